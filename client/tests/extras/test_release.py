"""The files of a release, in the folder that HULLCAST_WHEELS names: `make release-check` builds them."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import installs
import pytest

import hullcast

FOLDER = Path(os.environ.get("HULLCAST_WHEELS", "/nonexistent"))
if not FOLDER.is_dir():
    pytest.skip("only `make release-check` builds the files of a release", allow_module_level=True)
#: The packages that `cargo publish --dry-run` wrote. Cargo may keep a second copy for its own use.
CRATES = {path.name: path for path in FOLDER.parent.glob("package/**/hullcast*.crate")}
#: The oldest C library for which the wheel is built, that of CentOS 7.
PLATFORM = "manylinux_2_17"


def only(pattern: str) -> Path:
    (found,) = FOLDER.glob(pattern)
    return found


def test_the_wheel_is_for_every_linux():
    """Catches a server that needs a newer C library than the wheel's name promises."""
    wheel = only(f"hullcast-{hullcast.__version__}-*.whl")
    assert PLATFORM in wheel.name
    command = [sys.executable, "-m", "auditwheel", "show", wheel]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    said = " ".join(done.stdout.split())
    assert re.search(rf'consistent with the following platform tag: "{PLATFORM}_\w+"', said), said
    assert "constrains the platform tag to" in said, "auditwheel found no program in the wheel"


def test_the_wheel_is_for_every_python():
    """Catches an extension module, which would bind the wheel to versions of Python.

    Without one, abi3audit has nothing to check.
    """
    wheel = only(f"hullcast-{hullcast.__version__}-*.whl")
    assert "-py3-none-" in wheel.name
    with zipfile.ZipFile(wheel) as file:
        assert not [name for name in file.namelist() if name.endswith((".so", ".pyd"))]


def test_the_wheel_runs(tmp_path: Path):
    """Catches a server that the other linker has broken."""
    installs.run_the_readme(
        only(f"hullcast-{hullcast.__version__}-*.whl"), tmp_path, "--only-binary", ":all:"
    )


def test_the_source_distribution_builds(tmp_path: Path):
    """Catches a file that the source distribution lacks.

    It is built in an empty environment, but in the target directory of the repository, where the
    dependencies are compiled already.
    """
    archive = only(f"hullcast-{hullcast.__version__}.tar.gz")
    with tarfile.open(archive) as file:
        names = {name.partition("/")[2] for name in file.getnames()}
    assert {
        "PKG-INFO",
        "LICENSE-MIT",
        "LICENSE-APACHE",
        "Cargo.lock",
        "playground/dist/playground.js",
    } <= names
    assert not [name for name in names if re.search(r"(^|/)(tests|benches|examples|target)/", name)]
    cargo = shutil.which("cargo")
    assert cargo is not None
    installs.run_the_readme(
        archive, tmp_path, "--no-binary", "hullcast", seconds=3000,
        CARGO_TARGET_DIR=str(FOLDER.parent), PATH=f"{Path(cargo).parent}:/usr/bin:/bin",
    )  # fmt: skip


def test_the_crates_are_complete():
    """Catches a crate of another version, without its licence, or with files that only the repository needs."""
    parts = ["hullcast", *(f"hullcast-{part}" for part in ("batch", "client", "contact", "proto"))]
    assert CRATES.keys() == {f"{part}-{hullcast.__version__}.crate" for part in parts}
    for crate in CRATES.values():
        with tarfile.open(crate) as file:
            inside = {name.partition("/")[2] for name in file.getnames()}
        assert {"Cargo.toml", "README.md", "LICENSE-MIT", "LICENSE-APACHE"} <= inside, crate
        others = ("tests/", "client/", "target/", "docs/")
        assert not [name for name in inside if name.startswith(others)], crate


def test_the_licences_of_the_crates_are_there():
    """Catches a release without the texts that must accompany the server's dependencies."""
    text = (FOLDER / "THIRD-PARTY-LICENCES.txt").read_text()
    assert len(text) > 100_000
    for crate in ("tonic", "rustls", "ring", "tokio"):
        assert re.search(rf"^.*\b{crate} \d", text, re.MULTILINE), crate
