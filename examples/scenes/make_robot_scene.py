"""Makes panda.json and anymal_c.json: collision hulls of real robots in several configurations.

    pip install numpy scipy example-robot-data        # about 130 MB of wheels
    python make_robot_scene.py [--robots FOLDER] [--out FOLDER]

The hulls are the convex hulls of the URDFs' collision geometry. Bodies in contact are sunk into
each other by SINK metres, as a simulator leaves them.
"""

import argparse
import itertools
import sysconfig
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import robot
import shapes
from robot import pose

HERE = Path(__file__).parent
INSTALLED = Path(sysconfig.get_paths()["purelib"]) / "cmeel.prefix/share/example-robot-data/robots"
SINK = 1e-4
MARGIN = 0.002


class Scene:
    """Hulls and bodies, with a growing list of frames."""

    def __init__(self, robot_model, objects):
        self.robot = robot_model
        self.objects = objects  # name -> vertices
        self.names = [p.name for p in robot_model.pieces] + list(objects)
        self.vertices = [p.vertices for p in robot_model.pieces] + list(objects.values())
        self.frames = []

    def add(self, name, angles, base, placed):
        """Adds a frame: joint values, the base's pose, and the pose (4, 4) of every object."""
        poses = self.robot.piece_poses(angles, base) + [placed[o] for o in self.objects]
        self.frames.append((name, np.array(poses)))

    def pairs(self):
        """Pairs with bounding spheres within the margin in some frame, without ignored links."""
        low = np.array([v.min(axis=0) for v in self.vertices], float)
        high = np.array([v.max(axis=0) for v in self.vertices], float)
        middle = (low + high) / 2
        radius = np.array([np.linalg.norm(v - m, axis=1).max() for v, m in zip(self.vertices, middle)])
        centres = [np.einsum("bij,bj->bi", p[:, :3, :3], middle) + p[:, :3, 3] for _, p in self.frames]
        pieces = self.robot.pieces
        chosen = []
        for i, j in itertools.combinations(range(len(self.vertices)), 2):
            if j < len(pieces) and self.robot.ignores(pieces[i].link, pieces[j].link):
                continue
            reach = radius[i] + radius[j] + MARGIN
            if any(np.linalg.norm(c[i] - c[j]) <= reach for c in centres):
                chosen.append([i, j])
        return chosen

    def document(self, name, licence, origin):
        """The scene file's content. Equal shapes share one hull."""
        hulls, index, body_hulls = [], {}, []
        sources = [(p.source, p.volume_ratio) for p in self.robot.pieces] + [("made by the script", 1.0)] * len(
            self.objects
        )
        for body, vertices, (source, ratio) in zip(self.names, self.vertices, sources):
            key = np.ascontiguousarray(vertices, float).tobytes()
            if key not in index:
                index[key] = len(hulls)
                hulls.append(
                    {"name": body, "source": source, "volume_ratio": round(ratio, 9), "vertices": vertices}
                )
            body_hulls.append(index[key])
        frames = [{"name": frame, **_columns(poses)} for frame, poses in self.frames]
        bodies = [
            {"name": body, "hull": hull, "position": position, "rotation": rotation}
            for body, hull, position, rotation in zip(
                self.names, body_hulls, frames[0]["positions"], frames[0]["rotations"]
            )
        ]
        return {
            "format": "hullcast.scene.v1",
            "name": name,
            "units": "m",
            "license": licence,
            "origin": origin,
            "margin": MARGIN,
            "hulls": hulls,
            "bodies": bodies,
            "frames": frames,
            "pairs": self.pairs(),
        }


def _columns(poses):
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat(canonical=True)
    return {"positions": poses[:, :3, 3], "rotations": quaternions}


def standing(vertices, xy, rotation=None, on=0.0):
    """The pose in which the hull stands on the height `on`, sunk in by SINK."""
    rotation = rotation or Rotation.identity()
    lowest = rotation.apply(vertices)[:, 2].min()
    return pose([*xy, on - lowest - SINK], rotation)


def yaw(degrees):
    """A rotation about the vertical axis."""
    return Rotation.from_euler("z", degrees, degrees=True)


# --- the Panda over a table -------------------------------------------------------------------

PANDA_JOINTS = [f"panda_joint{i}" for i in range(1, 8)]
PANDA_HOME = np.array([0, -np.pi / 4, 0, -3 * np.pi / 4, 0, np.pi / 2, np.pi / 4])
PAD_OFFSET = 2e-5  # the finger pads' inner faces are this far past the middle when closed


def reach(arm, target, start):
    """Joint values that bring the tool centre to the pose `target` (4, 4), by least squares."""

    def error(values):
        hand = arm.link_poses(dict(zip(PANDA_JOINTS, values)))["panda_hand_tcp"]
        turn = Rotation.from_matrix(hand[:3, :3].T @ target[:3, :3]).as_rotvec()
        return np.concatenate([hand[:3, 3] - target[:3, 3], 0.3 * turn])

    limits = np.array([j.limits for name in PANDA_JOINTS for j in arm.joints if j.name == name]).T
    found = least_squares(error, np.clip(start, *limits), bounds=limits, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    if np.abs(found.fun).max() > 1e-9:
        raise RuntimeError(f"the arm cannot reach {target[:3, 3]}")
    return found.x


def panda(folder):
    """The arm stands on a table and grasps, carries, stacks and presses."""
    description = folder / "panda_description"
    arm = robot.load(description / "urdf/panda.urdf", description / "srdf/panda.srdf", folder.parents[1])
    rng = np.random.default_rng(2010)
    objects = {
        "table": shapes.box([1.5, 1.3, 0.05]),
        "part": shapes.box([0.04, 0.05, 0.09]),
        "crate": shapes.box([0.2, 0.26, 0.12]),
        "lid": shapes.box([0.16, 0.18, 0.02]),
        "hexagonal prism": shapes.prism(6, 0.045, 0.14),
        "disc": shapes.prism(24, 0.09, 0.03),
        "ramp": shapes.wedge(0.22, 0.16, 0.07),
        "ball": shapes.icosphere(0.05),
        "rock 1": shapes.rock(rng, 24, [0.07, 0.05, 0.04]),
        "rock 2": shapes.rock(rng, 40, [0.06, 0.06, 0.05]),
        "bar": shapes.box([0.3, 0.02, 0.02]),
    }
    scene = Scene(arm, objects)
    at_rest = {
        "table": pose([0.3, 0, -0.025]),
        "part": standing(objects["part"], [0.5, 0.15], yaw(20)),
        "crate": standing(objects["crate"], [0.55, -0.25], yaw(-15)),
        "hexagonal prism": standing(objects["hexagonal prism"], [0.3, -0.45], yaw(10)),
        "disc": standing(objects["disc"], [0.35, 0.42]),
        "ramp": standing(objects["ramp"], [0.75, 0.3], yaw(30)),
        "ball": standing(objects["ball"], [0.82, 0.02]),
        "rock 1": standing(objects["rock 1"], [0.1, 0.45], shapes.resting_rotation(objects["rock 1"])),
        "rock 2": standing(objects["rock 2"], [0.85, -0.3], shapes.resting_rotation(objects["rock 2"])),
    }
    crate_top, disc_top = 0.12 - SINK, 0.03 - SINK
    at_rest["lid"] = standing(objects["lid"], [0.55, -0.25], yaw(10), on=crate_top)
    at_rest["bar"] = standing(objects["bar"], [0.35, 0.42], yaw(70), on=disc_top)

    base = pose([0, 0, -SINK])
    down = Rotation.from_euler("x", 180, degrees=True)
    open_hand = {"panda_finger_joint1": 0.04}
    holding = {"panda_finger_joint1": 0.025 + PAD_OFFSET - SINK}
    closed = {"panda_finger_joint1": 0.0}

    def frame(name, tool, fingers, placed, start=PANDA_HOME):
        values = reach(arm, np.linalg.inv(base) @ tool, start)
        scene.add(name, dict(zip(PANDA_JOINTS, values)) | fingers, base, placed)
        return values

    # The tool centre is 15 mm above the middle of the part. The pads close along the hand's y axis.
    part_to_tool = pose([0, 0, 0.015], down)
    grasp = at_rest["part"] @ part_to_tool
    scene.add("home", dict(zip(PANDA_JOINTS, PANDA_HOME)) | open_hand, base, at_rest)
    over = frame("approach", pose([0, 0, 0.06]) @ grasp, open_hand, at_rest)
    frame("grasp", grasp, holding, at_rest, over)
    lifted = pose([0.5, 0.05, 0.4], yaw(35) * Rotation.from_euler("y", 25, degrees=True))
    frame("lift", lifted @ part_to_tool, holding, at_rest | {"part": lifted}, over)
    stacked = standing(objects["part"], [0.55, -0.25], yaw(35), on=crate_top + 0.02 - SINK)
    frame("stack", stacked @ part_to_tool, holding, at_rest | {"part": stacked}, over)
    # The fingertips reach 9.5 mm past the tool centre.
    press = pose([0.35, 0.42, disc_top + 0.02 - SINK + 0.0095 - SINK], yaw(70) * down)
    frame("press", press, closed, at_rest, over)
    return scene.document(
        "Panda over a table",
        "Apache-2.0 (robot: LICENSES/panda-Apache-2.0.txt); objects: as this project",
        "example-robot-data 6.0.0, panda_description, from franka_ros/franka_description, Franka Emika GmbH; "
        "changed: convex hulls of the collision geometry",
    )


# --- ANYmal C on the ground -------------------------------------------------------------------

LEGS = ("LF", "RF", "LH", "RH")
# Flat ground, given by a point of the plane and its normal.
GROUND = (np.zeros(3), np.array([0.0, 0, 1]))


class Quadruped:
    """ANYmal C with feet that can be placed on planes."""

    def __init__(self, model):
        self.model = model
        self.feet = {
            leg: next(p for p in model.pieces if p.link == f"{leg}_FOOT" and "sphere" in p.source) for leg in LEGS
        }

    def foot(self, leg, angles, base):
        """The world vertices of a foot's ball."""
        piece = self.feet[leg]
        world = self.model.link_poses(angles, base)[piece.link] @ piece.origin
        return piece.vertices @ world[:3, :3].T + world[:3, 3]

    def stand(self, base, plan, guess):
        """Joint values that place each foot at (x, y) of `plan`, sunk into its plane by SINK."""
        angles = dict(guess)
        for leg, (xy, (point, normal), lift) in plan.items():
            names = [f"{leg}_{joint}" for joint in ("HAA", "HFE", "KFE")]

            def error(values, names=names, leg=leg, xy=xy, point=point, normal=normal, lift=lift):
                vertices = self.foot(leg, angles | dict(zip(names, values)), base)
                middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
                return [*(middle[:2] - xy), ((vertices - point) @ normal).min() - lift + SINK]

            found = least_squares(error, [guess[n] for n in names], xtol=1e-15, ftol=1e-15, gtol=1e-15)
            if np.abs(found.fun).max() > 1e-9:
                raise RuntimeError(f"{leg} cannot reach {xy}")
            angles |= dict(zip(names, found.x))
        return angles


def stance(hfe, kfe, haa=0.1):
    """Joint values for inward-bent knees; front and hind legs are mirrored."""
    angles = {}
    for leg in LEGS:
        front, left = leg[1] == "F", leg[0] == "L"
        angles |= {
            f"{leg}_HAA": -haa if left else haa,
            f"{leg}_HFE": hfe if front else -hfe,
            f"{leg}_KFE": kfe if front else -kfe,
        }
    return angles


def footprints(length, width, planes=None, lifts=None, shift=(0, 0)):
    """The target of each foot: (x, y), plane, and height above the plane."""
    planes, lifts = planes or {}, lifts or {}
    return {
        leg: (
            np.array(
                [(length if leg[1] == "F" else -length) + shift[0], (width if leg[0] == "L" else -width) + shift[1]]
            ),
            planes.get(leg, GROUND),
            lifts.get(leg, 0.0),
        )
        for leg in LEGS
    }


def anymal(folder):
    """The robot stands, trots, climbs, lies down and pushes among objects on the ground."""
    description = folder / "anymal_c_simple_description"
    model = robot.load(description / "urdf/anymal.urdf", description / "srdf/anymal.srdf", folder.parents[1])
    dog = Quadruped(model)
    rng = np.random.default_rng(2010)
    objects = {
        "ground": shapes.box([5, 4, 0.2]),
        "step": shapes.box([0.5, 0.9, 0.15]),
        "ramp": shapes.wedge(0.8, 0.9, 0.2),
        "crate": shapes.box([0.4, 0.5, 0.6]),
        "box": shapes.box([0.25, 0.3, 0.2]),
        "barrel": shapes.prism(24, 0.2, 0.55),
        "post": shapes.prism(6, 0.12, 0.8),
        "plank": shapes.box([1.2, 0.18, 0.03]),
    } | {f"rock {i}": shapes.rock(rng, n, h) for i, (n, h) in enumerate(
        [(20, [0.2, 0.15, 0.1]), (32, [0.15, 0.15, 0.12]), (48, [0.12, 0.1, 0.1]), (96, [0.25, 0.2, 0.12])], 1)}
    scene = Scene(model, objects)
    placed = {
        "ground": pose([0, 0, -0.1]),
        "step": standing(objects["step"], [1.6, 1.0]),
        "ramp": standing(objects["ramp"], [-1.5, 1.2]),
        "crate": standing(objects["crate"], [1.3, -1.2], yaw(12)),
        "box": standing(objects["box"], [1.3, -1.2], yaw(40), on=0.6 - SINK),
        "barrel": standing(objects["barrel"], [-1.0, -1.3]),
        "post": standing(objects["post"], [-2.0, -0.6]),
        "plank": standing(objects["plank"], [-0.4, 1.5], yaw(5)),
        "rock 1": standing(objects["rock 1"], [0.2, -1.5], shapes.resting_rotation(objects["rock 1"])),
        "rock 2": standing(objects["rock 2"], [2.0, -0.2], shapes.resting_rotation(objects["rock 2"])),
        "rock 3": standing(objects["rock 3"], [-1.9, 0.4], shapes.resting_rotation(objects["rock 3"])),
        "rock 4": standing(objects["rock 4"], [0.6, 1.6], shapes.resting_rotation(objects["rock 4"])),
    }

    def frame(name, base, plan, guess, moved=None):
        scene.add(name, dog.stand(base, plan, guess), base, placed | (moved or {}))

    upright, crouched = stance(0.7, -1.0), stance(1.4, -2.3)
    frame("stand", pose([0, 0, 0.5]), footprints(0.36, 0.25), upright)
    lifts = {"LF": 0.08, "RH": 0.06}
    frame("trot", pose([0.05, 0, 0.48], Rotation.from_euler("y", 2, degrees=True)),
          footprints(0.36, 0.25, lifts=lifts, shift=(0.05, 0)), upright)
    step = standing(objects["step"], [0.62, 0])
    top = (np.array([0, 0, 0.15 - SINK]), GROUND[1])
    frame("step up", pose([0, 0, 0.54], Rotation.from_euler("y", -10, degrees=True)),
          footprints(0.42, 0.25, planes={"LF": top, "RF": top}), upright, {"step": step})
    slope = Rotation.from_euler("y", -np.arctan2(0.2, 0.8))
    ramp = standing(objects["ramp"], [0.6, 0])
    face = (ramp[:3, 3] - [0.4, 0, 0], slope.apply([0, 0, 1]))
    frame("ramp", pose([0, 0, 0.52], Rotation.from_euler("y", -7, degrees=True)),
          footprints(0.40, 0.25, planes={"LF": face, "RF": face}), upright, {"ramp": ramp})
    frame("lie down", pose([0, 0, 0.09 - SINK]), footprints(0.40, 0.32), crouched)
    # The front face is 0.4145 + 0.11 m ahead of the base's origin.
    crate = standing(objects["crate"], [0.2 + 0.5245 + 0.2 - SINK, 0])
    frame("push", pose([0.2, 0, 0.45]), footprints(0.33, 0.25, shift=(0.12, 0)), upright,
          {"crate": crate, "box": standing(objects["box"], crate[:2, 3], yaw(28), on=0.6 - SINK)})
    return scene.document(
        "ANYmal C on the ground",
        "BSD-3-Clause (robot: LICENSES/anymal_c-BSD-3-Clause.txt); objects: as this project",
        "example-robot-data 6.0.0, anymal_c_simple_description, ANYbotics AG; "
        "changed: cylinders and spheres as polyhedra inside them",
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=Path, default=INSTALLED, help="example-robot-data's robots folder")
    parser.add_argument("--out", type=Path, default=HERE)
    arguments = parser.parse_args()
    for name, make in (("panda", panda), ("anymal_c", anymal)):
        document = make(arguments.robots.resolve())
        path = arguments.out / f"{name}.json"
        shapes.write_scene(path, document)
        ratios = [h["volume_ratio"] for h in document["hulls"]]
        print(
            f"{path}: {len(document['hulls'])} hulls (volume ratio at least {min(ratios):.6f}), "
            f"{len(document['bodies'])} bodies, {len(document['frames'])} frames, {len(document['pairs'])} pairs"
        )


if __name__ == "__main__":
    main()
