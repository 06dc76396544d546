"""The page about simulators prints the outputs that it shows."""

from __future__ import annotations

import pages
import pytest
from blocks import ROOT

pytest.importorskip("mujoco")
pytest.importorskip("newton")


def test_the_page_prints_what_it_shows(tmp_path):
    assert pages.run(ROOT / "docs/simulators.md", tmp_path) == 2
