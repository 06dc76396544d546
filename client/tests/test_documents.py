"""What the documents link to is there, and README's program does what it says."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pages

ROOT = Path(__file__).resolve().parents[2]
_LINK = re.compile(r"\]\(([^)\s]+)\)")
_FENCE = re.compile(r"^```.*?^```$", re.DOTALL | re.MULTILINE)
_HEADING = re.compile(r"^#+ (.*)$", re.MULTILINE)


def _documents() -> list[Path]:
    listed = subprocess.run(
        ["git", "ls-files", "*.md"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    names = listed.stdout.split() or [
        str(path.relative_to(ROOT)) for path in ROOT.glob("docs/**/*.md")
    ]
    return [ROOT / name for name in names]


def _anchors(page: Path) -> set[str]:
    text = _FENCE.sub("", page.read_text())
    plain = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in _HEADING.findall(text))
    return {heading.strip().replace(" ", "-") for heading in plain}


def test_every_link_leads_somewhere():
    """To a file of this repository, and to a heading of it where one is named."""
    links = 0
    for page in _documents():
        for link in _LINK.findall(_FENCE.sub("", page.read_text())):
            if ":" in link:
                continue
            name, _, anchor = link.partition("#")
            target = (page.parent / name).resolve() if name else page
            assert target.exists(), f"{page.relative_to(ROOT)}: {link}"
            assert target.is_relative_to(ROOT), f"{page.relative_to(ROOT)}: {link}"
            if anchor:
                assert anchor in _anchors(target), f"{page.relative_to(ROOT)}: {link}"
            links += 1
    assert links > 80, links


def test_readme_prints_what_it_shows(tmp_path):
    assert pages.run(ROOT / "README.md", tmp_path) == 1
