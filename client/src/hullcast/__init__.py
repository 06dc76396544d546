"""Certified contact manifolds of convex hulls, from a hullcast server.

    import hullcast
    with hullcast.connect("localhost:50051") as client:  # or hullcast.serve()
        hulls = client.register([vertices_a, vertices_b])
        scene = hullcast.Scene(hulls, positions, rotations)
        m = client.query(scene, pairs, margin=0.01)
        m.alpha, m.normal, m.witness_a, m.distance

Units are the caller's (metres in the documentation), angles radians. Right
handed; quaternions x, y, z, w. Arrays are float64, uint32 and uint8.
"""

from . import aio
from ._arrays import from_wxyz
from ._client import Client
from ._errors import (
    DeadlineExceeded,
    Error,
    HullRejected,
    InvalidArgument,
    NotConvexWarning,
    OutputNotAsked,
    ResourceExhausted,
    ServerDidNotStart,
    ServerError,
    ServerNotFound,
    Unauthenticated,
    Unavailable,
    Unimplemented,
)
from ._export import Padded
from ._hulls import Hull, hull_id
from ._manifolds import Manifold, Manifolds
from ._query import Accuracy
from ._scene import Scene
from ._serve import serve
from ._version import __version__
from ._wire import FeatureKind, Flag, Outcome

connect = Client.connect

__all__ = [
    "Accuracy",
    "Client",
    "DeadlineExceeded",
    "Error",
    "FeatureKind",
    "Flag",
    "Hull",
    "HullRejected",
    "InvalidArgument",
    "Manifold",
    "Manifolds",
    "NotConvexWarning",
    "Outcome",
    "OutputNotAsked",
    "Padded",
    "ResourceExhausted",
    "Scene",
    "ServerDidNotStart",
    "ServerError",
    "ServerNotFound",
    "Unauthenticated",
    "Unavailable",
    "Unimplemented",
    "__version__",
    "aio",
    "connect",
    "from_wxyz",
    "hull_id",
    "serve",
]
