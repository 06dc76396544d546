//! A validated, immutable convex hull: vertices, faces, edges, adjacency, contraction point.
//!
//! A hull is built from a cloud of points in these steps, one file per step:
//!
//! ```text
//! cloud      check the points, weld duplicates, sort what is left
//! quickhull  triangulate the hull of the points, decided by exact predicates
//! solid      number the vertices as registered, compute normals, move the hull to hull units
//! mass       volume, centre of mass and inertia
//! merge      group nearly coplanar triangles into faces
//! topology   edges and outlines of the faces (boundary: edges of faces of several triangles)
//! isolation  measure how far each face stands apart from its neighbours
//! boxes      recognise boxes
//! ```
//!
//! Everything up to the triangulation is exact. A tolerance enters only when triangles are
//! merged into faces. `build` calls the steps in order; `simplify` builds hulls of fewer vertices.

use glam::{DMat3, DVec3};

use super::csr::Csr;
use super::stop::{Meter, Stop};

mod access;
mod boundary;
mod boxes;
mod build;
mod cloud;
mod edge;
mod error;
mod face;
mod isolation;
mod mass;
mod merge;
mod quickhull;
mod simplify;
mod solid;
mod support;
mod topology;
mod triangulation;

pub(crate) use boxes::{BoxRow, BoxShape, octant};
pub use error::{BuildError, HullError, HullErrorKind};
pub use face::Face;
pub use simplify::Simplification;
pub use triangulation::Triangulation;

/// Options for building a hull.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HullOptions {
    /// The contraction point, which must be strictly inside the hull. Hull frame, caller's
    /// units. If absent, the hull uses its centre of mass.
    pub contraction_point: Option<[f64; 3]>,
    /// The largest allowed number of vertices of the hull that is kept: all extreme vertices, or
    /// the vertices that simplification leaves. A hull with more is refused.
    pub max_vertices: usize,
    /// How to simplify the hull. The simplified hull keeps the contraction point of the whole
    /// hull. If absent, the hull keeps all extreme vertices.
    pub simplification: Option<Simplification>,
    /// How far the vertices of one face may lie from the plane of the face: a fraction of the
    /// circumradius, from 0 (rounding only) to [`MAX_PLANARITY`]. If absent, the hull uses
    /// [`ABSENT_PLANARITY`]. The allowed distance never exceeds 1/64 of the inradius.
    pub planarity: Option<f64>,
}

/// The largest planarity that a hull may be registered with: a fraction of the circumradius.
pub const MAX_PLANARITY: f64 = 0.01;
/// The planarity of hulls that are registered without one: a fraction of the circumradius. This
/// value must never change, because the faces of stored hulls depend on it.
pub const ABSENT_PLANARITY: f64 = 1e-6;

impl Default for HullOptions {
    fn default() -> Self {
        Self { contraction_point: None, max_vertices: 16_384, simplification: None, planarity: None }
    }
}

/// A convex hull, ready for queries.
///
/// The geometry is stored in *hull units*: positions are relative to the contraction point and
/// divided by [`ConvexHull::scale`], a power of two that brings the circumradius into [0.5, 1).
/// Scaling a hull by a power of two therefore changes no bit of the geometry in hull units.
#[derive(Clone, Debug, PartialEq)]
pub struct ConvexHull {
    /// The extreme vertices, in hull units and in registered order.
    pub(super) vertices: Vec<DVec3>,
    /// The extreme vertices by coordinate, for the support mapping.
    pub(super) columns: super::support::Columns,
    /// The box that the hull is, if the hull is a box about its contraction point.
    box_shape: Option<BoxShape>,
    /// The row that lanes read, if the hull is a box along its frame's axes to rounding.
    box_row: Option<BoxRow>,
    /// The map of directions; present for large hulls only.
    pub(super) support_map: Option<super::support::SupportMap>,
    /// For each vertex, its index among the registered points; ascending.
    registered: Vec<u32>,
    /// The number of registered points.
    registered_count: u32,
    /// An upper bound of the Hausdorff distance between a simplified hull and the whole hull;
    /// caller's units. 0 for a hull that is not simplified.
    deviation: f64,
    /// A power of two: caller's units per hull unit.
    scale: f64,
    /// Hull frame, caller's units.
    contraction_point: DVec3,
    /// Distance of the contraction point from the origin of the hull frame; caller's units.
    contraction_distance: f64,
    /// Radius of the largest ball about the contraction point that lies inside the hull, rounded
    /// down; hull units.
    inradius: f64,
    /// Radius of the smallest ball about the contraction point that contains the hull, rounded
    /// up; hull units.
    circumradius: f64,
    /// Caller's units cubed.
    volume: f64,
    /// Hull frame, caller's units.
    center_of_mass: DVec3,
    /// About the centre of mass at unit density, in the axes of the hull frame; caller's units to
    /// the fifth power.
    inertia: DMat3,
    /// The planarity that the hull was registered with, or [`ABSENT_PLANARITY`].
    planarity: f64,
    /// The largest distance of a vertex from the plane of one of its faces, or of a vertex that
    /// was straightened away from the line of its edge; hull units.
    merge_error: f64,
    /// The faces, after nearly coplanar triangles were merged.
    faces: Vec<Face>,
    /// For each face, its corners, anticlockwise seen from outside.
    outlines: Csr,
    /// The number of corners of the face that has the most corners.
    largest_face: u32,
    /// For each face, the faces across its edges; ascending.
    face_neighbours: Csr,
    /// For each edge, its two end vertices, the lower index first. The edges are ascending.
    edge_vertices: Vec<[u32; 2]>,
    /// For each edge, the faces on its left and on its right, seen from outside along the way
    /// from the lower vertex to the higher one.
    edge_faces: Vec<[u32; 2]>,
    /// For each vertex, the faces (groups) that have a triangle at the vertex; ascending.
    vertex_faces: Csr,
    /// For each vertex, the edges that end in it; ascending.
    vertex_edges: Csr,
    /// For each vertex, its neighbours along the triangulation; ascending.
    pub(super) vertex_neighbours: Csr,
}

impl ConvexHull {
    /// Builds the hull of `points`, with its centre of mass as the contraction point.
    ///
    /// `points` are in the hull frame and the caller's units. Exact duplicates are welded and
    /// points inside the hull are dropped. Every extreme vertex is kept, and none is moved.
    ///
    /// # Errors
    /// [`HullErrorKind`] lists the reasons for which a cloud of points has no hull.
    pub fn new(points: &[[f64; 3]]) -> Result<Self, HullError> {
        Self::with_options(points, &HullOptions::default())
    }

    /// Builds the hull of `points` according to `options`; see [`ConvexHull::new`].
    ///
    /// ```
    /// use hullcast_contact::{ConvexHull, HullOptions, Simplification};
    ///
    /// let ring = (0..32).map(|i| (11.25 * f64::from(i)).to_radians());
    /// let wheel: Vec<[f64; 3]> =
    ///     ring.flat_map(|t| [-0.1, 0.1].map(|z| [t.cos(), t.sin(), z])).collect();
    /// let simplification = Some(Simplification { max_vertices: None, max_deviation: Some(0.1) });
    /// let hull = ConvexHull::with_options(&wheel, &HullOptions { simplification, ..HullOptions::default() })?;
    /// assert!(hull.vertex_count() < 32 && hull.deviation() <= 0.1);
    /// # Ok::<(), hullcast_contact::HullError>(())
    /// ```
    ///
    /// # Errors
    /// [`HullErrorKind`] lists the reasons for which a cloud of points has no hull.
    pub fn with_options(points: &[[f64; 3]], options: &HullOptions) -> Result<Self, HullError> {
        Self::with_options_stoppable(points, options, &Stop::default()).map_err(never_stopped)
    }

    /// Builds the hull of `points` according to `options`, unless `stop` ends the build early.
    /// The build counts its steps in `stop` and checks the flag about once a millisecond.
    ///
    /// ```
    /// use hullcast_contact::{BuildError, ConvexHull, HullOptions, Stop};
    ///
    /// let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    /// let stop = Stop::default();
    /// let hull = ConvexHull::with_options_stoppable(&corners, &HullOptions::default(), &stop)?;
    /// assert!(hull.vertex_count() == 4 && stop.steps() > 0);
    /// # Ok::<(), BuildError>(())
    /// ```
    ///
    /// # Errors
    /// [`BuildError::Hull`] if the points have no hull ([`HullErrorKind`] lists the reasons), and
    /// [`BuildError::Stopped`] if the build was stopped.
    pub fn with_options_stoppable(
        points: &[[f64; 3]],
        options: &HullOptions,
        stop: &Stop,
    ) -> Result<Self, BuildError> {
        check_planarity(options.planarity)?;
        let meter = Meter::new(stop);
        match &options.simplification {
            None => build::build(points, options, &meter),
            Some(wanted) => simplify::simplified(points, options, wanted, &meter),
        }
    }
}

fn check_planarity(planarity: Option<f64>) -> Result<(), HullError> {
    match planarity {
        Some(share) if !(0.0..=MAX_PLANARITY).contains(&share) => Err(HullError {
            kind: HullErrorKind::PlanarityOutOfRange,
            index: None,
            detail: format!(
                "planarity is {}, must be from 0 to {MAX_PLANARITY} (a share of the circumradius)",
                error::plain(share)
            ),
        }),
        _ => Ok(()),
    }
}

/// Converts the error of a build that cannot be stopped, because no other code holds its [`Stop`].
fn never_stopped(error: BuildError) -> HullError {
    match error {
        BuildError::Hull(error) => error,
        BuildError::Stopped => HullError {
            kind: HullErrorKind::NotRepresentable,
            index: None,
            detail: "internal: the build was stopped, but nobody asked for it".to_owned(),
        },
    }
}

/// The surface of the hull of `points` as triangles, whose entries are indices into `points`. It is exact: no
/// point is outside a triangle's plane, and coplanar triangles are not merged into faces.
///
/// # Errors
/// The points have no hull ([`HullErrorKind`]).
pub fn triangulate(points: &[[f64; 3]]) -> Result<Triangulation, HullError> {
    let stop = Stop::default();
    let solid = solid::Solid::new(points, &Meter::new(&stop)).map_err(never_stopped)?;
    let solid::Solid { registered, mut triangulation, .. } = solid;
    triangulation.triangles.iter_mut().flatten().for_each(|v| *v = registered[*v as usize]);
    Ok(triangulation)
}
