"""Compares every result with the exact solution, over families of shapes and regimes.

These tests catch wrong results of any kind: a bracket that misses the exact growth scale, a normal
that is not optimal, a false contact, a point off its hull, an overlap without points. The counts at
the end assert that the sweeps met the intended cases.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from cases import REGIMES, Case, ask, regime_cases
from checks import Budget, Coverage, Hulls, check, check_growth, check_normal, check_outcome
from oracle import dot
from shapes import FAMILIES, box, family, prism

import hullcast
from hullcast import Flag, Outcome

OUTPUTS = ("ALPHA", "NORMAL", "POINTS", "WITNESS_B", "FEATURES", "BASES", "DIAGNOSTICS")
SOLVERS = ("PORTAL", "GJK_RAY_CAST")
PAIRS = {"poly64": 12}
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def check_all(client, get_hulls, cases: list[Case], **accuracy) -> Coverage:
    """Queries every case with both solvers, and checks every result."""
    coverage = Coverage()
    faces: Hulls = get_hulls(list({hull for case in cases for hull in case.hulls}))
    for margin, group in itertools.groupby(cases, key=lambda case: case.margin):
        group = list(group)
        for solver in SOLVERS:
            m = ask(
                client,
                group,
                margin=margin,
                outputs=OUTPUTS,
                accuracy=hullcast.Accuracy(solver=solver, **accuracy),
            )
            for case, pair in zip(group, m, strict=True):
                check(case, pair, faces, accuracy.get("relative_tolerance", 0.0))
                coverage.note(pair)
    return coverage


@pytest.fixture(scope="module")
def shapes(client):
    """Some shapes of each family, with their hulls."""
    rng = np.random.default_rng(11)
    made = {name: family(name, 6, rng) for name in FAMILIES}
    made["mixed"] = [shape for shapes in made.values() for shape in shapes[:2]]
    return {
        name: (list_, client.register([shape.vertices for shape in list_]))
        for name, list_ in made.items()
    }


@pytest.mark.parametrize("name", [*FAMILIES, "mixed"])
@pytest.mark.parametrize("regime", REGIMES)
def test_families_and_regimes(client, get_hulls, shapes, name, regime):
    """Random pairs of each family in each regime, with both solvers."""
    rng = np.random.default_rng(
        [FAMILIES.index(name) if name in FAMILIES else 99, REGIMES.index(regime)]
    )
    count = PAIRS.get(name, 24)
    cases = regime_cases(regime, rng, *shapes[name], count)
    covered = check_all(client, get_hulls, cases).counts
    assert covered.total() >= 2 * count
    if regime in ("deep", "shallow", "separated", "resting"):
        assert covered["CONTACT"] == 2 * count
    if regime == "near":
        assert covered["CONTACT"] >= count / 4
        assert covered["SEPARATED"] >= count / 4
    if regime == "resting" and name in ("box", "prism"):
        assert covered["face-face"] >= 1.8 * count
        assert covered["many points"] >= 1.8 * count


def test_every_kind_of_contact(client, get_hulls, shapes):
    """Faces, edges and vertices touch each other in all combinations; some points are estimated.

    The default feature angle is small, so random orientations also meet edges and vertices.
    """
    rng = np.random.default_rng(12)
    cases = regime_cases("shallow", rng, *shapes["mixed"], 150)
    cases += regime_cases("deep", rng, *shapes["mixed"], 60)
    cases += regime_cases("resting", rng, *shapes["mixed"], 40)
    covered = check_all(client, get_hulls, cases).counts
    cases = regime_cases("separated", rng, *shapes["tetra"], 60)
    covered += check_all(client, get_hulls, cases, feature_angle=0.4).counts
    for kind, least in {
        "face-face": 40,
        "edge-face": 10,
        "face-vertex": 100,
        "edge-edge": 80,
        "ESTIMATED": 20,
    }.items():
        assert covered[kind] >= least, covered
    assert covered["CONTACT"] == 2 * 310


def aligned(client, pairs) -> list[Case]:
    """Cases of upright shapes, from tuples (shape a, shape b, d)."""
    unique = list({id(s): s for a, b, _ in pairs for s in (a, b)}.values())
    hulls = dict(
        zip(
            map(id, unique),
            client.register(
                [s.vertices for s in unique], contraction_points=[(0.0, 0.0, 0.0)] * len(unique)
            ),
            strict=True,
        )
    )
    return [
        Case(
            (a, b),
            (hulls[id(a)], hulls[id(b)]),
            np.array([(0.0, 0.0, 0.0), d]),
            np.array([UPRIGHT, UPRIGHT]),
        )
        for a, b, d in pairs
    ]


def test_integer_boxes_tie(client, get_hulls):
    """Boxes with integer sides at integer offsets, where the ray meets edges and corners of K.

    If several normals are optimal, a pivot without a rule for ties cycles or finds no exit edge.
    Exact touching depends on the last bit.
    """
    rng = np.random.default_rng(13)
    boxes = [box(half) for half in itertools.product((1, 2, 3), (1, 2), (1, 3))]
    pairs = [
        (*(boxes[i] for i in rng.integers(len(boxes), size=2)), rng.integers(-4, 5, size=3))
        for _ in range(200)
    ]
    cases = aligned(client, pairs)
    covered = check_all(client, get_hulls, cases).counts
    halves = [np.abs(a.vertices[0]) + np.abs(b.vertices[0]) for a, b, _ in pairs]
    ratios = [np.sort(np.abs(d) / h) for h, (_, _, d) in zip(halves, pairs, strict=True)]
    assert sum(r[-1] == r[-2] > 0 for r in ratios) >= 30
    assert sum(r[-1] == 1 for r in ratios) >= 20
    assert covered["SEPARATED"] >= 40
    assert covered["CONTACT"] >= 200


def test_prisms_and_diagonals_tie(client, get_hulls):
    """Cubes along (1,1,1) and (1,1,0), and equal prisms along their axis, at several scales."""
    cube, six = box((0.5, 0.5, 0.5)), prism(6, 0.5, 0.5)
    offsets = [(1, 1, 1), (1, 1, 0), (1, 0, 0), (-1, 1, -1), (0, 0, 1), (1, -1, 1e-9)]
    pairs = [
        (a, b, np.array(d) * scale)
        for (a, b), d, scale in itertools.product(
            [(cube, cube), (six, six), (cube, six)], offsets, (1e-3, 0.25, 0.5, 0.75, 0.999, 1.0)
        )
    ]
    covered = check_all(client, get_hulls, aligned(client, pairs)).counts
    assert covered["CONTACT"] >= 150


def test_identical_poses_are_coincident(client, get_hulls):
    """Identical poses give alpha 0, a unit normal, points and COINCIDENT; at 1e-290 they do not."""
    shapes = [box((0.5, 0.25, 1)), prism(5, 0.5, 0.5)]
    cases = aligned(client, [(s, s, (0.0, 0.0, 0.0)) for s in shapes])
    for pair in ask(client, cases, outputs=OUTPUTS):
        assert pair.outcome == Outcome.CONTACT
        assert pair.flags & Flag.COINCIDENT
        assert pair.alpha == pair.alpha_lower == 0
        assert abs(np.linalg.norm(pair.normal) - 1) < 1e-15
        assert len(pair.distance) >= 1
        assert pair.separation < 0
    cases = aligned(client, [(s, s, (1e-290, 2e-290, 0.0)) for s in shapes])
    faces = get_hulls([hull for case in cases for hull in case.hulls])
    for case, pair in zip(cases, ask(client, cases, outputs=OUTPUTS), strict=True):
        assert not pair.flags & Flag.COINCIDENT
        check(case, pair, faces)


def test_loose_tolerance_is_still_certified(client, get_hulls, shapes):
    """The bracket is at most as wide as requested, and contains the exact value."""
    rng = np.random.default_rng(14)
    for tolerance in (1e-6, 1e-2, 0.5):
        cases = regime_cases("shallow", rng, *shapes["mixed"], 20)
        check_all(client, get_hulls, cases, relative_tolerance=tolerance)


def test_bracket_of_plates_and_needles(client):
    """For aspect ratios to 1e6 the budget, which grows with R/r, still holds or is flagged."""
    rng = np.random.default_rng(15)
    aspects = (1e-2, 1e-4, 1e-6)
    flat = [box((1, 0.7, aspect)) for aspect in aspects]
    thin = [box((aspect, aspect, 1)) for aspect in aspects]
    everything = [*flat, *thin]
    hulls = client.register([shape.vertices for shape in everything])
    cases = regime_cases("shallow", rng, everything, hulls, 80)
    flagged = 0
    for solver in SOLVERS:
        m = ask(client, cases, outputs=OUTPUTS, accuracy=hullcast.Accuracy(solver=solver))
        for case, pair in zip(cases, m, strict=True):
            budget = Budget(case)
            check_outcome(case, pair, budget)
            if pair.flags & Flag.GAP_OPEN:
                flagged += 1
                continue
            check_growth(case, pair, budget)
            check_normal(case, pair, budget)
            assert len(pair.distance) >= 1
    assert flagged <= 4


@pytest.mark.parametrize("offset", [1e3, 1e6, 1e9, 1e12])
def test_far_from_the_origin(client, get_hulls, shapes, offset):
    """The error of alpha does not grow with the distance from the world's origin."""
    rng = np.random.default_rng(16)
    made = regime_cases("shallow", rng, *shapes["mixed"], 20)
    place = offset * np.array([1.0, -0.5, 0.25])
    far = []
    for case in made:
        positions = case.positions - case.positions[0] + place
        far.append(Case(case.shapes, case.hulls, positions, case.rotations, case.margin))
    assert any(dot(case.exact.d, case.exact.d) for case in far)
    check_all(client, get_hulls, far)


def test_scaling_by_a_power_of_two_changes_no_bit(client):
    """All tolerances are relative, so alpha, its bracket and the normal have the same bits."""
    rng = np.random.default_rng(17)
    shape_list = family("poly16", 2, rng) + family("box", 2, rng)
    answers = []
    for power in (0, -60, -7, 60):
        hulls = client.register([np.ldexp(shape.vertices, power) for shape in shape_list])
        rng = np.random.default_rng(18)
        positions = np.ldexp(rng.normal(size=(40, 3)), power)
        rotations = rng.normal(size=(40, 4))
        rotations /= np.linalg.norm(rotations, axis=1, keepdims=True)
        scene = hullcast.Scene(hulls, positions, rotations, body_hulls=np.arange(40) % 4)
        m = client.query(scene, np.arange(40).reshape(-1, 2), margin=np.inf)
        answers.append((m.alpha, m.alpha_lower, m.alpha_upper, m.normal, m.point_counts))
        answers[-1] += (np.ldexp(m.separation, -power),)
    for other in answers[1:]:
        for ours, theirs in zip(answers[0], other, strict=True):
            assert (ours == theirs).all()
