//! Recognises hulls that are boxes about their contraction point.

use glam::{DMat3, DVec3};

use super::Face;
use crate::tolerance::BOX_CORNER;

/// A box about the contraction point, in hull units.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct BoxShape {
    /// The unit axes of the box in the hull frame, as columns.
    pub(crate) axes: DMat3,
    /// The half extents along the axes.
    pub(crate) half: DVec3,
    /// The vertex in each [`octant`] of the box's axes.
    corners: [u32; 8],
}

impl BoxShape {
    /// The box that these vertices and faces form, or `None` if they form no box.
    pub(crate) fn recognise(vertices: &[DVec3], faces: &[Face]) -> Option<Self> {
        if vertices.len() != 8 || faces.len() != 6 {
            return None;
        }
        let x = faces[0].normal;
        let across = |m: &DVec3| m.dot(x).abs() < 0.5;
        let y = faces.iter().map(|face| face.normal).find(across)?;
        let axes = DMat3::from_cols(x, y, x.cross(y));
        let own: Vec<DVec3> = vertices.iter().map(|v| axes.transpose() * *v).collect();
        let half = own.iter().fold(DVec3::ZERO, |half, v| half.max(v.abs()));
        let error = BOX_CORNER * half.length();
        let mut corners = [u32::MAX; 8];
        for (v, i) in own.iter().zip(0..) {
            if (v.abs() - half).abs().max_element() > error {
                return None;
            }
            corners[octant(*v)] = i;
        }
        (!corners.contains(&u32::MAX)).then_some(Self { axes, half, corners })
    }

    /// The vertex in an [`octant`].
    pub(crate) fn corner(&self, octant: usize) -> u32 {
        self.corners[octant]
    }
}

/// The octant of `v`, from 0 to 7: bit `i` is set if coordinate `i` is positive.
pub(crate) fn octant(v: DVec3) -> usize {
    usize::from(v.x > 0.0) | usize::from(v.y > 0.0) << 1 | usize::from(v.z > 0.0) << 2
}
