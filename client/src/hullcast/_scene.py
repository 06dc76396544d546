"""Scenes: bodies at poses."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar, cast

import numpy as np
import numpy.typing as npt

from . import _arrays, _motion
from ._arguments import counted, iterable, kind, ordered
from ._arrays import Floats, Indices
from ._errors import InvalidArgument
from ._hulls import Content, Hull
from ._settled import Settled, freeze

#: In place of a mask of bodies: none of them has moved.
NOTHING: npt.NDArray[np.bool_] = np.zeros(0, dtype=bool)


class Scene(Settled):
    """A set of bodies: hulls at poses. A pose maps its hull's frame to the world frame.

    A scene does not change: its attributes cannot be assigned, and its arrays are read-only copies.
    `moved` gives a scene of the same bodies at new poses.

    Args:
        hulls: one hull per body; or distinct hulls, with `body_hulls`. A hull is a `Hull` or its id
            of 32 bytes. If a server has lost a hull, the client can register it again only if it is
            a `Hull`.
        positions: (n, 3), the world positions of the origins of the hulls' frames, in the caller's
            units; or, without `rotations`, (n, 4, 4) homogeneous matrices or a scipy
            `RigidTransform`.
        rotations: (n, 4) quaternions in the order x, y, z, w (`from_wxyz` converts the other
            order), (n, 3, 3) matrices, or a scipy `Rotation`. Quaternions with a norm of 0.25 to 4
            are normalised. With any other norm the body's pose is unusable.
        body_hulls: (n,): each body's hull, as an index into `hulls`.
        worlds: (n,), used by `find`: bodies only meet bodies of the same world. A body of world
            2^32 - 1 meets the bodies of every other world, and no other body of world 2^32 - 1.
        groups: (n,), used by `find`: bodies of the same group never meet. Group 0 means no group.
        ignored_groups: (k, 2), used by `find`: pairs of groups whose bodies never meet. They need
            `groups`.
        margins: (n,): a length that is added to the margin of each of a body's pairs, 0 to 1e100.
            The margin of the pair (a, b) is `margin + (margins[a] + margins[b])`.

    Raises:
        InvalidArgument: an argument has a wrong shape or type, an index out of range, or a number
            out of its range.
    """

    _instead: ClassVar[dict[str, str]] = {
        "positions": "use scene.moved(positions, rotations), a scene at new poses",
        "rotations": "use scene.moved(positions, rotations), a scene at new poses",
        "": "make a new hullcast.Scene",
    }

    #: The ids of the distinct hulls.
    hull_ids: tuple[bytes, ...]
    #: For each of `hull_ids`, the content to register it again; None if only the id was given.
    contents: tuple[Content | None, ...]
    #: For each of `hull_ids`, the hull's circumradius; None if only the id was given.
    radii: tuple[float | None, ...]
    #: (n,): each body's hull, as an index into `hull_ids`.
    body_hulls: Indices
    #: (n, 3): the position of each body.
    positions: Floats
    #: (n, 4): the rotation of each body, a quaternion x, y, z, w.
    rotations: Floats
    #: (n,): the world of each body; or None.
    worlds: Indices | None
    #: (n,): the group of each body; or None.
    groups: Indices | None
    #: (k, 2): pairs of groups whose bodies never meet; or None.
    ignored_groups: Indices | None
    #: (n,): the length that each body adds to the margins of its pairs; or None.
    margins: Floats | None
    #: (m, 2): the pairs of the file from which the scene was loaded; otherwise None.
    pairs: Indices | None
    #: The margin of the file from which the scene was loaded; otherwise None.
    margin: float | None

    def __init__(
        self,
        hulls: Sequence[Hull | bytes],
        positions: Any,
        rotations: Any = None,
        *,
        body_hulls: Any = None,
        worlds: Any = None,
        groups: Any = None,
        ignored_groups: Any = None,
        margins: Any = None,
    ) -> None:
        hulls = list_of_hulls(hulls)
        ids = [_id(i, hull) for i, hull in enumerate(hulls)]
        # A message must have each hull once, however often the caller names it.
        place: dict[bytes, int] = {}
        distinct = np.array([place.setdefault(id, len(place)) for id in ids], dtype="<u4")
        known = {hull.id: hull for hull in hulls if isinstance(hull, Hull)}
        of_ids = [known.get(id) for id in place]
        if body_hulls is None:
            of_bodies = distinct
        else:
            of = f"there {'is' if len(ids) == 1 else 'are'} {counted(len(ids), 'hull')}"
            chosen = _arrays.indices("body_hulls", body_hulls, None, below=len(ids), of=of)
            of_bodies = distinct[chosen]
        count = len(of_bodies)
        self._set(
            hull_ids=tuple(place),
            contents=tuple(None if hull is None else hull.content for hull in of_ids),
            radii=tuple(None if hull is None else hull.circumradius for hull in of_ids),
            body_hulls=_arrays.frozen(of_bodies),
            worlds=_optional("worlds", worlds, count),
            groups=_optional("groups", groups, count),
            ignored_groups=_optional("ignored_groups", ignored_groups, None, 2),
            margins=_motion.margins(margins, count),
            pairs=None,
            margin=None,
        )
        if self.ignored_groups is not None and (self.ignored_groups == 0).any():
            raise InvalidArgument(
                "got group 0, which means no group: expected two numbers above 0 in each row",
                reason="VALUE_OUT_OF_RANGE",
                field="ignored_groups",
            )
        if self.ignored_groups is not None and len(self.ignored_groups) and self.groups is None:
            raise InvalidArgument(
                "missing: ignored_groups without groups has no effect; expected the group of each "
                "body",
                reason="MISSING_ARGUMENT",
                field="groups",
            )
        self._place(positions, rotations, of_hulls=body_hulls is None)

    def __len__(self) -> int:
        return len(self.body_hulls)

    def __repr__(self) -> str:
        bodies = counted(len(self), "body", "bodies")
        text = f"{bodies} of {counted(len(self.hull_ids), 'hull')}"
        if self.worlds is not None:
            text += f" in {counted(len(np.unique(self.worlds)), 'world')}"
        return f"Scene({text})"

    def plot(self, *, path: str | os.PathLike[str] | None = None, ax: Any = None) -> Any:
        """Draws all bodies with matplotlib (extra `plot`); needs no display.

        Bodies with an unusable pose are left out.

        Args:
            path: a file to write the picture to, such as "scene.png"; by default none.
            ax: matplotlib axes with projection="3d" to draw into; by default new axes.

        Returns:
            The `matplotlib.figure.Figure`.

        Raises:
            ImportError: matplotlib or scipy is not installed.
            InvalidArgument: NO_GEOMETRY, the scene has only the id of a hull; WRONG_TYPE for `ax`.
        """
        from . import _plot

        unusable = _arrays.unusable(self.positions, self.rotations)
        bodies = np.setdiff1d(np.arange(len(self)), unusable)
        return _plot.bodies_alone(bodies, self, path, ax)

    def moved(self, positions: Any, rotations: Any = None) -> Scene:
        """A scene of the same bodies at new poses, which are given in any form that `Scene` takes.

        Raises:
            InvalidArgument: as for `Scene`.
        """
        scene = self._copy()
        scene._place(positions, rotations)
        return scene

    def _moved_some(
        self, bodies: Indices, positions: Any, rotations: Any
    ) -> tuple[Scene, npt.NDArray[np.bool_]]:
        """A scene at new poses of some bodies, and the mask of those; see `_moved_where`."""
        at, turned = _arrays.poses(positions, rotations, len(bodies))
        if len(bodies) == 0:
            return self, NOTHING
        moved = np.zeros(len(self), dtype=bool)
        moved[bodies] = True
        everywhere = self.positions.copy(), self.rotations.copy()
        everywhere[0][bodies], everywhere[1][bodies] = at, turned
        return self._at(*everywhere), moved

    def _moved_where(self, positions: Any, rotations: Any) -> tuple[Scene, npt.NDArray[np.bool_]]:
        """A scene at new poses, and the mask of the bodies whose poses have other bits.

        Bits are compared, so that a pose with NaN is equal to itself, as it is for the server. If
        there is none, the scene is this one, and the mask is `NOTHING`: comparing takes a small
        part of the time of copying.
        """
        given = _arrays.poses(positions, rotations, len(self))
        moved = NOTHING
        for old, new in zip((self.positions, self.rotations), given, strict=True):
            differ = old.view("<u8") != new.view("<u8")
            if differ.any():
                # Combining the columns takes a fifth of the time of `differ.any(axis=1)`.
                for column in differ.T:
                    moved = column | moved if len(moved) else np.array(column)
        return (self._at(*map(np.array, given)), moved) if len(moved) else (self, NOTHING)

    def _at(self, positions: Floats, rotations: Floats) -> Scene:
        """A scene with these arrays, which become read-only."""
        scene = self._copy()
        positions.flags.writeable = rotations.flags.writeable = False
        scene._set(positions=positions, rotations=rotations)
        return scene

    def save(
        self,
        path: str | os.PathLike[str],
        pairs: Any = None,
        *,
        margin: float | None = None,
        name: str = "",
    ) -> None:
        """Writes the scene to a JSON file, in the format that `hullcast query` reads.

        The file has each hull's points and options, each body's pose, the pairs and the margins.
        Worlds and groups are written too; the command line ignores them. Every number is written
        such that reading gives the same bits.

        Args:
            path: the file, such as "scene.json".
            pairs: (n, 2), the pairs of bodies that `hullcast query` answers; by default those of
                the file from which the scene was loaded, or none.
            margin: the margin of the query, 0 or more; by default that of the file, or 0.
            name: the scene's name in messages; by default the file's name.

        Raises:
            InvalidArgument: NO_GEOMETRY, the scene has only the id of a hull; NOT_FINITE, a pose
                has a number that is not finite; SIMPLIFIED, a hull was simplified, which the
                format cannot state; or an argument is not usable.
        """
        from . import _scene_file

        _scene_file.save(self, path, pairs, margin, name)

    @classmethod
    def load(cls, path: str | os.PathLike[str], *, frame: int | str = 0) -> Scene:
        """Reads a scene file, as `save` writes it and `hullcast query` reads it.

            scene = hullcast.Scene.load("scene.json")
            m = client.query(scene, scene.pairs, margin=scene.margin)

        The hulls need not be registered: the first query registers those that the server lacks.

        Args:
            path: the file.
            frame: the configuration to load, for a file with several: its number from 0 or its
                name.

        Returns:
            The scene. Its attributes `pairs` and `margin` are those of the file.

        Raises:
            InvalidArgument: NOT_A_SCENE, the file has another content; the message names the
                place. UNREADABLE_FILE; UNKNOWN_FRAME, there is no such configuration.
            FileNotFound: the file does not exist.
        """
        from . import _scene_file

        return _scene_file.load(path, frame)

    def _copy(self) -> Scene:
        scene = Scene.__new__(Scene)
        scene.__dict__.update(self.__dict__)
        return scene

    def _place(self, positions: Any, rotations: Any, *, of_hulls: bool = False) -> None:
        """Sets the poses of all bodies to copies of the given ones."""
        at, turned = _arrays.poses(positions, rotations, len(self), of_hulls=of_hulls)
        self._set(positions=_arrays.frozen(at), rotations=_arrays.frozen(turned))

    def _many(self, positions: Floats, rotations: Floats) -> Scene:
        """A scene with a copy of the bodies for each set of poses, one set after another."""
        scene = self._copy()
        copies = len(positions) // max(len(self), 1)
        scene._set(body_hulls=_arrays.frozen(np.tile(self.body_hulls, copies)))
        if self.margins is not None:
            scene._set(margins=_arrays.frozen(np.tile(self.margins, copies)))
        return scene.moved(positions, rotations)

    def __setstate__(self, state: dict[str, Any]) -> None:
        unknown = (None,) * len(state["hull_ids"])
        defaults = {"pairs": None, "margin": None, "margins": None, "radii": unknown}
        self.__dict__.update({**defaults, **state})
        freeze(self)


def _optional(field: str, value: Any, *shape: int | None) -> Indices | None:
    """A read-only copy of an array of integers, or None."""
    return None if value is None else _arrays.frozen(_arrays.indices(field, value, *shape))


def list_of_hulls(hulls: Any) -> list[Any]:
    """The hulls as a list. A single hull counts as a list of one.

    Raises:
        InvalidArgument: WRONG_TYPE or NO_ORDER.
    """
    if isinstance(hulls, (Hull, bytes)):
        return [hulls]
    ordered("hulls", hulls)
    if isinstance(hulls, (str, Mapping)) or not iterable(hulls):
        raise InvalidArgument(
            f"expected a list of hulls, got {kind(hulls)}", reason="WRONG_TYPE", field="hulls"
        )
    return list(cast("Iterable[Any]", hulls))


def _id(place: int, hull: Any) -> bytes:
    id = hull.id if isinstance(hull, Hull) else hull
    if not isinstance(id, bytes) or len(id) != 32:
        raise InvalidArgument(
            f"expected a Hull or the 32 bytes of its id, got {_described(id)}: "
            "register shapes first, with client.register",
            reason="NOT_A_HULL",
            field="hulls",
            index=place,
        )
    return id


def _described(value: Any) -> str:
    return f"{len(value)} bytes" if isinstance(value, bytes) else kind(value)
