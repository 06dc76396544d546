//! Contact manifolds of two convex hulls.
//!
//! [`contact_manifold`] takes two hulls, each at a pose, and returns their growth scale, the contact
//! normal and the contact points. It follows M. Silcowitz, S. Niebe and K. Erleben, *Contact Point
//! Generation for Convex Polytopes in Interactive Rigid Body Dynamics* (SCA 2010). The *growth scale*
//! `alpha` is the smallest factor by which both hulls, scaled about a point inside each, touch.
//! The paper's three steps are three modules:
//!
//! | step | paper | module |
//! |---|---|---|
//! | 1: growth scale and contact normal, by a ray cast | section 3 | `growth` |
//! | 2: the pair of features that the normal touches, by Gauss maps | section 4 | `gauss_map` |
//! | 3: contact points, by intersecting the two features | section 5 | `intersection` |
//!
//! ```text
//! contact_manifold(A, B, query):
//!     bring A and B into one frame                                      (pair)
//!     the bounding spheres are farther apart than the margin: SEPARATED
//!     alpha, normal n, basis = growth of A and B, or SEPARATED          (step 1)
//!     feature of A along n, feature of B along -n                       (step 2)
//!     points = intersection of the two features                         (step 3)
//!     alpha <= 1, or a point within the margin: CONTACT
//!     otherwise the distance between the hulls decides                  (distance)
//!     keep at most max_points of the points                             (reduce)
//! ```
//!
//! Two boxes along the axes of their frames take a path of their own, which computes several pairs at
//! once (`lanes`). [`box_manifolds`] is its form for many pairs.
//!
//! [`certificate`] checks an answer against its definition. It reads only the two hulls and shares no
//! solver with the other modules. `docs/algorithm.md` lists the symbols that the comments use.
//!
//! An example: one cube penetrates another by 0.01.
//!
//! ```
//! use hullcast_contact::{Body, ConvexHull, Pose, Query, Workspace, certificate, contact_manifold};
//!
//! let sign = |corner: u32, axis: u32| if corner >> axis & 1 == 0 { -0.5 } else { 0.5 };
//! let corners: Vec<[f64; 3]> = (0..8).map(|i| [sign(i, 0), sign(i, 1), sign(i, 2)]).collect();
//! let cube = ConvexHull::new(&corners)?;
//! let upright = [0.0, 0.0, 0.0, 1.0];
//! let a = Body::new(&cube, Pose::new([0.0, 0.0, 0.0], upright)?);
//! let b = Body::new(&cube, Pose::new([0.2, 0.0, 0.99], upright)?);
//!
//! let query = Query { margin: 0.01, ..Query::default() };
//! let mut workspace = Workspace::default();
//! let manifold = contact_manifold(&a, &b, &query, None, &mut workspace);
//! assert!(manifold.alpha_lower <= 0.99 && 0.99 <= manifold.alpha_upper);
//! assert_eq!(manifold.normal.to_array(), [0.0, 0.0, 1.0]);
//! assert_eq!(manifold.points.len(), 4);
//! assert!(manifold.points.iter().all(|point| (point.distance + 0.01).abs() < 1e-15));
//! certificate::check(&a, &b, &query, manifold)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod body;
mod bounds;
pub mod certificate;
mod cost;
mod csr;
mod derivatives;
mod distance;
mod estimate;
pub(crate) mod exact;
mod gauss_map;
mod growth;
pub mod hull;
mod intersection;
mod lanes;
mod manifold;
mod monotone_chain;
mod motion;
mod pair;
mod query;
mod reduce;
mod simplex;
pub mod sort;
pub mod stop;
mod support;
mod tolerance;
pub mod workload;

use glam::DVec3;

pub use body::{Body, InvalidPose, Pose};
pub use bounds::Bounds;
pub use derivatives::{Derivatives, KinkScratch, derivatives};
pub use estimate::estimated_steps;
pub use hull::{
    ABSENT_PLANARITY, BuildError, ConvexHull, HullError, HullErrorKind, HullOptions, MAX_PLANARITY,
    Simplification,
};
pub use lanes::{BoxPair, GROUP, InstructionSet, box_manifolds, box_manifolds_with};
pub use manifold::{Basis, ContactPoint, Element, Feature, Flags, Manifold, Outcome};
pub use motion::{Motion, approach};
pub use query::{Accuracy, Query, Solver, Wanted};
pub use stop::{STEPS_BETWEEN_LOOKS, Stop, Stopped};
pub use support::instruction_set;

use distance::Decision;
use gauss_map::{Direction, Touched, touched_feature};
use growth::{Cost, Goal, Growth, Separation, Solution, growth};
use intersection::Intersection;
use pair::{Pair, Support, shift};
use support::Columns;
use tolerance::{MERGE, NOISE, U};

/// Buffers that are reused from pair to pair, so that after the first pairs no call allocates.
#[derive(Debug, Default)]
pub struct Workspace {
    turned: Columns,
    steps: Steps,
    lanes: lanes::Buffers,
    /// Elementary steps of the pairs computed since the last [`Workspace::take_steps`].
    counted: u64,
}

impl Workspace {
    /// The elementary steps ([`Stop`]) of the pairs that were computed with this workspace since
    /// the last call.
    #[inline]
    pub fn take_steps(&mut self) -> u64 {
        std::mem::take(&mut self.counted)
    }
}

/// The answer, and the buffers and cached values of the steps.
#[derive(Debug, Default)]
struct Steps {
    manifold: Manifold,
    gauss_map: gauss_map::Scratch,
    intersection: Intersection,
    reduce: reduce::Scratch,
    /// The last feature angle with its sine and cosine: most pairs of a batch share one angle.
    feature_angle: Option<(f64, f64, f64)>,
}

/// Computes the contact manifold of `a` and `b`: the paper's three steps, in order.
///
/// `warm` is the basis of an earlier answer for the same two hulls. A basis that no longer fits costs
/// no more than a cold start. The answer is stored in `workspace` and valid until the next call.
///
/// Lengths are in the caller's units. The normal and the witnesses are in the world frame.
///
/// A pair farther apart than the margin gets only certified lower bounds: its `alpha_upper` is
/// infinite, and it has no points and no basis.
///
/// A simulation passes the basis of one step to the next:
///
/// ```
/// # use hullcast_contact::{Body, ConvexHull, InvalidPose, Pose, Query, Workspace, contact_manifold};
/// # let corners = [[-1.0, -1.0, -1.0], [1.0, 1.0, -1.0], [-1.0, 1.0, 1.0], [1.0, -1.0, 1.0]];
/// # let hull = ConvexHull::new(&corners)?;
/// # let pose = |z: f64| Pose::new([0.1, 0.2, z], [0.0, 0.0, 0.0, 1.0]);
/// let (query, mut workspace, mut warm) = (Query::default(), Workspace::default(), None);
/// let ground = Body::new(&hull, pose(0.0)?);
/// for step in 0..10 {
///     let falling = Body::new(&hull, pose(1.5 - 0.01 * f64::from(step))?);
///     let manifold = contact_manifold(&ground, &falling, &query, warm.as_ref(), &mut workspace);
///     assert!(step == 0 || manifold.iterations == 1);
///     warm = manifold.basis;
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn contact_manifold<'w>(
    a: &Body<'_>,
    b: &Body<'_>,
    query: &Query,
    warm: Option<&Basis>,
    workspace: &'w mut Workspace,
) -> &'w Manifold {
    if let Some(boxes) = BoxPair::new(a, b, query, warm) {
        return lanes::box_manifold(&boxes, query, workspace);
    }
    let Workspace { turned, steps, counted, .. } = workspace;
    let pair = &mut Pair::new(a, b);
    steps.answer(pair, query, warm, turned);
    *counted += cost::PAIR
        + cost::ITERATION * u64::from(steps.manifold.iterations)
        + pair.steps(steps.manifold.support_calls);
    &steps.manifold
}

/// If the bounding spheres are farther apart than the margin (pair units), returns how far `K`
/// reaches at most along the line of centres.
fn spheres_apart(pair: &Pair<'_>, margin: f64) -> Option<f64> {
    let reach = pair.circumradius;
    (pair.distance - reach > margin + pair.rounding_band()).then_some(reach)
}

impl Steps {
    /// Computes the answer for a pair and stores it in `self.manifold`.
    fn answer<'a>(
        &mut self,
        pair: &mut Pair<'a>,
        query: &Query,
        warm: Option<&Basis>,
        turned: &'a mut Columns,
    ) {
        // The margin in pair units. If it overflows, it is infinite, which is right: it exceeds every
        // distance.
        let margin = query.margin / pair.unit;
        self.manifold.reset();
        if let Some(reach) = spheres_apart(pair, margin) {
            self.manifold.set_apart(pair, pair.ray, reach, Cost::default());
            return;
        }

        // Step 1: growth scale and normal.
        let goal = Goal::new(&query.accuracy, margin, query.wanted == Wanted::Outcome);
        let solution = match growth(pair, query.accuracy.solver, warm, &goal, turned) {
            Growth::Solved(solution) => solution,
            Growth::Separated(Separation { direction, support, cost }) => {
                let reach = direction.dot(support.point) / direction.length();
                self.manifold.set_apart(pair, direction, reach, cost);
                return;
            }
        };
        self.conclude(pair, solution, margin, query);
    }

    /// Computes features, points and outcome for the growth scale and normal found, and stores the
    /// answer. `margin` is in pair units.
    fn conclude(&mut self, pair: &Pair<'_>, mut solution: Solution, margin: f64, query: &Query) {
        let certain = solution.upper <= 1.0 || margin == f64::INFINITY;
        if query.wanted == Wanted::Points {
            self.find_points(pair, &solution, &query.accuracy);
        }

        let near = certain || (query.wanted == Wanted::Points && self.points_within(margin));
        let outcome = if near { Some(Outcome::Contact) } else { self.decide(pair, &mut solution, margin) };
        let Some(outcome) = outcome else { return };
        // A query for the outcome only does not ask for a bracket, so none can be too wide.
        solution.gap_open &= query.wanted != Wanted::Outcome;
        self.manifold.set_solved(pair, &solution, outcome);
        if query.wanted == Wanted::Points {
            self.lift_points(pair, &query.accuracy);
        }
    }

    /// Decides by the distance of the hulls whether they are within the margin (pair units). Stores the
    /// answer and returns `None` if they are not.
    fn decide(&mut self, pair: &Pair<'_>, solution: &mut Solution, margin: f64) -> Option<Outcome> {
        match distance::decide(pair, &solution.triple, margin, &mut solution.cost) {
            Decision::Within => Some(Outcome::Contact),
            Decision::Unknown => Some(Outcome::Undecided),
            Decision::Beyond(direction, support) => {
                let reach = direction.dot(support.point) / direction.length();
                self.manifold.set_apart(pair, direction, reach, solution.cost);
                None
            }
        }
    }

    /// The sine and the cosine of the feature angle.
    fn sine_and_cosine(&mut self, feature_angle: f64) -> (f64, f64) {
        let (_, sine, cosine) = match self.feature_angle {
            Some(known) if known.0 == feature_angle => known,
            _ => {
                let (sine, cosine) = feature_angle.sin_cos();
                *self.feature_angle.insert((feature_angle, sine, cosine))
            }
        };
        (sine, cosine)
    }

    /// Steps 2 and 3: finds the two features and the contact points of their intersection.
    fn find_points(&mut self, pair: &Pair<'_>, solution: &Solution, accuracy: &Accuracy) {
        let n = solution.normal;
        // A triple that still contains inner points is not a basis, because these points stand for no
        // vertices.
        let complete = solution.triple.iter().all(|u| u.a != Support::INNER);
        let [u0, u1, u2] = if complete { solution.triple } else { [solution.support; 3] };
        let known = |vertex: fn(&Support) -> u32| [solution.support, u0, u1, u2].each_ref().map(vertex);
        let depth = MERGE * U * pair.circumradius;
        let (sine, cosine) = self.sine_and_cosine(accuracy.feature_angle);
        let of = |n, known: &[u32; 4], scale: f64, hull, scratch: &mut _| {
            touched_feature(hull, &Direction { n, known, depth: depth / scale, sine, cosine }, scratch)
        };
        let features = [
            of(n, &known(|s| s.a), pair.scale_a, pair.a, &mut self.gauss_map),
            of(-pair.direction_in_b(n), &known(|s| s.b), pair.scale_b, pair.b, &mut self.gauss_map),
        ];
        self.intersection.find(pair, n, features);
        self.manifold.features = Some([named(pair.a, features[0]), named(pair.b, features[1])]);
    }

    /// Whether a contact point shows that the hulls are within the margin of each other. Each of its two
    /// witnesses lies on its hull to within the planarity of the face.
    fn points_within(&self, margin: f64) -> bool {
        let found = &self.intersection;
        !found.estimated
            && found.points.iter().any(|p| (p.height_b - p.height_a).abs() + found.planarity <= margin)
    }

    /// Reduces the points found to `max_points`, transforms them to the world and stores them.
    fn lift_points(&mut self, pair: &Pair<'_>, accuracy: &Accuracy) {
        let found = &mut self.intersection;
        let rounding = pair.rounding_band();
        let most = accuracy.max_points as usize;
        if most != 0 && found.points.len() > most {
            found.points.rotate_left(std::mem::take(&mut found.first));
            self.manifold.kept_area = reduce::reduce(&mut found.points, most, rounding, &mut self.reduce);
            pair.count.add(cost::LOOK * self.reduce.take_looked_at());
            self.manifold.flags.reduced = true;
        }
        self.manifold.flags.estimated = found.estimated;
        let [e1, e2, n] = found.axes().map(|axis| pair.offset_to_world(axis));
        let (translation, centre) = (pair.translation_a, pair.centre_offset_a());
        let (last, first) = found.points.split_at(found.first);
        self.manifold.points.extend(first.iter().chain(last).map(|p| ContactPoint {
            witness_a: translation + (centre + (e1 * p.at.x + e2 * p.at.y + n * p.height_a)),
            distance: (p.height_b - p.height_a) * pair.unit,
            id: p.id,
        }));
    }
}

impl Manifold {
    fn reset(&mut self) {
        let points = std::mem::take(&mut self.points);
        *self = Self { points, ..Self::default() };
        self.points.clear();
    }

    /// Fills in the answer for a separated pair. `direction` (A's frame, any length) certifies the
    /// separation, and `K` reaches at most `reach` along it. All numbers are certified lower bounds.
    fn set_apart(&mut self, pair: &Pair<'_>, direction: DVec3, reach: f64, cost: Cost) {
        let n = direction.normalize();
        let noise = |m: f64| NOISE * U * m;
        let width = reach + noise(pair.circumradius);
        self.outcome = Outcome::Separated;
        let lower = ((n.dot(pair.ray) - noise(pair.ray_m)) / width).next_down();
        self.alpha_lower = shift(lower, pair.alpha_exponent).max(0.0);
        self.alpha = self.alpha_lower;
        self.alpha_upper = f64::INFINITY;
        self.separation = (n.dot(pair.d) - reach - pair.rounding_band()) * pair.unit;
        self.normal = pair.direction_to_world(n);
        self.features = None;
        (self.iterations, self.support_calls) = (cost.iterations, cost.support_calls);
    }

    fn set_solved(&mut self, pair: &Pair<'_>, solution: &Solution, outcome: Outcome) {
        let n = solution.normal;
        self.outcome = outcome;
        self.flags.gap_open = solution.gap_open;
        self.flags.coincident = solution.coincident;
        (self.alpha, self.alpha_lower, self.alpha_upper) = (solution.alpha, solution.lower, solution.upper);
        self.separation = (n.dot(pair.d) - n.dot(solution.support.point)) * pair.unit;
        self.normal = pair.direction_to_world(n);
        self.basis = basis(pair, &solution.triple);
        (self.iterations, self.support_calls) = (solution.cost.iterations, solution.cost.support_calls);
    }
}

/// The triple in indices of the vertices as registered, or `None` if it contains an inner point.
fn basis(pair: &Pair<'_>, triple: &[Support; 3]) -> Option<Basis> {
    let complete = triple.iter().all(|u| u.a != Support::INNER);
    complete.then(|| Basis {
        a: triple.map(|u| pair.a.registered_indices()[u.a as usize]),
        b: triple.map(|u| pair.b.registered_indices()[u.b as usize]),
    })
}

fn named(hull: &ConvexHull, feature: Touched) -> Feature {
    let registered = |v: u32| hull.registered_indices()[v as usize];
    match feature {
        Touched::Vertex(v) => Feature::Vertex(registered(v)),
        Touched::Edge(e) => Feature::Edge(hull.edge_vertices()[e as usize].map(registered)),
        Touched::Face(f) => Feature::Face(f),
    }
}
