"""Runs the container image that `scripts/image` writes, by the OCI runtime runc.

A container has the image's user, a read-only root, no capability, and the restrictions of
deploy/hullcast.service as a seccomp filter. It shares the network with the tests, so that they can
reach it on the loopback address.
"""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import os
import re
import subprocess
import tarfile
from contextlib import suppress
from pathlib import Path
from typing import Any, TextIO

ROOT = Path(__file__).resolve().parents[2]
UNIT = (ROOT / "deploy/hullcast.service").read_text()

#: The flags of clone(2) that make namespaces, CLONE_NEWTIME excepted, which clone does not take.
NAMESPACES = 0x7E02_0000
#: PROT_WRITE and PROT_EXEC.
WRITE, EXECUTE = 2, 4
FAMILIES = {"AF_UNIX": 1, "AF_INET": 2, "AF_INET6": 10}


def read(archive: Path) -> tuple[dict[str, Any], bytes]:
    """The configuration and the layer of an image, after a check of every size and digest."""
    with tarfile.open(archive) as file:

        def member(name: str) -> bytes:
            found = file.extractfile(name)
            assert found is not None, name
            return found.read()

        def blob(descriptor: dict[str, Any]) -> bytes:
            data = member(f"blobs/sha256/{descriptor['digest'].removeprefix('sha256:')}")
            assert len(data) == descriptor["size"]
            assert f"sha256:{hashlib.sha256(data).hexdigest()}" == descriptor["digest"]
            return data

        assert json.loads(member("oci-layout")) == {"imageLayoutVersion": "1.0.0"}
        (entry,) = json.loads(member("index.json"))["manifests"]
        manifest = json.loads(blob(entry))
        config = json.loads(blob(manifest["config"]))
        (layer,) = manifest["layers"]
        data = gzip.decompress(blob(layer))
    assert config["rootfs"]["diff_ids"] == [f"sha256:{hashlib.sha256(data).hexdigest()}"]
    return config, data


def unpack(layer: bytes, folder: Path) -> None:
    """Writes the files of a layer, with their owners."""
    with tarfile.open(fileobj=io.BytesIO(layer)) as file:
        file.extractall(folder, numeric_owner=True, filter="fully_trusted")


def specification(root: Path, config: dict[str, Any]) -> dict[str, Any]:
    """What runc needs to know of a container of an image."""
    user, group = (int(number) for number in config["config"]["User"].split(":"))
    quiet = ["nosuid", "nodev", "noexec"]
    return {
        "ociVersion": "1.0.2",
        "root": {"path": str(root), "readonly": True},
        "process": {
            "user": {"uid": user, "gid": group},
            "args": [*config["config"]["Entrypoint"]],
            "env": [*config["config"]["Env"]],
            "cwd": "/",
            "noNewPrivileges": "NoNewPrivileges=yes" in UNIT,
            "capabilities": {},
        },
        "mounts": [
            {"destination": "/proc", "type": "proc", "source": "proc", "options": quiet},
            {"destination": "/dev", "type": "tmpfs", "source": "tmpfs", "options": ["nosuid", "noexec", "mode=755", "size=64k"]},
            {"destination": "/tmp", "type": "tmpfs", "source": "tmpfs", "options": [*quiet, "size=1m"]},
            {"destination": "/sys/fs/cgroup", "type": "cgroup", "source": "cgroup", "options": [*quiet, "ro"]},
        ],
        "linux": {
            "namespaces": [{"type": kind} for kind in ("pid", "mount", "ipc", "uts")],
            "resources": {},
            "seccomp": restrictions(),
        },
    }  # fmt: skip


def restrictions() -> dict[str, Any]:
    """The unit's restrictions of system calls, as seccomp rules. A forbidden call ends the process.

    The groups of names are those of systemd on this machine.
    """
    (group,) = re.findall(r"^SystemCallFilter=(@\S+)$", UNIT, re.MULTILINE)
    allowed = members(group)
    rules: list[dict[str, Any]] = []

    def only(name: str, *conditions: dict[str, Any]) -> None:
        """Allows a call if one of the conditions holds."""
        allowed.discard(name)
        rules.extend(
            {"names": [name], "action": "SCMP_ACT_ALLOW", "args": [condition]}
            for condition in conditions
        )

    def without(bits: int, index: int) -> dict[str, Any]:
        return {"index": index, "value": bits, "valueTwo": 0, "op": "SCMP_CMP_MASKED_EQ"}

    def equal(value: int) -> dict[str, Any]:
        return {"index": 0, "value": value, "op": "SCMP_CMP_EQ"}

    (families,) = re.findall(r"^RestrictAddressFamilies=(.*)$", UNIT, re.MULTILINE)
    only("socket", *(equal(FAMILIES[name]) for name in families.split()))
    if "MemoryDenyWriteExecute=yes" in UNIT:
        only("mmap", without(WRITE, 2), without(EXECUTE, 2))
        for name in ("mprotect", "pkey_mprotect"):
            only(name, without(EXECUTE, 2))
    if "RestrictNamespaces=yes" in UNIT:
        only("clone", without(NAMESPACES, 0))
        allowed -= {"unshare", "setns", "clone3"}
        # The flags of clone3 are in memory, where a filter cannot see them. The C library then calls clone.
        rules.append({"names": ["clone3"], "action": "SCMP_ACT_ERRNO", "errnoRet": 38})
    if "LockPersonality=yes" in UNIT:
        only("personality", equal(0), equal(0xFFFF_FFFF))
    rules.append({"names": sorted(allowed), "action": "SCMP_ACT_ALLOW"})
    return {"defaultAction": "SCMP_ACT_KILL_PROCESS", "architectures": [], "syscalls": rules}  # fmt: skip


def members(group: str) -> set[str]:
    """The system calls of one of systemd's groups, and of the groups in it."""
    command = ["systemd-analyze", "syscall-filter", group]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    names = {line.strip() for line in done.stdout.splitlines()[1:] if line.strip()}
    names = {name for name in names if not name.startswith("#")}
    groups = {name for name in names if name.startswith("@")}
    return (names - groups).union(*(members(name) for name in groups))


class Container:
    """A running container. `lines` of its standard output are read by `line`."""

    def __init__(self, bundle: Path, specification: dict[str, Any]) -> None:
        bundle.mkdir(parents=True, exist_ok=True)
        (bundle / "config.json").write_text(json.dumps(specification))
        self.name = f"hullcast-{os.getpid()}-{bundle.name}"
        self.errors = bundle / "errors"
        with self.errors.open("w") as errors:
            self.process = subprocess.Popen(
                ["runc", "run", "--bundle", str(bundle), self.name],
                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=errors, text=True,
            )  # fmt: skip
        assert self.process.stdout is not None
        self.output: TextIO = self.process.stdout

    def line(self, begin: str) -> str:
        """The rest of the next line, which begins with `begin`."""
        line = self.output.readline().rstrip()
        assert line.startswith(begin), (line, self.errors.read_text())
        return line.removeprefix(begin)

    def pid(self) -> int:
        """The number of the container's first process, outside the container."""
        command = ["runc", "state", self.name]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        return int(json.loads(done.stdout)["pid"])

    def signal(self, name: str) -> None:
        subprocess.run(["runc", "kill", self.name, name], check=True)

    def wait(self, seconds: float) -> int:
        """The exit code; more than 128 is a signal."""
        return self.process.wait(timeout=seconds)

    def __enter__(self) -> Container:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            subprocess.run(
                ["runc", "kill", self.name, "KILL"], check=False, stderr=subprocess.DEVNULL
            )
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(timeout=30)
        subprocess.run(
            ["runc", "delete", "--force", self.name], check=False, stderr=subprocess.DEVNULL
        )
        self.output.close()
