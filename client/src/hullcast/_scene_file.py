"""Scene files, `hullcast.scene.v1`: JSON that the command line reads too.

`examples/scenes/README.md` describes the format. Unknown keys are ignored.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from typing import Any, NoReturn, cast

import numpy as np

from . import _arguments, _arrays, _files
from ._arguments import counted, kind, shown
from ._errors import InvalidArgument
from ._hulls import DEFAULT_PLANARITY, LARGEST_PLANARITY, Content
from ._scene import Scene

_FORMAT = "hullcast.scene.v1"
#: The number of configurations that a message names.
_NAMED = 8


def save(scene: Scene, path: Any, pairs: Any, margin: Any, name: Any) -> None:
    """Writes a scene file; arguments and errors are those of `Scene.save`."""
    bodies = len(scene)
    of = f"the scene has {counted(bodies, 'body', 'bodies')}"
    if pairs is None:
        pairs = np.zeros((0, 2), "<u4") if scene.pairs is None else scene.pairs
    else:
        pairs = _arrays.indices("pairs", pairs, None, 2, below=bodies, of=of)
    margin = scene.margin or 0.0 if margin is None else _arguments.number("margin", margin, 0)
    _arguments.instance("name", name, str, "a str")
    file = _files.writable("path", path)
    for field in ("positions", "rotations"):
        wrong = np.flatnonzero(~np.isfinite(getattr(scene, field)).all(axis=1))
        if wrong.size:
            raise InvalidArgument(
                "the pose has a number that is not finite, which JSON cannot express",
                reason="NOT_FINITE",
                field=field,
                index=int(wrong[0]),
            )
    # Each hull, body and pair has a line of its own.
    parts: dict[str, list[Any]] = {
        "hulls": [_hull(i, content) for i, content in enumerate(scene.contents)],
        "bodies": [
            {"hull": hull, "position": position, "rotation": rotation}
            for hull, position, rotation in zip(
                scene.body_hulls.tolist(),
                scene.positions.tolist(),
                scene.rotations.tolist(),
                strict=True,
            )
        ],
        "pairs": pairs.tolist(),
    }
    head = {"format": _FORMAT, "name": name or os.path.basename(file), "margin": margin}
    for field in ("worlds", "groups", "ignored_groups"):
        if getattr(scene, field) is not None:
            head[field] = getattr(scene, field).tolist()
    if scene.margins is not None:
        head["margins"] = scene.margins.tolist()
    lines = [f"{json.dumps(key)}: {json.dumps(value)}" for key, value in head.items()]
    for key, rows in parts.items():
        lines.append(f'"{key}": [\n' + ",\n".join(json.dumps(row) for row in rows) + "\n]")
    with _files.writing("path", file), open(file, "w", encoding="ascii") as out:
        out.write("{\n" + ",\n".join(lines) + "\n}\n")


def _hull(place: int, content: Content | None) -> dict[str, Any]:
    if content is None:
        raise InvalidArgument(
            "the scene has only this hull's id, and the file needs its points: make the scene with "
            "Hull objects",
            reason="NO_GEOMETRY",
            field="hulls",
            index=place,
        )
    if content.max_vertices is not None or content.max_deviation is not None:
        raise InvalidArgument(
            "the hull was simplified when it was registered, which a scene file cannot state: "
            "register the simplified points without max_vertices and max_deviation",
            reason="SIMPLIFIED",
            field="hulls",
            index=place,
        )
    hull: dict[str, Any] = {"name": f"hull {place}", "planarity": content.planarity}
    if content.centre is not None:
        hull["contraction_point"] = content.centre.tolist()
    return {**hull, "vertices": content.points.tolist()}


def load(path: Any, frame: Any) -> Scene:
    """Reads a scene file; arguments and errors are those of `Scene.load`."""
    data = _files.read("path", path)
    name = _files.path_of("path", path)
    try:
        return _scene(_parsed(data), frame)
    except _NotAScene as error:
        text = str(error)
    except InvalidArgument as error:
        if error.field == "frame":
            raise
        text = f"{error.place}: {error.message}"
    raise InvalidArgument(f"{name}: {text}", reason="NOT_A_SCENE", field="path")


class _NotAScene(Exception):
    """A fault of the content. The message does not name the file yet."""


def _parsed(data: bytes) -> dict[str, Any]:
    def refuse(constant: str) -> NoReturn:
        raise ValueError(f"{constant} is not JSON")

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        entries: dict[str, Any] = {}
        for key, value in pairs:
            if key in entries:
                raise _NotAScene(f"the key {key!r} is twice in one object, expected it once")
            entries[key] = value
        return entries

    try:
        found = json.loads(data.decode("utf-8-sig"), parse_constant=refuse, object_pairs_hook=once)
    except (ValueError, RecursionError) as error:
        raise _NotAScene(f"not JSON ({error}); expected a scene file, {_FORMAT}") from None
    if not isinstance(found, dict):
        raise _NotAScene(f"expected an object with the key format, got {kind(found)}")
    file = cast("dict[str, Any]", found)
    if file.get("format") != _FORMAT:
        raise _NotAScene(f"format: got {shown(file.get('format'))}, expected {_FORMAT!r}")
    return file


def _scene(file: dict[str, Any], frame: Any) -> Scene:
    if not isinstance(file.get("name"), str):
        raise _NotAScene(f"name: expected a text, got {kind(file.get('name'))}")
    contents = [_content(place, hull) for place, hull in _objects("hulls", file)]
    bodies = list(_objects("bodies", file))
    counts = counted(len(contents), "hull")
    hulls = [
        _arguments.integer(f"{place}.hull", body.get("hull"), 0, 2**32 - 1)
        for place, body in bodies
    ]
    for (place, _), hull in zip(bodies, hulls, strict=True):
        if hull >= len(contents):
            raise _NotAScene(f"{place}.hull: got {hull}, but the scene has {counts}")
    positions: Any = [_finite(f"{at}.position", body.get("position"), 3) for at, body in bodies]
    rotations: Any = [_finite(f"{at}.rotation", body.get("rotation"), 4) for at, body in bodies]
    frames = list(_objects("frames", file)) if "frames" in file else []
    _check_names(frames)
    # Every configuration is read, because the command line refuses a file with a fault in any.
    poses = [
        (
            _finite(f"{place}.positions", entry.get("positions"), len(bodies), 3),
            _finite(f"{place}.rotations", entry.get("rotations"), len(bodies), 4),
        )
        for place, entry in frames
    ]
    number = _frame([entry for _, entry in frames], frame)
    if poses:
        positions, rotations = poses[number]
    of = f"the scene has {counted(len(bodies), 'body', 'bodies')}"
    pairs = _arrays.indices("pairs", file.get("pairs"), None, 2, below=len(bodies), of=of)
    scene = Scene(
        [content.identity for content in contents],
        np.reshape(positions, (-1, 3)),
        np.reshape(rotations, (-1, 4)),
        body_hulls=hulls,
        worlds=file.get("worlds"),
        groups=file.get("groups"),
        ignored_groups=file.get("ignored_groups"),
        # The command line takes an empty list for none, even if there are bodies.
        margins=file.get("margins") or None,
    )
    known = {content.identity: content for content in contents}
    scene._set(
        contents=tuple(known[id] for id in scene.hull_ids),
        pairs=_arrays.frozen(pairs),
        margin=_arguments.number("margin", file.get("margin", 0.0), 0),
    )
    return scene


def _objects(key: str, file: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """The objects in a list of the file, each with its place for messages."""
    found = file.get(key)
    if not isinstance(found, list):
        raise _NotAScene(f"{key}: expected a list, got {kind(found)}")
    for i, entry in enumerate(cast("list[Any]", found)):
        if not isinstance(entry, dict):
            raise _NotAScene(f"{key}[{i}]: expected an object, got {kind(entry)}")
        known = cast("dict[str, Any]", entry)
        if not isinstance(known.get("name", ""), str):
            raise _NotAScene(f"{key}[{i}].name: expected a text, got {kind(known['name'])}")
        yield f"{key}[{i}]", known


def _check_names(frames: list[tuple[str, dict[str, Any]]]) -> None:
    """Raises if two configurations have one name, by which a caller could mean either."""
    first: dict[str, str] = {}
    for place, frame in frames:
        name = frame.get("name", "")
        if name and first.setdefault(name, place) != place:
            raise _NotAScene(
                f"{place}.name: {first[name]} has the name {shown(name)} too, expected another name"
            )


def _content(place: str, hull: dict[str, Any]) -> Content:
    centre = hull.get("contraction_point")
    planarity = hull.get("planarity", DEFAULT_PLANARITY)
    return Content(
        points=_arrays.frozen(_finite(f"{place}.vertices", hull.get("vertices"), None, 3)),
        centre=None
        if centre is None
        else _arrays.frozen(_finite(f"{place}.contraction_point", centre, 3)),
        planarity=None
        if planarity is None
        else _arguments.number(f"{place}.planarity", planarity, 0, LARGEST_PLANARITY),
    )


def _finite(place: str, value: Any, *shape: int | None) -> _arrays.Floats:
    array = _arrays.floats(place, value, *shape)
    if not np.isfinite(array).all():
        raise _NotAScene(f"{place}: a number is too large for double precision")
    return array


def _frame(given: list[dict[str, Any]], wanted: Any) -> int:
    """The number of the configuration with a name or number; 0 in a file without configurations."""
    if isinstance(wanted, str):
        for number, frame in enumerate(given):
            if frame.get("name") == wanted:
                return number
    else:
        number = _arguments.integer("frame", wanted, 0, 2**31 - 1)
        if number < max(len(given), 1):
            return number
    last = max(len(given) - 1, 0)
    names = [str(frame["name"]) for frame in given if frame.get("name")]
    allowed = "0" if last == 0 else f"0 to {last}"
    if names:
        allowed += f", or a name: {', '.join(names[:_NAMED])}{', ...' * (len(names) > _NAMED)}"
    raise InvalidArgument(
        f"got {shown(wanted)}, expected {allowed}", reason="UNKNOWN_FRAME", field="frame"
    )
