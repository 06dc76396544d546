"""Reads SRDF files: the pairs of links whose collisions are disabled."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from . import _elements, _files
from ._elements import Element, Invalid
from ._errors import InvalidArgument


def disabled(srdf: Any, links: Sequence[str]) -> list[tuple[str, str]]:
    """The pairs of link names whose collisions an SRDF file disables.

    They are the pairs of its `disable_collisions` elements. `disable_default_collisions` disables
    all pairs of a link but those of `enable_collisions` elements.

    Args:
        srdf: the path of the SRDF file.
        links: the names of all links of the robot.

    Raises:
        InvalidArgument: NOT_AN_SRDF, NOT_A_PATH or UNREADABLE_FILE.
        FileNotFound: the file does not exist.
    """
    path = Path(_files.path_of("srdf", srdf))
    data = _files.read("srdf", path)
    try:
        root = _elements.root_of(data, "robot")
        if root.find("link") is not None or root.find("joint") is not None:
            raise Invalid(
                "this is a URDF file, because its <robot> has links or joints; expected an SRDF "
                "file, whose <robot> has <disable_collisions> elements"
            )
        pairs = [_pair(element) for element in root.iter("disable_collisions")]
        enabled = [_pair(element) for element in root.iter("enable_collisions")]
        silent = [
            _elements.text_of(element, "link", "<robot>")
            for element in root.iter("disable_default_collisions")
        ]
    except Invalid as error:
        raise InvalidArgument(f"{path.name}: {error}", reason="NOT_AN_SRDF", field="srdf") from None
    kept = {frozenset(pair) for pair in enabled}
    return pairs + [(a, b) for a in silent for b in links if frozenset((a, b)) not in kept]


def _pair(element: Element) -> tuple[str, str]:
    a, b = (_elements.text_of(element, name, "<robot>") for name in ("link1", "link2"))
    return a, b
