"""The things exist that the commands and the text of the pages name."""

from __future__ import annotations

import inspect
import re

import commands
import not_run
import pytest
from blocks import ROOT, blocks_of, inline_code, listed, without_blocks
from blocks import pages as every_page

import hullcast


def test_every_command_names_what_is_there():
    """Catches a target, file, flag, feature, package or test that a page names and that is gone."""
    wrong, seen = [], 0
    for page in every_page():
        name = str(page.relative_to(ROOT))
        blocks = [block for block in blocks_of(page) if commands.is_shell(block) and not block.mark]
        lines = [
            (block.where, line)
            for block in blocks
            if not not_run.reason(block)
            for line in commands.shown(block)
        ]
        lines += [(name, code) for code in inline_code(page) if is_inline_command(code)]
        for where, line in lines:
            seen += 1
            try:
                commands.check(line)
            except (commands.Wrong, ValueError) as error:
                wrong.append(f"{where}: {line}: {error}")
    assert wrong == []
    assert seen > 100, seen


def is_inline_command(code: str) -> bool:
    """Whether code in the text is a known program with an argument, or any program with a flag."""
    if re.match(r"[\w./-]+ .*(?<!\S)--[a-z]", code):
        return not code.startswith("--")
    program = commands.program_of(code)
    argument = re.match(r"[\w./=]+ [\w.\"'-]", code)
    return argument is not None and program in commands.CHECKS


@pytest.mark.parametrize(
    "line",
    [
        "make no-such-target",
        "make test NOSUCH=1",
        "hullcast sieve",
        "hullcast serve --no-such-flag",
        "hullcast tradeoff",
        "lab sieve",
        "lab tradeoff --no-such-flag",
        "lab tradeoff examples/scenes/none.json",
        "hullcast query examples/scenes/none.json",
        "hullcast query examples/scenes/panda.json # --no-such-flag",
        "pip install hullcast",
        "pip install 'hullcast[mesh]'",
        "pip install './client[none]'",
        "pip install no-such-package",
        "cargo install hullcast",
        "cargo build --features none",
        "cargo test --test none",
        "cargo test -p none --test hull",
        "cargo test -p hullcast --test hull",
        "cargo test --test hull no_such_test",
        "cargo test --no-such-flag",
        "python client/examples/none.py",
        "python client/examples/soak.py --no-such-flag",
        "scripts/none",
        "apt-get install no-such-package",
        "grpcurl $A hullcast.v1.HullService/Nothing",
        "grpcurl -d '{\"no_field\": 1}' $A hullcast.v1.HullService/HasHulls",
        "HULLCAST_NO_SUCH=1 make test",
        "no-such-program",
    ],
)  # fmt: skip
def test_a_command_that_names_what_is_not_there_is_noticed(line):
    with pytest.raises(commands.Wrong):
        commands.check(line)


#: The objects that the names in the text stand for.
OBJECTS = {
    "hullcast": hullcast,
    "client": hullcast.Client,
    "session": hullcast.Session,
    "m": hullcast.Manifolds,
    "robot": hullcast.Robot,
}
#: Names of the protocol, of files and of hosts that begin like names of the package.
OTHERS = {"v1", "golden", "scene", "service", "example", "NAMESPACE", "sock", "urdf"}
_NAME = re.compile(r"(?<![\w./:])(hullcast|client|session|m|robot)\.(\w+)")


def test_every_python_name_in_the_text_is_one():
    """Catches a renamed method or class."""
    known = {name: set(dir(thing)) for name, thing in OBJECTS.items()}
    known["hullcast"] |= {"ray", "mujoco", "newton", "torch", "jax"}
    for name, thing in OBJECTS.items():
        for base in inspect.getmro(thing) if inspect.isclass(thing) else ():
            if base.__module__.startswith("hullcast"):
                source = inspect.getsource(base)
                known[name] |= set(re.findall(r"\bself\.(\w+)\b.* = ", source))
                known[name] |= set(inspect.get_annotations(base))
    named = 0
    for page in every_page():
        if page.name == "CHANGELOG.md":
            continue
        found = [(code, *name) for code in inline_code(page) for name in _NAME.findall(code)]
        for code, holder, name in found:
            if name not in OTHERS:
                assert name in known[holder], f"{page.name}: {code}"
                named += 1
    assert named > 40, named


def test_every_flag_in_the_text_is_one():
    """Checks flags that stand without their command against all commands that have flags."""
    own = ("serve", "query", "load", "prune")
    known = "\n".join(commands.help_of("hullcast", name) for name in own)
    known += "\n".join(commands.help_of("lab", name) for name in ("tradeoff", "planarity"))
    known += commands.help_of("cargo", "build")
    sources = ("scripts/", "client/examples/", "client/tests/conftest.py")
    files = [ROOT / name for name in listed() if name.startswith(sources)]
    known += "\n".join(file.read_text(errors="replace") for file in files)
    named = 0
    for page in every_page():
        for flag in re.findall(r"`(--[a-z][a-z0-9-]*)", without_blocks(page)):
            assert re.search(rf"{flag}\b(?!-)", known), f"{page.name}: {flag}"
            named += 1
    assert named > 30, named


def test_no_advice_to_install_what_is_not_published():
    """Checks the install commands in the messages and docstrings of the package."""
    advised = 0
    for path in sorted((ROOT / "client/src/hullcast").glob("*.py")):
        for line in re.findall(r"pip install (?:'[^']+'|[\w-]+)", path.read_text()):
            commands.check(line)
            advised += 1
    assert advised > 5, advised
