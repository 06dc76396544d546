//! Reads the workload file: hulls and pairs with exact answers, in the format of docs/workload.md.

use std::io;

/// The families, in the order of the file.
pub(crate) const FAMILIES: [&str; 4] = ["box", "poly16", "poly64", "poly256"];
/// The regimes, in the order of the file.
pub(crate) const REGIMES: [&str; 3] = ["shallow", "resting", "separated"];
/// The index of "separated" in [`REGIMES`].
pub(crate) const SEPARATED: usize = 2;

/// A hull in its own frame; its contraction point is the origin.
pub(crate) struct Hull {
    pub(crate) vertices: Vec<[f64; 3]>,
    /// The planes `[n, d]` of the faces; `n.x + d <= 0` inside.
    pub(crate) planes: Vec<[f64; 4]>,
}

/// The pose of a hull: position and quaternion `x, y, z, w`.
#[derive(Clone, Copy)]
pub(crate) struct HullPose {
    pub(crate) position: [f64; 3],
    pub(crate) rotation: [f64; 4],
}

/// Two hulls of a family and the exact answer.
pub(crate) struct Pair {
    pub(crate) hulls: [usize; 2],
    pub(crate) poses: [HullPose; 2],
    /// The exact growth scale, rounded to double.
    pub(crate) alpha: f64,
    /// An optimal unit normal from A to B, rounded to double.
    pub(crate) normal: [f64; 3],
}

pub(crate) struct Family {
    pub(crate) name: &'static str,
    pub(crate) hulls: Vec<Hull>,
    /// The pairs of each regime.
    pub(crate) regimes: Vec<Vec<Pair>>,
}

/// Reads a whole file.
pub(crate) fn parse(bytes: &[u8]) -> io::Result<Vec<Family>> {
    let mut input = Reader { bytes };
    let (families, regimes) = (input.count()?, input.count()?);
    if (families, regimes) != (FAMILIES.len(), REGIMES.len()) {
        return Err(invalid(format!("{families} families of {regimes} regimes")));
    }
    let parsed = FAMILIES.iter().map(|name| input.family(name)).collect::<io::Result<_>>()?;
    if !input.bytes.is_empty() {
        return Err(invalid(format!("{} bytes are left over", input.bytes.len())));
    }
    Ok(parsed)
}

fn invalid(message: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, message)
}

struct Reader<'a> {
    bytes: &'a [u8],
}

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> io::Result<[u8; N]> {
        let (head, rest) = self.bytes.split_first_chunk().ok_or(io::ErrorKind::UnexpectedEof)?;
        self.bytes = rest;
        Ok(*head)
    }

    fn count(&mut self) -> io::Result<usize> {
        Ok(u32::from_le_bytes(self.take()?) as usize)
    }

    fn number(&mut self) -> io::Result<f64> {
        Ok(f64::from_le_bytes(self.take()?))
    }

    fn numbers<const N: usize>(&mut self) -> io::Result<[f64; N]> {
        let mut row = [0.0; N];
        for value in &mut row {
            *value = self.number()?;
        }
        Ok(row)
    }

    fn rows<const N: usize>(&mut self, count: usize) -> io::Result<Vec<[f64; N]>> {
        (0..count).map(|_| self.numbers()).collect()
    }

    fn family(&mut self, name: &'static str) -> io::Result<Family> {
        let hulls: Vec<Hull> = (0..self.count()?).map(|_| self.hull()).collect::<io::Result<_>>()?;
        let regimes = REGIMES
            .iter()
            .map(|_| (0..self.count()?).map(|_| self.pair(hulls.len())).collect())
            .collect::<io::Result<_>>()?;
        Ok(Family { name, hulls, regimes })
    }

    fn hull(&mut self) -> io::Result<Hull> {
        let (vertices, planes) = (self.count()?, self.count()?);
        Ok(Hull { vertices: self.rows(vertices)?, planes: self.rows(planes)? })
    }

    fn pose(&mut self) -> io::Result<HullPose> {
        Ok(HullPose { position: self.numbers()?, rotation: self.numbers()? })
    }

    fn pair(&mut self, hull_count: usize) -> io::Result<Pair> {
        let hulls = [self.count()?, self.count()?];
        if hulls.iter().any(|&hull| hull >= hull_count) {
            return Err(invalid(format!("hulls {hulls:?} of {hull_count}")));
        }
        let poses = [self.pose()?, self.pose()?];
        Ok(Pair { hulls, poses, alpha: self.number()?, normal: self.numbers()? })
    }
}
