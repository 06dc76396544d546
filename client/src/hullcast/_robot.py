"""Robots from URDF and MJCF files: their shapes, their poses, and the pairs that can meet."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar, cast

import numpy as np
import numpy.typing as npt

from . import (
    _arguments,
    _arrays,
    _convexity,
    _decompose,
    _joint_values,
    _mesh,
    _mjcf,
    _numbers,
    _srdf,
    _urdf,
)
from ._arguments import counted
from ._arrays import Floats, Indices
from ._errors import InvalidArgument
from ._hulls import Hull
from ._scene import Scene, list_of_hulls
from ._settled import Settled, freeze
from ._urdf import Joint


class Robot(Settled):
    """The collision geometry of a URDF or MJCF file as convex bodies, with poses by joint values.

        robot = hullcast.Robot("panda.urdf")
        scene = robot.scene(client.register(robot.shapes), {"panda_joint4": -2.0})
        m = client.query(scene, robot.pairs, margin=0.01)

    Each collision element becomes one body; a mesh that is not convex becomes several bodies, its
    convex pieces. Lengths are in metres and angles in radians, as in URDF.

    Bodies of one link never meet. Neither do bodies of two links that ignore each other: links
    connected by fixed joints, and neighbours in the tree, because links overlap at their joints.
    (To find the neighbour of a link, links without collision geometry are skipped.)

    MuJoCo compiles MJCF files (extra `mujoco`). There the links are MuJoCo's bodies, with "world"
    as the root, and each geom that can collide is one body, meshes as their convex hulls. The pairs
    that may meet are those that MuJoCo's own filter lets meet: links that are welded together or
    neighbours do not, nor do excluded ones or those whose `contype` and `conaffinity` do not match.
    Joint values are those of MuJoCo's `qpos`. Round geoms and planes become polyhedra, as
    `hullcast.mujoco.scene` says.

    Args:
        urdf: the path of the URDF or MJCF file. Visual elements are not read.
        packages: for URDF: a folder or a list of folders. `package://name/...` and
            `package:///name/...` are looked up as `name/...` in these folders first, then in
            ROS_PACKAGE_PATH, in AMENT_PREFIX_PATH and in the folders that contain the URDF file.
        srdf: for URDF: the path of an SRDF file. Links that its `disable_collisions` elements name
            ignore each other. A link of `disable_default_collisions` ignores all others, except
            those of `enable_collisions`.
        ignored: further pairs of names of links that ignore each other.
        decompose: for URDF, True or False: whether to decompose meshes that are not convex or not
            closed (extra `decompose`). If not, `register` uses their convex hulls, with a
            `NotConvexWarning` each.
        threshold, cache, progress: the settings of the decomposition, as in `hullcast.decompose`.

    Raises:
        InvalidArgument: NOT_A_ROBOT, the file is neither URDF nor MJCF, or its links and joints do
            not form one tree, or MuJoCo does not compile it; UNSUPPORTED_JOINT, a floating, planar
            or ball joint; UNSUPPORTED_SHAPE, a height field; COPLANAR, a flat mesh; UNKNOWN_LINK,
            in `ignored`; NOT_AN_SRDF; for a mesh file, as `Client.register`. The message names the
            file, the link and the element.
        FileNotFound: the URDF file, or a mesh file that it names, does not exist.
        ImportError: a mesh is not convex, and the extra `decompose` is not installed; or the file
            is MJCF, and the extra `mujoco` is not installed.

    Warns:
        NoBodiesWarning: no link has collision geometry.
    """

    _instead: ClassVar[dict[str, str]] = {"": "make a new hullcast.Robot"}

    #: The robot's name.
    name: str
    #: The names of the links.
    links: tuple[str, ...]
    #: The names of the joints that have a value of their own: they move, and mimic no other joint.
    joints: tuple[str, ...]
    #: (joints, 2): the lowest and the highest value of each joint, radians or metres; infinite
    #: without a limit.
    limits: Floats
    #: For each body the shape that `Client.register` takes, in the frame of the body's link: points
    #: (k, 3) or a mesh. Messages name it by its link and its file. A cylinder is an inscribed prism
    #: with 32 sides, a sphere an inscribed polyhedron with 162 vertices, and a capsule an inscribed
    #: polyhedron with 130 vertices.
    shapes: list[Any]
    #: (bodies,): the link of each body, as an index into `links`.
    body_links: npt.NDArray[np.intp]
    #: (bodies,): the group of each body, as `Scene` takes them; one per link for URDF.
    groups: Indices
    #: (k, 2): the groups that ignore each other, as `Scene` takes them.
    ignored_groups: Indices
    #: (m, 2): all pairs of bodies that may meet, as `Client.query` takes them.
    pairs: Indices

    def __init__(
        self,
        urdf: str | os.PathLike[str],
        *,
        packages: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = (),
        srdf: str | os.PathLike[str] | None = None,
        ignored: Iterable[tuple[str, str]] = (),
        decompose: bool = True,
        threshold: float = 0.05,
        cache: str | os.PathLike[str] | None = None,
        progress: _decompose.Report = None,
    ) -> None:
        _decompose.check_threshold(threshold)
        decompose = _arguments.flag("decompose", decompose)
        mjcf = _mjcf.read(urdf)
        if mjcf is not None:
            _refuse_for_mjcf(packages, srdf)
            self._take(mjcf, _named(ignored))
            return
        model = _urdf.read(urdf, packages)
        dented = [
            i
            for i, (_, _, shape) in enumerate(model.shapes)
            if decompose
            and isinstance(shape, _mesh.Mesh)
            and not _convexity.is_convex(shape.vertices, shape.faces)
        ]
        found = _decompose.decompose_all(
            [model.shapes[i][2] for i in dented],
            threshold=threshold,
            cache=cache,
            progress=progress,
        )
        pieces = dict(zip(dented, found, strict=True))
        bodies = [
            (link, piece)
            for i, (link, label, shape) in enumerate(model.shapes)
            for piece in _named_pieces(label, pieces.get(i, [shape]))
        ]
        body_links: npt.NDArray[np.intp] = np.array([link for link, _ in bodies], np.intp)
        disabled = [] if srdf is None else _srdf.disabled(srdf, model.links)
        known = [pair for pair in disabled if set(pair) <= set(model.links)]
        if disabled and not known:
            raise InvalidArgument(
                f"none of its pairs of links is in the URDF file; the first is {disabled[0]}: give "
                "the SRDF file of this robot",
                reason="UNKNOWN_LINK",
                field="srdf",
            )
        silent = _ignoring(model, set(body_links.tolist()), [*known, *_named(ignored)])
        meeting = [
            (i, j)
            for i, j in itertools.combinations(range(len(bodies)), 2)
            if bodies[i][0] != bodies[j][0] and _sorted(bodies[i][0], bodies[j][0]) not in silent
        ]
        self._settle(
            model,
            shapes=[piece for _, piece in bodies],
            body_links=body_links,
            groups=(body_links + 1).astype("<u4"),
            ignored_groups=np.array(sorted(silent), "<u4").reshape(-1, 2) + np.uint32(1),
            pairs=np.array(meeting, dtype="<u4").reshape(-1, 2),
        )

    def _take(self, mjcf: _mjcf.Mjcf, ignored: Sequence[tuple[str, str]]) -> None:
        """Sets all attributes from an MJCF file."""
        shapes, links = mjcf.model.shapes, mjcf.model.links
        body_links: npt.NDArray[np.intp] = np.array([link for link, _, _ in shapes], np.intp)
        meets = mjcf.meets.copy()
        for a, b in _indices_of(ignored, links):
            of_a, of_b = mjcf.group[body_links == a], mjcf.group[body_links == b]
            meets[np.ix_(of_a, of_b)] = meets[np.ix_(of_b, of_a)] = False
        self._settle(
            mjcf.model,
            shapes=[points for _, _, points in shapes],
            body_links=body_links,
            groups=(mjcf.group + 1).astype("<u4"),
            ignored_groups=np.argwhere(np.triu(~meets, 1)).astype("<u4") + np.uint32(1),
            pairs=np.argwhere(np.triu(meets[np.ix_(mjcf.group, mjcf.group)])).astype("<u4"),
        )

    def _settle(self, model: _urdf.Model, **attributes: Any) -> None:
        """Sets all attributes, those of links and joints from the model."""
        self._model = model
        free = [joint for joint in model.joints if joint.is_free]
        self._set(
            name=model.name,
            links=model.links,
            joints=tuple(joint.name for joint in free),
            limits=np.array([joint.limits for joint in free], dtype="<f8").reshape(-1, 2),
            **attributes,
        )
        freeze(self)

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        freeze(self)

    def __len__(self) -> int:
        return len(self.shapes)

    def __repr__(self) -> str:
        used = counted(len(set(self.body_links.tolist())), "link")
        bodies = counted(len(self), "body", "bodies")
        return f"Robot({self.name}: {bodies} of {used}, {counted(len(self.joints), 'joint')})"

    def poses(self, joints: Any = None, *, base: Any = None) -> Floats:
        """Computes the world poses of the bodies from joint values, by forward kinematics.

        Args:
            joints: the joint values, radians or metres, in the order of the attribute `joints`:
                (joints,), or (k, joints) for k configurations. Or the values by the names of the
                joints: a mapping from names to one value or to k values, a pandas `Series` with
                the names as its index, or a data frame with a column per joint and a row per
                configuration. Joints that are not named are at 0, and None means that all joints
                are at 0. If 0 is outside a joint's limits, the nearer limit is used instead of 0. A
                value beyond a joint's limits is used as it is, with a `JointLimitsWarning`.
            base: (4, 4) or (k, 4, 4) or a scipy `RigidTransform` or a list of these, the pose of
                the root link in the world; by default the identity.

        Returns:
            (bodies, 4, 4), or (k, bodies, 4, 4) for k configurations: the poses of the bodies'
            frames in the world. The frame of a body is that of its link.

        Raises:
            InvalidArgument: WRONG_SHAPE, LENGTH_MISMATCH, NOT_AN_ARRAY, NOT_FINITE, UNKNOWN_JOINT,
                REPEATED_NAME, NOT_A_POSE or NOT_A_ROTATION.
        """
        values, several = _joint_values.read(joints, self.joints, self.limits)
        base = base.as_matrix() if callable(getattr(base, "as_matrix", None)) else base
        roots = np.eye(4) if base is None else _numbers.any_shape("base", _arrays.as_matrices(base))
        if roots.shape[-2:] != (4, 4) or roots.ndim not in (2, 3):
            raise InvalidArgument(
                f"expected shape (4, 4) or (k, 4, 4), got {roots.shape}",
                reason="WRONG_SHAPE",
                field="base",
            )
        try:
            _check_base(roots.reshape(-1, 4, 4))
        except InvalidArgument as error:
            error.index = None if roots.ndim == 2 else error.index
            raise
        several = several or roots.ndim == 3
        count = len(roots) if roots.ndim == 3 and len(values) == 1 else len(values)
        values = np.broadcast_to(values, (count, len(self.joints)))
        if roots.ndim == 3 and len(roots) != count:
            raise InvalidArgument(
                f"got {counted(len(roots), 'pose')} for {counted(count, 'configuration')}, "
                "expected one pose, or one per configuration",
                reason="LENGTH_MISMATCH",
                field="base",
            )
        of = np.zeros((len(self.links), count, 4, 4))
        of[self._model.root] = roots
        for joint in self._model.ordered:
            of[joint.child] = of[joint.parent] @ joint.origin @ self._motion(joint, values)
        result = of[self.body_links].swapaxes(0, 1)
        return np.ascontiguousarray(result if several else result[0])

    def scene(
        self, hulls: Sequence[Hull | bytes], joints: Any = None, *, base: Any = None
    ) -> Scene:
        """Places the robot's bodies in a scene.

        For k configurations the scene has k copies of the robot, each in a world of its own. Copy i
        has the bodies `i * len(robot)` to `(i + 1) * len(robot)` (exclusive), and its pairs are
        `pairs + i * len(robot)`.

        Args:
            hulls: the hulls of `shapes`, as `Client.register` returned them.
            joints, base: as in `poses`.

        Raises:
            InvalidArgument: LENGTH_MISMATCH, another number of hulls; otherwise as `poses`.
        """
        hulls = list_of_hulls(hulls)
        if len(hulls) != len(self):
            raise InvalidArgument(
                f"got {counted(len(hulls), 'hull')} for {counted(len(self), 'shape')}, expected "
                "one hull per shape, in the order of Robot.shapes",
                reason="LENGTH_MISMATCH",
                field="hulls",
            )
        poses = self.poses(joints, base=base)
        copies = len(poses) if poses.ndim == 4 else 1
        return Scene(
            hulls,
            poses.reshape(-1, 4, 4),
            body_hulls=np.tile(np.arange(len(self)), copies),
            worlds=np.repeat(np.arange(copies), len(self)),
            groups=np.tile(self.groups, copies),
            ignored_groups=self.ignored_groups,
        )

    def _motion(self, joint: Joint, values: Floats) -> Floats:
        """(k, 4, 4): the motions of a joint for k configurations."""
        motion = np.tile(np.eye(4), (len(values), 1, 1))
        if joint.is_fixed:
            return motion
        value = joint.factor * values[:, self.joints.index(joint.mimics or joint.name)]
        value = value + joint.offset
        if joint.kind == "prismatic":
            motion[:, :3, 3] = value[:, None] * joint.axis
            return motion
        # Rodrigues' formula: 1 + sin K + (1 - cos) K^2, where K is the cross product with the axis.
        x, y, z = joint.axis
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        # 1 - cos(v) = 2 sin(v / 2)^2 avoids cancellation.
        turned = np.sin(value)[:, None, None] * cross
        turned = turned + (2 * np.sin(value / 2) ** 2)[:, None, None] * (cross @ cross)
        motion[:, :3, :3] += turned
        return motion


def _named_pieces(label: str, pieces: Sequence[Any]) -> list[Any]:
    """The convex pieces of a collision element; points have the element's name in messages."""
    several = len(pieces) > 1
    return [
        _mesh.Points.of(cast("Floats", piece), f"{label}, piece {k}" if several else label)
        if isinstance(piece, np.ndarray)
        else piece
        for k, piece in enumerate(pieces)
    ]


def _check_base(roots: Floats) -> None:
    """Raises if a pose of the root link is not finite, or is not a pose."""
    wrong = np.flatnonzero(~np.isfinite(roots).all(axis=(1, 2)))
    if wrong.size:
        raise InvalidArgument(
            "the pose has a number that is not finite",
            reason="NOT_FINITE",
            field="base",
            index=int(wrong[0]),
        )
    _arrays.check_bottom("base", roots)
    _arrays.quaternions("base", roots[:, :3, :3])


def _named(ignored: Any) -> list[tuple[str, str]]:
    """Checks that the argument `ignored` is pairs of names, and returns it as a list."""
    given: list[Any] = list(ignored) if _arguments.iterable(ignored) else [ignored]
    pairs = [
        tuple(pair) if _arguments.iterable(pair) and not isinstance(pair, str) else ()
        for pair in given
    ]
    for i, pair in enumerate(pairs):
        if len(pair) != 2 or not all(isinstance(name, str) for name in pair):
            raise InvalidArgument(
                "expected pairs of names of links, such as [('hand', 'elbow')]",
                reason="NOT_A_PAIR",
                field="ignored",
                index=i,
            )
    return cast("list[tuple[str, str]]", pairs)


def _refuse_for_mjcf(packages: Any, srdf: Any) -> None:
    """Raises if an argument is given that has no meaning for an MJCF file."""
    for field, value, absent in (("packages", packages, ()), ("srdf", srdf, None)):
        if value is not absent and not (isinstance(value, (tuple, list)) and not value):
            raise InvalidArgument(
                f"got {_arguments.shown(value)}, expected nothing: an MJCF file names its meshes "
                "and its exclusions itself",
                reason="NOT_ALLOWED",
                field=field,
            )


def _indices_of(ignored: Sequence[tuple[str, str]], links: Sequence[str]) -> list[tuple[int, int]]:
    """The indices of the links that pairs of names name.

    Raises:
        InvalidArgument: UNKNOWN_LINK.
    """
    for name in itertools.chain.from_iterable(ignored):
        if name not in links:
            raise InvalidArgument(
                f"got the link {name!r}, expected links of the robot's file",
                reason="UNKNOWN_LINK",
                field="ignored",
            )
    return [(links.index(a), links.index(b)) for a, b in ignored]


def _sorted(a: int, b: int) -> tuple[int, int]:
    return (a, b) if a <= b else (b, a)


def _ignoring(
    model: _urdf.Model, used: set[int], named: Sequence[tuple[str, str]]
) -> set[tuple[int, int]]:
    """The pairs of links with bodies that ignore each other, each with the lower index first."""
    part = list(range(len(model.links)))
    above: dict[int, int] = {}
    for joint in model.ordered:
        if joint.is_fixed:
            part[joint.child] = part[joint.parent]
        else:
            above[joint.child] = joint.parent
    solid = {part[link] for link in used}
    silent: set[tuple[int, int]] = set()
    for a, b in itertools.combinations(sorted(used), 2):
        p, q = part[a], part[b]
        if (
            p == q
            or q == _next_solid(p, part, above, solid)
            or p == _next_solid(q, part, above, solid)
        ):
            silent.add((a, b))
    for a, b in _indices_of(named, model.links):
        if a != b and a in used and b in used:
            silent.add(_sorted(a, b))
    return silent


def _next_solid(part: int, parts: Sequence[int], above: Mapping[int, int], solid: set[int]) -> int:
    """The nearest part up the tree that has bodies; -1 if there is none."""
    while part in above:
        part = parts[above[part]]
        if part in solid:
            return part
    return -1
