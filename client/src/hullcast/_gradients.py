"""The numbers of pairs as functions of poses, with their gradients; for `torch.py` and `jax.py`."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ._arrays import Floats
from ._client import Client
from ._manifolds import Manifolds
from ._scene import Scene

#: For each function: the output and the column of its values, and those of its derivatives.
_COLUMNS = {
    "alpha": ("ALPHA", "alpha", "ALPHA_GRADIENT", "alpha_gradient"),
    "separation": ("NORMAL", "separation", "SEPARATION_GRADIENT", "separation_gradient"),
    "normal": ("NORMAL", "normal", "NORMAL_JACOBIAN", "normal_jacobian"),
}


class PairFunction(NamedTuple):
    """One of the functions of `_COLUMNS`, of the poses of a scene's bodies."""

    name: str
    client: Client
    scene: Scene
    pairs: Any

    def values(self, positions: Any, rotations: Any) -> Floats:
        """The value of each pair, without derivatives."""
        output, column, _, _ = _COLUMNS[self.name]
        return getattr(self._asked(positions, rotations, output), column)

    def with_derivatives(self, positions: Any, rotations: Any) -> tuple[Floats, Floats]:
        """The value of each pair, and the derivatives of its k coordinates: (n, k, 9)."""
        output, column, derivative, derivatives = _COLUMNS[self.name]
        m = self._asked(positions, rotations, output, derivative)
        return getattr(m, column), getattr(m, derivatives).reshape(len(m), -1, 9)

    def _asked(self, positions: Any, rotations: Any, *outputs: str) -> Manifolds:
        poses = (np.asarray(pose, np.float64) for pose in (positions, rotations))
        scene = self.scene.moved(*poses)
        return self.client.query(scene, self.pairs, margin=np.inf, outputs=outputs)

    def pulled_back(
        self, derivatives: Floats, rotations: Any, weights: Any
    ) -> tuple[Floats, Floats]:
        """The gradient of the weighted sum of all values, by the positions and the quaternions.

        Args:
            derivatives: (n, k, 9), of `with_derivatives`.
            rotations: (bodies, 4), the quaternions at which they were computed.
            weights: one per value.
        """
        weights = np.asarray(weights, np.float64).reshape((*derivatives.shape[:2], 1))
        # A value of weight 0 adds nothing, also if it has no gradient.
        terms = np.where(weights == 0, 0.0, weights * derivatives).sum(axis=1)
        rotations = np.asarray(rotations, np.float64)
        a, b = np.asarray(self.pairs, np.int64).reshape(-1, 2).T
        by_position, by_rotation = np.zeros((2, len(rotations), 3))
        np.add.at(by_position, b, terms[:, :3])
        np.add.at(by_position, a, -terms[:, :3])
        np.add.at(by_rotation, a, terms[:, 3:6])
        np.add.at(by_rotation, b, terms[:, 6:])
        return by_position, _by_quaternion(by_rotation, rotations)


def _by_quaternion(by_rotation: Floats, rotations: Floats) -> Floats:
    """The gradient by the components of quaternions, from the gradient by small rotations.

    A change `dq` of the quaternion `q` is the small rotation 2 (dq conj(q))_xyz / |q|^2. The result
    is the transpose of this linear map, applied to `by_rotation`. It is perpendicular to `q`.
    """
    xyz, w = rotations[:, :3], rotations[:, 3:]
    of_xyz = w * by_rotation + np.cross(by_rotation, xyz)
    of_w = -(xyz * by_rotation).sum(axis=1, keepdims=True)
    squares = (rotations**2).sum(axis=1, keepdims=True)
    return np.concatenate([of_xyz, of_w], axis=1) * (2 / squares)
