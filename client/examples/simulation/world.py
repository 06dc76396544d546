"""A small rigid body simulator: projected Gauss-Seidel on the contacts that a server finds.

Semi-implicit Euler; velocity constraints with Baumgarte stabilisation, whose velocity is
taken away again by half as many sweeps after the step; Coulomb
friction in two tangents, each bounded by the normal impulse; impulses started from
those of the same points (by their ids) a step before. Pairs of bodies are coloured
so that pairs of one colour share no moving body and are solved together by numpy:
the order of a Gauss-Seidel sweep, at the speed of arrays.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

import hullcast

GRAVITY = np.array([0, 0, -9.81])
#: Of the depth beyond the slop, taken back in a step.
BAUMGARTE = 0.2
#: Depth that is left alone, metres.
SLOP = 1e-3
MARGIN = 0.01
#: A point nearer than this to one of a step before may be the same, metres.
NEAR = 0.02


@dataclass
class Step:
    """What a step cost and found."""

    contacts: int
    pairs: int
    depth: float
    seconds_contacts: float
    seconds_solver: float


@dataclass
class World:
    """Bodies with their state; the first `fixed` of them do not move.

    `shapes` are points (k, 3) about each body's centre of mass.
    """

    client: hullcast.Client
    shapes: Sequence[np.ndarray]
    positions: np.ndarray
    rotations: np.ndarray
    fixed: int
    density: float = 1000.0
    friction: float = 0.6
    dt: float = 1 / 100
    iterations: int = 10
    accuracy: hullcast.Accuracy = field(default_factory=hullcast.Accuracy)
    max_deviation: float | None = None

    def __post_init__(self) -> None:
        whole = self.client.register(self.shapes)
        self.hulls = whole
        if self.max_deviation is not None:
            # Masses stay those of the whole hulls.
            centers = [hull.contraction_point for hull in whole]
            self.hulls = self.client.register(
                self.shapes, contraction_points=centers, max_deviation=self.max_deviation
            )
        count = len(whole)
        moves = np.arange(count) >= self.fixed
        masses = self.density * np.array([hull.volume for hull in whole])
        inertia = self.density * np.array([hull.inertia for hull in whole])
        self.masses = masses
        self.inverse_mass = np.where(moves, 1 / masses, 0.0)
        self.inverse_inertia = np.linalg.inv(inertia) * moves[:, None, None]
        self.inertia = inertia
        #: (n, 6): linear, angular.
        self.velocities = np.zeros((count, 6))
        self.scene = hullcast.Scene(self.hulls, self.positions, self.rotations, groups=None)
        self._before: tuple[np.ndarray, ...] | None = None

    def step(self) -> Step:
        """Goes on by `dt`."""
        moving = self.inverse_mass > 0
        self.velocities[moving, :3] += self.dt * GRAVITY
        begin = time.perf_counter()
        self.scene = self.scene.moved(self.positions, self.rotations)
        m = self.client.find(
            self.scene,
            margin=MARGIN,
            accuracy=self.accuracy,
            outputs=["NORMAL", "POINTS", "FEATURES"],
        )
        middle = time.perf_counter()
        alive = (self.inverse_mass[m.pairs] > 0).any(axis=1)
        m = m[alive]
        self._solve(m)
        end = time.perf_counter()
        depth = float(-m.distance.min()) if len(m.distance) else 0.0
        return Step(len(m.distance), len(m), max(depth, 0.0), middle - begin, end - middle)

    def kinetic_energy(self) -> float:
        """Of all moving bodies, joules."""
        turned = matrices(self.rotations)
        inertia = turned @ self.inertia @ turned.transpose(0, 2, 1)
        linear, angular = self.velocities[:, :3], self.velocities[:, 3:]
        spin = np.einsum("ni,nij,nj->n", angular, inertia, angular)
        energy = 0.5 * (self.masses * (linear**2).sum(axis=1) + spin)
        return float(energy[self.fixed :].sum())

    def _move(self) -> None:
        self.positions = self.positions + self.dt * self.velocities[:, :3]
        x, y, z, w = self.rotations.T
        wx, wy, wz = 0.5 * self.dt * self.velocities[:, 3:].T
        change = np.stack(
            [
                wx * w + wy * z - wz * y,
                wy * w + wz * x - wx * z,
                wz * w + wx * y - wy * x,
                -wx * x - wy * y - wz * z,
            ],
            axis=1,
        )
        rotations = self.rotations + change
        self.rotations = rotations / np.linalg.norm(rotations, axis=1, keepdims=True)

    def _solve(self, m: hullcast.Manifolds) -> None:
        """Impulses that keep the points apart, Gauss-Seidel sweep after sweep."""
        count = len(m.distance)
        if count == 0:
            self._before = None
            self._move()
            return
        of = np.repeat(np.arange(len(m)), m.point_counts)
        a, b = m.pairs[of].astype(np.intp).T
        normal = m.normal[of]
        point = m.witness_a + 0.5 * m.distance[:, None] * normal
        helper = np.where(np.abs(normal[:, :1]) < 0.6, [[1.0, 0, 0]], [[0, 1.0, 0]])
        first = np.cross(normal, helper)
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        axes = np.stack([normal, first, np.cross(normal, first)], axis=1)
        turned = matrices(self.rotations)
        inverse = turned @ self.inverse_inertia @ turned.transpose(0, 2, 1)

        def half(body: np.ndarray, sign: float) -> tuple[np.ndarray, np.ndarray]:
            arm = point - self.positions[body]
            spin = np.cross(arm[:, None, :], axes)
            jacobian = sign * np.concatenate([axes, spin], axis=2)
            change = jacobian.copy()
            change[:, :, :3] *= self.inverse_mass[body][:, None, None]
            change[:, :, 3:] = jacobian[:, :, 3:] @ inverse[body]
            return jacobian, change

        (ja, ca), (jb, cb) = half(a, -1.0), half(b, 1.0)
        mass = 1 / ((ja * ca).sum(axis=2) + (jb * cb).sum(axis=2))
        gap = m.distance
        # Apart: may close the gap; deeper than the slop: opens a share of it.
        bias = np.where(gap > 0, -gap, BAUMGARTE * np.maximum(-gap - SLOP, 0)) / self.dt
        impulse = self._remembered(m.pairs[of], m.point_ids, point)
        v = self.velocities
        np.add.at(v, a, (impulse[:, :, None] * ca).sum(axis=1))
        np.add.at(v, b, (impulse[:, :, None] * cb).sum(axis=1))
        groups = [
            (i, a[i], b[i], ja[i], jb[i], ca[i], cb[i], mass[i])
            for i in coloured(m.pairs, m.point_counts.astype(np.intp), self.inverse_mass)
        ]
        for _ in range(self.iterations):
            self._sweep(groups, impulse, bias)
        self._move()
        # What was pushed apart keeps no velocity from that.
        for _ in range(max(1, self.iterations // 2)):
            self._sweep(groups, impulse, np.minimum(bias, 0))
        self._before = (m.pairs[of], m.point_ids, point, impulse)

    def _sweep(self, groups: list, impulse: np.ndarray, bias: np.ndarray) -> None:
        """Once through all points: friction, then the normal."""
        v = self.velocities
        for i, at_a, at_b, ja, jb, ca, cb, mass in groups:
            va, vb = v[at_a], v[at_b]
            now = impulse[i]
            for row in (1, 2, 0):
                along = (ja[:, row] * va).sum(axis=1) + (jb[:, row] * vb).sum(axis=1)
                if row == 0:
                    new = np.maximum(now[:, 0] + mass[:, 0] * (bias[i] - along), 0)
                else:
                    most = self.friction * now[:, 0]
                    new = np.clip(now[:, row] - mass[:, row] * along, -most, most)
                by = (new - now[:, row])[:, None]
                now[:, row] = new
                va += by * ca[:, row]
                vb += by * cb[:, row]
            impulse[i] = now
            v[at_a], v[at_b] = va, vb

    def _remembered(self, pairs: np.ndarray, ids: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Of each point the impulse that it had a step before: by its id, or else, where the
        features that make it have changed, that of the nearest point of the same pair."""
        impulse = np.zeros((len(points), 3))
        if self._before is None:
            return impulse
        old_pairs, old_ids, old_points, old_impulse = self._before
        same_id, old_id = (
            np.ascontiguousarray(np.concatenate(two, axis=1)).view("V24").ravel()
            for two in ((pairs, ids), (old_pairs, old_ids))
        )
        known = {key: i for i, key in enumerate(old_id.tolist())}
        taken = np.array([known.get(key, -1) for key in same_id.tolist()])
        of_pair: dict[tuple[int, int], list[int]] = {}
        for i, (a, b) in enumerate(old_pairs.tolist()):
            of_pair.setdefault((a, b), []).append(i)
        free = set(range(len(old_points))) - set(taken.tolist())
        for i in np.flatnonzero(taken < 0).tolist():
            near = [j for j in of_pair.get(tuple(pairs[i].tolist()), []) if j in free]
            if near:
                far = np.linalg.norm(old_points[near] - points[i], axis=1)
                if far.min() < NEAR:
                    taken[i] = near[int(far.argmin())]
                    free.discard(int(taken[i]))
        found = taken >= 0
        impulse[found] = old_impulse[taken[found]]
        return impulse


def coloured(pairs: np.ndarray, counts: np.ndarray, inverse_mass: np.ndarray) -> list[np.ndarray]:
    """Points in groups that share no moving body, in which the sweep goes through them."""
    taken = [0] * len(inverse_mass)
    moves = inverse_mass > 0
    colours: list[list[int]] = []
    for i, (a, b) in enumerate(pairs.tolist()):
        both = (taken[a] if moves[a] else 0) | (taken[b] if moves[b] else 0)
        colour = (~both & (both + 1)).bit_length() - 1
        taken[a] |= 1 << colour
        taken[b] |= 1 << colour
        if colour == len(colours):
            colours.append([])
        colours[colour].append(i)
    starts = np.cumsum(counts) - counts
    groups = []
    for colour in colours:
        members = np.array(colour)
        for k in range(int(counts[members].max())):
            groups.append(starts[members[counts[members] > k]] + k)
    return groups


def matrices(q: np.ndarray) -> np.ndarray:
    """Rotation matrices (n, 3, 3) of unit quaternions x, y, z, w."""
    x, y, z, w = q.T
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1),
        ],
        axis=1,
    )
