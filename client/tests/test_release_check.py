"""Checks `scripts/release-check` on copies of the files that it reads, each with one mistake."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FILES = [
    "Cargo.toml",
    "Cargo.lock",
    "CHANGELOG.md",
    "deploy/chart/Chart.yaml",
    "client/src/hullcast/_version.py",
]


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A copy whose changelog has a release, whatever the repository's has."""
    for name in FILES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text((ROOT / name).read_text())
    (version,) = re.findall(
        r'^\[workspace\.package\]\nversion = "(.*)"$',
        (ROOT / "Cargo.toml").read_text(),
        re.MULTILINE,
    )
    (tmp_path / "CHANGELOG.md").write_text(
        f"# Changelog\n\n## {version} - 2026-01-31\n\n## 0.0.1 - 2025-01-31\n"
    )
    return tmp_path


def check(root: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, ROOT / "scripts/release-check", "--root", root, *options]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def test_the_repository_has_one_version(copy: Path) -> None:
    """Catches a version that was set in some of the files only."""
    done = check(copy, "--any-tree")
    assert done.returncode == 0, done.stderr
    assert "of 2026-01-31: versions and changelog agree" in done.stdout


@pytest.mark.parametrize(
    ("file", "pattern", "new", "said"),
    [
        ("deploy/chart/Chart.yaml", r"^version: .*$", "version: 9.9.9", "Chart.yaml: version 9.9.9, expected"),
        ("deploy/chart/Chart.yaml", r"^appVersion: .*$", 'appVersion: "9.9.9"', "Chart.yaml: version 9.9.9, expected"),
        ("client/src/hullcast/_version.py", r'^__version__.*$', '__version__ = "9.9.9"', "_version.py: version 9.9.9, expected"),
        ("client/src/hullcast/_version.py", r"^__version__.*$", "", "_version.py: no line of the form"),
        ("Cargo.toml", r'^(hullcast-batch = \{ version = )"[^"]*"', r'\1"9.9.9"', "Cargo.toml: version 9.9.9, expected"),
        ("Cargo.toml", r'^(\[workspace\.package\]\nversion = )".*"$', r'\1"1.0"', "Cargo.toml: [workspace.package] has 1.0"),
        ("Cargo.lock", r'^(name = "hullcast-proto"\nversion = )".*"$', r'\1"9.9.9"', "Cargo.lock: version 9.9.9, expected"),
        ("CHANGELOG.md", r"^## .* - 2026.*$", "## Unreleased", "CHANGELOG.md: the first section is 'Unreleased'"),
        ("CHANGELOG.md", r"2026-01-31", "2026-02-30", "is '2026-02-30', expected YYYY-MM-DD"),
        ("CHANGELOG.md", r"2026-01-31", "9999-01-31", "9999-01-31 of"),
    ],
)  # fmt: skip
def test_a_contradiction_is_named(copy: Path, file: str, pattern: str, new: str, said: str) -> None:
    """Catches a check that passes over a mistake, or does not say in which file it is."""
    text = (copy / file).read_text()
    changed, count = re.subn(pattern, new, text, count=1, flags=re.MULTILINE)
    assert count == 1
    (copy / file).write_text(changed)
    done = check(copy, "--any-tree")
    assert done.returncode == 1
    assert said in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_the_commit_is_the_one_that_is_released(copy: Path) -> None:
    """Catches a release of files that no commit has, and a version that was released before."""

    def git(*arguments: str) -> None:
        author = ["-c", "user.name=test", "-c", "user.email=test@localhost"]
        subprocess.run(["git", "-C", copy, *author, *arguments], check=True, capture_output=True)

    git("init", "--quiet")
    git("add", ".")
    git("commit", "--quiet", "--message", "one")
    assert check(copy).returncode == 0
    (copy / "new").touch()
    assert "1 files are not committed, the first of them: ?? new" in check(copy).stderr
    (version,) = re.findall(
        r"^version: (.*)$", (copy / "deploy/chart/Chart.yaml").read_text(), re.MULTILINE
    )
    git("tag", f"v{version}")
    git("add", ".")
    git("commit", "--quiet", "--message", "two")
    assert f"the tag v{version} is on" in check(copy).stderr
