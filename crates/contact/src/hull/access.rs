//! Read access to a hull.

use glam::{DMat3, DVec3};

use super::{BoxRow, BoxShape, ConvexHull, Face};
use crate::csr::Csr;
use crate::support::{Columns, SupportMap};

/// Properties in the hull frame and the caller's units.
impl ConvexHull {
    /// The number of vertices: all extreme vertices, or those that simplification kept.
    pub fn vertex_count(&self) -> usize {
        self.vertices.len()
    }

    /// The number of faces, after nearly coplanar triangles were merged.
    pub fn face_count(&self) -> usize {
        self.faces.len()
    }

    /// The number of corners of the face that has the most corners.
    pub fn largest_face(&self) -> usize {
        self.largest_face as usize
    }

    /// The number of edges between faces.
    pub fn edge_count(&self) -> usize {
        self.edge_vertices.len()
    }

    /// The number of points that the hull was registered with.
    #[inline]
    pub fn registered_count(&self) -> usize {
        self.registered_count as usize
    }

    /// For each vertex, its index among the registered points; ascending.
    pub fn registered_indices(&self) -> &[u32] {
        &self.registered
    }

    /// The vertex with this registered index, if it was kept.
    pub fn vertex_of_registered(&self, index: u32) -> Option<u32> {
        self.registered.binary_search(&index).ok().map(|v| v as u32)
    }

    /// The volume; units cubed.
    pub fn volume(&self) -> f64 {
        self.volume
    }

    /// The centre of mass; hull frame.
    pub fn center_of_mass(&self) -> DVec3 {
        self.center_of_mass
    }

    /// The inertia tensor about the centre of mass at unit density, in the axes of the hull frame;
    /// units to the fifth power.
    pub fn inertia(&self) -> DMat3 {
        self.inertia
    }

    /// The contraction point, about which the hull is scaled; hull frame.
    pub fn contraction_point(&self) -> DVec3 {
        self.contraction_point
    }

    /// The radius of the largest ball about the contraction point that lies inside the hull,
    /// rounded down.
    pub fn inradius(&self) -> f64 {
        self.inradius * self.scale
    }

    /// The radius of the smallest ball about the contraction point that contains the hull, rounded
    /// up.
    pub fn circumradius(&self) -> f64 {
        self.circumradius * self.scale
    }

    /// The largest distance of a vertex from the plane of its face, rounded up, plus the
    /// [`ConvexHull::deviation`] of a simplified hull.
    pub fn geometric_error(&self) -> f64 {
        self.faces.iter().map(|face| face.planarity).fold(0.0, f64::max) * self.scale + self.deviation
    }

    /// How far the vertices of a face were allowed to lie from its plane, as a fraction of the
    /// circumradius. [`ConvexHull::geometric_error`] has the distance that was reached.
    pub fn planarity(&self) -> f64 {
        self.planarity
    }

    /// A certified upper bound of the Hausdorff distance to the hull of all points. It is 0 if no
    /// extreme vertex was left out.
    pub fn deviation(&self) -> f64 {
        self.deviation
    }

    /// The corners of face `i`, anticlockwise seen from outside, as registered indices.
    pub fn face_outline(&self, i: usize) -> impl ExactSizeIterator<Item = u32> + '_ {
        self.outlines.row(i).iter().map(|&v| self.registered[v as usize])
    }

    /// The outward unit normal of face `i`; hull frame.
    pub fn face_normal(&self, i: usize) -> DVec3 {
        self.faces[i].normal
    }

    /// Bytes held on the heap.
    pub fn heap_bytes(&self) -> usize {
        fn bytes<T>(v: &Vec<T>) -> usize {
            v.capacity() * size_of::<T>()
        }
        let lists = [
            &self.outlines,
            &self.face_neighbours,
            &self.vertex_faces,
            &self.vertex_edges,
            &self.vertex_neighbours,
        ];
        bytes(&self.vertices)
            + self.columns.heap_bytes()
            + self.support_map.as_ref().map_or(0, SupportMap::heap_bytes)
            + bytes(&self.registered)
            + bytes(&self.faces)
            + bytes(&self.edge_vertices)
            + bytes(&self.edge_faces)
            + lists.into_iter().map(Csr::heap_bytes).sum::<usize>()
    }
}

/// Properties in hull units: relative to the contraction point and divided by
/// [`ConvexHull::scale`]. Vertices, faces and edges are numbered from 0 in the order of this hull.
impl ConvexHull {
    /// The box that this hull is, or `None` if it is not a box about its contraction point.
    pub(crate) fn box_shape(&self) -> Option<&BoxShape> {
        self.box_shape.as_ref()
    }

    /// The row that lanes read, or `None` if the hull does not take part in lanes of boxes.
    #[inline]
    pub(crate) fn box_row(&self) -> Option<&BoxRow> {
        self.box_row.as_ref()
    }

    /// Vertex `i`.
    #[inline]
    pub(crate) fn vertex(&self, i: u32) -> DVec3 {
        self.vertices[i as usize]
    }

    /// The largest distance of a vertex from the plane of one of its faces, or of a vertex that
    /// was straightened away from the line of its edge.
    #[inline]
    pub(crate) fn merge_error(&self) -> f64 {
        self.merge_error
    }

    /// The vertices by coordinate.
    pub(crate) fn columns(&self) -> &Columns {
        &self.columns
    }

    /// The distance of the contraction point from the origin of the hull frame; caller's units.
    pub(crate) fn contraction_distance(&self) -> f64 {
        self.contraction_distance
    }

    /// The scale, a power of two: caller's units per hull unit.
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// The vertices, in registered order.
    pub fn vertices(&self) -> &[DVec3] {
        &self.vertices
    }

    /// [`ConvexHull::inradius`] in hull units.
    pub fn unit_inradius(&self) -> f64 {
        self.inradius
    }

    /// [`ConvexHull::circumradius`] in hull units; in [0.5, 1).
    pub fn unit_circumradius(&self) -> f64 {
        self.circumradius
    }

    /// The faces, after nearly coplanar triangles were merged.
    pub fn faces(&self) -> &[Face] {
        &self.faces
    }

    /// The corners of face `i`, anticlockwise seen from outside.
    pub fn outline(&self, i: usize) -> &[u32] {
        self.outlines.row(i)
    }

    /// The faces across the edges of face `i`; ascending.
    pub fn face_neighbours(&self, i: usize) -> &[u32] {
        self.face_neighbours.row(i)
    }

    /// The end vertices of each edge, the lower index first. The edges are ascending.
    pub fn edge_vertices(&self) -> &[[u32; 2]] {
        &self.edge_vertices
    }

    /// For each edge, the faces on its left and on its right, seen from outside along the way from
    /// the lower vertex to the higher one.
    pub fn edge_faces(&self) -> &[[u32; 2]] {
        &self.edge_faces
    }

    /// The faces that have a triangle at vertex `i`; ascending.
    pub fn vertex_faces(&self, i: usize) -> &[u32] {
        self.vertex_faces.row(i)
    }

    /// The edges that end in vertex `i`; ascending. A vertex inside a merged face has none.
    pub fn vertex_edges(&self, i: usize) -> &[u32] {
        self.vertex_edges.row(i)
    }

    /// The neighbours of vertex `i` along the triangulation; ascending.
    pub fn vertex_neighbours(&self, i: usize) -> &[u32] {
        self.vertex_neighbours.row(i)
    }
}
