"""Runs a page of the documentation: its Python code as one program, with its outputs compared."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import hullcast

DOCS = Path(__file__).resolve().parents[2] / "docs/python"
_BLOCK = re.compile(r"^```(python|text)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def run(page: Path, folder: Path) -> int:
    """Runs a page in a folder, asserts its shown outputs, and returns their number."""
    blocks = _BLOCK.findall(page.read_text())
    program = folder / f"{page.stem.replace('-', '_')}.py"
    program.write_text("\n".join(text for kind, text in blocks if kind == "python"))
    expected = [text for kind, text in blocks if kind == "text"]
    done = subprocess.run(
        [sys.executable, program.name],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**os.environ, "PYTHONPATH": str(Path(hullcast.__file__).parents[1])},
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "".join(expected)
    return len(expected)
