"""What ships beside the code: examples that run, stubs that match the contract."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import hullcast

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    ("script", "expected"),
    [
        (["first_contacts.py"], "pairs in contact: [[0, 1], [0, 2]]"),
        (["throughput.py", "--seconds", "0.1"], "resting   several"),
    ],
)
def test_examples_run(script, expected):
    """As a user would run them; what they print is not measured here."""
    done = subprocess.run(
        [sys.executable, str(ROOT / "client/examples" / script[0]), *script[1:]],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**os.environ, "PYTHONPATH": str(Path(hullcast.__file__).parents[1])},
    )
    assert done.returncode == 0, done.stderr
    assert expected in done.stdout


def test_stubs_are_those_of_the_contract(tmp_path):
    """A change of proto/ without `make stubs` would leave the client speaking the old one."""
    pytest.importorskip("grpc_tools")
    subprocess.run(
        [str(ROOT / "scripts/stubs")],
        check=True,
        timeout=120,
        env={**os.environ, "PY": sys.executable, "OUT": str(tmp_path)},
    )
    made = sorted(tmp_path.iterdir())
    assert len(made) == 6
    for file in made:
        checked_in = Path(hullcast.__file__).parent / "_pb" / file.name
        assert file.read_text() == checked_in.read_text(), f"{file.name}: run `make stubs`"
