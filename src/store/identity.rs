//! The name of a hull: the SHA-256 of its content (docs/identity.md).
//!
//! The hashed bytes are also the stored bytes, so that a blob proves by its name that it is the
//! blob that was acknowledged.

use std::{fmt, str::FromStr};

use sha2::{Digest, Sha256};

use crate::contact::{BuildError, ConvexHull, HullError, HullOptions, Simplification, Stop};

/// The first bytes of the byte string.
const MAGIC: &[u8; 8] = b"hullcast";
/// The version of byte strings without a planarity.
const FORMAT: u32 = 1;
/// The version of byte strings with a planarity.
const FORMAT_WITH_PLANARITY: u32 = 2;
const ABSENT: u8 = 0;
const PRESENT: u8 = 1;

/// SHA-256 of a hull's identity bytes.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct HullId(pub [u8; 32]);

impl fmt::Display for HullId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for HullId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// The text is not 64 lower-case hexadecimal digits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotAnId;

impl FromStr for HullId {
    type Err = NotAnId;

    fn from_str(text: &str) -> Result<Self, NotAnId> {
        let digit = |byte: u8| match byte {
            b'0'..=b'9' => Ok(byte - b'0'),
            b'a'..=b'f' => Ok(byte - b'a' + 10),
            _ => Err(NotAnId),
        };
        let text: &[u8; 64] = text.as_bytes().try_into().map_err(|_| NotAnId)?;
        let mut id = [0; 32];
        for (byte, pair) in id.iter_mut().zip(text.chunks_exact(2)) {
            *byte = digit(pair[0])? << 4 | digit(pair[1])?;
        }
        Ok(Self(id))
    }
}

/// The definition of a hull, as it is registered.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HullDefinition {
    /// The points, in the hull's frame, the caller's units and the caller's order.
    pub points: Vec<[f64; 3]>,
    /// The contraction point, in the hull's frame and the caller's units; the centre of mass if
    /// absent.
    pub contraction_point: Option<[f64; 3]>,
    /// The simplification; if absent, the hull keeps all its vertices.
    pub simplification: Option<Simplification>,
    /// See [`HullOptions::planarity`].
    pub planarity: Option<f64>,
}

impl HullDefinition {
    /// The bytes that are hashed and stored. -0.0 is written as 0.0.
    pub fn identity_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(72 + 24 * self.points.len());
        bytes.extend_from_slice(MAGIC);
        let format = if self.planarity.is_some() { FORMAT_WITH_PLANARITY } else { FORMAT };
        bytes.extend_from_slice(&format.to_le_bytes());
        match self.contraction_point {
            None => bytes.push(ABSENT),
            Some(point) => {
                bytes.push(PRESENT);
                write_point(&mut bytes, point);
            }
        }
        match self.simplification {
            None => bytes.push(ABSENT),
            Some(Simplification { max_vertices, max_deviation }) => {
                bytes.push(PRESENT);
                write_optional(&mut bytes, max_vertices.map(u32::to_le_bytes));
                write_optional(&mut bytes, max_deviation.map(|deviation| (deviation + 0.0).to_le_bytes()));
            }
        }
        if let Some(planarity) = self.planarity {
            bytes.extend_from_slice(&(planarity + 0.0).to_le_bytes());
        }
        bytes.extend_from_slice(&(self.points.len() as u32).to_le_bytes());
        for &point in &self.points {
            write_point(&mut bytes, point);
        }
        bytes
    }

    /// Reads identity bytes. Returns `None` if they are invalid or have a version that is not
    /// known here.
    pub fn from_identity_bytes(bytes: &[u8]) -> Option<Self> {
        let mut rest = ByteReader(bytes);
        if rest.take::<8>()? != *MAGIC {
            return None;
        }
        let has_planarity = match u32::from_le_bytes(rest.take()?) {
            FORMAT => false,
            FORMAT_WITH_PLANARITY => true,
            _ => return None,
        };
        let contraction_point = match rest.take()? {
            [ABSENT] => None,
            [PRESENT] => Some(rest.point()?),
            _ => return None,
        };
        let simplification = match rest.take()? {
            [ABSENT] => None,
            [PRESENT] => Some(Simplification {
                max_vertices: rest.optional()?.map(u32::from_le_bytes),
                max_deviation: rest.optional()?.map(f64::from_le_bytes),
            }),
            _ => return None,
        };
        let planarity = if has_planarity { Some(f64::from_le_bytes(rest.take()?)) } else { None };
        let count = u32::from_le_bytes(rest.take()?) as usize;
        if rest.0.len() != count.checked_mul(24)? {
            return None;
        }
        let points = (0..count).map(|_| rest.point()).collect::<Option<_>>()?;
        Some(Self { points, contraction_point, simplification, planarity })
    }

    /// Builds the hull.
    ///
    /// # Errors
    /// The reason why these points have no valid hull.
    pub fn build(&self, max_vertices: usize) -> Result<ConvexHull, HullError> {
        ConvexHull::with_options(&self.points, &self.options(max_vertices))
    }

    /// Builds the hull, unless `stop` ends the build.
    ///
    /// # Errors
    /// The reason why these points have no valid hull, or that the build was stopped.
    pub fn build_stoppable(&self, max_vertices: usize, stop: &Stop) -> Result<ConvexHull, BuildError> {
        ConvexHull::with_options_stoppable(&self.points, &self.options(max_vertices), stop)
    }

    fn options(&self, max_vertices: usize) -> HullOptions {
        let Self { contraction_point, simplification, planarity, .. } = *self;
        HullOptions { contraction_point, max_vertices, simplification, planarity }
    }
}

/// The id of identity bytes.
pub fn id_of(identity_bytes: &[u8]) -> HullId {
    HullId(Sha256::digest(identity_bytes).into())
}

fn write_optional<const N: usize>(bytes: &mut Vec<u8>, value: Option<[u8; N]>) {
    match value {
        None => bytes.push(ABSENT),
        Some(value) => {
            bytes.push(PRESENT);
            bytes.extend_from_slice(&value);
        }
    }
}

fn write_point(bytes: &mut Vec<u8>, point: [f64; 3]) {
    for coordinate in point {
        // Adding 0.0 turns -0.0 into 0.0 and leaves the bits of every other number unchanged.
        bytes.extend_from_slice(&(coordinate + 0.0).to_le_bytes());
    }
}

/// The bytes that are still to be read.
struct ByteReader<'a>(&'a [u8]);

impl ByteReader<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (head, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*head)
    }

    /// The outer option is `None` if the bytes cannot be read, and the inner one if the value is
    /// absent.
    #[allow(clippy::option_option, reason = "two questions")]
    fn optional<const N: usize>(&mut self) -> Option<Option<[u8; N]>> {
        match self.take()? {
            [ABSENT] => Some(None),
            [PRESENT] => Some(Some(self.take()?)),
            _ => None,
        }
    }

    fn point(&mut self) -> Option<[f64; 3]> {
        Some([
            f64::from_le_bytes(self.take()?),
            f64::from_le_bytes(self.take()?),
            f64::from_le_bytes(self.take()?),
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tetrahedron() -> HullDefinition {
        HullDefinition {
            points: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            ..HullDefinition::default()
        }
    }

    fn simplified(max_vertices: Option<u32>, max_deviation: Option<f64>) -> HullDefinition {
        let simplification = Some(Simplification { max_vertices, max_deviation });
        HullDefinition { simplification, ..tetrahedron() }
    }

    /// Catches a field that is written but not read, or read in another place.
    #[test]
    fn bytes_read_back() {
        let plain = tetrahedron();
        let with_point = HullDefinition { contraction_point: Some([0.1, 0.2, 0.3]), ..tetrahedron() };
        let both = HullDefinition { contraction_point: Some([0.1; 3]), ..simplified(Some(9), Some(0.5)) };
        let one = [simplified(Some(9), None), simplified(None, Some(0.5)), simplified(None, None)];
        let flat = HullDefinition { planarity: Some(0.0), ..tetrahedron() };
        let every = HullDefinition { planarity: Some(1e-3), ..both.clone() };
        for definition in [plain, with_point, both, flat, every].into_iter().chain(one) {
            let bytes = definition.identity_bytes();
            assert_eq!(HullDefinition::from_identity_bytes(&bytes), Some(definition));
        }
    }

    /// Catches a truncated or padded blob that is read as a smaller hull.
    #[test]
    fn every_truncation_and_padding_is_refused() {
        let flat = HullDefinition { planarity: Some(1e-3), ..tetrahedron() };
        for definition in [tetrahedron(), simplified(Some(9), Some(0.5)), flat] {
            let bytes = definition.identity_bytes();
            for length in 0..bytes.len() {
                assert_eq!(HullDefinition::from_identity_bytes(&bytes[..length]), None, "{length}");
            }
            assert_eq!(HullDefinition::from_identity_bytes(&[&bytes[..], &[0]].concat()), None);
        }
    }

    /// Catches two ids for one hull, and one id for two hulls.
    #[test]
    fn the_sign_of_zero_is_no_content_and_the_point_is() {
        let plain = id_of(&tetrahedron().identity_bytes());
        let mut signed = tetrahedron();
        signed.points[0] = [-0.0, 0.0, -0.0];
        assert_eq!(id_of(&signed.identity_bytes()), plain);
        let with_point = HullDefinition { contraction_point: Some([0.25; 3]), ..tetrahedron() };
        assert_ne!(id_of(&with_point.identity_bytes()), plain);
        let zeros = [0.0, -0.0].map(|zero| id_of(&simplified(None, Some(zero)).identity_bytes()));
        assert_eq!(zeros[0], zeros[1]);
        assert_ne!(zeros[0], plain);
        let planarities = [0.0, -0.0, 1e-6].map(|planarity| {
            id_of(&HullDefinition { planarity: Some(planarity), ..tetrahedron() }.identity_bytes())
        });
        assert_eq!(planarities[0], planarities[1]);
        assert_ne!(planarities[0], plain);
        // A hull that is registered with the default planarity as an explicit value is a different
        // hull.
        assert_ne!(planarities[2], plain);
    }

    /// Catches an id that does not survive the round trip through its text.
    #[test]
    fn ids_read_back() {
        let id = id_of(b"any");
        assert_eq!(id.to_string().parse(), Ok(id));
        for text in ["", "0", &"g".repeat(64), &"A".repeat(64), &"0".repeat(65)] {
            assert_eq!(text.parse::<HullId>(), Err(NotAnId), "{text}");
        }
    }
}
