"""A target of make fails if a tool is missing, and says which one and how to install it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from blocks import ROOT

#: For each tool of scripts/check-tools: the commands that are hidden, and a part of the message.
TOOLS = {
    "chromium": (["chromium", "chromium-browser", "google-chrome"], "apt-get install chromium"),
    "npm": (["npm"], "apt-get install npm"),
    "go": (["go"], "https://go.dev/doc/install"),
    "haproxy": (["haproxy"], "apt-get install haproxy"),
    "nginx": (["nginx"], "apt-get install nginx-light"),
    "ip": (["ip"], "apt-get install iproute2"),
    "unshare": (["unshare"], "apt-get install util-linux"),
    "runc": (["runc"], "apt-get install runc"),
    "systemd-analyze": (["systemd-analyze"], "apt-get install systemd"),
    "valgrind": (["valgrind"], "apt-get install valgrind"),
    "rustfmt": (["cargo"], "rustup component add rustfmt"),
    "clippy": (["cargo"], "rustup component add clippy"),
    "cxx": (["c++"], "apt-get install g++"),
    "nightly": (["cargo"], "rustup toolchain install nightly"),
    "cargo-fuzz": (["cargo-fuzz"], "cargo install cargo-fuzz"),
    "deny": (["cargo-deny", "python3"], "make audit"),
    "python3.11": (["python3"], "make PYTHON=python3.11"),
    "root": (["id"], "run this target as root"),
}
MAKEFILE = (ROOT / "Makefile").read_text()
NEEDS = re.findall(r"^([a-z][\w -]*): NEEDS := (.*)$", MAKEFILE, re.MULTILINE)


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment of a machine without the tools above and without root's rights."""
    folder = tmp_path_factory.mktemp("bin")
    (folder / "id").write_text("#!/bin/sh\necho 1000\n")
    (folder / "id").chmod(0o755)
    taken = {"id", *(command for commands, _ in TOOLS.values() for command in commands)}
    for place in [*os.get_exec_path(), "/usr/sbin", "/sbin"]:
        for program in Path(place).iterdir() if Path(place).is_dir() else ():
            link = folder / program.name
            if program.name not in taken and not link.is_symlink():
                link.symlink_to(program)
    return {**os.environ, "PATH": str(folder), "HOME": str(folder)}


@pytest.fixture(scope="module")
def script(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of scripts/check-tools that searches only PATH and not the system's folders."""
    copy = tmp_path_factory.mktemp("tools") / "scripts/check-tools"
    copy.parent.mkdir()
    text = (ROOT / "scripts/check-tools").read_text()
    assert ":/usr/sbin:/sbin" in text
    copy.write_text(text.replace(":/usr/sbin:/sbin", ""))
    (copy.parents[1] / "Cargo.toml").write_text((ROOT / "Cargo.toml").read_text())
    return copy


@pytest.mark.parametrize("tool", TOOLS)
def test_a_tool_that_is_missing_is_named(tool, script, bare):
    """Catches a tool whose message lacks the way to install it."""
    _, how = TOOLS[tool]
    shell = shutil.which("bash") or "bash"
    done = subprocess.run(
        [shell, script, tool], env=bare, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1, done
    assert re.search(rf"^missing: .*{re.escape(how)}", done.stderr, re.MULTILINE), done.stderr


def test_every_tool_that_a_target_needs_is_known():
    """Catches a name that check-tools does not know, and a tool that is not tested or not needed."""
    needed = {name for _, names in NEEDS for name in re.findall(r"[a-z][\w.-]+", names)}
    assert needed - {"if"} == set(TOOLS)
    assert len(NEEDS) > 9


@pytest.mark.parametrize(
    ("target", "missing"),
    [
        ("test-playground", "Chromium"),
        ("playground", "npm"),
        ("test-tools", "Go"),
        ("fuzz", "cargo-fuzz"),
    ],
)
def test_a_target_fails_before_anything_is_built(target, missing, bare):
    environment = {name: value for name, value in bare.items() if name != "AVAILABLE"}
    tools = [f"PYTHON={sys.executable}", f"CARGO={shutil.which('cargo')}"]
    done = subprocess.run(
        ["make", *tools, target],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    assert f"missing: {missing}" in done.stderr
    assert "build" not in done.stdout
    assert "pytest" not in done.stdout


def test_skipped_tests_fail_the_targets_that_are_about_them(tmp_path):
    """Catches a `make test-playground` that succeeds although every test was skipped."""
    shutil.copy(ROOT / "client/tests/conftest.py", tmp_path / "conftest.py")
    (tmp_path / "test_it.py").write_text(
        "import pytest\n\n\ndef test_a():\n    pass\n\n\n"
        "@pytest.mark.skipif(True, reason='Chromium is not installed')\ndef test_b():\n    pass\n"
    )
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}/client/src:{ROOT}/client/tests"}
    for options, code in (([], 0), (["--no-skips"], 1), (["--no-skips", "-k", "test_a"], 0)):
        command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *options, "test_it.py"]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == code, (options, done.stdout, done.stderr)


def test_the_targets_that_need_something_forbid_skips():
    """Catches a target that runs tests of `extras/` and accepts skipped ones."""
    (forbidding,) = re.findall(
        r"^(test-[\w -]+): \\\n  export PYTEST_ADDOPTS", MAKEFILE, re.MULTILINE
    )
    targets = re.findall(
        r"^([\w-]+):.*##.*\n(?:\t.*\n)*?\t.*pytest .*client/tests/extras", MAKEFILE, re.MULTILINE
    )
    assert len(targets) > 5
    assert set(targets) == set(forbidding.split())
