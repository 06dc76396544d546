//! Recognises hulls that are boxes about their contraction point.

use glam::{DMat3, DVec3};

use super::{ConvexHull, Face};
use crate::tolerance::{BOX_CORNER, LENGTH_ABOVE, OFF_BOX, U};

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
        // The order of the faces is arbitrary. A box along the axes of its frame takes these axes.
        let along = |m: DVec3| m.abs().max_element() == 1.0;
        let axes = if along(x) && along(y) { DMat3::IDENTITY } else { DMat3::from_cols(x, y, x.cross(y)) };
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

/// A box along the axes of its hull's frame, in the form that [`lanes`](crate::lanes) read: the numbers
/// in one cache line, and the names in the next.
#[derive(Clone, Debug, PartialEq)]
#[repr(align(64))]
pub(crate) struct BoxRow {
    /// Half extents in hull units; the centre in the hull frame, the scale, and the distance of the
    /// centre from the origin of the frame, in the caller's units.
    numbers: [f64; 8],
    /// The vertex in each [`octant`], as registered.
    pub(crate) vertices: [u32; 8],
    /// The face along each axis: at `2 i` the one with the negative normal, and at `2 i + 1` the other.
    pub(crate) faces: [u32; 6],
}

impl BoxRow {
    /// The row of a hull. `None` if the hull is not a box along its frame's axes, or if a corner is
    /// farther than [`OFF_BOX`] roundoffs of the circumradius from the box's.
    pub(super) fn of(hull: &ConvexHull) -> Option<Self> {
        let shape = hull.box_shape()?;
        let half = shape.half;
        let off = |v: &DVec3| (v.abs() - half).length() * LENGTH_ABOVE;
        let is_near = hull.vertices().iter().all(|v| off(v) <= OFF_BOX * U * hull.unit_circumradius());
        if shape.axes != DMat3::IDENTITY || !is_near {
            return None;
        }
        let centre = hull.contraction_point();
        let mut faces = [u32::MAX; 6];
        for (face, f) in hull.faces().iter().zip(0..) {
            let axis = [0, 1, 2].into_iter().find(|&i| face.normal[i].abs() == 1.0)?;
            faces[2 * axis + usize::from(face.normal[axis] > 0.0)] = f;
        }
        let vertices = shape.corners.map(|v| hull.registered_indices()[v as usize]);
        let numbers =
            [half.x, half.y, half.z, centre.x, centre.y, centre.z, hull.scale(), hull.contraction_distance()];
        (!faces.contains(&u32::MAX)).then_some(Self { numbers, vertices, faces })
    }

    /// How far a corner of the hull may be from the box's, caller's units.
    pub(crate) fn off_box(&self) -> f64 {
        let [x, y, z, _, _, _, scale, _] = self.numbers;
        OFF_BOX * U * LENGTH_ABOVE * DVec3::new(x, y, z).length() * scale
    }

    /// Half extents, centre, scale, distance of the centre.
    pub(crate) fn numbers(&self) -> &[f64; 8] {
        &self.numbers
    }
}

/// The octant of `v`, from 0 to 7: bit `i` is set if coordinate `i` is positive.
pub(crate) fn octant(v: DVec3) -> usize {
    usize::from(v.x > 0.0) | usize::from(v.y > 0.0) << 1 | usize::from(v.z > 0.0) << 2
}
