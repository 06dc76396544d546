"""Computes the contacts of real scenes, with a server that this script starts and stops.

    make demo

Registers the hulls of examples/scenes, queries the contacts of every configuration, checks the
results against the vertices, prints a summary and draws a picture.
"""

import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import grpc
import numpy as np

import hullcast
import render
from hullcast._pb import hulls_pb2
from PIL import Image, ImageDraw

HERE = Path(__file__).parent
OUTPUTS = ["ALPHA", "NORMAL", "POINTS", "FEATURES"]
REPEATS = 5


@dataclass
class Frame:
    """One configuration and its result."""

    name: str
    scene: hullcast.Scene
    answer: hullcast.Manifolds
    seconds: float  # the fastest round trip, from numpy to numpy


@dataclass
class Example:
    """A scene file whose hulls are registered."""

    document: dict
    hulls: list
    pairs: np.ndarray
    frames: list
    outlines: list  # for each hull its faces, each an array of corners (k, 3)


def load(client, path):
    """Registers a scene's hulls and queries the contacts of each of its frames."""
    document = json.loads(path.read_text())
    hulls = client.register([np.array(h["vertices"]) for h in document["hulls"]])
    bodies, pairs = document["bodies"], np.array(document["pairs"])
    frames = document.get("frames") or [
        {"name": "", "positions": [b["position"] for b in bodies], "rotations": [b["rotation"] for b in bodies]}
    ]
    first = frames[0]
    scene = hullcast.Scene(
        hulls, first["positions"], first["rotations"], body_hulls=[b["hull"] for b in bodies]
    )
    answered = []
    for frame in frames:
        moved = scene.moved(frame["positions"], frame["rotations"])
        seconds = []
        for _ in range(REPEATS):
            start = time.perf_counter()
            answer = client.query(moved, pairs, margin=document["margin"], outputs=OUTPUTS)
            seconds.append(time.perf_counter() - start)
        answered.append(Frame(frame["name"], moved, answer, min(seconds)))
    return Example(document, hulls, pairs, answered, outlines(client, hulls))


def outlines(client, hulls):
    """The server's faces, with coplanar triangles merged: for each hull a list of corner arrays."""
    with grpc.insecure_channel(client.target, options=[("grpc.enable_http_proxy", 0)]) as channel:
        get = channel.unary_unary(
            "/hullcast.v1.HullService/GetHulls",
            request_serializer=hulls_pb2.GetHullsRequest.SerializeToString,
            response_deserializer=hulls_pb2.GetHullsResponse.FromString,
        )
        request = hulls_pb2.GetHullsRequest(ids=[h.id for h in hulls])
        request.field_mask.paths.extend(["vertices", "faces"])
        records = get(request, timeout=60).hulls
    result = []
    for record in records:
        vertices = np.array(record.vertices).reshape(-1, 3)
        place = {registered: row for row, registered in enumerate(record.vertex_indices)}
        corners = np.array([place[i] for i in record.face_vertices])
        offsets = list(record.face_offsets)
        result.append([vertices[corners[a:b]] for a, b in zip(offsets, offsets[1:])])
    return result


def matrices(rotations):
    """(n, 3, 3): the rotation matrices of quaternions x, y, z, w."""
    x, y, z, w = (rotations / np.linalg.norm(rotations, axis=1)[:, None]).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def check(example, frame):
    """Checks every pair using only definitions and the vertices of the file.

    For every pair, the outcome is known, the bracket is in order and the normal has unit length.
    For every pair in contact, the separation follows from the vertices' extents along the normal,
    alpha is the bound that they give, and no point is deeper than the separation. Returns the
    number of pairs in contact.
    """
    m, bodies = frame.answer, example.document["bodies"]
    turn = matrices(np.array(frame.scene.rotations))
    world = [
        np.array(example.document["hulls"][b["hull"]]["vertices"]) @ turn[i].T + frame.scene.positions[i]
        for i, b in enumerate(bodies)
    ]
    centre = [
        turn[i] @ example.hulls[b["hull"]].contraction_point + frame.scene.positions[i] for i, b in enumerate(bodies)
    ]
    contact = m.outcome == hullcast.Outcome.CONTACT
    assert np.isin(m.outcome, (hullcast.Outcome.CONTACT, hullcast.Outcome.SEPARATED)).all(), "an outcome is unknown"
    assert (m.alpha_lower <= m.alpha).all() and (m.alpha <= m.alpha_upper).all(), "a bracket is out of order"
    assert np.allclose(np.linalg.norm(m.normal, axis=1), 1, atol=1e-14), "a normal is not of unit length"
    assert (np.diff(m.point_offsets)[contact] > 0).all(), "a contact has no point"
    for i in np.flatnonzero(contact):
        (a, b), n = example.pairs[i], m.normal[i]
        d = centre[b] - centre[a]
        h = (world[a] @ n).max() - centre[a] @ n + centre[b] @ n - (world[b] @ n).min()
        size = np.ptp(world[a], axis=0).max() + np.ptp(world[b], axis=0).max() + np.abs(d).max()
        assert abs(m.separation[i] - (n @ d - h)) <= 1e-13 * size, f"pair {i}: separation"
        assert abs(m.alpha[i] - n @ d / h) <= 1e-13 * size / min(h, size), f"pair {i}: alpha"
        distances = m.distance[m.point_offsets[i] : m.point_offsets[i + 1]]
        planarity = sum(example.hulls[bodies[k]["hull"]].geometric_error for k in (a, b))
        assert (distances >= m.separation[i] - planarity - 1e-13 * size).all(), f"pair {i}: a point is too deep"
    return int(contact.sum())


def report(example):
    """Prints one line per frame."""
    document = example.document
    print(
        f"\n{document['name']}: {len(example.hulls)} hulls "
        f"({sum(h.vertex_count for h in example.hulls)} vertices), {len(document['bodies'])} bodies, "
        f"{len(example.pairs)} pairs, margin {document['margin'] * 1e3:g} mm"
    )
    print("  frame       contacts  points   deepest      alpha of contacts     round trip       pairs/s  checked")
    for frame in example.frames:
        m = frame.answer
        contacts = check(example, frame)
        alpha = m.alpha[m.outcome == hullcast.Outcome.CONTACT]
        print(
            f"  {frame.name or '-':<11} {contacts:8d} {len(m.distance):7d} {-m.distance.min() * 1e3:8.3f} mm"
            f"   {alpha.min():.6f} .. {alpha.max():.6f} {frame.seconds * 1e3:8.2f} ms "
            f"{len(example.pairs) / frame.seconds:13,.0f}  {contacts} ok"
        )


# --- The picture ------------------------------------------------------------------------------

STEEL, ORANGE, GROUND = (222, 226, 232), (243, 146, 55), (214, 212, 206)
HEADER = 72  # height of the header above a picture, in pixels
PALETTE = [(126, 176, 160), (150, 170, 214), (222, 184, 120), (200, 146, 160), (158, 190, 120), (184, 164, 206)]


def body_colour(name, index):
    """A body's colour: light and orange for robot links, grey for fixed bodies, others varied."""
    if name.split()[0] in ("table", "ground", "floor", "wall"):
        return GROUND
    if "/" in name:
        joints = ("link1", "link3", "link5", "link7", "HFE", "KFE", "face", "finger", "lidar")
        return ORANGE if any(j in name for j in joints) else STEEL
    return PALETTE[index % len(PALETTE)]


def panel(example, frame, camera, size, scale, *, length, radius, hidden, hide=()):
    """Draws one frame. `scale` is the distance, in metres, at both ends of the colour ramp."""
    document, m = example.document, frame.answer
    turn = matrices(np.array(frame.scene.rotations))
    bodies, colours = [], []
    for i, body in enumerate(document["bodies"]):
        if body["name"].split()[0] not in hide:
            faces = example.outlines[body["hull"]]
            bodies.append([face @ turn[i].T + frame.scene.positions[i] for face in faces])
            colours.append(body_colour(body["name"], i))
    picture, view, depth = render.draw(bodies, colours, camera, size)
    pair = np.repeat(np.arange(len(example.pairs)), np.diff(m.point_offsets))
    middle = m.witness_a + 0.5 * m.distance[:, None] * m.normal[pair]
    colour = render.ramp(0.5 - 0.5 * m.distance / scale)
    picture = render.draw_contacts(
        picture, view, depth, middle, m.normal[pair], colour, length, radius, hidden
    )
    contacts = int((m.outcome == hullcast.Outcome.CONTACT).sum())
    sheet = Image.new("RGB", (size[0], size[1] + HEADER), tuple(int(c) for c in render.BACKGROUND))
    sheet.paste(picture, (0, HEADER))
    pen = ImageDraw.Draw(sheet)
    title = f"{document['name']}: {frame.name}" if frame.name else document["name"]
    counts = f"{len(example.pairs):,} pairs, {contacts:,} contacts, {len(m.distance):,} points"
    pen.text((14, 10), title, fill=render.INK, font=render.font(20))
    pen.text((14, 36), f"{counts}, {frame.seconds * 1e3:.1f} ms", fill=(92, 99, 110), font=render.font(16))
    bar = render.colour_bar(230, 62, f"{scale * 1e3:g} mm apart", f"{scale * 1e3:g} mm deep", "contact points")
    sheet.paste(bar, (size[0] - 244, 6))
    return sheet


def draw(panda, anymal, pile, path):
    """Draws five robot configurations around the pile."""
    width, height, gap = 640, 420, 10
    arm = render.Camera((1.75, -1.05, 1.05), (0.36, -0.02, 0.33), 1.95)
    hand = render.Camera((1.00, 0.62, 0.40), (0.50, 0.14, 0.10), 1.55)
    walk = render.Camera((2.3, 2.0, 1.05), (0.28, 0.05, 0.27), 2.2)
    heap = render.Camera((4.3, -4.7, 3.9), (0, 0, -0.1), 1.6)
    frames = {f.name: f for e in (panda, anymal) for f in e.frames}
    places = {
        (0, 0): (panda, "grasp", hand),
        (1, 0): (panda, "stack", arm),
        (2, 0): (panda, "press", arm),
        (0, 1): (anymal, "step up", walk),
        (0, 2): (anymal, "ramp", walk),
    }
    step = (width + gap, height + HEADER + gap)
    sheet = Image.new("RGB", (3 * step[0] + gap, 3 * step[1] + gap), (255, 255, 255))
    for (column, row), (example, name, camera) in places.items():
        part = panel(example, frames[name], camera, (width, height), 2e-4, length=0.06, radius=4.5, hidden=0.75)
        sheet.paste(part, (gap + column * step[0], gap + row * step[1]))
    size = (2 * width + gap, 2 * height + HEADER + gap)
    part = panel(pile, pile.frames[0], heap, size, 1e-3, length=0.07, radius=3, hidden=0, hide=("wall",))
    sheet.paste(part, (gap + step[0], gap + step[1]))
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path, optimize=True)


def main():
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE.parent / "out" / "demo.png"
    started = time.perf_counter()
    with hullcast.serve() as client:
        print(f"server at {client.target}, hulls in an embedded store")
        panda, anymal, pile = (
            load(client, HERE / "scenes" / name) for name in ("panda.json", "anymal_c.json", "pile.json")
        )
    for example in (panda, anymal, pile):
        report(example)
    draw(panda, anymal, pile, path)
    print(f"\nserver stopped; picture: {path.resolve()}  ({time.perf_counter() - started:.1f} s in all)")


if __name__ == "__main__":
    main()
