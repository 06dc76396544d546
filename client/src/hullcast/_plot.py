"""Pictures of bodies and their contacts, drawn with matplotlib."""

from __future__ import annotations

import io
import os
from typing import Any

import numpy as np

from . import _drawing, _files
from ._arguments import counted, kind
from ._arrays import Floats, Indices
from ._errors import InvalidArgument
from ._export import Columns
from ._scene import Scene

_NUMBERED = 12
_HULL_COLOURS = ("#8fa3b8", "#b8a98f", "#9db88f", "#b88fa6", "#8fb8b5", "#a08fb8")


def picture(
    bodies: Any,
    pairs: Indices,
    normals: Floats,
    points: Columns,
    scene: Scene,
    path: str | os.PathLike[str] | None,
    ax: Any = None,
) -> Any:
    """Draws the figure that `Manifolds.plot` returns.

    Args:
        bodies: the indices of the bodies to draw.
        pairs, normals: (n, 2) and (n, 3).
        points: the columns `point_counts` (n,), `witness_as` and `witness_bs` (p, 3), and
            `distances` (p,).
        scene: the bodies' hulls and poses.
        path: a file to write the figure to, or None.
        ax: the axes to draw into; None for new axes.
    """
    figure, axes = _axes(ax)
    if path is not None:
        path = _files.writable("path", path)
        known = figure.canvas.get_supported_filetypes()
        suffix = os.path.splitext(path)[1].lower().lstrip(".")
        if suffix not in known:
            raise InvalidArgument(
                f"got {path!r}, expected a file name that ends in one of "
                f"{', '.join('.' + name for name in sorted(known))}",
                reason="UNKNOWN_VALUE",
                field="path",
            )
    from matplotlib import cm, colors

    # If there are many bodies, only those in contact are numbered.
    touching = pairs[points["point_counts"] > 0]
    numbered = set((touching if len(bodies) > _NUMBERED else bodies).reshape(-1).tolist())
    corners = [_draw_body(axes, scene, int(body), int(body) in numbered) for body in bodies]
    distances = points["distances"]
    if len(distances):
        reach = float(np.abs(distances).max()) or 1.0
        scale = colors.TwoSlopeNorm(0.0, -reach, reach)
        colour = cm.ScalarMappable(scale, "coolwarm_r")
        size = float(np.ptp(np.concatenate(corners), axis=0).max())
        _draw_contacts(axes, normals, points, colour, size)
        _colour_bar(figure, axes, colour, is_own=ax is None)
    if corners:
        _frame(axes, np.concatenate(corners))
    axes.set(xlabel="x", ylabel="y", zlabel="z")
    if len(normals) or len(distances):
        points_text = counted(len(distances), "contact point")
        axes.set_title(f"{counted(len(normals), 'pair')}, {points_text}")
    else:
        axes.set_title(counted(len(bodies), "body", "bodies"))
    if path is not None:
        with _files.writing("path", path):
            figure.savefig(path)
    return figure


def bodies_alone(
    bodies: Any, scene: Scene, path: str | os.PathLike[str] | None, ax: Any = None
) -> Any:
    """Draws the figure that `Scene.plot` returns."""
    nothing = {
        "point_counts": np.zeros(0, dtype="<u4"),
        "witness_as": np.zeros((0, 3)),
        "witness_bs": np.zeros((0, 3)),
        "distances": np.zeros(0),
    }
    no_pairs = np.zeros((0, 2), dtype="<u4")
    return picture(bodies, no_pairs, np.zeros((0, 3)), nothing, scene, path, ax)


def _axes(ax: Any) -> tuple[Any, Any]:
    """The figure and axes to draw into."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError(
            "plot needs matplotlib and scipy: pip install './client[plot]' in the clone"
        ) from error
    if ax is not None:
        if not hasattr(ax, "add_collection3d"):
            raise InvalidArgument(
                'expected matplotlib axes with projection="3d", such as '
                f'plt.figure().add_subplot(projection="3d"), got {kind(ax)}',
                reason="WRONG_TYPE",
                field="ax",
            )
        return ax.figure, ax

    class Picture(Figure):
        """A figure that a notebook displays without further settings."""

        def _repr_png_(self) -> bytes:
            written = io.BytesIO()
            self.savefig(written, format="png")  # pyright: ignore[reportUnknownMemberType]
            return written.getvalue()

        def __reduce_ex__(self, protocol: Any) -> Any:
            # Pickle as a plain figure, because pickle cannot find this local class by name.
            state = super().__reduce_ex__(2)[2]
            return _plain_figure, (), state

    figure: Any = Picture(figsize=(9, 7), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)  # a canvas that needs no display
    return figure, figure.add_subplot(projection="3d", computed_zorder=False)


def _plain_figure() -> Any:
    """An empty figure, which pickle fills."""
    from matplotlib.figure import Figure

    return Figure.__new__(Figure)


def _draw_body(axes: Any, scene: Scene, body: int, numbered: bool) -> Floats:
    """Draws a body's hull, and returns the hull's corners in the world frame."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

    points = _drawing.points_of(scene, body)
    vertices = _drawing.world(points, scene.positions[body], scene.rotations[body])
    triangles, edges = _drawing.surface(vertices)
    colour = _HULL_COLOURS[body % len(_HULL_COLOURS)]
    axes.add_collection3d(
        Poly3DCollection(
            vertices[triangles], facecolors=colour, alpha=0.2, shade=True, linewidths=0, zorder=1
        )
    )
    # A round hull may have no edges to draw, and matplotlib does not accept an empty collection.
    if len(edges):
        axes.add_collection3d(
            Line3DCollection(vertices[edges], colors=colour, linewidths=0.8, zorder=2)
        )
    used = np.unique(triangles)
    if numbered:
        box = {"boxstyle": "round,pad=0.1", "facecolor": "white", "alpha": 0.7, "linewidth": 0}
        middle = vertices[used].mean(axis=0)
        axes.text(*middle, str(body), color="#404040", fontsize=8, bbox=box, zorder=6)
    return vertices[used]


def _draw_contacts(axes: Any, normals: Floats, points: Columns, colour: Any, size: float) -> None:
    """Draws patches, their normals, and a line from each witness point on A to that on B."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

    a, b, distances = points["witness_as"], points["witness_bs"], points["distances"]
    ends = np.cumsum(points["point_counts"])
    for normal, start, end in zip(normals, ends - points["point_counts"], ends, strict=True):
        if start == end:
            continue
        patch = (a[start:end] + b[start:end]) / 2
        middle = patch.mean(axis=0)
        if end - start > 2:
            ring = patch[_drawing.around(patch - middle, normal)]
            shade = colour.to_rgba(distances[start:end].mean(), alpha=0.55)
            axes.add_collection3d(Poly3DCollection([ring], facecolor=shade, zorder=3))
        axes.quiver(*middle, *normal, length=0.12 * size, color="#202020", linewidth=1.2, zorder=5)
    shades = colour.to_rgba(distances)
    axes.add_collection3d(Line3DCollection(np.stack([a, b], axis=1), colors=shades, zorder=4))
    for side, marker in ((a, "o"), (b, "^")):
        axes.scatter(*side.T, c=shades, marker=marker, s=14, depthshade=False, zorder=4)


def _colour_bar(figure: Any, axes: Any, colour: Any, *, is_own: bool) -> None:
    """Draws the scale of the distances, with room for the names outside of the axes."""
    label = "distance (negative: overlapping)"
    if is_own:
        figure.colorbar(colour, ax=axes, shrink=0.6, pad=0.12, label=label)
        return
    # The caller's axes may have others beside them, so take height from them, not width.
    bar = figure.colorbar(
        colour, ax=axes, location="bottom", shrink=0.6, fraction=0.04, pad=0.08, label=label
    )
    bar.ax.locator_params(nbins=3)  # the numbers would overlap


def _frame(axes: Any, corners: Floats) -> None:
    """Sets limits around everything, with one scale on all axes, and not too flat to look into."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    size = float((high - low).max()) or 1.0
    middle, half = (low + high) / 2, np.maximum(high - low, 0.4 * size) / 2
    for name, at, reach in zip("xyz", middle, half, strict=True):
        getattr(axes, f"set_{name}lim")(at - reach, at + reach)
    axes.set_box_aspect(half, zoom=0.95)
