"""Starts a server process that lives as long as its client."""

from __future__ import annotations

import contextlib
import difflib
import importlib.metadata
import json
import os
import shutil
import signal
import subprocess
import tempfile
import threading
import weakref
from collections.abc import Mapping, Sequence
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
    """Starts a server on this machine and returns a client of it.

    The server ends when the client is closed or garbage collected. It also ends when this process
    ends in any way, because the server's standard input is closed then. A forked child process may
    use the client, but does not keep the server alive.

    The server's binary is the one that the environment variable HULLCAST_BIN names; otherwise the
    one installed with this package; otherwise `hullcast` on PATH.

    Args:
        store: where hulls are stored, a directory or a URL; None keeps them in the server's memory
            until it ends.
        listen: "host:port", where port 0 stands for any free port; or "unix:PATH".
        arguments: further arguments of `hullcast serve`.
        timeout: the default timeout of the client's calls, as in `connect`.
        start_timeout: the seconds within which the server must listen; None or infinity for no
            limit.

    Returns:
        A client of the server. Closing the client ends the server.

    Raises:
        InvalidArgument: an argument is not usable; the error names it.
        ServerNotFound: there is no binary.
        ServerDidNotStart: the binary cannot be run, or the server exited, or did not listen in
            time.
    """
    # The server is on this machine, so do not use the proxy that the environment may name. A server
    # that has ended does not come back, so one retry is enough.
    options = (
        ("grpc.enable_http_proxy", 0),
        ("grpc.service_config", json.dumps(service_config(attempts=2))),
    )
    Settings.of("localhost", None, None, timeout, ())  # check `timeout` before the server starts
    server = start(store, listen=listen, arguments=arguments, start_timeout=start_timeout)
    return Client(Settings.of(server.target, None, None, timeout, options), server=server)


def start(
    store: str | os.PathLike[str] | None,
    *,
    listen: str,
    arguments: Sequence[str] = (),
    start_timeout: float | None = 30,
) -> Server:
    """Starts a server and waits until it listens; arguments and errors are those of `serve`."""
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
    # The log file has no name, so nothing is left of it however this process ends.
    log = tempfile.TemporaryFile(prefix="hullcast-")  # noqa: SIM115 (it lives with the server)
    try:
        # A terminal and a notebook interrupt all processes of a session. The server ends with its
        # standard input instead, so that an interrupted cell does not end it.
        process = subprocess.Popen(
            command,
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log,
            start_new_session=True,
        )
    except OSError as error:  # such as a binary for another kind of machine, or a text file
        log.close()
        raise ServerDidNotStart(
            f"{command[0]} cannot be run ({error.strerror}): expected the hullcast program for "
            "this machine",
            reason="NOT_RUNNABLE",
        ) from None
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
    """Checks further arguments of the command line, and returns them as strings."""
    expected = 'expected a list of str, such as ["--compute-threads", "4"]'
    _arguments.ordered("arguments", arguments)
    if isinstance(arguments, (str, bytes, Mapping)) or not _arguments.iterable(arguments):
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
    """The path of the hullcast binary that `serve` starts.

    Raises:
        ServerNotFound: there is no binary.
    """
    named = os.environ.get("HULLCAST_BIN")
    if named:
        what = ""
        if os.path.isdir(named):
            what = "is a directory"
        elif not os.path.exists(named):
            what = "does not exist"
        elif not os.path.isfile(named):
            what = "is not a file"
        elif not os.access(named, os.X_OK):
            what = "is not executable (chmod +x makes it so)"
        if what:
            raise ServerNotFound(
                f"HULLCAST_BIN is {named!r}, which {what}: expected the path of the hullcast "
                "program",
                reason="NO_BINARY",
            )
        return os.path.abspath(named)
    similar = _similar_variable("HULLCAST_BIN")
    found = _own_binary() or shutil.which("hullcast")
    if found is None:
        raise ServerNotFound(
            "no hullcast binary: set HULLCAST_BIN to its path, or put it on PATH "
            "(`cargo build --release` in a clone makes target/release/hullcast)"
            + (f". The variable {similar} is not read" if similar else ""),
            reason="NO_BINARY",
        )
    return found


def _similar_variable(name: str) -> str | None:
    """An environment variable whose name is like `name`; None without one."""
    others = [other for other in os.environ if other != name and other.startswith("HULL")]
    return next(iter(difflib.get_close_matches(name, others, n=1, cutoff=0.7)), None)


def _own_binary() -> str | None:
    """The path of the `hullcast` script that was installed with this package, or None."""
    name = "hullcast.exe" if os.name == "nt" else "hullcast"
    package = Path(__file__).parent
    places = [package.parent / "bin" / name]  # `pip install --target` records another path
    with contextlib.suppress(importlib.metadata.PackageNotFoundError):
        for file in importlib.metadata.files("hullcast") or ():
            if file.name == name and file.parent.name != package.name:
                places.append(Path(str(file.locate())))
    return next((str(place.resolve()) for place in places if place.is_file()), None)


class Server:
    """A server process and its log file."""

    #: The address that the server prints on its first line.
    target: str

    def __init__(self, process: subprocess.Popen[bytes], log: Any) -> None:
        self._process = process
        self._log = log
        self._owner = os.getpid()
        _servers.add(self)

    @property
    def ended(self) -> bool:
        """Whether the process has ended, by itself or by a signal."""
        return self.how_it_ended() is not None

    def how_it_ended(self, seconds: float = 0.0) -> str | None:
        """How the process ended, if it ends within `seconds` from now; None if it still runs."""
        if self._owner != os.getpid():  # a forked child cannot wait for its parent's process
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
        """Waits for the server's first line, and returns the address in it."""
        line: list[bytes] = []
        assert self._process.stdout is not None
        read = self._process.stdout.readline
        # A thread reads the line, because not every system can wait for a pipe with a timeout.
        reader = threading.Thread(target=lambda: line.append(read()), daemon=True)
        reader.start()
        reader.join(seconds)
        text = line[0].decode(errors="replace").strip() if line else ""
        if not text.startswith(_LISTENING):
            state = (
                f"did not listen within {seconds:g} s, the start_timeout"
                if not line and seconds is not None
                else f"printed {text!r} instead of its address"
                if text
                else "ended before it listened"
            )
            raise ServerDidNotStart(
                f"{self._process.args!r} {state}: {self._log_end()}", reason="NOT_LISTENING"
            )
        return text.removeprefix(_LISTENING)

    def _log_end(self) -> str:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(1)  # so that the log is complete
        with contextlib.suppress(OSError, ValueError):  # ValueError: the file is closed
            self._log.seek(0)
            return self._log.read()[-2000:].decode(errors="replace").strip()
        return ""

    def close(self, patience: float = _EXIT_SECONDS) -> None:
        """Ends the server: closes its standard input, then terminates it, then kills it.

        The server gets `patience` seconds after each step to finish calls in flight. In a forked
        child process this method does nothing.
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
        """Ends the server of a client that was garbage collected, so that no call is in flight."""
        self.close(patience=1.0)

    def let_go(self) -> None:
        """Closes this process's end of the server's standard input."""
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()


_servers: weakref.WeakSet[Server] = weakref.WeakSet()


def _after_fork() -> None:
    """Closes the inherited standard input, which would keep the server alive after the parent."""
    for server in list(_servers):
        server.let_go()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
