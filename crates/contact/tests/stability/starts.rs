//! Answers agree within the error budget wherever the solver started: cold, from the pair's own basis, or
//! from the basis of a pose near or far. They need not have the same bits, because a facet of `K` with more
//! than three vertices has several bases, and the normal of each is rounded differently.

use glam::{DQuat, DVec3};
use hullcast_contact::workload::{Family, Regime, Workload};
use hullcast_contact::{
    Basis, Body, ConvexHull, Flags, Manifold, Outcome, Pose, Query, Workspace, certificate, contact_manifold,
};

const U: f64 = f64::EPSILON / 2.0;
/// How far B is moved for the answer whose basis is the start. The hulls' radii are about 0.3 to 1.
const MOTIONS: [f64; 4] = [0.0, 1e-3, 1e-1, 0.5];
const PAIRS: usize = 150;
const MARGIN: f64 = 0.005;

#[derive(Debug, Default)]
struct Counts {
    compared: usize,
    contacts: usize,
    same_bits: usize,
    points: usize,
    other_points: usize,
}

/// A pair, its cold answer, and the lengths of the error budget.
struct Started<'a> {
    bodies: [Body<'a>; 2],
    rotations: [DQuat; 2],
    query: Query,
    cold: Manifold,
    /// Sums of the inradii and of the circumradii.
    inradius: f64,
    circumradius: f64,
    /// The lengths that enter the centre offset.
    m: f64,
}

impl<'a> Started<'a> {
    fn new(bodies: [Body<'a>; 2], offset: DVec3, rotations: [DQuat; 2], workspace: &mut Workspace) -> Self {
        let [a, b] = &bodies;
        let query = Query { margin: MARGIN, ..Query::default() };
        let [ca, cb] = [a, b].map(|body| body.hull.contraction_point().length());
        Self {
            query,
            cold: contact_manifold(a, b, &query, None, workspace).clone(),
            inradius: a.hull.inradius() + b.hull.inradius(),
            circumradius: a.hull.circumradius() + b.hull.circumradius(),
            m: offset.length() + ca + cb,
            bodies,
            rotations,
        }
    }

    /// `R` divided by the least height of the triangle of a basis: the factor by which the rounding of
    /// its corners turns its normal.
    fn condition(&self, basis: &Basis) -> f64 {
        let corner = |i: usize| {
            let [a, b] = [(0, basis.a[i]), (1, basis.b[i])].map(|(side, registered)| {
                let hull = self.bodies[side].hull;
                let v = hull.vertex_of_registered(registered).expect("a vertex of the basis");
                self.rotations[side] * (hull.vertices()[v as usize] * hull.scale())
            });
            a - b
        };
        let [u0, u1, u2] = [0, 1, 2].map(corner);
        let longest = [u1 - u0, u2 - u1, u0 - u2].map(|e| e.length()).into_iter().fold(0.0, f64::max);
        self.circumradius * longest / (u1 - u0).cross(u2 - u0).length()
    }

    /// Compares the answer from a basis with the cold one.
    fn compare(&self, start: &Basis, workspace: &mut Workspace, counts: &mut Counts) {
        let ([a, b], cold) = (&self.bodies, &self.cold);
        let warm = contact_manifold(a, b, &self.query, Some(start), workspace);
        certificate::check(a, b, &self.query, warm).expect("a certified answer");
        assert_eq!(warm.outcome, cold.outcome);
        counts.compared += 1;
        let (Some(old), Some(new)) = (&cold.basis, &warm.basis) else {
            assert!(cold.outcome == Outcome::Separated && cold.basis == warm.basis);
            return;
        };
        counts.contacts += 1;
        let open = |flags: Flags| Flags { gap_open: true, ..flags };
        assert!(open(warm.flags) == open(cold.flags) && !warm.flags.gap_open && !cold.flags.gap_open);
        let rounding = 64.0 * U * (self.circumradius + self.m);
        let budget = 2.0 * (cold.alpha * 64.0 * U * self.circumradius + 16.0 * U * self.m) / self.inradius;
        assert!((warm.alpha - cold.alpha).abs() <= budget, "{warm:?} {cold:?}");
        assert!(warm.alpha_lower <= cold.alpha_upper && cold.alpha_lower <= warm.alpha_upper);
        let condition = self.condition(old).max(self.condition(new));
        let angle = 64.0 * U * condition;
        assert!((warm.normal - cold.normal).length() <= angle, "{condition:e} {warm:?} {cold:?}");
        let lengths = 2.0 * (rounding + angle * self.circumradius);
        assert!((warm.separation - cold.separation).abs() <= lengths, "{warm:?} {cold:?}");
        assert_eq!(warm.features, cold.features);
        counts.same_bits += usize::from(same_bits(warm, cold));
        let ids = |m: &Manifold| m.points.iter().map(|p| p.id).collect::<Vec<_>>();
        assert_eq!(ids(warm), ids(cold));
        for (p, q) in warm.points.iter().zip(&cold.points) {
            let off = p.witness_a.distance(q.witness_a).max((p.distance - q.distance).abs());
            counts.points += 1;
            counts.other_points += usize::from(off > lengths);
        }
    }
}

/// Whether all numbers of two answers are equal. The work done may differ.
fn same_bits(warm: &Manifold, cold: &Manifold) -> bool {
    let work = |m: &Manifold| Manifold { iterations: 0, support_calls: 0, ..m.clone() };
    work(warm) == work(cold)
}

/// All families and regimes, from four kinds of starts. Catches a start that decides the outcome, an answer
/// of a facet beside the optimal one, and a bracket that only one of the starts proves.
#[test]
fn answers_agree_from_every_start() {
    let mut all = Counts::default();
    let mut workspace = Workspace::default();
    for (family, regime) in Family::ALL.into_iter().flat_map(|f| Regime::ALL.map(|r| (f, r))) {
        let workload = Workload::generate(family, regime, PAIRS, 5).expect("a workload");
        let hulls: Vec<ConvexHull> =
            workload.hulls.iter().map(|points| ConvexHull::new(points).expect("a hull")).collect();
        let mut counts = Counts::default();
        for (index, pair) in workload.pairs.iter().enumerate() {
            let body = |side: usize, motion: f64| {
                let mut position = pair.positions[side];
                position[index % 3] += motion;
                Body::new(
                    &hulls[pair.hulls[side]],
                    Pose::new(position, pair.rotations[side]).expect("a pose"),
                )
            };
            let offset = DVec3::from(pair.positions[1]) - DVec3::from(pair.positions[0]);
            let rotations = pair.rotations.map(DQuat::from_array);
            let bodies = [body(0, 0.0), body(1, 0.0)];
            let started = Started::new(bodies, offset, rotations, &mut workspace);
            for motion in MOTIONS {
                let apart = Query { margin: f64::INFINITY, ..Query::default() };
                let moved = contact_manifold(&body(0, 0.0), &body(1, motion), &apart, None, &mut workspace);
                let start = moved.basis.expect("no distance exceeds an infinite margin");
                started.compare(&start, &mut workspace, &mut counts);
            }
        }
        println!("{:8} {:10} {counts:?}", family.name(), regime.name());
        all.compared += counts.compared;
        all.contacts += counts.contacts;
        all.points += counts.points;
        all.other_points += counts.other_points;
        all.same_bits += counts.same_bits;
    }
    println!("{all:?}");
    // Bits are not promised. The count shows that they differ, and that not all of them do.
    assert!(all.same_bits > all.contacts / 2 && all.same_bits < all.contacts, "{all:?}");
    assert_eq!([all.compared, all.contacts], [12 * 4 * PAIRS, 8 * 4 * PAIRS]);
    assert!(all.points > 10_000 && all.other_points == 0, "{all:?}");
}
