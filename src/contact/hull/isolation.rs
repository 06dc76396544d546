//! How far a face stands apart from the rest of its hull: far enough, and a
//! direction near its normal touches it and nothing else.

use glam::DVec3;

use super::Csr;

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
    /// along the face's normal; hull units. By convexity the highest of the others
    /// is a neighbour of one of the face's own.
    pub(crate) gap: f64,
}

/// Of each face.
pub(super) fn isolation(
    vertices: &[DVec3],
    planes: impl ExactSizeIterator<Item = (DVec3, f64, f64)>,
    vertex_faces: &Csr,
    neighbours: &Csr,
) -> Vec<Isolation> {
    let planes: Vec<(DVec3, f64, f64)> = planes.collect();
    let mut isolation = vec![Isolation { cosine: -1.0, gap: f64::INFINITY }; planes.len()];
    for v in 0..vertices.len() {
        let faces = vertex_faces.row(v);
        if faces.len() > MOST_FACES {
            faces.iter().for_each(|&f| isolation[f as usize].cosine = 1.0);
            continue;
        }
        for (i, &f) in faces.iter().enumerate() {
            let normal = planes[f as usize].0;
            let mut closest = isolation[f as usize].cosine;
            for &g in &faces[i + 1..] {
                let cosine = normal.dot(planes[g as usize].0);
                closest = closest.max(cosine);
                let other = &mut isolation[g as usize].cosine;
                *other = other.max(cosine);
            }
            isolation[f as usize].cosine = closest;
        }
    }
    let face_vertices = vertex_faces.transposed(planes.len());
    // Per vertex the face, plus one, that was last found to have it.
    let mut known = vec![0_u32; vertices.len()];
    for (f, (isolation, &(normal, offset, planarity))) in (1..).zip(isolation.iter_mut().zip(&planes)) {
        let own = face_vertices.row(f as usize - 1);
        own.iter().for_each(|&v| known[v as usize] = f);
        for &v in own.iter().filter(|&&v| vertex_faces.row(v as usize).len() <= MOST_FACES) {
            for &w in neighbours.row(v as usize).iter().filter(|&&w| known[w as usize] != f) {
                let gap = offset - planarity - normal.dot(vertices[w as usize]);
                isolation.gap = isolation.gap.min(gap);
            }
        }
    }
    isolation
}
