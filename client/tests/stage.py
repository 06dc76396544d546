"""Runs single blocks of Python in a namespace that has the names that they use."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import not_run
from blocks import Block
from shell import clean_environment

import hullcast

#: Pages whose blocks do not make up one program.
PAGES = ("client/README.md",)

_STAGE = """
import ast, asyncio, inspect, os, sys
import numpy as np
import hullcast

corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.5
vertices_a, vertices_b = corners, corners * 0.8
server = hullcast.serve()

def names():
    client = hullcast.connect(server.target, options=[("grpc.enable_http_proxy", 0)])
    hulls = client.register([vertices_a, vertices_b])
    positions, rotations = np.array([[0, 0, 0], [0, 0, 0.895]]), np.array([[0.0, 0, 0, 1]] * 2)
    scene, pairs = hullcast.Scene(hulls, positions, rotations), [[0, 1]]
    m = client.query(scene, pairs, margin=0.01)
    return {**globals(), **locals()}

def act(text, where):
    text = text.replace("localhost:50051", server.target)
    code = compile(text, where, "exec", flags=ast.PyCF_ALLOW_TOP_LEVEL_AWAIT)
    result = eval(code, names())
    if inspect.isawaitable(result):
        asyncio.run(result)
    print("ran", where)
"""

_ROBOT = """<robot name="panda">
  <link name="panda_link3"><collision><geometry><box size="1 1 1"/></geometry></collision></link>
  <link name="panda_link4"/>
  <link name="panda_link5"><collision><geometry><box size="1 1 1"/></geometry></collision></link>
  <joint name="panda_joint4" type="revolute">
    <parent link="panda_link3"/><child link="panda_link4"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="0" effort="1" velocity="1"/>
  </joint>
  <joint name="fixed" type="fixed"><parent link="panda_link4"/><child link="panda_link5"/></joint>
</robot>
"""


def statements_without_their_package() -> list[str]:
    return [
        statement
        for statement, package in not_run.STATEMENTS.items()
        if importlib.util.find_spec(package) is None
    ]


def run(
    blocks: list[Block],
    folder: Path,
    *,
    before: str = "",
    without: Sequence[str] = (),
    python: Path | None = None,
    **more: str,
) -> None:
    """Runs each block in a fresh namespace, all of them in one process and an empty folder.

    Lines that begin with one of `without` are left out. The interpreter `python` of another
    environment uses the hullcast that is installed there.
    """
    (folder / "panda.urdf").write_text(_ROBOT)
    program = [_STAGE, before]
    for block in blocks:
        lines = block.text.splitlines(keepends=True)
        kept = [line for line in lines if not line.startswith(tuple(without))]
        program.append(f"act({''.join(kept)!r}, {block.where!r})\n")
    (folder / "parts.py").write_text("\n".join(program))
    here = {} if python else {"PYTHONPATH": str(Path(hullcast.__file__).parents[1])}
    environment = {**clean_environment(folder, python), **here, "MPLBACKEND": "agg", **more}
    done = subprocess.run(
        [python or sys.executable, "parts.py"],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("ran ") == len(blocks), done.stdout
