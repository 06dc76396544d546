"""What ships beside the code: examples that run, stubs that match the contract."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
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


def test_importing_is_light():
    """Nothing that only an extra needs, and little beside grpc, numpy and protobuf themselves.

    Modules are counted, since times vary.
    """
    program = """
        import sys, grpc, numpy
        from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
        before = set(sys.modules)
        import hullcast
        print(*sorted(set(sys.modules) - before))
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
        env={**os.environ, "PYTHONPATH": str(Path(hullcast.__file__).parents[1])},
    )
    loaded = done.stdout.split()
    assert "hullcast.aio" in loaded
    others = [name for name in loaded if not name.startswith(("hullcast", "google.protobuf"))]
    assert {name.partition(".")[0] for name in others} <= {*sys.stdlib_module_names, "numpy"}
    assert len(others) < 40, others


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
