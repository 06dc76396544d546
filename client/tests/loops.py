"""Random simulations, whose steps are compared with `find` of the same scene."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import matching
import numpy as np
from crowds import CUBE, EVERYTHING
from shapes import family

import hullcast

OUTPUTS = (*EVERYTHING, "MATCHES")
MARGIN = 0.05
#: The largest share of pairs that may differ in the last digits, because the solver of a session starts
#: from the basis of the step before.
MOST_BITS = 0.5
#: The columns that `find` has too, without those that say how the solver worked.
SAME = (
    "outcome", "flags", "alpha", "alpha_lower", "alpha_upper", "normal", "separation",
    "point_counts", "feature_kinds", "feature_indices", "kept_area",
)  # fmt: skip
SAME_POINTS = ("witness_a", "witness_b", "distance", "point_ids")


class Bodies(NamedTuple):
    """The bodies of a simulation."""

    positions: np.ndarray
    rotations: np.ndarray
    hulls: np.ndarray
    worlds: np.ndarray
    groups: np.ndarray

    def scene(self, hulls: Sequence[Any]) -> hullcast.Scene:
        return hullcast.Scene(
            hulls,
            self.positions,
            self.rotations,
            body_hulls=self.hulls,
            worlds=self.worlds,
            groups=self.groups,
            ignored_groups=[[1, 2]],
        )

    def taken(self, rows: np.ndarray) -> Bodies:
        return Bodies(*(column[rows] for column in self))

    def joined(self, more: Bodies) -> Bodies:
        return Bodies(*map(np.concatenate, zip(self, more, strict=True)))


def some(rng: np.random.Generator, count: int, kinds: int, side: float = 2.6) -> Bodies:
    """Bodies at random poses. Many lie on a grid, such that faces touch."""
    positions, rotations = rng.uniform(0, side, (count, 3)), rng.normal(size=(count, 4))
    flat = rng.random(count) < 0.5
    rotations[flat] = [0, 0, 0, 1]
    positions[flat, 2] = rng.integers(0, 3, size=np.count_nonzero(flat)) * 0.9
    rotations /= np.linalg.norm(rotations, axis=1, keepdims=True)
    worlds = rng.integers(1, 3, size=count)
    worlds[rng.random(count) < 0.1] = 2**32 - 1
    return Bodies(
        positions, rotations, rng.integers(kinds, size=count), worlds, rng.integers(4, size=count)
    )


def shaken(rng: np.random.Generator, bodies: Bodies, rows: np.ndarray, by: float) -> Bodies:
    """The bodies after a small motion of some of them."""
    positions, rotations = bodies.positions.copy(), bodies.rotations.copy()
    positions[rows] += rng.normal(0, by, (len(rows), 3))
    rotations[rows] += rng.normal(0, by, (len(rows), 4))
    rotations[rows] /= np.linalg.norm(rotations[rows], axis=1, keepdims=True)
    return bodies._replace(positions=positions, rotations=rotations)


def shapes() -> list[np.ndarray]:
    rng = np.random.default_rng(41)
    found = [shape.vertices for shape in family("box", 2, rng) + family("poly16", 2, rng)]
    return [*found, hullcast.cylinder(0.4, 0.5).vertices, CUBE]


class Difference(NamedTuple):
    """How many pairs of a session's answer differ from those of `find`."""

    #: Pairs of which some bit differs, because the solver started elsewhere.
    bits: int
    #: Pairs with another normal or other points: at a tie several are right.
    ties: int


def difference(found: hullcast.Manifolds, expected: hullcast.Manifolds) -> Difference:
    """Compares an answer with that of `find`.

    The pairs, bodies and outcomes must be the same, and the growth scales equal to rounding.
    """
    for name in ("pairs", "outcome", "invalid_bodies", "missing_hulls"):
        assert getattr(found, name).tobytes() == getattr(expected, name).tobytes(), name
    assert found.scene is not None
    assert expected.scene is not None
    assert found.scene.positions.tobytes() == expected.scene.positions.tobytes()
    assert (np.abs(found.alpha - expected.alpha) <= 1e-13 * expected.alpha + 1e-300).all()
    different = other_bits(found, expected)
    ties = 0
    for i in different:
        a, b = (m[i : i + 1] for m in (found, expected))
        is_same = a.point_ids.tolist() == b.point_ids.tolist() and all(
            np.allclose(getattr(a, name), getattr(b, name), rtol=0, atol=1e-12)
            for name in ("normal", "separation", "witness_a", "distance")
        )
        ties += not is_same
    return Difference(len(different), ties)


def other_bits(found: hullcast.Manifolds, expected: hullcast.Manifolds) -> np.ndarray:
    """The rows of which some bit differs."""

    def differ(name: str) -> np.ndarray:
        a, b = (np.ascontiguousarray(getattr(m, name)) for m in (found, expected))
        rows = [column.view("u1").reshape(len(column), -1) for column in (a, b)]
        return (rows[0] != rows[1]).any(axis=1)

    if len(found) == 0:
        return np.zeros(0, dtype=int)
    if found.point_counts.tobytes() != expected.point_counts.tobytes():
        return np.arange(len(found))
    rows = np.any([differ(name) for name in SAME], axis=0)
    if len(found.distance):
        points = np.any([differ(name) for name in SAME_POINTS], axis=0)
        rows[np.repeat(np.arange(len(found)), found.point_counts)[points]] = True
    return np.flatnonzero(rows)


def expect_few(difference: Difference, pairs: int) -> None:
    """Asserts that nearly all pairs are equal to rounding, and most of them to the bit."""
    assert difference.ties <= 0.01 * pairs, difference
    assert difference.bits <= MOST_BITS * pairs, difference


def expect_matches(
    before: hullcast.Manifolds,
    found: hullcast.Manifolds,
    previous: Sequence[int] | None,
    radii: Sequence[float] | None = None,
) -> Counter[str]:
    """Compares the matches with those by plain loops, and with `hullcast.match`.

    `radii` are those of the scene's hulls, if the scene has a hull only by its id.
    """
    assert found.scene is not None
    of_hulls = found.scene.radii if radii is None else radii
    of_bodies = [of_hulls[hull] for hull in found.scene.body_hulls]
    expected = matching.matches(before, found, of_bodies, previous)
    answers = [found]
    if radii is None:
        answers.append(hullcast.match(before, found, previous=previous))
    for answer in answers:
        assert answer.previous_pairs.tolist() == expected.pairs
        assert answer.previous_points.tolist() == expected.points
        assert answer.ended_pairs.tolist() == expected.ended
    return Counter(
        {
            "pairs that stayed": int(np.count_nonzero(found.previous_pairs >= 0)),
            "pairs that ended": len(expected.ended),
            "points by id": expected.by_id,
            "points by distance": expected.by_distance,
            "new points": expected.new,
        }
    )


#: What happens before a step, and how often of a hundred.
EVENTS = {"all move": 30, "some move": 25, "named ones move": 10, "none moves": 10, "teleport": 5,
          "come and go": 12, "begin anew": 3, "no pose": 5}  # fmt: skip


class Loop:
    """A random simulation, each of whose steps is compared with `find`.

    With `guest`, one more hull is known to the scenes only by its id. The client cannot register it
    again, so its bodies are in no pair while the servers lack it.
    """

    def __init__(
        self,
        client: hullcast.Client,
        seed: int,
        bodies: int = 14,
        guest: hullcast.Hull | None = None,
    ) -> None:
        self.client = client
        self.rng = np.random.default_rng(seed)
        self.hulls: list[Any] = list(client.register(shapes()))
        self.radii: list[float] | None = None
        if guest is not None:
            self.radii = [hull.circumradius for hull in (*self.hulls, guest)]
            self.hulls.append(guest.id)
        self.bodies = some(self.rng, bodies, len(self.hulls))
        scene = self.bodies.scene(self.hulls)
        options: Any = {"margin": MARGIN, "outputs": OUTPUTS, "on_invalid": "flag"}
        self.session = client.session(scene, find=True, **options)
        self.before: hullcast.Manifolds | None = None
        self.seen: Counter[str] = Counter()

    def step(self, reference: hullcast.Client, *, restarts: bool = False) -> hullcast.Manifolds:
        """Makes a random step; `restarts` says that the server was lost since the last one."""
        rng, bodies = self.rng, self.bodies
        event = str(rng.choice(list(EVENTS), p=np.array(list(EVENTS.values())) / 100))
        previous: list[int] | None = None
        call: Callable[[], hullcast.Manifolds]
        if event in ("come and go", "begin anew"):
            kept = rng.permutation(np.flatnonzero(rng.random(len(bodies.hulls)) < 0.85))
            new = some(rng, int(rng.integers(5)), len(self.hulls))
            bodies = bodies.taken(kept).joined(new)
            if len(kept) and rng.random() < 0.2:  # a body gets another hull
                bodies.hulls[0] = (bodies.hulls[0] + 1) % len(self.hulls)
            previous = [*kept.tolist(), *[-1] * len(new.hulls)] if event == "come and go" else None
            scene, given = bodies.scene(self.hulls), previous
            call = lambda: self.session.update(scene, previous=given)  # noqa: E731
        else:
            count = len(bodies.hulls)
            rows = np.flatnonzero(rng.random(count) < (1.0 if event == "all move" else 0.2))
            if event == "none moves":
                rows = rows[:0]
            bodies = shaken(rng, bodies, rows, 10 ** rng.uniform(-4, -1.3))
            if event in ("teleport", "no pose") and count:
                bodies.positions[0] = np.nan if event == "no pose" else rng.uniform(0, 2.6, 3)
            at, turns = bodies.positions, bodies.rotations
            call = lambda: self.session.step(at, turns)  # noqa: E731
            if event == "named ones move":
                call = lambda: self.session.step(at[rows], turns[rows], moved=rows)  # noqa: E731
        self.bodies = bodies
        found = call()
        scene = bodies.scene(self.hulls)
        options: Any = {"margin": MARGIN, "outputs": EVERYTHING, "on_invalid": "flag"}
        expected = reference.find(scene, **options)
        self.seen["steps"] += 1
        self.seen[event] += 1
        self.seen["pairs"] += len(found)
        bits, ties = difference(found, expected)
        self.seen["pairs that differ"] += bits
        self.seen["ties"] += ties
        anew = self.before is None or event == "begin anew" or restarts
        assert found.restarted == anew
        if anew:
            assert (found.previous_pairs == -1).all()
            assert (found.previous_points == -1).all()
            assert len(found.ended_pairs) == 0
        else:
            assert self.before is not None
            self.seen += expect_matches(self.before, found, previous, self.radii)
        if len(found.missing_hulls):
            self.seen["steps without a hull"] += 1
        self.before = found
        return found


def expect_seen(seen: Counter[str], steps: int) -> None:
    """Asserts that a sweep had every case, and that few pairs depend on their start."""
    assert seen["steps"] == steps
    for event, share in EVENTS.items():
        assert seen[event] > share * steps / 400, seen
    for name in ("pairs that stayed", "pairs that ended", "points by id", "new points"):
        assert seen[name] > steps / 20, seen
    assert seen["points by distance"] > steps / 80, seen
    expect_few(Difference(seen["pairs that differ"], seen["ties"]), seen["pairs"])
