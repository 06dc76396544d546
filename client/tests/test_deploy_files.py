"""Checks deploy/Containerfile and deploy/hullcast.service against the actual server.

Also runs the Slurm job of docs/cluster.md, with one node.

No image is built. The settings in the files are compared with the server's settings.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import hullcast
from hullcast._serve import find_binary

tomllib = pytest.importorskip("tomllib")

ROOT = Path(__file__).resolve().parents[2]
UNIT = ROOT / "deploy/hullcast.service"
CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])

#: The libraries in gcr.io/distroless/cc.
LIBRARIES = {"libc", "libm", "libgcc_s", "libdl", "libpthread", "librt", "ld-linux", "linux-vdso"}


def instructions() -> list[tuple[str, str]]:
    text = (ROOT / "deploy/Containerfile").read_text()
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    return [(word, rest) for word, _, rest in (line.partition(" ") for line in lines)]


def last_stage() -> dict[str, list[str]]:
    said: dict[str, list[str]] = {}
    for word, rest in instructions():
        if word == "FROM":
            said.clear()
        said.setdefault(word, []).append(rest)
    return said


def environment() -> dict[str, str]:
    return dict(pair.split("=", 1) for line in last_stage()["ENV"] for pair in line.split())


def settings(**environment: str) -> dict[str, object]:
    """The server's settings for an environment."""
    done = subprocess.run(
        [find_binary(), "serve", "--print-config"],
        env=os.environ | environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return tomllib.loads(done.stdout)


def test_the_image_is_of_the_server_as_it_is() -> None:
    """Catches paths, ports or users that contradict each other in the Containerfile.

    Also catches a setting or an environment variable that the server does not have.
    """
    said = last_stage()
    build, final = (rest for word, rest in instructions() if word == "FROM")
    assert build.endswith(" AS build")
    assert "distroless/cc" in final
    commands = " ".join(rest for word, rest in instructions() if word == "RUN")
    (profile,) = re.findall(r"--profile (\w+)", commands)
    assert profile in tomllib.loads((ROOT / "Cargo.toml").read_text())["profile"]
    binary, store = (line.split() for line in said["COPY"])
    assert binary == ["--from=build", f"/src/target/{profile}/hullcast", "/usr/local/bin/hullcast"]
    assert said["ENTRYPOINT"] == ['["/usr/local/bin/hullcast", "serve"]']

    (user,) = said["USER"]
    assert not user.startswith(("0", "root"))
    assert store[:2] == ["--from=build", f"--chown={user}"]
    assert f"mkdir {store[2]}" in commands
    known = settings(**environment())
    assert [known["store"]] == [store[3]] == said["VOLUME"]
    ports = [str(known["listen"][0]), str(known["admin_listen"])]
    assert said["EXPOSE"] == [" ".join(address.rpartition(":")[2] for address in ports)]
    assert all(address.startswith("0.0.0.0:") for address in ports)
    # Each variable must change some setting.
    plain = settings()
    for name, value in environment().items():
        assert settings(**{name: value}) != plain, name


@pytest.mark.skipif(not shutil.which("ldd"), reason="no ldd")
def test_the_binary_needs_no_library_that_the_image_lacks() -> None:
    """Catches a dependency that links a system library, because the image has few."""
    done = subprocess.run(["ldd", find_binary()], capture_output=True, text=True, check=True)
    needed = {Path(line.split()[0]).name.split(".so")[0] for line in done.stdout.splitlines()}
    assert {re.sub(r"(ld-linux)-.*", r"\1", name) for name in needed} <= LIBRARIES


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may become another user")
def test_it_serves_as_the_images_user(tmp_path: Path) -> None:
    """Catches a server that needs to be root, or that writes outside its store."""
    user, group = (int(number) for number in last_stage()["USER"][0].split(":"))
    # A directory of root that other users may enter, like the image's root, with the binary in it.
    place = Path(tmp_path.anchor, "tmp", f"hullcast-{os.getpid()}")
    store = place / "store"
    store.mkdir(parents=True)
    try:
        place.chmod(0o755)
        os.chown(store, user, group)
        binary = shutil.copy(find_binary(), place / "hullcast")
        command = [binary, "serve", "--until-stdin-closes", "--allow-plaintext"]
        own = environment() | {"HULLCAST_STORE": str(store)}
        own |= dict.fromkeys(("HULLCAST_LISTEN", "HULLCAST_ADMIN_LISTEN"), "127.0.0.1:0")
        with subprocess.Popen(
            command, env=own, cwd="/", user=user, group=group, extra_groups=[],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        ) as server:  # fmt: skip
            assert server.stdout is not None
            assert server.stdin is not None
            target = server.stdout.readline().strip().removeprefix("listening on ")
            options = [("grpc.enable_http_proxy", 0)]
            with hullcast.connect(target, options=options) as client:
                client.register([CUBE])
            server.stdin.close()
            assert server.wait(timeout=60) == 0
        (blob,) = (path for path in store.rglob("*") if path.is_file())
        assert blob.stat().st_uid == user
    finally:
        shutil.rmtree(place)


def test_the_unit_gives_the_server_its_time() -> None:
    """Catches a unit that kills a draining server, or has a setting unknown to the server."""
    unit = UNIT.read_text()
    (command,) = re.findall(r"^ExecStart=/usr/local/bin/hullcast (.*)$", unit, re.MULTILINE)
    assert command.split()[:2] == ["serve", "--config"]
    known = settings()
    (seconds,) = re.findall(r"^TimeoutStopSec=(\d+)$", unit, re.MULTILINE)
    assert int(seconds) > float(known["grace_seconds"]) + float(known["drain_seconds"])
    (variable, store) = re.findall(r"^Environment=(\w+)=(.*)$", unit, re.MULTILINE)[0]
    assert settings(**{variable: store})["store"] == store
    (directory,) = re.findall(r"^StateDirectory=(.*)$", unit, re.MULTILINE)
    assert store == f"/var/lib/{directory}"


@pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="no systemd")
def test_systemd_knows_every_word_of_the_unit(tmp_path: Path) -> None:
    """Catches a misspelt setting, which systemd ignores without refusing the unit."""

    def verify(text: str) -> str:
        unit = tmp_path / "hullcast.service"
        unit.write_text(text.replace("/usr/local/bin/hullcast", str(find_binary())))
        command = ["systemd-analyze", "verify", "--man=no", str(unit)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
        return "".join(line for line in done.stderr.splitlines() if unit.name in line)

    text = UNIT.read_text()
    assert verify(text) == ""
    assert "NoNewPrivilege" in verify(text.replace("NoNewPrivileges", "NoNewPrivilege"))


SIMULATE = """
import os, sys, hullcast
with hullcast.connect(os.environ["HULLCAST_TARGET"]) as client:
    hulls = client.register([[[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]])
    print("registered", hulls[0].id.hex())
"""


def test_the_slurm_job_runs(tmp_path: Path):
    """Runs the page's script on one node. Catches a job that is refused, that never finds its server,
    or that leaves its server running."""
    page = (ROOT / "docs/cluster.md").read_text()
    (script,) = re.findall(r"```bash\n(#!/bin/bash\n#SBATCH.*?)```", page, re.DOTALL)
    commands = tmp_path / "bin"
    commands.mkdir()
    (commands / "hullcast").symlink_to(Path(find_binary()).resolve())
    (commands / "srun").write_text('#!/bin/sh\nexec "$@"\n')
    (commands / "srun").chmod(0o755)
    (tmp_path / "simulate.py").write_text(SIMULATE)
    (tmp_path / "job").write_text(script)
    environment = os.environ | {
        "PATH": f"{commands}:{Path(sys.executable).parent}:{os.environ['PATH']}",
        "SLURM_SUBMIT_DIR": str(tmp_path),
        "PYTHONPATH": str(Path(hullcast.__file__).parents[1]),
        "TMPDIR": str(tmp_path),
    }
    environment.pop("HULLCAST_LISTEN", None)
    done = subprocess.run(
        ["bash", "job"], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=60
    )
    expected = hullcast.hull_id([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]).hex()
    assert f"registered {expected}" in done.stdout, done.stderr
    (blob,) = (tmp_path / "hulls").glob("*/*")
    assert blob.name == expected
    (scratch,) = tmp_path.glob("tmp.*")
    assert not hullcast_runs(scratch / "hullcast")


def hullcast_runs(socket: Path) -> bool:
    """Whether a process was started with this socket and still is."""
    lines = [p.read_bytes() for p in Path("/proc").glob("[0-9]*/cmdline") if p.exists()]
    return any(f"unix:{socket}".encode() in line for line in lines)
