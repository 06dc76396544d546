"""The blocking client: makes calls with `grpc` and waits for them."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from . import _blocking, _calls, _channel, _errors, _link, _session, _status
from ._grpc import grpc
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
    """A connection to a server, whose calls block.

    Make a client with `connect` or `serve`, and close it with `close` or `with`. Several threads
    may make calls on one client at once.
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
        """Registers convex hulls, each given by its points, for use in a `Scene`.

        Registering a hull that the server already knows costs little. A mesh that is not convex, or
        has holes, is registered as its convex hull, with a `NotConvexWarning`.

        Args:
            hulls: one hull or an iterable of hulls. A hull is an array (n, 3) of points in the
                hull's own frame; an object with such an array as `.vertices`, for example a mesh of
                trimesh or open3d; a scipy `ConvexHull`; a `Hull`; or the path of an OBJ, STL, DAE
                or PLY file. A `trimesh.Scene` stands for all its parts. Points inside the hull are
                dropped; no point is moved. Only an object that has triangles too, as `.faces`,
                `.triangles` or `.indices`, is checked for convexity.
            contraction_points: one entry per hull: the point (3,) about which the hull grows,
                strictly inside the hull, or None for the centre of mass.
            max_vertices: simplify each hull to at most this many vertices, 4 or more.
            max_deviation: simplify each hull such that no dropped point is farther than this from
                the simplified hull; a length, 0 or more. A simplified hull has a subset of the
                vertices and keeps its contraction point. `Hull.deviation` is a certified bound of
                the deviation.
            planarity: how far the vertices of one face may lie from one plane, as a fraction of the
                circumradius, 0 to 0.01. Coordinates rounded in a file would otherwise split a face
                into many. No vertex moves, and `alpha` does not depend on the planarity; a contact
                point inside a face may be off its hull by at most this much. "default" means
                `DEFAULT_PLANARITY`, and for a `Hull` its own planarity. With None the server uses
                1e-6.
            timeout: seconds for the whole call; by default the client's timeout.

        Returns:
            One `Hull` per hull given, in order.

        Raises:
            HullRejected: the server refused some hulls. The others are registered; see
                `HullRejected.results`.
            InvalidArgument: an argument is not usable. For a file: UNSUPPORTED_MESH (an unknown
                format, or a feature that is not read), MALFORMED_MESH, NO_TRIANGLES or
                UNREADABLE_FILE.
            FileNotFound: a file does not exist.
        """

        make = partial(
            Registration.of, hulls, contraction_points, max_vertices, max_deviation, planarity
        )
        return self._run(self._registering(make, timeout), timeout)

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
        linear_velocities: Any = None,
        angular_velocities: Any = None,
        time_step: float = 0.0,
        turning_points: Any = None,
        timeout: float | None = None,
    ) -> Manifolds:
        """Computes the contact manifold of each pair.

        If the server does not have some of the scene's hulls, and the scene was made with `Hull`
        objects, the client registers these hulls and queries their pairs again.

        Args:
            scene: the bodies.
            pairs: (n, 2) integers, the body indices A and B of each pair; or an iterable of pairs.
            margin: a distance, 0 or more: pairs whose hulls are within this distance of each other
                get contact points. With infinity every pair gets all numbers and points.
            accuracy: the solver and its tolerances; by default `Accuracy.EXACT`.
            outputs: the outputs to compute and send: names out of `OUTCOME`, `ALPHA`, `NORMAL`,
                `POINTS`, `WITNESS_B`, `FEATURES`, `BASES`, `DIAGNOSTICS`, `ALPHA_GRADIENT`,
                `SEPARATION_GRADIENT` and `NORMAL_JACOBIAN`; by default ALPHA, NORMAL and POINTS.
            warm: earlier manifolds of the same pairs, queried with output BASES. The solver starts
                from their bases.
            on_invalid: "raise" raises `InvalidPoses` if a body has an unusable pose: a position
                that is not finite or beyond 1e100, or a quaternion whose norm is not in 0.25 to 4.
                "flag" raises nothing; the pairs of such bodies have the outcome INVALID.
            linear_velocities, angular_velocities: (n, 3) along the axes of the world, by default 0:
                the velocity of each body's turning point, and its rate of turn about that point in
                radians per unit of `time_step`.
            time_step: the time for which the velocities hold, 0 to 1e100. The margin of each pair
                grows by the most by which its distance can shrink in this time, so that no pair is
                missed that touches before the time has passed.
            turning_points: (n, 3) in the hulls' frames: the point about which each body turns, by
                default the origin of its hull's frame. For a shape of a rigid body this is the
                centre of mass of the rigid body.
            timeout: seconds above 0 for the whole call; infinity for no limit; by default the
                client's timeout.

        Returns:
            The manifolds of all pairs, in the order of `pairs`.

        Raises:
            InvalidPoses: some bodies have unusable poses. The error names them and has the whole
                result (`.manifolds`).
            InvalidArgument: an argument is not usable; the error names it.
            Unimplemented: SERVER_TOO_OLD, the server does not know margins of bodies and motions.
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
            linear_velocities=linear_velocities,
            angular_velocities=angular_velocities,
            time_step=time_step,
            turning_points=turning_points,
        )
        return self._run(self._querying(make, timeout), timeout)

    def find(
        self,
        scene: Scene,
        *,
        margin: float = 0.0,
        accuracy: Accuracy | None = None,
        outputs: Iterable[str] | None = None,
        on_invalid: Literal["raise", "flag"] = "raise",
        linear_velocities: Any = None,
        angular_velocities: Any = None,
        time_step: float = 0.0,
        turning_points: Any = None,
        timeout: float | None = None,
    ) -> Manifolds:
        """Finds all pairs within the margin of each other, and computes their contact manifolds.

        The server finds the pairs by a broad phase. It considers all pairs that the scene's worlds
        and groups allow, and returns those that `query` would not call SEPARATED. `.pairs` of the
        result is sorted, with the lower body first.

        A body with an unusable pose, or with a hull that the server does not have, is in no pair.
        `.invalid_bodies` and `.missing_hulls` of the result list them. Unusable poses also raise
        `InvalidPoses`, unless `on_invalid` is "flag".

        The arguments and errors are those of `query`, except that the margin must be finite.
        """

        make = partial(
            Query,
            scene,
            None,
            margin=margin,
            accuracy=accuracy,
            outputs=outputs,
            on_invalid=on_invalid,
            linear_velocities=linear_velocities,
            angular_velocities=angular_velocities,
            time_step=time_step,
            turning_points=turning_points,
            find=True,
        )
        return self._run(self._finding(make, timeout), timeout)

    def session(
        self,
        scene: Scene,
        pairs: Any = None,
        *,
        find: bool = False,
        margin: float = 0.0,
        accuracy: Accuracy | None = None,
        outputs: Iterable[str] | None = None,
        warm: Manifolds | None = None,
        on_invalid: Literal["raise", "flag"] = "raise",
    ) -> Session:
        """Opens a step loop, in which each step sends only the poses that have changed.

        With `find` the server finds the pairs in each step, as `Client.find` does; bodies may be
        added and removed (`Session.update`). Otherwise the loop is over the given pairs. The first
        step opens the connection. A step that raises `InvalidPoses` counts as answered, and the
        next step continues from it.

        Args:
            scene: the bodies. The poses are those of each step; the scene's own poses are only used
                by a first step with `moved`.
            pairs: (n, 2), as in `query`; not with `find`.
            find: whether the server finds the pairs, with the scene's worlds and groups.
            margin, accuracy, on_invalid: as in `query`, or in `find`.
            outputs: as in `query`. A session also has MATCHES: which pairs and points are those of
                the step before.
            warm: as in `query`; not with `find`.

        Raises:
            InvalidArgument: an argument is not usable; the error names it.
        """
        make = partial(
            _session.query_of,
            scene,
            pairs,
            find=find,
            margin=margin,
            accuracy=accuracy,
            outputs=outputs,
            warm=warm,
            on_invalid=on_invalid,
        )
        return Session(self, make)

    def info(self, *, timeout: float | None = None) -> ServerInfo:
        """Asks the server for its version, instruction set, threads and limits."""
        return self._run(self._informing(timeout), timeout)

    def ping(self, *, timeout: float | None = None) -> float:
        """Measures the seconds that the server takes to answer a small call.

        Raises:
            ServerError: the server did not answer; usually `Unavailable` or `DeadlineExceeded`.
        """
        return self._run(self._pinging(timeout), timeout)

    def hulls(self, *, timeout: float | None = None) -> list[StoredHull]:
        """Lists every hull in the server's store, sorted by id."""
        return self._run(self._listing(timeout), timeout)

    def delete(self, hulls: Any, *, timeout: float | None = None) -> list[bool]:
        """Removes hulls from the server's store. They can always be registered again.

        Args:
            hulls: one hull or an iterable of hulls: `Hull` objects, `StoredHull` objects from
                `hulls()`, or ids of 32 bytes.
            timeout: seconds for the whole call; by default the client's timeout.

        Returns:
            For each hull, whether it was in the store.
        """
        return self._run(self._deleting(hulls, timeout), timeout)

    def _open(self, group: _channel.Target) -> _link.Link:
        channel = self._settings.open(grpc, group)
        return _blocking.Link(channel, self._settings.metadata)

    def _run(self, steps: _link.Steps[T], timeout: float | None = None) -> T:
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
        except _errors.DeadlineExceeded as error:
            self._explain(error, timeout)
            raise
        finally:
            steps.close()

    def close(self) -> None:
        """Closes the connection, and ends the server if `serve` started it."""
        link, stop_server = self._begin_close()
        if isinstance(link, _blocking.Link):
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
    """A step loop. Make one with `Client.session`, end it with `close` or `with`.

        with client.session(scene, find=True, margin=0.01) as session:
            while simulating:
                m = session.step(positions, rotations)

    Everything that does not change between steps stays on the server. A step sends the poses of the
    bodies that have moved since the step before, and the server answers pairs whose bodies did not
    move without computing them. It starts each other pair from the solution of the step before.

    The results are those of `Client.find`; in a session of given pairs they are those of `query`
    with `warm`. The arrays of a find session's results are read-only, because a step in which
    nothing changed has the arrays of the step before.

    If a session loses its server, the next step connects to another one and sends everything again;
    its result has `restarted`. In a session of given pairs that step starts from the bases of the
    last result, if the outputs include BASES.

    A session computes one step at a time. Do not share it between threads. An open session uses one
    stream of the client's connection, or up to 8 or more if it has many pairs. If a server permits
    no more (1,024 calls on one connection by default), a step raises `ResourceExhausted` with the
    reason TOO_MANY_SESSIONS. Worlds of one scene need only one session.
    """

    def step(
        self,
        positions: Any,
        rotations: Any = None,
        *,
        moved: Any = None,
        linear_velocities: Any = None,
        angular_velocities: Any = None,
        time_step: float = 0.0,
        turning_points: Any = None,
        timeout: float | None = None,
    ) -> Manifolds:
        """Computes the contact manifolds with the bodies at the given poses.

        Args:
            positions, rotations: the poses of all bodies, in any form that `Scene` takes; or, with
                `moved`, those of the bodies that it names.
            moved: (k,) integers: the bodies to which the poses belong. All other bodies stay where
                the last call of `step` or `update` put them. By default the poses are those of all
                bodies, and the client compares them with the last ones to find out which bodies
                moved; with hundreds of thousands of bodies, naming them saves some milliseconds.
            linear_velocities, angular_velocities, turning_points: as in `find`, of all bodies or,
                with `moved`, (k, 3) of the bodies that it names. They hold for the following steps
                until others are given; at first they are 0.
            time_step: as in `find`. It holds for this step only: without it the velocities do not
                enlarge the margins.
            timeout: seconds for this step; by default the client's timeout.

        Returns:
            The manifolds of the session's pairs, in their order; or, with `find`, those that
            `Client.find` would return.

        Raises:
            InvalidPoses, InvalidArgument, ServerError: as for `Client.query`.
            Unimplemented: SERVER_TOO_OLD, the server's version has no find sessions or no matches.
        """
        motion = {
            "linear_velocities": linear_velocities,
            "angular_velocities": angular_velocities,
            "time_step": time_step,
            "turning_points": turning_points,
        }
        steps = self._stepping(positions, rotations, moved, motion, timeout)
        return self._calls._run(steps, timeout)

    def update(
        self,
        scene: Scene,
        *,
        previous: Any = None,
        linear_velocities: Any = None,
        angular_velocities: Any = None,
        time_step: float = 0.0,
        turning_points: Any = None,
        timeout: float | None = None,
    ) -> Manifolds:
        """Makes a step with other bodies, in a session with `find`: some are added or removed.

            kept = np.flatnonzero(alive)
            scene = hullcast.Scene(hulls, positions, rotations, body_hulls=body_hulls)
            m = session.update(scene, previous=[*kept, -1])  # the last body is new

        Args:
            scene: all bodies, at their poses. Options such as the margin stay.
            previous: (n,) integers: for each body its index in the scene of the last step that was
                answered, or -1 for a new one. An index may be there once. A body whose hull has
                changed is a new one. Without `previous` all bodies are new, and the session begins
                anew.
            linear_velocities, angular_velocities, time_step, turning_points: as in `find`, of all
                bodies of this scene. Without new ones, the bodies that stayed keep theirs, and new
                bodies have 0.
            timeout: seconds for this step; by default the client's timeout.

        Returns:
            As for `step`. `previous_pairs`, `previous_points` and `ended_pairs` compare the bodies
            that stayed.

        Raises:
            InvalidArgument: FIND_ONLY, the session is one of given pairs; or an argument is not
                usable.
            InvalidPoses, ServerError: as for `step`.
        """
        motion = {
            "linear_velocities": linear_velocities,
            "angular_velocities": angular_velocities,
            "time_step": time_step,
            "turning_points": turning_points,
        }
        steps = self._updating(scene, previous, motion, timeout)
        return self._calls._run(steps, timeout)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


connect = Client.connect
