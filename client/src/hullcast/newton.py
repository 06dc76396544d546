"""Contacts inside Newton: its solvers with hullcast's manifolds (extra `newton`).

    import hullcast.newton
    pipeline = hullcast.newton.Pipeline(client, model)
    contacts = pipeline.contacts()
    for step in range(1000):
        pipeline.collide(state, contacts)
        solver.step(state, next_state, control, contacts, dt)

`import hullcast` does not load this module.
"""

from __future__ import annotations

import importlib
import weakref
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from . import _arguments, _nwmodel
from ._arrays import Indices
from ._client import Client
from ._errors import InvalidArgument
from ._manifolds import Manifolds
from ._query import Accuracy
from ._scene import Scene
from ._settled import Settled
from ._worlds import EVERY_WORLD

#: Newton's sign for a generation that there is not.
_NO_GENERATION = -1
#: Newton's signs for a contact of a new pair, and for a new contact of a known pair.
_NEW_PAIR, _NEW_POINT = -1, -2


class Pipeline(Settled):
    """Fills `newton.Contacts` with hullcast's contacts, in place of `newton.CollisionPipeline`.

    The contacts are those of all shapes that Newton lets meet, with its margins, gaps, worlds,
    collision groups and filters. Each step makes one call to the server and launches one Warp
    kernel. Results are the same to the bit for worlds that are copies of each other.

    A mesh is its convex hull, with a `NotConvexWarning` if it is not convex. A sphere is an
    inscribed polyhedron with 162 vertices (for an ellipsoid, stretched), a cylinder or a cone has
    32 sides, and a capsule is an inscribed polyhedron with 130 vertices. A plane without a size is
    the upper face of a large box. For shapes that are apart, hullcast's normal is that of growth
    distance, so keep gaps small.

    Args:
        client: a client, for example of `hullcast.serve()`.
        model: a `newton.Model`. Its shapes and filters are read once, here.
        matching: whether to find each contact again in the step before, for the solvers that start
            from earlier forces (`SolverVBD(rigid_contact_history=True)` and `SolverSteel`).
        shuffle: None for rows in the order of pairs, and of points around a patch. A number puts
            the rows of each world in an order that depends on the number only. Solvers that pass
            over the rows in sequence, such as Steel, drift less on shuffled rows.
        accuracy: as in `Client.query`.
        rigid_contact_max: the room in the buffers that `contacts` makes; by default Newton's
            estimate.
        plane_size: half the size of the box that stands for a plane without a size.

    Raises:
        ImportError: newton is not installed, or has a version that is not supported.
        InvalidArgument: an argument is not usable; UNSUPPORTED_SHAPE, a height field, a barrel or
            a Gaussian splat may meet another shape.
    """

    _instead: ClassVar[dict[str, str]] = {"": "make another hullcast.newton.Pipeline"}

    def __init__(
        self,
        client: Client,
        model: Any,
        *,
        matching: bool = False,
        shuffle: int | None = None,
        accuracy: Accuracy | None = None,
        rigid_contact_max: int | None = None,
        plane_size: float = 1000.0,
    ) -> None:
        self._newton = _nwmodel.library()
        _arguments.instance("client", client, Client, "a hullcast.Client")
        _arguments.instance("model", model, self._newton.Model, "a newton.Model")
        self._matching = _arguments.flag("matching", matching)
        self._shuffle = (
            None if shuffle is None else _arguments.integer("shuffle", shuffle, 0, 2**32)
        )
        self._accuracy = Accuracy.EXACT if accuracy is None else accuracy
        _arguments.instance("accuracy", self._accuracy, Accuracy, "a hullcast.Accuracy or None")
        if rigid_contact_max is not None:
            rigid_contact_max = _arguments.integer(
                "rigid_contact_max", rigid_contact_max, 1, 2**31 - 1
            )
        self._room = rigid_contact_max
        reach = _arguments.number("plane_size", plane_size, 1e-3, 1e6)
        self._client, self._model = client, model
        self._warp: Any = importlib.import_module("warp")
        pairs = _nwmodel.candidates(model)
        #: The shapes that may meet another one, ascending: the bodies of the scene.
        chosen: npt.NDArray[np.intp] = np.unique(pairs).astype(np.intp)
        self._chosen = chosen
        self._allowed = np.sort(pairs[:, 0] << 32 | pairs[:, 1])
        self._of_bodies: npt.NDArray[np.intp] = model.shape_body.numpy()[chosen].astype(np.intp)
        local = model.shape_transform.numpy()[chosen].astype(np.float64).reshape(-1, 7)
        local[:, 3:] /= np.linalg.norm(local[:, 3:], axis=1, keepdims=True)
        self._local = local
        self._margins = model.shape_margin.numpy().astype(np.float64)
        self._gaps = model.shape_gap.numpy().astype(np.float64)
        widest = np.sort((self._margins + self._gaps)[chosen])[-2:]
        self._margin = max(0.0, float(widest.sum()))
        self._worlds = model.shape_world.numpy().astype(np.int64)
        found, of_shapes = _nwmodel.distinct(model, chosen.tolist(), reach)
        worlds = self._worlds[chosen]
        # Newton's global shapes meet each other, and hullcast's bodies of every world do not.
        everywhere = worlds < 0
        mixed = bool(everywhere.any() and not everywhere.all())
        both = np.isin(pairs, chosen[everywhere]).all(axis=1)
        self._global_pairs = np.searchsorted(chosen, pairs[both]) if mixed else pairs[:0]
        self._scene = None
        if len(chosen):
            self._scene = Scene(
                client.register(found),
                *_nwmodel.poses(np.zeros((0, 7)), np.full(len(chosen), -1), local),
                body_hulls=of_shapes,
                worlds=None if everywhere.all() else np.where(everywhere, EVERY_WORLD, worlds),
                groups=self._of_bodies + 2,
            )
        self._earlier: _Earlier | None = None

    def __repr__(self) -> str:
        return f"Pipeline({_arguments.counted(len(self._chosen), 'shape')})"

    def contacts(self) -> Any:
        """A new `newton.Contacts` that `collide` can fill."""
        mode = "latest" if self._matching else "disabled"
        pipeline = self._newton.CollisionPipeline(
            self._model, rigid_contact_max=self._room, contact_matching=mode
        )
        return pipeline.contacts()

    def collide(self, state: Any, contacts: Any) -> Manifolds | None:
        """Fills `contacts` with the contacts of `state`.

        Args:
            state: a `newton.State` of the model.
            contacts: a `newton.Contacts`, as `contacts()` makes it. Its content is replaced, and
                its generation rises, which tells solvers that the contacts are new.

        Returns:
            The manifolds from which the contacts were taken, before points beyond Newton's gaps
            were left out; None if no two shapes can meet. Body i of the manifolds is the i-th of
            the shapes that may meet another one.

        Raises:
            InvalidArgument: an argument is not usable; TOO_MANY_CONTACTS, the buffer is too small;
                NO_MATCHING, it was made without matching.
            InvalidPoses: a body has a pose that is not finite.
            ServerError: as `Client.find`.
        """
        self._check(state, contacts)
        m = self._computed(state)
        before = int(contacts.contact_generation.numpy()[0])
        if m is None:
            contacts.clear()
            self._earlier = None
            return None
        shapes = self._chosen[m.pairs].astype("<u4")
        pair_of = np.repeat(np.arange(len(m), dtype=np.int32), m.point_counts)
        rows = self._rows(m, shapes, pair_of)
        room = len(contacts.rigid_contact_shape0)
        if len(rows) > room:
            raise InvalidArgument(
                f"there are {len(rows)} contacts, and the buffer has room for {room}: make it with "
                "a larger rigid_contact_max",
                reason="TOO_MANY_CONTACTS",
                field="contacts",
            )
        matches, generation = np.zeros(0, np.int32), _NO_GENERATION
        keys = None
        if self._matching:
            keys = np.hstack([shapes[pair_of[rows]], m.point_ids[rows]])
            earlier = self._earlier
            known = earlier is not None and earlier.buffer() is contacts
            known = known and earlier is not None and earlier.generation == before
            generation = before if known else _NO_GENERATION
            matches = match(earlier.keys if known and earlier else keys[:0], keys)
        contacts.clear()
        self._fill(state, contacts, m, shapes, pair_of, rows, matches, generation)
        if keys is not None:
            now = int(contacts.contact_generation.numpy()[0])
            self._earlier = _Earlier(weakref.ref(contacts), now, keys)
        return m

    def _check(self, state: Any, contacts: Any) -> None:
        newton = self._newton
        _arguments.instance("state", state, newton.State, "a newton.State")
        _arguments.instance("contacts", contacts, newton.Contacts, "a newton.Contacts")
        bodies = 0 if state.body_q is None else len(state.body_q)
        if bodies != self._model.body_count:
            raise InvalidArgument(
                f"got a state of {_arguments.counted(bodies, 'body', 'bodies')}, expected one of "
                f"this model, with {self._model.body_count}: model.state()",
                reason="LENGTH_MISMATCH",
                field="state",
            )
        if self._matching and contacts.rigid_contact_match_index is None:
            raise InvalidArgument(
                "it has no match indices, and this pipeline has matching=True: make it with "
                "pipeline.contacts()",
                reason="NO_MATCHING",
                field="contacts",
            )

    def _computed(self, state: Any) -> Manifolds | None:
        """The manifolds of all pairs of shapes that may meet, within the largest margin."""
        if self._scene is None:
            return None
        bodies = np.zeros((0, 7)) if state.body_q is None else state.body_q.numpy()
        scene = self._scene.moved(*_nwmodel.poses(bodies, self._of_bodies, self._local))
        options: dict[str, Any] = {
            "margin": self._margin,
            "accuracy": self._accuracy,
            "outputs": ("NORMAL", "POINTS", "FEATURES") if self._matching else ("NORMAL", "POINTS"),
        }
        m = self._client.find(scene, **options)
        shapes = self._chosen[m.pairs].astype(np.int64)
        m = m[np.isin(shapes[:, 0] << 32 | shapes[:, 1], self._allowed)]
        if not len(self._global_pairs):
            return m
        return Manifolds.concat([m, self._client.query(scene, self._global_pairs, **options)])

    def _rows(
        self, m: Manifolds, shapes: Indices, pair_of: npt.NDArray[np.int32]
    ) -> npt.NDArray[np.int32]:
        """The points that Newton keeps, in the order in which it gets them."""
        margins, gaps = self._margins[shapes].sum(axis=1), self._gaps[shapes].sum(axis=1)
        kept = np.flatnonzero(m.distance - margins[pair_of] <= gaps[pair_of])
        world = self._worlds[shapes].max(axis=1)[pair_of[kept]]
        order = np.argsort(world, kind="stable")
        if self._shuffle is not None:
            order = order[np.lexsort((mixed(_ranks(world[order]), self._shuffle), world[order]))]
        return kept[order].astype(np.int32)

    def _fill(
        self,
        state: Any,
        contacts: Any,
        m: Manifolds,
        shapes: Indices,
        pair_of: npt.NDArray[np.int32],
        rows: npt.NDArray[np.int32],
        matches: npt.NDArray[np.int32],
        generation: int,
    ) -> None:
        """Writes the rows by one kernel."""
        warp, model = self._warp, self._model
        device = contacts.device

        def array(values: npt.NDArray[Any], kind: Any = None) -> Any:
            options = {} if kind is None else {"dtype": kind}
            plain = np.require(values, requirements=["C", "W"])
            return warp.array(plain, copy=not device.is_cpu, device=device, **options)

        empty = array(np.zeros(0, np.int32))
        body_q = state.body_q
        if body_q is None:
            body_q = warp.empty(0, dtype=warp.transform, device=device)
        has_matches = contacts.rigid_contact_match_index is not None
        if has_matches and not self._matching:
            matches = np.full(len(rows), _NEW_PAIR, np.int32)
        for optional in ("stiffness", "damping", "friction"):
            values = getattr(contacts, f"rigid_contact_{optional}")
            if values is not None:
                values.zero_()  # so that solvers take the materials of the shapes
        warp.launch(
            importlib.import_module("hullcast._nwkernels").fill,
            dim=max(1, len(rows)),
            inputs=[
                len(rows),
                array(shapes),
                array(m.normal, warp.vec3d),
                array(m.witness_a, warp.vec3d),
                array(m.distance),
                array(pair_of),
                array(rows),
                array(matches),
                generation,
                model.shape_body,
                body_q,
                model.shape_margin,
            ],
            outputs=[
                contacts.rigid_contact_count,
                contacts.rigid_contact_shape0,
                contacts.rigid_contact_shape1,
                contacts.rigid_contact_point0,
                contacts.rigid_contact_point1,
                contacts.rigid_contact_offset0,
                contacts.rigid_contact_offset1,
                contacts.rigid_contact_normal,
                contacts.rigid_contact_margin0,
                contacts.rigid_contact_margin1,
                contacts.rigid_contact_tids,
                contacts.rigid_contact_match_index if has_matches else empty,
                contacts.rigid_contact_match_generation if has_matches else empty,
            ],
            device=device,
            record_tape=False,
        )


@dataclass(frozen=True, eq=False)
class _Earlier:
    """The contacts of the step before."""

    buffer: weakref.ref[Any]
    generation: int
    #: (rows, 6): the shapes and the point id of each row.
    keys: Indices


def match(earlier: Indices, later: Indices) -> npt.NDArray[np.int32]:
    """For each later contact, the row of the same contact before.

    Args:
        earlier, later: (rows, 6), two shapes and a point id of four numbers. Rows are the same
            contact if all six agree. Of several equal rows only the first is matched.

    Returns:
        (rows,): the earlier row; -1 if the pair of shapes is new, -2 if only the point is.
    """
    before, after = _hashes(earlier), _hashes(later)
    order = np.argsort(before, kind="stable")  # the first of equal rows comes first
    place = np.searchsorted(before[order], after)
    inside = place < len(order)
    row = np.full(len(later), _NEW_POINT, np.int32)
    row[inside] = order[place[inside]]
    known = row >= 0
    # Two contacts may have one hash, so the rows themselves are compared.
    known[known] = (earlier[row[known]] == later[known]).all(axis=1)
    first = np.zeros(len(later), dtype=bool)
    first[np.unique(after, return_index=True)[1]] = True
    row[~(known & first)] = _NEW_POINT
    row[~np.isin(_pairs_of(later), _pairs_of(earlier))] = _NEW_PAIR
    return row


def _hashes(keys: Indices) -> npt.NDArray[np.uint64]:
    """A number of 64 bits for each row."""
    result = np.zeros(len(keys), dtype=np.uint64)
    for column in keys.T:
        result = mixed(result ^ column.astype(np.uint64), 0)
    return result


def _pairs_of(keys: Indices) -> npt.NDArray[np.uint64]:
    return keys[:, 0].astype(np.uint64) << np.uint64(32) | keys[:, 1].astype(np.uint64)


def _ranks(groups: npt.NDArray[np.int64]) -> npt.NDArray[np.uint64]:
    """The place of each entry among the entries of its group, for sorted groups."""
    starts = np.searchsorted(groups, groups)
    return (np.arange(len(groups)) - starts).astype(np.uint64)


def mixed(numbers: npt.NDArray[np.uint64], seed: int) -> npt.NDArray[np.uint64]:
    """Pseudo-random numbers, each from one number and the seed (the finaliser of SplitMix64)."""
    with np.errstate(over="ignore"):
        z = numbers + np.uint64(seed + 1) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return z ^ (z >> np.uint64(31))
