//! A validated, immutable convex hull: vertices, faces, edges, adjacency,
//! contraction point.

use glam::{DMat3, DVec3};

use super::stop::{Meter, Stop};

mod access;
mod boundary;
mod boxes;
mod build;
mod cloud;
mod csr;
mod error;
mod face;
mod isolation;
mod mass;
mod merge;
mod quickhull;
mod simplify;
mod solid;
mod topology;
mod triangulation;

pub(crate) use boxes::{BoxShape, octant};
pub(crate) use csr::Csr;
pub use error::{BuildError, HullError, HullErrorKind};
pub use face::Face;
pub use simplify::Simplification;
#[doc(hidden)]
pub use triangulation::Triangulation;

/// How a hull is built.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HullOptions {
    /// Strictly inside; absent: the centre of mass. Hull frame, caller's units.
    pub contraction_point: Option<[f64; 3]>,
    /// More extreme vertices than this are refused.
    pub max_vertices: usize,
    /// Fewer vertices, about the contraction point of the whole hull; absent: all.
    pub simplification: Option<Simplification>,
    /// How far the vertices of one face may lie from one plane: a share of the circumradius from
    /// 0 (only rounding) to [`MAX_PLANARITY`]; absent: [`ABSENT_PLANARITY`]. At most 1/64 of
    /// the inradius is allowed however large this is.
    pub planarity: Option<f64>,
}

/// The largest planarity that a hull may be registered with, a share of the circumradius.
pub const MAX_PLANARITY: f64 = 0.01;
/// The planarity of hulls that are registered without one. It never changes: the faces of
/// stored hulls depend on it.
pub const ABSENT_PLANARITY: f64 = 1e-6;

impl Default for HullOptions {
    fn default() -> Self {
        Self { contraction_point: None, max_vertices: 16_384, simplification: None, planarity: None }
    }
}

/// A convex hull, ready for queries.
///
/// Lengths are kept in *hull units*: relative to the contraction point and
/// divided by [`ConvexHull::scale`], a power of two that brings the
/// circumradius into [0.5, 1), so that scaling a hull by a power of two changes
/// no bit here.
#[derive(Clone, Debug, PartialEq)]
pub struct ConvexHull {
    /// Extreme vertices, hull units, in registered order.
    pub(super) vertices: Vec<DVec3>,
    /// The same, for the support mapping.
    pub(super) columns: super::support::Columns,
    /// Of boxes about the contraction point.
    box_shape: Option<BoxShape>,
    /// Of large hulls.
    pub(super) support_map: Option<super::support::SupportMap>,
    /// Per vertex its index among the points as registered; ascending.
    registered: Vec<u32>,
    /// Points as registered.
    registered_count: u32,
    /// Of a simplified hull: upper bound of its Hausdorff distance to the whole; caller's units.
    deviation: f64,
    /// Power of two: caller's units per hull unit.
    scale: f64,
    /// Hull frame, caller's units.
    contraction_point: DVec3,
    /// From the hull frame's origin.
    contraction_distance: f64,
    /// Of the largest ball about the contraction point inside, rounded down; hull units.
    inradius: f64,
    /// Of the smallest ball about the contraction point around, rounded up; hull units.
    circumradius: f64,
    /// Caller's units: cubic, length, and length^5.
    volume: f64,
    center_of_mass: DVec3,
    /// About the centre of mass, unit density.
    inertia: DMat3,
    /// As registered, or [`ABSENT_PLANARITY`].
    planarity: f64,
    /// How far vertices are from their faces' planes, and vertices between an edge's ends from
    /// its line, at most; hull units.
    merge_error: f64,
    /// After merging coplanar triangles.
    faces: Vec<Face>,
    /// Per face: its corners, anticlockwise from outside.
    outlines: Csr,
    /// Corners of the face that has the most.
    largest_face: u32,
    /// Per face: the faces across its edges, ascending.
    face_neighbours: Csr,
    /// Lower vertex first; ascending.
    edge_vertices: Vec<[u32; 2]>,
    /// Per edge: the face on the left of going from the lower to the higher
    /// vertex seen from outside, and the one on the right.
    edge_faces: Vec<[u32; 2]>,
    /// Per vertex: faces (groups) with a triangle at it, ascending.
    vertex_faces: Csr,
    /// Per vertex: edges ending in it, ascending.
    vertex_edges: Csr,
    /// Per vertex: its neighbours along the triangulation, ascending.
    pub(super) vertex_neighbours: Csr,
}

impl ConvexHull {
    /// The hull of `points`, about its centre of mass.
    ///
    /// `points` are in the caller's units, hull frame. Exact duplicates are
    /// welded, points inside dropped; every extreme vertex is kept, none moved.
    ///
    /// # Errors
    /// [`HullErrorKind`] lists the clouds that are no hull.
    pub fn new(points: &[[f64; 3]]) -> Result<Self, HullError> {
        Self::with_options(points, &HullOptions::default())
    }

    /// The hull of `points` as `options` say; see [`ConvexHull::new`].
    ///
    /// ```
    /// use hullcast::contact::{ConvexHull, HullOptions, Simplification};
    ///
    /// let ring = (0..32).map(|i| (11.25 * f64::from(i)).to_radians());
    /// let wheel: Vec<[f64; 3]> =
    ///     ring.flat_map(|t| [-0.1, 0.1].map(|z| [t.cos(), t.sin(), z])).collect();
    /// let simplification = Some(Simplification { max_vertices: None, max_deviation: Some(0.1) });
    /// let hull = ConvexHull::with_options(&wheel, &HullOptions { simplification, ..HullOptions::default() })?;
    /// assert!(hull.vertex_count() < 32 && hull.deviation() <= 0.1);
    /// # Ok::<(), hullcast::contact::HullError>(())
    /// ```
    ///
    /// # Errors
    /// [`HullErrorKind`] lists the clouds that are no hull.
    pub fn with_options(points: &[[f64; 3]], options: &HullOptions) -> Result<Self, HullError> {
        Self::with_options_stoppable(points, options, &Stop::default()).map_err(never_stopped)
    }

    /// The hull of `points` as `options` say, unless `stop` ends the build before: the build
    /// counts its steps there and looks at the flag about once a millisecond.
    ///
    /// ```
    /// use hullcast::contact::{BuildError, ConvexHull, HullOptions, Stop};
    ///
    /// let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    /// let stop = Stop::default();
    /// let hull = ConvexHull::with_options_stoppable(&corners, &HullOptions::default(), &stop)?;
    /// assert!(hull.vertex_count() == 4 && stop.steps() > 0);
    /// # Ok::<(), BuildError>(())
    /// ```
    ///
    /// # Errors
    /// [`HullErrorKind`] lists the clouds that are no hull; the build was stopped.
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
                "planarity is {share}, must be from 0 to {MAX_PLANARITY} (a share of the circumradius)"
            ),
        }),
        _ => Ok(()),
    }
}

/// The error of a build that nobody can stop.
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

/// The triangles of which the hull of `points` is made, over indices of
/// `points`: for tests of their exactness.
#[doc(hidden)]
pub fn triangulate(points: &[[f64; 3]]) -> Result<Triangulation, HullError> {
    let stop = Stop::default();
    let solid = solid::Solid::new(points, &Meter::new(&stop)).map_err(never_stopped)?;
    let solid::Solid { registered, mut triangulation, .. } = solid;
    triangulation.triangles.iter_mut().flatten().for_each(|v| *v = registered[*v as usize]);
    Ok(triangulation)
}
