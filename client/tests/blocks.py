"""Finds the code of every page: fenced blocks, and code within the text."""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
_FENCE = re.compile(r"^( *)(`{3,}|~{3,})([^\n`]*)\n(.*?)^\1\2 *$", re.DOTALL | re.MULTILINE)
_INLINE = re.compile(r"(?<!`)`([^`]+)`(?!`)")
_WRITTEN = re.compile(r"^<!-- (\w[\w-]*) -->$.*?^<!-- /\1 -->$", re.DOTALL | re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    page: str
    line: int
    kind: str
    text: str
    # The mark (`<!-- mark -->`) of the section that a command of this repository writes, or "".
    mark: str
    # The kind of the block that ends on the line before this one, or "".
    after: str

    @property
    def where(self) -> str:
        return f"{self.page}:{self.line}"


def listed(*patterns: str) -> list[str]:
    """The files of the repository, including new ones that are not committed yet."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", *patterns]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    # During a merge a file is listed once per version.
    names = dict.fromkeys(done.stdout.splitlines())
    return [name for name in names if (ROOT / name).exists()]


def pages() -> list[Path]:
    """Every page of Markdown."""
    names = listed("*.md")
    found = [ROOT / name for name in names]
    if not names:
        found = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), ROOT / "client/README.md"]
    return found


def blocks_of(page: Path) -> list[Block]:
    """All fenced blocks of a page, in order."""
    text = page.read_text()
    written = [(match.start(), match.end(), match[1]) for match in _WRITTEN.finditer(text)]
    found: list[Block] = []
    end, kind_before = -1, ""
    for match in _FENCE.finditer(text):
        marks = [mark for start, stop, mark in written if start < match.start() < stop]
        kind = match[3].strip()
        found.append(
            Block(
                page=str(page.relative_to(ROOT)),
                line=text.count("\n", 0, match.start()) + 1,
                kind=kind,
                text=match[4],
                mark=marks[0] if marks else "",
                after=kind_before if match.start() == end + 1 else "",
            )
        )
        end, kind_before = match.end(), kind
    return found


def every_block() -> list[Block]:
    return [block for page in pages() for block in blocks_of(page)]


def without_blocks(page: Path) -> str:
    return _FENCE.sub("", page.read_text())


def inline_code(page: Path) -> list[str]:
    """The code between backticks in the text, each on one line."""
    return [" ".join(code.split()) for code in _INLINE.findall(without_blocks(page))]
