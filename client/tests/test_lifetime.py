"""Servers of `serve` end with their client and process, and leave no files."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import tempfile
import textwrap
import threading
from pathlib import Path

import programs
from crowds import CUBE

import hullcast


def ends(process: int) -> bool:
    """Whether a process ends within ten seconds."""
    for _ in range(200):
        try:
            state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
        except FileNotFoundError:
            return True
        if state == "Z":
            return True  # it has ended, and its parent has not waited for it yet
        threading.Event().wait(0.05)
    return False


def test_a_cell_that_is_run_again_leaves_one_server():
    """Catches one running server per client that was garbage collected."""
    processes = []
    for _ in range(3):
        client = hullcast.serve()
        client.register(CUBE)
        processes.append(client._server._process.pid)
    gc.collect()
    assert ends(processes[0])
    assert ends(processes[1])
    assert len(client.register(CUBE)) == 1
    client.close()
    assert ends(processes[2])


def test_the_end_of_the_process_ends_the_server(tmp_path):
    """Catches a server or files that remain after a program that closes nothing."""
    program = """
        import hullcast
        client = hullcast.serve()
        client.register([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
        print(client._server._process.pid)
    """
    done = programs.run(program, TMPDIR=str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert ends(int(done.stdout))
    assert not list(tmp_path.iterdir())


def test_a_forked_child_does_not_keep_the_server_of_a_killed_parent(tmp_path):
    """Catches a child that keeps the server's standard input open, and files that remain."""
    program = """
        import hullcast, os, signal, time
        client = hullcast.serve()
        child = os.fork()
        if child == 0:
            time.sleep(300)
            os._exit(0)
        print(client._server._process.pid, child, flush=True)
        os.kill(os.getpid(), signal.SIGKILL)
    """
    with open(tmp_path / "out", "w+") as out:
        scratch = tmp_path / "scratch"
        scratch.mkdir()
        paths = os.pathsep.join(p for p in sys.path if p)
        parent = subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(program)],
            stdout=out,
            env={**os.environ, "PYTHONPATH": paths, "TMPDIR": str(scratch)},
        )
        parent.wait(60)
        out.seek(0)
        server, child = map(int, out.read().split())
    try:
        os.kill(child, 0)  # the child is alive
        assert ends(server)
        assert not list(scratch.iterdir())
    finally:
        os.kill(child, signal.SIGKILL)


def test_a_forked_child_may_use_the_server_and_ends_nothing(tmp_path):
    """Catches a child whose end or garbage collection stops its parent's server."""
    program = """
        import gc, os, sys
        import hullcast
        cube = [[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]
        client = hullcast.serve()
        client.register(cube)
        child = os.fork()
        if child == 0:
            assert len(client.register(cube)) == 1
            client = None
            gc.collect()
            sys.exit(7)  # with the exit handlers
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), len(client.register(cube)))
    """
    done = programs.run(program, TMPDIR=str(tmp_path))
    assert done.stdout.split() == ["7", "1"], done.stderr


def test_an_interrupt_does_not_end_the_server(tmp_path):
    """Catches a server that ends when the user interrupts a cell or presses Ctrl-C.

    As a terminal and Jupyter do, the test sends the signal to the whole group of processes.
    """
    ended = programs.run(
        """
        import os, signal, time, hullcast
        os.setsid()
        # A test run in the background of a shell may have been started with the signal ignored.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        client = hullcast.serve()
        try:
            os.killpg(0, signal.SIGINT)
            time.sleep(60)
        except KeyboardInterrupt:
            pass
        time.sleep(1)
        print(client.info().version)
        """,
        TMPDIR=str(tmp_path),
    )
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.strip() == hullcast.__version__


def test_no_folder_is_made():
    """Catches a temporary folder, which nothing would remove if the process were killed."""
    before = set(os.listdir(tempfile.gettempdir()))
    with hullcast.serve() as client:
        client.register(CUBE)
        now = set(os.listdir(tempfile.gettempdir())) - before
    assert not [name for name in now if name.startswith("hullcast")]
