"""Installs the package into an empty environment, and uses it there as a user would."""

from __future__ import annotations

import os
import subprocess
import textwrap
import venv
from pathlib import Path

import pages

ROOT = Path(__file__).resolve().parents[2]


def run_the_readme(
    package: Path, folder: Path, *options: str, seconds: float = 600, **environment: str
) -> None:
    """Installs a wheel or a source distribution, and runs the README's program and the playground with it.

    Args:
        package: the file to install.
        folder: an empty folder for the environment.
        options: further options of `pip install`.
        seconds: the time that the installation may take.
        environment: further variables for `pip install`.
    """
    venv.create(folder / "env", with_pip=True)
    python = folder / "env/bin/python"
    clean = {k: v for k, v in os.environ.items() if k not in ("HULLCAST_BIN", "PYTHONPATH")}
    building = clean | environment
    clean["PATH"] = "/usr/bin:/bin"
    building.setdefault("PATH", clean["PATH"])
    pip = [python, "-m", "pip", "install", "--quiet", *options, package]
    subprocess.run(pip, env=building if environment else clean, timeout=seconds, check=True)
    program = "import hullcast, hullcast._serve as s; print(hullcast.__file__, s.find_binary())"
    done = subprocess.run([python, "-c", program], env=clean, capture_output=True, text=True)
    found = done.stdout.split()
    assert found[0].startswith(f"{folder}/env/"), done
    assert found[1] == f"{folder}/env/bin/hullcast"
    assert pages.run(ROOT / "README.md", folder, python) == 1
    page = """
        import urllib.request
        import hullcast

        with hullcast.serve(arguments=["--playground"]) as client:
            print(urllib.request.urlopen(f"http://{client.target}/", timeout=30).read())
    """
    program = textwrap.dedent(page)
    done = subprocess.run([python, "-c", program], env=clean, capture_output=True, text=True)
    assert "playground.js" in done.stdout, done
