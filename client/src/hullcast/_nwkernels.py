# type: ignore
# Warp compiles these functions. Its types are warp's own, which type checkers do not know.
"""The kernel that writes contacts into Newton's arrays. It needs warp."""

import warp as wp


@wp.kernel(enable_backward=False)
def fill(
    count: int,
    shapes: wp.array2d(dtype=wp.uint32),
    normals: wp.array(dtype=wp.vec3d),
    witnesses: wp.array(dtype=wp.vec3d),
    distances: wp.array(dtype=wp.float64),
    pair_of: wp.array(dtype=wp.int32),
    rows: wp.array(dtype=wp.int32),
    matches: wp.array(dtype=wp.int32),
    generation: int,
    body_of: wp.array(dtype=wp.int32),
    body_q: wp.array(dtype=wp.transform),
    margins: wp.array(dtype=wp.float32),
    # outputs
    counts: wp.array(dtype=wp.int32),
    shape0: wp.array(dtype=wp.int32),
    shape1: wp.array(dtype=wp.int32),
    point0: wp.array(dtype=wp.vec3),
    point1: wp.array(dtype=wp.vec3),
    offset0: wp.array(dtype=wp.vec3),
    offset1: wp.array(dtype=wp.vec3),
    normal_out: wp.array(dtype=wp.vec3),
    margin0: wp.array(dtype=wp.float32),
    margin1: wp.array(dtype=wp.float32),
    tids: wp.array(dtype=wp.int32),
    match_index: wp.array(dtype=wp.int32),
    match_generation: wp.array(dtype=wp.int32),
):
    """Writes row i of the contacts from the point `rows[i]`; the first thread writes the counts."""
    i = wp.tid()
    if i == 0:
        counts[0] = count
        if match_generation.shape[0] > 0:
            match_generation[0] = generation
    if i >= count:
        return
    point = rows[i]
    pair = pair_of[point]
    a = wp.int32(shapes[pair, 0])
    b = wp.int32(shapes[pair, 1])
    n = normals[pair]
    on_a = witnesses[point]
    on_b = on_a + distances[point] * n
    thick_a = margins[a]
    thick_b = margins[b]
    shape0[i] = a
    shape1[i] = b
    point0[i] = wp.vec3(to_body(body_of[a], body_q, on_a))
    point1[i] = wp.vec3(to_body(body_of[b], body_q, on_b))
    offset0[i] = wp.vec3(turned_to_body(body_of[a], body_q, wp.float64(thick_a) * n))
    offset1[i] = wp.vec3(turned_to_body(body_of[b], body_q, -wp.float64(thick_b) * n))
    normal_out[i] = wp.vec3(n)
    margin0[i] = thick_a
    margin1[i] = thick_b
    tids[i] = 0
    if match_index.shape[0] > 0:
        match_index[i] = matches[i]


@wp.func
def to_body(body: int, body_q: wp.array(dtype=wp.transform), point: wp.vec3d) -> wp.vec3d:
    """A point of the world in the frame of a body; body -1 is the world."""
    if body < 0:
        return point
    return turned_to_body(
        body, body_q, point - wp.vec3d(wp.transform_get_translation(body_q[body]))
    )


@wp.func
def turned_to_body(body: int, body_q: wp.array(dtype=wp.transform), vector: wp.vec3d) -> wp.vec3d:
    """A vector of the world in the frame of a body; body -1 is the world."""
    if body < 0:
        return vector
    single = wp.transform_get_rotation(body_q[body])
    double = wp.quatd(
        wp.float64(single[0]), wp.float64(single[1]), wp.float64(single[2]), wp.float64(single[3])
    )
    return wp.quat_rotate_inv(wp.normalize(double), vector)
