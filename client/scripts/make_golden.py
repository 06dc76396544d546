"""Writes tests/golden/contacts.json: pairs with their exact answers.

    python client/scripts/make_golden.py

The inputs are chosen here, and every answer comes from the tests' exact oracle. The Rust tests and
the Python tests read the same file (tests/golden/README.md describes the format).
"""

from __future__ import annotations

import json
import math
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "client/src"), str(ROOT / "client/tests")]

from cases import matrix, random_rotation, rotation_between  # noqa: E402
from oracle import ExactBody, ExactPair, add, dot, patch  # noqa: E402
from shapes import Shape, box, poly, prism, tetra  # noqa: E402

U = 2.0**-53
UPRIGHT = [0.0, 0.0, 0.0, 1.0]
TURNED = [0.0, 0.0, math.sin(math.pi / 8), math.cos(math.pi / 8)]
UNIT = box((0.5, 0.5, 0.5))


def case(name, why, a, b, d, *, q=UPRIGHT, margin=0.0, origin=(0.0, 0.0, 0.0), faces=None, **more):
    """Makes one case: hull `a` at `origin`, and hull `b` at offset `d` from it, rotated by `q`.

    `faces` has the faces whose intersection is the patch, as indices into `Shape.faces`.
    """
    centres = more.get("centres", ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    origin = np.array(origin, dtype=float)
    poses = [(origin, np.array(UPRIGHT)), (origin + np.array(d, dtype=float), np.array(q))]
    bodies = [
        ExactBody.make(shape.vertices, centre, *pose)
        for shape, centre, pose in zip((a, b), centres, poses, strict=True)
    ]
    pair = ExactPair(*bodies)
    alpha, n = pair.growth
    distance_squared = pair.distance_squared
    r = sum(inradius(s, c) for s, c in zip((a, b), centres, strict=True))
    radius = sum(
        np.linalg.norm(s.vertices - c, axis=1).max() for s, c in zip((a, b), centres, strict=True)
    )
    lengths = np.linalg.norm(poses[1][0] - poses[0][0]) + sum(np.linalg.norm(c) for c in centres)
    centre_distance = math.sqrt(dot(pair.d, pair.d))
    corners = None
    if faces is not None:
        ours, theirs = (
            [add(body.position, body.vertices[i]) for i in shape.faces[face]]
            for shape, body, face in zip((a, b), bodies, faces, strict=True)
        )
        corners = [[float(c) for c in p] for p in patch(ours, theirs, n)]
    return {
        "name": name,
        "why": why,
        **{
            key: {
                "vertices": shape.vertices.tolist(),
                "contraction_point": list(centre),
                "position": pose[0].tolist(),
                "rotation": [float(c) for c in pose[1]],
            }
            for key, shape, centre, pose in zip("ab", (a, b), centres, poses, strict=True)
        },
        "margin": None if math.isinf(margin) else margin,
        "outcome": "CONTACT"
        if math.isinf(margin) or distance_squared <= Fraction(margin) ** 2
        else "SEPARATED",
        "alpha_below": below(alpha),
        "alpha_above": above(alpha),
        "alpha_budget": float(alpha) * 16 * U * radius / r + 16 * U * lengths / r,
        "distance": math.sqrt(distance_squared),
        "length_budget": 64 * U * (radius + centre_distance) + 16 * U * lengths,
        "patch": corners,
        "patch_budget": 1e-9 * radius + 4 * U * float(np.abs(poses[1][0]).max()),
    }


def below(x: Fraction) -> float:
    """The largest double that is not above x."""
    near = float(x)
    return near if Fraction(near) <= x else math.nextafter(near, -math.inf)


def above(x: Fraction) -> float:
    """The smallest double that is not below x."""
    return 0.0 - below(-x)  # 0.0, not -0.0


def inradius(shape: Shape, centre) -> float:
    """The radius of the largest ball about the contraction point inside the shape."""
    planes = [shape.plane(face) for face in shape.faces]
    return min(float(normal @ (middle - centre)) for normal, middle in planes)


def facing(shape: Shape, direction) -> int:
    """The face whose normal is nearest to a direction in the hull's frame."""
    return int(np.argmax([shape.plane(f)[0] @ direction for f in shape.faces]))


def on_top(name, why, a, b, d, **more):
    """A case with B's bottom face on A's top face; the patch is their intersection."""
    q = np.array(more.get("q", UPRIGHT))
    down = matrix(q).T @ (0.0, 0.0, -1.0)
    return case(name, why, a, b, d, faces=(facing(a, (0, 0, 1)), facing(b, down)), **more)


def tilted(angle: float) -> list[float]:
    """A rotation about x."""
    return [math.sin(angle / 2), 0.0, 0.0, math.cos(angle / 2)]


def resting(rng, a: Shape, b: Shape, gap: float, name: str, why: str):
    """A case with the first face of B laid on A's top face."""
    top = facing(a, (0, 0, 1))
    normal_a, middle_a = a.plane(a.faces[top])
    normal_b, middle_b = b.plane(b.faces[0])
    q = rotation_between(normal_b, -normal_a, rng.uniform(0, 6))
    d = middle_a + gap * normal_a - matrix(q) @ middle_b
    return case(name, why, a, b, d, q=q, margin=0.01, faces=(top, 0))


def cases():
    """All cases, in the order of the file."""
    rng = np.random.default_rng(20100702)
    yield from resting_cases(rng)
    yield from tied_cases()
    yield from touching_cases()
    yield from sized_cases()
    yield from bounded_cases()
    yield from random_cases(rng)


def resting_cases(rng):
    """Cases with a face on a face."""
    yield on_top(
        "cubes_stacked",
        "equal aligned cubes: slivers where sides coincide",
        UNIT,
        UNIT,
        (0, 0, 0.99),
    )
    yield on_top(
        "cubes_stacked_apart",
        "resting with a gap inside the margin",
        UNIT,
        UNIT,
        (0.25, 0.125, 1.005),
        margin=0.01,
    )
    yield on_top(
        "cubes_stacked_turned",
        "an octagon: eight points, none of them a corner",
        UNIT,
        UNIT,
        (0, 0, 0.999),
        q=TURNED,
    )
    yield on_top(
        "box_on_box_turned",
        "a corner of B hangs over A's side",
        box((1, 0.6, 0.3)),
        box((0.5, 0.4, 0.2)),
        (0.7, 0.3, 0.499),
        q=TURNED,
    )
    yield on_top(
        "prisms_stacked",
        "a twelve-sided prism on a three-sided one",
        prism(3, 1, 0.25),
        prism(12, 0.6, 0.25),
        (0.01, 0.02, 0.499),
    )
    yield on_top(
        "tilt_below_feature_angle",
        "the whole patch as long as the tilt is below 0.01",
        UNIT,
        UNIT,
        (0.1, 0, 0.999),
        q=tilted(0.009),
    )
    yield resting(
        rng,
        prism(7, 0.8, 0.5),
        tetra(rng),
        -0.001,
        "tetra_on_prism",
        "oblique faces, no shared direction",
    )
    yield resting(
        rng,
        poly(16, rng),
        box((0.4, 0.5, 0.6)),
        -0.0005,
        "box_on_poly",
        "a face with merged triangles on one without",
    )


def tied_cases():
    """Cases with several optimal normals, or several possible pivots."""
    yield case("cubes_along_edge_diagonal", "two normals are optimal", UNIT, UNIT, (0.75, 0.75, 0))
    yield case(
        "cubes_along_diagonal",
        "three normals are optimal; a classic pivot finds no exit edge",
        UNIT,
        UNIT,
        (0.75, 0.75, 0.75),
    )
    yield case(
        "flat_box_tie",
        "moving d by 1e-12 makes the separation jump",
        box((1, 1, 0.05)),
        box((0.2, 0.2, 0.2)),
        (0.6, 0, 0.125),
    )
    yield case("integer_boxes_1", "pivot ties", box((2, 3, 3)), box((4, 4, 1)), (4, -4, 2))
    yield case("integer_boxes_2", "pivot ties", box((1, 3, 2)), box((1, 3, 4)), (0, -4, 4))
    yield case(
        "prism_in_prism",
        "pivot ties along the axis",
        prism(6, 0.5, 0.5),
        prism(6, 0.5, 0.5),
        (0, 0, 0.5),
    )
    yield case(
        "cube_at_corner_of_large_cube",
        "a small cube on a large one's diagonal",
        box((1, 1, 1)),
        box((0.1, 0.1, 0.1)),
        (1.05, 1.05, 1.05),
    )


def touching_cases():
    """Cases of hulls that touch exactly, coincide, or are apart along a plain direction."""
    yield case("touching_faces", "exactly touching is CONTACT", UNIT, UNIT, (0.25, 0, 1))
    yield case("touching_edges", "exactly touching along an edge", UNIT, UNIT, (1, 0.25, 1))
    yield case("touching_corners", "exactly touching at a corner", UNIT, UNIT, (1, 1, 1))
    yield case(
        "coincident", "identical hulls at an identical pose: alpha is 0", UNIT, UNIT, (0, 0, 0)
    )
    yield case(
        "almost_coincident", "alpha keeps its relative precision", UNIT, UNIT, (1e-290, 0, 0)
    )
    yield case(
        "cube_above_cube",
        "separated along an axis, every number wanted",
        UNIT,
        UNIT,
        (0, 0, 1.9),
        margin=math.inf,
    )
    yield case(
        "edge_over_edge",
        "two edges cross above each other",
        prism(3, 0.5, 1),
        UNIT,
        (0.2, 0.9, 0.1),
        q=[0.5, 0.5, 0.5, 0.5],
    )


def sized_cases():
    """Cases of hulls that are thin, long, tiny, huge or far away."""
    yield case(
        "large_plate",
        "a unit cube on a plate of half size 2e4",
        box((2e4, 2e4, 0.5)),
        UNIT,
        (1234.5, -987.25, 0.999),
    )
    yield case(
        "coaxial_on_large_plate",
        "the same about its axis",
        box((2e4, 2e4, 0.5)),
        UNIT,
        (0, 0, 0.999),
    )
    yield case(
        "plates",
        "two plates 1e-6 thick, tilted: stalls at rounding level",
        box((1, 0.7, 1e-6)),
        box((0.6, 0.9, 1e-6)),
        (-0.0649442904150084, -0.016471141617431306, 2.02e-6),
        q=tilted(1e-4),
    )
    yield case(
        "needles",
        "aspect 1e4, crossing",
        box((1e-4, 1e-4, 1)),
        box((1, 1e-4, 1e-4)),
        (0.3, 1.5e-4, 0.2),
    )
    yield case(
        "ghost",
        "the growth normal's separation is .009, the hulls are .174 apart",
        box((1, 1, 0.03)),
        box((0.02, 0.02, 0.02)),
        (1.1934, 0, 0.059),
        margin=0.05,
    )
    yield case(
        "far_from_origin",
        "the same cubes 1e9 from the world's origin",
        UNIT,
        UNIT,
        (0.25, 0.125, 0.96875),
        origin=(1e9, -1e9, 5e8),
        q=TURNED,
    )
    yield case(
        "tiny",
        "all lengths times 2^-40",
        scaled(UNIT, -40),
        scaled(UNIT, -40),
        np.ldexp((0.3, 0.2, 0.9), -40),
        q=TURNED,
    )
    yield case(
        "huge",
        "all lengths times 2^40",
        scaled(UNIT, 40),
        scaled(UNIT, 40),
        np.ldexp((0.3, 0.2, 0.9), 40),
        q=TURNED,
    )
    yield case(
        "sizes_apart",
        "a cube of 1e-5 on the side of a unit cube",
        UNIT,
        box((1e-5, 1e-5, 1e-5)),
        (0.1, 0.2, 0.500005),
    )


def bounded_cases():
    """Cases with given contraction points, and with margins at and near the distance."""
    yield case(
        "contraction_point_aside",
        "growth about points near a face",
        UNIT,
        UNIT,
        (0.3, 0.2, 0.9),
        centres=((0.25, 0.125, -0.4375), (0.0, -0.25, 0.4375)),
    )
    yield case(
        "margin_at_distance",
        "the hulls exactly the margin apart",
        UNIT,
        UNIT,
        (1.5, 0, 0),
        margin=0.5,
    )
    yield case(
        "margin_below_distance",
        "the hulls farther than the margin",
        UNIT,
        UNIT,
        (1.5, 0, 0),
        margin=0.499,
    )
    yield case(
        "margin_corner",
        "a corner's distance is not its separation along an axis",
        UNIT,
        UNIT,
        (1.3, 1.4, 1.2),
        margin=0.5,
    )


def random_cases(rng):
    """Random cases without special features."""
    for i in range(4):
        a, b = (
            poly(16, rng),
            (tetra(rng), box((0.3, 0.5, 0.7)), prism(5, 0.5, 0.4), poly(16, rng))[i],
        )
        direction = rng.normal(size=3)
        d = direction / np.linalg.norm(direction) * (0.5, 0.9, 1.1, 2.0)[i]
        yield case(
            f"random_{i}", "nothing special", a, b, d, q=random_rotation(rng), margin=math.inf
        )


def scaled(shape: Shape, power: int) -> Shape:
    """A shape with all lengths multiplied by a power of two."""
    return Shape(shape.family, np.ldexp(shape.vertices, power))


def main() -> None:
    """Writes the file."""
    path = ROOT / "tests/golden/contacts.json"
    lines = [json.dumps(case) for case in cases()]
    head = '{"format": "hullcast.golden.v1", "cases": [\n'
    path.write_text(head + ",\n".join(lines) + "\n]}\n")  # one line per case, for diffs
    print(f"{len(lines)} cases in {path.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
