"""A test runs every block of every page, or `not_run.py` lists the block with a reason.

The tests find new pages by themselves, and fail until each of their blocks is run or listed.
"""

from __future__ import annotations

import ast
import re
import shlex
import shutil
import sys
import urllib.request
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from typing import Any

import commands
import not_run
import pages
import pytest
import stage
from blocks import ROOT, Block, blocks_of, every_block, listed, without_blocks
from blocks import pages as every_page
from crowds import Server
from replicas import free_ports
from shell import Shell
from test_pages import EXTRAS, SHOWN

#: The programs of the languages' blocks: each block is such a file, built by `make test-languages`.
PROGRAMS = {
    "go": "examples/go/first/main.go",
    "typescript": "examples/typescript/src/first.ts",
    "java": "examples/java/src/main/java/hullcast/conformance/First.java",
    "cpp": "examples/cpp/first.cpp",
}


def is_page_run(page: str) -> bool:
    """Whether a test runs the Python of the page as one program and compares its outputs."""
    path = Path(page)
    return page in ("README.md", "docs/simulators.md") or (
        path.parent == Path("docs/python") and path.stem in {*SHOWN, *EXTRAS}
    )


INDENTED = re.compile(r"^(?![-*+\d ]).*\n\n {4,}\S", re.MULTILINE)


def holder(block: Block) -> str | None:
    """How a block is tested, or why it is not run; None if neither is known."""
    if reason := not_run.reason(block):
        return f"not run: {reason}"
    if block.mark:
        return "written by a command of this repository"
    if block.kind == "python":
        if block.page in stage.PAGES:
            return "run on a stage"
        return "run as the page's program" if is_page_run(block.page) else None
    if block.kind == "text" and block.after in ("python", "text") and is_page_run(block.page):
        return "compared with what the page's program prints"
    if block.kind in PROGRAMS:
        return "a program of examples/"
    if block.kind == "rust" and block.page == "docs/rust.md":
        return "compiled by the tests of crates/client"
    return "commands" if commands.is_shell(block) else None


def test_no_block_is_left_out():
    """Catches a block that is neither run nor in the list, and an entry of the list without a block."""
    blocks = every_block()
    alone = [block.where for block in blocks if holder(block) is None]
    assert alone == [], "neither run by a test nor listed in client/tests/not_run.py"
    assert len(blocks) > 90, len(blocks)
    for page, text, _ in not_run.BLOCKS:
        assert any(b.page == page and text in b.text for b in blocks), (page, text)


def test_a_block_that_nothing_holds_is_noticed():
    """Catches a rule that accepts every block."""
    for kind, text in [
        ("python", "print(1)"),
        ("", "an output"),
        ("text", "hullcast serve"),
        ("json", "{}"),
        ("bash", "curl localhost"),
        ("", "make test\nand some more"),
        ("rust", "fn main() {}"),
    ]:
        block = Block("docs/new.md", 1, kind, text, "", "")
        assert holder(block) is None, (kind, text)


def test_blocks_are_found_as_they_are_written(tmp_path, monkeypatch):
    """Catches a fence that is not found: indented, longer, made of tildes, or inside another one."""
    monkeypatch.setattr("blocks.ROOT", tmp_path)
    page = tmp_path / "page.md"
    page.write_text(
        "a\n\n```\none\n```\n```text\ntwo\n```\n\n- item\n\n  ```sh\n  three\n  ```\n\n"
        "````md\n```\nfour\n```\n````\n\n~~~\nfive\n~~~\n\n<!-- own -->\n```\nsix\n```\n<!-- /own -->\n"
    )
    found = [(b.line, b.kind, b.text.strip(), b.mark, b.after) for b in blocks_of(page)]
    assert found == [
        (3, "", "one", "", ""),
        (6, "text", "two", "", ""),
        (12, "sh", "three", "", ""),
        (16, "md", "```\nfour\n```", "", ""),
        (22, "", "five", "", ""),
        (27, "", "six", "own", ""),
    ]


def test_no_page_has_code_that_is_only_indented():
    """Catches a block that is indented by four spaces: it has no kind, and no test would find it.

    After an item of a list, such lines belong to the item.
    """
    for page in every_page():
        found = INDENTED.search(without_blocks(page))
        assert not found, f"{page.relative_to(ROOT)}: {found[0]!r}"
    assert INDENTED.search("Text:\n\n    code\n")
    assert not INDENTED.search("- item\n\n    more of it\n")


def test_every_program_that_is_not_run_has_its_reason():
    """The list has every program that the checks know, except hullcast and openssl, which are run."""
    assert {*not_run.PROGRAMS, "hullcast", "openssl"} == set(commands.CHECKS)
    lines = [line for block in every_block() for line in commands.shown(block)]
    for text in not_run.COMMANDS:
        assert any(text in line for line in lines), text
    reasons = [reason for *_, reason in not_run.BLOCKS] + [*not_run.PROGRAMS.values()]
    files = {Path(name).name for name in listed()}
    for name in re.findall(r"[\w-]+\.(?:py|rs)\b", " ".join(reasons)):
        assert name in files, name


def runs(line: str) -> bool:
    return commands.program_of(line) not in not_run.PROGRAMS and not any(
        text in line for text in not_run.COMMANDS
    )


RUN = [
    block
    for block in every_block()
    if commands.is_shell(block) and not not_run.reason(block) and not block.mark
    if any(runs(line) for line in commands.shown(block))
]


@pytest.mark.parametrize("block", RUN, ids=lambda block: block.where)
def test_the_commands_of_a_block_run(block, tmp_path):
    """Catches a server that does not start and a command that fails, in an empty folder."""
    for line in filter(runs, commands.shown(block)):
        program = commands.program_of(line)
        if program != "hullcast" and not shutil.which(program):
            pytest.skip(f"{program} is not installed: apt-get install {program}")
    with Shell(tmp_path) as shell:
        for line in filter(runs, commands.shown(block)):
            shell.run(line)


@pytest.mark.parametrize("page", stage.PAGES)
def test_the_programs_of_a_page_of_parts_run(page, tmp_path):
    """Each block runs on its own, in a namespace that has the names that it uses."""
    blocks = [block for block in blocks_of(ROOT / page) if block.kind == "python"]
    assert len(blocks) > 3
    stage.run(blocks, tmp_path, without=stage.statements_without_their_package())


def test_what_needs_a_package_is_python():
    """All blocks are compiled here, also those that only run if a package is installed."""
    for block in every_block():
        if block.kind == "python":
            compile(block.text, block.where, "exec", flags=ast.PyCF_ALLOW_TOP_LEVEL_AWAIT)


def test_every_written_section_has_its_writer():
    """Catches a mark that no command writes, so that its text only looks measured."""
    names = ("Makefile", "scripts/", "client/examples/", "benches/", "src/cli/")
    files = [ROOT / name for name in listed() if name.startswith(names)]
    sources = [file.read_text(errors="replace") for file in files]
    marks = [
        (page.name, mark)
        for page in every_page()
        for mark in re.findall(r"^<!-- /([\w-]+) -->$", page.read_text(), re.MULTILINE)
    ]
    for page, mark in marks:
        word = re.compile(rf"\b{mark}\b")
        assert any(word.search(source) for source in sources), f"{page}: {mark}"
    assert len(marks) > 20, len(marks)


@pytest.mark.parametrize("language", PROGRAMS)
def test_the_page_shows_the_program_that_is_run(language):
    """The block is a copy of the file that `make test-languages` builds and runs."""
    blocks = [block for block in blocks_of(ROOT / "docs/languages.md") if block.kind == language]
    assert [block.text for block in blocks] == [(ROOT / PROGRAMS[language]).read_text()]
    others = [block for block in every_block() if block.kind == language]
    assert len(others) == 1, others


def languages() -> Any:
    """The script `scripts/test-languages` as a module."""
    script = SourceFileLoader("languages", str(ROOT / "scripts/test-languages"))
    module = module_from_spec(spec_from_loader(script.name, script))
    sys.modules[script.name] = module  # its dataclass looks there
    script.exec_module(module)
    return module


def test_the_counts_of_the_languages_page_are_up_to_date():
    """Catches an output of `make test-languages` from before a golden case or an identity was added."""
    module = languages()
    counts = ", ".join(f"{count} {what}" for what, count in module.expected().items())
    shown = [b.text for b in blocks_of(ROOT / "docs/languages.md") if "falsified" in b.text]
    lines = shown[0].splitlines()
    assert len(lines) == len(PROGRAMS)
    for name, line in zip(module.LANGUAGES, lines, strict=True):
        assert line.startswith(f"{name}: {counts}, {len(module.FALSE)} falsified")


def test_the_commands_of_the_languages_page_are_those_that_are_run():
    """Catches a command that the page shows and `make test-languages` does not run."""
    module = languages()
    (block,) = [b for b in blocks_of(ROOT / "docs/languages.md") if "cd examples/go" in b.text]
    quiet = {"--silent", "--batch-mode", "--quiet", "--no-audit", "--no-fund", "--parallel", "2"}
    lines = block.text.splitlines()
    for (name, language), line in zip(module.LANGUAGES.items(), lines, strict=True):
        first, *steps = line.split(" && ")
        assert first == f"cd examples/{name}"
        run = [*language.build, [*language.first, "localhost:50051"]]
        for shown, done in zip(steps, run, strict=True):
            wanted = [word for word in done if word not in quiet and "PROTOC=" not in word]
            kept = [word for word in shlex.split(shown) if word not in quiet]
            assert kept == [word for word in wanted if not word.startswith("-DCMAKE")], line


def test_the_metrics_of_the_autoscaler_are_the_servers():
    """Catches a rule of docs/cluster.md with a metric that does not exist."""
    (rule,) = [b.text for b in blocks_of(ROOT / "docs/cluster.md") if "seriesQuery" in b.text]
    (port,) = free_ports(1)
    with (
        Server("memory://", "--admin-listen", f"127.0.0.1:{port}"),
        urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=30) as answer,
    ):
        metrics = set(re.findall(r"^(\w+)", answer.read().decode(), re.MULTILINE))
    named = set(re.findall(r"(hullcast_\w+_(?:sum|count))\b", rule))
    assert len(named) == 2
    assert named <= metrics


def test_the_pages_that_are_run_are_there():
    """Catches a renamed page, of which its test would read nothing."""
    named = [f"docs/python/{name}.md" for name in (*SHOWN, *EXTRAS)]
    for page in ["README.md", *stage.PAGES, *named]:
        assert any(block.kind == "python" for block in blocks_of(ROOT / page)), page
    assert pages.DOCS == ROOT / "docs/python"
