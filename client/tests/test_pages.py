"""The documentation's pages print the outputs that they show."""

from __future__ import annotations

import re

import pages
import pytest

#: Pages and the number of outputs that each shows.
SHOWN = {
    "first-contacts": 10,
    "finding": 2,
    "margins": 3,
    "loops": 6,
    "workers": 1,
    "accuracy": 5,
    "derivatives": 2,
}
#: Pages with their outputs that need a robot, ray, torch or jax, which `extras/` runs.
EXTRAS = {"robots": 3, "batch-jobs": 2, "fitting": 2}


@pytest.mark.parametrize("page", SHOWN)
def test_a_page_prints_what_it_shows(page, tmp_path):
    """A page's program runs as a user would run it, and prints the outputs on the page."""
    assert pages.run(pages.DOCS / f"{page}.md", tmp_path) == SHOWN[page]


def test_no_page_is_left_out():
    """All pages of the folder are tested, and the files that they link to exist."""
    found = {page.stem: page.read_text() for page in pages.DOCS.glob("*.md")}
    assert set(found) == {*SHOWN, *EXTRAS}
    links = [link for text in found.values() for link in re.findall(r"\]\(([^)#:]+)[#)]", text)]
    assert len(links) > 5
    for link in links:
        assert (pages.DOCS / link).exists(), link
