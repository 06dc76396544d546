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
        for &f in faces {
            let (normal, offset, planarity) = planes[f as usize];
            let of = &mut isolation[f as usize];
            if faces.len() > MOST_FACES {
                of.cosine = 1.0;
                continue;
            }
            for &g in faces.iter().filter(|&&g| g != f) {
                of.cosine = of.cosine.max(normal.dot(planes[g as usize].0));
            }
            for &w in neighbours.row(v) {
                if vertex_faces.row(w as usize).binary_search(&f).is_err() {
                    of.gap = of.gap.min(offset - planarity - normal.dot(vertices[w as usize]));
                }
            }
        }
    }
    isolation
}
