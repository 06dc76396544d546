"""A small rigid body simulator: projected Gauss-Seidel on the contacts that a server finds.

- Integration is semi-implicit Euler.
- Contacts are velocity constraints with Baumgarte stabilisation. Half as many sweeps after the step
  remove the velocity that the stabilisation added.
- Coulomb friction acts along two tangents, which are solved together. Each is bounded by the normal
  impulse.
- Impulses start from those of the same points in the previous step, which the server names.
- Pairs of bodies are coloured such that pairs of one colour share no moving body. numpy solves such
  pairs together, which gives the result of a Gauss-Seidel sweep at the speed of array operations.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import cast

import least
import numpy as np
from contacts import (
    Contacts,
    Floats,
    Ids,
    Indices,
    Rows,
    as_manifolds,
    by_growth_distance,
    frames,
)

import hullcast

GRAVITY = np.array([0, 0, -9.81])
#: The fraction of the depth beyond the slop that is removed in one step.
BAUMGARTE = 0.2
#: The depth that is not corrected, in metres.
SLOP = 1e-3
MARGIN = 0.01


@dataclass
class Step:
    """The contacts and the times of a step."""

    contacts: int
    depth: float
    seconds_contacts: float
    seconds_solver: float


@dataclass
class Group:
    """Points that share no moving body, and are solved together."""

    points: Indices
    #: (p, 2): the two bodies of each point.
    bodies: Indices
    #: (p, 3, 12): the Jacobian along normal and tangents, divided by the effect of a unit impulse.
    jacobian: Floats
    #: (p, 3, 12): the change of both bodies' velocities by a unit impulse.
    change: Floats
    #: (p, 3): the accumulated impulses.
    impulse: Floats
    #: (p,): the impulses that the bias requires.
    bias: Floats = field(default_factory=lambda: np.zeros(0))


@dataclass
class World:
    """Bodies and their state. The first `fixed` bodies do not move.

    `shapes` are points (k, 3) relative to each body's centre of mass.
    """

    client: hullcast.Client
    shapes: Sequence[Floats]
    positions: Floats
    rotations: Floats
    fixed: int
    density: float = 1000.0
    friction: float = 0.6
    dt: float = 1 / 100
    iterations: int = 10
    accuracy: hullcast.Accuracy = field(default_factory=hullcast.Accuracy)
    max_deviation: float | None = None
    #: Whether normals are by least translation, for the pairs that the server finds in contact.
    by_least: bool = False

    def __post_init__(self) -> None:
        whole = self.client.register(self.shapes)
        self.hulls = whole
        if self.max_deviation is not None:
            # The masses stay those of the original hulls.
            centres = [hull.contraction_point for hull in whole]
            self.hulls = self.client.register(
                self.shapes, contraction_points=centres, max_deviation=self.max_deviation
            )
        count = len(whole)
        moves = np.arange(count) >= self.fixed
        masses = self.density * np.array([hull.volume for hull in whole])
        inertia = self.density * np.array([hull.inertia for hull in whole])
        self.masses = masses
        self.inverse_mass = np.where(moves, 1 / masses, 0.0)
        self.inverse_inertia = np.linalg.inv(inertia) * moves[:, None, None]
        self.inertia = inertia
        #: (n, 6): linear and angular velocities.
        self.velocities = np.zeros((count, 6))
        # Fixed bodies are in one group, so that they do not meet each other.
        self.session = self.client.session(
            hullcast.Scene(
                self.hulls, self.positions, self.rotations, groups=np.where(moves, 0, 1)
            ),
            find=True,
            margin=MARGIN,
            accuracy=self.accuracy,
            outputs=["NORMAL", "POINTS", "MATCHES"],
        )
        #: Whether simplification removed vertices of a moving hull.
        self.simpler = any(
            hull.vertex_count < full.vertex_count
            for hull, full in zip(self.hulls[self.fixed :], whole[self.fixed :], strict=True)
        )
        self._solids = [least.shape_of(points) for points in self.shapes] if self.by_least else []
        #: (p, 3): the impulses of the last step's points.
        self._impulse: Floats = np.zeros((0, 3))
        self._by_least_before: hullcast.Manifolds | None = None

    def step(self) -> Step:
        """Advances the simulation by `dt`."""
        moving = self.inverse_mass > 0
        self.velocities[moving, :3] += self.dt * GRAVITY
        begin = time.perf_counter()
        m = self.session.step(self.positions, self.rotations)
        found, previous = by_growth_distance(m), m.previous_points
        if self.by_least:
            found, previous = self._found_by_least(m)
        middle = time.perf_counter()
        self._solve(found, previous)
        end = time.perf_counter()
        depth = float(-found.distance.min()) if len(found.distance) else 0.0
        return Step(len(found.distance), max(depth, 0.0), middle - begin, end - middle)

    def close(self) -> None:
        """Ends the session with the server."""
        self.session.close()

    def _found_by_least(self, m: hullcast.Manifolds) -> tuple[Contacts, Rows]:
        """The contacts by least translation, and the row that each point had in the last step."""
        turned, angle = matrices(self.rotations), self.accuracy.feature_angle
        found = least.by_least_translation(self._solids, m.pairs, self.positions, turned, angle)
        now = as_manifolds(found, m)
        before = self._by_least_before or now[:0]
        self._by_least_before = now
        return found, hullcast.match(before, now).previous_points

    def kinetic_energy(self) -> float:
        """The kinetic energy of all moving bodies, in joules."""
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

    def _solve(self, found: Contacts, previous: Rows) -> None:
        """Computes impulses that keep the points apart, by Gauss-Seidel, and moves the bodies.

        They start from those that the points had in the last step, or from 0 (`previous` is -1).
        """
        impulse = np.concatenate([self._impulse, np.zeros((1, 3))])[previous]
        self._impulse = impulse
        if len(found.distance) == 0:
            self._move()
            return
        of = np.repeat(np.arange(len(found.pairs)), found.counts)
        pairs = found.pairs[of]
        bodies = pairs.astype(np.intp)
        axes = frames(found.normal)[of]
        turned = matrices(self.rotations)
        inverse = turned @ self.inverse_inertia @ turned.transpose(0, 2, 1)
        arms = found.point[:, None] - self.positions[bodies]
        spins = np.cross(arms[:, :, None], axes[:, None])
        # (p, 2, 3, 6): for each point's two bodies, by axis.
        jacobian = np.concatenate([np.broadcast_to(axes[:, None], spins.shape), spins], axis=3)
        jacobian *= np.array([-1.0, 1.0])[:, None, None]
        change: Floats = jacobian.copy()
        change[..., :3] *= self.inverse_mass[bodies][:, :, None, None]
        change[..., 3:] = jacobian[..., 3:] @ inverse[bodies]
        # (p, 3, 12): both bodies' velocities in one row.
        jacobian, change = side_by_side(jacobian), side_by_side(change)
        mass = 1 / (jacobian * change).sum(axis=2)
        jacobian *= mass[:, :, None]
        gap = found.distance
        # A gap may be closed but not crossed. A fraction of the depth beyond the slop is removed.
        bias = np.where(gap > 0, -gap, BAUMGARTE * np.maximum(-gap - SLOP, 0)) / self.dt
        np.add.at(
            self.velocities, bodies, np.einsum("pr,prk->pk", impulse, change).reshape(-1, 2, 6)
        )
        groups: list[Group] = []
        for i in coloured(found.pairs, found.counts, self.inverse_mass):
            groups.append(Group(i, bodies[i], jacobian[i], change[i], impulse[i]))
        bias *= mass[:, 0]
        for group in groups:
            group.bias = bias[group.points]
        for _ in range(self.iterations):
            self._sweep(groups)
        self._move()
        # Remove the velocity that only pushed bodies apart.
        for group in groups:
            group.bias = np.minimum(group.bias, 0)
        for _ in range(max(1, self.iterations // 2)):
            self._sweep(groups)
        for group in groups:
            impulse[group.points] = group.impulse

    def _sweep(self, groups: Sequence[Group]) -> None:
        """Sweeps once through all points: friction first, then the normal direction."""
        v = self.velocities
        for group in groups:
            now = v[group.bodies].reshape(-1, 12)
            old = group.impulse
            most = self.friction * old[:, :1]
            tangents = old[:, 1:] - np.einsum("prk,pk->pr", group.jacobian[:, 1:], now)
            tangents = np.minimum(np.maximum(tangents, -most), most)
            now += np.einsum("pr,prk->pk", tangents - old[:, 1:], group.change[:, 1:])
            along = np.einsum("pk,pk->p", group.jacobian[:, 0], now)
            pushed = np.maximum(old[:, 0] + group.bias - along, 0)
            now += (pushed - old[:, 0])[:, None] * group.change[:, 0]
            old[:, 0], old[:, 1:] = pushed, tangents
            v[group.bodies] = now.reshape(-1, 2, 6)


def side_by_side(two: Floats) -> Floats:
    """Reshapes (p, 2, 3, 6) to (p, 3, 12)."""
    return two.transpose(0, 2, 1, 3).reshape(len(two), 3, 12)


def coloured(pairs: Ids, counts: Indices, inverse_mass: Floats) -> list[Indices]:
    """Groups of points that share no moving body, in the order of the sweep."""
    taken: list[int] = [0] * len(inverse_mass)
    moves = inverse_mass > 0
    colours: list[list[int]] = []
    for i, (a, b) in enumerate(cast("list[tuple[int, int]]", pairs.tolist())):
        both = (taken[a] if moves[a] else 0) | (taken[b] if moves[b] else 0)
        colour = (~both & (both + 1)).bit_length() - 1
        taken[a] |= 1 << colour
        taken[b] |= 1 << colour
        if colour == len(colours):
            colours.append([])
        colours[colour].append(i)
    starts = np.cumsum(counts) - counts
    groups: list[Indices] = []
    for colour in colours:
        members = np.array(colour)
        for k in range(int(counts[members].max())):
            groups.append(starts[members[counts[members] > k]] + k)
    return groups


def matrices(q: Floats) -> Floats:
    """The rotation matrices (n, 3, 3) of unit quaternions x, y, z, w."""
    x, y, z, w = q.T
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1),
        ],
        axis=1,
    )
