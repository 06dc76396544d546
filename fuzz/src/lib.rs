//! Numbers and points from a fuzzer's bytes, near what breaks geometry: a small
//! grid, off it by ulps, powers of two, and any bits at all.

/// Reads a fuzzer's bytes; zeros once they end.
pub struct Bytes<'a>(pub &'a [u8]);

impl Bytes<'_> {
    pub fn byte(&mut self) -> u8 {
        let (first, rest) = self.0.split_first().map_or((0, self.0), |(&first, rest)| (first, rest));
        self.0 = rest;
        first
    }

    pub fn below(&mut self, limit: u8) -> u8 {
        self.byte() % limit
    }

    fn bits(&mut self) -> u64 {
        (0..8).fold(0, |bits, _| bits << 8 | u64::from(self.byte()))
    }

    /// A coordinate: most are grid values of about 1.
    pub fn coordinate(&mut self) -> f64 {
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

    pub fn point(&mut self) -> [f64; 3] {
        std::array::from_fn(|_| self.coordinate())
    }

    /// Points of a hull: some are made of earlier ones, so that they are equal,
    /// on a line or in a plane to rounding.
    pub fn points(&mut self, most: u8) -> Vec<[f64; 3]> {
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
    pub fn rotation(&mut self) -> [f64; 4] {
        let half = 0.5f64.sqrt();
        let turns = [[0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0], [0.5, 0.5, 0.5, 0.5], [half, 0.0, 0.0, half]];
        let kind = self.below(8);
        if kind < 4 {
            return turns[usize::from(kind)];
        }
        let q: [f64; 4] = if kind < 6 {
            let near = turns[usize::from(self.below(4))];
            std::array::from_fn(|k| near[k] + f64::from(self.byte() as i8) * 2f64.powi(-60 + i32::from(kind) * 4))
        } else {
            std::array::from_fn(|_| f64::from(self.byte() as i8))
        };
        let length = q.iter().map(|x| x * x).sum::<f64>().sqrt();
        q.map(|x| x / length)
    }
}
