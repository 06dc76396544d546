"""The parts that ship beside the code: examples that run, and stubs that match the protocol."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
from commands import lab_binary

import hullcast

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    ("script", "expected"),
    [
        (["overhead.py", "--seconds", "0.02", "--sizes", "1", "5000"], " 5,000 "),
        (["peers.py", "--seconds", "0.05"], " 2,457 "),
        (["loops.py", "--seconds", "0.05", "--worlds", "20"], "none moved, by name"),
        (["throughput.py", "--seconds", "0.1"], "| resting | several | "),
    ],
)
def test_examples_run(script, expected):
    """The examples run as a user would run them. The figures that they print are not checked."""
    done = subprocess.run(
        [sys.executable, str(ROOT / "client/examples" / script[0]), *script[1:]],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**os.environ, "PYTHONPATH": str(Path(hullcast.__file__).parents[1])},
    )
    assert done.returncode == 0, done.stderr
    assert expected in done.stdout


def test_others_answer_the_pairs_of_a_tradeoff(tmp_path):
    """Catches files that `lab tradeoff` and the programs in Python read differently.

    The installed peers answer the requested pairs, `lab tradeoff` judges their answers, and its
    chart is drawn.
    """
    binary = lab_binary()
    script = ROOT / "client/examples/tradeoff_peers.py"
    asked, pairs = tmp_path / "pairs.json", ["--pairs", "1"]

    def run(*command: str | Path) -> str:
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    run(binary, "tradeoff", *pairs, "--ask", asked)
    names = run(sys.executable, script, asked, "--out", tmp_path).splitlines()
    assert len(names) == 2
    present = [name.split(":")[0] for name in names if "left out" not in name]
    files = [f"--peer={path}" for path in sorted(tmp_path.glob("[cm]*.json"))]
    assert len(files) == len(present)
    table = run(binary, "tradeoff", *pairs, *files, "--out", tmp_path / "all")
    lines = [line for line in table.splitlines() if line.startswith(("coal ", "MuJoCo "))]
    assert len(lines) == 2 * len(present), "one line for all pairs and one for the deep pairs"
    assert (tmp_path / "all.csv").read_text().count("MuJoCo") == 14 * ("MuJoCo" in table)

    pytest.importorskip("matplotlib")
    plot = ROOT / "client/examples/tradeoff.py"
    run(sys.executable, plot, tmp_path / "all.json", tmp_path / "all.svg")
    drawn = (tmp_path / "all.svg").read_text()
    assert drawn.rstrip().endswith("</svg>")
    for title in ("normal short of optimal, p95", "time over the default's"):
        assert f"<!-- {title} -->" in drawn, title


def python(program: str) -> str:
    """The output of a program that runs in an interpreter of its own."""
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        env={**os.environ, "PYTHONPATH": str(Path(hullcast.__file__).parents[1])},
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_importing_is_light():
    """Importing hullcast loads neither grpc nor numpy.

    The test looks at the loaded modules, since times vary.
    """
    loaded = python(
        """
        import sys
        before = set(sys.modules)
        import hullcast
        print(*set(sys.modules) - before)
        """
    ).split()
    others = [name for name in loaded if not name.startswith("hullcast")]
    assert {name.partition(".")[0] for name in others} <= {*sys.stdlib_module_names}
    assert sorted(set(loaded) - set(others)) == ["hullcast", "hullcast._version"]


def test_using_loads_only_what_is_used():
    """Scenes and saved results do not load grpc. A client loads no extra package."""
    program = """
        import sys, grpc, numpy
        from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
        before = set(sys.modules)
        import hullcast
        for name in {names}: getattr(hullcast, name)
        print(*set(sys.modules) - before)
    """
    light = program.replace("import sys, grpc, numpy", "import sys, numpy").replace(
        "from google.protobuf", "# "
    )
    loaded = python(light.format(names=("Scene", "Manifolds", "Hull", "Unavailable"))).split()
    assert "hullcast._manifolds" in loaded
    assert not [name for name in loaded if name.startswith(("grpc", "google", "asyncio"))]
    loaded = python(program.format(names=("connect", "serve", "aio"))).split()
    others = [name for name in loaded if not name.startswith(("hullcast", "google.protobuf"))]
    assert {name.partition(".")[0] for name in others} <= {*sys.stdlib_module_names, "numpy"}
    assert len(others) < 80, others


def test_every_public_name_is_there():
    """`__all__` matches the modules that define the names, and nothing else is public."""
    assert dir(hullcast) == sorted(hullcast.__all__)
    homes = {name for names in hullcast._HOMES.values() for name in names}
    assert homes | {"__version__", "aio"} == set(hullcast.__all__)
    for name in hullcast.__all__:
        assert getattr(hullcast, name).__doc__
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = hullcast.no_such_name


def test_one_version():
    """The package has the server's version, which the wheel takes."""
    manifest = (ROOT / "Cargo.toml").read_text()
    assert f'\nversion = "{hullcast.__version__}"\n' in manifest


def test_stubs_are_those_of_the_contract(tmp_path):
    """Catches a change of proto/ without `make stubs`, after which the client is out of date."""
    pytest.importorskip("grpc_tools")
    subprocess.run(
        [str(ROOT / "scripts/stubs")],
        check=True,
        timeout=120,
        env={**os.environ, "PY": sys.executable, "OUT": str(tmp_path)},
    )
    made = sorted(tmp_path.iterdir())
    assert len(made) == 6
    for file in made:
        checked_in = Path(hullcast.__file__).parent / "_pb" / file.name
        assert file.read_text() == checked_in.read_text(), f"{file.name}: run `make stubs`"
