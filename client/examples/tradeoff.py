"""Plots the points that `lab tradeoff` writes: time against three errors.

    python client/examples/tradeoff.py out/tradeoff-families.json docs/tradeoff-families.png

Every setting is a small dot. Settings that no other one beats are red, recommended ones green, and
other libraries purple.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import matplotlib

matplotlib.use("agg")
matplotlib.rcParams["svg.hashsalt"] = "hullcast"
import matplotlib.pyplot as plt  # noqa: E402
from matplotlib.patheffects import withStroke  # noqa: E402
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter  # noqa: E402

SETTINGS, FRONT, ADVISED, OTHERS = "#96b4d7", "#c83c28", "#145a32", "#82288c"

#: The distance between names, in pixels.
GAP = 2

#: The places of a name beside its point, the nearest first: alignment and offset in points.
PLACES = [
    (side, x, y + sign * 8 * far)
    for far in range(12)
    for sign, y in ((1, 5), (-1, -12))
    for side, x in (("left", 6), ("right", -6))
]


def draw(axis: Any, panel: dict[str, Any]) -> None:
    """Draws one panel, without the names of its points."""
    axis.set_title(panel["title"], fontsize=11, loc="left")
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.plot(*transposed(panel["settings"]), ".", color=SETTINGS, markersize=3, rasterized=True)
    axis.plot(*transposed(panel["front"]), ".-", color=FRONT, markersize=7, linewidth=1)
    for colour, points in ((ADVISED, panel["advised"]), (OTHERS, panel["others"])):
        for point in points:
            axis.plot(*point["at"], "o", color=colour, markersize=6)
    axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.set_axisbelow(True)
    axis.grid(color="#e1e1e1")
    axis.spines[["top", "right"]].set_visible(False)


def transposed(points: list[list[float]]) -> list[list[float]]:
    """The horizontal and the vertical coordinates of points."""
    return [[point[k] for point in points] for k in (0, 1)]


def label(axis: Any, panel: dict[str, Any]) -> None:
    """Writes each name at the nearest place beside its point that hides no other name or point."""
    frame = axis.get_window_extent()
    named = [(ADVISED, point) for point in panel["advised"]]
    named += [(OTHERS, point) for point in panel["others"]]
    marks = [axis.transData.transform(point["at"]) for _, point in named]
    written: list[Any] = []
    for colour, point in named:
        text = axis.annotate(
            point["name"],
            point["at"],
            xytext=(0, 0),
            textcoords="offset points",
            color=colour,
            fontsize=9,
            # A white outline keeps the name readable on the dots.
            path_effects=[withStroke(linewidth=2, foreground="white")],
        )
        for side, x, y in PLACES:
            text.set(horizontalalignment=side, position=(x, y))
            box = text.get_window_extent().padded(GAP)
            inside = frame.x0 <= box.x0 and box.x1 <= frame.x1 and frame.y0 <= box.y0
            if inside and not any(map(box.overlaps, written)) and not box.count_contains(marks):
                break
        written.append(text.get_window_extent())


def main() -> None:
    source, target = sys.argv[1:]
    with open(source, encoding="utf-8") as file:
        chart = json.load(file)
    panels = chart["panels"]
    figure, axes = plt.subplots(
        1, len(panels), figsize=(4.8 * len(panels), 4), dpi=150, layout="constrained", squeeze=False
    )
    for axis, panel in zip(axes[0], panels, strict=True):
        draw(axis, panel)
        axis.set_xlabel(chart["x"])
    # The names are placed by their size in pixels, which is known once the figure has its layout.
    figure.draw_without_rendering()
    for axis, panel in zip(axes[0], panels, strict=True):
        label(axis, panel)
    metadata = {"Date": None} if target.endswith(".svg") else None
    figure.savefig(target, metadata=metadata)  # pyright: ignore[reportUnknownMemberType]


if __name__ == "__main__":
    main()
