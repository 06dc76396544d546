"""A server of one's own, for as long as the client lives."""

from __future__ import annotations

import contextlib
import importlib.metadata
import os
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

from ._client import Client
from ._errors import ServerDidNotStart, ServerNotFound

_LISTENING = "listening on "
_EXIT_SECONDS = 10.0


def serve(
    store: str | os.PathLike[str] | None = None,
    *,
    listen: str = "127.0.0.1:0",
    arguments: Sequence[str] = (),
    timeout: float | None = 60,
    start_timeout: float = 30,
) -> Client:
    """Starts a server and returns a client of it.

    The server ends when the client is closed, and also when this process ends
    in whatever way, since its standard input closes then.

    The binary is the one that the environment variable HULLCAST_BIN names, else
    the package's own, else `hullcast` on PATH.

    Args:
        store: where hulls are kept, a directory or URL; None: a directory that is
            removed at the end.
        listen: "host:port" (port 0: any free one) or "unix:PATH".
        arguments: further arguments of `hullcast serve`.
        timeout: of the client's calls, as in `connect`.
        start_timeout: seconds until the server must listen.

    Raises:
        ServerNotFound: no binary.
        ServerDidNotStart: it ended or was silent.
    """
    server = start(store, listen=listen, arguments=arguments, start_timeout=start_timeout)
    # It is on this machine: whatever proxy the environment names is not for it.
    client = Client.connect(server.target, timeout=timeout, options=[("grpc.enable_http_proxy", 0)])
    client._on_close = server.close
    return client


def start(
    store: str | os.PathLike[str] | None,
    *,
    listen: str,
    arguments: Sequence[str] = (),
    start_timeout: float = 30,
) -> Server:
    """A server that listens; arguments and errors are those of `serve`."""
    binary = find_binary()
    scratch = tempfile.mkdtemp(prefix="hullcast-")
    try:
        place = Path(scratch, "store") if store is None else store
        command = [binary, "serve", "--listen", listen, "--store", os.fspath(place)]
        command += ["--until-stdin-closes", *arguments]
        with open(Path(scratch, "log"), "wb") as log:
            process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log
            )
    except BaseException:
        shutil.rmtree(scratch, ignore_errors=True)
        raise
    server = Server(process, scratch)
    try:
        server.target = server.wait_until_listening(start_timeout)
    except BaseException:
        server.close()
        raise
    return server


def find_binary() -> str:
    """The path of the hullcast binary that `serve` starts."""
    named = os.environ.get("HULLCAST_BIN")
    if named:
        if not os.path.isfile(named):
            raise ServerNotFound(f"HULLCAST_BIN names no file: {named}", reason="NO_BINARY")
        return named
    found = _own_binary() or shutil.which("hullcast")
    if found is None:
        raise ServerNotFound(
            "no hullcast binary: set HULLCAST_BIN, or put it on PATH (cargo install hullcast)",
            reason="NO_BINARY",
        )
    return found


def _own_binary() -> str | None:
    """The script that was installed with this package, wherever that put its scripts."""
    name = "hullcast.exe" if os.name == "nt" else "hullcast"
    package = Path(__file__).parent
    places = [package.parent / "bin" / name]  # of `pip install --target`, whose record is wrong
    with contextlib.suppress(importlib.metadata.PackageNotFoundError):
        for file in importlib.metadata.files("hullcast") or ():
            if file.name == name and file.parent.name != package.name:
                places.append(Path(str(file.locate())))
    return next((str(place.resolve()) for place in places if place.is_file()), None)


class Server:
    """The process, and the directory that goes with it."""

    #: The address on its first line.
    target: str

    def __init__(self, process: subprocess.Popen[bytes], scratch: str) -> None:
        self._process = process
        self._scratch = scratch

    @property
    def ended(self) -> bool:
        """Whether the process has, by itself or killed."""
        return self._process.poll() is not None

    def wait_until_listening(self, seconds: float) -> str:
        """The address on the server's first line."""
        line: list[bytes] = []
        assert self._process.stdout is not None
        read = self._process.stdout.readline
        # A thread, since a pipe cannot be waited for with a timeout everywhere.
        reader = threading.Thread(target=lambda: line.append(read()), daemon=True)
        reader.start()
        reader.join(seconds)
        text = line[0].decode(errors="replace").strip() if line else ""
        if not text.startswith(_LISTENING):
            state = "was silent" if not line else f"said {text!r}" if text else "ended"
            raise ServerDidNotStart(
                f"{self._process.args!r} {state}: {self._log_end()}", reason="NOT_LISTENING"
            )
        return text.removeprefix(_LISTENING)

    def _log_end(self) -> str:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(1)  # so that its last words are there
        return Path(self._scratch, "log").read_bytes()[-2000:].decode(errors="replace").strip()

    def close(self) -> None:
        """Ends the server: by its standard input, then by force."""
        process = self._process
        for end in (_close_input(process), process.terminate, process.kill):
            end()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_EXIT_SECONDS)
                break
        if process.stdout is not None:
            process.stdout.close()
        shutil.rmtree(self._scratch, ignore_errors=True)


def _close_input(process: subprocess.Popen[bytes]) -> Callable[[], None]:
    def close() -> None:
        if process.stdin is not None:
            with contextlib.suppress(OSError):
                process.stdin.close()

    return close
