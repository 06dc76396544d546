"""Contacts by least translation, computed with numpy.

Only the normal differs from the server's contacts; the steps after it are the same. The normal is
the axis along which the hulls overlap least, or are farthest apart. It is searched over all face
normals of the Minkowski difference: the face normals of both hulls, and the cross products of edges
whose arcs on the Gauss map cross (Gregorius, GDC 2013). No shorter translation separates
overlapping hulls. Then, as in the server, each hull's feature that faces the other hull within the
feature angle is taken (a face, otherwise an edge, otherwise a vertex). Both features are projected
along the normal and intersected, and every corner of the intersection is lifted back onto the
features.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from contacts import Contacts, Floats, Ids, Indices, frames
from scipy.spatial import ConvexHull

#: Triangles whose normals differ by less than this are one face.
COPLANAR = 1e-7
#: An axis of an edge pair is used only if it is better than every face's axis by this much, in
#: metres. For parallel faces, the other axes are better by rounding errors only.
BETTER = 1e-9
#: Vertices within this distance of the support plane count as support vertices, in metres.
SUPPORTING = 1e-9

#: The corners (k, 2) in the contact plane, and a name of each side. A side follows its corner.
Outline = tuple[Floats, list[int]]


@dataclass
class Shape:
    """A hull in its own frame."""

    vertices: Floats
    #: (f, 3) and (f,): n.x <= offset for points x inside.
    normals: Floats
    offsets: Floats
    #: The corners of each face, anticlockwise seen from outside.
    faces: list[Indices]
    #: (e, 2): the two vertices, and the two faces, of each edge.
    edges: Indices
    edge_faces: Indices


def shape_of(points: Floats) -> Shape:
    """Makes a shape from points that are all corners, by merging scipy's triangles into faces."""
    hull = ConvexHull(points)
    planes: Floats = hull.equations
    of_plane = np.full(len(planes), -1)
    chosen: list[int] = []
    for i, plane in enumerate(planes):
        same = [k for k, j in enumerate(chosen) if np.abs(planes[j] - plane).max() < COPLANAR]
        of_plane[i] = same[0] if same else len(chosen)
        if not same:
            chosen.append(i)
    normals, offsets = planes[chosen, :3], -planes[chosen, 3]
    faces: list[Indices] = []
    sides: dict[tuple[int, int], int] = {}
    for face, normal in enumerate(normals):
        corners = np.unique(hull.simplices[of_plane == face])
        spread = points[corners] - points[corners].mean(axis=0)
        across = np.cross(normal, spread[0])
        order = np.argsort(np.arctan2(spread @ across, spread @ spread[0]))
        ring = corners[order].astype(np.intp)
        faces.append(ring)
        for tail, tip in zip(ring.tolist(), np.roll(ring, -1).tolist(), strict=True):
            sides[tail, tip] = face
    edges = [side for side in sides if side[0] < side[1]]
    edge_faces = [(sides[tail, tip], sides[tip, tail]) for tail, tip in edges]
    return Shape(points, normals, offsets, faces, np.array(edges), np.array(edge_faces))


@dataclass
class Placed:
    """A hull in the world's axes, with a body's origin as its origin."""

    shape: Shape
    vertices: Floats
    normals: Floats
    #: (e, 3): the direction of each edge, the normals of its two faces, and their cross product.
    along: Floats
    left: Floats
    right: Floats
    across: Floats


def placed(shape: Shape, turned: Floats) -> Placed:
    """The shape, rotated by a matrix."""
    vertices, normals = shape.vertices @ turned.T, shape.normals @ turned.T
    tail, tip = shape.edges.T
    left, right = normals[shape.edge_faces[:, 0]], normals[shape.edge_faces[:, 1]]
    return Placed(
        shape, vertices, normals, vertices[tip] - vertices[tail], left, right, np.cross(right, left)
    )


def axis(a: Placed, b: Placed, offset: Floats) -> tuple[Floats, float]:
    """The unit normal from A to B with the largest separation, and that separation.

    `offset` is the position of B relative to A.
    """
    of_a = (a.normals @ (b.vertices + offset).T).min(axis=1) - a.shape.offsets
    of_b = (b.normals @ (a.vertices - offset).T).min(axis=1) - b.shape.offsets
    best_a, best_b = int(of_a.argmax()), int(of_b.argmax())
    if of_a[best_a] >= of_b[best_b]:
        normal, most = a.normals[best_a], float(of_a[best_a])
    else:
        normal, most = -b.normals[best_b], float(of_b[best_b])
    # An arc of A crosses an arc of -B if the ends of each lie on both sides of the other's plane.
    ends_left, ends_right = -a.across @ b.left.T, -a.across @ b.right.T
    own_left, own_right = a.left @ b.across.T, a.right @ b.across.T
    crossing = (
        (ends_left * ends_right < 0) & (own_left * own_right < 0) & (ends_left * own_right > 0)
    )
    i, j = np.nonzero(crossing)
    n = np.cross(a.along[i], b.along[j])
    length = np.linalg.norm(n, axis=1)
    sine = length / np.linalg.norm(a.along[i], axis=1) / np.linalg.norm(b.along[j], axis=1)
    fit = sine > 1e-8  # for parallel edges, a face has the same normal
    i, j, n = i[fit], j[fit], n[fit] / length[fit, None]
    n *= np.sign(np.einsum("ni,ni->n", n, a.left[i] + a.right[i]))[:, None]
    tails = b.vertices[b.shape.edges[j, 0]] + offset - a.vertices[a.shape.edges[i, 0]]
    separations = np.einsum("ni,ni->n", n, tails)
    if len(separations) and separations.max() > most + BETTER:
        best = int(separations.argmax())
        return n[best], float(separations[best])
    return normal, most


def feature(hull: Placed, n: Floats, angle: float) -> Indices:
    """The corners of the face, the edge or the vertex that faces `n`."""
    cosines = hull.normals @ n
    face = int(cosines.argmax())
    if np.linalg.norm(np.cross(hull.normals[face], n)) <= np.sin(angle) and cosines[face] > 0:
        return hull.shape.faces[face]
    heights = hull.vertices @ n
    support = int(heights.argmax())
    supporting = heights >= heights[support] - SUPPORTING
    lengths = np.linalg.norm(hull.along, axis=1)
    sines = np.abs(hull.along @ n) / lengths
    inside = (np.cross(hull.along, hull.left) @ n) * (np.cross(hull.along, hull.right) @ n) <= 0
    fit = supporting[hull.shape.edges].any(axis=1) & (sines <= np.sin(angle)) & inside
    if fit.any():
        return hull.shape.edges[int(np.where(fit, sines, np.inf).argmin())]
    return np.array([support])


def clipped(outline: Outline, by: Outline) -> Outline:
    """The part of an outline (a point, a segment or a polygon) inside a convex polygon.

    This is the Sutherland-Hodgman algorithm, which clips by one side after another. The outline of
    a point or of a segment is treated as a closed polygon that returns along itself.
    """
    corners, names = outline[0].tolist(), outline[1]
    around = by[0].tolist()
    for k, (px, py) in enumerate(around):
        qx, qy = around[(k + 1) % len(around)]
        depths = [(qx - px) * (y - py) - (qy - py) * (x - px) for x, y in corners]
        kept: list[list[float]] = []
        sides: list[int] = []
        for i, (x, y) in enumerate(corners):
            j = (i + 1) % len(corners)
            if depths[i] >= 0:
                kept.append([x, y])
                sides.append(names[i])
            if (depths[i] >= 0) != (depths[j] >= 0):
                t = depths[i] / (depths[i] - depths[j])
                u, v = corners[j]
                kept.append([x + t * (u - x), y + t * (v - y)])
                # At the entry the outline's side continues; at the exit the clipping side begins.
                sides.append(by[1][k] if depths[i] >= 0 else names[i])
        corners, names = kept, sides
        if not corners:
            break
    return np.array(corners).reshape(-1, 2), names


def nearest(p: Floats, q: Floats) -> Floats:
    """The midpoint between two outlines that do not meet, or the crossing point of two segments."""
    best, middle = np.inf, p[0]
    for one, other in ((p, q), (q, p)):
        for corner in one:
            tails, along = other, np.roll(other, -1, axis=0) - other
            squares = np.maximum((along**2).sum(axis=1), 1e-300)
            t = np.clip(((corner - tails) * along).sum(axis=1) / squares, 0, 1)
            feet = tails + t[:, None] * along
            far = np.linalg.norm(feet - corner, axis=1)
            if far.min() < best:
                best, middle = far.min(), 0.5 * (corner + feet[int(far.argmin())])
    if len(p) == len(q) == 2:
        u, v, w = p[1] - p[0], q[1] - q[0], q[0] - p[0]
        area = turn(u, v)
        if abs(area) > 1e-12 * float(np.linalg.norm(u) * np.linalg.norm(v)):
            s, t = turn(w, v) / area, turn(w, u) / area
            if 0 <= s <= 1 and 0 <= t <= 1:
                return p[0] + s * u
    return middle


def turn(u: Floats, v: Floats) -> float:
    """The signed area that two plane vectors span; positive if anticlockwise."""
    return float(u[0] * v[1] - u[1] * v[0])


def heights(corners: Floats, flat: Floats, at: Floats, n: Floats) -> Floats:
    """The heights along the normal at which points of the contact plane lie on a feature."""
    own = corners @ n
    if len(corners) == 1:
        return np.full(len(at), own[0])
    if len(corners) == 2:
        along = flat[1] - flat[0]
        t = (at - flat[0]) @ along / max(float(along @ along), 1e-300)
        return own[0] + np.clip(t, 0, 1) * (own[1] - own[0])
    plane = np.column_stack([flat, np.ones(len(flat))])
    slopes = np.linalg.lstsq(plane, own, rcond=None)[0]
    return np.column_stack([at, np.ones(len(at))]) @ slopes


def manifold(
    a: Placed, b: Placed, offset: Floats, angle: float
) -> tuple[Floats, Floats, Floats, Ids]:
    """The normal, the points relative to A's origin, the distances, and the id of each point."""
    n, _ = axis(a, b, offset)
    features = feature(a, n, angle), feature(b, -n, angle)
    plane = frames(n[None])[0, 1:].T
    corners = a.vertices[features[0]], b.vertices[features[1]] + offset
    flat = corners[0] @ plane, corners[1] @ plane
    # Make B's outline anticlockwise, too, as seen along n.
    second = flat[1][::-1] if len(flat[1]) > 2 else flat[1]
    named = [list(range(len(flat[0]))), list(range(1000, 1000 + len(flat[1])))]
    one, other = (flat[0], named[0]), (second, named[1])
    if len(flat[1]) > 2:
        at, names = clipped(one, other)
    elif len(flat[0]) > 2:
        at, names = clipped(other, one)
    else:
        at, names = nearest(flat[0], flat[1])[None], [0]
    if len(at) == 0:
        at, names = nearest(flat[0], flat[1])[None], [0]
    keep = distinct(at)
    at = at[keep]
    low, high = heights(corners[0], flat[0], at, n), heights(corners[1], flat[1], at, n)
    points = at @ plane.T + (0.5 * (low + high))[:, None] * n
    sides = [[names[i], names[i - 1], *key(features)] for i in keep]
    return n, points, high - low, np.array(sides, dtype=np.uint32).reshape(-1, 4)


def key(features: tuple[Indices, Indices]) -> tuple[int, int]:
    """A number for each of the two features."""
    a, b = (
        int(corners.min()) + 256 * int(corners.max()) + (len(corners) << 20) for corners in features
    )
    return a, b


def distinct(at: Floats) -> list[int]:
    """The indices of distinct points: only the first of several points within 1e-9 m counts."""
    kept: list[int] = []
    for i, point in enumerate(at):
        if all(np.abs(point - at[j]).max() > 1e-9 for j in kept):
            kept.append(i)
    return kept


def by_least_translation(
    shapes: Sequence[Shape], pairs: Ids, positions: Floats, turned: Floats, angle: float
) -> Contacts:
    """The manifold of every pair, each from a cold start."""
    moved: list[int] = np.unique(pairs).tolist()
    bodies = {body: placed(shapes[body], turned[body]) for body in moved}
    found: list[tuple[Floats, Floats, Floats, Ids]] = []
    for a, b in pairs.tolist():
        n, points, distance, ids = manifold(
            bodies[a], bodies[b], positions[b] - positions[a], angle
        )
        found.append((n, points + positions[a], distance, ids))
    counts = np.array([len(one[2]) for one in found], dtype=np.intp)
    if not found:
        empty = np.zeros((0, 3))
        return Contacts(pairs, counts, empty, empty, np.zeros(0), np.zeros((0, 4), np.uint32))
    normals, points, distances, ids = zip(*found, strict=True)
    return Contacts(
        pairs,
        counts,
        np.array(normals),
        np.concatenate(points),
        np.concatenate(distances),
        np.concatenate(ids),
    )
