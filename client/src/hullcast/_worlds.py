"""Splits the bodies of a `find` by worlds, if one message may not contain all of them.

Bodies of different worlds never meet, and a body of world 2^32 - 1 meets those of every other
world. So a part has the bodies of some worlds and all bodies of world 2^32 - 1. Every pair that may
meet is then in exactly one part: no pair is lost, and none is found twice. Bodies of one world
cannot be split in this way, because any two of them may meet.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from . import _answers, _export
from ._arrays import Indices
from ._errors import InvalidArgument
from ._scene import Scene

#: The world of the bodies that meet the bodies of every other world. It is the largest number.
EVERY_WORLD = 2**32 - 1


def halves(scene: Scene, bodies: Indices | None, error: InvalidArgument) -> list[Indices]:
    """Splits the bodies of a message in two parts that have about as many bodies each.

    Args:
        scene: the scene of the `find`.
        bodies: the bodies of the message, ascending; None for all.
        error: why the server refused the message.

    Raises:
        InvalidArgument: the bodies of the message cannot be split.
    """
    if bodies is None:
        bodies = np.arange(len(scene), dtype="<u4")
    worlds = _worlds_of(scene, bodies)
    if len(bodies) >= 2 and (worlds == EVERY_WORLD).all():  # these never meet each other
        return [bodies[: len(bodies) // 2], bodies[len(bodies) // 2 :]]
    last = middle(scene, bodies, error)
    # Bodies of world 2^32 - 1 are in both parts.
    return [bodies[(worlds <= last) | (worlds == EVERY_WORLD)], bodies[worlds > last]]


def middle(scene: Scene, bodies: Indices | None, error: InvalidArgument) -> int:
    """The last world of the first of two parts that have about as many bodies each.

    The arguments and errors are those of `halves`.
    """
    if bodies is None:
        bodies = np.arange(len(scene), dtype="<u4")
    worlds = _worlds_of(scene, bodies)
    distinct, counts = np.unique(worlds[worlds != EVERY_WORLD], return_counts=True)
    if len(bodies) < 2 or len(distinct) == 0:
        raise error
    if len(distinct) < 2:
        raise _too_large(scene, worlds, error)
    ends = np.cumsum(counts)
    half = int(np.count_nonzero(ends < ends[-1] / 2))
    return int(distinct[min(half, len(distinct) - 2)])


def _worlds_of(scene: Scene, bodies: Indices) -> Indices:
    return np.zeros(len(bodies), dtype="<u4") if scene.worlds is None else scene.worlds[bodies]


def order(pairs: Indices) -> npt.NDArray[np.intp]:
    """The order that sorts the pairs of all parts as one message would have them."""
    a, b = pairs.T
    return np.lexsort((b, a))


def together(parts: Sequence[_answers.Columns]) -> _answers.Columns:
    """Joins the answers of all parts, with the pairs sorted as one message would have them."""
    columns = _answers.merge(parts)
    if len(parts) == 1:
        return columns
    return _export.take(columns, order(columns["pairs"]))


def _too_large(scene: Scene, worlds: Indices, error: InvalidArgument) -> InvalidArgument:
    """The error for a message that cannot be split, with the number of its bodies."""
    everywhere = int(np.count_nonzero(worlds == EVERY_WORLD))
    text = f"the scene's {len(worlds)} bodies have no worlds"
    if scene.worlds is not None:
        text = f"{len(worlds) - everywhere} bodies are in world {worlds.min()}"
        text += f", and {everywhere} in world 2^32 - 1, which they meet" if everywhere else ""
    return InvalidArgument(
        f"{error.message}. find splits a scene only by its worlds, and {text}: put bodies that "
        "never meet into different worlds, give the pairs to query, or start the server with a "
        "higher limit",
        reason=error.reason,
        field=error.field,
        index=error.index,
    )
