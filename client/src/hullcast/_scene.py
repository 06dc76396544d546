"""Scenes: bodies at poses."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from . import _arrays
from ._arguments import kind
from ._arrays import Floats, Indices
from ._errors import InvalidArgument
from ._hulls import Content, Hull


class Scene:
    """A set of bodies: hulls at poses. A pose maps its hull's frame to the world frame.

    Args:
        hulls: one hull per body; or distinct hulls, with `body_hulls`. A hull is a `Hull` or its id
            of 32 bytes. If a server has lost a hull, the client can register it again only if it is
            a `Hull`.
        positions: (n, 3), the world positions of the origins of the hulls' frames, in the caller's
            units; or (n, 4, 4) homogeneous matrices, without `rotations`.
        rotations: (n, 4) quaternions in the order x, y, z, w (`from_wxyz` converts the other
            order), (n, 3, 3) matrices, or a scipy `Rotation`. Quaternions with a norm of 0.25 to 4
            are normalised. With any other norm the body's pose is unusable.
        body_hulls: (n,): each body's hull, as an index into `hulls`.
        worlds: (n,), used by `find`: bodies only meet bodies of the same world. A body of world
            2^32 - 1 meets the bodies of every other world.
        groups: (n,), used by `find`: bodies of the same group never meet. Group 0 means no group.
        ignored_groups: (k, 2), used by `find`: pairs of groups whose bodies never meet.

    Raises:
        InvalidArgument: an argument has a wrong shape or type, or an index out of range.
    """

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
    ) -> None:
        if isinstance(hulls, (Hull, bytes)):
            hulls = [hulls]
        elif isinstance(hulls, (str, Mapping)) or not isinstance(hulls, Iterable):
            raise InvalidArgument(
                f"expected a list of hulls, got {kind(hulls)}", reason="WRONG_TYPE", field="hulls"
            )
        hulls = list(hulls)
        ids = [_id(i, hull) for i, hull in enumerate(hulls)]
        # A message must have each hull once, however often the caller names it.
        place: dict[bytes, int] = {}
        distinct = np.array([place.setdefault(id, len(place)) for id in ids], dtype="<u4")
        self.hull_ids: tuple[bytes, ...] = tuple(place)
        known = {hull.id: hull.content for hull in hulls if isinstance(hull, Hull)}
        #: For each of `hull_ids`, the content to register it again; None if only the id was given.
        self.contents: tuple[Content | None, ...] = tuple(known.get(id) for id in place)
        if body_hulls is None:
            self.body_hulls: Indices = distinct
        else:
            self.body_hulls = distinct[
                _arrays.indices(
                    "body_hulls", body_hulls, None, below=len(ids), of=f"there are {len(ids)} hulls"
                )
            ]
        count = len(self.body_hulls)
        self.positions: Floats
        self.rotations: Floats
        self.positions, self.rotations = _arrays.poses(positions, rotations, count)
        self.worlds = None if worlds is None else _arrays.indices("worlds", worlds, count)
        self.groups = None if groups is None else _arrays.indices("groups", groups, count)
        self.ignored_groups = (
            None
            if ignored_groups is None
            else _arrays.indices("ignored_groups", ignored_groups, None, 2)
        )
        if self.ignored_groups is not None and (self.ignored_groups == 0).any():
            raise InvalidArgument(
                "got group 0, which means no group: expected two numbers above 0 in each row",
                reason="VALUE_OUT_OF_RANGE",
                field="ignored_groups",
            )

    def __len__(self) -> int:
        return len(self.body_hulls)

    def __repr__(self) -> str:
        hulls = len(self.hull_ids)
        bodies = f"{len(self)} bod{'y' if len(self) == 1 else 'ies'}"
        text = f"{bodies} of {hulls} hull{'' if hulls == 1 else 's'}"
        if self.worlds is not None:
            worlds = len(np.unique(self.worlds))
            text += f" in {worlds} world{'' if worlds == 1 else 's'}"
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
        scene = Scene.__new__(Scene)
        scene.__dict__.update(self.__dict__)
        scene.positions, scene.rotations = _arrays.poses(positions, rotations, len(self))
        return scene

    def _many(self, positions: Floats, rotations: Floats) -> Scene:
        """A scene with a copy of the bodies for each set of poses, one set after another."""
        scene = Scene.__new__(Scene)
        scene.__dict__.update(self.__dict__)
        scene.body_hulls = np.tile(self.body_hulls, len(positions) // max(len(self), 1))
        return scene.moved(positions, rotations)


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
