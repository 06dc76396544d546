//! What is known of a face, in one cache line.

use glam::DVec3;

use super::isolation::Isolation;

/// A face, in hull units: about the contraction point, divided by the hull's scale.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(align(64))]
pub struct Face {
    /// Unit, outward.
    pub normal: DVec3,
    /// The largest of normal . v over all vertices.
    pub offset: f64,
    /// Of the outline; squared.
    pub area: f64,
    /// How far below its plane the lowest vertex of its group is, rounded up.
    pub planarity: f64,
    /// How far it stands apart from the others.
    pub(crate) isolation: Isolation,
}

const _: () = assert!(size_of::<Face>() == 64);
