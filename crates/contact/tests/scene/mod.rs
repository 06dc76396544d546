//! Seeded shapes and poses, shared by the tests of the geometry.
#![allow(dead_code)]

use hullcast_contact::{Body, ConvexHull, Pose, workload};

/// The generator of the library, with the draws that the recorded cases were made with.
pub struct Random(workload::Random);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(workload::Random::new(seed))
    }

    pub fn bits(&mut self) -> u64 {
        self.0.bits()
    }

    /// Uniform in [low, high).
    pub fn range(&mut self, low: f64, high: f64) -> f64 {
        self.0.within(low, high)
    }

    /// A number below `n`, by the remainder: the recorded cases depend on it.
    pub fn below(&mut self, n: usize) -> usize {
        (self.bits() % n as u64) as usize
    }

    /// Uniform on the unit sphere.
    pub fn direction(&mut self) -> [f64; 3] {
        self.0.direction().to_array()
    }

    /// A uniform random rotation: a unit quaternion x, y, z, w.
    pub fn rotation(&mut self) -> [f64; 4] {
        self.0.rotation().to_array()
    }
}

pub fn hull(points: &[[f64; 3]]) -> ConvexHull {
    ConvexHull::new(points).expect("a hull")
}

pub fn box_points([x, y, z]: [f64; 3]) -> Vec<[f64; 3]> {
    (0..8)
        .map(|i| {
            [
                if i & 1 == 0 { -x } else { x },
                if i & 2 == 0 { -y } else { y },
                if i & 4 == 0 { -z } else { z },
            ]
        })
        .collect()
}

pub fn box_hull(half: [f64; 3]) -> ConvexHull {
    hull(&box_points(half))
}

/// Random points on an ellipsoid, so that all of them are extreme.
pub fn cloud(random: &mut Random, count: usize, half: [f64; 3]) -> Vec<[f64; 3]> {
    (0..count)
        .map(|_| {
            let d = random.direction();
            [d[0] * half[0], d[1] * half[1], d[2] * half[2]]
        })
        .collect()
}

/// A regular prism whose axis is z.
pub fn prism_points(sides: usize, radius: f64, half_height: f64) -> Vec<[f64; 3]> {
    (0..2 * sides)
        .map(|i| {
            let angle = std::f64::consts::TAU * (i / 2) as f64 / sides as f64;
            [radius * angle.cos(), radius * angle.sin(), if i % 2 == 0 { -half_height } else { half_height }]
        })
        .collect()
}

pub const IDENTITY: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

pub fn at(hull: &ConvexHull, position: [f64; 3], rotation: [f64; 4]) -> Body<'_> {
    Body::new(hull, Pose::new(position, rotation).expect("a pose"))
}

pub fn scaled(v: [f64; 3], by: f64) -> [f64; 3] {
    v.map(|x| x * by)
}
