//! A feature clipped by a face: Sutherland and Hodgman, *Reentrant polygon clipping* (1974,
//! doi:10.1145/360767.360802), with what makes each vertex carried along.
//!
//! A side of the window cuts where the subject passes from more than `eps`
//! inside to more than `eps` outside; a vertex within `eps` of the side's line is
//! on it, and stands for the crossing itself. Within `eps` of both sides of a
//! sharp corner may be far beyond the corner: there it is cut off.
//!
//! Every side of the window looks at every vertex that is left, which is fastest for the few
//! sides of most faces but quadratic. Large polygons are cut by [`chain`], which gives the same
//! vertices in linear time.

use glam::DVec2;

use super::outline::{Outline, Side};
use chain::Chain;

mod chain;

/// Products of the numbers of sides above which polygons are cut as a [`Chain`].
const LARGE: usize = 1024;

/// Whether two polygons are so large that looking at every pair of sides would take too long.
pub(super) fn are_large(a: &Outline, b: &Outline) -> bool {
    let [a, b] = [a, b].map(|outline| outline.corners.len());
    a > 2 && b > 2 && a * b > LARGE
}

/// A vertex of the intersection.
#[derive(Clone, Copy, Debug)]
pub(super) struct Vertex {
    pub(super) at: DVec2,
    pub(super) made: Made,
    /// What the outline follows from here.
    line: Line,
}

/// What makes a vertex, by places in the two outlines.
#[derive(Clone, Copy, Debug)]
pub(super) enum Made {
    /// A corner of the subject inside the window.
    Own(u32),
    /// A corner of the window inside the subject; or only near, where two sides
    /// meet that are not neighbours: those between lie within `eps` of here.
    Window { corner: u32, near: bool },
    /// A side of the subject and one of the window.
    Crossing(u32, u32),
}

#[derive(Clone, Copy, Debug)]
enum Line {
    /// A side of the subject.
    Own(u32),
    /// A side of the window.
    Window(u32),
}

/// Vertices one after another around a polygon.
struct Run {
    first: usize,
    count: usize,
}

impl Run {
    /// Those whose distance is no less than `least`, where they are one run, but
    /// neither all nor none.
    fn of(distances: &[f64], least: f64) -> Option<Self> {
        let (mut first, mut count, mut starts) = (0, 0, 0);
        let mut before = *distances.last()? >= least;
        for (i, &distance) in distances.iter().enumerate() {
            // Without branches: which vertices they are is anyone's guess.
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

/// Buffers, and the vertices kept.
#[derive(Debug, Default)]
pub(super) struct Clip {
    pub(super) kept: Vec<Vertex>,
    next: Vec<Vertex>,
    /// Of each vertex from the side that cuts.
    distances: Vec<f64>,
    chain: Chain,
}

impl Clip {
    /// Vertices that were looked at since the last call, beside those of small polygons.
    pub(super) fn take_looked_at(&mut self) -> u64 {
        std::mem::take(&mut self.chain.looked_at)
    }

    /// Keeps the part of `subject` (a point, a segment or a polygon) inside
    /// `window`, a polygon; in order, with vertices nearer than `eps` still apart.
    pub(super) fn clip(&mut self, subject: &Outline, window: &Outline, eps: f64) {
        self.kept.clear();
        let corners = subject.corners.iter().zip(0..);
        self.kept.extend(corners.map(|(c, i)| Vertex { at: c.at, made: Made::Own(i), line: Line::Own(i) }));
        let mut on_line = false;
        if are_large(subject, window) {
            on_line = self.clip_chain(window, eps);
        } else {
            for j in 0..window.sides.len() {
                on_line |= self.cut(window, j as u32, eps);
            }
        }
        if on_line {
            self.cut_corners(window, eps);
        }
    }

    /// Cuts by side `j` of the window; whether a vertex is within `eps` of it.
    fn cut(&mut self, window: &Outline, j: u32, eps: f64) -> bool {
        let Self { kept, distances, .. } = self;
        let side = window.sides[j as usize];
        distances.clear();
        let (mut least, mut on_line) = (f64::INFINITY, false);
        distances.extend(kept.iter().map(|v| {
            let distance = side.distance(v.at);
            // A side of no length (NaN) bounds nothing: it is never the smaller.
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

    /// Of a polygon that leaves the window across side `j` once, and comes back once.
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

    /// Of a segment, or of a polygon that rounding makes leave more than once.
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

    /// Cuts what is more than `eps` beyond a sharp corner, across the corner.
    #[cold]
    fn cut_corners(&mut self, window: &Outline, eps: f64) {
        let Self { kept, next, .. } = self;
        let mut before = window.sides.len() - 1;
        for (j, corner) in window.corners.iter().enumerate() {
            let sides = [before, j].map(|side| window.sides[side].inward);
            before = j;
            // Of sides at right angles and wider ones `eps` is near the corner itself.
            if !((sides[0] + sides[1]).length_squared() < SHARP) {
                continue;
            }
            // Between the two sides' ways from the corner.
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

/// Where the outline leaves the window across side `j` and where it comes back, between the
/// vertices inside and outside, each with its distance from the side.
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

    /// The last vertex before the side of the window, a new one if the last inside is not on the
    /// side's line; and the first vertex of the way back, if it is new.
    fn vertices(&self) -> (Option<Vertex>, Option<Vertex>) {
        let leaves = (self.leaves[0].1 > self.eps)
            .then(|| Vertex { line: Line::Window(self.j), ..self.crossing(self.leaves) });
        let enters = (self.enters[1].1 > self.eps).then(|| self.crossing(self.enters));
        (leaves, enters)
    }
}

/// Square of the sum of the unit inward directions of a corner's sides: 2 at a
/// right angle.
const SHARP: f64 = 1.999;

/// Where the outline, on its way from `p` to `q`, meets side `j` of the window.
fn crossing(window: &Outline, p: &Vertex, q: &Vertex, share: f64, j: u32) -> Vertex {
    let at = p.at + share * (q.at - p.at);
    match p.line {
        Line::Own(i) => Vertex { at, made: Made::Crossing(i, j), line: p.line },
        // Two sides of the window meet in the corner where the second begins.
        Line::Window(k) => {
            let (made, at) = if window.next(j as usize) == k as usize {
                (Made::Window { corner: k, near: false }, window.corners[k as usize].at)
            } else if window.next(k as usize) == j as usize {
                (Made::Window { corner: j, near: false }, window.corners[j as usize].at)
            } else {
                (Made::Window { corner: nearest_corner(window, at, [k, j]), near: true }, at)
            };
            Vertex { at, made, line: p.line }
        }
    }
}

/// The corner of the window that is nearest to the point where two of its sides meet that are
/// not neighbours. Large windows look only at the corners between these sides.
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
