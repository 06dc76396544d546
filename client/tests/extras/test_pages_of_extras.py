"""The pages about robots and ray print what they show."""

from __future__ import annotations

import pages
import pytest
from crowds import RAY_SETTINGS


def test_the_page_about_robots(tmp_path):
    """The page goes from the Panda's URDF to contacts, and to those of 1,000 configurations."""
    pytest.importorskip("yourdfpy")
    assert pages.run(pages.DOCS / "robots.md", tmp_path) == 3


def test_the_page_about_ray(tmp_path, monkeypatch):
    """The page queries a hundred scenes of a dataset, on a ray cluster of one node."""
    pytest.importorskip("ray")
    for name, value in {**RAY_SETTINGS, "RAY_ADDRESS": "local"}.items():
        monkeypatch.setenv(name, value)
    assert pages.run(pages.DOCS / "batch-jobs.md", tmp_path) == 2
