//! The support mapping of a hull: its vertex farthest along a direction.

use glam::DVec3;

use super::ConvexHull;

impl ConvexHull {
    /// The vertex with the largest `n . v`, the lowest index of equals.
    pub(crate) fn support(&self, n: DVec3) -> u32 {
        scalar(self.vertices(), n)
    }
}

/// One product and two sums a vertex, in this order and without fused
/// operations: what every other version must give to the bit.
fn scalar(vertices: &[DVec3], n: DVec3) -> u32 {
    let (mut best, mut largest) = (0, f64::NEG_INFINITY);
    for (i, v) in vertices.iter().enumerate() {
        let value = n.x * v.x + n.y * v.y + n.z * v.z;
        if value > largest {
            (best, largest) = (i, value);
        }
    }
    best as u32
}
