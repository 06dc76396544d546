//! Points of hulls: families of shapes, and changes that bring them near degeneracy.

use glam::{DQuat, DVec3};
use hullcast_contact::{ConvexHull, HullOptions};

use crate::bytes::ByteSource;

/// Points and their hull.
pub(crate) struct Shape {
    pub(crate) points: Vec<[f64; 3]>,
    pub(crate) contraction_point: Option<[f64; 3]>,
    pub(crate) hull: ConvexHull,
}

impl Shape {
    /// None if the builder refuses the points. The refusal must not be an internal error.
    pub(crate) fn new(points: Vec<[f64; 3]>, contraction_point: Option<[f64; 3]>) -> Option<Self> {
        let options = HullOptions { contraction_point, ..HullOptions::default() };
        match ConvexHull::with_options(&points, &options) {
            Ok(hull) => Some(Self { points, contraction_point, hull }),
            Err(error) => {
                assert!(!error.detail.contains("internal"), "{error}");
                None
            }
        }
    }
}

impl ByteSource<'_> {
    /// The hull of the first of several point sets that has one.
    pub(crate) fn shape(&mut self, most: u8) -> Shape {
        let points = self.cloud(most);
        let contraction_point = match self.below(8) {
            0 => Some(self.point()),
            1 | 2 => Some(self.between(&points)),
            _ => None,
        };
        Shape::new(points.clone(), contraction_point)
            .or_else(|| Shape::new(points.clone(), None))
            .or_else(|| Shape::new(boxed(points), None))
            .or_else(|| Shape::new(self.family(most), None))
            .unwrap_or_else(|| Shape::new(cuboid([1.0; 3]), None).expect("a cube"))
    }

    /// Points, which may or may not have a hull.
    pub(crate) fn cloud(&mut self, most: u8) -> Vec<[f64; 3]> {
        let mut points = if self.below(4) == 0 { self.points(most) } else { self.family(most) };
        let [which, also] = [self.byte(), self.byte()];
        let changes = which & also;
        if changes & 1 != 0 {
            let by = [(); 3].map(|()| 10f64.powf(-f64::from(self.byte()) / 24.0));
            self.each(&mut points, |p| std::array::from_fn(|k| p[k] * by[k]));
        }
        if changes & 2 != 0 {
            let [x, y, z, w] = self.rotation();
            let turn = DQuat::from_xyzw(x, y, z, w);
            self.each(&mut points, |p| (turn * DVec3::from_array(p)).to_array());
        }
        if changes & 4 != 0 {
            self.dotted(&mut points, most);
        }
        if changes & 8 != 0 {
            for p in &mut points {
                if self.below(3) == 0 {
                    *p = p.map(|x| self.nudged(x));
                }
            }
        }
        if changes & 16 != 0 {
            let (by, off) = (10f64.powi(-i32::from(self.below(17))), self.direction());
            for i in 0..points.len().min(usize::from(most) / 2) {
                points.push((DVec3::from_array(points[i]) + by * self.share() * off).to_array());
            }
        }
        if changes & 32 != 0 {
            let off = self.point();
            self.each(&mut points, |p| std::array::from_fn(|k| p[k] + off[k]));
        }
        if changes & 64 != 0 {
            let by = match self.below(4) {
                0 => 10f64.powi(i32::from(self.byte() as i8) / 3),
                1 => self.coordinate(),
                _ => 10f64.powf(self.grid()),
            };
            self.each(&mut points, |p| p.map(|x| x * by));
        }
        points
    }

    fn each(&self, points: &mut [[f64; 3]], change: impl Fn([f64; 3]) -> [f64; 3]) {
        points.iter_mut().for_each(|p| *p = change(*p));
    }

    /// A shape of about unit size, about the origin.
    fn family(&mut self, most: u8) -> Vec<[f64; 3]> {
        let count = 4 + usize::from(self.below(most - 3));
        match self.below(7) {
            0 => cuboid([(); 3].map(|()| self.share())),
            1 => {
                let half = [(); 3].map(|()| self.one_of(&[0.25, 0.5, 1.0, 2.0, 3.0, 1e-3]));
                cuboid(half)
            }
            // A prism, a frustum, or a needle if its tip is far away.
            2 | 3 => {
                let sides = (count / 2).max(3);
                let (radius, top) = (self.share(), self.one_of(&[1.0, 1.0, 0.5, 1e-3, 0.0]));
                let height = self.share() * self.one_of(&[1.0, 1.0, 1e-3, 1e3, 1e9]);
                let ring = |by: f64, z: f64| {
                    (0..sides).map(move |i| {
                        let angle = std::f64::consts::TAU * i as f64 / sides as f64;
                        [by * angle.cos(), by * angle.sin(), z]
                    })
                };
                ring(radius, -height).chain(ring(top * radius, height)).collect()
            }
            4 => (0..count).map(|_| self.direction().to_array()).collect(),
            5 => (0..count).map(|_| [(); 3].map(|()| f64::from(self.below(5)) / 2.0 - 1.0)).collect(),
            _ => (0..count).map(|_| [(); 3].map(|()| self.grid())).collect(),
        }
    }

    /// Adds points in faces, on edges and beside them.
    fn dotted(&mut self, points: &mut Vec<[f64; 3]>, most: u8) {
        let corners = points.len();
        for _ in 0..self.below(most) {
            let [p, q, r] = [(); 3].map(|()| points[usize::from(self.byte()) % corners]);
            let (s, t) = (self.one_of(&[0.0, 0.25, 0.5, 1.0]), self.share());
            let off = self.little();
            points.push(std::array::from_fn(|k| {
                p[k] + s * (q[k] - p[k]) + (1.0 - s) * t * (r[k] - p[k]) + off * [0.3, -0.5, 0.8][k]
            }));
        }
    }

    /// A point between some of the points, often near one of them or almost outside.
    fn between(&mut self, points: &[[f64; 3]]) -> [f64; 3] {
        let [p, q, r, s] = [(); 4].map(|()| points[usize::from(self.byte()) % points.len()]);
        let weights = [self.share(), self.share(), self.share(), self.little().abs()];
        let sum: f64 = weights.iter().sum();
        let part = |k: usize| weights.iter().zip([p, q, r, s]).map(|(w, v)| w / sum * v[k]).sum();
        std::array::from_fn(part)
    }

    /// Points of any kind. Some are made from earlier ones, so that they are equal, on a line or in
    /// a plane, to rounding.
    fn points(&mut self, most: u8) -> Vec<[f64; 3]> {
        let mut points: Vec<[f64; 3]> = Vec::new();
        for _ in 0..4 + self.below(most - 3) {
            let old = |bytes: &mut Self| points[usize::from(bytes.byte()) % points.len()];
            let point = match self.below(6) {
                0 if !points.is_empty() => old(self),
                1 if !points.is_empty() => {
                    let [p, q, share] = [old(self), old(self), [f64::from(self.byte()) / 16.0 - 4.0; 3]];
                    std::array::from_fn(|k| p[k] + share[k] * (q[k] - p[k]))
                }
                2 if !points.is_empty() => {
                    let [p, q, r] = [old(self), old(self), old(self)];
                    std::array::from_fn(|k| p[k] + (q[k] - r[k]))
                }
                _ => self.point(),
            };
            points.push(point);
        }
        points
    }
}

fn cuboid([x, y, z]: [f64; 3]) -> Vec<[f64; 3]> {
    let side = |i: usize, k: usize, half: f64| if i >> k & 1 == 0 { -half } else { half };
    (0..8).map(|i| [side(i, 0, x), side(i, 1, y), side(i, 2, z)]).collect()
}

/// The points whose coordinates are in the accepted range, and four corners of a box around them,
/// so that they are not flat.
fn boxed(points: Vec<[f64; 3]>) -> Vec<[f64; 3]> {
    let mut points = points;
    points.retain(|p| p.iter().all(|x| x.abs() < 1e40));
    let size = points.iter().flatten().fold(1e-40f64, |size, x| size.max(x.abs()));
    points.extend([[size, size, -size], [-size, size, size], [size, -size, size], [-size; 3]]);
    points
}
