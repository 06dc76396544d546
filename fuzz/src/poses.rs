//! Poses of two hulls: arbitrary, at a growth scale, face on face, or point on point.

use glam::{DMat3, DQuat, DVec3};
use hullcast_contact::{Body, ConvexHull, Pose, Query, Workspace, contact_manifold};

use crate::bytes::ByteSource;

/// The positions and rotations of both hulls.
#[derive(Clone, Debug)]
pub struct PosePair {
    pub positions: [[f64; 3]; 2],
    pub rotations: [[f64; 4]; 2],
}

impl PosePair {
    pub fn bodies<'h>(&self, hulls: [&'h ConvexHull; 2]) -> [Body<'h>; 2] {
        let pose = |side: usize| Pose::new(self.positions[side], self.rotations[side]).expect("a pose");
        [0, 1].map(|side| Body::new(hulls[side], pose(side)))
    }

    /// The pose of B whose contraction point is `d` from A's.
    fn at(hulls: [&ConvexHull; 2], rotations: [[f64; 4]; 2], d: DVec3) -> Self {
        let [a, b] = [0, 1].map(|side| turned(rotations[side]) * hulls[side].contraction_point());
        Self { positions: [[0.0; 3], (d - b + a).to_array()], rotations }
    }
}

fn turned([x, y, z, w]: [f64; 4]) -> DMat3 {
    DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize())
}

impl ByteSource<'_> {
    pub(crate) fn poses(&mut self, hulls: [&ConvexHull; 2]) -> PosePair {
        let size: f64 = hulls.iter().map(|hull| hull.circumradius()).sum();
        let mut poses = match self.below(8) {
            0 => PosePair {
                positions: [self.point(), self.point()],
                rotations: [self.rotation(), self.rotation()],
            },
            1 => {
                let rotations = [self.rotation(), self.rotation()];
                let share = self.share() * self.one_of(&[1.0, 1.0, 2.0, 1e-3, 1e-16, 1e-100, 1e9]);
                PosePair::at(hulls, rotations, share * size * self.direction())
            }
            2 | 3 => self.at_a_growth_scale(hulls, size),
            4..=6 => self.face_on_face(hulls, size),
            _ => self.point_on_point(hulls, size),
        };
        if self.below(4) == 0 {
            let by = size.min(1e40) * 10f64.powi(i32::from(self.below(13)));
            let off = (by * self.direction()).to_array();
            for position in &mut poses.positions {
                *position = std::array::from_fn(|k| position[k] + off[k]);
            }
        }
        // The handlers refuse a pose that is out of range, so the geometry never sees such a coordinate. It
        // becomes 0 here.
        for x in poses.positions.iter_mut().flatten() {
            *x = if x.abs() <= 1e100 { *x } else { 0.0 };
        }
        poses
    }

    fn at_a_growth_scale(&mut self, hulls: [&ConvexHull; 2], size: f64) -> PosePair {
        let (rotations, direction) = ([self.rotation(), self.rotation()], self.direction());
        let far = PosePair::at(hulls, rotations, size * direction);
        let [a, b] = far.bodies(hulls);
        let query = Query { margin: f64::INFINITY, ..Query::default() };
        let alpha = contact_manifold(&a, &b, &query, None, &mut Workspace::default()).alpha;
        let wanted = match self.below(4) {
            0 => self.share() * 2.0,
            1 => self.nudged(1.0),
            _ => 1.0 + self.little(),
        };
        PosePair::at(hulls, rotations, size * wanted / alpha.max(f64::MIN_POSITIVE) * direction)
    }

    /// A corner of a face, the middle of an edge or of the face, or a point inside; and the face's
    /// normal.
    fn spot(&mut self, hull: &ConvexHull) -> (DVec3, DVec3) {
        let face = usize::from(self.byte()) % hull.face_count();
        let outline = hull.outline(face);
        let corner = |i: usize| hull.vertices()[outline[i % outline.len()] as usize];
        let first = usize::from(self.byte());
        let at = match self.below(4) {
            0 => corner(first),
            1 => corner(first).midpoint(corner(first + 1)),
            2 => (0..outline.len()).map(corner).sum::<DVec3>() / outline.len() as f64,
            _ => corner(first).lerp(corner(first + 2), self.share()),
        };
        (hull.contraction_point() + at * hull.scale(), hull.face_normal(face))
    }

    /// B's face on A's face, tilted, spun and lifted by a small amount or not at all.
    fn face_on_face(&mut self, hulls: [&ConvexHull; 2], size: f64) -> PosePair {
        let [(at_a, normal_a), (at_b, normal_b)] = hulls.map(|hull| self.spot(hull));
        let rotation = self.rotation();
        let normal = turned(rotation) * normal_a;
        let angle = self.one_of(&[0.0, 0.0, 0.25, 0.5, 1.0]) * std::f64::consts::PI + self.little();
        let tilt = self.one_of(&[0.0, 0.0, 0.01]) + self.little();
        let (axis, _) = normal.any_orthonormal_pair();
        let other = DQuat::from_axis_angle(axis, tilt)
            * DQuat::from_axis_angle(normal, angle)
            * DQuat::from_rotation_arc(normal_b, -normal);
        let lift = size * self.little() * self.one_of(&[1.0, 1.0, 0.1]);
        let other = other.normalize().to_array();
        let position = turned(rotation) * at_a + lift * normal - turned(other) * at_b;
        PosePair { positions: [[0.0; 3], position.to_array()], rotations: [rotation, other] }
    }

    /// Places a spot of B at a spot of A, or near it.
    fn point_on_point(&mut self, hulls: [&ConvexHull; 2], size: f64) -> PosePair {
        let [(at_a, _), (at_b, _)] = hulls.map(|hull| self.spot(hull));
        let rotations = [self.rotation(), self.rotation()];
        let off = size * self.little() * self.direction();
        let position = turned(rotations[0]) * at_a + off - turned(rotations[1]) * at_b;
        PosePair { positions: [[0.0; 3], position.to_array()], rotations }
    }
}
