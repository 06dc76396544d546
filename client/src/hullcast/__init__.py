"""Client of hullcast: certified contact manifolds of convex hulls, computed by a server.

For example::

    import hullcast
    with hullcast.connect("localhost:50051") as client:  # or hullcast.serve()
        hulls = client.register([vertices_a, vertices_b])
        scene = hullcast.Scene(hulls, positions, rotations)
        m = client.query(scene, pairs, margin=0.01)
        m.alpha, m.normal, m.witness_a, m.distance

Lengths are in the caller's units (metres in the documentation), and angles in radians. Coordinate
systems are right-handed. Quaternions have the order x, y, z, w. Result arrays are float64, uint32
or uint8.
"""

import importlib
from typing import TYPE_CHECKING, Any

from ._version import __version__

if TYPE_CHECKING:
    from . import aio
    from ._arrays import from_wxyz
    from ._client import Client, Session, connect
    from ._decompose import decompose
    from ._errors import (
        DeadlineExceeded,
        Error,
        FileNotFound,
        HullRejected,
        InvalidArgument,
        InvalidPoses,
        InvalidPosesWarning,
        JointLimitsWarning,
        MissingHullsWarning,
        NoBodiesWarning,
        NotCachedWarning,
        NotConvexWarning,
        OutputNotAsked,
        PairOutOfRange,
        ResourceExhausted,
        ServerDidNotStart,
        ServerError,
        ServerNotFound,
        Unauthenticated,
        Unavailable,
        Unimplemented,
    )
    from ._export import Padded
    from ._hulls import DEFAULT_PLANARITY, Hull, hull_id
    from ._manage import ServerInfo, StoredHull
    from ._manifolds import Manifold, Manifolds
    from ._matching import Matches, match
    from ._query import Accuracy
    from ._robot import Robot
    from ._scene import Scene
    from ._serve import serve
    from ._shapes import Shape, box, capsule, cone, cylinder, prism, sphere
    from ._views import PerBody
    from ._wire import FeatureKind, Flag, Outcome

__all__ = [
    "DEFAULT_PLANARITY",
    "Accuracy",
    "Client",
    "DeadlineExceeded",
    "Error",
    "FeatureKind",
    "FileNotFound",
    "Flag",
    "Hull",
    "HullRejected",
    "InvalidArgument",
    "InvalidPoses",
    "InvalidPosesWarning",
    "JointLimitsWarning",
    "Manifold",
    "Manifolds",
    "Matches",
    "MissingHullsWarning",
    "NoBodiesWarning",
    "NotCachedWarning",
    "NotConvexWarning",
    "Outcome",
    "OutputNotAsked",
    "Padded",
    "PairOutOfRange",
    "PerBody",
    "ResourceExhausted",
    "Robot",
    "Scene",
    "ServerDidNotStart",
    "ServerError",
    "ServerInfo",
    "ServerNotFound",
    "Session",
    "Shape",
    "StoredHull",
    "Unauthenticated",
    "Unavailable",
    "Unimplemented",
    "__version__",
    "aio",
    "box",
    "capsule",
    "cone",
    "connect",
    "cylinder",
    "decompose",
    "from_wxyz",
    "hull_id",
    "match",
    "prism",
    "serve",
    "sphere",
]

# Each name is loaded at its first use. A program that may never query contacts then does not wait
# for grpc to load.
_HOMES = {
    "_arrays": ["from_wxyz"],
    "_client": ["Client", "Session", "connect"],
    "_decompose": ["decompose"],
    "_errors": [
        "DeadlineExceeded",
        "Error",
        "FileNotFound",
        "HullRejected",
        "InvalidArgument",
        "InvalidPoses",
        "InvalidPosesWarning",
        "JointLimitsWarning",
        "MissingHullsWarning",
        "NoBodiesWarning",
        "NotCachedWarning",
        "NotConvexWarning",
        "OutputNotAsked",
        "PairOutOfRange",
        "ResourceExhausted",
        "ServerDidNotStart",
        "ServerError",
        "ServerNotFound",
        "Unauthenticated",
        "Unavailable",
        "Unimplemented",
    ],
    "_export": ["Padded"],
    "_hulls": ["DEFAULT_PLANARITY", "Hull", "hull_id"],
    "_manage": ["ServerInfo", "StoredHull"],
    "_manifolds": ["Manifold", "Manifolds"],
    "_matching": ["Matches", "match"],
    "_query": ["Accuracy"],
    "_robot": ["Robot"],
    "_scene": ["Scene"],
    "_serve": ["serve"],
    "_shapes": ["Shape", "box", "capsule", "cone", "cylinder", "prism", "sphere"],
    "_views": ["PerBody"],
    "_wire": ["FeatureKind", "Flag", "Outcome"],
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name in _HOME_OF:
        value = getattr(importlib.import_module(f"{__name__}.{_HOME_OF[name]}"), name)
    elif name == "aio":
        value = importlib.import_module(f"{__name__}.aio")
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
