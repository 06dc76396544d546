"""Plots docs/planarity.csv, which `make planarity` writes.

    python client/examples/planarity.py docs/planarity.csv docs/planarity.svg

The upper row shows the fraction of contact patches of rounded shapes that are whole, against the
planarity of the faces. The lower row shows the mean patch area for two roundings, and the cost of a
coarse planarity on the same shapes without rounding.
"""

from __future__ import annotations

import csv
import sys

import matplotlib

matplotlib.use("agg")
matplotlib.rcParams["svg.hashsalt"] = "hullcast"
import matplotlib.pyplot as plt  # noqa: E402

import hullcast  # noqa: E402

ROUNDINGS = ("float32", "6 decimals", "5 decimals", "4 decimals")


def main() -> None:
    source, target = sys.argv[1:]
    with open(source, encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    groups = list(dict.fromkeys(row["group"] for row in rows))

    def line(group: str, rounding: str, column: str) -> tuple[list[float], list[float]]:
        chosen = [row for row in rows if (row["group"], row["rounding"]) == (group, rounding)]
        share = 100 if column in ("whole", "edges lost") else 1
        values = [share * float(row[column]) for row in chosen]
        return [float(row["planarity"]) for row in chosen], values

    figure, axes = plt.subplots(2, 4, figsize=(15, 7), sharex=True, layout="constrained")
    panels = [(rounding, "whole", rounding) for rounding in ROUNDINGS]
    panels += [
        ("6 decimals", "mean area", "6 decimals: mean area / unrounded"),
        ("5 decimals", "mean area", "5 decimals: mean area / unrounded"),
        ("unrounded", "edges lost", "edges above 0.01 rad lost, %"),
        ("unrounded", "error", "largest error of a face / radius"),
    ]
    for axis, (rounding, column, title) in zip(axes.flat, panels, strict=True):
        for group in groups:
            axis.plot(*line(group, rounding, column), marker="o", markersize=3, label=group)
        axis.axvline(hullcast.DEFAULT_PLANARITY, color="black", linewidth=1, linestyle=":")
        axis.set_xscale("log")
        axis.set_title(title, fontsize=10)
        axis.grid(alpha=0.3)
        if column == "whole":
            axis.set_ylim(-3, 105)
        if column == "error":
            axis.set_yscale("log")
            axis.set_ylim(1e-7, 1e-2)
    axes[0, 0].set_ylabel("whole patches, %")
    for axis in axes[1]:
        axis.set_xlabel("planarity, share of the circumradius")
    axes[0, 0].legend(loc="lower left", fontsize=9, title="dotted: the default", title_fontsize=9)
    metadata = {"Date": None} if target.endswith(".svg") else None
    figure.savefig(target, metadata=metadata)  # pyright: ignore[reportUnknownMemberType]


if __name__ == "__main__":
    main()
