//! Lanes by SSE2, AVX2 and AVX-512, bit for bit those of `f64`.
//!
//! A value of [`Vectors`] shows that the machine has its instructions, because only
//! [`Vectors::available`] makes one. [`Vectors::run`] is the only place where a computation meets a vector
//! type, so wherever a vector exists, its instructions do.

#![allow(unsafe_code)]

use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub};

#[allow(clippy::wildcard_imports, reason = "some sixty intrinsics, whose names say where they are from")]
use std::arch::x86_64::*;

use super::{Kernel, Lanes, Mask, Row, WIDTH};

/// The instruction sets with vectors of doubles. A value exists only if the machine has the instructions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Vectors(Set);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Set {
    Sse2,
    Avx2,
    Avx512,
}

impl Vectors {
    /// Those of this machine, from the narrowest to the widest.
    pub(super) fn available() -> impl DoubleEndedIterator<Item = Self> {
        let avx2 = is_x86_feature_detected!("avx2").then_some(Set::Avx2);
        let avx512 = is_x86_feature_detected!("avx512f").then_some(Set::Avx512);
        [Some(Set::Sse2), avx2, avx512].into_iter().flatten().map(Self)
    }

    pub(super) const fn name(self) -> &'static str {
        match self.0 {
            Set::Sse2 => "2 lanes, SSE2",
            Set::Avx2 => "4 lanes, AVX2",
            Set::Avx512 => "8 lanes, AVX-512",
        }
    }

    /// Computes with the vectors of this instruction set.
    #[inline]
    pub(super) fn run<K: Kernel>(self, kernel: K) {
        match self.0 {
            Set::Sse2 => kernel.run::<Sse2>(),
            // SAFETY: this value exists, so the machine has AVX2.
            Set::Avx2 => unsafe { with_avx2(kernel) },
            // SAFETY: this value exists, so the machine has AVX-512F.
            Set::Avx512 => unsafe { with_avx512(kernel) },
        }
    }
}

/// The entry function for AVX2.
#[target_feature(enable = "avx2")]
fn with_avx2<K: Kernel>(kernel: K) {
    kernel.run::<Avx2>();
}

/// The entry function for AVX-512.
#[target_feature(enable = "avx512f")]
fn with_avx512<K: Kernel>(kernel: K) {
    kernel.run::<Avx512>();
}

/// Defines a vector of doubles and its mask from the names of its intrinsics.
macro_rules! vector {
    (
        $(#[$doc:meta])* $lanes:ident($inner:ty) of $count:literal,
        $(#[$mask_doc:meta])* $mask:ident($mask_inner:ty);
        arithmetic: $add:ident $sub:ident $mul:ident $div:ident $sqrt:ident $max:ident $min:ident;
        memory: $set:ident $load:ident $store:ident;
        compare: |$a:ident, $b:ident| $gt:expr, $ge:expr;
        choose: |$choice:ident, $yes:ident, $no:ident| $select:expr;
        bits: $to_bits:ident $from_bits:ident $and:ident $andnot:ident $or:ident $xor:ident
            $set_bits:ident $add_bits:ident;
        masks: |$p:ident, $q:ident| $mask_and:expr, $mask_or:expr, $mask_not:expr, $mask_bits:expr;
        transpose: $transpose:ident;
    ) => {
        $(#[$doc])*
        #[derive(Clone, Copy)]
        pub(super) struct $lanes($inner);

        $(#[$mask_doc])*
        #[derive(Clone, Copy)]
        pub(super) struct $mask($mask_inner);

        vector!(@operator $lanes Add add $add);
        vector!(@operator $lanes Sub sub $sub);
        vector!(@operator $lanes Mul mul $mul);
        vector!(@operator $lanes Div div $div);

        impl Neg for $lanes {
            type Output = Self;

            #[inline(always)]
            fn neg(self) -> Self {
                // SAFETY: values of this type exist only where its instructions do ([`Vectors`]).
                unsafe { Self($from_bits($xor($to_bits(self.0), $to_bits($set(-0.0))))) }
            }
        }

        impl BitAnd for $mask {
            type Output = Self;

            #[inline(always)]
            fn bitand(self, other: Self) -> Self {
                let ($p, $q) = (self.0, other.0);
                #[allow(unused_unsafe, reason = "masks of AVX-512 are plain integers")]
                // SAFETY: values of this type exist only where its instructions do ([`Vectors`]).
                unsafe { Self($mask_and) }
            }
        }

        impl BitOr for $mask {
            type Output = Self;

            #[inline(always)]
            fn bitor(self, other: Self) -> Self {
                let ($p, $q) = (self.0, other.0);
                #[allow(unused_unsafe, reason = "masks of AVX-512 are plain integers")]
                // SAFETY: values of this type exist only where its instructions do ([`Vectors`]).
                unsafe { Self($mask_or) }
            }
        }

        impl Not for $mask {
            type Output = Self;

            #[inline(always)]
            fn not(self) -> Self {
                let $p = self.0;
                #[allow(unused_unsafe, reason = "masks of AVX-512 are plain integers")]
                // SAFETY: values of this type exist only where its instructions do ([`Vectors`]).
                unsafe { Self($mask_not) }
            }
        }

        impl Mask for $mask {
            #[inline(always)]
            fn bits(self) -> u32 {
                let $p = self.0;
                #[allow(unused_unsafe, reason = "masks of AVX-512 are plain integers")]
                // SAFETY: values of this type exist only where its instructions do ([`Vectors`]).
                unsafe { $mask_bits }
            }
        }

        // SAFETY of every block below: the functions of this type are called only where its
        // instructions exist ([`Vectors`]). Blocks that touch memory have a reason of their own.
        #[allow(clippy::undocumented_unsafe_blocks, reason = "one reason for all, just above")]
        impl Lanes for $lanes {
            const COUNT: usize = $count;
            type Mask = $mask;

            #[inline(always)]
            fn splat(x: f64) -> Self {
                unsafe { Self($set(x)) }
            }

            #[inline(always)]
            fn transposed(rows: &[&Row; WIDTH], at: usize) -> [Self; WIDTH] {
                unsafe { $transpose(rows, at) }
            }

            #[inline(always)]
            fn store(self, row: &mut Row, at: usize) {
                let place: &mut [f64; $count] = row[at..].first_chunk_mut().unwrap_or_else(out_of_row);
                // SAFETY: the place has as many doubles as are stored.
                unsafe { $store(place.as_mut_ptr(), self.0) }
            }

            #[inline(always)]
            fn sqrt(self) -> Self {
                unsafe { Self($sqrt(self.0)) }
            }

            #[inline(always)]
            fn abs(self) -> Self {
                unsafe { Self($from_bits($andnot($to_bits($set(-0.0)), $to_bits(self.0)))) }
            }

            #[inline(always)]
            fn max(self, other: Self) -> Self {
                unsafe { Self($max(self.0, other.0)) }
            }

            #[inline(always)]
            fn min(self, other: Self) -> Self {
                unsafe { Self($min(self.0, other.0)) }
            }

            #[inline(always)]
            fn gt(self, other: Self) -> $mask {
                let ($a, $b) = (self.0, other.0);
                unsafe { $mask($gt) }
            }

            #[inline(always)]
            fn ge(self, other: Self) -> $mask {
                let ($a, $b) = (self.0, other.0);
                unsafe { $mask($ge) }
            }

            #[inline(always)]
            fn select(mask: $mask, yes: Self, no: Self) -> Self {
                let ($choice, $yes, $no) = (mask.0, yes.0, no.0);
                unsafe { Self($select) }
            }

            #[inline(always)]
            fn copysign(self, sign: Self) -> Self {
                unsafe {
                    let bit = $to_bits($set(-0.0));
                    let (size, sign) = ($andnot(bit, $to_bits(self.0)), $and(bit, $to_bits(sign.0)));
                    Self($from_bits($or(size, sign)))
                }
            }

            #[inline(always)]
            fn next_up(self) -> Self {
                unsafe { Self($from_bits($add_bits($to_bits(self.0), $set_bits(1)))) }
            }

            #[inline(always)]
            fn next_down(self) -> Self {
                unsafe { Self($from_bits($add_bits($to_bits(self.0), $set_bits(-1)))) }
            }
        }
    };
    (@operator $lanes:ident $trait:ident $function:ident $intrinsic:ident) => {
        impl $trait for $lanes {
            type Output = Self;

            #[inline(always)]
            fn $function(self, other: Self) -> Self {
                // SAFETY: values of this type exist only where its instructions do ([`Vectors`]).
                unsafe { Self($intrinsic(self.0, other.0)) }
            }
        }
    };
}

/// A row of [`WIDTH`] numbers is cut only at multiples of a number of lanes that divides it.
#[cold]
fn out_of_row<T>() -> T {
    unreachable!("a group of lanes begins at a multiple of its width")
}

vector! {
    /// Two lanes by SSE2, which every x86-64 machine has.
    Sse2(__m128d) of 2,
    /// A mask of SSE2: all bits of a lane are equal.
    Sse2Mask(__m128d);
    arithmetic: _mm_add_pd _mm_sub_pd _mm_mul_pd _mm_div_pd _mm_sqrt_pd _mm_max_pd _mm_min_pd;
    memory: _mm_set1_pd _mm_loadu_pd _mm_storeu_pd;
    compare: |a, b| _mm_cmpgt_pd(a, b), _mm_cmpge_pd(a, b);
    choose: |mask, yes, no| _mm_or_pd(_mm_and_pd(mask, yes), _mm_andnot_pd(mask, no));
    bits: _mm_castpd_si128 _mm_castsi128_pd _mm_and_si128 _mm_andnot_si128 _mm_or_si128 _mm_xor_si128
        _mm_set1_epi64x _mm_add_epi64;
    masks: |p, q| _mm_and_pd(p, q), _mm_or_pd(p, q),
        _mm_xor_pd(p, _mm_castsi128_pd(_mm_set1_epi64x(-1))), _mm_movemask_pd(p).cast_unsigned();
    transpose: transpose_sse2;
}

vector! {
    /// Four lanes by AVX2.
    Avx2(__m256d) of 4,
    /// A mask of AVX2: all bits of a lane are equal.
    Avx2Mask(__m256d);
    arithmetic: _mm256_add_pd _mm256_sub_pd _mm256_mul_pd _mm256_div_pd _mm256_sqrt_pd _mm256_max_pd
        _mm256_min_pd;
    memory: _mm256_set1_pd _mm256_loadu_pd _mm256_storeu_pd;
    compare: |a, b| _mm256_cmp_pd::<_CMP_GT_OQ>(a, b), _mm256_cmp_pd::<_CMP_GE_OQ>(a, b);
    choose: |mask, yes, no| _mm256_blendv_pd(no, yes, mask);
    bits: _mm256_castpd_si256 _mm256_castsi256_pd _mm256_and_si256 _mm256_andnot_si256 _mm256_or_si256
        _mm256_xor_si256 _mm256_set1_epi64x _mm256_add_epi64;
    masks: |p, q| _mm256_and_pd(p, q), _mm256_or_pd(p, q),
        _mm256_xor_pd(p, _mm256_castsi256_pd(_mm256_set1_epi64x(-1))), _mm256_movemask_pd(p).cast_unsigned();
    transpose: transpose_avx2;
}

vector! {
    /// Eight lanes by AVX-512.
    Avx512(__m512d) of 8,
    /// A mask of AVX-512: one bit per lane.
    Avx512Mask(u8);
    arithmetic: _mm512_add_pd _mm512_sub_pd _mm512_mul_pd _mm512_div_pd _mm512_sqrt_pd _mm512_max_pd
        _mm512_min_pd;
    memory: _mm512_set1_pd _mm512_loadu_pd _mm512_storeu_pd;
    compare: |a, b| _mm512_cmp_pd_mask::<_CMP_GT_OQ>(a, b), _mm512_cmp_pd_mask::<_CMP_GE_OQ>(a, b);
    choose: |mask, yes, no| _mm512_mask_blend_pd(mask, no, yes);
    bits: _mm512_castpd_si512 _mm512_castsi512_pd _mm512_and_si512 _mm512_andnot_si512 _mm512_or_si512
        _mm512_xor_si512 _mm512_set1_epi64 _mm512_add_epi64;
    masks: |p, q| p & q, p | q, !p, u32::from(p);
    transpose: transpose_avx512;
}

/// [`Lanes::transposed`] for two lanes.
#[inline(always)]
unsafe fn transpose_sse2(rows: &[&Row; WIDTH], at: usize) -> [Sse2; WIDTH] {
    let (first, second) = (rows[at], rows[at + 1]);
    let mut columns = [Sse2::splat(0.0); WIDTH];
    for i in 0..WIDTH {
        // SAFETY: SSE2 is part of x86-64.
        columns[i] = unsafe { Sse2(_mm_set_pd(second[i], first[i])) };
    }
    columns
}

/// [`Lanes::transposed`] for four lanes: two squares of 4 by 4.
///
/// # Safety
/// The CPU has AVX2.
#[inline(always)]
unsafe fn transpose_avx2(rows: &[&Row; WIDTH], at: usize) -> [Avx2; WIDTH] {
    let rows = [rows[at], rows[at + 1], rows[at + 2], rows[at + 3]];
    let mut columns = [Avx2::splat(0.0); WIDTH];
    for half in 0..2 {
        // SAFETY: each row has 8 doubles, so 4 remain from `4 * half` on. The caller knows that the
        // CPU has AVX2.
        unsafe {
            let load = |i: usize| rows[i].as_ptr().add(4 * half);
            let (r0, r1) = (_mm256_loadu_pd(load(0)), _mm256_loadu_pd(load(1)));
            let (r2, r3) = (_mm256_loadu_pd(load(2)), _mm256_loadu_pd(load(3)));
            let (low01, high01) = (_mm256_unpacklo_pd(r0, r1), _mm256_unpackhi_pd(r0, r1));
            let (low23, high23) = (_mm256_unpacklo_pd(r2, r3), _mm256_unpackhi_pd(r2, r3));
            columns[4 * half] = Avx2(_mm256_permute2f128_pd::<0x20>(low01, low23));
            columns[4 * half + 1] = Avx2(_mm256_permute2f128_pd::<0x20>(high01, high23));
            columns[4 * half + 2] = Avx2(_mm256_permute2f128_pd::<0x31>(low01, low23));
            columns[4 * half + 3] = Avx2(_mm256_permute2f128_pd::<0x31>(high01, high23));
        }
    }
    columns
}

/// [`Lanes::transposed`] for eight lanes: a square of 8 by 8, in three rounds that exchange single
/// numbers, pairs of them, and fours.
///
/// # Safety
/// The CPU has AVX-512F.
#[inline(always)]
unsafe fn transpose_avx512(rows: &[&Row; WIDTH], _at: usize) -> [Avx512; WIDTH] {
    // SAFETY: each row has 8 doubles, and the caller knows that the CPU has AVX-512F.
    unsafe {
        let (r0, r1) = (_mm512_loadu_pd(rows[0].as_ptr()), _mm512_loadu_pd(rows[1].as_ptr()));
        let (r2, r3) = (_mm512_loadu_pd(rows[2].as_ptr()), _mm512_loadu_pd(rows[3].as_ptr()));
        let (r4, r5) = (_mm512_loadu_pd(rows[4].as_ptr()), _mm512_loadu_pd(rows[5].as_ptr()));
        let (r6, r7) = (_mm512_loadu_pd(rows[6].as_ptr()), _mm512_loadu_pd(rows[7].as_ptr()));
        // Numbers 0, 2, 4, 6 (even) or 1, 3, 5, 7 (odd) of two rows, in turns.
        let (even01, odd01) = (_mm512_unpacklo_pd(r0, r1), _mm512_unpackhi_pd(r0, r1));
        let (even23, odd23) = (_mm512_unpacklo_pd(r2, r3), _mm512_unpackhi_pd(r2, r3));
        let (even45, odd45) = (_mm512_unpacklo_pd(r4, r5), _mm512_unpackhi_pd(r4, r5));
        let (even67, odd67) = (_mm512_unpacklo_pd(r6, r7), _mm512_unpackhi_pd(r6, r7));
        // 0x88 takes the pairs 0 and 2 of both arguments, and 0xdd the pairs 1 and 3.
        let (e04, e26) =
            (_mm512_shuffle_f64x2::<0x88>(even01, even23), _mm512_shuffle_f64x2::<0xdd>(even01, even23));
        let (o15, o37) =
            (_mm512_shuffle_f64x2::<0x88>(odd01, odd23), _mm512_shuffle_f64x2::<0xdd>(odd01, odd23));
        let (f04, f26) =
            (_mm512_shuffle_f64x2::<0x88>(even45, even67), _mm512_shuffle_f64x2::<0xdd>(even45, even67));
        let (p15, p37) =
            (_mm512_shuffle_f64x2::<0x88>(odd45, odd67), _mm512_shuffle_f64x2::<0xdd>(odd45, odd67));
        [
            Avx512(_mm512_shuffle_f64x2::<0x88>(e04, f04)),
            Avx512(_mm512_shuffle_f64x2::<0x88>(o15, p15)),
            Avx512(_mm512_shuffle_f64x2::<0x88>(e26, f26)),
            Avx512(_mm512_shuffle_f64x2::<0x88>(o37, p37)),
            Avx512(_mm512_shuffle_f64x2::<0xdd>(e04, f04)),
            Avx512(_mm512_shuffle_f64x2::<0xdd>(o15, p15)),
            Avx512(_mm512_shuffle_f64x2::<0xdd>(e26, f26)),
            Avx512(_mm512_shuffle_f64x2::<0xdd>(o37, p37)),
        ]
    }
}
