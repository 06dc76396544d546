//! A feature clipped by a convex polygon, in any position.
//!
//! I. E. Sutherland and G. W. Hodgman, *Reentrant polygon clipping*, 1974, doi:10.1145/360767.360802.
//! The *subject* (a point, a segment or a polygon) is cut by the line of one side of the *window* after
//! another. Each vertex carries the features that make it:
//!
//! ```text
//! kept = vertices of the subject
//! for each side of the window:
//!     keep the vertices inside its line; where the outline passes from one side of the line
//!     to the other, add the crossing
//! ```
//!
//! Departure: the tests have the tolerance `eps`. An outline crosses a line only if it passes from more
//! than `eps` inside to more than `eps` outside, or back. A vertex within `eps` of the line is on it and
//! stands for the crossing itself. A point within `eps` of both sides of a sharp corner may be far
//! beyond the corner, so such parts are cut off across the corner at the end.
//!
//! Each side examines every vertex that is left, so the time is quadratic. That is fastest for the few
//! sides of most faces. Large polygons are cut by [`chain`], which gives the same vertices in linear
//! time.

use glam::DVec2;

use super::outline::{Outline, Side};
use crate::tolerance::SHARP;
use chain::Chain;

mod chain;

/// Polygons whose numbers of sides have a larger product than this are cut as a [`Chain`].
const LARGE: usize = 1024;

/// Whether two polygons are so large that examining every pair of sides would take too long.
pub(super) fn are_large(a: &Outline, b: &Outline) -> bool {
    let [a, b] = [a, b].map(|outline| outline.corners.len());
    a > 2 && b > 2 && a * b > LARGE
}

/// A vertex of the intersection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Vertex {
    pub(super) at: DVec2,
    pub(super) made: Made,
    /// The line that the outline follows from this vertex to the next.
    line: Line,
}

/// The features that make a vertex, by indices into the two outlines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Made {
    /// A corner of the subject, inside the window.
    Own(u32),
    /// A corner of the window, inside the subject. If `near`, the vertex is only near the corner: two
    /// sides meet in it that are not neighbours, and the sides between them are within `eps` of it.
    Window { corner: u32, near: bool },
    /// The crossing of a side of the subject and a side of the window.
    Crossing(u32, u32),
    /// The crossing of two sides of the window that are not neighbours. The sides between usually cut
    /// it off again. If not, it becomes the nearest corner of the window in the end.
    Meeting([u32; 2]),
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Line {
    /// A side of the subject.
    Own(u32),
    /// A side of the window.
    Window(u32),
}

/// Consecutive vertices around a polygon.
struct Run {
    first: usize,
    count: usize,
}

impl Run {
    /// The vertices whose distance is at least `least`. None if they are not a single run, or if they
    /// are all the vertices or none.
    fn of(distances: &[f64], least: f64) -> Option<Self> {
        let (mut first, mut count, mut starts) = (0, 0, 0);
        let mut before = *distances.last()? >= least;
        for (i, &distance) in distances.iter().enumerate() {
            // Computed without branches, because they would be unpredictable.
            let inside = distance >= least;
            let starts_here = inside & !before;
            first = if starts_here { i } else { first };
            starts += usize::from(starts_here);
            count += usize::from(inside);
            before = inside;
        }
        (starts == 1).then_some(Self { first, count })
    }
}

/// The vertices kept, and buffers.
#[derive(Debug, Default)]
pub(super) struct Clip {
    pub(super) kept: Vec<Vertex>,
    next: Vec<Vertex>,
    /// The distance of each kept vertex from the side that cuts.
    distances: Vec<f64>,
    chain: Chain,
}

impl Clip {
    /// Vertices of large polygons examined since the last call. Small polygons are not counted.
    pub(super) fn take_looked_at(&mut self) -> u64 {
        std::mem::take(&mut self.chain.looked_at)
    }

    /// Keeps in `kept` the part of `subject` (a point, a segment or a polygon) inside the polygon
    /// `window`, in order. Vertices closer than `eps` to each other are not merged yet.
    pub(super) fn clip(&mut self, subject: &Outline, window: &Outline, eps: f64) {
        self.begin(subject);
        let on_line = if are_large(subject, window) {
            self.cut_chain(window, eps)
        } else {
            self.cut_plainly(window, eps)
        };
        if on_line {
            self.cut_corners(window, eps);
        }
        for v in &mut self.kept {
            if let Made::Meeting(sides) = v.made {
                v.made = Made::Window { corner: nearest_corner(window, v.at, sides), near: true };
            }
        }
    }

    /// Starts with all vertices of `subject`.
    fn begin(&mut self, subject: &Outline) {
        self.kept.clear();
        let corners = subject.corners.iter().zip(0..);
        self.kept.extend(corners.map(|(c, i)| Vertex { at: c.at, made: Made::Own(i), line: Line::Own(i) }));
    }

    /// Cuts by every side of the window. Returns whether a vertex was within `eps` of one.
    fn cut_plainly(&mut self, window: &Outline, eps: f64) -> bool {
        (0..window.sides.len() as u32).fold(false, |on_line, j| on_line | self.cut(window, j, eps))
    }

    /// Cuts by side `j` of the window. Returns whether a vertex is within `eps` of it.
    fn cut(&mut self, window: &Outline, j: u32, eps: f64) -> bool {
        let Self { kept, distances, .. } = self;
        let side = window.sides[j as usize];
        distances.clear();
        let (mut least, mut on_line) = (f64::INFINITY, false);
        distances.extend(kept.iter().map(|v| {
            let distance = side.distance(v.at);
            // A side of no length (distance NaN) bounds nothing: its distance is never the smaller.
            least = if distance < least { distance } else { least };
            on_line |= distance.abs() <= eps;
            distance
        }));
        if least >= -eps {
            return on_line;
        }
        if kept.len() > 2
            && let Some(inside) = Run::of(distances, -eps)
        {
            self.keep_run(window, &inside, j, eps);
        } else {
            self.keep_each(window, j, eps);
        }
        std::mem::swap(&mut self.kept, &mut self.next);
        on_line
    }

    /// Cuts a polygon that leaves the window across side `j` once and comes back once.
    fn keep_run(&mut self, window: &Outline, inside: &Run, j: u32, eps: f64) {
        let Self { kept, next, distances, .. } = self;
        next.clear();
        let unwrapped = inside.count.min(kept.len() - inside.first);
        next.extend_from_slice(&kept[inside.first..][..unwrapped]);
        next.extend_from_slice(&kept[..inside.count - unwrapped]);
        let wrapped = |i: usize| if i >= kept.len() { i - kept.len() } else { i };
        let leaves = [inside.count - 1, inside.count].map(|i| wrapped(inside.first + i));
        let enters = [wrapped(inside.first + kept.len() - 1), inside.first];
        let [leaves, enters] = [leaves, enters].map(|two| two.map(|i| (&kept[i], distances[i])));
        let (leaves, enters) = Cut { window, j, eps, leaves, enters }.vertices();
        next.extend(leaves);
        let last = next.len() - 1;
        next[last].line = Line::Window(j);
        next.extend(enters);
    }

    /// Cuts a segment, or a polygon that leaves the window more than once because of rounding.
    fn keep_each(&mut self, window: &Outline, j: u32, eps: f64) {
        let Self { kept, next, distances, .. } = self;
        next.clear();
        let closed = kept.len() > 2;
        for (i, (&p, &from)) in kept.iter().zip(distances.iter()).enumerate() {
            let last = i + 1 == kept.len();
            let following = if last { 0 } else { i + 1 };
            let to = distances[following];
            let goes_on = closed || !last;
            let leaves = to < -eps && goes_on;
            if from >= -eps {
                next.push(if leaves && from <= eps { Vertex { line: Line::Window(j), ..p } } else { p });
            }
            if leaves && from > eps {
                let crossing = crossing(window, &p, &kept[following], from / (from - to), j);
                next.push(Vertex { line: Line::Window(j), ..crossing });
            } else if from < -eps && to > eps && goes_on {
                next.push(crossing(window, &p, &kept[following], from / (from - to), j));
            }
        }
    }

    /// Cuts off the part that is more than `eps` beyond a sharp corner, by a line across the corner.
    #[cold]
    fn cut_corners(&mut self, window: &Outline, eps: f64) {
        let Self { kept, next, .. } = self;
        let mut before = window.sides.len() - 1;
        for (j, corner) in window.corners.iter().enumerate() {
            let sides = [before, j].map(|side| window.sides[side].inward);
            before = j;
            // At a corner of 90 degrees or more, points within `eps` of both sides are near the corner.
            if !((sides[0] + sides[1]).length_squared() < SHARP) {
                continue;
            }
            // The bisector of the corner, pointing inward.
            let inward = (sides[0] - sides[1]).perp().normalize();
            let beyond = |v: &Vertex| inward.dot(v.at - corner.at) < -eps;
            if !kept.iter().any(beyond) {
                continue;
            }
            next.clear();
            let all = kept.iter().all(beyond);
            for (i, v) in kept.iter().enumerate().filter(|_| !all) {
                if !beyond(v) {
                    next.push(*v);
                } else if !beyond(&kept[if i == 0 { kept.len() - 1 } else { i - 1 }]) {
                    let (made, line) =
                        (Made::Window { corner: j as u32, near: false }, Line::Window(j as u32));
                    next.push(Vertex { at: corner.at, made, line });
                }
            }
            std::mem::swap(kept, next);
        }
    }
}

/// The two places where the outline crosses side `j` of the window: one leaves the window, one comes
/// back. Each is given by the vertices before and after it, with their distances from the side.
struct Cut<'a> {
    window: &'a Outline,
    j: u32,
    eps: f64,
    leaves: [(&'a Vertex, f64); 2],
    enters: [(&'a Vertex, f64); 2],
}

impl Cut<'_> {
    fn crossing(&self, [(p, from), (q, to)]: [(&Vertex, f64); 2]) -> Vertex {
        crossing(self.window, p, q, from / (from - to), self.j)
    }

    /// The crossing where the outline leaves, and the crossing where it comes back. Each is none if the
    /// vertex inside is on the side's line and stands for the crossing.
    fn vertices(&self) -> (Option<Vertex>, Option<Vertex>) {
        let leaves = (self.leaves[0].1 > self.eps)
            .then(|| Vertex { line: Line::Window(self.j), ..self.crossing(self.leaves) });
        let enters = (self.enters[1].1 > self.eps).then(|| self.crossing(self.enters));
        (leaves, enters)
    }
}

/// The vertex where the outline, on its way from `p` to `q`, crosses side `j` of the window.
fn crossing(window: &Outline, p: &Vertex, q: &Vertex, share: f64, j: u32) -> Vertex {
    let at = p.at + share * (q.at - p.at);
    match p.line {
        Line::Own(i) => Vertex { at, made: Made::Crossing(i, j), line: p.line },
        // Two neighbouring sides of the window meet in the corner where the second begins.
        Line::Window(k) => {
            let (made, at) = if window.next(j as usize) == k as usize {
                (Made::Window { corner: k, near: false }, window.corners[k as usize].at)
            } else if window.next(k as usize) == j as usize {
                (Made::Window { corner: j, near: false }, window.corners[j as usize].at)
            } else {
                (Made::Meeting([k, j]), at)
            };
            Vertex { at, made, line: p.line }
        }
    }
}

/// The corner of the window that is nearest to the meeting point of two sides `k` and `j` that are not
/// neighbours. In a large window only the corners between these two sides are examined; the sides
/// between did not cut.
#[cold]
fn nearest_corner(window: &Outline, at: DVec2, [k, j]: [u32; 2]) -> u32 {
    let distance = |i: u32| window.corners[i as usize].at.distance_squared(at);
    let nearer = |i: &u32, j: &u32| distance(*i).total_cmp(&distance(*j)).then(i.cmp(j));
    let count = window.corners.len() as u32;
    let (low, high) = (k.min(j), k.max(j));
    let nearest = if count as usize * count as usize <= LARGE {
        (0..count).min_by(nearer)
    } else if high - low <= count / 2 {
        (low..=high).min_by(nearer)
    } else {
        (high..count).chain(0..=low).min_by(nearer)
    };
    nearest.unwrap_or(0)
}
