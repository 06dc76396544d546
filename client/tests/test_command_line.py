"""The command line beside the Python client: its files, its certificates, its progress."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import re
import select
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from silent import SilentProxy

import hullcast
from hullcast import Manifolds
from hullcast._serve import find_binary

ROOT = Path(__file__).resolve().parents[2]
PANDA = ROOT / "examples/scenes/panda.json"
NO_PROXY = [("grpc.enable_http_proxy", 0)]
EVERYTHING = [
    "ALPHA", "NORMAL", "POINTS", "WITNESS_B", "FEATURES", "BASES", "DIAGNOSTICS",
    "ALPHA_GRADIENT", "SEPARATION_GRADIENT", "NORMAL_JACOBIAN",
]  # fmt: skip


@contextlib.contextmanager
def server(folder: Path, *arguments: str) -> Iterator[str]:
    """A server's port."""
    command = [find_binary(), "serve", "--listen", "127.0.0.1:0", "--until-stdin-closes"]
    command += ["--store", str(folder / "store"), *arguments]
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    try:
        assert process.stdout is not None
        yield process.stdout.readline().strip().rpartition(":")[2]
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize(
    "outputs", [EVERYTHING, ["ALPHA", "POINTS"], ["DIAGNOSTICS"], ["FEATURES"], ["OUTCOME"]]
)
def test_both_write_the_same_file(client, tmp_path, outputs):
    """Catches a column that one of them leaves out, names otherwise or shapes otherwise."""
    file = json.loads(PANDA.read_text())
    frame = next(frame for frame in file["frames"] if frame["name"] == "grasp")
    hulls = client.register(
        [np.array(hull["vertices"]) for hull in file["hulls"]],
        contraction_points=[hull.get("contraction_point") for hull in file["hulls"]],
    )
    scene = hullcast.Scene(
        hulls,
        frame["positions"],
        frame["rotations"],
        body_hulls=[body["hull"] for body in file["bodies"]],
    )
    asked = client.query(scene, file["pairs"], margin=file["margin"], outputs=outputs)
    asked.save(tmp_path / "python.npz")
    command = [find_binary(), "query", PANDA, "--frame", "grasp", "--out", tmp_path / "rust.npz"]
    subprocess.run([*command, "--outputs", ",".join(outputs)], check=True, capture_output=True)
    with np.load(tmp_path / "python.npz") as ours, np.load(tmp_path / "rust.npz") as theirs:
        assert sorted(ours.files) == sorted(theirs.files)
        for name in ours.files:
            assert ours[name].dtype == theirs[name].dtype, name
            assert ours[name].shape == theirs[name].shape, name
            assert ours[name].tobytes() == theirs[name].tobytes(), name
    loaded = Manifolds.load(tmp_path / "rust.npz")
    assert np.count_nonzero(loaded.in_contact) == 13
    if "DIAGNOSTICS" in outputs:
        assert (loaded.kept_area == asked.kept_area).all()
    else:
        with pytest.raises(hullcast.OutputNotAsked):
            _ = loaded.kept_area


def test_a_certificate_that_openssl_made_works_from_python(tmp_path):
    """Catches lines of the page about operations that make a certificate no client trusts."""
    if shutil.which("openssl") is None:
        pytest.skip("no openssl on this machine")
    page = (ROOT / "docs/operations.md").read_text()
    lines = re.search(r"^```sh\n(openssl .*?)^```$", page, re.DOTALL | re.MULTILINE)
    assert lines is not None
    subprocess.run(["sh", "-ec", lines[1]], cwd=tmp_path, check=True, capture_output=True)
    arguments = ["--tls-certificate", str(tmp_path / "certificate.pem")]
    arguments += ["--tls-key", str(tmp_path / "key.pem")]
    with server(tmp_path, *arguments) as port:
        for host in ("localhost", "127.0.0.1"):
            target = f"{host}:{port}"
            certificate = str(tmp_path / "certificate.pem")
            with hullcast.connect(target, tls=certificate, options=NO_PROXY) as client:
                assert client.ping() > 0


def test_progress_is_for_terminals(tmp_path):
    """Catches a command that says nothing for long, and progress in the files of a script."""
    with server(tmp_path) as port:
        command = [find_binary(), "query", str(PANDA), "--remote", f"127.0.0.1:{port}"]
        # Registers the hulls, so that the next messages are a list of ids and then the query.
        subprocess.run(command, check=True, capture_output=True, timeout=120)
        # The list and its headers have less than 1,500 bytes, and the query has more: it stays unanswered.
        with SilentProxy(f"127.0.0.1:{port}", most=1500) as proxy:
            command[-1] = proxy.address
            ours, theirs = pty.openpty()
            process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=theirs)
            os.close(theirs)
            shown, deadline = "", time.monotonic() + 60
            while "pairs" not in shown and time.monotonic() < deadline:
                if select.select([ours], [], [], 1)[0]:
                    shown += os.read(ours, 4096).decode()
            process.kill()
            process.wait()
            os.close(ours)
            assert "pairs" in shown
            assert "0/81" in shown
        with SilentProxy(f"127.0.0.1:{port}", most=1500) as proxy:
            command[-1] = proxy.address
            process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
            # A terminal would show progress after a second.
            with pytest.raises(subprocess.TimeoutExpired):
                process.communicate(timeout=4)
            process.kill()
            assert process.communicate() == (b"", b"")
