"""Decomposition of meshes into convex pieces: progress, exact parts, and refusals."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import solids
from solids import BARS, box, stl

import hullcast
from hullcast import _decompose

BOWL = solids.turned([(0, 0), (1, 0), (1, 1), (0.9, 1), (0.9, 0.1), (0, 0.1)], 24)


def test_progress_of_decomposition(tmp_path, monkeypatch, capfd):
    """Catches minutes without any message.

    The callback is told about each mesh that is not convex: its name, its number, the total, and
    whether it was cached. Without a callback the progress is only printed if standard error is a
    terminal.
    """

    class Coacd:
        """A substitute for coacd that always finds the two bars."""

        @staticmethod
        def run_coacd(*_: object, **__: object) -> list:
            return [(bar.reshape(-1, 3), None) for bar in BARS]

        @staticmethod
        def Mesh(*_: object) -> None:  # coacd's own name
            return None

        @staticmethod
        def set_log_level(_: str) -> None:
            return None

    monkeypatch.setitem(__import__("sys").modules, "coacd", Coacd)
    monkeypatch.setattr(_decompose.importlib.metadata, "version", lambda _: "0")
    (tmp_path / "bowl.stl").write_bytes(stl(BOWL))
    (tmp_path / "cube.stl").write_bytes(stl(box((0, 0, 0), (1, 1, 1))))
    elements = "".join(
        f'<collision><geometry><mesh filename="{name}.stl"/></geometry></collision>'
        for name in ("bowl", "cube", "bowl")
    )
    (tmp_path / "r.urdf").write_text(f'<robot name="r"><link name="a">{elements}</link></robot>')
    heard: list[_decompose.Progress] = []
    options = {"cache": tmp_path / "kept"}
    robot = hullcast.Robot(tmp_path / "r.urdf", progress=heard.append, **options)
    assert len(robot) == 5
    assert [(p.number, p.total, p.state) for p in heard] == [
        (1, 2, "computing"),
        (1, 2, "computed"),
        (2, 2, "cached"),
    ]
    assert heard[2].mesh == "link 'a', collision 2 (bowl.stl)"
    text = "convex pieces of link 'a', collision 2 (bowl.stl), 2 of 2: cached"
    assert str(heard[2]) == text
    hullcast.Robot(tmp_path / "r.urdf", **options)
    assert capfd.readouterr() == ("", "")
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    hullcast.Robot(tmp_path / "r.urdf", **options)
    assert text in capfd.readouterr().err
    # A truncated cache file is computed again.
    for kept in (tmp_path / "kept").iterdir():
        kept.write_bytes(kept.read_bytes()[:100])
    assert len(hullcast.decompose(solids.mesh(BOWL), **options)) == 2
    assert len(hullcast.Robot(tmp_path / "r.urdf", **options)) == 5


@pytest.mark.parametrize(
    ("mesh", "reason"),
    [
        (solids.mesh(box((0, 0, 0), (1, 1, 0))), "COPLANAR"),
        (solids.mesh(box((0, 0, 0), (1, 1, np.nan))), "NOT_FINITE"),
        (SimpleNamespace(vertices=np.eye(3), faces=np.zeros((0, 3), int)), "NO_TRIANGLES"),
        (SimpleNamespace(vertices=np.eye(3), faces=[[0, 1, 3]]), "INDEX_OUT_OF_RANGE"),
        (SimpleNamespace(vertices=np.eye(3)), "NO_TRIANGLES"),
        (np.eye(3), "NOT_A_MESH"),
        (None, "NOT_A_MESH"),
        ("none.obj", "FILE_NOT_FOUND"),
    ],
)
def test_what_cannot_be_decomposed(mesh, reason):
    """Catches a crash of coacd, which checks nothing itself."""
    with pytest.raises(hullcast.InvalidArgument) as caught:
        hullcast.decompose(mesh)
    assert caught.value.reason == reason


def test_separate_convex_parts_are_the_pieces(client, tmp_path, monkeypatch):
    """Catches that coacd is used for two overlapping convex bars.

    coacd takes a minute and moves the bars by 3 cm. The pieces must be exactly the bars, and a cube
    in their dent is 0.2 from them.
    """
    monkeypatch.setitem(__import__("sys").modules, "coacd", None)
    (tmp_path / "r.urdf").write_text(
        '<robot name="r"><link name="a"><collision><geometry><mesh filename="bars.stl"/></geometry>'
        "</collision></link></robot>"
    )
    (tmp_path / "bars.stl").write_bytes(stl(np.concatenate([*BARS, BARS[0], BARS[1][:, ::-1]])))
    robot = hullcast.Robot(tmp_path / "r.urdf", cache=tmp_path / "kept")
    corners = [sorted(map(tuple, bar.reshape(-1, 3).tolist())) for bar in BARS]
    expected = sorted(sorted(set(corner)) for corner in corners)
    assert sorted(sorted(map(tuple, shape.tolist())) for shape in robot.shapes) == expected
    cube = box((0.7, 0.7, -0.2), (1.1, 1.1, 0.2)).reshape(-1, 3)
    scene = hullcast.Scene(
        client.register([cube, *robot.shapes]), np.zeros((3, 3)), [[0, 0, 0, 1]] * 3
    )
    near = client.query(scene, [[0, 1], [0, 2]], margin=0.19)
    assert near.outcome.tolist() == [hullcast.Outcome.SEPARATED] * 2
    assert client.query(scene, [[0, 1], [0, 2]], margin=1).separation == pytest.approx([0.2, 0.2])
    # Parts that are open, flat, not convex or too many do need coacd.
    small = [box((i, 0, 0), (i + 0.5, 1, 1)) for i in range(65)]
    for parts in ((BARS[0], BARS[1][1:]), (*BARS, BARS[0] * [1, 1, 0]), (*BARS, BOWL + 3), small):
        with pytest.raises(ImportError, match="coacd"):
            hullcast.decompose(solids.mesh(*parts), cache=tmp_path / "kept")
    assert len(hullcast.decompose(solids.mesh(*small[:64]), cache=tmp_path / "kept")) == 64
