"""Plots of the measured figures, and short animations seen from the side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw
from scenes import Setup
from scipy.spatial import ConvexHull

COLOURS = ["#4c78a8", "#f58518", "#54a24b", "#e45756", "#72b7b2", "#b279a2"]
SIZE = (300, 240)

Picture = Image.Image


@dataclass
class Row:
    """The figures of one run."""

    scene: str
    variant: str
    sweeps: int
    #: Metres.
    drift: float
    #: Millijoules per kilogram.
    jitter: float
    #: Millimetres.
    depth: float
    contacts: float
    contact_ms: float
    solver_ms: float


def frame(
    setup: Setup, positions: npt.NDArray[np.float64], turned: npt.NDArray[np.float64], title: str
) -> Picture:
    """A picture of the bodies as seen along y, the farthest bodies drawn first."""
    low, high = VIEWS[setup.name]
    scale = min(SIZE[0] / (high[0] - low[0]), SIZE[1] / (high[1] - low[1]))
    picture = Image.new("RGB", SIZE, "white")
    pen = ImageDraw.Draw(picture)
    order: list[int] = np.argsort(-positions[:, 1]).tolist()
    for body in order:
        corners = (setup.shapes[body] @ turned[body].T + positions[body])[:, [0, 2]]
        outline = corners[ConvexHull(corners).vertices]
        at = np.stack(
            [(outline[:, 0] - low[0]) * scale, SIZE[1] - (outline[:, 1] - low[1]) * scale], axis=1
        )
        fill = "#dddddd" if body < setup.fixed else COLOURS[body % len(COLOURS)]
        pen.polygon([(x, y) for x, y in at.tolist()], fill=fill, outline="#333333")
    pen.text((6, 4), title, fill="black")
    return picture


#: Smaller values are drawn at this value, because they are rounding errors.
LEAST = 1e-7
#: The visible range of each scene: the lowest and the highest x and z.
VIEWS = {
    "tower": ((-3.4, -0.3), (3.4, 5.3)),
    "wall": ((-0.6, -0.2), (3.7, 2.4)),
    "arch": ((-1.9, -0.2), (1.9, 2.0)),
    "pile": ((-2.6, -0.2), (2.6, 3.4)),
    "rocking": ((-1.0, -0.1), (1.0, 1.4)),
}


def animate(left: Sequence[Picture], right: Sequence[Picture], path: Path, seconds: float) -> None:
    """Writes an animation with two runs side by side."""
    pictures: list[Picture] = []
    for a, b in zip(left, right, strict=True):
        both = Image.new("RGB", (2 * SIZE[0], SIZE[1]), "white")
        both.paste(a, (0, 0))
        both.paste(b, (SIZE[0], 0))
        pictures.append(both.quantize(32, dither=Image.Dither.NONE))
    pictures[0].save(
        path,
        save_all=True,
        append_images=pictures[1:],
        duration=int(1000 * seconds),
        loop=0,
        optimize=True,
    )


def plot(rows: Sequence[Row], path: Path) -> None:
    """Plots drift, jitter and depth against the number of sweeps, with one column per scene."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    plt: Any = pyplot
    scenes = list(dict.fromkeys(row.scene for row in rows))
    variants = list(dict.fromkeys(row.variant for row in rows))
    sweeps = sorted({row.sweeps for row in rows})
    names = {"drift": "drift, m", "jitter": "jitter, mJ/kg", "depth": "depth, mm"}
    figure, axes = plt.subplots(
        3, len(scenes), figsize=(2.7 * len(scenes), 7), sharex=True, squeeze=False
    )
    for j, scene in enumerate(scenes):
        axes[0, j].set_title(scene)
        for i, (key, label) in enumerate(names.items()):
            axis = axes[i, j]
            for variant in variants:
                some = [row for row in rows if (row.scene, row.variant) == (scene, variant)]
                values = [max(getattr(row, key), LEAST) for row in some]
                axis.plot([row.sweeps for row in some], values, "o-", ms=3, label=variant)
            axis.set(xscale="log", yscale="log")
            axis.set_xticks(sweeps, sweeps)
            axis.set_xticks([], minor=True)
            axis.grid(alpha=0.3)
            if j == 0:
                axis.set_ylabel(label)
        axes[2, j].set_xlabel("sweeps a step")
    axes[0, -1].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(path, metadata={"Date": None})
