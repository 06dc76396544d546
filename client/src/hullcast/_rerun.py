"""Writes bodies and their contacts to a rerun recording."""

from __future__ import annotations

from typing import Any

import numpy as np

from . import _arguments, _drawing
from ._arrays import Floats
from ._errors import InvalidArgument
from ._export import Columns
from ._scene import Scene

#: The colours of overlapping, touching and distant points.
_COLOURS: Floats = np.array([[180, 4, 38], [221, 221, 221], [59, 76, 192]], dtype=float)
_BODY = (143, 163, 184, 90)
_EDGE = (110, 125, 145)
_NORMAL = (32, 32, 32)


def log(
    bodies: Any,
    pairs: Any,
    normals: Floats,
    points: Columns,
    scene: Scene,
    path: str,
    hulls: bool,
    recording: Any,
) -> None:
    """Writes what `Manifolds.log` documents.

    Args:
        bodies: the indices of the bodies to write.
        pairs, normals: (n, 2) and (n, 3).
        points: as for `_plot.picture`.
        scene: the bodies' hulls and poses.
        path: the entity path under which everything is written.
        hulls: whether the hulls are written.
        recording: a `rerun.RecordingStream`, or None for the current one.
    """
    try:
        import rerun as library
    except ImportError as error:
        raise ImportError("log needs rerun: pip install './client[rerun]' in the clone") from error
    rerun: Any = library
    if recording is not None:
        wanted = "a rerun.RecordingStream or None"
        _arguments.instance("recording", recording, rerun.RecordingStream, wanted)
    elif rerun.get_data_recording() is None:
        raise InvalidArgument(
            "there is no recording, so that nothing would be kept: call rerun.init(NAME, "
            "spawn=True) for a viewer, or rerun.init(NAME) and rerun.save(FILE), first",
            reason="NO_RECORDING",
            field="recording",
        )
    to = {"recording": recording}
    for body in bodies:
        entity = f"{path}/bodies/{int(body)}"
        turn = rerun.Quaternion(xyzw=scene.rotations[body])
        pose = rerun.Transform3D(translation=scene.positions[body], quaternion=turn)
        rerun.log(entity, pose, **to)
        if hulls:
            _log_hull(rerun, entity, _drawing.points_of(scene, int(body)), to)
    size = _size(scene, bodies)
    # Empty collections are logged too, because they replace the content of an earlier step.
    for name, drawn in {
        **_patches(rerun, pairs, normals, points, size),
        **_witnesses(rerun, points, size),
    }.items():
        rerun.log(f"{path}/contacts/{name}", drawn, **to)


def _patches(
    rerun: Any, pairs: Any, normals: Floats, points: Columns, size: float
) -> dict[str, Any]:
    """The outlines of the patches, and an arrow along each normal from the patch's middle."""
    ends = np.cumsum(points["point_counts"])
    starts = ends - points["point_counts"]
    touching = np.flatnonzero(points["point_counts"])
    middles = (points["witness_as"] + points["witness_bs"]) / 2
    outlines, origins = list[Floats](), list[Floats]()
    for pair in touching:
        patch = middles[starts[pair] : ends[pair]]
        origins.append(patch.mean(axis=0))
        if len(patch) > 2:
            ring = patch[_drawing.around(patch - origins[-1], normals[pair])]
            outlines.append(np.concatenate([ring, ring[:1]]))
    return {
        "patches": rerun.LineStrips3D(outlines, radii=0.002 * size),
        "normals": rerun.Arrows3D(
            origins=np.array(origins).reshape(-1, 3),
            vectors=0.12 * size * normals[touching],
            colors=_NORMAL,
            radii=0.003 * size,
            labels=[f"{p[0]}, {p[1]}" for p in pairs[touching]],
            show_labels=False,
        ),
    }


def _witnesses(rerun: Any, points: Columns, size: float) -> dict[str, Any]:
    """The witness points on both hulls, and the lines that join them."""
    a, b = points["witness_as"], points["witness_bs"]
    shades = colours(points["distances"])
    lines = np.stack([a, b], axis=1)
    return {
        "witnesses": rerun.LineStrips3D(lines, colors=shades, radii=0.002 * size),
        "points_a": rerun.Points3D(a, colors=shades, radii=0.006 * size),
        "points_b": rerun.Points3D(b, colors=shades, radii=0.006 * size),
    }


def colours(distances: Floats) -> np.ndarray:
    """(p, 3) uint8: red if overlapping, grey if touching, blue if apart; stronger the farther."""
    reach = float(np.abs(distances).max(initial=0.0)) or 1.0
    channels = [np.interp(distances / reach, [-1, 0, 1], _COLOURS[:, i]) for i in range(3)]
    return np.stack(channels, axis=-1).astype(np.uint8)


def _log_hull(rerun: Any, entity: str, points: Floats, to: dict[str, Any]) -> None:
    """Writes a hull in its own frame, once for all times."""
    triangles, edges = _drawing.surface(points)
    hull = rerun.Mesh3D(vertex_positions=points, triangle_indices=triangles, albedo_factor=_BODY)
    rerun.log(f"{entity}/hull", hull, static=True, **to)
    lines = rerun.LineStrips3D(points[edges], colors=_EDGE)
    rerun.log(f"{entity}/edges", lines, static=True, **to)


def _size(scene: Scene, bodies: Any) -> float:
    """The extent of all bodies together, to which the sizes of strokes are relative."""
    corners = [
        _drawing.world(
            _drawing.points_of(scene, int(body)), scene.positions[body], scene.rotations[body]
        )
        for body in bodies
    ]
    return float(np.ptp(np.concatenate(corners), axis=0).max()) if corners else 1.0
