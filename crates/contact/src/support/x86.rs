//! The search for the farthest vertex with AVX2 and with AVX-512. The result is bit for bit that of
//! [`scalar`](super::scalar). A direction is passed as three numbers, because a vector would be
//! passed through memory.

#[allow(clippy::wildcard_imports, reason = "some forty intrinsics, whose names say where they are from")]
use std::arch::x86_64::*;

use super::columns::{Columns, Group, LANES};

/// The number of independent searches that run side by side. Each step of a search depends on its
/// previous step, so a single search would wait for latency.
const SEARCHES: usize = 4;

/// The vertex of `a` farthest along `n`, and the vertex of `b` farthest along `-n`. For small hulls
/// the two independent searches overlap in the pipeline.
#[target_feature(enable = "avx512f")]
pub(super) fn avx512_both(a: &Columns, b: &Columns, nx: f64, ny: f64, nz: f64) -> (u32, u32) {
    match (a.groups(), b.groups()) {
        ([a], [b]) => (avx512_few([a], nx, ny, nz), avx512_few([b], -nx, -ny, -nz)),
        ([a0, a1], [b0, b1]) => (avx512_few([a0, a1], nx, ny, nz), avx512_few([b0, b1], -nx, -ny, -nz)),
        _ => (avx512(a, nx, ny, nz), avx512(b, -nx, -ny, -nz)),
    }
}

/// The vertex farthest along `n`, with eight vertices per instruction.
#[target_feature(enable = "avx512f")]
pub(super) fn avx512(columns: &Columns, nx: f64, ny: f64, nz: f64) -> u32 {
    match columns.groups() {
        [g0] => avx512_few([g0], nx, ny, nz),
        [g0, g1] => avx512_few([g0, g1], nx, ny, nz),
        [g0, g1, g2] => avx512_few([g0, g1, g2], nx, ny, nz),
        [g0, g1, g2, g3] => avx512_few([g0, g1, g2, g3], nx, ny, nz),
        groups => avx512_many(groups, nx, ny, nz),
    }
}

/// `n . v` for the vertices of a group.
#[inline]
#[target_feature(enable = "avx512f")]
fn avx512_values(group: &Group, nx: __m512d, ny: __m512d, nz: __m512d) -> __m512d {
    // SAFETY: each column has 8 doubles.
    let (x, y, z) = unsafe {
        (
            _mm512_loadu_pd(group.x.as_ptr()),
            _mm512_loadu_pd(group.y.as_ptr()),
            _mm512_loadu_pd(group.z.as_ptr()),
        )
    };
    let flat = _mm512_add_pd(_mm512_mul_pd(nx, x), _mm512_mul_pd(ny, y));
    _mm512_add_pd(flat, _mm512_mul_pd(nz, z))
}

/// The search for `N` groups whose values fit in registers: finds the largest value first, then the
/// lowest index that has it.
#[inline]
#[target_feature(enable = "avx512f")]
fn avx512_few<const N: usize>(groups: [&Group; N], nx: f64, ny: f64, nz: f64) -> u32 {
    let (nx, ny, nz) = (_mm512_set1_pd(nx), _mm512_set1_pd(ny), _mm512_set1_pd(nz));
    let values = groups.map(|group| avx512_values(group, nx, ny, nz));
    let high = values[1..].iter().fold(values[0], |high, &value| _mm512_max_pd(high, value));
    let largest = _mm512_set1_pd(_mm512_reduce_max_pd(high));
    let mut equal = 0_u32;
    for (i, &value) in values.iter().enumerate() {
        equal |= u32::from(_mm512_cmp_pd_mask::<_CMP_EQ_OQ>(value, largest)) << (i * LANES);
    }
    // If no value is comparable (NaN), the index is 0, as in the scalar definition.
    equal.trailing_zeros() & (u32::BITS - 1)
}

/// The search for any number of groups: keeps the largest value of each lane and its index.
#[target_feature(enable = "avx512f")]
fn avx512_many(groups: &[Group], nx: f64, ny: f64, nz: f64) -> u32 {
    let (nx, ny, nz) = (_mm512_set1_pd(nx), _mm512_set1_pd(ny), _mm512_set1_pd(nz));
    let lanes = _mm512_set_epi64(7, 6, 5, 4, 3, 2, 1, 0);
    let mut best = [_mm512_set1_pd(f64::NEG_INFINITY); SEARCHES];
    let mut found = [_mm512_setzero_si512(); SEARCHES];
    let mut look = |search: usize, group: &Group, first: usize| {
        let value = avx512_values(group, nx, ny, nz);
        let better = _mm512_cmp_pd_mask::<_CMP_GT_OQ>(value, best[search]);
        best[search] = _mm512_mask_mov_pd(best[search], better, value);
        let index = _mm512_add_epi64(lanes, _mm512_set1_epi64(first as i64));
        found[search] = _mm512_mask_mov_epi64(found[search], better, index);
    };
    let (fours, rest) = groups.as_chunks::<SEARCHES>();
    let mut first = 0;
    for [g0, g1, g2, g3] in fours {
        look(0, g0, first);
        look(1, g1, first + LANES);
        look(2, g2, first + 2 * LANES);
        look(3, g3, first + 3 * LANES);
        first += SEARCHES * LANES;
    }
    for group in rest {
        look(0, group, first);
        first += LANES;
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

/// [`avx512_both`] with AVX2.
#[target_feature(enable = "avx2")]
pub(super) fn avx2_both(a: &Columns, b: &Columns, nx: f64, ny: f64, nz: f64) -> (u32, u32) {
    match (a.groups(), b.groups()) {
        ([a], [b]) => (avx2_few([a], nx, ny, nz), avx2_few([b], -nx, -ny, -nz)),
        ([a0, a1], [b0, b1]) => (avx2_few([a0, a1], nx, ny, nz), avx2_few([b0, b1], -nx, -ny, -nz)),
        _ => (avx2(a, nx, ny, nz), avx2(b, -nx, -ny, -nz)),
    }
}

/// The vertex farthest along `n`, with four vertices per instruction.
#[target_feature(enable = "avx2")]
pub(super) fn avx2(columns: &Columns, nx: f64, ny: f64, nz: f64) -> u32 {
    match columns.groups() {
        [g0] => avx2_few([g0], nx, ny, nz),
        [g0, g1] => avx2_few([g0, g1], nx, ny, nz),
        groups => avx2_many(groups, nx, ny, nz),
    }
}

/// `n . v` for both halves of a group.
#[inline]
#[target_feature(enable = "avx2")]
fn avx2_values(group: &Group, nx: __m256d, ny: __m256d, nz: __m256d) -> [__m256d; 2] {
    [0, LANES / 2].map(|half| {
        let (x, y, z) = (&group.x[half..], &group.y[half..], &group.z[half..]);
        // SAFETY: each slice has at least 4 doubles.
        let (x, y, z) = unsafe {
            (_mm256_loadu_pd(x.as_ptr()), _mm256_loadu_pd(y.as_ptr()), _mm256_loadu_pd(z.as_ptr()))
        };
        let flat = _mm256_add_pd(_mm256_mul_pd(nx, x), _mm256_mul_pd(ny, y));
        _mm256_add_pd(flat, _mm256_mul_pd(nz, z))
    })
}

/// [`avx512_few`] with AVX2.
#[inline]
#[target_feature(enable = "avx2")]
fn avx2_few<const N: usize>(groups: [&Group; N], nx: f64, ny: f64, nz: f64) -> u32 {
    let (nx, ny, nz) = (_mm256_set1_pd(nx), _mm256_set1_pd(ny), _mm256_set1_pd(nz));
    let values = groups.map(|group| avx2_values(group, nx, ny, nz));
    let values = values.as_flattened();
    let high = values[1..].iter().fold(values[0], |high, &value| _mm256_max_pd(high, value));
    let high = _mm256_max_pd(high, _mm256_permute2f128_pd::<1>(high, high));
    let largest = _mm256_max_pd(high, _mm256_permute_pd::<0b0101>(high));
    let mut equal = 0;
    for (i, &value) in values.iter().enumerate() {
        equal |= _mm256_movemask_pd(_mm256_cmp_pd::<_CMP_EQ_OQ>(value, largest)) << (i * LANES / 2);
    }
    // If no value is comparable (NaN), the index is 0, as in the scalar definition.
    equal.trailing_zeros() & (i32::BITS - 1)
}

/// [`avx512_many`] with AVX2.
#[target_feature(enable = "avx2")]
fn avx2_many(groups: &[Group], nx: f64, ny: f64, nz: f64) -> u32 {
    let (nx, ny, nz) = (_mm256_set1_pd(nx), _mm256_set1_pd(ny), _mm256_set1_pd(nz));
    let mut best = _mm256_set1_pd(f64::NEG_INFINITY);
    let mut found = _mm256_setzero_si256();
    let mut index = _mm256_set_epi64x(3, 2, 1, 0);
    let step = _mm256_set1_epi64x(4);
    for group in groups {
        for value in avx2_values(group, nx, ny, nz) {
            let better = _mm256_cmp_pd::<_CMP_GT_OQ>(value, best);
            best = _mm256_blendv_pd(best, value, better);
            found = _mm256_blendv_epi8(found, index, _mm256_castpd_si256(better));
            index = _mm256_add_epi64(index, step);
        }
    }
    let (mut values, mut indices) = ([0.0; 4], [0_i64; 4]);
    // SAFETY: both arrays have 4 elements of 8 bytes.
    unsafe {
        _mm256_storeu_pd(values.as_mut_ptr(), best);
        _mm256_storeu_si256(indices.as_mut_ptr().cast(), found);
    }
    // Selected without branches, because the best lane is unpredictable.
    let largest = values.iter().fold(f64::NEG_INFINITY, |a, &b| if b > a { b } else { a });
    let lane = |i: usize| if values[i] == largest { indices[i] } else { i64::MAX };
    lane(0).min(lane(1)).min(lane(2).min(lane(3))) as u32
}
