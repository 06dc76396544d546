//! A large convex polygon clipped by another in linear time.
//!
//! The result equals that of cutting by one side after another, bit for bit, but each cut examines only
//! the vertices near its line. Along a convex polygon the distance from a line falls to its least
//! value and rises again. The directions of the window's sides turn around once, and the vertex of
//! least distance moves around the polygon with them. These are rotating calipers (G. T. Toussaint,
//! *Solving geometric problems with the rotating calipers*, 1983):
//!
//! ```text
//! at = any vertex
//! for each side of the window:
//!     walk from `at` forwards and backwards, until the distance has certainly passed its least
//!         value and is more than eps; at = the vertex of least distance
//!     at is beyond the side: replace the run of vertices beyond it by the two crossings
//! ```
//!
//! The vertices form a doubly linked list, so that a run is replaced in constant time. Every vertex is
//! removed at most once, every cut adds at most two, and `at` goes around once. Polygons of `n` and `m`
//! sides therefore take `O(n + m)` time.
//!
//! A walk ends only where the distance exceeds the least one by more than all the rounding that may have
//! accumulated, which is a fraction of `eps` for each cut. Hence a vertex that was not examined is farther
//! than `eps` inside. Because of rounding, several runs of vertices may lie beyond one side. Such a cut is
//! done as in the plain version.

use super::{Clip, Cut, Line, Side, Vertex};
use crate::intersection::outline::Outline;

/// Polygons with fewer vertices than this are cut by examining all of them.
const FEW: usize = 16;

/// A vertex, and its neighbours in the list.
#[derive(Clone, Copy, Debug)]
struct Link {
    vertex: Vertex,
    next: u32,
    previous: u32,
    /// Distance from the side of the last walk that reached this vertex.
    distance: f64,
}

/// The vertices kept, linked in a circle.
#[derive(Debug, Default)]
pub(super) struct Chain {
    links: Vec<Link>,
    /// The first vertex of the outline.
    start: u32,
    count: usize,
    /// The vertex where the next walk begins.
    at: u32,
    /// Vertices examined by walks.
    pub(super) looked_at: u64,
}

/// The consecutive vertices that a walk examined.
struct Walk {
    first: u32,
    last: u32,
    /// Whether the walk went all the way around.
    whole: bool,
    least: f64,
    on_line: bool,
}

impl Chain {
    fn set(&mut self, vertices: &[Vertex]) {
        let count = vertices.len() as u32;
        self.links.clear();
        self.links.extend(vertices.iter().zip(0..).map(|(&vertex, i)| Link {
            vertex,
            next: if i + 1 == count { 0 } else { i + 1 },
            previous: if i == 0 { count.max(1) - 1 } else { i - 1 },
            distance: 0.0,
        }));
        (self.start, self.count, self.at) = (0, vertices.len(), 0);
    }

    fn write(&self, vertices: &mut Vec<Vertex>) {
        vertices.clear();
        let mut at = self.start;
        for _ in 0..self.count {
            vertices.push(self.link(at).vertex);
            at = self.link(at).next;
        }
    }

    fn link(&self, i: u32) -> &Link {
        &self.links[i as usize]
    }

    /// Examines the vertices on both sides of the one that is nearest to the line of `side` or farthest
    /// beyond it, and sets `at` to that vertex.
    fn walk(&mut self, side: &Side, eps: f64, slack: f64) -> Walk {
        let from = self.at;
        let mut walk = Walk { first: from, last: from, whole: false, least: f64::INFINITY, on_line: false };
        let mut looked_at = 1;
        self.look(from, side, eps, &mut walk);
        for forwards in [true, false] {
            let mut i = from;
            while looked_at < self.count {
                i = if forwards { self.link(i).next } else { self.link(i).previous };
                looked_at += 1;
                let distance = self.look(i, side, eps, &mut walk);
                if forwards {
                    walk.last = i
                } else {
                    walk.first = i
                }
                if distance > walk.least.max(eps) + slack {
                    break;
                }
            }
        }
        walk.whole = looked_at == self.count;
        self.looked_at += looked_at as u64;
        walk
    }

    fn look(&mut self, i: u32, side: &Side, eps: f64, walk: &mut Walk) -> f64 {
        let link = &mut self.links[i as usize];
        let distance = side.distance(link.vertex.at);
        link.distance = distance;
        if distance < walk.least {
            (walk.least, self.at) = (distance, i);
        }
        walk.on_line |= distance.abs() <= eps;
        distance
    }

    /// The last vertex inside before the run beyond the side, and the first vertex inside after it. None
    /// if there is not exactly one such run.
    fn ends(&self, walk: &Walk, eps: f64) -> Option<[u32; 2]> {
        let inside = |i: u32| self.link(i).distance >= -eps;
        // A walk that did not go all the way around began and ended inside.
        let (mut leaves, mut enters, mut runs) = (0, 0, 0);
        let mut before = !walk.whole || inside(walk.last);
        let mut i = walk.first;
        loop {
            if !inside(i) && before {
                leaves = self.link(i).previous;
            } else if inside(i) && !before {
                enters = i;
                runs += 1;
            }
            before = inside(i);
            if i == walk.last {
                break;
            }
            i = self.link(i).next;
        }
        (runs == 1).then_some([leaves, enters])
    }

    /// Replaces the vertices beyond side `j` of the window, between two that are inside, by the crossings.
    fn replace(&mut self, window: &Outline, j: u32, eps: f64, [leaves, enters]: [u32; 2]) {
        let mut beyond = self.link(leaves).next;
        while beyond != enters {
            self.count -= 1;
            beyond = self.link(beyond).next;
        }
        let of = |i: u32| (&self.link(i).vertex, self.link(i).distance);
        let (left, entered) = Cut {
            window,
            j,
            eps,
            leaves: [of(leaves), of(self.link(leaves).next)],
            enters: [of(self.link(enters).previous), of(enters)],
        }
        .vertices();
        let mut last = leaves;
        if let Some(vertex) = left {
            last = self.append(last, vertex);
        } else {
            self.links[last as usize].vertex.line = Line::Window(j);
        }
        if let Some(vertex) = entered {
            last = self.append(last, vertex);
        }
        self.links[last as usize].next = enters;
        self.links[enters as usize].previous = last;
        (self.start, self.at) = (enters, last);
    }

    /// Adds a new vertex after `previous` and returns its index.
    fn append(&mut self, previous: u32, vertex: Vertex) -> u32 {
        let i = self.links.len() as u32;
        self.links.push(Link { vertex, next: i, previous, distance: 0.0 });
        self.links[previous as usize].next = i;
        self.count += 1;
        i
    }
}

impl Clip {
    /// [`Clip::cut_plainly`] in linear time.
    pub(super) fn cut_chain(&mut self, window: &Outline, eps: f64) -> bool {
        // Every cut rounds its new vertices by a few roundoffs: at most a sixteenth of `eps`.
        let cuts = self.kept.len() + window.sides.len();
        let slack = eps * (2.0 + cuts as f64 / 8.0);
        let (mut on_line, mut linked) = (false, false);
        for (side, j) in window.sides.iter().zip(0..) {
            // A side of no length bounds nothing.
            if side.inward.is_nan() {
                continue;
            }
            if !linked && self.kept.len() >= FEW {
                self.chain.set(&self.kept);
                linked = true;
            }
            if linked {
                let walk = self.chain.walk(side, eps, slack);
                on_line |= walk.on_line;
                if walk.least >= -eps {
                    continue;
                }
                if let Some(ends) = self.chain.ends(&walk, eps) {
                    self.chain.replace(window, j, eps, ends);
                    if self.chain.count >= FEW {
                        continue;
                    }
                    self.chain.write(&mut self.kept);
                    linked = false;
                    continue;
                }
                self.chain.write(&mut self.kept);
                linked = false;
            }
            self.chain.looked_at += self.kept.len() as u64;
            on_line |= self.cut(window, j, eps);
        }
        if linked {
            self.chain.write(&mut self.kept);
        }
        on_line
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec2;

    use super::*;
    use crate::intersection::outline::{Corner, random_polygon};
    use crate::workload::Random;

    /// Polygons in every position, with corners on lines and nearly parallel sides: the chain must keep the
    /// same outline as the plain version, bit for bit. Catches a walk that passes the nearest vertex, a run
    /// that leaves a vertex beyond a side or loses one inside, crossings linked in the wrong order, and an
    /// outline that begins elsewhere.
    #[test]
    fn a_chain_keeps_what_the_plain_version_keeps() {
        let mut random = Random::new(21);
        let (mut plain, mut chain) = (Clip::default(), Clip::default());
        let (mut cut, mut empty, mut on_line) = (0, 0, 0);
        for round in 0..4000 {
            let [of_a, of_b] = [(); 2].map(|()| 3 + random.below(150));
            let (a, mut b) = (random_polygon(&mut random, of_a, 0), random_polygon(&mut random, of_b, 1000));
            match round % 4 {
                // Nearly the same polygon, rotated a little.
                0 => {
                    let turn = DVec2::from_angle(10_f64.powi(-2 - round / 4 % 14));
                    b.corners.clone_from(&a.corners);
                    b.corners.iter_mut().for_each(|c| c.at = turn.rotate(c.at));
                }
                // A corner on a line.
                1 => {
                    let (from, to) = (a.corners[0].at, a.corners[1].at);
                    let moved = from + random.unit() * (to - from) - b.corners[of_b / 2].at;
                    b.corners.iter_mut().for_each(|c: &mut Corner| c.at += moved);
                }
                _ => {}
            }
            b.set_sides();
            for eps in [1e-14, 1e-9, 1e-4] {
                plain.begin(&a);
                chain.begin(&a);
                let touched = plain.cut_plainly(&b, eps);
                assert_eq!(chain.cut_chain(&b, eps), touched);
                assert_eq!(chain.kept, plain.kept);
                on_line += usize::from(touched);
                cut += usize::from(!plain.kept.is_empty());
                empty += usize::from(plain.kept.is_empty());
            }
        }
        assert!(cut > 5000 && empty > 1000 && on_line > 3000, "{cut} {empty} {on_line}");
    }
}
