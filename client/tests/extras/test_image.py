"""The container image, written by `scripts/image` and run by runc under the systemd unit's restrictions."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from containers import ROOT, Container, read, specification, unpack

import hullcast
from hullcast._serve import find_binary

for tool in ("runc", "systemd-analyze"):
    if not shutil.which(tool):
        pytest.skip(f"no {tool}", allow_module_level=True)
if os.geteuid() != 0:
    pytest.skip("only root may run a container as another user", allow_module_level=True)

USER = 65532
CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
NO_PROXY = [("grpc.enable_http_proxy", 0)]
Start = Callable[..., Container]


def write_image(binary: Path, out: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, ROOT / "scripts/image", "--binary", binary, "--out", out]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """The configuration of an image of the tested server, and the folder of its files."""
    folder = tmp_path_factory.mktemp("image")
    done = write_image(Path(find_binary()).resolve(), folder / "image.tar")
    assert done.returncode == 0, done.stderr
    config, layer = read(folder / "image.tar")
    unpack(layer, folder / "root")
    return config, folder / "root"


@pytest.fixture
def start(image: tuple[dict[str, Any], Path], tmp_path: Path) -> Iterator[Start]:
    """Starts containers whose volume is `tmp_path / "volume"`."""
    config, root = image
    volume = tmp_path / "volume"
    volume.mkdir()
    os.chown(volume, USER, USER)
    with ExitStack() as stack:

        def run(*arguments: str, memory: int = 0, **environment: str) -> Container:
            made = specification(root, config)
            # The port of another test may be taken, so the system chooses.
            environment = (
                dict.fromkeys(("HULLCAST_LISTEN", "HULLCAST_ADMIN_LISTEN"), "127.0.0.1:0")
                | environment
            )
            made["process"]["env"] += [f"{name}={value}" for name, value in environment.items()]
            made["process"]["args"] += arguments
            (store,) = config["config"]["Volumes"]
            made["mounts"].append(
                {
                    "destination": store,
                    "type": "bind",
                    "source": str(volume),
                    "options": ["rbind", "rw"],
                }
            )
            if memory:
                made["linux"]["resources"]["memory"] = {"limit": memory}
            return stack.enter_context(Container(tmp_path / f"bundle{time.monotonic_ns()}", made))

        yield run


def get(url: str) -> tuple[int, str]:
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    try:
        with opener.open(url, timeout=30) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def contact(target: str) -> tuple[bool, bytes]:
    """Whether two cubes that overlap are in contact, and the id of the cube."""
    with hullcast.connect(target, options=NO_PROXY) as client:
        (cube,) = client.register([CUBE])
        upright = [[0, 0, 0, 1]] * 2
        scene = hullcast.Scene([cube, cube], [[0, 0, 0], [0.9, 0, 0]], upright)
        answer = client.query(scene, [(0, 1)])
    return bool(answer.outcome[0] == "contact"), cube.id


def test_the_archive_is_the_image_of_the_container_file(tmp_path: Path) -> None:
    """Catches an archive that changes from build to build, and files that anybody may change.

    `read` checks sizes and digests. The program is a small one, since only the archive is compared.
    """
    program = Path(shutil.copy("/bin/true", tmp_path / "hullcast"))
    for name in ("one", "two"):
        done = write_image(program, tmp_path / name)
        assert done.returncode == 0, done.stderr
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()
    config, layer = read(tmp_path / "one")
    assert config["config"]["User"] == f"{USER}:{USER}"
    assert config["config"]["StopSignal"] == "SIGTERM"
    with tarfile.open(fileobj=BytesIO(layer)) as file:
        entries = {f"/{entry.name}": entry for entry in file}
        assert file.extractfile("usr/local/bin/hullcast").read() == program.read_bytes()  # type: ignore[union-attr]
    assert {path for path, entry in entries.items() if entry.uid == USER} == set(
        config["config"]["Volumes"]
    )
    assert [path for path, entry in entries.items() if entry.mode & 0o022] == ["/tmp"]
    assert not [path for path, entry in entries.items() if entry.mode & 0o6000]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "no such file"),
        (b"#!/bin/sh\n", "not a 64-bit ELF program"),
        (b"\x7fELF\x02\x01" + bytes(12) + b"\x02\x00", "ELF machine 2; expected amd64, arm64"),
    ],
)
def test_a_file_that_is_no_server_makes_no_image(
    tmp_path: Path, content: bytes | None, said: str
) -> None:
    """Catches an image that cannot start, for example of a script or for another machine."""
    file = tmp_path / "hullcast"
    if content is not None:
        file.write_bytes(content)
    done = write_image(file, tmp_path / "image.tar")
    assert done.returncode == 1
    assert f"--binary {file}: " in done.stderr
    assert said in done.stderr
    assert not (tmp_path / "image.tar").exists()


def test_the_image_serves(start: Start, tmp_path: Path) -> None:
    """Catches an image that lacks a library, needs to be root, needs to write to its root, calls the
    system in a way that the unit forbids, or does not stop in time."""
    with start("--playground") as container:
        target = container.line("listening on ")
        admin = container.line("admin on ")
        page = container.line("playground at ")
        assert get(f"http://{admin}/livez") == (200, "live\n")
        while get(f"http://{admin}/readyz") == (503, "starting\n"):
            time.sleep(0.01)
        assert get(f"http://{admin}/readyz") == (200, "ready\n")
        found, cube = contact(target)
        assert found
        assert "playground.js" in get(page)[1]
        with hullcast.connect(target, options=NO_PROXY) as client:
            assert client.ping() < 30

        status = Path(f"/proc/{container.pid()}/status").read_text().splitlines()
        fields = {
            name: value.split() for name, _, value in (line.partition(":") for line in status)
        }
        assert fields["Uid"] == [str(USER)] * 4
        assert fields["Gid"] == [str(USER)] * 4
        assert {fields[name][0] for name in ("CapPrm", "CapEff", "CapBnd", "CapAmb")} == {"0" * 16}
        assert (fields["NoNewPrivs"], fields["Seccomp"]) == (["1"], ["2"])
        mounts = [
            line.split()
            for line in Path(f"/proc/{container.pid()}/mountinfo").read_text().splitlines()
        ]
        writable = {fields[4] for fields in mounts if "rw" in fields[5].split(",")}
        assert writable >= {"/tmp", "/var/lib/hullcast"}
        for path in writable - {"/tmp", "/var/lib/hullcast"}:
            found = Path(f"/proc/{container.pid()}/root{path}").stat()
            assert found.st_uid == 0, path
            assert not found.st_mode & 0o022, path

        # The server waits `grace_seconds` in which it says that it is not ready, and then for calls.
        begun = time.monotonic()
        container.signal("TERM")
        while get(f"http://{admin}/readyz")[0] == 200:
            assert time.monotonic() - begun < 2
        assert get(f"http://{admin}/livez")[0] == 200
        assert container.wait(20) == 0
        assert time.monotonic() - begun >= 3
    blobs = [path for path in (tmp_path / "volume").rglob("*") if path.is_file()]
    assert [(path.name, path.stat().st_uid) for path in blobs] == [(cube.hex(), USER)]

    # A new container with the same volume has the hulls.
    with (
        start() as container,
        hullcast.connect(container.line("listening on "), options=NO_PROXY) as client,
    ):
        assert [hull.id for hull in client.hulls()] == [cube]


def test_the_root_is_read_only(start: Start) -> None:
    """Catches a container whose server could replace its own program or its certificates."""
    container = start("--store", "/usr/local/bin/hulls")
    assert container.wait(60) != 0
    assert "Read-only file system" in container.errors.read_text()


@pytest.mark.parametrize(
    ("memory", "limits"),
    [
        (2 << 30, {}),
        # As in docs/budget.md and deploy/chart/ci/secured-values.yaml.
        (
            1 << 30,
            {"HULLCAST_MAX_MESSAGE_BYTES": "16MiB", "HULLCAST_MAX_POINTS_PER_HULL": "100000"},
        ),
    ],
)
def test_budgets_are_shares_of_the_containers_memory(
    start: Start, memory: int, limits: dict[str, str]
) -> None:
    """Catches a server that computes a percentage of the machine's memory, not of its container's."""
    budgets = {"HULLCAST_MAX_MEMORY_BYTES": "50%", "HULLCAST_CACHE_BYTES": "25%"}
    container = start(memory=memory, **budgets, **limits)
    target = container.line("listening on ")
    with hullcast.connect(target, options=NO_PROXY) as client:
        limits_of_it = client.info().limits
    assert limits_of_it["max_memory_bytes"] == memory // 2
    assert limits_of_it["cache_bytes"] == memory // 4


def test_a_container_that_is_too_small_is_refused(start: Start) -> None:
    """Catches a server that starts with a budget too small for its limits. The chart knows the number too."""
    container = start(memory=1 << 30, HULLCAST_MAX_MEMORY_BYTES="50%", HULLCAST_CACHE_BYTES="25%")
    assert container.wait(60) == 2
    said = container.errors.read_text()
    assert "--max-memory-bytes is 512 MiB" in said
    (least,) = re.findall(
        r"lt \(int \$budget\) (\d+)", (ROOT / "deploy/chart/templates/_helpers.tpl").read_text()
    )
    assert f"{least} MiB" in said, said


@pytest.mark.parametrize(
    ("program", "code"),
    [
        ("import socket; socket.socket(socket.AF_INET).close()", 0),
        ("import socket; socket.socket(socket.AF_NETLINK, socket.SOCK_RAW)", 159),
        ("import mmap; mmap.mmap(-1, 4096, prot=mmap.PROT_READ | mmap.PROT_EXEC)", 0),
        ("import mmap; mmap.mmap(-1, 4096, prot=mmap.PROT_WRITE | mmap.PROT_EXEC)", 159),
        ("import threading; threading.Thread(target=print).start()", 0),
        ("import ctypes; ctypes.CDLL(None).unshare(0x10000000)", 159),
        ("import ctypes; ctypes.CDLL(None).reboot(0)", 159),
    ],
)
def test_the_restrictions_restrict(tmp_path: Path, program: str, code: int) -> None:
    """Catches a filter that allows everything, with which the test of the server would show nothing.

    The program runs in this machine's files under the same restrictions. 159 is 128 and SIGSYS.
    """
    root = tmp_path / "root"
    made = specification(
        root,
        {"config": {"User": f"{USER}:{USER}", "Entrypoint": [], "Env": ["PATH=/usr/bin:/bin"]}},
    )
    for folder in ("/usr", "/lib", "/lib64", "/etc", "/proc", "/dev", "/tmp", "/sys/fs/cgroup"):
        (root / folder[1:]).mkdir(parents=True)
        if folder in ("/usr", "/lib", "/lib64", "/etc"):
            made["mounts"].append(
                {
                    "destination": folder,
                    "type": "bind",
                    "source": folder,
                    "options": ["rbind", "ro"],
                }
            )
    made["process"]["args"] = [str(Path("/usr/bin/python3").resolve()), "-c", program]
    with Container(tmp_path / "bundle", made) as container:
        assert container.wait(60) == code, container.errors.read_text()
