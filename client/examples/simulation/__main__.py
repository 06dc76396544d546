"""Does it matter in a simulation? Five scenes, four kinds of contacts, several numbers of sweeps.

    python client/examples/simulation [--docs FOLDER] [--scenes tower,wall] [--quick]

Contacts come from a server of its own: the whole manifold, the deepest point of
each pair alone, the manifold with no feature angle, and that of simplified hulls.
Printed for each run: drift (the largest way a body went that should have stayed, or
over the last second), jitter (mean kinetic energy over the last second, a kilogram),
depth (the deepest contact in the last second), contacts, and time a step. --docs
writes the table, plots and animations of docs/simulation.md.
"""

from __future__ import annotations

import argparse
import subprocess
from pathlib import Path

import draw
import numpy as np
import scenes
from world import World, matrices

import hullcast

#: Of each kind of contacts: what the server is asked for, and how simplified.
VARIANTS = {
    "manifold": (hullcast.Accuracy(), None),
    "one point": (hullcast.Accuracy(max_points=1), None),
    "angle 0": (hullcast.Accuracy(feature_angle=0.0), None),
    "simplified": (hullcast.Accuracy(), 0.02),
}
SWEEPS = (5, 20, 60)
#: Shown side by side: a scene with this many sweeps.
SHOWN = {"tower": 20, "arch": 20, "rocking": 20}
FRAMES = 40
OPEN, CLOSE = "<!-- simulation -->", "<!-- /simulation -->"


def run(
    client: hullcast.Client, setup: scenes.Setup, variant: str, sweeps: int, record: bool
) -> tuple[dict, list]:
    """One simulation; its figures, and pictures if asked for."""
    accuracy, deviation = VARIANTS[variant]
    world = World(
        client,
        setup.shapes,
        setup.positions.copy(),
        setup.rotations.copy(),
        setup.fixed,
        friction=setup.friction,
        iterations=sweeps,
        accuracy=accuracy,
        max_deviation=deviation,
    )
    last = int(1 / world.dt)
    settles = setup.name in ("pile", "rocking")
    steps, energy, pictures = [], [], []
    begin = world.positions
    for i in range(setup.steps):
        if record and i % max(1, setup.steps // FRAMES) == 0:
            turned = matrices(world.rotations)
            pictures.append(draw.frame(setup, setup.shapes, world.positions, turned, variant))
        if settles and i == setup.steps - last:
            begin = world.positions
        steps.append(world.step())
        energy.append(world.kinetic_energy())
    way = np.linalg.norm((world.positions - begin)[setup.fixed :], axis=1)
    mass = world.masses[setup.fixed :].sum()
    mean = {
        name: np.mean([getattr(step, name) for step in steps]) for name in ("contacts", "pairs")
    }
    return {
        "scene": setup.name,
        "variant": variant,
        "sweeps": sweeps,
        "drift": float(way.max()),
        "jitter": 1e3 * float(np.mean(energy[-last:])) / mass,
        "depth": 1e3 * max(step.depth for step in steps[-last:]),
        "contacts": float(mean["contacts"]),
        "contact_ms": 1e3 * float(np.median([step.seconds_contacts for step in steps])),
        "solver_ms": 1e3 * float(np.median([step.seconds_solver for step in steps])),
    }, pictures


HEAD = [
    "| scene | contacts | sweeps | drift, m | jitter, mJ/kg | depth, mm "
    "| points a step | contacts, ms | solver, ms |",
    "|---|---|---|---|---|---|---|---|---|",
]


def line(row: dict) -> str:
    """Of the table."""
    return (
        f"| {row['scene']} | {row['variant']} | {row['sweeps']} | {row['drift']:.2e} "
        f"| {row['jitter']:.2e} | {row['depth']:.2f} | {row['contacts']:.0f} "
        f"| {row['contact_ms']:.2f} | {row['solver_ms']:.2f} |"
    )


def main() -> None:
    """Simulates and prints."""
    parser = argparse.ArgumentParser(description="Contacts in a rigid body simulation")
    parser.add_argument("--scenes", default=",".join(scenes.SCENES), help="some of them")
    parser.add_argument("--docs", type=Path, help="writes simulation.md's table and pictures there")
    parser.add_argument("--quick", action="store_true", help="one number of sweeps")
    arguments = parser.parse_args()
    rows: list[dict] = []
    recorded: dict[tuple[str, str], list] = {}
    print("\n".join(HEAD))
    with hullcast.serve() as client:
        for name in arguments.scenes.split(","):
            setup = scenes.SCENES[name]()
            for variant in VARIANTS:
                # Of the pile a sweep takes as long as a whole step of the others.
                some = SWEEPS[1:2] if name == "pile" else SWEEPS
                for sweeps in SWEEPS[1:2] if arguments.quick else some:
                    record = bool(arguments.docs) and SHOWN.get(name) == sweeps
                    row, pictures = run(client, setup, variant, sweeps, record)
                    rows.append(row)
                    recorded[name, variant] = pictures or recorded.get((name, variant), [])
                    print(line(row), flush=True)
            if arguments.docs:  # after each scene, so that what is done is there
                write(arguments.docs, rows, recorded)


def write(docs: Path, rows: list[dict], recorded: dict[tuple[str, str], list]) -> None:
    """The page's table, its plot and animations."""
    root = Path(__file__).resolve().parents[3]
    where = subprocess.run(
        [root / "scripts/provenance"], capture_output=True, text=True, check=True
    )
    page = docs / "simulation.md"
    head, rest = page.read_text().split(OPEN)
    table = "\n".join([where.stdout.strip(), "", *HEAD, *map(line, rows)])
    page.write_text(f"{head}{OPEN}\n{table}\n{CLOSE}{rest.split(CLOSE)[1]}")
    draw.plot(rows, docs / "simulation.svg")
    for name in SHOWN:
        if recorded.get((name, "manifold")) and recorded.get((name, "one point")):
            draw.animate(
                recorded[name, "manifold"],
                recorded[name, "one point"],
                docs / f"simulation-{name}.gif",
                0.08,
            )


if __name__ == "__main__":
    main()
