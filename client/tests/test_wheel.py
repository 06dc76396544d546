"""The wheel as a user gets it, with client and server, in an environment of its own."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import installs
import pytest

import hullcast

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """A wheel that is built from the same objects as the tested binary, so within seconds."""
    pytest.importorskip("maturin")
    out = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "maturin", "build", "--profile", "release", "--out", str(out)]
    done = subprocess.run(
        command, cwd=ROOT / "client", capture_output=True, text=True, timeout=900, check=False
    )
    assert done.returncode == 0, done.stderr
    (made,) = out.iterdir()
    return made


def test_what_the_wheel_has(wheel):
    """The wheel has the package with types and stubs, the server and the licences, and no tests."""
    with zipfile.ZipFile(wheel) as file:
        names = file.namelist()
        (metadata,) = (name for name in names if name.endswith(".dist-info/METADATA"))
        text = file.read(metadata).decode()
    sources = (ROOT / "client/src").rglob("*.py*")
    expected = {str(p.relative_to(ROOT / "client/src")) for p in sources if p.suffix != ".pyc"}
    assert {name for name in names if name.startswith("hullcast/")} >= expected
    (server,) = (name for name in names if ".data/scripts/" in name)
    assert server.rpartition("/")[2] == "hullcast"
    assert {n.rpartition("/")[2] for n in names if "/licenses/" in n} == {
        "LICENSE-MIT",
        "LICENSE-APACHE",
    }
    assert not [name for name in names if name.endswith(".rs") or "test" in name]
    assert f"\nVersion: {hullcast.__version__}\n" in text
    assert "\nRequires-Python: >=3.10\n" in text
    for extra in ("mesh", "robot", "decompose", "plot", "rerun", "ray"):
        assert f"\nProvides-Extra: {extra}\n" in text


def test_the_wheel_alone_runs_the_readmes_program(wheel, tmp_path):
    """The wheel works in an empty environment with the newest packages, without anything from here."""
    installs.run_the_readme(wheel, tmp_path, "--only-binary", ":all:")
