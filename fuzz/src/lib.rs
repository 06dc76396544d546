//! Numbers and points from a fuzzer's bytes, near what breaks geometry: a small
//! grid, off it by ulps, powers of two, and any bits at all.

#[cfg(feature = "service")]
pub mod seeds;

use hullcast::contact::{Accuracy, ConvexHull, HullError, HullOptions, InvalidPose, Pose, Query, Wanted};
use libfuzzer_sys::arbitrary::{self, Arbitrary, Unstructured};

/// Iterations that no pair needs.
pub const UNLIMITED: u32 = 1000;

/// Points of a hull.
#[derive(Debug)]
pub struct Cloud(pub Vec<[f64; 3]>);

/// Two hulls somewhere, and what is asked of them.
#[derive(Debug)]
pub struct Scene {
    pub points: [Vec<[f64; 3]>; 2],
    pub contraction_points: [Option<[f64; 3]>; 2],
    pub positions: [[f64; 3]; 2],
    pub rotations: [[f64; 4]; 2],
    /// Of either solver.
    pub query: Query,
    /// What a client may send as a warm start, registered vertices or not.
    pub odd_warm_start: [u32; 6],
}

impl Scene {
    pub fn hull(&self, side: usize) -> Result<ConvexHull, HullError> {
        let contraction_point = self.contraction_points[side];
        let options = HullOptions { contraction_point, ..HullOptions::default() };
        ConvexHull::with_options(&self.points[side], &options)
    }

    pub fn pose(&self, side: usize) -> Result<Pose, InvalidPose> {
        Pose::new(self.positions[side], self.rotations[side])
    }
}

impl<'a> Arbitrary<'a> for Cloud {
    fn arbitrary(u: &mut Unstructured<'a>) -> arbitrary::Result<Self> {
        Ok(Self(Bytes::all(u)?.points(64)))
    }
}

impl<'a> Arbitrary<'a> for Scene {
    fn arbitrary(u: &mut Unstructured<'a>) -> arbitrary::Result<Self> {
        let bytes = &mut Bytes::all(u)?;
        let query = bytes.query();
        let [a, b] = [(); 2].map(|()| {
            let contraction_point = (bytes.below(4) == 0).then(|| bytes.point());
            (contraction_point, bytes.points(24))
        });
        let [(at_a, turned_a), (at_b, turned_b)] = [(); 2].map(|()| (bytes.point(), bytes.rotation()));
        Ok(Self {
            points: [a.1, b.1],
            contraction_points: [a.0, b.0],
            positions: [at_a, at_b],
            rotations: [turned_a, turned_b],
            query,
            odd_warm_start: [(); 6].map(|()| u32::from(bytes.byte()) * 0x0101_0101 % 29),
        })
    }
}

/// Reads a fuzzer's bytes; zeros once they end.
struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn all(u: &mut Unstructured<'a>) -> arbitrary::Result<Self> {
        Ok(Self(u.bytes(u.len())?))
    }

    fn byte(&mut self) -> u8 {
        let (first, rest) = self.0.split_first().map_or((0, self.0), |(&first, rest)| (first, rest));
        self.0 = rest;
        first
    }

    fn below(&mut self, limit: u8) -> u8 {
        self.byte() % limit
    }

    fn bits(&mut self) -> u64 {
        (0..8).fold(0, |bits, _| bits << 8 | u64::from(self.byte()))
    }

    /// A coordinate: most are grid values of about 1.
    fn coordinate(&mut self) -> f64 {
        match self.below(8) {
            0..=3 => f64::from(self.byte() as i8) / 32.0,
            4 | 5 => {
                let grid = f64::from(self.byte() as i8) / 32.0;
                f64::from_bits(grid.to_bits().wrapping_add_signed(i64::from(self.byte() as i8)))
            }
            6 => f64::from(self.byte() as i8) * 2f64.powi(i32::from(self.byte() as i8) / 2),
            _ => f64::from_bits(self.bits()),
        }
    }

    fn point(&mut self) -> [f64; 3] {
        std::array::from_fn(|_| self.coordinate())
    }

    /// Points of a hull: some are made of earlier ones, so that they are equal,
    /// on a line or in a plane to rounding.
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

    /// A quaternion: of the cube's turns, near them, or any.
    fn rotation(&mut self) -> [f64; 4] {
        let half = 0.5f64.sqrt();
        let turns =
            [[0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0], [0.5, 0.5, 0.5, 0.5], [half, 0.0, 0.0, half]];
        let kind = self.below(8);
        if kind < 4 {
            return turns[usize::from(kind)];
        }
        let q: [f64; 4] = if kind < 6 {
            let near = turns[usize::from(self.below(4))];
            std::array::from_fn(|k| {
                near[k] + f64::from(self.byte() as i8) * 2f64.powi(-60 + i32::from(kind) * 4)
            })
        } else {
            std::array::from_fn(|_| f64::from(self.byte() as i8))
        };
        let length = q.iter().map(|x| x * x).sum::<f64>().sqrt();
        q.map(|x| x / length)
    }

    fn query(&mut self) -> Query {
        let mut of = |values: &[f64]| values[usize::from(self.below(values.len() as u8))];
        let margin = of(&[0.0, f64::INFINITY, 1e-9, 0.01, 1.0]);
        let relative_tolerance = of(&[0.0, 0.0, 0.0, 1e-9, 1e-3, 1.0]);
        let feature_angle = of(&[0.01, 0.01, 0.0, 0.5]);
        let accuracy = Accuracy {
            relative_tolerance,
            feature_angle,
            max_points: [0, 0, 1, 4][usize::from(self.below(4))],
            max_iterations: [UNLIMITED, UNLIMITED, 1, 5][usize::from(self.below(4))],
            ..Accuracy::default()
        };
        let wanted = [Wanted::Points, Wanted::Points, Wanted::Growth, Wanted::Outcome];
        Query { margin, accuracy, wanted: wanted[usize::from(self.below(4))] }
    }
}
