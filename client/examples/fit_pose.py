"""Pushes a hull into the corner of a floor and a wall by gradient descent, and draws its way.

    python client/examples/fit_pose.py [--picture FILE] [--steps N]

It needs torch and matplotlib. The cost is the height of the hull's origin plus its distance from
the wall, and a penalty for each pair that overlaps. `hullcast.torch` differentiates the penalty by
the position and by the quaternion. docs/python/fitting.md explains the program.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false
# matplotlib is only partly typed.

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

import hullcast
import hullcast.torch

#: Lengths, in metres: the thickness of floor and wall, and the sides of the brick.
THICKNESS, SIDES = 0.2, (0.6, 0.5, 0.3)
START = ([0.9, 0.0, 0.8], [0.1, 0.35, 0.2, 0.9])
#: The pairs of the brick, body 2, with the floor and the wall.
PAIRS = ((0, 2), (1, 2))
#: The penalty of an overlap: this times the square of 1 - alpha.
STIFFNESS = 100.0


def corner(client: hullcast.Client) -> hullcast.Scene:
    """A floor below z = 0, a wall before x = 0, and the brick at its start."""
    floor = hullcast.box((4.0, 4.0, THICKNESS))
    wall = hullcast.box((THICKNESS, 4.0, 4.0))
    hulls = client.register([floor, wall, hullcast.box(SIDES)])
    positions = [[1.0, 0.0, -THICKNESS / 2], [-THICKNESS / 2, 0.0, 1.0], START[0]]
    rotations = [[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0], START[1]]
    return hullcast.Scene(hulls, positions, rotations)


def fit(client: hullcast.Client, steps: int) -> tuple[list[np.ndarray], list[float]]:
    """The poses of the brick in every step, x, y, z and the quaternion, and the costs."""
    import torch as library

    torch: Any = library
    scene = corner(client)
    still = torch.tensor(scene.positions[:2]), torch.tensor(scene.rotations[:2])
    position = torch.tensor(scene.positions[2], requires_grad=True)
    rotation = torch.tensor(scene.rotations[2], requires_grad=True)
    optimizer = torch.optim.Adam([position, rotation], lr=0.02)
    # Shrinking steps end the dance around the kinks where the brick lies on its faces.
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    poses: list[np.ndarray] = []
    costs: list[float] = []
    for _ in range(steps):
        optimizer.zero_grad()
        positions = torch.cat([still[0], position[None]])
        rotations = torch.cat([still[1], rotation[None]])
        alpha = hullcast.torch.alpha(client, scene, PAIRS, positions, rotations)
        overlap = (1 - alpha).clamp(min=0)
        cost = position[0] + position[2] + STIFFNESS * (overlap**2).sum()
        cost.backward()
        optimizer.step()
        schedule.step()
        poses.append(np.concatenate([position.detach().numpy(), rotation.detach().numpy()]))
        costs.append(float(cost.detach()))
    return poses, costs


def outline(pose: np.ndarray) -> np.ndarray:
    """The outline of the brick, seen along y: corners (x, z) in order."""
    from scipy.spatial import ConvexHull
    from scipy.spatial.transform import Rotation

    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2 * SIDES
    seen = (Rotation.from_quat(pose[3:]).apply(corners) + pose[:3])[:, [0, 2]]
    return seen[ConvexHull(seen).vertices]


def draw(poses: list[np.ndarray], costs: list[float], path: Path) -> None:
    """Draws the brick's way into the corner, and the cost by steps."""
    import matplotlib.pyplot as plt

    figure, (side, chart) = plt.subplots(1, 2, figsize=(9, 4), width_ratios=(3, 2))
    ground = {"color": "0.8", "zorder": 0}
    side.add_patch(plt.Rectangle((-THICKNESS, -THICKNESS), 2, THICKNESS, **ground))
    side.add_patch(plt.Rectangle((-THICKNESS, -THICKNESS), THICKNESS, 2, **ground))
    first = np.concatenate(START)
    shown = [first, *(poses[int(len(poses) * part)] for part in (0.1, 0.2, 0.3, 0.5)), poses[-1]]
    for i, pose in enumerate(shown):
        colour = plt.get_cmap("viridis")(0.85 * (1 - i / (len(shown) - 1)))
        corners = outline(pose)
        if i in (0, len(shown) - 1):
            side.add_patch(plt.Polygon(corners, alpha=0.3, color=colour))
        side.add_patch(plt.Polygon(corners, fill=False, linewidth=1.5, color=colour))
    way = np.array([first, *poses])
    side.plot(way[:, 0], way[:, 2], color="0.3", linewidth=1, linestyle=":")
    side.annotate("start", first[[0, 2]], ha="center", va="center")
    side.annotate("end", poses[-1][[0, 2]], ha="center", va="center")
    side.set(xlim=(-THICKNESS, 1.4), ylim=(-THICKNESS, 1.3), aspect="equal")
    side.set(xlabel="x (m)", ylabel="z (m)", title="The brick, seen along y")
    chart.plot(costs, color="C0")
    chart.set(xlabel="step", ylabel="cost", title="The cost")
    chart.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--picture", type=Path, help="writes the picture to this file")
    parser.add_argument("--steps", type=int, default=300)
    arguments = parser.parse_args()
    with hullcast.serve() as client:
        poses, costs = fit(client, arguments.steps)
        scene = corner(client)
        bodies = np.concatenate([scene.positions, scene.rotations], axis=1)
        bodies[2] = poses[-1]
        end = scene.moved(bodies[:, :3], bodies[:, 3:])
        m = client.query(end, PAIRS, margin=np.inf)
    x, y, z = poses[-1][:3]
    print(f"cost {costs[0]:.3f} at the start, {costs[-1]:.3f} at the end")
    print(f"origin of the brick at ({x:.3f}, {y:.3f}, {z:.3f})")
    print(f"alpha {m.alpha[0]:.4f} with the floor, {m.alpha[1]:.4f} with the wall")
    if arguments.picture:
        draw(poses, costs, arguments.picture)


if __name__ == "__main__":
    main()
