"""The documentation's pages do what they say."""

from __future__ import annotations

import re

import pages
import pytest

#: Pages and the outputs that each shows.
SHOWN = {"first-contacts": 9, "finding": 2, "loops": 2, "workers": 1, "accuracy": 5}
#: The same of those that need a robot or ray, which `extras/` runs.
EXTRAS = {"robots": 3, "batch-jobs": 2}


@pytest.mark.parametrize("page", SHOWN)
def test_a_page_prints_what_it_shows(page, tmp_path):
    """Its program runs as a user's would, and its outputs are those printed."""
    assert pages.run(pages.DOCS / f"{page}.md", tmp_path) == SHOWN[page]


def test_no_page_is_left_out():
    """Of the folder; and what they link to is there."""
    found = {page.stem: page.read_text() for page in pages.DOCS.glob("*.md")}
    assert set(found) == {*SHOWN, *EXTRAS}
    links = [link for text in found.values() for link in re.findall(r"\]\(([^)#:]+)[#)]", text)]
    assert len(links) > 5
    for link in links:
        assert (pages.DOCS / link).exists(), link
