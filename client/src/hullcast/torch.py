"""Functions of poses that torch can differentiate (extra `torch`).

    import hullcast.torch
    positions = torch.tensor(scene.positions, requires_grad=True)
    rotations = torch.tensor(scene.rotations, requires_grad=True)
    alpha = hullcast.torch.alpha(client, scene, pairs, positions, rotations)
    alpha.clamp(max=1).sum().backward()

The gradient of a pair with the flag KINK is not unique: the page about derivatives explains which
one it is. `import hullcast` does not load this module.
"""

from __future__ import annotations

from typing import Any

from . import _tensors
from ._client import Client
from ._gradients import PairFunction
from ._scene import Scene

try:
    import torch as _library
except ImportError as error:
    raise ImportError(
        "hullcast.torch needs torch: pip install './client[torch]' in the clone"
    ) from error

_torch: Any = _library


def alpha(client: Client, scene: Scene, pairs: Any, positions: Any, rotations: Any) -> Any:
    """The growth scale of each pair, as a function of the poses.

    The server computes the values and the gradients in double precision. It computes gradients only
    if one of the tensors requires them. Every pair has a value, whatever its distance. A second
    derivative is not defined, and asking for one is an error.

    Args:
        client: a client, for example of `hullcast.serve()`.
        scene: the bodies; its own poses are not used.
        pairs: (n, 2), the body indices A and B of each pair.
        positions: (bodies, 3), a floating-point tensor.
        rotations: (bodies, 4), quaternions in the order x, y, z, w, which need not be normalised.

    Returns:
        (n,), with the type and the device of `positions`.

    Raises:
        InvalidPoses: a body has an unusable pose.
        InvalidArgument: an argument is not usable; the error names it.
    """
    return _Value.apply(PairFunction("alpha", client, scene, pairs), positions, rotations)


def separation(client: Client, scene: Scene, pairs: Any, positions: Any, rotations: Any) -> Any:
    """The signed separation of each pair along its normal; otherwise as `alpha`.

    At a kink the value itself jumps.
    """
    return _Value.apply(PairFunction("separation", client, scene, pairs), positions, rotations)


def normal(client: Client, scene: Scene, pairs: Any, positions: Any, rotations: Any) -> Any:
    """The unit normal of each pair, from A to B: (n, 3); otherwise as `alpha`.

    At a kink the value itself jumps.
    """
    return _Value.apply(PairFunction("normal", client, scene, pairs), positions, rotations)


class _Value(_torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, function: PairFunction, positions: Any, rotations: Any) -> Any:
        poses = [_tensors.as_numpy(pose) for pose in (positions, rotations)]
        ctx.function = function
        ctx.save_for_backward(positions, rotations)
        if any(ctx.needs_input_grad):
            values, ctx.derivatives = function.with_derivatives(*poses)
        else:
            values = function.values(*poses)
        return _torch.tensor(values, dtype=positions.dtype, device=positions.device)

    @staticmethod
    def backward(ctx: Any, weights: Any) -> tuple[None, Any, Any]:
        poses = ctx.saved_tensors
        return None, *_Gradient.apply(ctx.function, ctx.derivatives, weights, *poses)


class _Gradient(_torch.autograd.Function):
    """The gradient of `_Value`, a function of its own so that its derivative is refused."""

    @staticmethod
    def forward(
        ctx: Any, function: PairFunction, derivatives: Any, weights: Any, *poses: Any
    ) -> tuple[Any, ...]:
        numbers = [_tensors.as_numpy(tensor) for tensor in (poses[1], weights)]
        gradients = function.pulled_back(derivatives, *numbers)
        return tuple(
            _torch.tensor(gradient, dtype=pose.dtype, device=pose.device)
            for gradient, pose in zip(gradients, poses, strict=True)
        )

    @staticmethod
    def backward(ctx: Any, *_: Any) -> Any:
        raise RuntimeError("hullcast.torch has first derivatives only, expected one backward pass")
