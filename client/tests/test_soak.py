"""A short version of the long run in docs/reliability.md."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import hullcast

ROOT = Path(__file__).resolve().parents[2]


def test_memory_is_bounded_under_everything_at_once() -> None:
    """Catches memory that grows with the work that a server has done.

    The script fails if memory exceeds the cache plus a constant. The cache is less than half of the
    data that passes through it.
    """
    command = [sys.executable, str(ROOT / "client/examples/soak.py"), "--cache-bytes", "4000000"]
    command += ["--registrations", "10000", "--hulls", "3000", "--rounds", "24"]
    path = str(Path(hullcast.__file__).parents[1])
    done = subprocess.run(
        command, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, timeout=900
    )
    assert done.returncode == 0, done.stderr
    counts = {name: int(count) for name, count in re.findall(r"'(\w+)': (\d+)", done.stdout)}
    assert counts["registered"] == 24 * 200
    assert counts["stepped"] > 24 * 5 * 500 / 2
    assert counts["queried"] > 24 * 3000 / 2
    assert min(counts["found"], counts["deleted"]) > 24
