//! The row that each pair of a step had in the answer before.

use hullcast_contact::{Stopped, sort::sort, stop::Meter};

use super::{KeptRows, Step};
use crate::codes::NO_INDEX;

/// Steps to compare and move two keys.
const COMPARISON: u64 = 3;

/// Steps to look at a pair.
const PAIR_STEPS: u64 = 5;

/// The most pairs that a walk looks at in one call.
const AT_A_TIME: usize = 1 << 16;

/// The bit that says that A and B have changed places.
const SWAPPED: u32 = 1 << 31;

/// The row of a pair in the answer before, if there is one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Link(u32);

impl Link {
    /// The link of a pair that was not in the answer before.
    pub const NONE: Self = Self(u32::MAX);

    pub(super) fn new(row: usize, swapped: bool) -> Self {
        Self(row as u32 | if swapped { SWAPPED } else { 0 })
    }

    /// The row, and whether A and B have changed places since.
    pub(super) fn row(self) -> Option<(usize, bool)> {
        (self != Self::NONE).then_some(((self.0 & !SWAPPED) as usize, self.0 & SWAPPED != 0))
    }
}

/// The key of a pair, independent of the order of its bodies.
fn key(pair: [u32; 2]) -> u64 {
    u64::from(pair[0].min(pair[1])) << 32 | u64::from(pair[0].max(pair[1]))
}

/// The rows whose bodies are both still there: their pairs as they are numbered now, with their keys, in
/// ascending order.
fn sorted_rows(
    rows: &KeptRows,
    bodies_now: &[u32],
    meter: &Meter<'_>,
) -> Result<Vec<(u64, u32, bool)>, Stopped> {
    let mut sorted = Vec::with_capacity(rows.len());
    for (row, pair) in (0..).zip(rows.pairs().as_chunks::<2>().0) {
        meter.spend(PAIR_STEPS)?;
        let [a, b] = pair.map(|body| bodies_now.get(body as usize).copied().unwrap_or(NO_INDEX));
        if a != NO_INDEX && b != NO_INDEX {
            sorted.push((key([a, b]), row, a > b));
        }
    }
    sort(&mut sorted, meter, COMPARISON, Ord::cmp)?;
    Ok(sorted)
}

/// The rows by their pairs, in ascending order; of several rows of one pair only the first.
pub(super) fn of_found(
    rows: &KeptRows,
    bodies_now: &[u32],
    meter: &Meter<'_>,
) -> Result<Vec<([u32; 2], Link)>, Stopped> {
    let mut sorted = sorted_rows(rows, bodies_now, meter)?;
    meter.spend(sorted.len() as u64)?;
    sorted.dedup_by_key(|(key, ..)| *key);
    let pair = |key: u64| [(key >> 32) as u32, key as u32];
    // Found pairs have their lower body first.
    Ok(sorted.into_iter().map(|(key, row, swapped)| (pair(key), Link::new(row as usize, swapped))).collect())
}

/// The row of each of these pairs. Of several pairs of the same bodies, the first gets the first row.
pub(super) fn of_named(
    rows: &KeptRows,
    pairs: &[u32],
    bodies_now: &[u32],
    meter: &Meter<'_>,
) -> Result<Vec<Link>, Stopped> {
    let old = sorted_rows(rows, bodies_now, meter)?;
    let (pairs, _) = pairs.as_chunks::<2>();
    let mut new = Vec::with_capacity(pairs.len());
    for (index, &pair) in (0_u32..).zip(pairs) {
        meter.spend(PAIR_STEPS)?;
        new.push((key(pair), index));
    }
    sort(&mut new, meter, COMPARISON, Ord::cmp)?;
    let mut links = vec![Link::NONE; pairs.len()];
    let mut old = old.into_iter().peekable();
    for (key, index) in new {
        while old.next_if(|&(before, ..)| before < key).is_some() {
            meter.spend(1)?;
        }
        if let Some((_, row, was_descending)) = old.next_if(|&(same, ..)| same == key) {
            let [a, b] = pairs[index as usize];
            links[index as usize] = Link::new(row as usize, was_descending != (a > b));
        }
    }
    Ok(links)
}

/// Pairs of a step that are computed together, with their links.
#[derive(Debug, Default)]
pub struct StepPairs {
    pairs: Vec<u32>,
    links: Vec<Link>,
}

impl StepPairs {
    /// Adds candidates that were not in the answer before, until there are `most` pairs. Returns the number of
    /// indices that were used.
    pub fn extend_anew(&mut self, candidates: &[u32], most: usize) -> usize {
        let used = candidates.len().min(2 * most.saturating_sub(self.len()));
        self.pairs.extend_from_slice(&candidates[..used]);
        self.links.resize(self.pairs.len() / 2, Link::NONE);
        used
    }

    /// The number of pairs.
    pub fn len(&self) -> usize {
        self.links.len()
    }

    /// Whether there are no pairs.
    pub fn is_empty(&self) -> bool {
        self.links.is_empty()
    }

    /// The bodies, 2 per pair.
    pub fn pairs(&self) -> &[u32] {
        &self.pairs
    }

    pub(super) fn pair(&self, index: usize) -> [u32; 2] {
        [self.pairs[2 * index], self.pairs[2 * index + 1]]
    }

    pub(super) fn link(&self, index: usize) -> Link {
        self.links.get(index).copied().unwrap_or(Link::NONE)
    }

    fn push(&mut self, pair: [u32; 2], link: Link) {
        self.pairs.extend_from_slice(&pair);
        self.links.push(link);
    }

    /// Cuts the pairs into two halves. `None` if there is only one.
    pub fn halves(&self) -> Option<[Self; 2]> {
        let middle = self.len() / 2;
        if middle == 0 {
            return None;
        }
        let (first, second) = (self.pairs.split_at(2 * middle), self.links.split_at(middle));
        let half = |pairs: &[u32], links: &[Link]| Self { pairs: pairs.to_vec(), links: links.to_vec() };
        Some([half(first.0, second.0), half(first.1, second.1)])
    }
}

/// A walk through the candidates of a step and the rows of the answer before, both in ascending order.
///
/// If the step inherits, a row whose bodies have not changed is taken whether or not its pair is among the
/// candidates. So a broad phase may leave out the pairs of bodies that have not changed.
#[derive(Debug, Default)]
pub struct Walk {
    /// The next row.
    next: usize,
}

impl Step {
    /// The pair and the link of the next row of a walk.
    fn walked(&self, next: usize) -> Option<([u32; 2], Link)> {
        match &self.found {
            Some(found) => found.get(next).copied(),
            None => (next < self.rows.len()).then(|| (self.rows.pair(next), Link::new(next, false))),
        }
    }

    fn has_changed(&self, pair: [u32; 2]) -> bool {
        pair.iter().any(|&body| self.changes.has(body))
    }
}

impl Walk {
    /// Adds the next pairs of a step to `into`, until it has `most` pairs, the candidates are used up, or many
    /// thousand pairs were passed. Returns the number of candidates that were used. `are_last` says that no other
    /// candidates follow; then the rest of the rows follows the candidates.
    ///
    /// # Errors
    /// The work was stopped.
    pub fn take(
        &mut self,
        step: &Step,
        candidates: &[u32],
        are_last: bool,
        most: usize,
        into: &mut StepPairs,
        meter: &Meter<'_>,
    ) -> Result<usize, Stopped> {
        let (candidates, _) = candidates.as_chunks::<2>();
        let mut used = 0;
        for _ in 0..AT_A_TIME {
            meter.spend(PAIR_STEPS)?;
            if into.len() >= most {
                break;
            }
            let candidate = candidates.get(used).copied();
            let row = step.walked(self.next);
            match (candidate, row) {
                (Some(candidate), Some((pair, link))) if pair == candidate => {
                    into.push(pair, link);
                    self.next += 1;
                    used += 1;
                }
                (Some(candidate), row) if row.is_none_or(|(pair, _)| pair > candidate) => {
                    if !step.inherits || !step.reuses || step.has_changed(candidate) {
                        into.push(candidate, Link::NONE);
                    }
                    used += 1;
                }
                (candidate, Some((pair, link))) if candidate.is_some() || are_last => {
                    if step.inherits && !step.has_changed(pair) {
                        into.push(pair, link);
                    }
                    self.next += 1;
                }
                _ => break,
            }
        }
        Ok(used)
    }

    /// Whether all rows were passed.
    pub fn is_done(&self, step: &Step) -> bool {
        step.walked(self.next).is_none()
    }
}

#[cfg(test)]
mod tests {
    use std::{collections::BTreeMap, sync::Arc};

    use hullcast_contact::{Stop, workload::Random};

    use super::*;
    use crate::{codes::outcome, columns::Columns, scene::SceneTemplate, steps::Changes};

    const BODIES: u32 = 12;

    /// Rows with these pairs, all of them contacts.
    fn rows(pairs: &[[u32; 2]], named: bool) -> Arc<KeptRows> {
        let meter_stop = Stop::default();
        let meter = &Meter::new(&meter_stop);
        let flat = pairs.as_flattened().to_vec();
        let (of_template, found) = if named { (flat, Vec::new()) } else { (Vec::new(), flat) };
        let template = SceneTemplate::new(1, vec![0; BODIES as usize], of_template, meter).unwrap();
        let outcomes = vec![outcome::CONTACT; pairs.len()];
        let mut columns = Columns::default();
        (columns.pairs, columns.outcomes) = (found, outcomes);
        Arc::new(KeptRows::new(Arc::new(template), columns, &Stop::default()).unwrap())
    }

    /// A random choice of pairs, in ascending order.
    fn some_pairs(random: &mut Random, of: u64) -> Vec<[u32; 2]> {
        let all = (0..BODIES).flat_map(|a| (a + 1..BODIES).map(move |b| [a, b]));
        all.filter(|_| random.bits() % 8 < of).collect()
    }

    /// Catches a row of unmoved bodies that is lost where the broad phase leaves it out, or doubled where it does
    /// not; a row that stays although a body moved away; a pair out of order; and a walk that depends on how the
    /// candidates are cut.
    #[test]
    fn a_walk_joins_rows_and_candidates() {
        let mut random = Random::new(9);
        let (mut reused, mut left_out, mut parted) = (0, 0, 0);
        for case in 0..3_000_u64 {
            let old = some_pairs(&mut random, 3);
            let changed: Vec<bool> = (0..BODIES).map(|_| random.bits().is_multiple_of(3)).collect();
            let is_changed = |pair: &[u32; 2]| pair.iter().any(|&body| changed[body as usize]);
            // The pairs that meet now: of unmoved bodies those that met before, and perhaps others that were
            // separated.
            let drawn = some_pairs(&mut random, 4);
            let candidates: Vec<[u32; 2]> = if case % 2 == 0 {
                // A broad phase that leaves out the pairs of unmoved bodies.
                drawn.iter().copied().filter(is_changed).collect()
            } else {
                // One that has them all.
                let both = drawn.iter().chain(old.iter().filter(|pair| !is_changed(pair)));
                let mut all: Vec<_> = both.copied().collect();
                all.sort_unstable();
                all.dedup();
                all
            };
            let mut expected: BTreeMap<[u32; 2], Link> = BTreeMap::new();
            for (row, pair) in old.iter().enumerate() {
                let stays = !is_changed(pair) || candidates.contains(pair);
                if stays {
                    expected.insert(*pair, Link::new(row, false));
                }
                reused += u32::from(!is_changed(pair));
                parted += u32::from(!stays);
            }
            for pair in candidates.iter().filter(|pair| is_changed(pair)) {
                expected.entry(*pair).or_insert(Link::NONE);
            }
            left_out += candidates.len() + old.len() - expected.len();
            let changes = Changes::of_test(changed.clone());
            let step = Step::inherited(rows(&old, false), changes, true);
            let stop = Stop::default();
            let (mut walk, mut found) = (Walk::default(), Vec::new());
            let mut given = candidates.as_flattened();
            let (most, piece) = (1 + case as usize % 5, 2 * (1 + case as usize % 7));
            loop {
                let mut pairs = StepPairs::default();
                while pairs.len() < most {
                    let some = &given[..piece.min(given.len())];
                    let is_last = given.is_empty();
                    let used = walk.take(&step, some, is_last, most, &mut pairs, &Meter::new(&stop)).unwrap();
                    given = &given[2 * used..];
                    if is_last && walk.is_done(&step) {
                        break;
                    }
                }
                if pairs.is_empty() {
                    break;
                }
                found.extend((0..pairs.len()).map(|index| (pairs.pair(index), pairs.link(index))));
            }
            assert_eq!(found, expected.into_iter().collect::<Vec<_>>(), "case {case}");
        }
        let counts = [reused as usize, left_out, parted as usize];
        assert!(counts.iter().all(|&count| count > 5_000), "{counts:?}");
    }

    /// Catches a pair that gets the row of other bodies, a row that two pairs get, and a change of A and B that is
    /// not noticed. Compares with a search of all rows for each pair in turn.
    #[test]
    fn named_pairs_get_their_rows_in_order() {
        let mut random = Random::new(10);
        let (mut linked, mut swapped, mut repeated) = (0, 0, 0);
        for case in 0..2_000 {
            let mut pairs = |count: u64| -> Vec<[u32; 2]> {
                (0..count).map(|_| [0; 2].map(|_| (random.bits() % u64::from(BODIES)) as u32)).collect()
            };
            let (old, new) = (pairs(60), pairs(60));
            // Some bodies are gone, and the others have other numbers.
            let now: Vec<u32> = (0..BODIES)
                .map(|body| if body % 5 == 4 { NO_INDEX } else { (body * 7 + case) % BODIES })
                .collect();
            let rows = rows(&old, true);
            let stop = Stop::default();
            let links = of_named(&rows, new.as_flattened(), &now, &Meter::new(&stop)).unwrap();
            let mut used = vec![false; old.len()];
            for (&[a, b], link) in new.iter().zip(&links) {
                let same = |row: &usize| {
                    let [c, d] = old[*row].map(|body| now[body as usize]);
                    !used[*row] && ([c, d] == [a, b] || [d, c] == [a, b])
                };
                let expected = (0..old.len()).find(same);
                assert_eq!(link.row().map(|(row, _)| row), expected, "case {case}");
                if let Some(row) = expected {
                    used[row] = true;
                    let was = old[row].map(|body| now[body as usize]);
                    assert_eq!(link.row(), Some((row, was != [a, b])));
                    linked += 1;
                    swapped += u32::from(was != [a, b]);
                    repeated += u32::from(new.iter().filter(|pair| key(**pair) == key([a, b])).count() > 1);
                }
            }
        }
        assert!(linked > 20_000 && swapped > 5_000 && repeated > 5_000, "{linked} {swapped} {repeated}");
    }
}
