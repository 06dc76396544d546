"""What is logged to rerun recordings, and that rerun can read them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from crowds import make_pile

import hullcast
from hullcast._rerun import colours

rerun = pytest.importorskip("rerun")


@pytest.fixture
def written(monkeypatch):
    """Collects what is logged, by entity, while it is also logged for real."""
    entities: dict[str, list] = {}
    log = rerun.log

    def both(path, entity, **options):
        entities.setdefault(path, []).append(entity)
        log(path, entity, **options)

    monkeypatch.setattr(rerun, "log", both)
    return entities


def test_two_steps_of_a_pile(client, written, tmp_path):
    """The whole pile with poses, hulls and points; then one pair without hulls."""
    scene = make_pile(client)
    m = client.query(scene, [[0, 1], [0, 2], [0, 3], [1, 2]], margin=0.02)
    recording = rerun.RecordingStream("hullcast-test")
    recording.save(tmp_path / "pile.rrd")
    m.log("world", recording=recording)
    first = {path: entities[0] for path, entities in written.items()}
    assert set(first) == {
        *(f"world/bodies/{i}{part}" for i in range(4) for part in ("", "/hull", "/edges")),
        *(f"world/contacts/{part}" for part in ("patches", "normals", "witnesses")),
        *(f"world/contacts/points_{side}" for side in "ab"),
    }
    assert len(first["world/bodies/1/edges"].strips) == 18  # a hexagonal prism
    for side, points in (("a", m.witness_a), ("b", m.witness_b)):
        logged = first[f"world/contacts/points_{side}"].positions.as_arrow_array().to_pylist()
        assert np.array(logged) == pytest.approx(points, abs=1e-6)
    arrows = first["world/contacts/normals"]
    assert arrows.labels.as_arrow_array().to_pylist() == ["0, 1", "0, 2"]
    vectors = np.array(arrows.vectors.as_arrow_array().to_pylist())
    assert vectors / np.linalg.norm(vectors, axis=1)[:, None] == pytest.approx(m.normal[:2])
    assert [len(s) for s in first["world/contacts/patches"].strips.as_arrow_array()] == [7, 5]
    written.clear()
    m.log("world", pairs=[1], hulls=False, recording=recording)
    assert {path for path in written if "bodies" in path} == {"world/bodies/0", "world/bodies/2"}
    assert len(written["world/contacts/points_a"][0].positions) == 4
    written.clear()
    m.log("world", pairs=[2], recording=recording)  # no contact: the previous step is cleared
    assert all(not len(e.positions) for e in written["world/contacts/points_a"])
    recording.flush()
    done = subprocess.run(
        [str(Path(sys.executable).parent / "rerun"), "rrd", "print", str(tmp_path / "pile.rrd")],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert "/world/contacts/points_a" in done.stdout


def test_colours_tell_the_sign():
    """Overlapping points are red, distant blue, touching grey, relative to the largest distance."""
    red, grey, blue = colours(np.array([-0.02, 0, 0.02])).tolist()
    assert red[0] > 2 * red[2]
    assert blue[2] > 2 * blue[0]
    assert len(set(grey)) == 1
    assert colours(np.zeros(0)).shape == (0, 3)


def test_what_cannot_be_written_says_so(client, tmp_path):
    """A loaded result has no scene to draw."""
    m = client.query(make_pile(client), [[0, 1]])
    m.save(tmp_path / "m.npz")
    with pytest.raises(hullcast.InvalidArgument, match="NO_SCENE"):
        hullcast.Manifolds.load(tmp_path / "m.npz").log()


def test_without_a_recording_the_user_is_told(client):
    """Catches a log that is silently lost because `rerun.init` was not called."""
    m = client.query(make_pile(client), [[0, 1]], margin=0.02)
    with pytest.raises(hullcast.InvalidArgument, match=r"NO_RECORDING.*rerun\.init"):
        m.log()
