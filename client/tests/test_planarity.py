"""Shapes with rounded coordinates, as in mesh files, stand on whole faces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hullcast

#: A cube of 4 cm, rotated and written with six decimals. The first line has the quaternion of the
#: inverse rotation.
TURNED_CUBE = Path(__file__).parent / "meshes/turned_cube.obj"
FLOOR = np.array([[x, y, z] for x in (-2, 2) for y in (-2, 2) for z in (-0.2, 0)])


def corners_touched(
    client: hullcast.Client, shapes: list, turns: list, size: float, planarity: object
) -> list[int]:
    """The number of contact points of each cube, rotated back to stand 0.1 mm deep in a floor."""
    floor, *cubes = client.register([FLOOR, *shapes], planarity=planarity)
    above = [[0, 0, size / 2 - 1e-4]] * len(cubes)
    scene = hullcast.Scene(
        [floor, *cubes], [[0, 0, 0], *above], [[0, 0, 0, 1], *(list(turn) for turn in turns)]
    )
    m = client.query(scene, [[0, 1 + i] for i in range(len(cubes))], margin=1e-3)
    assert (np.abs(m.distance + 1e-4) < 3e-6).all()
    return m.point_counts.tolist()


def test_the_cube_of_a_file_stands_on_four_corners(client: hullcast.Client):
    """Catches a default planarity below the file's rounding: only 3 of 4 corners touch then."""
    pytest.importorskip("trimesh")
    quaternion = TURNED_CUBE.read_text(encoding="utf-8").splitlines()[0].split("quaternion")[1]
    turn = [float(x) for x in quaternion.split()]
    assert corners_touched(client, [TURNED_CUBE], [turn], 0.04, "default") == [4]


@pytest.mark.parametrize("size", [0.04, 1.0])
def test_rounded_cubes_stand_on_four_corners(client: hullcast.Client, size: float):
    """Catches a lost corner in 40 orientations.

    Without a planarity most orientations lose a corner, so the test is not vacuous.
    """
    rotation = pytest.importorskip("scipy.spatial.transform").Rotation
    turns = rotation.random(40, random_state=18)
    cube = size * np.array(
        [[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]
    )
    shapes = [np.round(turn.apply(cube), 6) for turn in turns]
    back = turns.inv().as_quat()
    assert corners_touched(client, shapes, back, size, "default") == [4] * 40
    assert corners_touched(client, shapes, back, size, None).count(4) < 30
