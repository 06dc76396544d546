//! The support mapping of a hull: a scan of all vertices, or for a large hull its map of directions.

use glam::DVec3;

use super::ConvexHull;
use crate::cost::{Count, MAPPED_CALL, scan_steps};
use crate::support::{SupportMap, farthest};

impl ConvexHull {
    /// The vertex `v` with the largest `n . v`; the lowest index if several tie. `n` is in the hull
    /// frame and need not be a unit vector.
    #[inline]
    pub(crate) fn support(&self, n: DVec3) -> u32 {
        self.counted_support(n, &Count::default())
    }

    /// [`ConvexHull::support`], and counts its steps in `count`.
    #[inline]
    pub(crate) fn counted_support(&self, n: DVec3, count: &Count) -> u32 {
        if let Some(map) = &self.support_map {
            return self.mapped(map, n, count);
        }
        count.add(scan_steps(self.vertices.len()));
        farthest(&self.columns, n)
    }

    /// The support mapping of a large hull. It is a separate function so that its code does not slow
    /// down small hulls.
    #[inline(never)]
    fn mapped(&self, map: &SupportMap, n: DVec3, count: &Count) -> u32 {
        count.add(MAPPED_CALL);
        map.farthest(&self.vertices, n).unwrap_or_else(|| {
            count.add(scan_steps(self.vertices.len()));
            farthest(&self.columns, n)
        })
    }
}
