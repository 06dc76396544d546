"""Runs a page of the documentation: its Python code as one program, with its outputs compared."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import not_run
from blocks import blocks_of
from shell import clean_environment

import hullcast

DOCS = Path(__file__).resolve().parents[2] / "docs/python"


def run(page: Path, folder: Path, python: Path | None = None, **environment: str) -> int:
    """Runs a page in an empty folder, asserts its shown outputs, and returns their number.

    The interpreter `python` of another environment uses the hullcast that is installed there. The
    interpreter of the tests uses the one in the sources.
    """
    blocks = [(b.kind, b.text) for b in blocks_of(page) if not not_run.reason(b)]
    program = folder / f"{page.stem.replace('-', '_')}.py"
    program.write_text("\n".join(text for kind, text in blocks if kind == "python"))
    expected = [text for kind, text in blocks if kind == "text"]
    here = {} if python else {"PYTHONPATH": str(Path(hullcast.__file__).parents[1])}
    done = subprocess.run(
        [python or sys.executable, program.name],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        env={**clean_environment(folder, python), **here, **environment},
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "".join(expected)
    return len(expected)
