//! How far a face stands apart from the rest of its hull: far enough, and a
//! direction near its normal touches it and nothing else.

use super::Csr;
use super::merge::Plane;
use crate::contact::stop::{Meter, Stopped};

/// Vertices with more faces than this are not looked around: a fan of n faces
/// has n^2 pairs. Their faces count as not apart from anything.
const MOST_FACES: usize = 64;

/// Of a face.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Isolation {
    /// Of the angles to the normals of faces that share a vertex, the cosine of
    /// the smallest.
    pub(crate) cosine: f64,
    /// How much lower than all of the face's own vertices every other one lies,
    /// along the face's normal; hull units.
    pub(crate) gap: f64,
}

/// Of each plane.
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
