"""The page about robots does what it says."""

from __future__ import annotations

import pages
import pytest


def test_the_page_about_robots(tmp_path):
    """From the Panda's URDF to contacts, and to those of 1,000 configurations."""
    pytest.importorskip("yourdfpy")
    assert pages.run(pages.DOCS / "robots.md", tmp_path) == 3
