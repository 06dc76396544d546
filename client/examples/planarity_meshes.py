"""Writes the hulls of real meshes to a scene file, for `make planarity`.

    python client/examples/planarity_meshes.py out/meshes.json

The meshes come from the package example-robot-data. In a fixed random order, the first 150 meshes
are taken whose hulls are distinct and have at most 600 vertices.
"""

from __future__ import annotations

import json
import random
import sys
import sysconfig
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError

ROBOTS = Path(sysconfig.get_path("purelib")) / "cmeel.prefix/share/example-robot-data/robots"
COUNT = 150
MOST_VERTICES = 600


def main() -> None:
    files = sorted(path for path in ROBOTS.rglob("*") if path.suffix.lower() in (".stl", ".obj"))
    if not files:
        raise SystemExit(f"no meshes in {ROBOTS}: pip install -r client/requirements-planarity.txt")
    random.Random(18).shuffle(files)
    hulls: dict[bytes, dict[str, object]] = {}
    for file in files:
        mesh: Any = trimesh.load_mesh(file)  # pyright: ignore[reportUnknownMemberType]
        points = np.asarray(mesh.vertices, dtype=float)
        try:
            corners = points[ConvexHull(points).vertices]
        except QhullError:
            continue  # a flat mesh
        if len(corners) <= MOST_VERTICES:
            name = str(file.relative_to(ROBOTS))
            hulls[corners.tobytes()] = {"name": name, "vertices": corners.tolist()}
        if len(hulls) == COUNT:
            break
    scene = {
        "format": "hullcast.scene.v1",
        "name": "meshes",
        "hulls": list(hulls.values()),
        "bodies": [],
        "pairs": [],
    }
    Path(sys.argv[1]).write_text(json.dumps(scene), encoding="utf-8")


if __name__ == "__main__":
    main()
