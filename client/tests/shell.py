"""Runs the commands of a page in an empty folder and a clean environment."""

from __future__ import annotations

import os
import re
import signal
import subprocess
from pathlib import Path

from blocks import ROOT
from replicas import free_ports

from hullcast._serve import find_binary


class Shell:
    """Runs one block, line by line.

    A server that a line starts runs until the end of the block. A free port replaces the port of the
    pages, and absolute paths are moved into the empty folder.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "bin").mkdir()
        (folder / "bin/hullcast").symlink_to(Path(find_binary()).resolve())
        (folder / "examples").symlink_to(ROOT / "examples")
        (self._port,) = free_ports(1)
        self._environment = {
            "PATH": f"{folder / 'bin'}:/usr/local/bin:/usr/bin:/bin:/usr/sbin",
            "HOME": str(folder),
            "HULLCAST_LISTEN": f"127.0.0.1:{self._port}",
        }
        self._servers: list[subprocess.Popen[str]] = []

    def run(self, line: str) -> None:
        """Runs a line, once without and once with the part in square brackets."""
        command = line.partition(" #")[0].strip()
        command = command.replace("target/release/hullcast", "hullcast")
        command = command.replace(":50051", f":{self._port}")
        command = re.sub(r"(?<=[\s=])/(?!dev/)(?=\w)", f"{self.folder}/", command)
        optional = re.compile(r"\s\[(.*?)\](?=\s|$)")
        for form in dict.fromkeys((optional.sub("", command), optional.sub(r" \1", command))):
            self._one(form)

    def _one(self, command: str) -> None:
        if command.startswith("hullcast serve"):
            self._serve(command)
            return
        done = subprocess.run(
            ["bash", "-euc", command],
            cwd=self.folder,
            env=self._environment,
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"

    def _serve(self, command: str) -> None:
        log = self.folder / f"server-{len(self._servers)}.log"
        with open(log, "w") as file:
            server = subprocess.Popen(
                ["bash", "-c", f"exec {command}"],
                cwd=self.folder,
                env=self._environment,
                stdout=subprocess.PIPE,
                stderr=file,
                text=True,
            )
        self._servers.append(server)
        assert server.stdout is not None
        assert server.stdout.readline().startswith("listening on "), f"{command}\n{log.read_text()}"

    def __enter__(self) -> Shell:
        return self

    def __exit__(self, *error: object) -> None:
        for server in self._servers:
            server.send_signal(signal.SIGTERM)
        codes = [server.wait(60) for server in self._servers]
        for server in self._servers:
            assert server.stdout is not None
            server.stdout.close()
        assert error[0] is not None or codes == [0] * len(codes), codes


def clean_environment(folder: Path, python: Path | None = None) -> dict[str, str]:
    """The environment of a user's program, without the variables of the tests.

    A program of another environment's `python` finds only that environment's and the system's
    programs.
    """
    if python:
        return {"PATH": f"{python.parent}:/usr/bin:/bin", "HOME": str(folder)}
    kept = {name: os.environ[name] for name in ("PATH", "HULLCAST_BIN") if name in os.environ}
    return {**kept, "HOME": str(folder)}
