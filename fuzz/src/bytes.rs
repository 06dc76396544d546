//! Numbers from a fuzzer's bytes that are near the limits of geometry: a small grid, values off it
//! by some ulps, powers of two, and arbitrary bits.

use hullcast_contact::workload::Random;
use libfuzzer_sys::arbitrary::{Result, Unstructured};

/// Reads a fuzzer's bytes. After the last one it continues with pseudo-random bytes seeded by all
/// of them, so that a short input makes as rich a scene as a long one.
pub(crate) struct ByteSource<'a> {
    rest: &'a [u8],
    random: Random,
}

impl<'a> ByteSource<'a> {
    pub(crate) fn all(u: &mut Unstructured<'a>) -> Result<Self> {
        let rest = u.bytes(u.len())?;
        // The seed is the FNV-1a hash of the bytes.
        let add = |hash: u64, &byte: &u8| (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3);
        let seed = rest.iter().fold(0xcbf2_9ce4_8422_2325, add);
        Ok(Self { rest, random: Random::new(seed) })
    }

    pub(crate) fn byte(&mut self) -> u8 {
        if let Some((&first, rest)) = self.rest.split_first() {
            self.rest = rest;
            return first;
        }
        self.random.bits() as u8
    }

    pub(crate) fn below(&mut self, limit: u8) -> u8 {
        self.byte() % limit
    }

    pub(crate) fn one_of<T: Copy>(&mut self, values: &[T]) -> T {
        values[usize::from(self.byte()) % values.len()]
    }

    fn bits(&mut self) -> u64 {
        (0..8).fold(0, |bits, _| bits << 8 | u64::from(self.byte()))
    }

    /// A multiple of 1/32 of absolute value at most 4.
    pub(crate) fn grid(&mut self) -> f64 {
        f64::from(self.byte() as i8) / 32.0
    }

    /// A number in (0, 1].
    pub(crate) fn share(&mut self) -> f64 {
        (f64::from(self.byte()) + 1.0) / 256.0
    }

    /// `x` moved by up to 128 ulps.
    pub(crate) fn nudged(&mut self, x: f64) -> f64 {
        f64::from_bits(x.to_bits().wrapping_add_signed(i64::from(self.byte() as i8)))
    }

    /// 0, or a number of either sign whose size is between rounding and 1.
    pub(crate) fn little(&mut self) -> f64 {
        let byte = self.byte();
        let size = 10f64.powf(-17.0 * f64::from(byte >> 1) / 127.0);
        [size, -size][usize::from(byte & 1)] * f64::from(self.below(4).min(1))
    }

    /// A coordinate. Three in four are grid values, or near them.
    pub(crate) fn coordinate(&mut self) -> f64 {
        match self.below(8) {
            0..=3 => self.grid(),
            4 | 5 => {
                let grid = self.grid();
                self.nudged(grid)
            }
            6 => f64::from(self.byte() as i8) * 2f64.powi(i32::from(self.byte() as i8) / 2),
            _ => f64::from_bits(self.bits()),
        }
    }

    pub(crate) fn point(&mut self) -> [f64; 3] {
        std::array::from_fn(|_| self.coordinate())
    }

    /// A unit vector, either from a small grid, which produces many ties, or an arbitrary one.
    pub(crate) fn direction(&mut self) -> glam::DVec3 {
        let grid = match self.below(3) {
            0 => [(); 3].map(|()| f64::from(self.below(3)) - 1.0),
            _ => [(); 3].map(|()| f64::from(self.byte() as i8)),
        };
        glam::DVec3::from_array(grid).try_normalize().unwrap_or(glam::DVec3::Z)
    }

    /// A quaternion: a turn of the cube, one near it, or an arbitrary one.
    pub(crate) fn rotation(&mut self) -> [f64; 4] {
        let half = 0.5f64.sqrt();
        let turns =
            [[0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0], [0.5, 0.5, 0.5, 0.5], [half, 0.0, 0.0, half]];
        let kind = self.below(8);
        if kind < 4 {
            return turns[usize::from(kind)];
        }
        let q: [f64; 4] = if kind < 6 {
            let near = self.one_of(&turns);
            std::array::from_fn(|k| {
                near[k] + f64::from(self.byte() as i8) * 2f64.powi(-60 + i32::from(kind) * 4)
            })
        } else {
            std::array::from_fn(|_| f64::from(self.byte() as i8))
        };
        let length = q.iter().map(|x| x * x).sum::<f64>().sqrt();
        if length > 0.0 { q.map(|x| x / length) } else { turns[0] }
    }
}
