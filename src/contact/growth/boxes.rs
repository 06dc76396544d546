//! Two boxes: the growth scale in closed form over the 15 separating axes
//! (Gottschalk, Lin and Manocha, *OBBTree*, 1996, for the axes).
//!
//! What is returned is no answer but a triple of vertices of `K` to start from:
//! the triangle of the winning axis' facet that the ray crosses. The portal
//! certifies it, usually in one step, and goes on where rounding or a tie named
//! the wrong facet.

use glam::{DMat3, DVec3};

use crate::contact::hull::BoxShape;
use crate::contact::pair::{Pair, Support};

/// Both boxes in A's axes.
struct Boxes<'a> {
    pair: &'a Pair<'a>,
    a: &'a BoxShape,
    b: &'a BoxShape,
    /// Half extents, pair units.
    half_a: DVec3,
    half_b: DVec3,
    /// B's axes in A's, as columns.
    axes: DMat3,
    ray: DVec3,
}

#[derive(Clone, Copy)]
enum Kind {
    FaceOfA(usize),
    FaceOfB(usize),
    Edges(usize, usize),
}

/// Where to start for two boxes; none for other hulls.
pub(crate) fn seeds(pair: &Pair<'_>) -> Option<[Support; 3]> {
    let (a, b) = (pair.a.box_shape()?, pair.b.box_shape()?);
    let boxes = Boxes {
        pair,
        a,
        b,
        half_a: a.half * pair.scale_a,
        half_b: b.half * pair.scale_b,
        axes: a.axes.transpose() * (pair.rotation * b.axes),
        ray: a.axes.transpose() * pair.ray,
    };
    let (scale, kind) = boxes.best_axis();
    let crossed = boxes.ray / scale;
    Some(match kind {
        Kind::FaceOfA(i) => boxes.face_of_a(i, crossed),
        Kind::FaceOfB(j) => boxes.face_of_b(j, crossed),
        Kind::Edges(i, j) => boxes.edges(i, j, crossed),
    })
}

impl Boxes<'_> {
    /// The largest growth scale of an axis, and the axis.
    fn best_axis(&self) -> (f64, Kind) {
        let (c, t) = (&self.axes, self.ray);
        let size = [c.x_axis.abs(), c.y_axis.abs(), c.z_axis.abs()];
        let mut scales = [0.0; 15];
        for i in 0..3 {
            let across: f64 = (0..3).map(|j| self.half_b[j] * size[j][i]).sum();
            scales[i] = t[i].abs() / (self.half_a[i] + across);
            scales[3 + i] = c.col(i).dot(t).abs() / (self.half_b[i] + self.half_a.dot(size[i]));
        }
        for i in 0..3 {
            let (i1, i2) = ((i + 1) % 3, (i + 2) % 3);
            for j in 0..3 {
                let (j1, j2) = ((j + 1) % 3, (j + 2) % 3);
                let reach = (t[i2] * c.col(j)[i1] - t[i1] * c.col(j)[i2]).abs();
                let width = self.half_a[i1] * size[j][i2]
                    + self.half_a[i2] * size[j][i1]
                    + self.half_b[j1] * size[j2][i]
                    + self.half_b[j2] * size[j1][i];
                scales[6 + 3 * i + j] = reach / width;
            }
        }
        // Without branches: which is largest is anyone's guess. Parallel edges
        // have no axis, their scale (0 / 0) is no number and never larger.
        let (mut best, mut largest) = (0, scales[0]);
        for (k, &scale) in scales.iter().enumerate() {
            let better = scale > largest;
            best = if better { k } else { best };
            largest = if better { scale } else { largest };
        }
        let kind = match best {
            0..3 => Kind::FaceOfA(best),
            3..6 => Kind::FaceOfB(best - 3),
            _ => Kind::Edges((best - 6) / 3, (best - 6) % 3),
        };
        (largest, kind)
    }

    /// A's face `i` against the corner of B farthest into it.
    fn face_of_a(&self, i: usize, crossed: DVec3) -> [Support; 3] {
        let n = DVec3::AXES[i] * self.ray[i].signum();
        let b = self.b_signs(-n);
        let on_face = (crossed + self.axes * (b * self.half_b)) / self.half_a;
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        triangle(on_face[j], on_face[k]).map(|(x, y)| {
            let mut a = n;
            (a[j], a[k]) = (x, y);
            self.corner(a, b)
        })
    }

    /// B's face `j` against the corner of A farthest into it.
    fn face_of_b(&self, j: usize, crossed: DVec3) -> [Support; 3] {
        let towards = self.axes.col(j).dot(self.ray).signum();
        let a = signs(self.axes.col(j) * towards);
        let on_face = (self.axes.transpose() * (a * self.half_a - crossed)) / self.half_b;
        let (k, l) = ((j + 1) % 3, (j + 2) % 3);
        triangle(on_face[k], on_face[l]).map(|(x, y)| {
            let mut b = DVec3::ZERO;
            (b[j], b[k], b[l]) = (-towards, x, y);
            self.corner(a, b)
        })
    }

    /// A's edge along `i` against B's along `j`.
    fn edges(&self, i: usize, j: usize, crossed: DVec3) -> [Support; 3] {
        let (along_a, along_b) = (DVec3::AXES[i], self.axes.col(j));
        let across = along_a.cross(along_b);
        let n = across * across.dot(self.ray).signum();
        let (mut a, mut b) = (signs(n), self.b_signs(-n));
        (a[i], b[j]) = (0.0, 0.0);
        // crossed = (a + x along_a) - (b + y along_b), in the plane across n.
        let rest = crossed - a * self.half_a + self.axes * (b * self.half_b);
        let (past_b, past_a) = (along_b.cross(n), along_a.cross(n));
        let x = rest.dot(past_b) / (self.half_a[i] * along_a.dot(past_b));
        let y = -rest.dot(past_a) / (self.half_b[j] * along_b.dot(past_a));
        triangle(x, y).map(|(x, y)| {
            (a[i], b[j]) = (x, y);
            self.corner(a, b)
        })
    }

    /// Signs, in B's axes, of the corner of B farthest along `n`.
    fn b_signs(&self, n: DVec3) -> DVec3 {
        signs(self.axes.transpose() * n)
    }

    fn corner(&self, a: DVec3, b: DVec3) -> Support {
        self.pair.support_of(self.a.corner(a), self.b.corner(b))
    }
}

fn signs(v: DVec3) -> DVec3 {
    DVec3::new(v.x.signum(), v.y.signum(), v.z.signum())
}

/// Of the square from -1 to 1 the corners of the half that holds a point.
fn triangle(x: f64, y: f64) -> [(f64, f64); 3] {
    let third = if x > y { (1.0, -1.0) } else { (-1.0, 1.0) };
    [(-1.0, -1.0), third, (1.0, 1.0)]
}
