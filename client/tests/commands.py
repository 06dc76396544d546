"""Checks that the things exist that a command names, without running the command.

These are targets of make, flags, subcommands, files, extras, features, packages and tests. Only
`--help` and `make --dry-run` are run.
"""

from __future__ import annotations

import itertools
import json
import os
import re
import shlex
import subprocess
from functools import cache
from pathlib import Path

from blocks import ROOT, Block, listed

from hullcast._serve import find_binary

_ASSIGNMENT = re.compile(r"^([A-Z][A-Z_]+)=")
_FLAG = re.compile(r"(?<![\w-])--[a-z][a-z0-9-]*")


class Wrong(AssertionError):
    """A command names something that does not exist."""


def lines_of(text: str) -> list[str]:
    """The lines of a text, with continued lines joined and without prompts and comments."""
    joined = text.replace("\\\n", " ")
    lines = (line.strip().removeprefix("$ ") for line in joined.splitlines())
    return [line for line in lines if line and not line.startswith("#")]


def program_of(line: str) -> str:
    """The name of the program that a line runs, without the variables before it."""
    words = line.split()
    while words and _ASSIGNMENT.match(words[0]):
        words.pop(0)
    name = words[0].rpartition("/")[2] if words else ""
    return "scripts/" if words and words[0].startswith("scripts/") else name


def check(line: str) -> None:
    """Raises `Wrong` if the line names something that does not exist."""
    program = program_of(line)
    if program not in CHECKS:
        raise Wrong(f"no check knows the command {program!r}: add one to client/tests/commands.py")
    command, _, comment = line.partition(" #")
    # `[--flag VALUE]` may be left out.
    words = shlex.split(re.sub(r"(?<=\s)\[(.*?)\](?=\s|$)", r"\1", command))
    while _ASSIGNMENT.match(words[0]):
        variable = words.pop(0).partition("=")[0]
        if not _somewhere(variable):
            raise Wrong(f"nothing reads the variable {variable}")
    CHECKS[program](words, comment)


@cache
def _somewhere(text: str) -> bool:
    """Whether a source file reads this variable, directly or as a setting of the server."""
    ends = (".rs", ".py", "Makefile", ".mjs")
    names = [name for name in listed() if name.endswith(ends) or name.startswith("scripts/")]
    names.remove("client/tests/test_commands.py")  # it has variables that are not there
    setting = text.removeprefix("HULLCAST_").lower()
    return any(
        text in source or f" {setting}:" in source
        for source in ((ROOT / name).read_text(errors="replace") for name in names)
    )


def _make(words: list[str], _comment: str) -> None:
    done = subprocess.run(
        ["make", "--dry-run", *words[1:]], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise Wrong(done.stderr.strip())
    for word in words[1:]:
        variable, assigned, _ = word.partition("=")
        if assigned and f"$({variable})" not in (ROOT / "Makefile").read_text():
            raise Wrong(f"the Makefile does not use the variable {variable}")


@cache
def _help(*command: str) -> str:
    done = subprocess.run([*command, "--help"], capture_output=True, text=True, check=False)
    if done.returncode:
        raise Wrong(f"{' '.join(command)} is no command")
    return done.stdout


def lab_binary() -> str:
    """The path of the laboratory's program, which `make` builds before it runs the tests."""
    path = Path(os.environ.get("HULLCAST_LAB") or ROOT / "target/release/lab")
    assert path.is_file(), f"there is no {path}: `make lab` builds it, HULLCAST_LAB names another"
    return str(path)


#: The programs of the repository, and functions that find them.
OWN = {"hullcast": find_binary, "lab": lab_binary}


def help_of(program: str, *command: str) -> str:
    """The help text of a command."""
    return _help(OWN[program]() if program in OWN else program, *command)


def _own(words: list[str], comment: str) -> None:
    binary = OWN[program_of(words[0])]()
    subcommand = [word for word in words[1:2] if not word.startswith("-")]
    text = _help(binary, *subcommand)
    for flag in _FLAG.findall(" ".join([*words[1:], comment])):
        if not re.search(rf"{flag}\b(?!-)", text) and flag != "--help":
            raise Wrong(f"{' '.join(words[:2])} has no {flag}")
    _files(words[2:])


def _files(words: list[str]) -> None:
    """Checks relative paths that have a folder; they are below the root of the repository."""
    values = set()
    for flag, value in itertools.pairwise(words):
        if flag.startswith("--"):
            values.add(value)
    for word in words:
        if "/" in word and word not in values and not word.startswith(("-", "/", "$")):
            _exists(word)


def _exists(name: str) -> Path:
    if not (ROOT / name).exists():
        raise Wrong(f"there is no {name}")
    return ROOT / name


def _pip(words: list[str], _comment: str) -> None:
    if words[1] != "install":
        raise Wrong(f"{' '.join(words)}: only `pip install` is known")
    used = "\n".join(path.read_text() for path in ROOT.glob("client/requirements*.txt"))
    used += (ROOT / "client/src/hullcast/_tensors.py").read_text()
    for word in words[2:]:
        name, _, rest = word.partition("[")
        if name.startswith("-"):
            continue
        if name == "hullcast":
            raise Wrong("hullcast is not published: it is installed from the clone, ./client")
        if name == "./client":
            for extra in filter(None, rest.rstrip("]").split(",")):
                if extra not in (*_extras(), "..."):
                    raise Wrong(f"./client has no extra {extra!r}")
        elif not re.search(rf"(?<![\w-]){re.escape(name)}(?![\w-])", used):
            raise Wrong(f"no file of requirements has the package {name}")


#: The flags of cargo that are followed by a name that is checked.
VALUED = ("--features", "--package", "-p", "--test", "--example", "--bin")


@cache
def _extras() -> list[str]:
    text = (ROOT / "client/pyproject.toml").read_text()
    section = text.partition("[project.optional-dependencies]\n")[2].partition("\n[")[0]
    return re.findall(r"^(\w+) = ", section, re.MULTILINE)


@cache
def _packages() -> dict[str, Path]:
    """The folder of each package of the workspace."""
    manifests = [ROOT / "Cargo.toml", *ROOT.glob("crates/*/Cargo.toml")]
    name = re.compile(r'^name = "(.*)"$', re.MULTILINE)
    return {name.findall(path.read_text())[0]: path.parent for path in manifests}


def _sources(folders: list[Path]) -> list[Path]:
    return [file for folder in folders for file in folder.glob("[st]*/**/*.rs")]


def _cargo(words: list[str], _comment: str) -> None:
    if words[1] == "install":
        for word in words[2:]:
            if word.partition("@")[0] == "hullcast":
                raise Wrong("hullcast is not published: cargo install --path . in the clone")
        return
    if words[1] == "deny":
        _exists("deny.toml")
        return
    known = _help("cargo", words[1])
    own, _, filters = " ".join(words[2:]).partition(" -- ")
    arguments = own.split()
    for flag in _FLAG.findall(own):
        if not re.search(rf"{flag}\b(?!-)", known):
            raise Wrong(f"cargo {words[1]} has no {flag}")
    names = {flag: value for flag, value in itertools.pairwise(arguments) if flag in VALUED}
    for feature in filter(None, re.split(r"[, ]", names.get("--features", ""))):
        if not re.search(rf"^{feature} = ", (ROOT / "Cargo.toml").read_text(), re.MULTILINE):
            raise Wrong(f"there is no feature {feature}")
    package = names.get("--package") or names.get("-p")
    folders = [folder for name, folder in _packages().items() if package in (name, None)]
    if not folders:
        raise Wrong(f"there is no package {package}")
    places = {"--test": "tests", "--example": "examples", "--bin": "src/bin"}
    sources: list[Path] = []
    for flag, place in places.items():
        if name := names.get(flag):
            for folder in [*folders, ROOT / "benches"]:
                sources += folder.glob(f"{place}/{name}.rs")
                sources += folder.glob(f"{place}/{name}/**/*.rs")
            if not sources:
                raise Wrong(f"there is no {place}/{name}")
    wanted = [word for word in filters.split() if not word.startswith("-")]
    taken = set(names.values())
    wanted += [word for word in arguments if not word.startswith("-") and word not in taken]
    if words[1] == "test":
        text = "\n".join(path.read_text() for path in sources or _sources(folders))
        for name in wanted:
            if not re.search(rf"fn \w*{name.rpartition('::')[2]}|mod {name}", text):
                raise Wrong(f"no test is called {name}")


def _python(words: list[str], _comment: str) -> None:
    if words[1] == "-m":
        if words[2] == "pytest":
            _files(words[3:])
        else:
            raise Wrong(f"python -m {words[2]} is not known")
        return
    _script([words[1], *words[2:]], "")


def _script(words: list[str], _comment: str) -> None:
    path = _exists(words[0])
    files = sorted(path.glob("*.py")) if path.is_dir() else [path]
    text = "\n".join(file.read_text() for file in files)
    for flag in _FLAG.findall(" ".join(words[1:])):
        if f'"{flag}"' not in text:
            raise Wrong(f"{words[0]} has no {flag}")


def _apt(words: list[str], _comment: str) -> None:
    known = "".join(
        (ROOT / f"scripts/{name}").read_text() for name in ("test-languages", "check-tools")
    )
    for word in words[2:]:
        if word not in known:
            raise Wrong(f"neither scripts/check-tools nor scripts/test-languages names {word}")


def _grpc(words: list[str], _comment: str) -> None:
    """Checks methods and the fields of messages against the contract."""
    contract = "\n".join(path.read_text() for path in ROOT.glob("proto/hullcast/v1/*.proto"))
    for word in words:
        if word.startswith("hullcast.v1."):
            service, _, method = word.removeprefix("hullcast.v1.").partition("/")
            for pattern in (rf"service {service} ", rf"rpc {method}\b" if method else ""):
                if not re.search(pattern, contract):
                    raise Wrong(f"the contract has no {word}")
    for value in words[words.index("-d") + 1 :][:1] if "-d" in words else ():
        for field in re.findall(r'"(\w+)":', value):
            if field != "service" and not re.search(rf"\b{field} = \d", contract):
                raise Wrong(f"the contract has no field {field}")


def _helm(words: list[str], _comment: str) -> None:
    """Checks the chart, the files of values and the assigned values."""
    schema = json.loads((ROOT / "deploy/chart/values.schema.json").read_text())
    for option, value in itertools.pairwise(words):
        if option in ("--values", "-f"):
            _exists(value)
        if option == "--set":
            at = schema
            for name in value.partition("=")[0].split("."):
                at = at.get("properties", {}).get(name)
                if at is None:
                    raise Wrong(f"the chart has no value {value}")
    for word in words:
        if word.startswith("deploy/"):
            _exists(word)


def _other(_words: list[str], _comment: str) -> None:
    """Accepts the command of a program that is not part of this project."""


CHECKS = {
    "make": _make,
    "hullcast": _own,
    "lab": _own,
    "pip": _pip,
    "cargo": _cargo,
    "python": _python,
    "scripts/": _script,
    "apt-get": _apt,
    "grpcurl": _grpc,
    "ghz": _grpc,
    "helm": _helm,
    **dict.fromkeys(("openssl", "kill", "systemctl", "xacro", "git"), _other),
}

#: The kinds of blocks that can have commands.
SHELL = ("", "sh", "bash", "console")


def shown(block: Block) -> list[str]:
    """The commands of a block. In a console, these are the lines with a prompt."""
    text = block.text
    if block.kind == "console":
        text = "".join(re.findall(r"^\$ .*\n", text, re.MULTILINE))
    return lines_of(text)


def is_shell(block: Block) -> bool:
    """Whether each line of a block is a command of a known program."""
    lines = shown(block)
    return block.kind in SHELL and bool(lines) and all(map(is_command, lines))


def is_command(line: str) -> bool:
    return program_of(line) in CHECKS
