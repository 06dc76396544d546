//! A table whose keys are numbers that this server chose.

use std::{
    collections::HashMap,
    hash::{BuildHasherDefault, Hasher},
};

/// A table by numbers that no caller can choose, such as the ids of callers. Therefore its hash
/// function needs no random key, and takes about a nanosecond.
pub type ById<K, V> = HashMap<K, V, BuildHasherDefault<IdHasher>>;

/// Mixes numbers by a multiplication of 64 by 64 bits, of which both halves are used.
#[derive(Clone, Copy, Debug, Default)]
pub struct IdHasher(u64);

impl Hasher for IdHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.write_u64(byte.into());
        }
    }

    fn write_u64(&mut self, number: u64) {
        // 2^64 divided by the golden ratio; any odd number without a pattern would do.
        let product = u128::from(self.0.rotate_left(32) ^ number) * 0x9e37_79b9_7f4a_7c15;
        self.0 = product as u64 ^ (product >> 64) as u64;
    }

    fn write_usize(&mut self, number: usize) {
        self.write_u64(number as u64);
    }
}

#[cfg(test)]
mod tests {
    use std::{collections::HashSet, hash::BuildHasher};

    use super::*;

    /// Catches numbers with a pattern, as ids in sequence or addresses, that share their hash or the bits
    /// of it from which a table chooses a place: the lowest, and the highest 7.
    #[test]
    fn patterns_are_spread() {
        for step in [1, 8, 16, 160, 4096, 1 << 32] {
            for of in [|n| (0, n), |n| (n, 0), |n| (n, n)] {
                let hashes: Vec<u64> = (0..4096)
                    .map(|i| {
                        BuildHasherDefault::<IdHasher>::default().hash_one::<(u64, usize)>({
                            let (a, b): (u64, u64) = of(i * step);
                            (a, b as usize)
                        })
                    })
                    .collect();
                let distinct =
                    |bits: fn(u64) -> u64| hashes.iter().map(|&h| bits(h)).collect::<HashSet<_>>().len();
                assert_eq!(distinct(|hash| hash), 4096, "{step}");
                // A random function leaves 63 % of 4096 places used.
                assert!(distinct(|hash| hash & 4095) > 2000, "{step}");
                assert_eq!(distinct(|hash| hash >> 57), 128, "{step}");
            }
        }
    }
}
