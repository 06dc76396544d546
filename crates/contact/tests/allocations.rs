//! A pair allocates nothing once the workspace's buffers have grown.

mod scene;

use hullcast_contact::{
    Accuracy, Body, ConvexHull, Outcome, Query, Solver, Wanted, Workspace, contact_manifold,
};
use scene::{IDENTITY, Random, at, box_hull, cloud, hull, prism_points, scaled};

/// Solves 2000 pairs with both solvers twice and counts the allocations of the second pass. Catches
/// a buffer that is made anew for every pair. The counts of outcomes show that reduction, estimates
/// and separation were all exercised.
#[test]
fn pairs_allocate_nothing_once_the_buffers_have_grown() {
    let random = &mut Random::new(12);
    let shapes: Vec<ConvexHull> = vec![
        box_hull([0.5, 0.7, 0.3]),
        hull(&prism_points(24, 0.6, 0.4)),
        hull(&cloud(random, 64, [0.5, 0.6, 0.7])),
        hull(&cloud(random, 600, [0.5, 0.6, 0.7])),
        box_hull([0.8, 0.6, 1e-3]),
    ];
    let bodies: Vec<[Body<'_>; 2]> = (0..2000)
        .map(|_| {
            let [a, b] = [random.below(5), random.below(5)].map(|i| &shapes[i]);
            let position = scaled(random.direction(), random.range(0.0, 1.5));
            // Aligned hulls rest face on face.
            let rotations =
                if random.below(2) == 0 { [IDENTITY; 2] } else { [(); 2].map(|()| random.rotation()) };
            [at(a, [0.0; 3], rotations[0]), at(b, position, rotations[1])]
        })
        .collect();
    let queries = Solver::ALL.map(|solver| {
        [(0.01, 0), (f64::INFINITY, 4)].map(|(margin, max_points)| {
            let accuracy = Accuracy { solver, max_points, ..Accuracy::default() };
            Query { margin, accuracy, wanted: Wanted::Points }
        })
    });
    let mut workspace = Workspace::default();
    let mut pass = || {
        let (mut reduced, mut estimated, mut apart) = (0, 0, 0);
        for query in queries.as_flattened() {
            for [a, b] in &bodies {
                let m = contact_manifold(a, b, query, None, &mut workspace);
                reduced += usize::from(m.flags.reduced);
                estimated += usize::from(m.flags.estimated);
                apart += usize::from(m.outcome == Outcome::Separated);
            }
        }
        (reduced, estimated, apart)
    };
    pass();
    let (mut reduced, mut estimated, mut apart) = (0, 0, 0);
    let counted = allocation_counter::measure(|| (reduced, estimated, apart) = pass());
    assert!(reduced > 200 && estimated > 500 && apart > 500, "{reduced} {estimated} {apart}");
    assert_eq!(counted.count_total, 0, "allocations in 8000 pairs");
}
