"""Makes pile.json: mixed hulls, dropped into a tray and simulated until they are at rest.

    pip install numpy scipy ./client
    python make_pile.py [--bodies 1000] [--out pile.json]

This is a small rigid body simulator. All contacts come from a hullcast server. Impulses are
computed by projected Gauss-Seidel with friction, starting from the impulses of the previous step,
which are found by the contact points' ids. Poses are integrated by the semi-implicit Euler method.
Gyroscopic torque is left out. Pairs of one colour of the contact graph are independent, so numpy
solves all pairs of a colour at once.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import hullcast
import shapes

HERE = Path(__file__).parent
GRAVITY = np.array([0, 0, -9.81])
STEP = 1 / 120
FRICTION = 0.6
# Contact points are kept up to this distance, so that a body is stopped before it sinks in.
MARGIN = 0.01
# The penetration that is not corrected (m), the fraction of the rest that one step removes, and the
# largest speed of this correction (m/s).
SLOP, RECOVERY, RECOVERY_SPEED = 2e-4, 0.2, 0.5
ITERATIONS = 20
# The damping of linear and angular velocity (1/s): at first, and after CALM seconds, when all
# bodies have landed.
DAMPING, CALM_DAMPING, CALM = 0.5, 5.0, 8.0
# The largest speed. No body moves farther than MARGIN in a step, so none passes through another.
SPEED = MARGIN / STEP
POINTS = 4
TRAY = 2.1  # half of the inner side, in metres
COLUMNS = 1.6  # half of the side of the block of bodies that is dropped, in metres
SCENE_MARGIN = 0.002


def make_shapes(rng):
    """The hulls that move, each about its centre of mass, and the two hulls of the tray."""
    clouds = {
        "cube": shapes.box([0.2, 0.2, 0.2]),
        "brick": shapes.box([0.3, 0.2, 0.12]),
        "slab": shapes.box([0.34, 0.22, 0.06]),
        "bar": shapes.box([0.4, 0.1, 0.1]),
        "wedge": shapes.wedge(0.26, 0.2, 0.18),
        "triangular prism": shapes.prism(3, 0.15, 0.22),
        "hexagonal prism": shapes.prism(6, 0.12, 0.18),
        "disc": shapes.prism(16, 0.15, 0.08),
        "barrel": shapes.prism(24, 0.1, 0.24),
        "tetrahedron": np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) * 0.12,
        "icosahedron": shapes.icosphere(0.13, 0),
        "rock 16": shapes.rock(rng, 16, [0.16, 0.14, 0.12]),
        "rock 32": shapes.rock(rng, 32, [0.18, 0.13, 0.11]),
        "rock 64": shapes.rock(rng, 64, [0.14, 0.14, 0.13]),
    }
    for name, points in clouds.items():
        clouds[name] = points - shapes.mass_properties(points)[1]
    tray = {"floor": shapes.box([2 * TRAY + 0.4, 2 * TRAY + 0.4, 0.2]), "wall": shapes.box([2 * TRAY + 0.2, 0.2, 0.5])}
    return clouds, tray


class World:
    """The state of the bodies. The last five, which are the tray, do not move."""

    def __init__(self, count, seed):
        rng = np.random.default_rng(seed)
        moving, tray = make_shapes(rng)
        self.hull_names = list(moving) + list(tray)
        self.hulls = list(moving.values()) + list(tray.values())
        floor = len(moving)
        self.body_hulls = np.concatenate([rng.integers(0, len(moving), count), [floor] + [floor + 1] * 4])
        self.count = count
        total = count + 5
        side = int(np.ceil(np.sqrt(count / 10)))
        cell = 2 * COLUMNS / side
        index = np.arange(count)
        grid = np.column_stack([index % side, index // side % side, index // side**2])
        self.position = np.zeros((total, 3))
        self.position[:count, :2] = (grid[:, :2] + 0.5) * cell - COLUMNS
        self.position[:count, 2] = 0.3 + 0.36 * grid[:, 2]
        self.position[:count] += rng.uniform(-0.01, 0.01, (count, 3))
        edge = TRAY + 0.1
        self.position[count:] = [[0, 0, -0.1], [0, edge, 0.25], [0, -edge, 0.25], [edge, 0, 0.25], [-edge, 0, 0.25]]
        quarter = Rotation.from_euler("z", [[0], [0], [0], [90], [90]], degrees=True)
        self.rotation = Rotation.concatenate([Rotation.random(count, rng=rng), quarter])
        self.velocity = np.zeros((total, 6))  # linear and angular, world frame
        properties = [shapes.mass_properties(h) for h in self.hulls]
        volume = np.array([p[0] for p in properties])[self.body_hulls]
        self.mass = 1000 * volume
        self.inertia = 1000 * np.array([p[2] for p in properties])[self.body_hulls]
        self.inverse_mass = 1 / self.mass
        self.inverse_inertia = np.linalg.inv(self.inertia)
        self.inverse_mass[count:] = 0
        self.inverse_inertia[count:] = 0

    def boxes(self):
        """The low and high corners of the bodies' axis-aligned boxes, world frame."""
        low = np.empty_like(self.position)
        high = np.empty_like(self.position)
        turn = self.rotation.as_matrix()
        for hull, vertices in enumerate(self.hulls):
            rows = np.flatnonzero(self.body_hulls == hull)
            world = np.einsum("bij,vj->bvi", turn[rows], vertices) + self.position[rows, None]
            low[rows], high[rows] = world.min(axis=1), world.max(axis=1)
        return low, high

    def pairs(self, margin):
        """(n, 2): pairs with a moving body and boxes within the margin, by a sweep along x."""
        low, high = self.boxes()
        low, high = low - margin / 2, high + margin / 2
        order = np.argsort(low[:, 0], kind="stable")
        reach = np.searchsorted(low[order, 0], high[order, 0], side="right")
        counts = np.maximum(reach - np.arange(len(order)) - 1, 0)
        first = np.repeat(np.arange(len(order)), counts)
        second = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) + first + 1
        a, b = order[first], order[second]
        keep = (low[a, 1:] <= high[b, 1:]).all(axis=1) & (low[b, 1:] <= high[a, 1:]).all(axis=1)
        pairs = np.sort(np.column_stack([a, b])[keep], axis=1)
        pairs = pairs[pairs[:, 0] < self.count]
        return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]

    def kinetic_energy(self):
        """The kinetic energy of each moving body, in joules."""
        linear, angular = self.velocity[: self.count, :3], self.velocity[: self.count, 3:]
        local = self.rotation[: self.count].inv().apply(angular)
        spin = np.einsum("bi,bij,bj->b", local, self.inertia[: self.count], local)
        return 0.5 * (self.mass[: self.count] * (linear**2).sum(axis=1) + spin)

    def integrate(self):
        """Moves every body by its velocity for one step."""
        self.position += STEP * self.velocity[:, :3]
        self.rotation = Rotation.from_rotvec(STEP * self.velocity[:, 3:]) * self.rotation


class Contacts:
    """The constraint rows of a step: POINTS slots per manifold, each a normal and two tangents."""

    def __init__(self, world, manifolds, pairs, memory):
        counts = np.diff(manifolds.point_offsets)
        rows = np.flatnonzero(counts)
        self.a, self.b = pairs[rows].T
        pair = np.repeat(np.arange(len(rows)), counts[rows])
        slot = np.arange(len(pair)) - np.repeat(np.cumsum(counts[rows]) - counts[rows], counts[rows])
        normal = manifolds.normal[rows][pair]
        middle = manifolds.witness_a + 0.5 * manifolds.distance[:, None] * normal
        shape = (len(rows), POINTS)
        self.at = (pair, slot)
        self.keys = _keys(self.a[pair], self.b[pair], manifolds.point_ids)
        self.jacobian = np.zeros((*shape, 3, 12))
        axes = _frame(normal)
        for side, body, sign in ((0, self.a, -1.0), (6, self.b, 1.0)):
            arm = middle - world.position[body[pair]]
            self.jacobian[pair, slot, :, side : side + 3] = sign * axes
            self.jacobian[pair, slot, :, side + 3 : side + 6] = sign * np.cross(arm[:, None], axes)
        turn = world.rotation.as_matrix()
        inertia = turn @ world.inverse_inertia @ turn.transpose(0, 2, 1)
        self.response = self.jacobian.copy()
        for side, body in ((0, self.a), (6, self.b)):
            self.response[..., side : side + 3] *= world.inverse_mass[body][:, None, None, None]
            spin = self.response[..., side + 3 : side + 6]
            self.response[..., side + 3 : side + 6] = np.einsum("pij,pskj->pski", inertia[body], spin)
        resistance = np.einsum("pskj,pskj->psk", self.jacobian, self.response)
        self.softness = np.divide(1, resistance, out=np.zeros_like(resistance), where=resistance > 0)
        # A gap may be closed within the step but not crossed. A penetration is removed slowly.
        gap = manifolds.distance
        push = np.minimum(RECOVERY * np.maximum(-gap - SLOP, 0) / STEP, RECOVERY_SPEED)
        self.target = np.zeros(shape)
        self.target[pair, slot] = np.where(gap > 0, -gap / STEP, push)
        self.impulse = np.zeros((*shape, 3))
        self.impulse[pair, slot] = memory.recall(self.keys)
        self.colours = _colours(self.a, self.b, world.count)

    def solve(self, velocity):
        """Runs projected Gauss-Seidel, colour by colour, and changes the velocities in place."""
        warm = np.einsum("pskj,psk->pj", self.response, self.impulse)
        np.add.at(velocity, self.a, warm[:, :6])
        np.add.at(velocity, self.b, warm[:, 6:])
        parts = [
            (rows, self.a[rows], self.b[rows], self.jacobian[rows], self.response[rows],
             self.softness[rows], self.target[rows], self.impulse[rows])
            for rows in self.colours
        ]  # fmt: skip
        for _ in range(ITERATIONS):
            for _, a, b, jacobian, response, softness, target, impulse in parts:
                v = np.concatenate([velocity[a], velocity[b]], axis=1)
                for slot in range(POINTS):
                    for axis in range(3):
                        speed = np.einsum("pj,pj->p", jacobian[:, slot, axis], v)
                        old = impulse[:, slot, axis].copy()
                        if axis == 0:
                            new = np.maximum(old + softness[:, slot, 0] * (target[:, slot] - speed), 0)
                        else:
                            limit = FRICTION * impulse[:, slot, 0]
                            new = np.clip(old - softness[:, slot, axis] * speed, -limit, limit)
                        impulse[:, slot, axis] = new
                        v += response[:, slot, axis] * (new - old)[:, None]
                velocity[a], velocity[b] = v[:, :6], v[:, 6:]
        for rows, *_, impulse in parts:
            self.impulse[rows] = impulse


class Memory:
    """The impulses of the previous step, by bodies and point ids."""

    def __init__(self):
        self.keys = np.empty(0, _KEY)
        self.impulse = np.empty((0, 3))

    def store(self, contacts):
        order = np.argsort(contacts.keys, kind="stable")
        self.keys, self.impulse = contacts.keys[order], contacts.impulse[contacts.at][order]

    def recall(self, keys):
        found = np.zeros((len(keys), 3))
        if len(self.keys):
            place = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
            known = self.keys[place] == keys
            found[known] = self.impulse[place[known]]
        return found


_KEY = np.dtype("S24")


def _keys(a, b, ids):
    """One sortable key per point. It is big-endian, so that bytes sort like numbers."""
    columns = np.column_stack([a, b, ids]).astype(">u4")
    return np.ascontiguousarray(columns).view(_KEY)[:, 0]


def _frame(normal):
    """(n, 3, 3): each normal and two tangents."""
    least = np.argmin(np.abs(normal), axis=1)
    tangent = np.cross(normal, np.eye(3)[least])
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    return np.stack([normal, tangent, np.cross(normal, tangent)], axis=1)


def _colours(a, b, moving):
    """Groups of rows in which no moving body occurs twice."""
    used = [0] * moving
    colours = {}
    for row, (i, j) in enumerate(zip(a.tolist(), b.tolist())):
        taken = used[i] | (used[j] if j < moving else 0)
        colour = ~taken & (taken + 1)
        used[i] |= colour
        if j < moving:
            used[j] |= colour
        colours.setdefault(colour, []).append(row)
    return [np.array(rows) for rows in colours.values()]


def simulate(client, world, seconds):
    """Runs until the bodies are at rest or time is over; returns the figures of the last step."""
    hulls = client.register(world.hulls)
    body_hulls = [hulls[i] for i in world.body_hulls]
    memory, accuracy = Memory(), hullcast.Accuracy(max_points=POINTS)
    started, energy, limit = time.perf_counter(), np.inf, int(seconds / STEP)
    for step in range(limit):
        world.velocity[: world.count, :3] += STEP * GRAVITY
        speed = np.linalg.norm(world.velocity[:, :3], axis=1, keepdims=True)
        world.velocity[:, :3] *= np.minimum(1, SPEED / np.maximum(speed, SPEED))
        pairs = world.pairs(MARGIN)
        scene = hullcast.Scene(body_hulls, world.position, world.rotation)
        manifolds = client.query(
            scene, pairs, margin=MARGIN, accuracy=accuracy, outputs=["NORMAL", "POINTS", "FEATURES"]
        )
        contacts = Contacts(world, manifolds, pairs, memory)
        contacts.solve(world.velocity)
        memory.store(contacts)
        world.velocity /= 1 + STEP * (DAMPING if step * STEP < CALM else CALM_DAMPING)
        world.integrate()
        energy = world.kinetic_energy()
        if step % 30 == 0:
            print(
                f"t {step * STEP:5.2f} s  pairs {len(pairs)}  points {len(manifolds.distance)}  "
                f"deepest {-manifolds.distance.min(initial=0) * 1e3:.2f} mm  "
                f"energy {energy.mean():.2e} J a body  wall {time.perf_counter() - started:.0f} s",
                flush=True,
            )
        if step * STEP > 2 and energy.mean() < 2e-6 and energy.max() < 2e-4:
            break
    return {
        "steps": step + 1,
        "step_seconds": STEP,
        "mean_kinetic_energy_joule": float(energy.mean()),
        "max_kinetic_energy_joule": float(energy.max()),
        "max_speed_metre_per_second": float(np.linalg.norm(world.velocity[:, :3], axis=1).max()),
        "lightest_body_kilogram": float(world.mass[: world.count].min()),
    }


def document(client, world, figures):
    """The content of a scene file with the settled scene."""
    pairs = world.pairs(SCENE_MARGIN)
    hulls = client.register(world.hulls)
    quaternions = world.rotation.as_quat(canonical=True)
    scene = hullcast.Scene([hulls[i] for i in world.body_hulls], world.position, quaternions)
    manifolds = client.query(scene, pairs, margin=SCENE_MARGIN)
    figures |= {
        "pairs_in_contact": int(np.count_nonzero(np.diff(manifolds.point_offsets))),
        "deepest_penetration_metre": float(-manifolds.distance.min()),
    }
    names = [f"{name} {i}" for i, name in enumerate(world.hull_names[h] for h in world.body_hulls)]
    return {
        "format": "hullcast.scene.v1",
        "name": f"A settled pile of {world.count} hulls",
        "units": "m",
        "license": "as this project",
        "origin": "make_pile.py",
        "margin": SCENE_MARGIN,
        "settled": figures,
        "hulls": [{"name": n, "vertices": v} for n, v in zip(world.hull_names, world.hulls)],
        "bodies": [
            {"name": n, "hull": int(h), "position": p, "rotation": q}
            for n, h, p, q in zip(names, world.body_hulls, world.position, quaternions)
        ],
        "pairs": pairs,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bodies", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=20, help="simulated time at most")
    parser.add_argument("--seed", type=int, default=2010)
    parser.add_argument("--out", type=Path, default=HERE / "pile.json")
    arguments = parser.parse_args()
    world = World(arguments.bodies, arguments.seed)
    with hullcast.serve() as client:
        figures = simulate(client, world, arguments.seconds)
        scene = document(client, world, figures)
    shapes.write_scene(arguments.out, scene)
    print(f"{arguments.out}: {len(scene['pairs'])} pairs, {scene['settled']}")


if __name__ == "__main__":
    main()
