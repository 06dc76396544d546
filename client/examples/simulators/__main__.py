"""Runs scenes in MuJoCo and in Newton, on their own contacts and on hullcast's.

    python client/examples/simulators [--scenes tower,arch] [--engines MuJoCo] [--steps 400]

It needs the extras `mujoco` and `newton`, and mujoco-warp for Newton's SolverMuJoCo. It prints the
table of docs/simulators.md, with one row per run:
- drift: the largest displacement of a body from its place at the start; for the pile it is the
  median displacement of a body in the last half second;
- contacts: the mean number of contacts in the last half second;
- time per step: the median, of the whole step, and of its contacts in the case of Newton.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

sys.path.append(str(Path(__file__).resolve().parents[1] / "simulation"))

import models
import newton_models
import numpy as np
import scenes

import hullcast
import hullcast.mujoco
import hullcast.newton

mujoco: Any = importlib.import_module("mujoco")
newton: Any = importlib.import_module("newton")
warp: Any = importlib.import_module("warp")

TIME_STEP = 0.005
#: The number of steps over which contacts and the movement of a pile are measured.
LAST = 100
ONE = hullcast.Accuracy(max_points=1)
ACCURACIES = {"hullcast": hullcast.Accuracy.EXACT, "hullcast, one point": ONE}
NAMES = ("tower", "arch", "wall", "pile")
#: The factor of the distances in the lattice from which the pile falls.
WIDER = 1.5
#: Runs that take many minutes on a CPU.
LEFT_OUT = {("SolverMuJoCo", "pile")}


class Run(NamedTuple):
    """A row of the table."""

    engine: str
    scene: str
    contacts: str
    drift: float
    points: float
    #: The median milliseconds of a step, and of its contacts; NaN if they cannot be told apart.
    step: float
    contact: float

    def line(self) -> str:
        """The row in Markdown."""
        contact = "" if np.isnan(self.contact) else f"{self.contact:.2f}"
        return (
            f"| {self.engine} | {self.scene} | {self.contacts} | {1e3 * self.drift:.4g} "
            f"| {self.points:.0f} | {self.step:.2f} | {contact} |"
        )


class Record:
    """What is measured during a run."""

    def __init__(self, setup: scenes.Setup, steps: int) -> None:
        self._setup, self._steps = setup, steps
        self._start = setup.positions[setup.fixed :]
        self._counts: list[int] = []
        self._times: list[tuple[float, float]] = []

    def add(self, positions: models.Floats, count: int, step: float, contact: float) -> None:
        """Adds a step: positions (bodies, 3), the number of contacts, and seconds."""
        done = len(self._times)
        if self._setup.settles and done == self._steps - LAST:
            self._start = positions.copy()
        self._last = positions
        self._counts.append(count)
        self._times.append((step, contact))

    def row(self, engine: str, contacts: str) -> Run:
        """The figures of the run."""
        ways = np.linalg.norm(self._last - self._start, axis=1)
        drift = float(np.median(ways) if self._setup.settles else ways.max())
        step, contact = (1e3 * float(ms) for ms in np.median(self._times, axis=0))
        count = float(np.mean(self._counts[-LAST:]))
        return Run(engine, self._setup.name, contacts, drift, count, step, contact)


def in_mujoco(client: hullcast.Client, setup: scenes.Setup, steps: int) -> Iterator[Run]:
    """Runs a scene in MuJoCo. Its own contacts of meshes can be one point for each pair too."""
    text = models.mjcf(setup, time_step=TIME_STEP)
    single = text.replace("/>", '><flag multiccd="disable"/></option>', 1)
    own = {"MuJoCo": text}
    if any(models.half_extents(shape) is None for shape in setup.shapes):
        own["MuJoCo, one point"] = single
    for name, source in own.items():
        model = mujoco.MjModel.from_xml_string(source)
        step = partial(mujoco.mj_step, model)
        yield _simulated(setup, steps, mujoco.MjData(model), step).row("MuJoCo", name)
    for name, accuracy in ACCURACIES.items():
        model = mujoco.MjModel.from_xml_string(text)
        with hullcast.mujoco.NarrowPhase(client, model, accuracy=accuracy) as contacts:
            record = _simulated(setup, steps, mujoco.MjData(model), contacts.step)
        yield record.row("MuJoCo", name)


def _simulated(setup: scenes.Setup, steps: int, data: Any, step: Callable[[Any], None]) -> Record:
    record = Record(setup, steps)
    for _ in range(steps):
        begin = time.perf_counter()
        step(data)
        seconds = time.perf_counter() - begin
        record.add(data.xpos[1 + setup.fixed :].copy(), int(data.ncon), seconds, np.nan)
    return record


def in_newton(
    client: hullcast.Client, setup: scenes.Setup, steps: int, solver: str
) -> Iterator[Run]:
    """Runs a scene in one of Newton's solvers."""
    for name in ("Newton", *ACCURACIES):
        model: Any = newton_models.builder(setup).finalize()
        pipeline: Any = newton.CollisionPipeline(model)
        contacts: Any = pipeline.contacts()
        if name in ACCURACIES:
            pipeline = hullcast.newton.Pipeline(client, model, accuracy=ACCURACIES[name])
        chosen: Any
        if solver == "XPBD":
            chosen = newton.solvers.SolverXPBD(model, iterations=10)
        else:
            room = len(contacts.rigid_contact_shape0)
            chosen = newton.solvers.SolverMuJoCo(
                model, use_mujoco_contacts=False, nconmax=room, njmax=4 * room
            )
        record = Record(setup, steps)
        state, after, control = model.state(), model.state(), model.control()
        for _ in range(steps):
            state.clear_forces()
            begin = time.perf_counter()
            pipeline.collide(state, contacts)
            found = time.perf_counter()
            chosen.step(state, after, control, contacts, TIME_STEP)
            state, after = after, state
            positions = state.body_q.numpy()[:, :3].astype(float)
            end = time.perf_counter()
            count = int(contacts.rigid_contact_count.numpy()[0])
            record.add(positions, count, end - begin, found - begin)
        yield record.row(f"Newton, {solver}", name)


def scene(name: str) -> scenes.Setup:
    """One of the scenes. The pile's lattice is wider, so that no bodies overlap at the start."""
    setup = scenes.SCENES[name]()
    if setup.settles:
        setup.positions[setup.fixed :] *= WIDER
    return setup


def print_nothing(_: str) -> None:
    """Takes MuJoCo's warnings of unstable steps, which the table shows by their drift."""


def main() -> None:
    """Simulates and prints."""
    parser = argparse.ArgumentParser(description="Contacts inside simulators")
    parser.add_argument("--scenes", default=",".join(NAMES), help="some of them")
    parser.add_argument("--engines", default="MuJoCo,XPBD,SolverMuJoCo", help="some of them")
    parser.add_argument("--steps", type=int, default=400, help="the steps of each run")
    arguments = parser.parse_args()
    warp.config.log_level = warp.LOG_ERROR
    # Single points make scenes unstable, of which MuJoCo would write a file.
    mujoco.set_mju_user_warning(print_nothing)
    warnings.filterwarnings("ignore", "MuJoCo dependency version mismatch")
    columns = (
        "engine",
        "scene",
        "contacts of",
        "drift, mm",
        "contacts",
        "step, ms",
        "contacts, ms",
    )
    print(f"| {' | '.join(columns)} |\n|{'---|' * len(columns)}")
    with hullcast.serve() as client:
        for engine in arguments.engines.split(","):
            for name in arguments.scenes.split(","):
                if (engine, name) in LEFT_OUT:
                    continue
                setup = scene(name)
                steps = arguments.steps * (2 if setup.settles else 1)
                if engine == "MuJoCo":
                    runs = in_mujoco(client, setup, steps)
                else:
                    runs = in_newton(client, setup, steps, engine)
                for run in runs:
                    print(run.line(), flush=True)
    print(
        f"\nmujoco {mujoco.__version__}, newton {newton.__version__}, "
        f"{arguments.steps} steps of {1e3 * TIME_STEP:g} ms, twice as many for the pile."
    )


if __name__ == "__main__":
    main()
