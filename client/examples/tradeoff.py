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
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter  # noqa: E402

SETTINGS, FRONT, ADVISED, OTHERS = "#96b4d7", "#c83c28", "#145a32", "#82288c"


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
    """Writes each name beside its point, inside the panel, and moves it down until it hides no other."""
    frame = axis.get_window_extent()
    written: list[Any] = []
    for colour, points in ((ADVISED, panel["advised"]), (OTHERS, panel["others"])):
        for point in points:
            text = axis.annotate(
                point["name"],
                point["at"],
                xytext=(6, 5),
                textcoords="offset points",
                color=colour,
                fontsize=9,
            )
            if text.get_window_extent().x1 > frame.x1:
                text.set_horizontalalignment("right")
                text.set_position((-6, 5))
            down = 5
            while any(text.get_window_extent().overlaps(other) for other in written):
                down -= 2
                text.set_position((text.get_position()[0], down))
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
