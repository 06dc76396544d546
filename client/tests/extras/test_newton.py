"""Contacts inside Newton, compared with Newton's own pipeline and in its solvers."""

from __future__ import annotations

import itertools
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hullcast

newton: Any = pytest.importorskip("newton")
wp: Any = pytest.importorskip("warp")
pytest.importorskip("mujoco_warp")
inside: Any = pytest.importorskip("hullcast.newton")
for folder in ("simulators", "simulation"):
    sys.path.append(str(Path(__file__).resolve().parents[2] / "examples" / folder))
newton_models: Any = pytest.importorskip("newton_models")
scenes: Any = pytest.importorskip("scenes")

COLUMNS = (
    "shape0", "shape1", "normal", "point0", "point1", "offset0", "offset1", "margin0", "margin1", "tids",
)  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def quiet():
    wp.config.log_level = wp.LOG_ERROR


def rows(contacts: Any) -> dict[str, np.ndarray]:
    """The columns of all contacts."""
    count = int(contacts.rigid_contact_count.numpy()[0])
    return {
        name: getattr(contacts, f"rigid_contact_{name}").numpy()[:count].copy() for name in COLUMNS
    }


def by_place(columns: dict[str, np.ndarray]) -> np.ndarray:
    """The order of contacts by pair and place."""
    place = np.round(columns["point0"].astype(float), 4) + 0.0
    return np.lexsort((*place.T, columns["shape1"], columns["shape0"]))


def run(
    setup: Any,
    client: Any,
    solver: Any,
    *,
    steps: int = 200,
    copies: int = 0,
    options: Any = None,
    **pipeline: Any,
) -> tuple[np.ndarray, list[float]]:
    """The last poses of the bodies and the largest speed in each step.

    Without a client the contacts are Newton's own.
    """
    build = newton_models.builder(setup, **(options or {}))
    if copies:
        world = build
        build = newton.ModelBuilder()
        build.replicate(world, copies)
    build.color()
    model = build.finalize()
    state, after, control = model.state(), model.state(), model.control()
    if client is None:
        source = newton.CollisionPipeline(model)
    else:
        source = inside.Pipeline(client, model, **pipeline)
    contacts = (
        source.contacts()
        if client is None or source._matching
        else newton.CollisionPipeline(model, contact_matching="latest").contacts()
    )
    solver = solver(model)
    speeds = []
    for _ in range(steps):
        state.clear_forces()
        source.collide(state, contacts)
        solver.step(state, after, control, contacts, 0.005)
        state, after = after, state
        speeds.append(float(np.abs(state.body_qd.numpy()).max()))
    return state.body_q.numpy().copy(), speeds


def drift(setup: Any, poses: np.ndarray) -> float:
    return float(np.linalg.norm(poses[:, :3] - setup.positions[setup.fixed :], axis=1).max())


def xpbd(model: Any) -> Any:
    return newton.solvers.SolverXPBD(model, iterations=10)


def mujoco(model: Any) -> Any:
    return newton.solvers.SolverMuJoCo(model, use_mujoco_contacts=False, nconmax=2000, njmax=8000)


@pytest.mark.parametrize(("name", "margin"), [("tower", 0.0), ("arch", 0.0), ("tower", 0.002)])
def test_arrays_are_those_of_newton(client, name, margin):
    """Catches a point in the wrong frame, an offset of the wrong sign, a gap that is not added.

    With margins the cubes are apart by the margins of two, so that they just touch.
    """
    setup = scenes.SCENES[name]()
    setup.positions[1:, 2] += 2 * margin * np.arange(1, len(setup.positions))
    model = newton_models.builder(setup, margin=margin, gap=0.0015).finalize()
    state = model.state()
    own = newton.CollisionPipeline(model)
    theirs, ours = own.contacts(), inside.Pipeline(client, model).contacts()
    own.collide(state, theirs)
    m = inside.Pipeline(client, model).collide(state, ours)
    assert m is not None
    a, b = rows(theirs), rows(ours)
    assert len(a["normal"]) == len(b["normal"]) == {"tower": 40, "arch": 48}[name]
    first, second = by_place(a), by_place(b)
    for column in COLUMNS:
        difference = np.abs(a[column][first].astype(float) - b[column][second])
        assert difference.max() < 1e-6, column
    assert np.abs(b["offset0"]).max() == pytest.approx(margin, rel=1e-6)


def test_points_beyond_the_gaps_are_left_out(client):
    """Catches a gap that is taken for the pair's margin, and points filtered by pair."""
    for height in np.linspace(0.4, 0.52, 25):
        build = newton.ModelBuilder()
        config = newton.ModelBuilder.ShapeConfig(margin=0.003, gap=0.005)
        build.add_shape_box(
            -1,
            xform=wp.transform(wp.vec3(0, 0, -0.5), wp.quat_identity()),
            hx=3,
            hy=3,
            hz=0.5,
            cfg=config,
        )
        turn = wp.quat_from_axis_angle(wp.vec3(1, 0, 0), 0.005)
        body = build.add_body(xform=wp.transform(wp.vec3(0, 0, height), turn))
        build.add_shape_box(
            body,
            hx=0.5,
            hy=0.5,
            hz=0.5,
            cfg=newton.ModelBuilder.ShapeConfig(margin=0.001, gap=0.002),
        )
        model = build.finalize()
        pipeline = inside.Pipeline(client, model)
        contacts = pipeline.contacts()
        m = pipeline.collide(model.state(), contacts)
        kept = int(contacts.rigid_contact_count.numpy()[0])
        assert kept == np.count_nonzero(m.distance - 0.004 <= 0.007)
        low = height - 0.5 * np.cos(0.005) - 0.5 * np.sin(0.005)
        assert (kept > 0) == (low - 0.004 <= 0.007)


def random_model(rng: np.random.Generator, worlds: int) -> Any:
    """Overlapping boxes with random groups, filters, flags and bodies of several shapes."""

    def world(build: Any, local: bool) -> None:
        shapes = []
        for _ in range(int(rng.integers(2, 5))):
            body = build.add_body(
                xform=wp.transform(wp.vec3(*rng.normal(size=3) * 0.02), wp.quat_identity())
            )
            for _ in range(int(rng.integers(1, 3))):
                config = newton.ModelBuilder.ShapeConfig(
                    collision_group=int(rng.choice([-2, -1, 0, 1, 1, 2])),
                    has_shape_collision=bool(rng.random() < 0.9),
                )
                shapes.append(build.add_shape_box(body, hx=0.5, hy=0.5, hz=0.5, cfg=config))
        for a, b in itertools.combinations(shapes, 2):
            if rng.random() < 0.15:
                build.add_shape_collision_filter_pair(a, b)

    build = newton.ModelBuilder()
    build.add_shape_box(-1, hx=0.5, hy=0.5, hz=0.5)
    world(build, False)
    for _ in range(worlds):
        build.begin_world()
        world(build, True)
        build.end_world()
    return build.finalize()


@pytest.mark.parametrize("worlds", [0, 3])
def test_the_pairs_are_those_of_newton(client, worlds):
    """Catches each rule that is left out: worlds, groups, filters, flags, shapes of one body.

    All shapes overlap. Shapes of no world meet each other and those of every world.
    """
    rng = np.random.default_rng(9)
    met = left_out = both_global = 0
    for _ in range(20):
        model = random_model(rng, worlds)
        pairs = model.shape_contact_pairs
        expected = {tuple(sorted(pair)) for pair in pairs.numpy().tolist()}
        pipeline = inside.Pipeline(client, model)
        contacts = pipeline.contacts()
        pipeline.collide(model.state(), contacts)
        found = rows(contacts)
        ours = set(zip(found["shape0"].tolist(), found["shape1"].tolist(), strict=True))
        assert ours == expected
        met += len(expected)
        left_out += model.shape_count * (model.shape_count - 1) // 2 - len(expected)
        of_worlds = model.shape_world.numpy()
        both_global += sum(of_worlds[a] < 0 and of_worlds[b] < 0 for a, b in expected)
    assert met > 100
    assert left_out > 150
    assert both_global > 20


def test_generations_rise_and_matches_name_the_one_before(client):
    """Catches the pitfall of contacts that a solver takes for old ones, because no generation rose."""
    model = newton_models.builder(scenes.tower()).finalize()
    pipeline = inside.Pipeline(client, model, matching=True)
    contacts, other, state = pipeline.contacts(), pipeline.contacts(), model.state()

    def collided(into: Any) -> tuple[int, int, list[int]]:
        before = int(into.contact_generation.numpy()[0])
        pipeline.collide(state, into)
        now = int(into.contact_generation.numpy()[0])
        assert now == before + 1
        count = int(into.rigid_contact_count.numpy()[0])
        index = into.rigid_contact_match_index.numpy()[:count].tolist()
        return now, int(into.rigid_contact_match_generation.numpy()[0]), index

    first, reference, index = collided(contacts)
    assert (reference, set(index)) == (-1, {-1})
    second, reference, index = collided(contacts)
    assert (reference, index) == (first, list(range(40)))
    # Another buffer has no earlier contacts, and then the first one is not the latest.
    assert collided(other)[1] == -1
    assert collided(contacts)[1] == -1
    contacts.clear()  # as if another pipeline had filled it
    _, reference, index = collided(contacts)
    assert (reference, set(index)) == (-1, {-1})
    assert second == first + 1
    # A cube that moves up leaves its pairs; its neighbours keep their matches.
    poses = state.body_q.numpy()
    poses[9, 2] += 0.1
    state.body_q.assign(poses)
    _, _, index = collided(contacts)
    assert index == list(range(36))
    poses[9, 2] -= 0.1
    state.body_q.assign(poses)
    _, _, index = collided(contacts)
    assert index == [*range(36), *[-1] * 4]


def test_matches_are_those_of_a_dictionary():
    """Catches rows that are matched twice, or to the row of another pair."""
    rng = np.random.default_rng(1)
    counted = dict.fromkeys((-2, -1, 0), 0)
    for size in (0, 1, 5, 200):
        for _ in range(20):
            earlier = rng.integers(0, 4, (size, 6)).astype("<u4")
            later = np.concatenate(
                [earlier[: size // 2], rng.integers(0, 5, (size, 6)).astype("<u4")]
            )
            places: dict[tuple[int, ...], int] = {}
            for row, key in enumerate(map(tuple, earlier.tolist())):
                places.setdefault(key, row)
            pairs = {key[:2] for key in places}
            expected = []
            for key in map(tuple, later.tolist()):
                new = -2 if key[:2] in pairs else -1
                expected.append(places.pop(key, new))
            found = inside.match(earlier, later).tolist()
            assert found == expected
            for row in found:
                counted[min(row, 0)] += 1
    assert min(counted.values()) > 100


@pytest.mark.parametrize("shuffle", [None, 7])
def test_worlds_that_are_copies_agree_to_the_bit(client, shuffle):
    """Catches rows whose order depends on the other worlds, and points that do."""
    setup = scenes.tower()
    poses, _ = run(setup, client, xpbd, steps=40, copies=16, shuffle=shuffle)
    each = poses.reshape(16, 10, 7)
    assert all(world.tobytes() == each[0].tobytes() for world in each)
    alone, _ = run(setup, client, xpbd, steps=40, copies=1, shuffle=shuffle)
    assert alone.tobytes() == each[0].tobytes()
    assert 1e-4 < drift(setup, each[0]) < 0.1


def test_a_shuffle_changes_only_the_order(client):
    """Catches contacts that are lost or twice, and an order that differs from step to step."""
    model = newton_models.builder(scenes.arch()).finalize()
    found = []
    for seed in (None, 3, 3, 4):
        pipeline = inside.Pipeline(client, model, shuffle=seed)
        contacts = pipeline.contacts()
        pipeline.collide(model.state(), contacts)
        found.append(rows(contacts))
    order = [np.ascontiguousarray(columns["point0"]).tobytes() for columns in found]
    assert order[1] == order[2]
    assert len(set(order)) == 3
    for columns in found[1:]:
        for name in COLUMNS:
            one = sorted(map(repr, np.atleast_1d(columns[name]).tolist()))
            assert one == sorted(map(repr, found[0][name].tolist()))


@pytest.mark.parametrize("solver", [xpbd, mujoco], ids=["XPBD", "SolverMuJoCo"])
@pytest.mark.filterwarnings("ignore:MuJoCo dependency version mismatch")
def test_a_tower_drifts_as_with_newtons_own_contacts(client, solver):
    """The drift is within 1 %. Catches contacts that a solver reads in another way."""
    setup = scenes.tower()
    own, _ = run(setup, None, solver, steps=400)
    new, _ = run(setup, client, solver, steps=400)
    assert drift(setup, own) > 1e-3
    assert drift(setup, new) == pytest.approx(drift(setup, own), rel=0.01)


def test_matches_calm_vbd(client):
    """The solver starts from earlier forces. Catches indices that it cannot use."""
    setup = scenes.tower()

    def vbd(model: Any) -> Any:
        return newton.solvers.SolverVBD(model, iterations=10, rigid_contact_history=True)

    stiff = {"ke": 1e6, "kd": 1e4}
    jitter = []
    for matching in (True, False):
        _, speeds = run(setup, client, vbd, steps=400, options=stiff, matching=matching)
        jitter.append(float(np.mean(speeds[200:])))
    assert jitter[0] < 0.6 * jitter[1]


def test_shapes_are_those_of_newton(client):
    """Catches half lengths taken for lengths, another axis, and a scale that is left out.

    A probe rests on each shape, and is measured against the height of its top.
    """
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]], np.float32)
    mesh = newton.Mesh(points, np.array([0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3], np.int32))
    adders: list[tuple[Any, float]] = [
        (lambda b, o: b.add_shape_plane(body=o, width=0.0, length=0.0), 0.0),
        (lambda b, o: b.add_shape_plane(body=o, width=4.0, length=4.0), 0.0),
        (lambda b, o: b.add_shape_sphere(o, radius=0.7), 0.7),
        (lambda b, o: b.add_shape_capsule(o, radius=0.3, half_height=0.6), 0.9),
        (lambda b, o: b.add_shape_ellipsoid(o, rx=0.3, ry=0.4, rz=0.6), 0.6),
        (lambda b, o: b.add_shape_cylinder(o, radius=0.3, half_height=0.6), 0.6),
        (lambda b, o: b.add_shape_cone(o, radius=0.3, half_height=0.6), 0.6),
        (lambda b, o: b.add_shape_box(o, hx=0.3, hy=0.4, hz=0.5), 0.5),
        (lambda b, o: b.add_shape_convex_hull(o, mesh=mesh, scale=wp.vec3(1, 1, 2)), 2.0),
        (lambda b, o: b.add_shape_mesh(o, mesh=mesh, scale=wp.vec3(1, 1, 3)), 3.0),
    ]
    for add, top in adders:
        build = newton.ModelBuilder()
        add(build, -1)
        place = wp.transform(wp.vec3(0, 0, top + 0.5 - 0.01), wp.quat_identity())
        build.add_shape_box(build.add_body(xform=place), hx=1, hy=1, hz=0.5)
        model = build.finalize()
        pipeline = inside.Pipeline(client, model)
        contacts = pipeline.contacts()
        m = pipeline.collide(model.state(), contacts)
        name = model.shape_label[0] if hasattr(model, "shape_label") else top
        assert int(contacts.rigid_contact_count.numpy()[0]) > 0, name
        assert m.distance.min() == pytest.approx(-0.01, abs=1e-6 if top in (0, 0.5) else 2e-3), name


def test_a_mesh_that_is_not_convex_warns(client):
    box = np.array(list(itertools.product((0.0, 1.0), repeat=3)), np.float32)
    points = np.concatenate([box, [[0.5, 0.5, 0.3]]]).astype(np.float32)
    faces = [
        0,
        2,
        4,
        4,
        2,
        6,
        0,
        1,
        2,
        1,
        3,
        2,
        4,
        6,
        5,
        5,
        6,
        7,
        0,
        4,
        1,
        1,
        4,
        5,
        2,
        3,
        6,
        3,
        7,
        6,
    ]
    top = [1, 5, 8, 5, 7, 8, 7, 3, 8, 3, 1, 8]
    mesh = newton.Mesh(points, np.array([*faces, *top], np.int32))
    build = newton.ModelBuilder()
    build.add_shape_mesh(-1, mesh=mesh)
    build.add_shape_box(build.add_body(), hx=1, hy=1, hz=1)
    with pytest.warns(hullcast.NotConvexWarning, match="shape 0 .*is not convex"):
        inside.Pipeline(client, build.finalize())


def test_a_model_in_which_nothing_meets(client):
    """Catches a failure where there is no shape, no body, or no pair."""
    build = newton.ModelBuilder()
    build.add_ground_plane()
    model = build.finalize()
    pipeline = inside.Pipeline(client, model)
    contacts = newton.Contacts(4, 0)
    assert pipeline.collide(model.state(), contacts) is None
    assert int(contacts.rigid_contact_count.numpy()[0]) == 0
    assert int(contacts.contact_generation.numpy()[0]) == 1
    assert repr(pipeline) == "Pipeline(0 shapes)"


def test_arguments_of_the_pipeline(client):
    """Each wrong value is named, with what is allowed."""
    model = newton_models.builder(scenes.tower()).finalize()
    state = model.state()
    pipeline = inside.Pipeline(client, model)
    contacts = pipeline.contacts()
    make = inside.Pipeline
    for call, says in [
        (lambda: make(None, model), "client: expected a hullcast.Client, got None"),
        (lambda: make(client, state), "model: expected a newton.Model, got State"),
        (lambda: make(client, model, matching=1), "matching: got 1, expected True or False"),
        (lambda: make(client, model, shuffle=-1), "shuffle: got -1, expected an integer, 0 to"),
        (lambda: make(client, model, shuffle=0.5), "shuffle: got 0.5, expected an integer"),
        (lambda: make(client, model, accuracy="x"), "accuracy: expected a hullcast.Accuracy"),
        (lambda: make(client, model, rigid_contact_max=0), "rigid_contact_max: got 0, expected"),
        (lambda: make(client, model, plane_size=0), "plane_size: got 0, expected a number, 0.001"),
        (lambda: make(client, model, plane_size="x"), "plane_size: got 'x', expected a number"),
        (lambda: pipeline.collide(None, contacts), "state: expected a newton.State, got None"),
        (lambda: pipeline.collide(state, model), "contacts: expected a newton.Contacts, got Model"),
        (lambda: make(client, model, matching=True).collide(state, contacts), "contacts: it has no match indices"),
        (lambda: pipeline.collide(newton.ModelBuilder().finalize().state(), contacts), "state: got a state of 0 bodies, .* 10"),
        (lambda: pipeline.collide(state, newton.Contacts(39, 0)), "contacts: there are 40 contacts, .* room for 39"),
    ]:  # fmt: skip
        with pytest.raises(hullcast.InvalidArgument, match=says):
            call()
    pipeline.collide(state, newton.Contacts(40, 0))
    with pytest.raises(AttributeError, match=r"make another hullcast\.newton\.Pipeline"):
        pipeline.model = model
    build = newton.ModelBuilder()
    build.add_shape_cylinder(-1, radius=0.3, half_height=0.6, barrel_radius=5.0)
    build.add_shape_box(build.add_body(), hx=1, hy=1, hz=1)
    with pytest.raises(hullcast.InvalidArgument, match=r"model: shape 0 .* is a barrel, expected"):
        make(client, build.finalize())


def test_poses_that_are_not_finite_are_named(client):
    model = newton_models.builder(scenes.tower()).finalize()
    pipeline = inside.Pipeline(client, model)
    state = model.state()
    poses = state.body_q.numpy()
    poses[3, 0] = np.nan
    state.body_q.assign(poses)
    with pytest.raises(hullcast.InvalidPoses, match="body 4"):
        pipeline.collide(state, pipeline.contacts())


def test_newton_is_named_where_it_is_missing(client, monkeypatch):
    """Also catches a version whose arrays mean something else."""
    monkeypatch.setattr(newton, "__version__", "1.9.0")
    with pytest.raises(ImportError, match=r"needs newton 1\.8\.\*, and 1\.9\.0 is installed"):
        inside.Pipeline(client, None)
    monkeypatch.setitem(sys.modules, "newton", None)
    with pytest.raises(ImportError, match=r"needs newton: pip install './client\[newton\]'"):
        inside.Pipeline(client, None)
