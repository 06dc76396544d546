//! Hulls and their ids.

use std::{fmt, str::FromStr};

use hullcast_proto::{HullDefinition, Simplification};
use sha2::{Digest, Sha256};

/// The first bytes of the hashed content.
const MAGIC: &[u8; 8] = b"hullcast";
/// The version of contents without a planarity.
const FORMAT: u32 = 1;
/// The version of contents with a planarity.
const FORMAT_WITH_PLANARITY: u32 = 2;

/// The name of a hull: the SHA-256 of its content, so that the same hull has the same id on every server
/// (docs/identity.md).
///
/// It is displayed as 64 lower-case hexadecimal digits, and parsed from them.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct HullId(pub [u8; 32]);

/// The text is not 64 lower-case hexadecimal digits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the id of a hull is 64 lower-case hexadecimal digits")]
pub struct NotAnId;

/// The definition of a convex hull: a cloud of points, and options.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Hull {
    /// The points, in the hull's own frame and the caller's unit of length. At least 4 distinct points that
    /// are not all in one plane. Points inside the hull of the others are allowed; the server drops them.
    pub points: Vec<[f64; 3]>,
    /// The point about which the hull grows, strictly inside it. `None` means the centre of mass.
    pub contraction_point: Option<[f64; 3]>,
    /// Keeps only a subset of the vertices. `None` means that the hull keeps all of them.
    pub simplification: Option<Simplification>,
    /// The distance that the vertices of one face may have from one plane, as a fraction of the circumradius:
    /// 0 to 0.01. `None` means 1e-6. Coordinates that were rounded in a file need more.
    pub planarity: Option<f64>,
}

impl Hull {
    /// The hull of these points, without options.
    pub fn new(points: impl Into<Vec<[f64; 3]>>) -> Self {
        Self { points: points.into(), ..Self::default() }
    }

    /// The id that every server gives to this hull.
    pub fn id(&self) -> HullId {
        let mut content = Vec::with_capacity(72 + 24 * self.points.len());
        content.extend_from_slice(MAGIC);
        let format = if self.planarity.is_some() { FORMAT_WITH_PLANARITY } else { FORMAT };
        content.extend_from_slice(&format.to_le_bytes());
        content.push(self.contraction_point.is_some().into());
        content.extend(self.contraction_point.iter().flatten().copied().flat_map(written));
        content.push(self.simplification.is_some().into());
        if let Some(Simplification { max_vertices, max_deviation }) = self.simplification {
            content.push(max_vertices.is_some().into());
            content.extend(max_vertices.into_iter().flat_map(u32::to_le_bytes));
            content.push(max_deviation.is_some().into());
            content.extend(max_deviation.into_iter().flat_map(written));
        }
        content.extend(self.planarity.into_iter().flat_map(written));
        content.extend_from_slice(&(self.points.len() as u32).to_le_bytes());
        content.extend(self.points.as_flattened().iter().copied().flat_map(written));
        HullId(Sha256::digest(&content).into())
    }

    pub(crate) fn definition(&self) -> HullDefinition {
        HullDefinition {
            vertices: self.points.as_flattened().to_vec(),
            contraction_point: self.contraction_point.map(Vec::from).unwrap_or_default(),
            simplification: self.simplification,
            planarity: self.planarity,
        }
    }
}

/// A number as the content has it. -0.0 is written as 0.0; the bits of every other number stay.
fn written(number: f64) -> [u8; 8] {
    (number + 0.0).to_le_bytes()
}

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

#[cfg(test)]
mod tests {
    use super::*;

    /// Compares the ids with the test vectors of docs/identity.md. Catches an id that the server would not
    /// give to the hull.
    #[test]
    fn ids_are_those_of_the_test_vectors() {
        let page = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/identity.md"));
        let page = page.expect("the page");
        let block = page.split("```json\n").nth(1).and_then(|rest| rest.split("```").next());
        let vectors: Vec<serde_json::Value> = serde_json::from_str(block.expect("a block")).expect("JSON");
        let numbers = |value: &serde_json::Value| -> Option<Vec<f64>> {
            Some(value.as_array()?.iter().map(|number| number.as_f64().expect("a number")).collect())
        };
        for vector in &vectors {
            let (max_vertices, max_deviation) =
                (vector["max_vertices"].as_u64(), vector["max_deviation"].as_f64());
            let is_simplified = max_vertices.is_some() || max_deviation.is_some();
            let hull = Hull {
                points: numbers(&vector["vertices"]).expect("vertices").as_chunks().0.to_vec(),
                contraction_point: numbers(&vector["contraction_point"]).map(|p| [p[0], p[1], p[2]]),
                simplification: is_simplified.then(|| Simplification {
                    max_vertices: max_vertices.map(|count| u32::try_from(count).expect("a count")),
                    max_deviation,
                }),
                planarity: vector["planarity"].as_f64(),
            };
            assert_eq!(hull.id().to_string(), vector["id"].as_str().expect("an id"), "{}", vector["name"]);
        }
        assert_eq!(vectors.len(), 8);
    }

    /// Catches an id that does not survive the round trip through its text.
    #[test]
    fn ids_read_back() {
        let id = Hull::default().id();
        assert_eq!(id.to_string().parse(), Ok(id));
        for text in ["", "0", &"g".repeat(64), &"A".repeat(64), &"0".repeat(65)] {
            assert_eq!(text.parse::<HullId>(), Err(NotAnId), "{text}");
        }
    }
}
