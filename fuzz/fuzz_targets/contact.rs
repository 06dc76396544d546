//! Any pair with any options is answered as its certificate says, cold and warm.
#![no_main]

use hullcast::contact::{
    Accuracy, Basis, Body, ConvexHull, HullOptions, Pose, Query, Solver, Wanted, Workspace, certificate,
    contact_manifold,
};
use hullcast_fuzz::Bytes;
use libfuzzer_sys::fuzz_target;

fn hull(bytes: &mut Bytes<'_>) -> Option<ConvexHull> {
    let contraction_point = (bytes.below(4) == 0).then(|| bytes.point());
    let options = HullOptions { contraction_point, ..HullOptions::default() };
    ConvexHull::with_options(&bytes.points(24), &options).ok()
}

fn query(bytes: &mut Bytes<'_>) -> Query {
    let margin = [0.0, f64::INFINITY, 1e-9, 0.01, 1.0][usize::from(bytes.below(5))];
    let wanted = [Wanted::Points, Wanted::Points, Wanted::Growth, Wanted::Outcome][usize::from(bytes.below(4))];
    let accuracy = Accuracy {
        solver: [Solver::Portal, Solver::GjkRayCast][usize::from(bytes.below(2))],
        relative_tolerance: [0.0, 0.0, 1e-9, 1e-3, 1.0][usize::from(bytes.below(5))],
        feature_angle: [0.01, 0.0, 0.5][usize::from(bytes.below(3))],
        max_points: [0, 1, 4][usize::from(bytes.below(3))],
        max_iterations: [1000, 1000, 1, 5][usize::from(bytes.below(4))],
    };
    Query { margin, accuracy, wanted }
}

fuzz_target!(|data: &[u8]| {
    let bytes = &mut Bytes(data);
    let query = query(bytes);
    let (Some(a), Some(b)) = (hull(bytes), hull(bytes)) else { return };
    let mut pose = || Pose::new(bytes.point(), bytes.rotation()).ok();
    let (Some(pose_a), Some(pose_b)) = (pose(), pose()) else { return };
    let (a, b) = (Body::new(&a, pose_a), Body::new(&b, pose_b));
    let workspace = &mut Workspace::default();
    let mut warm: Option<Basis> = None;
    for _ in 0..2 {
        let answer = contact_manifold(&a, &b, &query, warm.as_ref(), workspace);
        // An outcome alone promises no numbers.
        if query.wanted != Wanted::Outcome
            && let Err(violation) = certificate::check(&a, &b, &query, answer)
        {
            panic!("{violation}\n{query:?}\n{answer:?}\n{a:?}\n{b:?}");
        }
        warm = answer.basis.or(Some(Basis { a: [0, 1, 2], b: [2, 1, u32::MAX] }));
    }
});
