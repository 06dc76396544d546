"""Files that callers name: only regular files are read, and the message says what a file is."""

from __future__ import annotations

import io
import os
import socket
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from crowds import CUBE
from solids import box, stl

import hullcast
from hullcast._serve import find_binary

URDF = '<robot name="r"><link name="a"><collision><geometry><box size="1 1 1"/></geometry></collision></link></robot>'  # fmt: skip
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"


def robot(folder: Path, **options: Any) -> hullcast.Robot:
    (folder / "good.urdf").write_text(URDF)
    return hullcast.Robot(folder / "good.urdf", **options)


#: Every function that reads a file: its call, the argument, and the file's suffix.
READERS: dict[str, tuple[Any, str, str]] = {
    "register": (lambda c, p, _: c.register(p), "hulls", ".stl"),
    "register a list": (lambda c, p, _: c.register([CUBE, p]), "hulls[1]", ".obj"),
    "decompose": (lambda _, p, __: hullcast.decompose(p), "mesh", ".stl"),
    "Robot": (lambda _, p, __: hullcast.Robot(p), "urdf", ".urdf"),
    "srdf": (lambda _, p, t: robot(t, srdf=p), "srdf", ".srdf"),
    "Manifolds.load": (lambda _, p, __: hullcast.Manifolds.load(p), "path", ".npz"),
    "Scene.load": (lambda _, p, __: hullcast.Scene.load(p), "path", ".json"),
    "tls": (lambda _, p, __: hullcast.connect("localhost", tls=p), "tls", ".pem"),
}


@pytest.mark.parametrize("name", READERS)
def test_only_regular_files_are_read(client, tmp_path, name):
    """Catches a pipe on which reading waits for ever, and Python's own errors."""
    call, field, suffix = READERS[name]
    pipe, missing = tmp_path / f"pipe{suffix}", tmp_path / f"none{suffix}"
    os.mkfifo(pipe)
    folder = tmp_path / f"folder{suffix}"
    folder.mkdir()
    plug = socket.socket(socket.AF_UNIX)
    plug.bind(str(tmp_path / f"socket{suffix}"))
    device = tmp_path / f"device{suffix}"
    device.symlink_to("/dev/zero")
    for path, text in (
        (pipe, "is a pipe, not a file"),
        (folder, "is a directory, not a file"),
        (tmp_path / f"socket{suffix}", "is a socket, not a file"),
        (device, "is a device, not a file"),
        (missing, "there is no such file"),
    ):
        for given in (path, str(path)):
            with pytest.raises(hullcast.InvalidArgument, match=text) as caught:
                call(client, given, tmp_path)
            assert caught.value.field.removesuffix("[0]") == field
            assert isinstance(caught.value, FileNotFoundError) == (path == missing)
    plug.close()


@pytest.mark.parametrize("name", READERS)
def test_an_open_file_is_not_a_path(client, tmp_path, name):
    """Catches an open file whose lines are taken for hulls, and a number taken for an open file."""
    call, field, _ = READERS[name]
    with open(__file__, "rb") as opened:
        for wrong, named in (
            (opened, repr(__file__)),
            (io.BytesIO(b"v 0 0 0"), "write it to a file"),
        ):
            with pytest.raises(hullcast.InvalidArgument, match="an open file") as caught:
                call(client, wrong, tmp_path)
            assert caught.value.field == field
            assert named in str(caught.value)


def test_writing_names_the_path(client, tmp_path):
    """Catches a number for a path, which overwrote whatever file the process had open there."""
    m = client.query(
        hullcast.Scene(client.register(CUBE), np.zeros((1, 3)), [[0, 0, 0, 1]]), [[0, 0]]
    )
    pytest.importorskip("matplotlib")
    for write in (m.save, lambda path: m.plot(path=path), m.scene.save):
        for wrong in (
            1,
            5,
            None,
            True,
            b"\0",
            "",
            io.BytesIO(),
            tmp_path,
            tmp_path / "no/file.png",
        ):
            if wrong is None and write is not m.save and write != m.scene.save:
                continue  # no file is written
            with pytest.raises(hullcast.InvalidArgument) as caught:
                write(wrong)
            assert caught.value.field == "path"
    with pytest.raises(hullcast.InvalidArgument, match=r"ends in one of .*\.png"):
        m.plot(path=tmp_path / "picture.docx")


@pytest.mark.parametrize(
    ("name", "content", "text"),
    [
        ("a.stl", OBJ.encode(), "has the suffix .stl, but its content is OBJ: rename it to .obj"),
        ("long.stl", (OBJ * 50).encode(), "its content is OBJ: rename it to .obj"),
        ("a.obj", stl(box((0, 0, 0), (1, 1, 1))), "binary, but OBJ is text"),
        ("b.obj", b"solid a\nendsolid a\n", "its content is STL as text: rename it to .stl"),
        ("c.stl", b"ply\nformat ascii 1.0\n", "its content is PLY: rename it to .ply"),
        (
            "d.stl",
            b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n",
            "run `git lfs pull`",
        ),
        (
            "e.obj",
            b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n",
            "run `git lfs pull`",
        ),
        ("f.stl", b"<?xml version='1.0'?><COLLADA/>", "its content is COLLADA: rename it to .dae"),
        ("g.obj", b"<!DOCTYPE html><html></html>", "is a page of HTML"),
        ("h.stl", b"PK\3\4" + bytes(200), "is a zip archive"),
        ("i.stl", URDF.encode(), "is a URDF file"),
        (
            "j.stl",
            b"just some words " * 20,
            "the file is text, but an STL file as text begins with",
        ),
    ],
)
def test_a_file_of_another_kind_is_named(client, tmp_path, name, content, text):
    """Catches a message that an OBJ file named .stl has lost billions of bytes."""
    (tmp_path / name).write_bytes(content)
    with pytest.raises(hullcast.InvalidArgument) as caught:
        client.register(tmp_path / name)
    assert text in str(caught.value)
    assert len(str(caught.value)) < 300


def test_damaged_answers_are_named(client, tmp_path):
    """Catches a message that a cut file is not an npz file, and columns of another type."""
    scene = hullcast.Scene(client.register(CUBE), np.zeros((1, 3)), [[0, 0, 0, 1]])
    path = tmp_path / "m.npz"
    client.query(scene, [[0, 0]]).save(path)
    whole = path.read_bytes()
    for size in (len(whole) // 2, len(whole) - 10, 100, 4):
        path.write_bytes(whole[:size])
        with pytest.raises(hullcast.InvalidArgument, match="a damaged npz file"):
            hullcast.Manifolds.load(path)
    path.write_bytes(whole)
    with np.load(path) as file:
        columns = dict(file)
    np.savez(path, **{**columns, "alphas": columns["alphas"].astype("<i8")})
    with pytest.raises(
        hullcast.InvalidArgument, match="alphas has the type int64, expected float64"
    ):
        hullcast.Manifolds.load(path)


def test_binaries_that_cannot_be_started(tmp_path, monkeypatch):
    """Catches PermissionError and OSError for a HULLCAST_BIN that is no program."""
    plain, text, folder = tmp_path / "plain", tmp_path / "text", tmp_path / "folder"
    plain.write_bytes(b"x")
    text.write_text("not a program\n")
    text.chmod(0o755)
    folder.mkdir()
    for path, kind, match in (
        (plain, hullcast.ServerNotFound, "is not executable"),
        (folder, hullcast.ServerNotFound, "is a directory"),
        (tmp_path / "none", hullcast.ServerNotFound, "does not exist"),
        (text, hullcast.ServerDidNotStart, "cannot be run .*expected the hullcast program"),
    ):
        monkeypatch.setenv("HULLCAST_BIN", str(path))
        with pytest.raises(kind, match=match):
            hullcast.serve()
    monkeypatch.delenv("HULLCAST_BIN")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr("hullcast._serve._own_binary", lambda: None)
    monkeypatch.setenv("HULLCAST_BINARY", "/somewhere")
    with pytest.raises(hullcast.ServerNotFound, match="variable HULLCAST_BINARY is not read"):
        hullcast.serve()


def test_a_relative_binary_is_that_of_the_folder(tmp_path, monkeypatch):
    """Catches a name without a folder that is looked for on PATH although the file is here."""
    (tmp_path / "own").symlink_to(os.path.abspath(find_binary()))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HULLCAST_BIN", "own")
    with hullcast.serve() as client:
        assert client.ping() > 0


# Scene files.


def two_cubes(client: hullcast.Client) -> hullcast.Scene:
    hulls = client.register([CUBE, CUBE * 0.1 + 1 / 3], contraction_points=[[0.1, 0, 0], None])
    hulls += client.register(CUBE * 2, planarity=None)
    rng = np.random.default_rng(5)
    turns = rng.normal(size=(4, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    return hullcast.Scene(
        hulls, rng.normal(size=(4, 3)), turns, body_hulls=[0, 1, 2, 0], groups=[1, 2, 3, 4],
        worlds=[0, 0, 0, 2**32 - 1], ignored_groups=[[1, 2]],
    )  # fmt: skip


def test_a_scene_goes_to_the_command_line_and_back(client, tmp_path):
    """Catches a pose, a point, an option or a pair that the file changes by a single bit."""
    scene, pairs = two_cubes(client), [[0, 1], [0, 2], [1, 3]]
    path = tmp_path / "scene.json"
    scene.save(path, pairs, margin=0.1)
    again = hullcast.Scene.load(path)
    for name in ("hull_ids", "margin", *("positions", "rotations", "body_hulls", "pairs"),
                 *("worlds", "groups", "ignored_groups")):  # fmt: skip
        ours, theirs = getattr(scene, name), getattr(again, name)
        if name not in ("margin", "pairs"):
            assert np.asarray(ours).tobytes() == np.asarray(theirs).tobytes(), name
    assert again.pairs.tolist() == pairs
    assert again.margin == 0.1
    m = client.query(again, again.pairs, margin=again.margin)
    out = tmp_path / "m.npz"
    command = [find_binary(), "query", path, "--out", out, "--outputs", "alpha,normal,points"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    other = hullcast.Manifolds.load(out)
    for name in ("outcome", "alpha", "normal", "separation", "witness_a", "distance", "pairs"):
        assert getattr(m, name).tobytes() == getattr(other, name).tobytes(), name
    # A moved scene keeps the pairs and the margin of its file.
    moved = again.moved(again.positions + 1, again.rotations)
    moved.save(path)
    assert hullcast.Scene.load(path).pairs.tolist() == pairs
    # A server that has never seen the hulls gets them with the first query.
    with hullcast.serve() as fresh:
        assert (fresh.query(again, pairs, margin=0.1).alpha == m.alpha).all()


def test_the_example_scenes_are_loaded(client):
    """Catches a file of the command line that Python reads otherwise; frames by name and number."""
    folder = Path(__file__).resolve().parents[2] / "examples/scenes"
    scene = hullcast.Scene.load(folder / "panda.json", frame="stack")
    assert (hullcast.Scene.load(folder / "panda.json", frame=4).positions == scene.positions).all()
    assert client.query(scene, scene.pairs, margin=scene.margin).in_contact.any()
    for wrong in ("stak", 6, -1, 1.5, None):
        with pytest.raises(hullcast.InvalidArgument) as caught:
            hullcast.Scene.load(folder / "panda.json", frame=wrong)
        assert caught.value.field == "frame"


GOOD = (
    '{"format": "hullcast.scene.v1", "name": "two", "margin": 0.5, "hulls": [{"vertices":'
    ' [[0,0,0],[1,0,0],[0,1,0],[0,0,1]]}], "bodies": [{"hull": 0, "position": [0,0,0], "rotation":'
    ' [0,0,0,1]}, {"hull": 0, "position": [0,0,2], "rotation": [0,0,0,1]}], "pairs": [[0,1]]}'
)


FRAME = '{"name": "f", "positions": [[0,0,0],[0,0,3]], "rotations": [[0,0,0,1],[0,0,0,1]]}'


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("[0,0,1]]", "[0,0]]", "hulls[0].vertices"),
        ("[0,0,1]]", "[0,0,1e999]]", "hulls[0].vertices"),
        ("[0,0,1]]", "[0,0,NaN]]", "not JSON"),
        ('"hull": 0, "position": [0,0,2]', '"hull": 7, "position": [0,0,2]', "bodies[1].hull: got 7"),
        ('"hull": 0, "position": [0,0,2]', '"hull": -1, "position": [0,0,2]', "bodies[1].hull"),
        ("[0,0,2]", "[0,2]", "bodies[1].position"),
        ("[0,0,2]", '[0,0,"2"]', "bodies[1].position"),
        ("[[0,1]]", "[[0,2]]", "pairs[0, 1]"),
        ("[[0,1]]", "null", "pairs"),
        ("0.5", "-0.5", "margin"),
        ("0.5", '"1"', "margin"),
        ("scene.v1", "scene.v2", "format"),
        ('"hulls": [', '"hulls": [5, ', "hulls[0]: expected an object"),
        ('"bodies"', '"others"', "bodies: expected a list"),
        (GOOD, "[]", "expected an object"),
        (GOOD, "# A page", "not JSON"),
        (GOOD, "", "not JSON"),
        (GOOD, '{"format": 1}', "format: got 1"),
        ('"pairs"', '"frames": 0, "pairs"', "frames: expected a list"),
        ('"pairs"', '"frames": {}, "pairs"', "frames: expected a list"),
        ('"pairs"', '"frames": "", "pairs"', "frames: expected a list"),
        ('"pairs"', '"frames": null, "pairs"', "frames: expected a list"),
        ('"margin": 0.5', '"margin": 0.5, "margin": 0.1', "the key 'margin' is twice"),
        ('"hull": 0', '"hull": 0, "hull": 0', "the key 'hull' is twice"),
        ('"name": "two"', '"name": 5', "name: expected a text"),
        ('"name": "two", ', "", "name: expected a text"),
        ('{"vertices"', '{"name": 5, "vertices"', "hulls[0].name: expected a text"),
        ('{"vertices"', '{"planarity": "0", "vertices"', "hulls[0].planarity: got '0'"),
        ('"pairs"', f'"frames": [{FRAME}, {FRAME}], "pairs"', "frames[1].name: frames[0] has the name 'f' too"),
        ('"pairs"', f'"frames": [{FRAME}, {{}}], "pairs"', "frames[1].positions"),
        ('"position": [0,0,2]', '"position": [0,2]', "bodies[1].position"),
    ],
)  # fmt: skip
def test_files_that_are_no_scenes(tmp_path, old, new, place):
    """Catches Python's KeyError or JSONDecodeError: the message names the file and the place."""
    path = tmp_path / "scene.json"
    path.write_text(GOOD)
    assert len(hullcast.Scene.load(path)) == 2
    path.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(hullcast.InvalidArgument) as caught:
        hullcast.Scene.load(path)
    assert (caught.value.reason, caught.value.field) == ("NOT_A_SCENE", "path")
    assert "scene.json: " in str(caught.value)
    assert place in str(caught.value)
    # The command line reads the same files, so it refuses these too.
    command = [find_binary(), "query", path]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode != 0
    assert "scene.json" in done.stderr


def test_a_planarity_that_no_server_accepts_names_its_hull(tmp_path):
    """Catches an id that no server gives, and an error that does not say which hull is at fault."""
    path = tmp_path / "scene.json"
    path.write_text(GOOD.replace('{"vertices"', '{"planarity": 5, "vertices"'))
    with pytest.raises(hullcast.InvalidArgument) as caught:
        hullcast.Scene.load(path)
    assert "hulls[0].planarity: got 5, expected a number, 0 to 0.01" in str(caught.value)


def test_scenes_that_a_file_cannot_hold(client, tmp_path):
    """Catches a file without points, with a pose that is no JSON, or with another hull."""
    hulls = client.register(CUBE)
    small = client.register(np.random.default_rng(1).normal(size=(60, 3)), max_vertices=10)
    at, turn = np.zeros((1, 3)), [[0, 0, 0, 1]]
    for scene, reason in (
        (hullcast.Scene([hulls[0].id], at, turn), "NO_GEOMETRY"),
        (hullcast.Scene(hulls, at + np.nan, turn), "NOT_FINITE"),
        (hullcast.Scene(small, at, turn), "SIMPLIFIED"),
    ):
        with pytest.raises(hullcast.InvalidArgument) as caught:
            scene.save(tmp_path / "scene.json")
        assert caught.value.reason == reason
    assert not (tmp_path / "scene.json").exists()
    for options in ({"pairs": [[0, 1]]}, {"margin": -1}, {"margin": np.inf}, {"name": 5}):
        with pytest.raises(hullcast.InvalidArgument) as caught:
            hullcast.Scene(hulls, at, turn).save(tmp_path / "scene.json", **options)
        assert caught.value.field == next(iter(options))


@pytest.mark.parametrize("where", ["a name that is too long", "a full disk"])
@pytest.mark.filterwarnings("error")
def test_the_systems_refusal_to_write_is_named(client, tmp_path, where):
    """Catches an OSError of the system: the argument and the path are not in it."""
    scene = hullcast.Scene(client.register(CUBE), np.zeros((1, 3)), [[0, 0, 0, 1]])
    m = client.query(scene, [[0, 0]])
    writers = {".npz": m.save, ".json": scene.save}
    if pytest.importorskip("matplotlib"):
        writers[".png"] = lambda path: m.plot(path=path)
    for suffix, write in writers.items():
        path = tmp_path / f"{'a' * 300}{suffix}"
        if where == "a full disk":
            path = tmp_path / f"full{suffix}"
            path.symlink_to("/dev/full")
        with pytest.raises(hullcast.InvalidArgument, match="cannot be written: ") as caught:
            write(path)
        assert (caught.value.reason, caught.value.field) == ("UNWRITABLE_FILE", "path")
