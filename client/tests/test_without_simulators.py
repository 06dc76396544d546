"""The parts that need a simulator, where it is not installed."""

from __future__ import annotations

import sys

import pytest


def test_mujoco_is_named_where_it_is_missing(tmp_path, monkeypatch):
    """Catches an error about a module of another package, with no way to get it."""
    monkeypatch.setitem(sys.modules, "mujoco", None)
    import hullcast.mujoco

    path = tmp_path / "robot.xml"
    path.write_text("<?xml version='1.0'?>\n<!-- a robot -->\n<mujoco><worldbody/></mujoco>")
    advice = r"needs mujoco: pip install './client\[mujoco\]' in the clone"
    with pytest.raises(ImportError, match=f"hullcast.Robot of an MJCF file {advice}"):
        hullcast.Robot(path)
    for call in (
        lambda: hullcast.mujoco.NarrowPhase(None, None),
        lambda: hullcast.mujoco.scene(None, None, None),
        lambda: hullcast.mujoco.geoms(None),
    ):
        with pytest.raises(ImportError, match=f"hullcast.mujoco {advice}"):
            call()


def test_newton_is_named_where_it_is_missing(monkeypatch):
    """Catches an error about a module of another package, with no way to get it."""
    monkeypatch.setitem(sys.modules, "newton", None)
    import hullcast.newton

    advice = r"hullcast.newton needs newton: pip install './client\[newton\]' in the clone"
    with pytest.raises(ImportError, match=advice):
        hullcast.newton.Pipeline(None, None)
