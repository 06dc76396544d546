//! Seeded shapes and poses, shared by the tests of the geometry.
#![allow(dead_code)]

use hullcast_contact::{Body, ConvexHull, Pose};

/// SplitMix64 (Steele, Lea and Flood, "Fast splittable pseudorandom number generators", 2014).
pub struct Random(pub u64);

impl Random {
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in [low, high).
    pub fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn below(&mut self, n: usize) -> usize {
        (self.bits() % n as u64) as usize
    }

    /// Uniform on the unit sphere.
    pub fn direction(&mut self) -> [f64; 3] {
        let z = self.range(-1.0, 1.0);
        let (sin, cos) = self.range(0.0, std::f64::consts::TAU).sin_cos();
        let flat = (1.0 - z * z).sqrt();
        [flat * cos, flat * sin, z]
    }

    /// A uniform random rotation: a unit quaternion x, y, z, w.
    pub fn rotation(&mut self) -> [f64; 4] {
        let (u, v, w) = (self.range(0.0, 1.0), self.range(0.0, 1.0), self.range(0.0, 1.0));
        let (s1, c1) = (std::f64::consts::TAU * v).sin_cos();
        let (s2, c2) = (std::f64::consts::TAU * w).sin_cos();
        let (a, b) = ((1.0 - u).sqrt(), u.sqrt());
        [a * s1, a * c1, b * s2, b * c2]
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
