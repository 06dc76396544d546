//! A batch of pairs, and the computation of each pair's answer.

use std::{any::Any, ops::Range, sync::Arc};

use hullcast_contact::{
    Basis, Body, BoxPair, GROUP, KinkScratch, Manifold, Outcome, Stopped, Workspace, box_manifolds,
    contact_manifold, derivatives, estimated_steps,
};

use crate::{
    columns::{Columns, InvalidPair},
    outputs::Outputs,
    scene::{Bodies, SceneFault, has_length},
    steps::{Step, StepPairs},
};

/// Steps of a pair in addition to its computation. A pair that is not computed, because a hull or
/// a pose is missing, takes only these.
const LEAST_STEPS: u64 = 50;

/// A batch that is ready to be computed: checked, with its hulls.
#[derive(Debug)]
pub struct Batch {
    pub(crate) bodies: Bodies,
    /// Pairs that replace the template's pairs. The answer leaves out those that are SEPARATED.
    candidates: Option<Vec<u32>>,
    /// Empty, or 6 per pair: registered indices of vertices, unchecked.
    warm_starts: Vec<u32>,
    /// The outputs that are kept: all that are sent, and those that the next step of a stream needs.
    pub(crate) kept: Outputs,
    /// The step from the answer before, if there is one. The pairs of the step are those of `candidates`; without
    /// them, the pairs are those of the template.
    pub(crate) step: Option<(Arc<Step>, Option<Arc<StepPairs>>)>,
    /// Dropped with the batch.
    owned: Option<Box<dyn Any + Send + Sync>>,
}

/// The buffers of a thread that computes pairs.
#[derive(Debug, Default)]
pub(crate) struct Workspaces {
    /// For groups of pairs of boxes, whose answers wait while the pairs between them are computed.
    boxes: Workspace,
    others: PairWorkspace,
}

/// The buffers for one pair.
#[derive(Debug, Default)]
struct PairWorkspace {
    contact: Workspace,
    kinks: KinkScratch,
}

/// Pairs of boxes that are computed together.
struct Group<'a> {
    /// Their numbers, ascending.
    pairs: [usize; GROUP],
    boxes: [BoxPair<'a>; GROUP],
    /// How many of these are used.
    count: usize,
}

impl Batch {
    /// The batch of all pairs of the bodies' template. `warm_starts` is empty, or has 6 indices per pair; bases
    /// that do not belong to a pair's hulls are ignored.
    ///
    /// # Errors
    /// There are not as many warm starts as pairs.
    pub fn new(bodies: Bodies, warm_starts: Vec<u32>) -> Result<Self, SceneFault> {
        if !warm_starts.is_empty() {
            let expected = 6 * bodies.template().pair_count();
            has_length(warm_starts.len(), expected, "warm_starts", "none or 6 per pair")?;
        }
        let kept = bodies.template().outputs();
        Ok(Self { bodies, candidates: None, warm_starts, kept, step: None, owned: None })
    }

    /// A batch of pairs that may meet, 2 indices per pair. Its answer contains those that are not
    /// SEPARATED.
    pub(crate) fn of_candidates(bodies: Bodies, candidates: Vec<u32>) -> Self {
        let kept = bodies.template().outputs();
        Self { bodies, candidates: Some(candidates), warm_starts: Vec::new(), kept, step: None, owned: None }
    }

    fn pairs(&self) -> &[u32] {
        self.candidates.as_deref().unwrap_or(self.bodies.template().pairs())
    }

    /// The number of pairs.
    pub fn pair_count(&self) -> usize {
        self.pairs().len() / 2
    }

    fn pair_bodies(&self, pair: usize) -> [u32; 2] {
        [0, 1].map(|side| self.pairs()[2 * pair + side])
    }

    /// The row of the answer before that a pair takes as it is.
    fn row_to_reuse(&self, pair: usize) -> Option<(&Step, usize)> {
        let (step, link) = self.link(pair)?;
        Some((step, step.row_to_reuse(self.pair_bodies(pair), link)?))
    }

    /// Keeps a value until the batch is freed, such as the memory that the batch counts against.
    pub fn keep(&mut self, value: impl Send + Sync + 'static) {
        self.owned = Some(Box::new(value));
    }

    /// Computes these pairs and adds them to `columns`, in order. Calls `spend` with the steps of each pair,
    /// and ends early if that fails.
    ///
    /// Pairs of boxes are computed in groups, ahead of the other pairs that are between them.
    pub(crate) fn pairs_in_order(
        &self,
        pairs: Range<usize>,
        workspaces: &mut Workspaces,
        columns: &mut Columns,
        mut spend: impl FnMut(u64) -> Result<(), Stopped>,
    ) -> Result<(), Stopped> {
        let Workspaces { boxes, others } = workspaces;
        let mut next = pairs.start;
        while next < pairs.end {
            let Some(group) = self.group(next..pairs.end) else {
                return self.one_by_one(next..pairs.end, others, columns, &mut spend);
            };
            let query = self.bodies.template().query();
            let manifolds = box_manifolds(&group.boxes[..group.count], query, boxes);
            for (&ahead, manifold) in group.pairs[..group.count].iter().zip(manifolds) {
                self.one_by_one(next..ahead, others, columns, &mut spend)?;
                spend(self.add(ahead, manifold, &mut others.kinks, columns))?;
                next = ahead + 1;
            }
            spend(boxes.take_steps())?;
        }
        Ok(())
    }

    /// Computes these pairs without groups. Consecutive rows of the answer before are copied together.
    fn one_by_one(
        &self,
        pairs: Range<usize>,
        workspace: &mut PairWorkspace,
        columns: &mut Columns,
        spend: &mut impl FnMut(u64) -> Result<(), Stopped>,
    ) -> Result<(), Stopped> {
        let mut next = pairs.start;
        while next < pairs.end {
            let Some((step, rows)) = self.rows_to_reuse(next..pairs.end) else {
                spend(self.pair(next, workspace, columns))?;
                next += 1;
                continue;
            };
            spend(LEAST_STEPS * rows.len() as u64)?;
            let end = next + rows.len();
            if self.candidates.is_some() {
                columns.pairs.extend_from_slice(&self.pairs()[2 * next..2 * end]);
            }
            step.push_rows(rows, columns);
            next = end;
        }
        Ok(())
    }

    /// The consecutive rows of the answer before that the first of these pairs take as they are. `None` if the
    /// first pair takes no row.
    fn rows_to_reuse(&self, pairs: Range<usize>) -> Option<(&Step, Range<usize>)> {
        let (step, first) = self.row_to_reuse(pairs.start)?;
        let others = (pairs.start + 1..pairs.end).zip(first + 1..);
        let follows = |&(pair, row): &(usize, usize)| {
            self.row_to_reuse(pair).is_some_and(|(_, its_row)| its_row == row)
        };
        Some((step, first..first + 1 + others.take_while(follows).count()))
    }

    /// The first pairs of boxes among these pairs, as many as one group holds. `None` if there are none.
    fn group(&self, pairs: Range<usize>) -> Option<Group<'_>> {
        let mut found = pairs.filter_map(|pair| Some((pair, self.box_pair(pair)?)));
        let (pair, first) = found.next()?;
        let mut group = Group { pairs: [pair; GROUP], boxes: [first; GROUP], count: 1 };
        for (pair, boxes) in found.take(GROUP - 1) {
            group.pairs[group.count] = pair;
            group.boxes[group.count] = boxes;
            group.count += 1;
        }
        Some(group)
    }

    /// Pair `pair`, if it is a pair of boxes that has to be computed.
    fn box_pair(&self, pair: usize) -> Option<BoxPair<'_>> {
        let query = self.bodies.template().query();
        let bodies = self.pair_bodies(pair);
        let [hull_a, hull_b] = bodies.map(|body| self.bodies.hull(body).as_ref().ok());
        if !BoxPair::accepts(hull_a?, hull_b?, query) || self.row_to_reuse(pair).is_some() {
            return None;
        }
        let [pose_a, pose_b] = bodies.map(|body| self.bodies.pose(body));
        let (a, b) = (Body::new(hull_a?, pose_a?), Body::new(hull_b?, pose_b?));
        BoxPair::new(&a, &b, &self.bodies.query(bodies, [&a, &b]), self.warm_start(pair, &a, &b).as_ref())
    }

    /// Computes pair `pair`, which takes no row of the answer before, and adds it to `columns`. Returns the steps
    /// that it took.
    fn pair(&self, pair: usize, workspace: &mut PairWorkspace, columns: &mut Columns) -> u64 {
        let mut invalid = InvalidPair::default();
        let bodies = self.pair_bodies(pair);
        let [a, b] = bodies.map(|body| self.body(body, &mut invalid));
        let (Some(a), Some(b)) = (a, b) else {
            columns.push_invalid(invalid, self.kept);
            return LEAST_STEPS;
        };
        let warm = self.warm_start(pair, &a, &b);
        let query = self.bodies.query(bodies, [&a, &b]);
        let manifold = contact_manifold(&a, &b, &query, warm.as_ref(), &mut workspace.contact);
        let steps = self.add(pair, manifold, &mut workspace.kinks, columns);
        steps + workspace.contact.take_steps()
    }

    /// Adds the answer of a pair to `columns`, with its derivatives if they are asked for. Returns the steps of
    /// that.
    fn add(&self, pair: usize, manifold: &Manifold, kinks: &mut KinkScratch, columns: &mut Columns) -> u64 {
        if self.candidates.is_some() {
            if manifold.outcome == Outcome::Separated {
                return 0;
            }
            columns.push_pair(self.pair_bodies(pair));
        }
        columns.push(manifold, self.kept);
        if !self.kept.any_derivatives() {
            return LEAST_STEPS;
        }
        let [a, b] = self.pair_bodies(pair).map(|body| self.body(body, &mut InvalidPair::default()));
        let found = a.zip(b).and_then(|(a, b)| derivatives(&a, &b, manifold, kinks));
        columns.push_derivatives(found.as_ref(), self.kept);
        LEAST_STEPS + kinks.take_steps()
    }

    fn body(&self, index: u32, invalid: &mut InvalidPair) -> Option<Body<'_>> {
        let hull = match self.bodies.hull(index) {
            Ok(hull) => Some(hull),
            Err(missing) => {
                invalid.hull(*missing);
                None
            }
        };
        let pose = self.bodies.pose(index);
        if pose.is_none() {
            invalid.body();
        }
        Some(Body::new(hull?, pose?))
    }

    /// The pair's basis from an earlier answer, or `None` if it contains indices that are not registered
    /// for these hulls.
    fn warm_start(&self, pair: usize, a: &Body<'_>, b: &Body<'_>) -> Option<Basis> {
        let (bases, _) = self.warm_starts.as_chunks::<6>();
        let basis = match bases.get(pair) {
            Some(&[a0, a1, a2, b0, b1, b2]) => Basis { a: [a0, a1, a2], b: [b0, b1, b2] },
            None => self.link(pair).and_then(|(step, link)| step.basis(link))?,
        };
        let of = |vertices: [u32; 3], body: &Body<'_>| {
            vertices.iter().all(|&vertex| (vertex as usize) < body.hull.registered_count())
        };
        (of(basis.a, a) && of(basis.b, b)).then_some(basis)
    }

    /// The estimated steps of a pair.
    pub(crate) fn pair_steps(&self, pair: usize) -> u64 {
        if self.row_to_reuse(pair).is_some() {
            return LEAST_STEPS;
        }
        let hull = |side: usize| self.bodies.hull(self.pairs()[2 * pair + side]).as_ref().ok();
        match (hull(0), hull(1)) {
            (Some(a), Some(b)) => estimated_steps(a, b),
            _ => LEAST_STEPS,
        }
    }

    /// The estimated steps of the most expensive pair that the hulls can form. No pair costs more
    /// than the most expensive hull with itself.
    pub(crate) fn most_steps(&self) -> u64 {
        let hulls = self.bodies.hulls().iter().filter_map(|hull| hull.as_ref().ok());
        hulls.map(|hull| estimated_steps(hull, hull)).max().unwrap_or(LEAST_STEPS)
    }
}
