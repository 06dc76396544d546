"""Contacts inside MuJoCo: `mj_step` with hullcast's manifolds (extra `mujoco`).

    import hullcast.mujoco
    with hullcast.mujoco.NarrowPhase(client, model) as contacts:
        for step in range(1000):
            contacts.step(data)

`import hullcast` does not load this module.
"""

from __future__ import annotations

import _thread
import contextlib
import ctypes
import threading
import warnings
from types import TracebackType
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import numpy.typing as npt

from . import _arguments, _arrays, _mjmodel
from ._arrays import Floats
from ._client import Client
from ._errors import Error, InvalidArgument
from ._manifolds import Manifolds
from ._mjmodel import BOX, MESH
from ._mjtable import TYPES, doubles, field_of, table
from ._query import Accuracy
from ._scene import Scene
from ._settled import Settled

if TYPE_CHECKING:
    from typing_extensions import Self

#: The doubles of `mjPreContact`: distance, position, normal, tangent.
_ROW = 10

#: The seconds after which an interrupt is repeated.
_PAUSE = 0.02

#: The number of `MjData` whose last contacts a `NarrowPhase` keeps.
_STATES = 64


def geoms(model: Any) -> npt.NDArray[np.intp]:
    """The indices of the model's geoms that can be in a contact, ascending.

    They are the bodies of `scene(client, model, data)`, in this order.

    Raises:
        ImportError: mujoco is not installed, or has a version that is not supported.
        InvalidArgument: WRONG_TYPE.
    """
    mujoco = _mjmodel.library("hullcast.mujoco")
    _mjmodel.check_model(mujoco, "model", model)
    return _mjmodel.colliding(model)


def scene(client: Client, model: Any, data: Any, *, geoms: Any = None) -> Scene:
    """The geoms of a MuJoCo model as a scene, at the poses of `data`.

    `client.find(scene)` then finds the pairs that MuJoCo would find: the scene's groups are
    MuJoCo's filter (`contype`, `conaffinity`, welded bodies, parent and child, exclusions and
    explicit pairs). `data.geom_xpos` and `data.geom_xmat` must be up to date, as they are after
    `mj_forward`, `mj_kinematics` or a step. For another state of the same model::

        chosen = hullcast.mujoco.geoms(model)
        moved = scene.moved(data.geom_xpos[chosen], data.geom_xmat[chosen].reshape(-1, 3, 3))

    A mesh is its convex hull, as in MuJoCo. A sphere is an inscribed polyhedron with 162 vertices
    (for an ellipsoid, stretched), a cylinder an inscribed prism with 32 sides, and a capsule an
    inscribed polyhedron with 130 vertices. So contacts of round geoms that are shallower than the
    gap to the true surface are missed. A plane is the upper face of a box that reaches 100 times
    the model's extent.

    Args:
        client: a client that registers the shapes.
        model: a `mujoco.MjModel`.
        data: its `mujoco.MjData`.
        geoms: (k,), the indices of the geoms to use, one body each; by default those of
            `hullcast.mujoco.geoms(model)`.

    Raises:
        ImportError: mujoco is not installed, or has a version that is not supported.
        InvalidArgument: an argument is not usable; UNSUPPORTED_SHAPE, a height field or a signed
            distance field is among the geoms.
    """
    mujoco = _mjmodel.library("hullcast.mujoco")
    _arguments.instance("client", client, Client, "a hullcast.Client")
    _mjmodel.check_model(mujoco, "model", model)
    _mjmodel.check_data(mujoco, model, data)
    if model.ngeom and not data.geom_xmat.any():
        raise InvalidArgument(
            "it has no poses yet: call mujoco.mj_forward(model, data) first",
            reason="NO_POSES",
            field="data",
        )
    if geoms is None:
        chosen = _mjmodel.colliding(model)
    else:
        of = f"the model has {_arguments.counted(model.ngeom, 'geom')}"
        chosen = _arrays.indices("geoms", geoms, None, below=model.ngeom, of=of).astype(np.intp)
    return _scene(client, mujoco, model, data, chosen)


def _scene(
    client: Client, mujoco: Any, model: Any, data: Any, chosen: npt.NDArray[np.intp]
) -> Scene:
    found, of_geoms = _mjmodel.shapes(model, chosen.tolist())
    rule = _mjmodel.Filter(mujoco, model, chosen)
    return Scene(
        client.register(found),
        *_poses(data, chosen),
        body_hulls=of_geoms,
        groups=rule.groups,
        ignored_groups=rule.ignored_groups,
    )


def _poses(data: Any, chosen: npt.NDArray[np.intp]) -> tuple[Floats, Floats]:
    return data.geom_xpos[chosen], data.geom_xmat[chosen].reshape(-1, 3, 3)


class NarrowPhase(Settled):
    """Makes MuJoCo use hullcast's contacts between boxes and meshes, within a `with` block.

        with hullcast.mujoco.NarrowPhase(client, model) as contacts:
            contacts.step(data)  # or mujoco.mj_step(model, data)

    MuJoCo keeps its search for pairs, its filter, its materials and its solver. Only the points
    between two boxes, two meshes, or a box and a mesh come from hullcast. All of them are computed
    in one call when MuJoCo asks for the first pair whose geoms have moved, so that every integrator
    works, and so do `mj_forward` and several `MjData` of the model. Other models in the process
    keep MuJoCo's own contacts.

    A pair gets at most as many points as MuJoCo has room for: eight for two boxes and four
    otherwise. `mj_geomDistance` gives MuJoCo's own distances if it asks for more than the margins
    of the model; for boxes and meshes of other models it is not exact while the block lasts.

    MuJoCo's functions cannot raise an exception in the middle of a step. If a call to the server
    fails, MuJoCo uses its own contacts from then on, and the exception is raised by `step` or
    `check`, or on leaving the block.

    Args:
        client: a client, for example of `hullcast.serve()`.
        model: a `mujoco.MjModel`. Its geometry and its filter are read once, here.
        accuracy: as in `Client.query`. Its `max_points` is lowered where MuJoCo has less room.

    Raises:
        ImportError: mujoco is not installed, or has a version that is not supported.
        InvalidArgument: an argument is not usable.
    """

    _instead: ClassVar[dict[str, str]] = {"": "make another hullcast.mujoco.NarrowPhase"}

    def __init__(self, client: Client, model: Any, *, accuracy: Accuracy | None = None) -> None:
        self._mujoco = _mjmodel.library("hullcast.mujoco")
        _arguments.instance("client", client, Client, "a hullcast.Client")
        _mjmodel.check_model(self._mujoco, "model", model)
        accuracy = Accuracy.EXACT if accuracy is None else accuracy
        _arguments.instance("accuracy", accuracy, Accuracy, "a hullcast.Accuracy or None")
        self._client, self._model = client, model
        kinds = model.geom_type
        every = _mjmodel.colliding(model)
        chosen = every[np.isin(kinds[every], (BOX, MESH))]
        self._chosen = chosen
        rest = self._mujoco.MjData(model)
        self._mujoco.mj_kinematics(model, rest)
        self._scene = _scene(client, self._mujoco, model, rest, chosen) if len(chosen) else None
        #: The group of each geom that has a hull, and whether two groups meet.
        rule = _mjmodel.Filter(self._mujoco, model, chosen)
        self._group = dict(zip(chosen.tolist(), rule.group.tolist(), strict=True))
        self._meets = rule.meets
        self._margin = _largest_margin(model, chosen)
        wanted = accuracy.max_points or 2**32 - 1
        #: The room for points of a pair of geoms, by their types.
        self._room = {key: min(wanted, most) for key, most in _room(self._mujoco, model).items()}
        most = [_limited(accuracy, n) for n in (max(self._room.values()), min(self._room.values()))]
        self._accuracy, self._fewer = most
        self._is_mesh = kinds[chosen] == MESH
        self._states: dict[int, _State] = {}
        self._lock = threading.Lock()
        self._failure: BaseException | None = None
        self._told = False
        self._active = False

    def __repr__(self) -> str:
        return f"NarrowPhase({_arguments.counted(len(self._chosen), 'geom')})"

    def __enter__(self) -> Self:
        table().add(self._model._address, self)
        self._active, self._failure, self._told = True, None, False
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        table().remove(self._model._address)
        self._active = False
        self._states.clear()
        if value is None and not self._told:
            self.check()

    def step(self, data: Any, count: int = 1) -> None:
        """Makes steps by `mj_step`, and raises if their contacts could not be computed.

        Args:
            data: the `mujoco.MjData` to step.
            count: the number of steps, 1 or more.

        Raises:
            Error: NOT_ACTIVE, outside the `with` block; ServerError, as `Client.find`.
            InvalidArgument: an argument is not usable.
        """
        if not self._active:
            raise Error(
                "the narrow phase is only in use inside its with block: "
                "with hullcast.mujoco.NarrowPhase(client, model) as contacts: ...",
                reason="NOT_ACTIVE",
            )
        _mjmodel.check_data(self._mujoco, self._model, data)
        for _ in range(_arguments.integer("count", count, 1, 2**31 - 1)):
            self._mujoco.mj_step(self._model, data)
            self.check()

    def check(self) -> None:
        """Raises the exception of the call that failed since the block began, if one did."""
        if self._failure is not None:
            self._told = True
            raise self._failure

    def manifolds(self, data: Any) -> Manifolds | None:
        """The manifolds of the last step of `data`; None if MuJoCo asked for no pair yet.

        Body i of the manifolds is the i-th of the boxes and meshes among `hullcast.mujoco.geoms`.
        """
        _mjmodel.check_data(self._mujoco, self._model, data)
        state = self._states.get(data._address)
        return None if state is None else state.manifolds

    def _answer(self, data: int, into: int, a: int, b: int, margin: float) -> int | None:
        """Writes the points of two geoms to `into`; None if no step of MuJoCo asks so."""
        if margin > self._margin or not self._may_meet(a, b):
            return None
        state = self._state(data, a, b)
        return state.write(into, a, b, margin, self._room[self._types(a, b)])

    def _may_meet(self, a: int, b: int) -> bool:
        first, second = self._group.get(a), self._group.get(b)
        return first is not None and second is not None and bool(self._meets[first, second])

    def _types(self, a: int, b: int) -> tuple[int, int]:
        return int(self._model.geom_type[a]), int(self._model.geom_type[b])

    def _fail(self, error: BaseException) -> None:
        """Leaves the pairs to MuJoCo from now on, and keeps the exception for `check`."""
        self._failure = error
        table().remove(self._model._address)
        if isinstance(error, KeyboardInterrupt):
            # The interrupt must end a loop over mj_step too, but not while MuJoCo waits for this
            # function. Its own functions run no Python, so that the next Python is the loop's.
            threading.Timer(_PAUSE, _thread.interrupt_main).start()
            return
        # Where warnings are errors, nothing is lost: the failure itself is raised later.
        with contextlib.suppress(RuntimeWarning):
            text = f"MuJoCo goes on with its own contacts: {error}"
            warnings.warn(RuntimeWarning(text), stacklevel=2)

    def _state(self, data: int, a: int, b: int) -> _State:
        """The contacts of the state in which `data` has the geoms a and b now."""
        state = self._states.get(data)
        if state is not None and state.holds(a, b):
            return state
        count = self._model.ngeom
        positions = doubles(field_of(data, "geom_xpos"), 3 * count)
        matrices = doubles(field_of(data, "geom_xmat"), 9 * count)
        manifolds = self._computed(positions.reshape(-1, 3), matrices.reshape(-1, 3, 3))
        poses = (positions.tobytes(), matrices.tobytes())
        state = _State(data, poses, manifolds, self._chosen)
        with self._lock:
            if len(self._states) >= _STATES:
                self._states.clear()
            self._states[data] = state
        return state

    def _computed(self, positions: Floats, matrices: Floats) -> Manifolds:
        assert self._scene is not None  # MuJoCo asked for a pair of them
        scene = self._scene.moved(positions[self._chosen], matrices[self._chosen])
        outputs = ("NORMAL", "POINTS")
        m = self._client.find(
            scene, margin=self._margin, accuracy=self._accuracy, outputs=outputs, on_invalid="flag"
        )
        meshes = self._is_mesh[m.pairs].any(axis=1)
        many = np.flatnonzero(meshes & (m.point_counts > self._fewer.max_points))
        if not len(many):
            return m
        # MuJoCo has less room for pairs with meshes: the server chooses which points to keep.
        fewer = self._client.query(
            scene,
            m.pairs[many],
            margin=self._margin,
            accuracy=self._fewer,
            outputs=outputs,
            on_invalid="flag",
        )
        return Manifolds.concat([m[np.delete(np.arange(len(m)), many)], fewer])


def _limited(accuracy: Accuracy, most: int) -> Accuracy:
    return Accuracy(accuracy.solver, accuracy.relative_tolerance, accuracy.feature_angle, most)


def _room(mujoco: Any, model: Any) -> dict[tuple[int, int], int]:
    """The number of points that MuJoCo accepts for two geoms, by their types in both orders."""
    room: dict[tuple[int, int], int] = {}
    for a, b in TYPES:
        firsts = np.flatnonzero(model.geom_type == a)[:1].tolist()
        seconds = np.flatnonzero(model.geom_type == b)[-1:].tolist()
        counts = [
            int(mujoco.mj_maxContact(model, i, j, margin))
            for i in firsts
            for j in seconds
            for margin in (0, 1)
        ]
        room[a, b] = room[b, a] = min(counts, default=4)
    return room


def _largest_margin(model: Any, chosen: npt.NDArray[np.intp]) -> float:
    """A bound of the margins with which MuJoCo asks for pairs: those of two geoms are added."""
    of_geoms = np.sort(model.geom_margin[chosen] + model.geom_gap[chosen])[-2:]
    of_pairs = model.pair_margin + model.pair_gap
    return max(0.0, float(of_geoms.sum()), float(of_pairs.max(initial=0.0)))


class _State:
    """The contacts of one state, in the form in which MuJoCo takes them."""

    def __init__(
        self,
        data: int,
        poses: tuple[bytes, bytes],
        manifolds: Manifolds,
        chosen: npt.NDArray[np.intp],
    ) -> None:
        self._data = data
        self._positions, self._matrices = poses
        self.manifolds = manifolds
        m = manifolds
        normal = np.repeat(m.normal, m.point_counts, axis=0)
        rows = np.zeros((2, len(normal), _ROW))
        rows[:, :, 0] = m.distance
        rows[:, :, 1:4] = m.witness_a + (0.5 * m.distance)[:, None] * normal
        rows[0, :, 4:7], rows[1, :, 4:7] = normal, -normal
        #: The rows of all points, and again with the normals turned around.
        self._rows = rows
        starts, stops = m.point_offsets[:-1].tolist(), m.point_offsets[1:].tolist()
        pairs = chosen[m.pairs].tolist()
        self._spans: dict[tuple[int, int], tuple[int, int, int]] = {}
        for (a, b), start, stop in zip(pairs, starts, stops, strict=True):
            if stop > start:
                self._spans[a, b] = (0, start, stop)
                self._spans[b, a] = (1, start, stop)

    def holds(self, a: int, b: int) -> bool:
        """Whether the two geoms are still where they were when the contacts were computed."""
        at, turned = field_of(self._data, "geom_xpos"), field_of(self._data, "geom_xmat")
        return all(
            ctypes.string_at(at + 24 * geom, 24) == self._positions[24 * geom : 24 * geom + 24]
            and ctypes.string_at(turned + 72 * geom, 72)
            == self._matrices[72 * geom : 72 * geom + 72]
            for geom in (a, b)
        )

    def write(self, into: int, a: int, b: int, margin: float, room: int) -> int:
        """Writes the points of two geoms that are nearer than the margin; returns their number."""
        span = self._spans.get((a, b))
        if span is None:
            return 0
        side, start, stop = span
        rows = self._rows[side, start:stop]
        near = rows[:, 0] < margin
        if not near.all():
            rows = rows[near]
        rows = rows[:room]
        ctypes.memmove(into, rows.ctypes.data, rows.nbytes)
        return len(rows)
