"""Scenes as models of MuJoCo."""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt
import scenes

Floats = npt.NDArray[np.float64]

#: The density of every body, kilograms per cubic metre.
DENSITY = 1000.0


def mjcf(setup: scenes.Setup, *, time_step: float = 0.005, options: str = "") -> str:
    """A scene in MuJoCo's format: boxes as boxes, and all other shapes as meshes.

    Args:
        setup: the scene.
        time_step: seconds per step.
        options: further attributes of `<option>`.
    """
    meshes: list[str] = []
    bodies: list[str] = []
    for i, (shape, place, turn) in enumerate(
        zip(setup.shapes, setup.positions, setup.rotations, strict=True)
    ):
        half = half_extents(shape)
        if half is None:
            meshes.append(f'<mesh name="shape {i}" vertex="{_numbers(shape)}"/>')
            geom = f'type="mesh" mesh="shape {i}"'
        else:
            geom = f'type="box" size="{_numbers(half)}"'
        free = "" if i < setup.fixed else "<freejoint/>"
        bodies.append(
            f'<body name="body {i}" pos="{_numbers(place)}" quat="{_numbers(np.roll(turn, 1))}">'
            f'{free}<geom {geom} density="{DENSITY}" friction="{setup.friction} 0 0"/></body>'
        )
    return (
        f'<mujoco model="{setup.name}"><option timestep="{time_step}" {options}/>'
        f'<size memory="200M"/><asset>{"".join(meshes)}</asset>'
        f"<worldbody>{''.join(bodies)}</worldbody></mujoco>"
    )


def half_extents(points: Floats) -> Floats | None:
    """The half edge lengths of a box about the origin, along the axes; None for another shape."""
    half = np.abs(points).max(axis=0)
    is_box = len(points) == 8 and np.array_equal(np.abs(points), np.tile(half, (8, 1)))
    return half if is_box and len(np.unique(points, axis=0)) == 8 else None


def puzzle(*, distance: float = 0.02005, margin: float = 0.0) -> str:
    """A cube of 26 small cubes with cut edges, which turn about its centre: 325 pairs of meshes.

    The six in the middle of a side have a hinge and a motor each, and all others a ball joint. Only
    the contacts hold a side together while it is turned.

    Args:
        distance: the distance of neighbours, metres. The small cubes are 0.02 m wide.
        margin: the margin of each geom.
    """
    half, cut = 0.01, 0.0015
    corners = [
        np.roll([sign * half, *rest], axis)
        for axis in range(3)
        for sign in (-1, 1)
        for rest in itertools.product((-(half - cut), half - cut), repeat=2)
    ]
    pieces: list[str] = []
    motors: list[str] = []
    for place in itertools.product((-1, 0, 1), repeat=3):
        if not any(place):
            continue
        name = "_".join(map(str, place))
        if sum(map(abs, place)) == 1:
            joint = f'type="hinge" axis="{_numbers(place)}"'
            motors.append(f'<motor joint="{name}" ctrlrange="-0.05 0.05" ctrllimited="true"/>')
        else:
            joint = 'type="ball"'
        pieces.append(
            f'<body><joint name="{name}" {joint} armature="0.0001" damping="0.0005" '
            f'frictionloss="0.0005"/><body pos="{_numbers(distance * np.array(place))}">'
            f'<geom type="mesh" mesh="piece" mass="0.0025" condim="1" margin="{margin}"/>'
            "</body></body>"
        )
    return (
        '<mujoco model="puzzle"><option timestep="0.01" integrator="implicitfast"/>'
        f'<asset><mesh name="piece" vertex="{_numbers(np.array(corners))}"/></asset>'
        f"<worldbody>{''.join(pieces)}</worldbody><actuator>{''.join(motors)}</actuator></mujoco>"
    )


def _numbers(values: npt.ArrayLike) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))
