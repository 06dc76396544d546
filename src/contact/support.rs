//! The support mapping of a hull: its vertex farthest along a direction.
//!
//! The only home of SIMD and of `unsafe`. Every version computes
//! `(n.x v.x + n.y v.y) + n.z v.z` without fused operations and takes the
//! lowest index of equals, so that all give the same vertex, to the bit.

#![allow(unsafe_code)]

use glam::DVec3;

use super::ConvexHull;

/// Vertices as columns of a length that is a multiple of [`LANES`]; filled up
/// with copies of the first vertex, which being lower wins every tie with them.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Columns {
    x: Vec<f64>,
    y: Vec<f64>,
    z: Vec<f64>,
}

/// What the widest instructions take at once.
const LANES: usize = 8;

impl Columns {
    pub(crate) fn new(vertices: &[DVec3]) -> Self {
        let filled = vertices.len().next_multiple_of(LANES);
        let column = |coordinate: fn(&DVec3) -> f64| {
            let mut column = Vec::with_capacity(filled);
            column.extend(vertices.iter().map(coordinate));
            column.resize(filled, vertices.first().map_or(0.0, coordinate));
            column
        };
        Self { x: column(|v| v.x), y: column(|v| v.y), z: column(|v| v.z) }
    }

    pub(crate) fn heap_bytes(&self) -> usize {
        (self.x.capacity() + self.y.capacity() + self.z.capacity()) * size_of::<f64>()
    }
}

/// Hulls of more vertices have a coarse level: below, looking at all of them is
/// as fast.
const COARSE_ABOVE: usize = 512;

/// Vertices of the coarse level.
const COARSE: usize = 64;

/// Some vertices of a large hull, far from each other: from the best of them few
/// steps along edges lead to the best of all.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Coarse {
    columns: Columns,
    indices: Vec<u32>,
}

impl Coarse {
    /// Farthest-point sampling, from the first vertex on; none for small hulls.
    pub(crate) fn new(vertices: &[DVec3]) -> Option<Self> {
        if vertices.len() <= COARSE_ABOVE {
            return None;
        }
        let mut nearest = vec![f64::INFINITY; vertices.len()];
        let (mut indices, mut next) = (Vec::with_capacity(COARSE), 0);
        while indices.len() < COARSE {
            indices.push(next as u32);
            let mut farthest = 0;
            for (i, v) in vertices.iter().enumerate() {
                nearest[i] = nearest[i].min(v.distance_squared(vertices[next]));
                if nearest[i] > nearest[farthest] {
                    farthest = i;
                }
            }
            next = farthest;
        }
        let chosen: Vec<DVec3> = indices.iter().map(|&i| vertices[i as usize]).collect();
        Some(Self { columns: Columns::new(&chosen), indices })
    }

    pub(crate) fn heap_bytes(&self) -> usize {
        self.columns.heap_bytes() + self.indices.capacity() * size_of::<u32>()
    }
}

impl ConvexHull {
    /// A vertex with the largest `n . v`, or, of large hulls and to rounding,
    /// perhaps one next to it: a bound needs [`ConvexHull::support`]. `near` is a
    /// vertex that may be near it.
    #[inline]
    pub(crate) fn likely_support(&self, n: DVec3, near: u32) -> u32 {
        let Some(coarse) = &self.coarse else { return self.support(n) };
        let height = |v: u32| n.dot(self.vertices()[v as usize]);
        let sampled = coarse.indices[farthest(&coarse.columns, n) as usize];
        self.climb(n, if height(near) > height(sampled) { near } else { sampled })
    }

    /// Whether [`ConvexHull::likely_support`] is the support.
    pub(crate) fn likely_is_sure(&self) -> bool {
        self.coarse.is_none()
    }

    /// From vertex to better vertex along edges: a vertex better than all its
    /// neighbours is the best of a convex hull. Ends, since each step is strictly
    /// upwards.
    fn climb(&self, n: DVec3, start: u32) -> u32 {
        let height = |v: u32| n.dot(self.vertices()[v as usize]);
        let (mut best, mut highest) = (start, height(start));
        loop {
            let from = best;
            for &v in self.vertex_neighbours(from as usize) {
                let h = height(v);
                if h > highest {
                    (best, highest) = (v, h);
                }
            }
            if best == from {
                return best;
            }
        }
    }

    /// The vertex with the largest `n . v`, the lowest index of equals.
    #[inline]
    pub(crate) fn support(&self, n: DVec3) -> u32 {
        farthest(&self.columns, n)
    }
}

/// By the widest instructions there are.
#[inline]
fn farthest(columns: &Columns, n: DVec3) -> u32 {
    #[cfg(target_arch = "x86_64")]
    {
        if is_x86_feature_detected!("avx512f") {
            // SAFETY: the instructions are there.
            return unsafe { x86::avx512(columns, n) };
        }
        if is_x86_feature_detected!("avx2") {
            // SAFETY: the instructions are there.
            return unsafe { x86::avx2(columns, n) };
        }
    }
    scalar(columns, n)
}

/// The instructions that the support mapping uses on this machine.
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

/// The definition; what every other version must give to the bit.
fn scalar(columns: &Columns, n: DVec3) -> u32 {
    let (mut best, mut largest) = (0, f64::NEG_INFINITY);
    for (i, ((x, y), z)) in columns.x.iter().zip(&columns.y).zip(&columns.z).enumerate() {
        let value = n.x * x + n.y * y + n.z * z;
        if value > largest {
            (best, largest) = (i, value);
        }
    }
    best as u32
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::*;

    use glam::DVec3;

    use super::{Columns, LANES};

    /// Independent searches side by side, since each waits for its own last step.
    const SEARCHES: usize = 4;

    /// Eight vertices at once.
    ///
    /// # Safety
    /// AVX-512F must be there.
    #[target_feature(enable = "avx512f")]
    pub(super) unsafe fn avx512(columns: &Columns, n: DVec3) -> u32 {
        let (nx, ny, nz) = (_mm512_set1_pd(n.x), _mm512_set1_pd(n.y), _mm512_set1_pd(n.z));
        let lanes = _mm512_set_epi64(7, 6, 5, 4, 3, 2, 1, 0);
        let mut best = [_mm512_set1_pd(f64::NEG_INFINITY); SEARCHES];
        let mut found = [_mm512_setzero_si512(); SEARCHES];
        let Columns { x, y, z } = columns;
        let mut look = |search: usize, first: usize| {
            let (x, y, z) = (&x[first..first + LANES], &y[first..first + LANES], &z[first..first + LANES]);
            // SAFETY: each slice is 8 doubles long.
            let (x, y, z) = unsafe {
                (_mm512_loadu_pd(x.as_ptr()), _mm512_loadu_pd(y.as_ptr()), _mm512_loadu_pd(z.as_ptr()))
            };
            let flat = _mm512_add_pd(_mm512_mul_pd(nx, x), _mm512_mul_pd(ny, y));
            let value = _mm512_add_pd(flat, _mm512_mul_pd(nz, z));
            let better = _mm512_cmp_pd_mask::<_CMP_GT_OQ>(value, best[search]);
            best[search] = _mm512_mask_mov_pd(best[search], better, value);
            let index = _mm512_add_epi64(lanes, _mm512_set1_epi64(first as i64));
            found[search] = _mm512_mask_mov_epi64(found[search], better, index);
        };
        let mut first = 0;
        while first + SEARCHES * LANES <= x.len() {
            look(0, first);
            look(1, first + LANES);
            look(2, first + 2 * LANES);
            look(3, first + 3 * LANES);
            first += SEARCHES * LANES;
        }
        while first < x.len() {
            look(0, first);
            first += LANES;
        }
        if x.len() < SEARCHES * LANES {
            let equal =
                _mm512_cmp_pd_mask::<_CMP_EQ_OQ>(best[0], _mm512_set1_pd(_mm512_reduce_max_pd(best[0])));
            return _mm512_mask_reduce_min_epi64(equal, found[0]) as u32;
        }
        let high = _mm512_max_pd(_mm512_max_pd(best[0], best[1]), _mm512_max_pd(best[2], best[3]));
        let largest = _mm512_set1_pd(_mm512_reduce_max_pd(high));
        let lowest = |search: usize| {
            let equal = _mm512_cmp_pd_mask::<_CMP_EQ_OQ>(best[search], largest);
            _mm512_mask_mov_epi64(_mm512_set1_epi64(i64::MAX), equal, found[search])
        };
        let low =
            _mm512_min_epi64(_mm512_min_epi64(lowest(0), lowest(1)), _mm512_min_epi64(lowest(2), lowest(3)));
        _mm512_reduce_min_epi64(low) as u32
    }

    /// Four vertices at once.
    ///
    /// # Safety
    /// AVX2 must be there.
    #[target_feature(enable = "avx2")]
    pub(super) unsafe fn avx2(columns: &Columns, n: DVec3) -> u32 {
        let (nx, ny, nz) = (_mm256_set1_pd(n.x), _mm256_set1_pd(n.y), _mm256_set1_pd(n.z));
        let mut best = _mm256_set1_pd(f64::NEG_INFINITY);
        let mut found = _mm256_setzero_si256();
        let mut index = _mm256_set_epi64x(3, 2, 1, 0);
        let step = _mm256_set1_epi64x(4);
        let chunks = columns.x.chunks_exact(4).zip(columns.y.chunks_exact(4)).zip(columns.z.chunks_exact(4));
        for ((x, y), z) in chunks {
            // SAFETY: each chunk is 4 doubles long.
            let (x, y, z) = unsafe {
                (_mm256_loadu_pd(x.as_ptr()), _mm256_loadu_pd(y.as_ptr()), _mm256_loadu_pd(z.as_ptr()))
            };
            let flat = _mm256_add_pd(_mm256_mul_pd(nx, x), _mm256_mul_pd(ny, y));
            let value = _mm256_add_pd(flat, _mm256_mul_pd(nz, z));
            let better = _mm256_cmp_pd::<_CMP_GT_OQ>(value, best);
            best = _mm256_blendv_pd(best, value, better);
            found = _mm256_blendv_epi8(found, index, _mm256_castpd_si256(better));
            index = _mm256_add_epi64(index, step);
        }
        let (mut values, mut indices) = ([0.0; 4], [0_i64; 4]);
        // SAFETY: both arrays are 4 elements of 8 bytes long.
        unsafe {
            _mm256_storeu_pd(values.as_mut_ptr(), best);
            _mm256_storeu_si256(indices.as_mut_ptr().cast(), found);
        }
        // Without branches: which lane is best is anyone's guess.
        let largest = values.iter().fold(f64::NEG_INFINITY, |a, &b| if b > a { b } else { a });
        let lane = |i: usize| if values[i] == largest { indices[i] } else { i64::MAX };
        lane(0).min(lane(1)).min(lane(2).min(lane(3))) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A version that breaks ties otherwise, fuses operations or reads past the
    /// end would differ here: integer coordinates tie all the time.
    #[test]
    fn every_version_gives_the_same_vertex() {
        let mut state = 1_u64;
        let mut next = |limit: u64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) % limit
        };
        let mut compared = 0;
        for count in 1..70 {
            for round in 0..50 {
                let fine = if round % 2 == 0 { 1.0 } else { 0.1 };
                let mut vector = || DVec3::from_array([0; 3].map(|_| fine * (next(7) as f64 - 3.0)));
                let vertices: Vec<DVec3> = (0..count).map(|_| vector()).collect();
                let (columns, n) = (Columns::new(&vertices), vector());
                let expected = scalar(&columns, n);
                assert!((expected as usize) < count);
                #[cfg(target_arch = "x86_64")]
                {
                    if is_x86_feature_detected!("avx512f") {
                        // SAFETY: the instructions are there.
                        assert_eq!(unsafe { x86::avx512(&columns, n) }, expected);
                    }
                    if is_x86_feature_detected!("avx2") {
                        // SAFETY: the instructions are there.
                        assert_eq!(unsafe { x86::avx2(&columns, n) }, expected);
                    }
                }
                compared += 1;
            }
        }
        assert_eq!(compared, 69 * 50);
    }
}
