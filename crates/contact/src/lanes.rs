//! Many pairs at once: one pair in each lane of a vector register.
//!
//! # What a lane is
//!
//! A vector register of AVX-512 holds eight doubles, and one instruction adds or multiplies all eight.
//! Each of the eight places is a *lane*. The geometry of one pair is a long chain of steps that wait for
//! each other, so it cannot fill such a register: of eight places one would work. Eight pairs can. Here
//! lane 0 computes the first pair, lane 1 the second, and so on; an expression such as `n.dot(d)` reads
//! as if it were about one pair, and computes eight.
//!
//! ```text
//! group of pairs   P0  P1  P2  P3  P4  P5  P6  P7       the same number of each pair is one register:
//! half extent x   |h0 |h1 |h2 |h3 |h4 |h5 |h6 |h7 |     rows of pairs become lanes once,
//! offset x        |d0 |d1 |d2 |d3 |d4 |d5 |d6 |d7 |     when a group is loaded
//! ```
//!
//! # Why one pair per lane
//!
//! No lane ever reads another lane, so a pair's answer depends on nothing but the pair: not on its
//! neighbours, on the place in its group, or on how a batch is split. A group with too few pairs repeats
//! its last one. The algorithm is written once, over the trait [`simd::Lanes`]; `f64` is the one-lane form,
//! which answers single pairs. Every operation is exactly defined, so the forms give the same bits.
//!
//! # How a lane gives up
//!
//! Lanes have no branches: all of them go the same way, and a `select` takes one of two results in each.
//! So this code handles the ordinary cases only, and every lane decides for itself whether it is
//! certain. The path for all hulls then does the rest:
//!
//! | uncertain in the lane | computed by the path for all hulls |
//! |---|---|
//! | lengths near the ends of the range, coincident centres, a bracket that is not closed | the whole pair |
//! | a feature near a limit of the Gauss map, projections that meet near a corner or miss each other, more points than asked for | features and points, from the growth scale and normal of the lane |
//! | no bound of alpha or point that shows whether the hulls are within the margin | the outcome, from the distance of the hulls |
//!
//! # How instruction sets are chosen
//!
//! Once per call, by looking at the CPU ([`simd::InstructionSet`]). [`simd`] explains how one generic
//! function becomes a function for each instruction set, and why all helpers are `#[inline(always)]`.
//!
//! # The steps, for two boxes
//!
//! ```text
//! load the group: both boxes in A's axes                                 (frame)
//! n = the best of the 15 separating axes                                 (axes)
//! SEPARATED if n separates by more than the margin
//! bracket of alpha: n below, a point that both grown boxes hold above    (bracket)
//! the feature of A along n, the feature of B along -n                    (features)
//! face and vertex, or two edges: one point                               (single)
//! two faces: the intersection of two rectangles                          (rectangles)
//! names of features, points and basis; then the rest of an open lane     (answer)
//! ```
//!
//! A hull takes part if it is a box along the axes of its own frame, to a few roundoffs
//! ([`BoxRow`](crate::hull::BoxRow)). A lane takes the same time whatever it finds;
//! docs/performance.md has the times. Warm starts are not needed, so only lanes that give up use them.

#![allow(clippy::inline_always, reason = "every helper must become part of its entry function; see simd")]

mod answer;
mod axes;
mod bracket;
mod features;
mod frame;
mod rectangles;
mod simd;
mod single;
#[cfg(test)]
mod tests;
mod vector;

use crate::hull::BoxRow;
use crate::pair::Pair;
use crate::{Basis, Body, ConvexHull, Manifold, Query, Solver, Wanted, Workspace, cost};
use answer::Lane;
use axes::Direction;
use bracket::{Bracket, lower_bound, separates};
use features::{Feature, FeatureAngle};
use frame::{Frame, Group};
use rectangles::Rectangles;
pub use simd::InstructionSet;
use simd::{Kernel, Lanes, Mask, Row, WIDTH};
use single::Single;

/// The number of pairs that [`box_manifolds`] computes at once. Any other number works too.
pub const GROUP: usize = WIDTH;

/// Two bodies whose hulls are boxes, for [`box_manifolds`].
#[derive(Clone, Copy, Debug)]
pub struct BoxPair<'a> {
    bodies: [Body<'a>; 2],
    rows: [&'a BoxRow; 2],
    /// Caller's units.
    margin: f64,
    warm: Option<Basis>,
}

impl<'a> BoxPair<'a> {
    /// Whether two bodies with these hulls make a pair; see [`BoxPair::new`].
    #[inline]
    pub fn accepts(a: &ConvexHull, b: &ConvexHull, query: &Query) -> bool {
        a.box_row().is_some() && b.box_row().is_some() && query.accuracy.solver == Solver::Portal
    }

    /// The pair, if both hulls are boxes that lanes can compute, and the query is for the default solver.
    /// The pair keeps the margin of `query`, so that the pairs of one group may have different margins.
    /// `warm` is a basis as for [`contact_manifold`](crate::contact_manifold).
    #[inline]
    pub fn new(a: &Body<'a>, b: &Body<'a>, query: &Query, warm: Option<&Basis>) -> Option<Self> {
        let rows = [a.hull.box_row()?, b.hull.box_row()?];
        let is_default = query.accuracy.solver == Solver::Portal;
        is_default.then(|| Self { bodies: [*a, *b], rows, margin: query.margin, warm: warm.copied() })
    }
}

/// Computes the contact manifolds of pairs of boxes, in order: the answers are those of
/// [`contact_manifold`](crate::contact_manifold), bit for bit, several times faster. They are valid until
/// the next call.
///
/// The margin of `query` is not used: each pair has the margin that it was made with.
///
/// ```
/// use hullcast_contact::{BoxPair, Body, ConvexHull, Pose, Query, Workspace, box_manifolds};
///
/// let sign = |corner: u32, axis: u32| if corner >> axis & 1 == 0 { -0.5 } else { 0.5 };
/// let corners: Vec<[f64; 3]> = (0..8).map(|i| [sign(i, 0), sign(i, 1), sign(i, 2)]).collect();
/// let cube = ConvexHull::new(&corners)?;
/// let pose = |z: f64| Pose::new([0.2, 0.1, z], [0.0, 0.0, 0.0, 1.0]);
/// let (ground, query) = (Body::new(&cube, pose(0.0)?), Query::default());
/// let mut pairs = Vec::new();
/// for step in 0..20 {
///     let above = Body::new(&cube, pose(0.9 + 0.01 * f64::from(step))?);
///     pairs.extend(BoxPair::new(&ground, &above, &query, None));
/// }
/// let mut workspace = Workspace::default();
/// let manifolds = box_manifolds(&pairs, &query, &mut workspace);
/// assert!(manifolds.len() == 20 && manifolds[0].points.len() == 4);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn box_manifolds<'w>(
    pairs: &[BoxPair<'_>],
    query: &Query,
    workspace: &'w mut Workspace,
) -> &'w [Manifold] {
    box_manifolds_with(InstructionSet::widest(), pairs, query, workspace)
}

/// [`box_manifolds`] for one pair, in one lane.
pub(crate) fn box_manifold<'w>(
    pair: &BoxPair<'_>,
    query: &Query,
    workspace: &'w mut Workspace,
) -> &'w Manifold {
    let manifolds = box_manifolds_with(InstructionSet::SCALAR, std::slice::from_ref(pair), query, workspace);
    &manifolds[0]
}

/// [`box_manifolds`] with the lanes of a given instruction set. Every one of them gives the same answers.
pub fn box_manifolds_with<'w>(
    instructions: InstructionSet,
    pairs: &[BoxPair<'_>],
    query: &Query,
    workspace: &'w mut Workspace,
) -> &'w [Manifold] {
    if workspace.lanes.manifolds.len() < pairs.len() {
        workspace.lanes.manifolds.resize_with(pairs.len(), Manifold::default);
    }
    let (sine, _) = workspace.steps.sine_and_cosine(query.accuracy.feature_angle);
    let question = Question { angle: FeatureAngle::new(sine), points: query.wanted == Wanted::Points };
    let mut first = 0;
    for group in pairs.chunks(WIDTH) {
        let numbers = workspace.lanes.numbers.get_or_insert_default();
        numbers.reset();
        let count = group.len();
        instructions.run(Boxes { group: &Group::new(group), count, question: &question, numbers });
        for (lane, pair) in group.iter().enumerate() {
            finish(workspace, first + lane, lane, pair, query);
        }
        first += group.len();
    }
    &workspace.lanes.manifolds[..pairs.len()]
}

/// Writes the answer of a lane, and computes the rest if the lane left something open.
fn finish(workspace: &mut Workspace, index: usize, lane: usize, boxes: &BoxPair<'_>, query: &Query) {
    let Workspace { turned, steps, lanes, counted } = workspace;
    let manifold = &mut lanes.manifolds[index];
    let Some(numbers) = &lanes.numbers else { return };
    let lane = Lane { numbers, lane, rows: boxes.rows };
    *counted += cost::LANE;
    let query = &Query { margin: boxes.margin, ..*query };
    if lane.is_complete(manifold, query) {
        return;
    }
    #[cfg(test)]
    {
        lanes.gave_up[usize::from(lane.is_solved())] += 1;
    }
    let [a, b] = &boxes.bodies;
    let pair = &mut Pair::new(a, b);
    std::mem::swap(&mut steps.manifold, manifold);
    if lane.is_solved() {
        pair.turn(turned);
        steps.complete(pair, &lane, query);
        *counted += pair.steps(0);
    } else {
        steps.answer(pair, query, boxes.warm.as_ref(), turned);
        let Manifold { iterations, support_calls, .. } = steps.manifold;
        *counted += cost::PAIR + cost::ITERATION * u64::from(iterations) + pair.steps(support_calls);
    }
    std::mem::swap(&mut steps.manifold, manifold);
}

/// Buffers of groups of pairs.
#[derive(Debug, Default)]
pub(crate) struct Buffers {
    manifolds: Vec<Manifold>,
    /// Allocated for the first group, so that making a workspace allocates nothing.
    numbers: Option<Box<Numbers>>,
    /// The lanes that left the whole pair, or a part of it, to the general path.
    #[cfg(test)]
    gave_up: [usize; 2],
}

/// The query, as far as lanes need it.
struct Question {
    angle: FeatureAngle,
    /// Whether points are asked for.
    points: bool,
}

/// The results of a group: bits and numbers of each lane.
#[derive(Debug, Default)]
struct Numbers {
    /// Lanes that are certainly farther apart than the margin.
    separated: u32,
    /// Lanes with a closed bracket.
    solved: u32,
    /// The solved lanes with certain features, and those with a certain point or intersection.
    features_sure: u32,
    single: u32,
    rectangles_sure: u32,
    /// How the bracket was found; see [`Direction`] and [`Bracket`].
    of_edges: u32,
    of_b: u32,
    between: u32,
    alpha: Row,
    lower: Row,
    upper: Row,
    /// Caller's units.
    separation: Row,
    /// World frame.
    normal: [Row; 3],
    /// In the axes of A's box, and of B's.
    n: [Row; 3],
    n_in_b: [Row; 3],
    /// See [`Bracket`].
    in_a: [Row; 3],
    in_b: [Row; 3],
    /// The numbers of the axes of A and of B that made the direction.
    axis_a: Row,
    axis_b: Row,
    /// See [`Feature::code`].
    feature_a: Row,
    feature_b: Row,
    /// The single point: witness on A in the world, distance; caller's units.
    witness: [Row; 3],
    distance: Row,
    /// For parallel faces: half extents, centre offset, and B's axes by columns.
    half_a: [Row; 3],
    half_b: [Row; 3],
    d: [Row; 3],
    axes: [[Row; 3]; 3],
    rectangles: Rectangles,
}

impl Numbers {
    /// Clears the bits. The numbers of a lane are only read if a bit says so.
    fn reset(&mut self) {
        for bits in [
            &mut self.separated,
            &mut self.solved,
            &mut self.features_sure,
            &mut self.single,
            &mut self.rectangles_sure,
            &mut self.of_edges,
            &mut self.of_b,
            &mut self.between,
        ] {
            *bits = 0;
        }
    }
}

/// The computation of the first `count` pairs of a group.
struct Boxes<'k> {
    group: &'k Group<'k>,
    count: usize,
    question: &'k Question,
    numbers: &'k mut Numbers,
}

impl Kernel for Boxes<'_> {
    #[inline(always)]
    fn run<L: Lanes>(self) {
        // With eight lanes there is one round, and `at` is known to be 0.
        for round in 0..WIDTH / L::COUNT {
            let at = round * L::COUNT;
            if at < self.count {
                compute_from::<L>(self.group, at, self.question, self.numbers);
            }
        }
    }
}

/// Computes the lanes of one register: those of the pairs from `at` on.
#[inline(always)]
fn compute_from<L: Lanes>(group: &Group<'_>, at: usize, question: &Question, numbers: &mut Numbers) {
    let frame = Frame::<L>::load(group, at);
    let direction = Direction::choose(&frame);
    let separated = frame.usable & separates(&frame, &direction);
    let normal = frame.rotation_a * direction.n;
    let normal = normal.scale(L::splat(1.0) / normal.length());
    normal.store(&mut numbers.normal, at);
    let gap = direction.along - direction.reach;
    let bound = gap - frame.rounding_band;
    (L::select(separated, bound, gap) * frame.unit).store(&mut numbers.separation, at);
    lower_bound(&frame, &direction).store(&mut numbers.lower, at);
    numbers.separated |= separated.bits() << at;
    if !(frame.usable & !separated).any() {
        return;
    }

    let bracket = Bracket::new(&frame, &direction);
    let solved = frame.usable & bracket.closed & !separated;
    numbers.solved |= solved.bits() << at;
    numbers.of_edges |= direction.of_edges.bits() << at;
    numbers.of_b |= direction.of_b.bits() << at;
    numbers.between |= bracket.between.bits() << at;
    bracket.alpha.store(&mut numbers.alpha, at);
    bracket.upper.store(&mut numbers.upper, at);
    direction.n.store(&mut numbers.n, at);
    direction.n_in_b.store(&mut numbers.n_in_b, at);
    bracket.in_a.store(&mut numbers.in_a, at);
    bracket.in_b.store(&mut numbers.in_b, at);
    (direction.axis_a.y + L::splat(2.0) * direction.axis_a.z).store(&mut numbers.axis_a, at);
    (direction.axis_b.y + L::splat(2.0) * direction.axis_b.z).store(&mut numbers.axis_b, at);
    if (solved & bracket.between).any() {
        frame.half_a.store(&mut numbers.half_a, at);
        frame.half_b.store(&mut numbers.half_b, at);
        frame.d.store(&mut numbers.d, at);
        let [x, y, z] = &mut numbers.axes;
        frame.rotation.x.store(x, at);
        frame.rotation.y.store(y, at);
        frame.rotation.z.store(z, at);
    }
    if question.points {
        touch::<L>(&frame, &direction, solved, at, question, numbers);
    }
}

/// Steps 2 and 3 of the lanes of one register.
#[inline(always)]
fn touch<L: Lanes>(
    frame: &Frame<L>,
    direction: &Direction<L>,
    solved: L::Mask,
    at: usize,
    question: &Question,
    numbers: &mut Numbers,
) {
    // How far below the farthest vertex another one still counts as touched.
    let depth = L::splat(crate::tolerance::MERGE * crate::tolerance::U) * frame.circumradius;
    let a = Feature::touched(direction.n, frame.half_a, depth, question.angle);
    let b = Feature::touched(-direction.n_in_b, frame.half_b, depth, question.angle);
    let sure = solved & a.sure & b.sure;
    a.code().store(&mut numbers.feature_a, at);
    b.code().store(&mut numbers.feature_b, at);
    numbers.features_sure |= sure.bits() << at;
    if (sure & Single::possible(&a, &b)).any() {
        let point = Single::new(frame, direction, &a, &b);
        numbers.single |= (sure & point.sure).bits() << at;
        let local = frame.centre_a + (frame.rotation_a * point.witness).scale(frame.unit);
        (frame.translation_a + local).store(&mut numbers.witness, at);
        (point.distance * frame.unit).store(&mut numbers.distance, at);
    }
    if (sure & a.is_face & b.is_face).any() {
        let clear = numbers.rectangles.measure(frame, direction, [&a, &b], at);
        numbers.rectangles_sure |= (sure & clear).bits() << at;
    }
}
