"""A proxy that can fall silent: it then neither forwards nor closes anything."""

from __future__ import annotations

import contextlib
import math
import socket
import threading


class SilentProxy:
    """Forwards bytes between clients and a server until `silence` is called.

    After that, or from the start if `silent` is true, the proxy accepts connections and sends
    nothing on them. With `most` it falls silent by itself once the clients have sent more than
    that many bytes.
    """

    def __init__(self, target: str, *, silent: bool = False, most: float = math.inf) -> None:
        host, _, port = target.rpartition(":")
        self._target = (host, int(port))
        self._silent = threading.Event()
        self._left = most
        if silent:
            self._silent.set()
        self._sockets: list[socket.socket] = []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def silence(self) -> None:
        """Stops forwarding, without closing anything."""
        self._silent.set()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                self._sockets.append(near)
                if self._silent.is_set():
                    continue
                far = socket.create_connection(self._target)
                self._sockets.append(far)
                for ends in ((near, far, True), (far, near, False)):
                    threading.Thread(target=self._forward, args=ends, daemon=True).start()

    def _forward(self, source: socket.socket, sink: socket.socket, counted: bool) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(1 << 16):
                if counted:
                    self._left -= len(data)
                    if self._left < 0:
                        self.silence()
                if self._silent.is_set():
                    return
                sink.sendall(data)

    def __enter__(self) -> SilentProxy:
        return self

    def __exit__(self, *error: object) -> None:
        # `shutdown` wakes the thread that waits in `accept` or `recv`; `close` would not.
        for each in (self._listener, *self._sockets):
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()
