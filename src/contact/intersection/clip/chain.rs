//! A large convex polygon clipped by another in linear time.
//!
//! It computes what cutting by one side of the window after another computes, to the bit, but
//! each cut looks only at the vertices near its line. Along a convex polygon the distance from a
//! line falls to its least value and rises again. The sides of the window turn around once,
//! and the nearest vertex moves around the polygon with them (rotating calipers; G. T.
//! Toussaint, *Solving geometric problems with the rotating calipers*, 1983).
//!
//! ```text
//! at = any vertex
//! for each side of the window:
//!     walk from `at` forwards and backwards until the distance has certainly passed its least
//!     value and is more than `eps`; at = the vertex of the least distance
//!     if that is beyond the side: replace the run of vertices beyond it by the two crossings
//! ```
//!
//! The vertices are a doubly linked list, so that a run is replaced in constant time. Every
//! vertex is removed once at most, every cut adds two at most, and `at` goes around once: `n`
//! and `m` sides take `O(n + m)`.
//!
//! A walk ends only where the distance is above the least one by more than all rounding that
//! may have gathered, a share of `eps` for each cut. So a vertex that was not looked at is
//! farther than `eps` inside. (Several runs beyond one side, which only rounding makes, are
//! cut as in the plain version.)

use super::{Clip, Cut, Line, Side, Vertex};
use crate::contact::intersection::outline::Outline;

/// Fewer vertices than this are cut by looking at all.
const FEW: usize = 16;

/// A vertex and its neighbours.
#[derive(Clone, Copy, Debug)]
struct Link {
    vertex: Vertex,
    next: u32,
    previous: u32,
    /// From the side that was walked along last.
    distance: f64,
}

/// The vertices kept, linked in a circle.
#[derive(Debug, Default)]
pub(super) struct Chain {
    links: Vec<Link>,
    /// The first vertex of the outline.
    start: u32,
    count: usize,
    /// Where the next walk begins.
    at: u32,
    /// Vertices that walks looked at.
    pub(super) looked_at: u64,
}

/// The vertices that a walk looked at, one after another.
struct Walk {
    first: u32,
    last: u32,
    /// The walk went all around.
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

    /// Looks at the vertices around the one nearest to the line of `side`, or beyond it.
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

    /// The last vertex inside before the run that is beyond the side, and the first inside after
    /// it; none if there is not one such run.
    fn ends(&self, walk: &Walk, eps: f64) -> Option<[u32; 2]> {
        let inside = |i: u32| self.link(i).distance >= -eps;
        // Not all around, the walk began and ended inside.
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

    /// Replaces the vertices beyond side `j` of the window, between two that are inside.
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

    /// A new vertex after `previous`.
    fn append(&mut self, previous: u32, vertex: Vertex) -> u32 {
        let i = self.links.len() as u32;
        self.links.push(Link { vertex, next: i, previous, distance: 0.0 });
        self.links[previous as usize].next = i;
        self.count += 1;
        i
    }
}

impl Clip {
    /// Cuts what is kept by every side of the window; whether a vertex was within `eps` of one.
    pub(super) fn clip_chain(&mut self, window: &Outline, eps: f64) -> bool {
        // Every cut rounds its new vertices by a few roundoffs, a sixteenth of `eps`.
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
