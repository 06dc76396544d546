//! The search for the pairs in which at least one body has moved.
//!
//! ```text
//! for each moved body, in order:
//!     search all trees for its partners with any index
//!     leave out the partners that have moved and have a lower index: they have found this pair
//! sort the pairs
//! ```
//!
//! The steps depend on the number of moved bodies and not on that of all bodies. The pairs are in order only when
//! all of them are known, so they are in memory together: the owner of a search bounds their number, and searches
//! for all pairs if there are more.

use hullcast_contact::{STEPS_BETWEEN_LOOKS, Stop, Stopped, sort::sort, stop::Meter};

use super::{BroadPhase, STEPS_PER_PARTNER, SearchProgress};

/// Steps to compare and move two pairs.
const COMPARISON: u64 = 2;

/// The bodies that have moved in a step.
#[derive(Clone, Debug, Default)]
pub struct MovedBodies {
    /// The bodies, ascending.
    list: Vec<u32>,
    /// One bit per body of the scene.
    bits: Vec<u64>,
}

impl MovedBodies {
    /// The moved bodies of a scene with `bodies` bodies. `list` is strictly ascending; indices that are out of
    /// range are left out.
    pub fn new(mut list: Vec<u32>, bodies: u32) -> Self {
        list.retain(|&body| body < bodies);
        let mut bits = vec![0; bodies.div_ceil(64) as usize];
        for &body in &list {
            bits[body as usize / 64] |= 1 << (body % 64);
        }
        Self { list, bits }
    }

    /// The bodies, ascending.
    pub fn list(&self) -> &[u32] {
        &self.list
    }

    /// Whether a body has moved.
    pub fn contains(&self, body: u32) -> bool {
        self.bits.get(body as usize / 64).is_some_and(|bits| bits >> (body % 64) & 1 == 1)
    }

    /// The bytes that the moved bodies of a scene take.
    pub fn bytes(moved: usize, bodies: usize) -> usize {
        moved * size_of::<u32>() + bodies.div_ceil(64) * size_of::<u64>()
    }
}

/// A search for the pairs of some of the moved bodies. It can be suspended and resumed.
#[derive(Debug)]
pub struct MovedSearch {
    /// The pairs found so far: the lower index is in the higher half of the number.
    keys: Vec<u64>,
    /// The place in the list of moved bodies of the body whose partners are searched for next.
    next: usize,
    end: usize,
    partners: Vec<u32>,
    progress: SearchProgress,
}

impl MovedSearch {
    /// Starts a search for the pairs of the bodies in `first..end` of the list of moved bodies.
    pub fn new(first: usize, end: usize) -> Self {
        let (keys, partners) = (Vec::new(), Vec::new());
        Self { keys, next: first, end, partners, progress: SearchProgress::default() }
    }

    /// Whether the search has found all its pairs.
    pub fn is_done(&self) -> bool {
        self.next >= self.end
    }

    /// The number of pairs found so far.
    pub fn pair_count(&self) -> usize {
        self.keys.len()
    }

    /// The pairs of several searches, in ascending order, 2 indices per pair.
    ///
    /// # Errors
    /// The computation was stopped.
    pub fn pairs(searches: impl IntoIterator<Item = Self>, stop: &Stop) -> Result<Vec<u32>, Stopped> {
        let mut keys: Vec<u64> = Vec::new();
        for mut search in searches {
            stop.spend(search.keys.len() as u64)?;
            keys.append(&mut search.keys);
        }
        sort(&mut keys, &Meter::new(stop), COMPARISON, Ord::cmp)?;
        stop.spend(keys.len() as u64)?;
        Ok(keys.into_iter().flat_map(|key| [(key >> 32) as u32, key as u32]).collect())
    }
}

impl BroadPhase {
    /// Resumes a search for pairs with a moved body. Returns after about `steps` steps, or once the search is done
    /// or has found `most` pairs.
    ///
    /// # Errors
    /// The computation was stopped.
    pub fn search_moved(
        &self,
        moved: &MovedBodies,
        search: &mut MovedSearch,
        steps: u64,
        most: usize,
        stop: &Stop,
    ) -> Result<(), Stopped> {
        let mut rest = steps;
        while rest > 0 && !search.is_done() && search.keys.len() < most {
            let some = rest.min(STEPS_BETWEEN_LOOKS);
            let mut left = some;
            while left > 0 && !search.is_done() && search.keys.len() < most {
                self.advance_moved(moved, search, &mut left);
            }
            rest -= some - left;
            stop.spend(some - left)?;
        }
        Ok(())
    }

    fn advance_moved(&self, moved: &MovedBodies, search: &mut MovedSearch, left: &mut u64) {
        let Some(&body) = moved.list.get(search.next) else {
            search.next = search.end;
            return;
        };
        if !self.find_partners(body, 0, &mut search.progress, &mut search.partners, left) {
            return;
        }
        *left = left.saturating_sub(1 + STEPS_PER_PARTNER * search.partners.len() as u64);
        let partners = search.partners.drain(..);
        let new = partners.filter(|&partner| partner > body || !moved.contains(partner));
        let key = |partner: u32| u64::from(body.min(partner)) << 32 | u64::from(body.max(partner));
        search.keys.extend(new.map(key));
        search.next += 1;
    }
}
