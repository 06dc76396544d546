//! The data of a face, in one cache line.

use glam::DVec3;

use super::isolation::Isolation;

/// A face in hull units: relative to the contraction point and divided by the scale of the hull.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(align(64))]
pub struct Face {
    /// The outward unit normal, hull frame.
    pub normal: DVec3,
    /// The largest `normal . v` over all vertices `v` of the hull.
    pub offset: f64,
    /// The area of the outline; hull units squared.
    pub area: f64,
    /// How far the lowest vertex of the face is below its plane, rounded up.
    pub planarity: f64,
    /// How far the face stands apart from the rest of the hull.
    pub(crate) isolation: Isolation,
}

const _: () = assert!(size_of::<Face>() == 64);
