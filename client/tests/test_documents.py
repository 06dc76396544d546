"""Links, files and make targets in the documents exist, and README's program works.

`test_blocks.py` and `test_commands.py` check the code of the pages.
"""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pages

ROOT = Path(__file__).resolve().parents[2]
_LINK = re.compile(r"\]\(([^)\s]+)\)")
_FENCE = re.compile(r"^```.*?^```$", re.DOTALL | re.MULTILINE)
_HEADING = re.compile(r"^#+ (.*)$", re.MULTILINE)
_CODE = re.compile(r"^```\w*\n(.*?)^```$|`([^`\n]+)`", re.DOTALL | re.MULTILINE)
_TARGET = re.compile(r"^([\w./$()-]+(?: [\w-]+)*):", re.MULTILINE)
_FILE = re.compile(r"[\w./-]+\.(?:rs|py|proto|md|toml|sh|mjs|ts|go|cpp|java|yaml)")


def _documents() -> list[Path]:
    names = _listed("*.md") or [str(path.relative_to(ROOT)) for path in ROOT.glob("docs/**/*.md")]
    return [ROOT / name for name in names]


def _listed(*patterns: str) -> list[str]:
    command = ["git", "ls-files", *patterns]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout.split()


def _code() -> list[tuple[Path, str]]:
    """Every piece of code in the documents, fenced or inline, with continued lines joined."""
    return [
        (page, (fenced or inline).replace("\\\n", " "))
        for page in _documents()
        for fenced, inline in _CODE.findall(page.read_text())
    ]


def _anchors(page: Path) -> set[str]:
    text = _FENCE.sub("", page.read_text())
    plain = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in _HEADING.findall(text))
    return {heading.strip().replace(" ", "-") for heading in plain}


def test_every_link_leads_somewhere():
    """Each link leads to a file of this repository, and to a heading of it if one is given."""
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


def test_every_target_of_make_is_one():
    """Targets after `make` exist. In CONTRIBUTING further targets may follow without `make`."""
    rules = _TARGET.findall((ROOT / "Makefile").read_text())
    targets = {name for rule in rules for name in rule.split()}
    named = 0
    for page, code in _code():
        names = re.findall(r"(?<![\w-])make ([a-z][a-z0-9-]*)", code)
        if page.name == "CONTRIBUTING.md" and re.fullmatch(r"[a-z]+(-[a-z]+)+", code):
            names.append(code)
        for name in names:
            assert name in targets, f"{page.relative_to(ROOT)}: make {name}"
            named += 1
    assert named > 50, named


def test_every_feature_is_one():
    manifest = (ROOT / "Cargo.toml").read_text()
    section = re.search(r"^\[features\]\n(.*?)^\[", manifest, re.DOTALL | re.MULTILINE)
    assert section
    features = re.findall(r"^(\w+) = ", section[1], re.MULTILINE)
    named = [
        (page, feature)
        for page in _documents()
        for listed in re.findall(r"(?:--features[ =]|\bfeature `)([a-z0-9,]+)", page.read_text())
        for feature in listed.split(",")
    ]
    for page, feature in named:
        assert feature in features, f"{page.relative_to(ROOT)}: --features {feature}"
    assert len(named) > 8, named


def test_every_file_that_is_named_is_there():
    """A document may name a file by the end of its path, relative to the document's topic."""
    ends = {name[start:] for name in _listed() for start in _starts(name)}
    named = 0
    for page, code in _code():
        if _FILE.fullmatch(code) and page.name != "CHANGELOG.md":
            assert code in ends, f"{page.relative_to(ROOT)}: {code}"
            named += 1
    assert named > 70 or not ends, named


def test_every_crates_licence_is_listed():
    """Catches a change of the dependencies without `make licences`."""
    lock = re.findall(r'^name = "(.*)"$', (ROOT / "Cargo.lock").read_text(), re.MULTILINE)
    page = (ROOT / "docs/licences.md").read_text()
    rows = re.findall(r"^\| .* \| (.*) \|$", page.partition("<!-- crates -->")[2], re.MULTILINE)
    listed = {name for row in rows for name in row.split(", ")}
    own = [ROOT / "Cargo.toml", *ROOT.glob("crates/*/Cargo.toml")]
    names = [re.findall(r'^name = "(.*)"$', path.read_text(), re.MULTILINE)[0] for path in own]
    assert set(lock) - listed == set(names)
    assert len(lock) > 300


def _starts(name: str) -> list[int]:
    return [0, *(place + 1 for place, letter in enumerate(name) if letter == "/")]


def test_readme_prints_what_it_shows(tmp_path):
    assert pages.run(ROOT / "README.md", tmp_path) == 1
