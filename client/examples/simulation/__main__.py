"""Compares kinds of contacts in a rigid body simulation, for several numbers of solver sweeps.

    python client/examples/simulation [--docs FOLDER] [--scenes tower,wall] [--quick]

There are five scenes and five kinds of contacts. A server computes the whole manifold; only the
deepest point of each pair; the manifold with a feature angle of 0; and the manifold of simplified
hulls (unless no hull lost a vertex). numpy computes the contacts of the same pairs by least
translation.

For each run the table has:
- drift: the largest displacement of a body that should have stayed in place. For the rocking box it
  covers the last second; for the pile it is the mean displacement of a body in the last second;
- jitter: the mean kinetic energy per kilogram over the last second;
- depth: the deepest contact in the last second;
- the number of contact points, and the times per step.

--docs writes the table, plots and animations of docs/simulation.md. Rows that are not run again
stay there.
"""

from __future__ import annotations

import argparse
import re
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import draw
import numpy as np
import scenes
from world import Step, World, matrices

import hullcast


class Variant(NamedTuple):
    """The settings of one kind of contacts."""

    accuracy: hullcast.Accuracy = hullcast.Accuracy.EXACT
    max_deviation: float | None = None
    by_least: bool = False


VARIANTS = {
    "manifold": Variant(),
    "one point": Variant(hullcast.Accuracy(max_points=1)),
    "least translation": Variant(by_least=True),
    "angle 0": Variant(hullcast.Accuracy(feature_angle=0.0)),
    "simplified": Variant(max_deviation=0.02),
}
SWEEPS = (5, 20, 60)
#: The scenes that are animated side by side, from runs with this many sweeps.
SHOWN, SHOWN_SWEEPS = ("tower", "arch", "rocking", "pile"), 20
FRAMES = 40
OPEN, CLOSE = "<!-- simulation -->", "<!-- /simulation -->"
HEAD = [
    "| scene | contacts | sweeps | drift, m | jitter, mJ/kg | depth, mm "
    "| points per step | contacts, ms | solver, ms |",
    "|---|---|---|---|---|---|---|---|---|",
]


def run(
    client: hullcast.Client, setup: scenes.Setup, name: str, sweeps: int, record: bool
) -> tuple[draw.Row, list[draw.Picture]] | None:
    """Runs one simulation; returns its figures, and pictures if requested.

    None: no hull was simplified, so the run would be a repetition.
    """
    variant = VARIANTS[name]
    world = World(
        client,
        setup.shapes,
        setup.positions.copy(),
        setup.rotations.copy(),
        setup.fixed,
        friction=setup.friction,
        iterations=sweeps,
        accuracy=variant.accuracy,
        max_deviation=variant.max_deviation,
        by_least=variant.by_least,
    )
    if variant.max_deviation is not None and not world.simpler:
        return None
    last = int(1 / world.dt)
    steps: list[Step] = []
    energy: list[float] = []
    pictures: list[draw.Picture] = []
    begin = world.positions
    for i in range(setup.steps):
        if record and i % max(1, setup.steps // FRAMES) == 0:
            turned = matrices(world.rotations)
            pictures.append(draw.frame(setup, world.positions, turned, name))
        if setup.settles and i == setup.steps - last:
            begin = world.positions
        steps.append(world.step())
        energy.append(world.kinetic_energy())
    world.close()
    ways = np.linalg.norm((world.positions - begin)[setup.fixed :], axis=1)
    row = draw.Row(
        scene=setup.name,
        variant=name,
        sweeps=sweeps,
        drift=float(ways.mean() if setup.name == "pile" else ways.max()),
        jitter=1e3 * float(np.mean(energy[-last:])) / float(world.masses[setup.fixed :].sum()),
        depth=1e3 * max(step.depth for step in steps[-last:]),
        contacts=float(np.mean([step.contacts for step in steps])),
        contact_ms=1e3 * float(np.median([step.seconds_contacts for step in steps])),
        solver_ms=1e3 * float(np.median([step.seconds_solver for step in steps])),
    )
    return row, pictures


def line(row: draw.Row) -> str:
    """Formats a row of the table."""
    return (
        f"| {row.scene} | {row.variant} | {row.sweeps} | {row.drift:.2e} "
        f"| {row.jitter:.2e} | {row.depth:.2f} | {row.contacts:.0f} "
        f"| {row.contact_ms:.2f} | {row.solver_ms:.2f} |"
    )


def read(text: str) -> draw.Row | None:
    """Parses a row of the table; None for a line without figures."""
    cells = [cell.strip() for cell in text.strip("|").split("|")]
    if len(cells) != 9 or cells[0] not in scenes.SCENES:
        return None
    return draw.Row(cells[0], cells[1], int(cells[2]), *map(float, cells[3:]))


def main() -> None:
    """Simulates and prints."""
    parser = argparse.ArgumentParser(description="Contacts in a rigid body simulation")
    parser.add_argument("--scenes", default=",".join(scenes.SCENES), help="some of them")
    parser.add_argument("--variants", default=",".join(VARIANTS), help="some of them")
    parser.add_argument("--docs", type=Path, help="writes simulation.md's table and pictures there")
    parser.add_argument("--quick", action="store_true", help="one number of sweeps")
    arguments = parser.parse_args()
    where = provenance()
    rows: list[draw.Row] = []
    recorded: dict[tuple[str, str], list[draw.Picture]] = {}
    print("\n".join(HEAD))
    with hullcast.serve() as client:
        for name in arguments.scenes.split(","):
            setup = scenes.SCENES[name]()
            for variant in arguments.variants.split(","):
                for sweeps in SWEEPS[1:2] if arguments.quick else SWEEPS:
                    shown = name in SHOWN and sweeps == SHOWN_SWEEPS
                    done = run(client, setup, variant, sweeps, bool(arguments.docs) and shown)
                    if done is None:
                        break
                    rows.append(done[0])
                    if shown:
                        recorded[name, variant] = done[1]
                    print(line(done[0]), flush=True)
            if arguments.docs:  # write after each scene, so that an abort loses little
                write(arguments.docs, where, rows, recorded)


def provenance() -> str:
    """The machine, its load and the commit, taken before anything runs."""
    script = Path(__file__).resolve().parents[3] / "scripts/provenance"
    return subprocess.run([script], capture_output=True, text=True, check=True).stdout.strip()


def write(
    docs: Path,
    where: str,
    rows: Sequence[draw.Row],
    recorded: dict[tuple[str, str], list[draw.Picture]],
) -> None:
    """Writes the page's table, its plot and the animations."""
    page = docs / "simulation.md"
    head, rest = page.read_text().split(OPEN)
    old, tail = rest.split(CLOSE)
    places = dict(re.findall(r"^- (\w+): (.*)$", old, re.MULTILINE))
    places |= {row.scene: where for row in rows}
    runs = {(row.scene, row.variant) for row in rows}
    kept = [
        row for row in map(read, old.splitlines()) if row and (row.scene, row.variant) not in runs
    ]
    order = [list(scenes.SCENES), list(VARIANTS)]
    rows = sorted(
        [*kept, *rows],
        key=lambda row: (order[0].index(row.scene), order[1].index(row.variant), row.sweeps),
    )
    measured = [f"- {name}: {places[name]}" for name in order[0] if name in places]
    table = "\n".join([*HEAD, *map(line, rows), "", *measured])
    page.write_text(f"{head}{OPEN}\n{table}\n{CLOSE}{tail}")
    draw.plot(rows, docs / "simulation.svg")
    for name in SHOWN:
        two = [recorded.get((name, variant), []) for variant in ("manifold", "one point")]
        if all(two):
            draw.animate(two[0], two[1], docs / f"simulation-{name}.gif", 0.08)


if __name__ == "__main__":
    main()
