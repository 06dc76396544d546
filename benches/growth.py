"""Plots docs/growth.csv, which `cargo run --bin growth` writes, as docs/growth.svg."""

import csv
import pathlib

import matplotlib

matplotlib.use("svg")
matplotlib.rcParams["svg.hashsalt"] = "hullcast"
import matplotlib.pyplot as plt  # noqa: E402

DOCS = pathlib.Path(__file__).parent.parent / "docs"
PANELS = {
    "vertices a hull": ["manifold, cold", "manifold, warm", "building a hull"],
    "pairs in a query": ["a query through the server"],
    "hulls registered": ["a pair, hulls drawn from those registered"],
}

lines = {}
with open(DOCS / "growth.csv") as file:
    for row in csv.DictReader(file):
        lines.setdefault(row["what"], []).append((float(row["size"]), float(row["value"]) / 1e3))

figure, axes = plt.subplots(1, len(PANELS), figsize=(13, 4), layout="constrained")
for axis, (size, names) in zip(axes, PANELS.items(), strict=True):
    for name in names:
        axis.loglog(*zip(*lines[name], strict=True), marker="o", markersize=3, label=name)
    axis.set_xlabel(size)
    axis.set_ylabel("microseconds")
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)
axes[2].set_ylim(bottom=0.1, top=10)
figure.savefig(DOCS / "growth.svg", metadata={"Date": None})
