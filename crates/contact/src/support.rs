//! The support mapping of a set of vertices: the vertex that is farthest along a direction.
//!
//! A hull of up to 256 vertices scans all of them; the coordinates are stored by column so that
//! SIMD instructions evaluate up to eight vertices at once. A larger hull has a map of directions
//! ([`SupportMap`]), which leaves a few candidates to compare.
//!
//! Every version computes `(n.x v.x + n.y v.y) + n.z v.z` without fused multiply-add, and takes the
//! lowest index if several vertices tie. So all versions return the same vertex on every machine.
//! The function [`scalar`] is the definition. This module and `lanes::simd` are the only ones with SIMD and `unsafe`.

#![allow(unsafe_code)]

mod columns;
mod map;
#[cfg(target_arch = "x86_64")]
mod x86;

use columns::LANES;
use glam::DVec3;

pub(crate) use columns::Columns;
pub(crate) use map::SupportMap;

/// The vertex farthest along `n`, by a scan with the widest instructions that the CPU has.
#[inline]
pub(crate) fn farthest(columns: &Columns, n: DVec3) -> u32 {
    #[cfg(target_arch = "x86_64")]
    {
        if is_x86_feature_detected!("avx512f") {
            // SAFETY: the check above shows that the CPU has these instructions.
            return unsafe { x86::avx512(columns, n.x, n.y, n.z) };
        }
        if is_x86_feature_detected!("avx2") {
            // SAFETY: the check above shows that the CPU has these instructions.
            return unsafe { x86::avx2(columns, n.x, n.y, n.z) };
        }
    }
    scalar(columns, n)
}

/// The vertex of `a` that is farthest along `n`, and the vertex of `b` that is farthest along `-n`.
#[inline]
pub(crate) fn farthest_both(a: &Columns, b: &Columns, n: DVec3) -> (u32, u32) {
    #[cfg(target_arch = "x86_64")]
    {
        if is_x86_feature_detected!("avx512f") {
            // SAFETY: the check above shows that the CPU has these instructions.
            return unsafe { x86::avx512_both(a, b, n.x, n.y, n.z) };
        }
        if is_x86_feature_detected!("avx2") {
            // SAFETY: the check above shows that the CPU has these instructions.
            return unsafe { x86::avx2_both(a, b, n.x, n.y, n.z) };
        }
    }
    (scalar(a, n), scalar(b, -n))
}

/// The name of the instruction set that the support mapping uses on this machine: "avx512", "avx2"
/// or "scalar".
pub fn instruction_set() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    {
        if is_x86_feature_detected!("avx512f") {
            return "avx512";
        }
        if is_x86_feature_detected!("avx2") {
            return "avx2";
        }
    }
    "scalar"
}

/// The definition of the support mapping. Every other version must return the same vertex.
fn scalar(columns: &Columns, n: DVec3) -> u32 {
    let (mut best, mut largest) = (0, f64::NEG_INFINITY);
    for (g, group) in columns.groups().iter().enumerate() {
        for lane in 0..LANES {
            let value = n.x * group.x[lane] + n.y * group.y[lane] + n.z * group.z[lane];
            if value > largest {
                (best, largest) = (g * LANES + lane, value);
            }
        }
    }
    best as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::workload::Random;

    /// Catches a version that breaks ties in another way, fuses operations or reads past the end.
    /// Integer coordinates make ties frequent.
    #[test]
    fn every_version_gives_the_same_vertex() {
        let mut random = Random::new(1);
        let mut compared = 0;
        let mut before = Columns::new(&[DVec3::X]);
        for count in 1..70 {
            for round in 0..50 {
                let fine = if round % 2 == 0 { 1.0 } else { 0.1 };
                let mut vector = || DVec3::from_array([0; 3].map(|_| fine * (random.below(7) as f64 - 3.0)));
                let vertices: Vec<DVec3> = (0..count).map(|_| vector()).collect();
                let (columns, n) = (Columns::new(&vertices), vector());
                let expected = scalar(&columns, n);
                assert!((expected as usize) < count);
                let both = (scalar(&before, n), scalar(&columns, -n));
                #[cfg(target_arch = "x86_64")]
                {
                    if is_x86_feature_detected!("avx512f") {
                        // SAFETY: the check above shows that the CPU has these instructions.
                        assert_eq!(unsafe { x86::avx512(&columns, n.x, n.y, n.z) }, expected);
                        // SAFETY: the check above shows that the CPU has these instructions.
                        assert_eq!(unsafe { x86::avx512_both(&before, &columns, n.x, n.y, n.z) }, both);
                    }
                    if is_x86_feature_detected!("avx2") {
                        // SAFETY: the check above shows that the CPU has these instructions.
                        assert_eq!(unsafe { x86::avx2(&columns, n.x, n.y, n.z) }, expected);
                        // SAFETY: the check above shows that the CPU has these instructions.
                        assert_eq!(unsafe { x86::avx2_both(&before, &columns, n.x, n.y, n.z) }, both);
                    }
                }
                before = columns;
                compared += 1;
            }
        }
        assert_eq!(compared, 69 * 50);
    }
}
