"""Runs the commands of docs/grpcurl.md, if grpcurl and ghz are installed."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

import hullcast

PAGE = Path(__file__).resolve().parents[3] / "docs/grpcurl.md"

pytestmark = pytest.mark.skipif(
    not (shutil.which("grpcurl") and shutil.which("ghz")), reason="grpcurl or ghz is not installed"
)


def runs(page: str) -> list[tuple[str, str]]:
    """Each command of the page, and the output that the page shows."""
    blocks = re.findall(r"```console\n\$ (.*)\n([^`]*)```", page)
    return [(command, shown) for command, shown in blocks]


def said(output: str) -> list[str]:
    """The output split at white space, because the tools vary it."""
    return output.split()


def test_the_page_is_what_comes(client: hullcast.Client):
    """Reflection is enough for both tools, and the page shows what they print.

    ghz prints times, so it is only checked that every call was answered. With HULLCAST_WRITE_PAGE
    set, the outputs are written to the page instead.
    """
    environment = os.environ | {"ADDRESS": client.target}
    text = PAGE.read_text()
    seen = 0
    for command, shown in runs(text):
        done = subprocess.run(
            ["bash", "-c", command], env=environment, capture_output=True, text=True, timeout=120
        )
        output = done.stdout + done.stderr
        assert (done.returncode == 0) == ("ERROR:" not in output), output
        if command.startswith("ghz"):
            assert re.search(r"\[OK\]\s+2000 responses", output), output
        elif "HULLCAST_WRITE_PAGE" not in os.environ:
            assert said(output) == said(shown), command
        if "HULLCAST_WRITE_PAGE" in os.environ:
            lines = [line.rstrip() for line in output.strip().splitlines()]
            text = text.replace(f"$ {command}\n{shown}", f"$ {command}\n" + "\n".join(lines) + "\n")
        seen += 1
    assert seen == 6
    if "HULLCAST_WRITE_PAGE" in os.environ:
        PAGE.write_text(text)
