"""MuJoCo's table of collision functions, and the memory of its structures, by ctypes."""

from __future__ import annotations

import ctypes
import itertools
import threading
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from . import _mjmodel
from ._arrays import Floats
from ._errors import Error
from ._mjmodel import BOX, MESH

#: The pairs of types of geoms whose contacts are replaced.
_TYPES = ((BOX, BOX), (BOX, MESH), (MESH, MESH))

#: The pairs of types of geoms whose contacts are replaced.
TYPES = ((BOX, BOX), (BOX, MESH), (MESH, MESH))

#: A bound of the search for a field of `mjData`; the structure itself is larger than that.
_SEARCHED = 1 << 18

#: `int collide(mjModel*, mjData*, mjPreContact*, int geom1, int geom2, mjtNum margin)`
_Collide = ctypes.CFUNCTYPE(
    ctypes.c_int,
    ctypes.c_void_p,
    ctypes.c_void_p,
    ctypes.c_void_p,
    ctypes.c_int,
    ctypes.c_int,
    ctypes.c_double,
)


class Phase(Protocol):
    """An object that answers the pairs of a model."""

    def _answer(self, data: int, into: int, a: int, b: int, margin: float) -> int | None:
        """Writes the points of the geoms a and b to `into`, and returns their number.

        `into` is the address of an array of `mjPreContact`, and `data` that of an `mjData`. None
        means that no step asks so: it is `mj_geomDistance`, which wants a distance.
        """
        ...

    def _fail(self, error: BaseException) -> None:
        """Takes note of an exception that `_answer` raised."""
        ...


class Table:
    """MuJoCo's table of collision functions, which is one for the whole process."""

    def __init__(self) -> None:
        mujoco = _mjmodel.library("hullcast.mujoco")
        count = int(mujoco.mjtGeom.mjNGEOMTYPES)
        shared = _shared(mujoco)
        self._entries = (ctypes.c_void_p * count**2).in_dll(shared, "mjCOLLISIONFUNC")
        #: `mjtNum mj_geomDistance(mjModel*, mjData*, int a, int b, mjtNum most, mjtNum from_to[6])`
        self._distance: Any = shared.mj_geomDistance
        self._distance.restype = ctypes.c_double
        self._distance.argtypes = [
            ctypes.c_void_p,
            ctypes.c_void_p,
            ctypes.c_int,
            ctypes.c_int,
            ctypes.c_double,
            ctypes.c_void_p,
        ]
        self._places = {types: types[0] * count + types[1] for types in TYPES}
        self._own: dict[tuple[int, int], Any] = {}
        self._installed: dict[tuple[int, int], Any] = {}
        self._phases: dict[int, Phase] = {}
        self._lock = threading.Lock()

    def add(self, model: int, phase: Phase) -> None:
        """Answers the pairs of a model by `phase`."""
        with self._lock:
            if model in self._phases:
                raise Error(
                    "this model is in use by another hullcast.mujoco.NarrowPhase: leave its with "
                    "block first",
                    reason="IN_USE",
                )
            if not self._phases:
                for types, place in self._places.items():
                    own = self._entries[place]
                    self._own[types] = (own, _Collide(own))
                    # A function that is not kept would be garbage collected.
                    self._installed[types] = _Collide(self._function(types))
                self._install()
            self._phases[model] = phase

    def remove(self, model: int) -> None:
        """Leaves the pairs of a model to MuJoCo; with the last model the table is as it was."""
        with self._lock:
            known = self._phases.pop(model, None) is not None
            if known and not self._phases:
                self._restore()

    def _install(self) -> None:
        for types, place in self._places.items():
            self._entries[place] = ctypes.cast(self._installed[types], ctypes.c_void_p).value

    def _restore(self) -> None:
        for types, place in self._places.items():
            self._entries[place] = self._own[types][0]

    def _apart(self, model: int, data: int, into: int, a: int, b: int, most: float) -> int:
        """Writes one point at MuJoCo's own distance of two geoms, if it is below `most`.

        `mj_geomDistance` takes its exact way only if the table has MuJoCo's own functions.
        Otherwise it asks them for contacts within the distance, which they know only roughly.
        """
        ends = np.zeros((2, 3))
        with self._lock:
            self._restore()
            distance = float(self._distance(model, data, a, b, most, ends.ctypes.data))
            self._install()
        way = ends[1] - ends[0]
        length = float(np.linalg.norm(way))
        if not distance < most:
            return 0
        normal = np.copysign(1.0, distance) * way / length if length > 0 else np.eye(3)[2]
        row = np.array([distance, *(ends.sum(axis=0) / 2), *normal, 0.0, 0.0, 0.0])
        ctypes.memmove(into, row.ctypes.data, row.nbytes)
        return 1

    def _function(self, types: tuple[int, int]) -> Callable[..., int]:
        def collide(model: int, data: int, into: int, a: int, b: int, margin: float) -> int:
            phase = self._phases.get(model)
            if phase is None:
                return int(self._own[types][1](model, data, into, a, b, margin))
            # An exception that leaves this function would be dropped, and MuJoCo would read any
            # number of contacts.
            try:
                count = phase._answer(data, into, a, b, margin)
                return self._apart(model, data, into, a, b, margin) if count is None else count
            except BaseException as error:
                phase._fail(error)
                return 0

        return collide


@cache
def table() -> Table:
    """The table, which is made at its first use."""
    return Table()


def _shared(mujoco: Any) -> ctypes.CDLL:
    """MuJoCo's shared library, which is loaded already."""
    folder = Path(mujoco.__file__).parent
    names = ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll")
    files = itertools.chain.from_iterable(sorted(folder.glob(name)) for name in names)
    file = next(files, None)
    if file is None:
        raise ImportError(f"{folder} has no shared library of MuJoCo: reinstall mujoco")
    return ctypes.CDLL(str(file))


@cache
def _offset(field: str) -> int:
    """The place of a pointer in `mjData`, which depends on the version of MuJoCo.

    It is found by its value, which the array of the same name has in Python. An empty array may
    begin where the next one does. So the model has one of everything that comes before.
    """
    mujoco = _mjmodel.library("hullcast.mujoco")
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body mocap='true'/><body><joint/><geom size='1'/><site/><camera/>"
        "<light/></body></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    wanted = getattr(data, field).ctypes.data
    places = range(data._address, data._address + _SEARCHED, ctypes.sizeof(ctypes.c_void_p))
    found = next((at for at in places if ctypes.c_void_p.from_address(at).value == wanted), None)
    if found is None:
        raise ImportError(
            f"mujoco {mujoco.__version__} keeps {field} in another way: not supported"
        )
    return found - data._address


def field_of(data: int, field: str) -> int:
    """The address of an array of `mjData`."""
    return ctypes.c_void_p.from_address(data + _offset(field)).value or 0


def doubles(address: int, count: int) -> Floats:
    """A copy of doubles in memory."""
    return np.frombuffer(ctypes.string_at(address, 8 * count), dtype=np.float64)
