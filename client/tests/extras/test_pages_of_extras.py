"""The pages about robots and ray, and the client's README, work for a user who follows them.

The pages' own install lines fill an empty environment, with the newest packages.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import venv
from pathlib import Path

import commands
import pages
import pytest
import stage
from blocks import ROOT, blocks_of
from crowds import RAY_SETTINGS
from test_pages import EXTRAS

#: Packages that the text of the pages names in addition: the extras of ray and rerun, and pandas.
NAMED = "pip install './client[ray,rerun]' pandas"
RAY = {**RAY_SETTINGS, "RAY_ADDRESS": "local"}


def install_lines() -> list[str]:
    """The `pip install` commands of the pages that are run here."""
    found = []
    for page in ("client/README.md", "docs/python/robots.md"):
        for block in blocks_of(ROOT / page):
            lines = commands.shown(block) if commands.is_shell(block) else []
            found += [line.partition(" #")[0] for line in lines if line.startswith("pip install ")]
    return found


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The interpreter of a new environment, which has only the packages that the pages install."""
    folder = tmp_path_factory.mktemp("user") / "environment"
    venv.create(folder, with_pip=True)
    hidden = ("HULLCAST_BIN", "PYTHONPATH", "PYTEST_ADDOPTS")
    environment = {name: value for name, value in os.environ.items() if name not in hidden}
    lines = install_lines()
    assert len(lines) > 2, lines
    for line in [*lines, NAMED]:
        command = [folder / "bin/python", "-m", *shlex.split(line)]
        subprocess.run(command, cwd=ROOT, env=environment, timeout=1800, check=True)
    return folder / "bin/python"


def test_the_page_about_robots(python, tmp_path):
    """Runs the page: from the Panda's URDF to contacts, also for 1,000 configurations at once."""
    assert pages.run(pages.DOCS / "robots.md", tmp_path, python) == EXTRAS["robots"]


def test_the_page_about_ray(python, tmp_path):
    """Answers a hundred scenes of a dataset, on a ray cluster of one node."""
    shown = pages.run(pages.DOCS / "batch-jobs.md", tmp_path, python, **RAY)
    assert shown == EXTRAS["batch-jobs"]


def test_the_programs_that_need_a_package(python, tmp_path):
    """Runs every block of the client's README, and the tasks of ray on the page about workers."""
    readme = blocks_of(ROOT / "client/README.md")
    (tasks,) = [b for b in blocks_of(pages.DOCS / "workers.md") if "@ray.remote" in b.text]
    blocks = [block for block in readme if block.kind == "python"]
    recording = "import rerun\nrerun.init('page')\nrerun.save('page.rrd')"
    stage.run(blocks, tmp_path, before=recording, python=python)
    before = (
        "import ray\nray.init(num_cpus=1, include_dashboard=False)\nscenes = [names()['scene']]"
    )
    stage.run([tasks], tmp_path, before=before, python=python, **RAY)
