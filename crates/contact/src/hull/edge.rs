//! Edges between faces while a hull is built.

use crate::sort::{COMPARISON, sort};
use crate::stop::{Meter, Stopped};

/// An edge: its end vertices, the lower index first, and the faces on the left and on the right of
/// the way from the first end to the second.
pub(super) type Edge = ([u32; 2], [u32; 2]);

/// Sorts edges by their vertices, then by their faces.
pub(super) fn sort_edges(edges: &mut Vec<Edge>, meter: &Meter<'_>) -> Result<(), Stopped> {
    let key = |([u, v], [left, right]): &Edge| {
        [u, v, left, right].into_iter().fold(0_u128, |key, &part| key << 32 | u128::from(part))
    };
    sort(edges, meter, COMPARISON, |e, f| key(e).cmp(&key(f)))
}
