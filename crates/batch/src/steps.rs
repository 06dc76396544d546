//! The steps of a simulation: what an answer takes from the answer before.
//!
//! A simulation asks for the same scene again and again, a little later each time. [`KeptRows`] are the rows of
//! an answer that are kept for the next step, and a [`Step`] says what has changed since. From both, a pair of
//! the next answer gets one of three things:
//!
//! - *its row*, bit for bit, if neither of its bodies has changed and the row is certain (CONTACT or
//!   SEPARATED);
//! - otherwise *its basis*, from which the solver starts warm;
//! - nothing, if the pair was not in the answer before.
//!
//! A pair finds its row by its [`Link`]. If the pairs are named and the same as before, row `i` is that of pair
//! `i`. If bodies have come and gone, pairs are sorted by their bodies, old and new ones, and merged: the first
//! row of a pair belongs to the first new pair of the same bodies, and so on. Bodies that changed their order
//! make the same pair with A and B swapped; such a row is never used as it is. If pairs are found, the
//! candidates of the broad phase and the rows are both in ascending order, and [`Walk`] merges them. All of it
//! takes `O(n log n)` time.
//!
//! A pair that is found, of bodies that have not changed, and that has no row, was SEPARATED before, since the
//! answer before had every other pair. So it still is, and is left out without a computation.

mod changes;
mod links;
mod rows;

use std::{ops::Range, sync::Arc};

use hullcast_contact::{Basis, Pose, Stop, Stopped, stop::Meter};

pub use self::{
    changes::{Changes, FormerPoses, Presence, bodies_now},
    links::{Link, StepPairs, Walk},
    rows::KeptRows,
};
use crate::{
    batch::Batch,
    codes::NO_INDEX,
    columns::Columns,
    matches::{PointId, PointPair, REACH, match_points},
    outputs::Outputs,
    scene::Bodies,
};

/// Steps to find a row's points and write its match.
const ROW_STEPS: u64 = 20;

/// What has changed since the answer before, and the rows of that answer.
#[derive(Debug)]
pub struct Step {
    rows: Arc<KeptRows>,
    changes: Changes,
    /// Whether rows are used again. Otherwise only their bases are.
    reuses: bool,
    /// Whether bodies, pairs, rules and options are all those of the message before.
    inherits: bool,
    /// The row of each pair that the request names; `None` if it is row `i` for pair `i`, or if the pairs are
    /// found.
    named: Option<Vec<Link>>,
    /// The rows by their pairs as they are numbered now, in ascending order; `None` if the numbers have not
    /// changed and the rows are in this order already.
    found: Option<Vec<([u32; 2], Link)>>,
}

impl Step {
    /// A step of a message that inherits. `reuses` says whether rows may be used again.
    pub fn inherited(rows: Arc<KeptRows>, changes: Changes, reuses: bool) -> Self {
        Self { rows, changes, reuses, inherits: true, named: None, found: None }
    }

    /// A step of a message that sends everything, with bodies of the message before. `bodies_now` has the
    /// number of each old body now, or [`NO_INDEX`] ([`bodies_now()`]).
    ///
    /// # Errors
    /// The work was stopped.
    pub fn of_bodies(
        rows: Arc<KeptRows>,
        changes: Changes,
        reuses: bool,
        bodies_now: &[u32],
        named_pairs: Option<&[u32]>,
        stop: &Stop,
    ) -> Result<Self, Stopped> {
        let meter = &Meter::new(stop);
        let (named, found) = match named_pairs {
            Some(pairs) => (Some(links::of_named(&rows, pairs, bodies_now, meter)?), None),
            None => (None, Some(links::of_found(&rows, bodies_now, meter)?)),
        };
        Ok(Self { rows, changes, reuses, inherits: false, named, found })
    }

    /// The most bytes that [`Self::of_bodies`] takes.
    pub fn bytes(rows: usize, pairs: usize) -> usize {
        // Keys of both sides, a second copy while they are sorted, and the links.
        (rows + pairs) * 40
    }

    /// The rows of the answer before.
    pub fn rows(&self) -> &Arc<KeptRows> {
        &self.rows
    }

    /// The changes since the message before.
    pub fn changes(&self) -> &Changes {
        &self.changes
    }

    /// Whether the next answer is known to have the same rows: nothing has changed, and every row is certain.
    pub fn repeats(&self) -> bool {
        self.reuses && self.inherits && self.changes.is_empty() && self.rows.are_certain()
    }

    /// The row of a pair that the request names.
    fn named_link(&self, pair: usize) -> Link {
        match &self.named {
            Some(links) => links.get(pair).copied().unwrap_or(Link::NONE),
            None => Link::new(pair, false),
        }
    }

    /// The row that a pair takes as it is.
    pub(crate) fn row_to_reuse(&self, bodies: [u32; 2], link: Link) -> Option<usize> {
        let (row, swapped) = link.row()?;
        let same = self.reuses && !swapped && bodies.iter().all(|&body| !self.changes.has(body));
        (same && self.rows.is_certain(row)).then_some(row)
    }

    /// The basis from which a pair starts.
    pub(crate) fn basis(&self, link: Link) -> Option<Basis> {
        let (row, swapped) = link.row()?;
        let (bases, _) = self.rows.columns().bases.as_chunks::<6>();
        let &[a0, a1, a2, b0, b1, b2] = bases.get(row)?;
        let (a, b) = ([a0, a1, a2], [b0, b1, b2]);
        Some(if swapped { Basis { a: b, b: a } } else { Basis { a, b } })
    }

    /// Adds consecutive rows of the answer before to the next answer.
    pub(crate) fn push_rows(&self, rows: Range<usize>, columns: &mut Columns) {
        let points = self.rows.points(rows.start).start..self.rows.points(rows.end - 1).end;
        let first_point = columns.point_count();
        columns.push_rows(self.rows.columns(), rows.clone(), points);
        columns.reset_last_rows(rows.len(), first_point);
    }

    /// Fills in the columns `previous_pairs` and `previous_points` of an answer, or a part of it, and marks in
    /// `seen` the rows that go on. `pairs` are the pairs that were computed; an answer to a search for pairs has
    /// some of them, in their order.
    ///
    /// # Errors
    /// The work was stopped.
    pub fn fill_matches(
        &self,
        bodies: &Bodies,
        pairs: Option<&StepPairs>,
        columns: &mut Columns,
        seen: &mut [bool],
        stop: &Stop,
    ) -> Result<(), Stopped> {
        let meter = &Meter::new(stop);
        let (mut at, mut first_point) = (0, 0);
        for row in 0..columns.len() {
            meter.spend(ROW_STEPS)?;
            let count = columns.point_counts[row] as usize;
            let points = first_point..first_point + count;
            first_point = points.end;
            let (pair, link) = match pairs {
                None => (bodies.template().pair(row), self.named_link(row)),
                Some(pairs) => {
                    let pair = [columns.pairs[2 * row], columns.pairs[2 * row + 1]];
                    while pairs.pair(at) != pair {
                        meter.spend(1)?;
                        at += 1;
                    }
                    (pair, pairs.link(at))
                }
            };
            let Some((old, swapped)) = link.row() else { continue };
            if !rows::goes_on(columns.outcomes[row]) || !self.rows.goes_on(old) {
                continue;
            }
            seen[old] = true;
            columns.previous_pairs[row] = old as u32;
            let mut matched = std::mem::take(&mut columns.previous_points);
            let pair =
                MatchedPair { step: self, bodies, pair, columns, first: points.start, row, old, swapped };
            let reach = pair.reach();
            let done =
                match_points(&pair, &mut matched[points], self.rows.matchable_points(old), reach, meter);
            columns.previous_points = matched;
            done?;
        }
        Ok(())
    }

    /// The pairs whose rows do not go on, with the bodies as they were numbered: 2 per pair.
    ///
    /// # Errors
    /// The work was stopped.
    pub fn ended_pairs(&self, seen: &[bool], stop: &Stop) -> Result<Vec<u32>, Stopped> {
        let (meter, mut ended) = (Meter::new(stop), Vec::new());
        for (row, &seen) in seen.iter().enumerate() {
            meter.spend(2)?;
            if !seen && self.rows.goes_on(row) {
                ended.extend(self.rows.pair(row));
            }
        }
        Ok(ended)
    }

    /// The estimated steps of matching this many rows and points.
    pub fn match_steps(rows: usize, points: usize) -> u64 {
        ROW_STEPS * rows as u64 + 8 * points as u64
    }
}

/// A pair in two answers.
struct MatchedPair<'a> {
    step: &'a Step,
    bodies: &'a Bodies,
    /// The bodies now.
    pair: [u32; 2],
    columns: &'a Columns,
    /// The first point of the row.
    first: usize,
    row: usize,
    /// The old row, and whether A and B have changed places since.
    old: usize,
    swapped: bool,
}

impl MatchedPair<'_> {
    fn reach(&self) -> f64 {
        let radius = |body: u32| self.bodies.hull(body).as_ref().map_or(0.0, |hull| hull.circumradius());
        REACH * radius(self.pair[0]).min(radius(self.pair[1]))
    }

    /// The old row's body on a side of the pair as it is now, and its pose then.
    fn former_pose(&self, side: usize) -> Option<Pose> {
        let old_side = if self.swapped { 1 - side } else { side };
        let old_body = self.step.rows.pair(self.old)[old_side];
        self.step.changes.former_pose(old_body, self.pair[side], self.bodies)
    }
}

/// The witnesses on A and on B of a point, each in a frame, or NaN without a frame.
fn local(columns: &Columns, row: usize, point: usize, frames: [Option<Pose>; 2]) -> [glam::DVec3; 2] {
    let at = |column: &[f64], index: usize| glam::DVec3::from_slice(&column[3 * index..][..3]);
    let witness_a = at(&columns.witness_as, point);
    let witness_b = witness_a + columns.distances[point] * at(&columns.normals, row);
    let within = |witness: glam::DVec3, frame: Option<Pose>| match frame {
        Some(pose) => pose.local(witness),
        None => glam::DVec3::NAN,
    };
    [within(witness_a, frames[0]), within(witness_b, frames[1])]
}

fn id(columns: &Columns, point: usize) -> PointId {
    let ids = &columns.point_ids[4 * point..][..4];
    [ids[0], ids[1], ids[2], ids[3]]
}

impl PointPair for MatchedPair<'_> {
    fn new_id(&self, index: usize) -> PointId {
        id(self.columns, self.first + index)
    }

    fn old_id(&self, index: usize) -> PointId {
        let [a0, a1, b0, b1] = id(self.step.rows.columns(), self.step.rows.points(self.old).start + index);
        if self.swapped { [b0, b1, a0, a1] } else { [a0, a1, b0, b1] }
    }

    fn new_point(&self, index: usize) -> crate::matches::LocalPoint {
        let frames = [0, 1].map(|side| self.bodies.pose(self.pair[side]));
        let [on_a, on_b] = local(self.columns, self.row, self.first + index, frames);
        crate::matches::LocalPoint { on_a, on_b }
    }

    fn old_point(&self, index: usize) -> crate::matches::LocalPoint {
        let point = self.step.rows.points(self.old).start + index;
        let mut frames = [0, 1].map(|side| self.former_pose(side));
        if self.swapped {
            frames.swap(0, 1);
        }
        let [mut on_a, mut on_b] = local(self.step.rows.columns(), self.old, point, frames);
        if self.swapped {
            std::mem::swap(&mut on_a, &mut on_b);
        }
        crate::matches::LocalPoint { on_a, on_b }
    }
}

impl Batch {
    /// The batch of the named pairs of a step, which takes what it can from the answer before.
    pub fn follow(&mut self, step: Arc<Step>) {
        self.step = Some((step, None));
    }

    /// The batch of found pairs of a step. Its answer has only those that are not SEPARATED, and their `pairs`.
    pub fn of_step(bodies: Bodies, pairs: Arc<StepPairs>, step: Option<Arc<Step>>) -> Self {
        let mut batch = Self::of_candidates(bodies, pairs.pairs().to_vec());
        batch.step = step.map(|step| (step, Some(pairs)));
        batch
    }

    /// Adds the columns that the next step needs, even if they are not asked for.
    pub fn keep_for_steps(&mut self) {
        self.kept = self.kept.kept_for_steps();
    }

    /// The step, and the row of a pair in the answer before.
    pub(crate) fn link(&self, pair: usize) -> Option<(&Step, Link)> {
        let (step, pairs) = self.step.as_ref()?;
        let link = pairs.as_ref().map_or_else(|| step.named_link(pair), |pairs| pairs.link(pair));
        Some((step, link))
    }
}

impl Outputs {
    /// These outputs, and those that the next step needs.
    #[must_use]
    pub fn kept_for_steps(self) -> Self {
        let matched = self.matches;
        Self {
            bases: true,
            points: self.points || matched,
            features: self.features || matched,
            normal: self.normal || matched,
            ..self
        }
    }
}

impl Columns {
    /// Resets what the last `count` rows, which are used again, do not take from the answer before: their matches,
    /// and the work that they took. `first_point` is the first point of these rows.
    fn reset_last_rows(&mut self, count: usize, first_point: usize) {
        fn reset(column: &mut [u32], count: usize, value: u32) {
            let first = column.len().saturating_sub(count); // a column that was not asked for is empty
            column[first..].fill(value);
        }
        let points = self.point_count() - first_point;
        reset(&mut self.iterations, count, 0);
        reset(&mut self.support_calls, count, 0);
        reset(&mut self.previous_pairs, count, NO_INDEX);
        reset(&mut self.previous_points, points, NO_INDEX);
    }
}
