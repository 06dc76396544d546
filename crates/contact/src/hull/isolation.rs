//! Measures how far each face stands apart from the rest of its hull.
//!
//! A query asks which feature of a hull a contact normal `n` touches. A face that stands apart
//! far enough answers without a search. Let `m` be the normal of the face, `a` the angle between
//! `n` and `m`, and `b` the feature angle, within which a face counts as touched. Two numbers of
//! the face then decide, both computed once when the hull is built:
//!
//! - The smallest angle `c` between `m` and the normal of another face that shares a vertex. If
//!   `a + b < c`, none of these other faces is within `b` of `n`.
//! - The gap: how much lower, along `m`, every other vertex is than the lowest vertex of the face.
//!   All vertices are within 1 of the contraction point, so along `n` the other vertices are still
//!   lower by at least `gap cos a - 2 sin a`. If that exceeds the depth within which a vertex
//!   counts as touched, only the vertices of the face are touched.
//!
//! ```text
//!            m  n
//!            | /          a is the angle between m and n
//!     o______|/______o    the face
//!    /                \   } gap
//!   o                  o  the next vertices
//! ```
//!
//! The gap comes from the merge. The angles take one pass over the pairs of faces at each vertex,
//! which is `O(n)` for `n` faces, because a vertex has a bounded number of pairs (at most 64
//! faces are compared).

use super::merge::Plane;
use crate::csr::Csr;
use crate::stop::{Meter, Stopped};

/// The faces of a vertex with more faces than this are not compared, because a fan of `n` faces
/// has `n^2` pairs. These faces count as not isolated.
const MOST_FACES: usize = 64;

/// How far a face stands apart from the rest of its hull.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Isolation {
    /// The cosine of the smallest angle between the normal of this face and that of another face
    /// that shares a vertex with it.
    pub(crate) cosine: f64,
    /// How much lower every other vertex is than the lowest vertex of the face, along the normal
    /// of the face; hull units.
    pub(crate) gap: f64,
}

/// The isolation of each plane.
pub(super) fn isolation(
    planes: &[Plane],
    vertex_faces: &Csr,
    meter: &Meter<'_>,
) -> Result<Vec<Isolation>, Stopped> {
    let mut cosines = vec![-1.0; planes.len()];
    for v in 0..vertex_faces.rows() {
        let faces = vertex_faces.row(v);
        let looked_at = faces.len().min(MOST_FACES) as u64;
        meter.spend(looked_at * looked_at + faces.len() as u64)?;
        if faces.len() > MOST_FACES {
            faces.iter().for_each(|&f| cosines[f as usize] = 1.0);
            continue;
        }
        for (i, &f) in faces.iter().enumerate() {
            let normal = planes[f as usize].normal;
            let mut closest: f64 = cosines[f as usize];
            for &g in &faces[i + 1..] {
                let cosine = normal.dot(planes[g as usize].normal);
                closest = closest.max(cosine);
                let other = &mut cosines[g as usize];
                *other = cosine.max(*other);
            }
            cosines[f as usize] = closest;
        }
    }
    Ok(cosines.into_iter().zip(planes).map(|(cosine, plane)| Isolation { cosine, gap: plane.gap }).collect())
}
