//! The matrix. A row is one value of an axis. It has a function that makes its cases, and a count
//! which shows that the cases are of the kind that the row names.

mod hulls;
mod planarity;
mod poses;
mod resting;

use std::sync::atomic::{AtomicUsize, Ordering};

use hullcast_contact::Workspace;

use super::case::Case;
use super::judge::{CaseCounts, SolverScore, judge};
use super::scene::Random;

/// One row of the matrix.
pub(crate) struct Row {
    pub(crate) axis: &'static str,
    pub(crate) value: String,
    /// The flag that the row is about; it may be raised in every case.
    pub(crate) about: About,
    /// This count must reach a tenth of the cases; otherwise the cases are not of the row's kind.
    meets: fn(&CaseCounts) -> usize,
    /// Large hulls are expensive: only one case in `thin` is run.
    thin: usize,
    stream: u64,
    make: Box<dyn FnMut(&mut Random) -> Case>,
}

/// The flag that a row may raise in every case.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum About {
    Nothing,
    GapOpen,
    Coincident,
}

impl Row {
    pub(crate) fn new(
        axis: &'static str,
        value: impl std::fmt::Display,
        make: impl FnMut(&mut Random) -> Case + 'static,
    ) -> Self {
        let meets = |counts: &CaseCounts| counts.overlapping + counts.apart;
        Self {
            axis,
            value: value.to_string(),
            about: About::Nothing,
            meets,
            thin: 1,
            stream: 0,
            make: Box::new(make),
        }
    }

    fn about(self, about: About) -> Self {
        Self { about, ..self }
    }

    fn meets(self, meets: fn(&CaseCounts) -> usize) -> Self {
        Self { meets, ..self }
    }

    fn thinned(self, thin: usize) -> Self {
        Self { thin, ..self }
    }
}

/// A row's scores, one cell per solver.
pub(crate) struct Score {
    pub(crate) axis: &'static str,
    pub(crate) value: String,
    pub(crate) cells: [SolverScore; 2],
}

/// Every row of the matrix.
pub(crate) fn rows() -> Vec<Row> {
    let mut rows = Vec::new();
    rows.extend(poses::scale());
    rows.extend(poses::world_offset());
    rows.extend(hulls::aspect());
    rows.extend(hulls::size_ratio());
    rows.extend(hulls::vertices());
    rows.extend(resting::facet_noise());
    rows.extend(resting::dihedral());
    rows.extend(planarity::any());
    rows.extend(planarity::resting());
    rows.extend(hulls::tiny());
    rows.extend(hulls::contraction_point());
    rows.extend(poses::centre_distance());
    rows.extend(poses::alpha());
    rows.extend(poses::margin());
    rows.extend(poses::ghosts());
    rows.extend(resting::tilt());
    rows.extend(resting::ties());
    rows.extend(poses::budgets());
    rows.extend(poses::quaternions());
    rows
}

impl Row {
    /// Each row has a random stream of its own, so that a new row changes no other row's cases.
    pub(crate) fn random(&self, stream: u64) -> Random {
        let name = self.axis.bytes().chain(self.value.bytes());
        Random::new(name.fold(7 + stream, |h, b| (h * 31 + u64::from(b)) & (u64::MAX >> 8)))
    }

    pub(crate) fn reseeded(self, stream: u64) -> Self {
        Self { stream, ..self }
    }

    pub(crate) fn case(&mut self, random: &mut Random) -> Case {
        (self.make)(random)
    }

    /// The number of cases that are run when `cases` are asked for.
    pub(crate) fn thinned_out(&self, cases: usize) -> usize {
        cases.div_ceil(self.thin)
    }
}

/// Calls `of` on every row, on all threads, and returns the results in the order of the rows. Each
/// row has a random stream of its own, so the result does not depend on the thread that runs it.
pub(crate) fn of_every_row<T: Send>(of: impl Fn(Row) -> T + Sync) -> Vec<T> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let next = AtomicUsize::new(0);
    let work = || {
        // Rows share shapes through `Rc`, so each thread builds its own rows.
        let mut own: Vec<Option<Row>> = rows().into_iter().map(Some).collect();
        let mut done = Vec::new();
        loop {
            let i = next.fetch_add(1, Ordering::Relaxed);
            let Some(row) = own.get_mut(i).and_then(Option::take) else { break done };
            done.push((i, of(row)));
        }
    };
    let mut done: Vec<(usize, T)> = std::thread::scope(|scope| {
        let handles: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        handles.into_iter().flat_map(|handle| handle.join().expect("rows")).collect()
    });
    done.sort_by_key(|(i, _)| *i);
    done.into_iter().map(|(_, made)| made).collect()
}

/// Runs `cases` cases of a row and checks the row's own claims: its kind of case is met often
/// enough, and flags that it is not about are rare (at most 1 % of the cases).
pub(crate) fn run(mut row: Row, cases: usize) -> Score {
    let cases = row.thinned_out(cases);
    let random = &mut row.random(row.stream);
    let mut workspace = Workspace::default();
    let mut cells = [SolverScore::default(), SolverScore::default()];
    for _ in 0..cases {
        judge(&row.case(random), &mut cells, &mut workspace);
    }
    for cell in &mut cells {
        let met = (row.meets)(&cell.counts);
        let all = cell.counts;
        cell.demand(10 * met >= cases, || format!("met {met} of {cases}: {all:?}"));
        let gap_open = if row.about == About::GapOpen { 0 } else { cell.gap_open };
        let coincident = if row.about == About::Coincident { 0 } else { cell.coincident };
        let flagged = gap_open + coincident + cell.undecided;
        cell.demand(100 * flagged <= cases, || format!("{flagged} of {cases} flagged"));
    }
    Score { axis: row.axis, value: row.value, cells }
}
