"""Contacts inside MuJoCo, compared with MuJoCo's own contacts."""

from __future__ import annotations

import gc
import itertools
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hullcast
from hullcast import _mjmodel, _mjtable

mujoco: Any = pytest.importorskip("mujoco")
narrow: Any = pytest.importorskip("hullcast.mujoco")
for folder in ("simulators", "simulation"):
    sys.path.append(str(Path(__file__).resolve().parents[2] / "examples" / folder))
models: Any = pytest.importorskip("models")
scenes: Any = pytest.importorskip("scenes")


def model_of(name: str, **options: Any) -> Any:
    return mujoco.MjModel.from_xml_string(models.mjcf(scenes.SCENES[name](), **options))


def run(model: Any, steps: int, step: Any) -> tuple[np.ndarray, list[int]]:
    """The positions of all bodies after some steps, and the number of contacts of each step."""
    data = mujoco.MjData(model)
    counts = []
    for _ in range(steps):
        step(data)
        counts.append(int(data.ncon))
    return data.xpos.copy(), counts


def both(client: hullcast.Client, model: Any, steps: int) -> tuple[float, list[int], list[int]]:
    """How far bodies end from where MuJoCo's own contacts bring them, and both counts."""
    own, counts = run(model, steps, lambda data: mujoco.mj_step(model, data))
    with narrow.NarrowPhase(client, model) as contacts:
        new, other = run(model, steps, contacts.step)
    return float(np.abs(own - new).max()), counts, other


def as_meshes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Makes all boxes but the floor meshes."""
    half = models.half_extents
    monkeypatch.setattr(
        models, "half_extents", lambda points: half(points) if points.max() > 1 else None
    )


def table() -> list[Any]:
    return list(_mjtable.table()._entries)


@pytest.mark.parametrize("as_mesh", [False, True], ids=["boxes", "meshes"])
def test_a_tower_ends_where_mujoco_brings_it(client, as_mesh, monkeypatch):
    """Catches a normal the wrong way round, a point off the middle, and a contact of another step."""
    if as_mesh:
        as_meshes(monkeypatch)
    model = model_of("tower")
    assert (model.geom_type[1:] == (7 if as_mesh else 6)).all()
    away, own, new = both(client, model, 400)
    # At first the faces touch exactly, which MuJoCo counts as a contact.
    assert own[20:] == new[20:] == [40] * 380
    assert away < 1e-9


def test_a_puzzle_of_meshes_is_as_in_mujoco(client):
    """325 pairs of meshes, whose contacts bear the weight of the pieces.

    The bodies of the first puzzle overlap by less than their margins, so that it has no contacts.
    In the second one they fall against each other. MuJoCo reads meshes in single precision.
    """
    still = mujoco.MjModel.from_xml_string(models.puzzle(distance=0.01905, margin=-0.001))
    rule = _mjmodel.Filter(mujoco, still, _mjmodel.colliding(still))
    assert np.count_nonzero(np.triu(rule.meets)) == 325
    away, own, new = both(client, still, 200)
    assert max(own) == max(new) == 0
    assert away < 1e-9
    falling = mujoco.MjModel.from_xml_string(models.puzzle())
    away, own, new = both(client, falling, 200)
    assert own == new
    assert max(own) > 30
    assert away < 1e-6


def test_every_integrator_gets_the_contacts_of_its_own_states(client, monkeypatch):
    """Catches contacts that are computed once per step: RK4 evaluates four states."""
    as_meshes(monkeypatch)
    model = model_of("tower", options='integrator="RK4"')
    computed = narrow.NarrowPhase._computed
    calls = []
    monkeypatch.setattr(
        narrow.NarrowPhase, "_computed", lambda *given: (calls.append(1), computed(*given))[1]
    )
    away, own, new = both(client, model, 60)
    assert own[20:] == new[20:] == [40] * 40
    assert away < 1e-6
    # At rest the second state is the first one, whose contacts are taken.
    assert len(calls) == 4 * 60 - 1


PRISM = " ".join(
    f"{np.cos(a):.6f} {np.sin(a):.6f} {z}" for a in np.arange(12) * np.pi / 6 for z in (-0.5, 0.5)
)
PLATES = f"""<mujoco><asset><mesh name="prism" vertex="{PRISM}"/></asset><worldbody>
  <geom type="box" size="3 3 0.5" pos="0 0 -0.5"/>
  <body pos="0 0 0.49"><freejoint/><geom type="mesh" mesh="prism" margin="0.05" gap="0.02"/></body>
  <body pos="0 0 1.48"><freejoint/><geom type="mesh" mesh="prism" margin="0.05"/></body>
  <body pos="9 0 0"><freejoint/><geom type="box" size="1 1 1"/></body>
  <body pos="9 0 1.99" euler="0 0 45"><freejoint/><geom type="box" size="1 1 1"/></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize("most", [0, 1, 3, 6])
def test_no_pair_has_more_points_than_mujoco_has_room_for(client, most):
    """Catches the crash of MuJoCo that follows, and points that are dropped from one side only."""
    model = mujoco.MjModel.from_xml_string(PLATES)
    data = mujoco.MjData(model)
    accuracy = hullcast.Accuracy(max_points=most)
    with narrow.NarrowPhase(client, model, accuracy=accuracy) as contacts:
        mujoco.mj_forward(model, data)
        counts = (
            dict(zip(*np.unique(data.contact.geom, axis=0, return_counts=True), strict=True))
            if 0
            else {}
        )
        for pair in data.contact.geom.tolist():
            counts[tuple(pair)] = counts.get(tuple(pair), 0) + 1
        room = {pair: mujoco.mj_maxContact(model, *pair, 1) for pair in counts}
        wanted = {pair: min(room[pair], most or 99) for pair in counts}
        assert counts == wanted
        assert sorted(room.values()) == [4, 4, 8]
        # The points that are kept are spread over the patch: their mean is near the axis.
        for pair in ((0, 1), (1, 2)):
            points = data.contact.pos[(data.contact.geom == pair).all(axis=1)]
            assert most in (1, 3) or np.linalg.norm(points[:, :2].mean(axis=0)) < 0.3
        contacts.step(data, 50)
    assert np.isfinite(data.qpos).all()
    # Without reduction the two prisms have twelve points.
    scene = narrow.scene(client, model, data)
    mujoco.mj_resetData(model, data)
    mujoco.mj_forward(model, data)
    chosen = narrow.geoms(model)
    at = scene.moved(data.geom_xpos[chosen], data.geom_xmat[chosen].reshape(-1, 3, 3))
    assert client.query(at, [[1, 2]]).point_counts.tolist() == [12]


def test_margins_and_gaps_are_those_of_mujoco(client):
    """Catches points beyond the margin, or within it but left out: MuJoCo adds margin and gap."""
    text = """<mujoco><worldbody><geom type="box" size="3 3 0.5" pos="0 0 -0.5" margin="0.01"/>
      <body pos="0 0 {0}"><freejoint/><geom type="box" size="1 1 1" margin="0.02" gap="0.03"/></body>
      <body pos="0 0 9"><freejoint/><geom type="box" size="1 1 1" margin="0.5"/></body>
    </worldbody></mujoco>"""
    met = 0
    for height in np.linspace(0.99, 1.08, 19):
        model = mujoco.MjModel.from_xml_string(text.format(height))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        own = (data.contact.dist.copy(), data.contact.includemargin.copy())
        with narrow.NarrowPhase(client, model):
            mujoco.mj_forward(model, data)
        assert data.contact.dist == pytest.approx(own[0], abs=1e-12)
        assert data.contact.includemargin.tolist() == own[1].tolist()
        met += len(own[0]) > 0
    assert 10 < met < 19


def test_the_table_is_restored(client):
    """Catches MuJoCo's functions that stay replaced after an error in the block."""
    model = model_of("tower")
    before = table()

    def fails() -> None:
        with narrow.NarrowPhase(client, model) as contacts:
            assert sum(a != b for a, b in zip(before, table(), strict=True)) == 3
            contacts.step(mujoco.MjData(model))
            raise KeyError

    with pytest.raises(KeyError):
        fails()
    assert table() == before
    other = model_of("wall")
    with narrow.NarrowPhase(client, model), narrow.NarrowPhase(client, other):
        assert table() != before
        with (
            pytest.raises(hullcast.Error, match="in use by another"),
            narrow.NarrowPhase(client, model),
        ):
            pass
        assert table() != before
    assert table() == before
    assert both(client, model, 5)[0] < 1e-12


def test_other_models_keep_their_own_contacts(client):
    """Catches contacts of one model that are given to another, or computed for it."""
    model, other = model_of("tower"), model_of("wall")
    data, away, own = mujoco.MjData(model), mujoco.MjData(other), mujoco.MjData(other)
    mujoco.mj_forward(other, own)
    with narrow.NarrowPhase(client, model) as contacts:
        mujoco.mj_forward(other, away)
        assert contacts.manifolds(data) is None
        assert away.ncon == own.ncon > 50
        mujoco.mj_forward(model, data)
        assert len(contacts.manifolds(data)) == 10
        assert contacts.manifolds(data).scene is not None


def test_several_states_of_one_model(client):
    """Catches contacts of one `MjData` that are given to another."""
    model = model_of("tower")
    states = [mujoco.MjData(model) for _ in range(3)]
    for i, data in enumerate(states):
        data.qpos[2] += 1e-3 * i
    expected = [mujoco.MjData(model) for _ in range(3)]
    for data, copy in zip(states, expected, strict=True):
        copy.qpos[:] = data.qpos
    with narrow.NarrowPhase(client, model) as contacts:
        for _ in range(20):
            for data in states:
                contacts.step(data)
    for copy in expected:
        mujoco.mj_step(model, copy, 20)
    for data, copy in zip(states, expected, strict=True):
        assert np.abs(data.qpos - copy.qpos).max() < 1e-9


@pytest.mark.parametrize("name", ["wall", "arch"])
def test_distances_are_those_of_mujoco(client, name):
    """Catches distances that MuJoCo takes from its contact functions while these are replaced."""
    model = model_of(name)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    pairs = list(itertools.combinations(range(0, model.ngeom, 2), 2))
    ends = np.zeros(6)

    def distances() -> list[list[float]]:
        found = []
        for a, b in pairs:
            distance = mujoco.mj_geomDistance(model, data, a, b, 100.0, ends)
            found.append([distance, *(ends if distance > 1e-3 else 0 * ends)])
        return found

    own = distances()
    with narrow.NarrowPhase(client, model):
        assert np.abs(np.array(distances()) - own).max() < 1e-12
    assert distances() == own
    assert sum(distance > 0.1 for distance, *_ in own) > 5


def test_a_server_that_is_lost_raises(tmp_path):
    """Catches a simulation that goes on without contacts when calls fail.

    MuJoCo's own contacts take over, `step` raises, and so does leaving the block after `mj_step`.
    """
    model = model_of("tower")
    before = table()
    own = mujoco.MjData(model)
    mujoco.mj_step(model, own, 5)
    for by_step in (True, False):
        data = mujoco.MjData(model)
        client = hullcast.serve()
        contacts = narrow.NarrowPhase(client, model)
        client.close()

        def simulated(contacts: Any, data: Any, by_step: bool) -> None:
            with contacts:
                if by_step:
                    for _ in range(3):  # each of them raises
                        with pytest.raises(hullcast.Error, match="CLOSED"):
                            contacts.step(data)
                    mujoco.mj_step(model, data, 2)
                else:
                    mujoco.mj_step(model, data, 5)
                assert table() == before

        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            if by_step:
                simulated(contacts, data, by_step)
            else:
                with pytest.raises(hullcast.Error, match="CLOSED"):
                    simulated(contacts, data, by_step)
        assert len(caught) == 1
        assert "MuJoCo goes on with its own contacts: CLOSED" in str(caught[0].message)
        assert np.abs(data.qpos - own.qpos).max() < 1e-9


def test_an_interrupt_ends_a_loop(client, monkeypatch):
    """Catches Ctrl-C that ctypes prints and drops while a contact is computed."""
    model = model_of("tower")
    data = mujoco.MjData(model)
    phase = narrow.NarrowPhase(client, model)

    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    def loop() -> None:
        with phase:
            while data.time < 1e4:
                mujoco.mj_step(model, data)

    monkeypatch.setattr(type(phase), "_computed", interrupted)
    with pytest.raises(KeyboardInterrupt):
        loop()
    assert data.time < 1e3


def test_nothing_is_kept_after_the_block(client):
    """Catches a model that is never freed, because the table holds it."""
    import weakref

    model = model_of("tower")
    phase = narrow.NarrowPhase(client, model)
    with phase:
        mujoco.mj_forward(model, mujoco.MjData(model))
    gone = weakref.ref(phase)
    del phase
    gc.collect()
    assert gone() is None


def test_arguments_of_the_narrow_phase(client):
    """Each wrong value is named, with what is allowed."""
    model = model_of("tower")
    data, other = mujoco.MjData(model), mujoco.MjData(model_of("wall"))
    for call, says in [
        (lambda: narrow.NarrowPhase(None, model), "client: expected a hullcast.Client, got None"),
        (lambda: narrow.NarrowPhase(client, data), "model: expected a mujoco.MjModel, got MjData"),
        (lambda: narrow.NarrowPhase(client, model, accuracy=4), "accuracy: expected .*Accuracy"),
        (lambda: narrow.geoms("x"), "model: expected a mujoco.MjModel, got str"),
        (lambda: narrow.scene(1, model, data), "client: expected"),
        (lambda: narrow.scene(client, None, data), "model: expected"),
        (lambda: narrow.scene(client, model, model), "data: expected a mujoco.MjData"),
        (lambda: narrow.scene(client, model, other), "data: got data of 31 geoms .* 11 and 70"),
        (lambda: narrow.scene(client, model, data), "data: it has no poses yet: .*mj_forward"),
        (lambda: narrow.NarrowPhase(client, model).manifolds(None), "data: expected a mujoco.MjD"),
    ]:
        with pytest.raises(hullcast.InvalidArgument, match=says):
            call()
    mujoco.mj_forward(model, data)
    for wrong in ([11], [-1], [0.5], "a", [[0, 1]], {1}):
        with pytest.raises(hullcast.InvalidArgument, match="geoms"):
            narrow.scene(client, model, data, geoms=wrong)
    with pytest.raises(hullcast.Error, match=r"NOT_ACTIVE.*only in use inside its with block"):
        narrow.NarrowPhase(client, model).step(data)
    with narrow.NarrowPhase(client, model) as contacts:
        assert repr(contacts) == "NarrowPhase(11 geoms)"
        for wrong in (0, 1.5, None, "a"):
            with pytest.raises(hullcast.InvalidArgument, match=r"count: got .*expected an integer"):
                contacts.step(data, wrong)
        with pytest.raises(hullcast.InvalidArgument, match="data: got data of 31 geoms"):
            contacts.step(other)
        with pytest.raises(AttributeError, match="make another"):
            contacts.model = model


def test_other_versions_of_mujoco_are_refused(client, monkeypatch):
    """Catches a version whose structures are read at the wrong places."""
    monkeypatch.setattr(mujoco, "__version__", "4.1.0")
    with pytest.raises(ImportError, match=r"needs mujoco 4\.0\.\*, and 4\.1\.0 is installed"):
        narrow.NarrowPhase(client, model_of("tower"))
