"""The client that blocks: how it makes a call and waits for it."""

from __future__ import annotations

import queue
import threading
import time
import weakref
from collections.abc import Callable, Iterable
from functools import partial
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import grpc

from . import _calls, _channel, _errors, _session, _status
from ._hulls import Hull, Planarity
from ._manage import ServerInfo, StoredHull
from ._manifolds import Manifolds
from ._query import Accuracy, Query
from ._register import Registration
from ._scene import Scene

if TYPE_CHECKING:
    from typing_extensions import Self

T = TypeVar("T")


class Client(_calls.Calls):
    """A connection to a server; made by `connect` or `serve`, closed by `close` or `with`.

    Its calls may be made from several threads at once.
    """

    __doc__ = f"{__doc__}\n{_calls.Calls.__doc__}"

    def register(
        self,
        hulls: Any,
        *,
        contraction_points: Any = None,
        max_vertices: int | None = None,
        max_deviation: float | None = None,
        planarity: Planarity = "default",
        timeout: float | None = None,
    ) -> list[Hull]:
        """Registers convex hulls, each given by points; those already known cost little.

        A mesh that is not convex, or has holes, is registered as its convex hull
        with a `NotConvexWarning`.

        Args:
            hulls: one hull or an iterable of hulls. Each is an array (n, 3), an object
                with such `.vertices`, as trimesh's, a scipy `ConvexHull`, a `Hull`, or
                the path of an OBJ, STL, DAE or PLY file; a `trimesh.Scene` counts as its
                parts. Points inside are dropped, none is moved.
            contraction_points: per hull (3,), strictly inside, or None: the
                centre of mass.
            max_vertices, max_deviation: simplify to at most so many vertices, and so
                that no point is farther than this from what is left: a subset of the
                vertices, about the same contraction point. `Hull.deviation` is the
                certified bound of what it cost.
            planarity: how far the vertices of one face may lie from one plane, a share of
                the circumradius from 0 to 0.01, so that coordinates that were rounded in
                a file leave faces whole. No vertex moves, and `alpha` does not depend on
                it; a contact point inside a face may be off its hull by at most this.
                "default" means `DEFAULT_PLANARITY`, and for a `Hull` its own; None sends
                none: the server takes 1e-6.
            timeout: seconds for the whole call; the client's by default.

        Raises:
            HullRejected: some are no hulls; the others are registered, see its `results`.
            InvalidArgument: for a file: UNSUPPORTED_MESH, another format or a feature that
                is not read; MALFORMED_MESH; NO_TRIANGLES; UNREADABLE_FILE.
            FileNotFound: there is no such file.
        """

        make = partial(
            Registration.of, hulls, contraction_points, max_vertices, max_deviation, planarity
        )
        return self._run(self._registering(make, timeout))

    def query(
        self,
        scene: Scene,
        pairs: Any,
        *,
        margin: float = 0.0,
        accuracy: Accuracy | None = None,
        outputs: Iterable[str] | None = None,
        warm: Manifolds | None = None,
        on_invalid: Literal["raise", "flag"] = "raise",
        timeout: float | None = None,
    ) -> Manifolds:
        """The contact manifold of each pair.

        Hulls that the server does not have are registered (again) if the scene
        was made with `Hull` objects, and the pairs asked for again.

        Args:
            scene: the bodies.
            pairs: (n, 2) integers, body indices A, B; or an iterable of pairs.
            margin: a pair gets contact points if its hulls are within this distance
                of each other; infinity gives every pair its numbers and points.
            accuracy: the solver and how exact; to rounding by default.
            outputs: names of `OUTCOME`, `ALPHA`, `NORMAL`, `POINTS`, `WITNESS_B`,
                `FEATURES`, `BASES`, `DIAGNOSTICS`: what is computed and sent;
                by default ALPHA, NORMAL and POINTS.
            warm: earlier manifolds of the same pairs, with output BASES: where
                the solver starts.
            on_invalid: "raise" raises `InvalidPoses` if a body's position is not finite
                or beyond 1e100, or its quaternion's norm is not in 0.25 to 4; "flag"
                only answers INVALID for the pairs of such bodies.
            timeout: seconds above 0 for the whole call, infinity for no limit; the
                client's by default.

        Raises:
            InvalidPoses: it names the bodies, and has the whole answer (`.manifolds`).
            InvalidArgument: naming the argument.
        """

        make = partial(
            Query,
            scene,
            pairs,
            margin=margin,
            accuracy=accuracy,
            outputs=outputs,
            warm=warm,
            on_invalid=on_invalid,
        )
        return self._run(self._querying(make, timeout))

    def find(
        self,
        scene: Scene,
        *,
        margin: float = 0.0,
        accuracy: Accuracy | None = None,
        outputs: Iterable[str] | None = None,
        on_invalid: Literal["raise", "flag"] = "raise",
        timeout: float | None = None,
    ) -> Manifolds:
        """The contact manifolds of all pairs within the margin; the server finds them.

        Those are the pairs that `query` would not answer SEPARATED, of all that the
        scene's worlds and groups let meet: `.pairs`, the lower body first, sorted.
        Bodies with an unusable pose or a hull that the server does not have are in no
        pair: `InvalidPoses` is raised for the former unless `on_invalid` is "flag";
        `.invalid_bodies` and `.missing_hulls` name them.

        The arguments are those of `query`; the margin is finite.
        """

        make = partial(
            Query,
            scene,
            None,
            margin=margin,
            accuracy=accuracy,
            outputs=outputs,
            on_invalid=on_invalid,
            find=True,
        )
        return self._run(self._finding(make, timeout))

    def session(
        self,
        scene: Scene,
        pairs: Any,
        *,
        margin: float = 0.0,
        accuracy: Accuracy | None = None,
        outputs: Iterable[str] | None = None,
        warm: Manifolds | None = None,
        on_invalid: Literal["raise", "flag"] = "raise",
    ) -> Session:
        """A step loop over the same bodies and pairs, of which each step sends poses alone.

        The arguments are those of `query`; the scene's poses are not used. The first
        step makes the connection. A step that raises `InvalidPoses` has been answered,
        and the next one goes on from it.
        """
        make = partial(
            Query,
            scene,
            pairs,
            margin=margin,
            accuracy=accuracy,
            outputs=outputs,
            warm=warm,
            on_invalid=on_invalid,
        )
        return Session(self, make)

    def info(self, *, timeout: float | None = None) -> ServerInfo:
        """What the server is, and its limits."""
        return self._run(self._informing(timeout))

    def ping(self, *, timeout: float | None = None) -> float:
        """Seconds until the server answered a small call; an exception if it did not."""
        return self._run(self._pinging(timeout))

    def hulls(self, *, timeout: float | None = None) -> list[StoredHull]:
        """Every hull in the server's store, sorted by id."""
        return self._run(self._listing(timeout))

    def delete(self, hulls: Any, *, timeout: float | None = None) -> list[bool]:
        """Removes hulls from the server's store; registering them again always works.

        Args:
            hulls: one, or an iterable: `Hull`, what `hulls()` returns, or ids.
            timeout: seconds for the whole call; the client's by default.

        Returns:
            Whether each hull was there.
        """
        return self._run(self._deleting(hulls, timeout))

    def _open(self) -> _calls.Link:
        return _Link(self._settings.open(grpc), self._settings.metadata)

    def _run(self, steps: _calls.Steps[T]) -> T:
        try:
            waited_for = next(steps)
            while True:
                try:
                    answer = waited_for.result()
                except grpc.RpcError as error:
                    waited_for = steps.throw(_status.from_rpc(error))
                except _errors.Error as error:
                    waited_for = steps.throw(error)
                else:
                    waited_for = steps.send(answer)
        except StopIteration as done:
            return done.value
        finally:
            steps.close()

    def close(self) -> None:
        """Closes the connection, and the server where `serve` started it."""
        link, stop_server = self._begin_close()
        if isinstance(link, _Link):
            link.channel.close()
        if stop_server is not None:
            stop_server()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


class Session(_session.Steps):
    """A step loop; made by `Client.session`, ended by `close` or `with`.

        with client.session(scene, pairs, margin=0.01) as session:
            while simulating:
                m = session.step(positions, rotations)

    What stays the same from step to step stays on the server, which starts each
    pair from where the step before ended (the answer is that of `query` with
    `warm`). A session that loses its server goes on with another: it sends all
    again, and starts from the last answer's bases if the outputs have BASES.

    One step at a time: not to be shared by threads.
    """

    def step(
        self, positions: Any, rotations: Any = None, *, timeout: float | None = None
    ) -> Manifolds:
        """The contact manifolds of all pairs, with the bodies at these poses.

        Args:
            positions, rotations: of all bodies, in any form that `Scene` takes.
            timeout: seconds for the step; the client's by default.
        """
        return self._calls._run(self._stepping(positions, rotations, timeout))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


class _Link:
    """A `grpc.Channel`'s calls."""

    def __init__(self, channel: grpc.Channel, metadata: Callable[[], _channel.Metadata]) -> None:
        self.channel = channel
        self._metadata = metadata
        self._unary: dict[str, Any] = {name: channel.unary_unary(name) for name in _calls.UNARY}
        self._stream: Any = channel.unary_stream(_calls.FIND)
        self.proven = False

    def start(self, method: str, data: bytes, timeout: float | None) -> Any:
        return self._unary[method].future(data, timeout=timeout, metadata=self._metadata())

    def call(self, method: str, data: bytes, timeout: float | None) -> Any:
        # Half the time of a future's: it waits on this thread.
        make = self._unary[method]
        return _Later(partial(make, data, timeout=timeout, metadata=self._metadata()))

    def stream(self, method: str, data: bytes, timeout: float | None) -> Any:
        assert method == _calls.FIND
        make = partial(self._stream, data, timeout=timeout, metadata=self._metadata())
        return _Later(lambda: list(make()))

    def open(self, method: str) -> _calls.Stream:
        return _Stream(self.channel.stream_stream(method), self._metadata())

    def pause(self, seconds: float) -> Any:
        return _Later(partial(time.sleep, seconds))

    def run(self, function: Callable[[], Any]) -> Any:
        return _Later(function)

    def shut(self) -> None:
        self.channel.close()

    def abandon(self) -> None:
        pass  # only another process's, and that is seen to when forking


class _Stream:
    """A stream of a `grpc.Channel`. It has no deadline of its own: each answer has one."""

    def __init__(self, begin: Any, metadata: _channel.Metadata) -> None:
        self._requests: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._call: Any = begin(iter(self._requests.get, None), metadata=metadata)
        self._watch = _Watch(self._call.cancel)
        # gRPC's thread waits for requests until it is told that there are no more.
        self.cancel = weakref.finalize(self, _end, self._call, self._requests, self._watch)

    def send(self, data: bytes) -> Any:
        self._requests.put(data)
        return _Later(_nothing)

    def receive(self, timeout: float | None) -> Any:
        return _Later(partial(self._receive, timeout))

    def _receive(self, timeout: float | None) -> bytes:
        self._watch.set(timeout)
        try:
            answer = next(self._call, None)
        except grpc.RpcError:
            if self._watch.expired:
                raise _calls.late() from None
            raise
        finally:
            self._watch.set(None)
        if self._watch.expired:  # just now: the stream is of no use any more
            raise _calls.late()
        if answer is None:
            raise _calls.stream_ended()
        return answer


def _nothing() -> None:
    """Nothing is to be waited for."""


def _end(call: Any, requests: queue.SimpleQueue[bytes | None], watch: _Watch) -> None:
    watch.stop()
    call.cancel()
    requests.put(None)


class _Watch:
    """Calls a function when a time is past that is set anew again and again.

    A thread a stream, which sleeps through; a timer a step would cost as much as
    the step.
    """

    def __init__(self, late: Callable[[], Any]) -> None:
        self.expired = False
        self._late = late
        self._deadline: float | None = None
        self._wakes_at: float | None = 0.0
        self._changed = threading.Event()
        self._stopped = False
        self._thread: threading.Thread | None = None

    def set(self, seconds: float | None) -> None:
        """So many seconds from now, or never."""
        self._deadline = deadline = None if seconds is None else time.monotonic() + seconds
        if deadline is None:
            return
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, daemon=True, name="hullcast-watch")
            self._thread.start()
        if self._wakes_at is None or deadline < self._wakes_at:
            self._changed.set()

    def stop(self) -> None:
        """Ends the thread."""
        self._stopped = True
        self._changed.set()

    def _run(self) -> None:
        while not self._stopped:
            deadline = self._wakes_at = self._deadline
            seconds = None if deadline is None else deadline - time.monotonic()
            if seconds is not None and seconds <= 0:
                self.expired = True
                self._late()
                return
            self._changed.wait(seconds)
            self._changed.clear()


class _Later:
    """A call that is made when it is waited for."""

    __slots__ = ("result",)

    def __init__(self, result: Callable[[], Any]) -> None:
        self.result = result

    def cancel(self) -> None:
        """It was not begun."""


connect = Client.connect
