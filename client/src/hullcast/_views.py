"""Results in the form that simulators need: by body, in body frames, with tangents, as tensors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _arguments, _tensors
from ._arrays import Floats
from ._columns import ManifoldColumns
from ._errors import InvalidArgument
from ._scene import Scene

#: An orthonormal, right-handed frame, one vector per row. The tangents of a normal are those of the
#: first row, turned. The direction opposite to the first row, at which they jump, is 25 degrees or
#: more from each axis and diagonal of the coordinates, where many scenes have their normals.
_REFERENCE = np.array([[2.0, 3.0, 6.0], [3.0, -6.0, 2.0], [6.0, 2.0, -3.0]]) / 7.0


@dataclass(frozen=True, repr=False)
class PerBody:
    """The contact points of each body in a few numbers. A body without contact points has zeros.

    The arrays have one row per body of the scene.
    """

    #: (bodies,): the number of contact points of the pairs in which the body is.
    count: npt.NDArray[np.int64]
    #: (bodies,): the signed distance of the body's deepest point; infinity without points.
    distance: Floats
    #: (bodies, 3): the deepest point, on the surface of this body, world frame.
    point: Floats
    #: (bodies, 3): the mean, over the body's points, of the unit normals that point away from the
    #: body. Its length is 1 if all normals agree, and less if contacts are on several sides.
    normal: Floats

    def __repr__(self) -> str:
        bodies = _arguments.counted(len(self.count), "body", "bodies")
        return f"PerBody({bodies}, {np.count_nonzero(self.count)} of them in contact)"


class ManifoldViews(ManifoldColumns):
    """The part of `Manifolds` that computes other forms of its columns."""

    def per_body(self) -> PerBody:
        """Adds up the contact points of each body: their number, the deepest one, the mean normal.

        There is one row per body of the scene. If the manifolds were loaded from a file and have no
        scene, the last row is that of the highest body in `pairs`. The query must have the outputs
        NORMAL and POINTS.
        """
        highest = int(self.pairs.max()) if self.pairs.size else -1
        bodies = highest + 1 if self.scene is None else len(self.scene)
        of_pair = np.repeat(np.arange(len(self.pairs)), self.point_counts)
        # Each contact point belongs to two bodies, and so it has two rows here.
        body = self.pairs[of_pair].T.reshape(-1).astype(np.intp)
        normals = np.repeat(self.normal, self.point_counts, axis=0)
        outward = np.concatenate([normals, -normals])
        points = np.concatenate([self.witness_a, self.witness_b])
        depth = np.tile(self.distance, 2)
        count = np.bincount(body, minlength=bodies)
        total = np.stack(
            [np.bincount(body, outward[:, i], minlength=bodies) for i in range(3)], axis=1
        )
        # In this order the first row of each body is its deepest; of equal ones, the first.
        order = np.lexsort((np.tile(np.arange(len(of_pair)), 2), depth, body))
        touched, first = np.unique(body[order], return_index=True)
        deepest = order[first]
        distance, point = np.full(bodies, np.inf), np.zeros((bodies, 3))
        distance[touched], point[touched] = depth[deepest], points[deepest]
        return PerBody(
            count=count.astype(np.int64),
            distance=distance,
            point=point,
            normal=total / np.maximum(count, 1)[:, None],
        )

    @property
    def frame(self) -> Floats:
        """(n, 3, 3): for each pair the normal and two tangents, one per row, right-handed.

        The rows are orthonormal to rounding. The tangents depend on the normal only, and
        continuously: they are those of the direction (2, 3, 6) / 7, turned by the least rotation
        that takes this direction to the normal. Only at the opposite direction, where no rule can
        be continuous, do they jump. The query must have the output NORMAL.
        """
        return frames(self.normal)

    @property
    def local_a(self) -> Floats:
        """(p, 3): the witness points on A, in the frame of A's hull.

        Raises:
            InvalidArgument: NO_SCENE, the manifolds were loaded from a file.
        """
        return self._in_body(0, self.witness_a)

    @property
    def local_b(self) -> Floats:
        """(p, 3): the witness points on B, in the frame of B's hull.

        Raises:
            InvalidArgument: NO_SCENE, the manifolds were loaded from a file.
        """
        return self._in_body(1, self.witness_b)

    def _in_body(self, side: int, points: Floats) -> Floats:
        scene = self._with_scene()
        body = np.repeat(self.pairs[:, side], self.point_counts)
        return unrotated(scene.rotations[body], points - scene.positions[body])

    def _with_scene(self) -> Scene:
        """The scene.

        Raises:
            InvalidArgument: NO_SCENE.
        """
        if self.scene is None:
            raise InvalidArgument(
                "an answer that was loaded from a file has no scene: assign its scene to the "
                "attribute scene",
                reason="NO_SCENE",
                field="scene",
            )
        return self.scene

    def to_torch(self) -> dict[str, Any]:
        """The requested columns as torch tensors on the CPU, by the names of their attributes.

        The tensors share the columns' memory. `tensor.to("cuda")` copies a tensor to a device.
        Indices and counts are uint32, with which torch cannot index; `tensor.long()` converts them.

        Raises:
            ImportError: torch is not installed.
        """
        return _tensors.to_torch(self._arrays())

    def to_jax(self) -> dict[str, Any]:
        """The requested columns as jax arrays, by the names of their attributes.

        jax keeps 64-bit numbers only with its setting `jax_enable_x64`; otherwise it rounds them to
        32 bits. An array may share the column's memory, so do not write into columns afterwards.

        Raises:
            ImportError: jax is not installed.
        """
        return _tensors.to_jax(self._arrays())

    def to_warp(self) -> dict[str, Any]:
        """The requested columns as warp arrays on the CPU, by the names of their attributes.

        The arrays share the columns' memory. `wp.clone(array, device="cuda")` copies an array to a
        device. Columns with three coordinates in each row, such as `normal`, are arrays of `vec3d`.

        Raises:
            ImportError: warp is not installed.
        """
        return _tensors.to_warp(self._arrays())

    def _arrays(self) -> dict[str, np.ndarray]:
        """The columns by the names of their attributes."""
        single = {name: name.removesuffix("s") for name in self._columns}
        return {
            single[name] if hasattr(self, single[name]) else name: column
            for name, column in self._columns.items()
        }


def frames(normals: Floats) -> Floats:
    """Right-handed frames (n, 3, 3) whose first rows are unit vectors (n, 3).

    The least rotation that takes r to n is the reflection that takes r to -n, followed by the one
    that takes -n to n. The second one does not move the tangents, which are at right angles to n.
    So each tangent is a tangent t of r, reflected in the plane at right angles to h = r + n:
    t - 2 (h.t) / (h.h) h. Where n is nearly -r, h has few correct digits, so the frame is made
    orthonormal again; and where h has none, the tangents are those of r.
    """
    half = normals + _REFERENCE[0]
    squared = _dot(half, half)
    known = squared > (16 * np.finfo(float).eps) ** 2
    factor = np.where(known, 2 * _dot(half, _REFERENCE[1:2]) / np.where(known, squared, 1), 0)
    first = _REFERENCE[1] - factor * half
    for _ in range(2):  # after a step that cancels digits, a second one is needed
        first = first - _dot(first, normals) * normals
        first = first / np.sqrt(_dot(first, first))
    second: Any = np.cross(normals, first)
    return np.stack([normals, first, second], axis=1)


def _dot(a: Floats, b: Floats) -> Floats:
    """(n, 1): inner products, added in a fixed order: a row does not depend on the other rows."""
    return (a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2])[:, None]


def unrotated(rotations: Floats, vectors: Floats) -> Floats:
    """Turns vectors (n, 3) by the inverse of quaternions (n, 4), which need not be of length 1."""
    turns = rotations / np.linalg.norm(rotations, axis=1, keepdims=True)
    axes = -turns[:, :3]
    crossed = 2.0 * np.cross(axes, vectors)
    result: Any = vectors + turns[:, 3:] * crossed + np.cross(axes, crossed)
    return result
