//! Reading a hull.

use glam::{DMat3, DVec3};

use super::{BoxShape, ConvexHull, Csr, Face};
use crate::contact::support::{Columns, SupportMap};

/// In the caller's units, hull frame.
impl ConvexHull {
    /// Extreme vertices kept.
    pub fn vertex_count(&self) -> usize {
        self.vertices.len()
    }

    /// Faces after merging coplanar triangles.
    pub fn face_count(&self) -> usize {
        self.faces.len()
    }

    /// Corners of the face that has the most.
    pub fn largest_face(&self) -> usize {
        self.largest_face as usize
    }

    /// Edges between faces.
    pub fn edge_count(&self) -> usize {
        self.edge_vertices.len()
    }

    /// Points as registered.
    pub fn registered_count(&self) -> usize {
        self.registered_count as usize
    }

    /// Per vertex its index among the points as registered; ascending.
    pub fn registered_indices(&self) -> &[u32] {
        &self.registered
    }

    /// The vertex with this registered index, if it was kept.
    pub fn vertex_of_registered(&self, index: u32) -> Option<u32> {
        self.registered.binary_search(&index).ok().map(|v| v as u32)
    }

    /// Cubic units.
    pub fn volume(&self) -> f64 {
        self.volume
    }

    /// Hull frame.
    pub fn center_of_mass(&self) -> DVec3 {
        self.center_of_mass
    }

    /// About the centre of mass at unit density; units to the fifth.
    pub fn inertia(&self) -> DMat3 {
        self.inertia
    }

    /// The point about which the hull grows; hull frame.
    pub fn contraction_point(&self) -> DVec3 {
        self.contraction_point
    }

    /// Of the largest ball about the contraction point inside, rounded down.
    pub fn inradius(&self) -> f64 {
        self.inradius * self.scale
    }

    /// Of the smallest ball about the contraction point around, rounded up.
    pub fn circumradius(&self) -> f64 {
        self.circumradius * self.scale
    }

    /// How far a face's vertices are from its plane at most, rounded up, and what
    /// simplification cost.
    pub fn geometric_error(&self) -> f64 {
        self.faces.iter().map(|face| face.planarity).fold(0.0, f64::max) * self.scale + self.deviation
    }

    /// How far the vertices of one face were allowed to lie from one plane, as a share of the
    /// circumradius. How far they do lie is in [`ConvexHull::geometric_error`].
    pub fn planarity(&self) -> f64 {
        self.planarity
    }

    /// Certified upper bound of the Hausdorff distance to the hull of all points; 0 where
    /// none was left out.
    pub fn deviation(&self) -> f64 {
        self.deviation
    }

    /// Corners of face `i`, anticlockwise from outside, as registered indices.
    pub fn face_outline(&self, i: usize) -> impl ExactSizeIterator<Item = u32> + '_ {
        self.outlines.row(i).iter().map(|&v| self.registered[v as usize])
    }

    /// Unit outward normal of face `i`, hull frame.
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

/// In hull units: about the contraction point, divided by [`ConvexHull::scale`].
/// Vertices, faces and edges are numbered from 0 in this hull's own order.
impl ConvexHull {
    /// The box that this hull is, if it is one about its contraction point.
    pub(crate) fn box_shape(&self) -> Option<&BoxShape> {
        self.box_shape.as_ref()
    }

    /// Vertex `i`.
    #[inline]
    pub(crate) fn vertex(&self, i: u32) -> DVec3 {
        self.vertices[i as usize]
    }

    /// How far vertices are from their faces' planes, and vertices between an edge's ends from
    /// its line, at most.
    #[inline]
    pub(crate) fn merge_error(&self) -> f64 {
        self.merge_error
    }

    /// The vertices as columns.
    pub(crate) fn columns(&self) -> &Columns {
        &self.columns
    }

    /// Of the contraction point from the hull frame's origin; caller's units.
    pub(crate) fn contraction_distance(&self) -> f64 {
        self.contraction_distance
    }

    /// Power of two: caller's units per hull unit.
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// Extreme vertices, in registered order.
    pub fn vertices(&self) -> &[DVec3] {
        &self.vertices
    }

    /// [`ConvexHull::inradius`], hull units.
    pub fn unit_inradius(&self) -> f64 {
        self.inradius
    }

    /// [`ConvexHull::circumradius`], hull units: in [0.5, 1).
    pub fn unit_circumradius(&self) -> f64 {
        self.circumradius
    }

    /// Faces, after merging coplanar triangles.
    pub fn faces(&self) -> &[Face] {
        &self.faces
    }

    /// Corners of face `i`, anticlockwise from outside.
    pub fn outline(&self, i: usize) -> &[u32] {
        self.outlines.row(i)
    }

    /// Faces across the edges of face `i`, ascending.
    pub fn face_neighbours(&self, i: usize) -> &[u32] {
        self.face_neighbours.row(i)
    }

    /// Ends of each edge, lower vertex first; ascending.
    pub fn edge_vertices(&self) -> &[[u32; 2]] {
        &self.edge_vertices
    }

    /// Per edge: the face on the left of going from the lower to the higher
    /// vertex seen from outside, and the one on the right.
    pub fn edge_faces(&self) -> &[[u32; 2]] {
        &self.edge_faces
    }

    /// Faces with a triangle at vertex `i`, ascending.
    pub fn vertex_faces(&self, i: usize) -> &[u32] {
        self.vertex_faces.row(i)
    }

    /// Edges ending in vertex `i`, ascending; none for a vertex inside a face.
    pub fn vertex_edges(&self, i: usize) -> &[u32] {
        self.vertex_edges.row(i)
    }

    /// Neighbours of vertex `i` along the triangulation, ascending.
    pub fn vertex_neighbours(&self, i: usize) -> &[u32] {
        self.vertex_neighbours.row(i)
    }
}
