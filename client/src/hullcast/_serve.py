"""A server of one's own, for as long as the client lives."""

from __future__ import annotations

import contextlib
import importlib.metadata
import json
import os
import shutil
import signal
import subprocess
import tempfile
import threading
import weakref
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from . import _arguments
from ._channel import Settings, service_config
from ._client import Client
from ._errors import InvalidArgument, ServerDidNotStart, ServerNotFound

_LISTENING = "listening on "
_EXIT_SECONDS = 10.0


def serve(
    store: str | os.PathLike[str] | None = None,
    *,
    listen: str = "127.0.0.1:0",
    arguments: Sequence[str] = (),
    timeout: float | None = 60,
    start_timeout: float | None = 30,
) -> Client:
    """Starts a server and returns a client of it.

    The server ends when the client is closed or no longer used, and also when
    this process ends in whatever way, since the server's standard input closes
    then. A forked child may use the client, and does not keep the server alive.

    The binary is the one that the environment variable HULLCAST_BIN names, else
    the package's own, else `hullcast` on PATH.

    Args:
        store: where hulls are kept, a directory or URL; None: in the server's
            memory, until it ends.
        listen: "host:port" (port 0: any free one) or "unix:PATH".
        arguments: further arguments of `hullcast serve`.
        timeout: of the client's calls, as in `connect`.
        start_timeout: seconds until the server must listen; None or infinity: no limit.

    Raises:
        InvalidArgument: naming the argument.
        ServerNotFound: no binary.
        ServerDidNotStart: it ended or was silent.
    """
    # The server is on this machine: a proxy that the environment names is not for it. Once it has
    # ended, it does not come back.
    options = (
        ("grpc.enable_http_proxy", 0),
        ("grpc.service_config", json.dumps(service_config(attempts=2))),
    )
    Settings.of("localhost", None, None, timeout, ())  # refused before a server is started
    server = start(store, listen=listen, arguments=arguments, start_timeout=start_timeout)
    return Client(Settings.of(server.target, None, None, timeout, options), server=server)


def start(
    store: str | os.PathLike[str] | None,
    *,
    listen: str,
    arguments: Sequence[str] = (),
    start_timeout: float | None = 30,
) -> Server:
    """A server that listens; arguments and errors are those of `serve`."""
    if store is None:
        store = "memory://"
    elif not isinstance(store, (str, os.PathLike)) or not os.fspath(store):
        raise InvalidArgument(
            f"expected a directory or a URL, got {_arguments.shown(store)}",
            reason="WRONG_TYPE",
            field="store",
        )
    if not isinstance(listen, str) or ":" not in listen:
        raise InvalidArgument(
            f'expected "host:port" or "unix:PATH", got {_arguments.shown(listen)}',
            reason="NOT_AN_ADDRESS",
            field="listen",
        )
    seconds = _arguments.seconds("start_timeout", start_timeout)
    command = [find_binary(), "serve", "--listen", listen, "--store", os.fspath(store)]
    command += ["--until-stdin-closes", *_words(arguments)]
    # The file has no name: nothing is left of it, however this process ends.
    log = tempfile.TemporaryFile(prefix="hullcast-")  # noqa: SIM115 (it lives with the server)
    try:
        process = subprocess.Popen(
            command, bufsize=0, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log
        )
    except BaseException:
        log.close()
        raise
    server = Server(process, log)
    try:
        server.target = server.wait_until_listening(seconds)
    except BaseException:
        server.close()
        raise
    return server


def _words(arguments: Any) -> list[str]:
    """Arguments of a command line, each a text."""
    expected = 'expected a list of str, such as ["--compute-threads", "4"]'
    if isinstance(arguments, (str, bytes, Mapping)) or not isinstance(arguments, Iterable):
        raise InvalidArgument(
            f"{expected}, got {_arguments.shown(arguments)}", reason="WRONG_TYPE", field="arguments"
        )
    words: list[str] = []
    for i, word in enumerate(arguments):  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
        if not isinstance(word, (str, os.PathLike)) or "\0" in os.fspath(word):  # pyright: ignore[reportUnknownArgumentType]
            raise InvalidArgument(
                f"{expected}, got {_arguments.shown(word)}",
                reason="WRONG_TYPE",
                field="arguments",
                index=i,
            )
        words.append(os.fspath(word))  # pyright: ignore[reportUnknownArgumentType]
    return words


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
            "no hullcast binary: set HULLCAST_BIN to its path, or put it on PATH "
            "(`cargo build --release` in a clone makes target/release/hullcast)",
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
    """The process of a server, and its log."""

    #: The address on its first line.
    target: str

    def __init__(self, process: subprocess.Popen[bytes], log: Any) -> None:
        self._process = process
        self._log = log
        self._owner = os.getpid()
        _servers.add(self)

    @property
    def ended(self) -> bool:
        """Whether the process has ended, by itself or killed."""
        return self.how_it_ended() is not None

    def how_it_ended(self, seconds: float = 0.0) -> str | None:
        """How the process has ended, at most so many seconds from now; None while it runs."""
        if self._owner != os.getpid():  # a forked child cannot wait for its parent's server
            return None
        code = self._process.poll()
        if code is None and seconds:
            with contextlib.suppress(subprocess.TimeoutExpired):
                code = self._process.wait(seconds)
        if code is None:
            return None
        if code >= 0:
            last = self._log_end().rpartition("\n")[2][-300:]
            return f"exit code {code}" + (f": {last}" if last else "")
        with contextlib.suppress(ValueError):
            return f"signal {-code}, {signal.Signals(-code).name}"
        return f"signal {-code}"

    def wait_until_listening(self, seconds: float | None) -> str:
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
        with contextlib.suppress(OSError, ValueError):  # ValueError: closed
            self._log.seek(0)
            return self._log.read()[-2000:].decode(errors="replace").strip()
        return ""

    def close(self, patience: float = _EXIT_SECONDS) -> None:
        """Ends the server: by its standard input, then by force. A forked child ends nothing.

        `patience` is how many seconds the server gets each time, for calls under way.
        """
        if self._owner != os.getpid():
            return
        process = self._process
        for end in (self.let_go, process.terminate, process.kill):
            end()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(patience)
                break
        if process.stdout is not None:
            process.stdout.close()
        self._log.close()

    def forget(self) -> None:
        """Ends the server of a client that nobody has any more, so that no call is under way."""
        self.close(patience=1.0)

    def let_go(self) -> None:
        """Closes this process's end of the server's standard input."""
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()


_servers: weakref.WeakSet[Server] = weakref.WeakSet()


def _after_fork() -> None:
    """A child that holds the standard input open would keep the server alive after its parent."""
    for server in list(_servers):
        server.let_go()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
