//! A feature clipped by a face: Sutherland and Hodgman, *Reentrant polygon
//! clipping* (1974), with the name of what makes each vertex carried along.
//!
//! A side of the window cuts where the subject passes from more than `eps`
//! inside to more than `eps` outside; a vertex within `eps` of the side's line is
//! on it, and stands for the crossing itself.

use glam::DVec2;

use super::outline::{Outline, Part};

/// A vertex of the intersection, by what makes it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Vertex {
    pub(super) at: DVec2,
    /// Of the subject.
    pub(super) own: Part,
    /// Of the window.
    pub(super) other: Part,
    /// What the outline follows from here.
    line: Line,
}

#[derive(Clone, Copy, Debug)]
enum Line {
    /// A side of the subject.
    Own(u16),
    /// A side of the window.
    Window(u16),
}

/// Buffers, and the vertices kept.
#[derive(Debug, Default)]
pub(super) struct Clip {
    pub(super) kept: Vec<Vertex>,
    next: Vec<Vertex>,
    /// Of each vertex from the side that cuts.
    distances: Vec<f64>,
}

impl Clip {
    /// Keeps the part of `subject` (a point, a segment or a polygon) inside
    /// `window`, a polygon; in order, with vertices nearer than `eps` still apart.
    pub(super) fn clip(&mut self, subject: &Outline, window: &Outline, eps: f64) {
        self.kept.clear();
        self.kept.extend(subject.corners.iter().zip(0..).map(|(c, i)| Vertex {
            at: c.at,
            own: Part::Corner(i),
            other: Part::Inside,
            line: Line::Own(i),
        }));
        for j in 0..window.sides.len() {
            self.cut(window, j as u16, eps);
        }
    }

    /// Cuts by side `j` of the window.
    fn cut(&mut self, window: &Outline, j: u16, eps: f64) {
        let Self { kept, next, distances } = self;
        let side = window.sides[j as usize];
        distances.clear();
        let mut least = 0.0;
        distances.extend(kept.iter().map(|v| {
            let distance = side.distance(v.at);
            // A side of no length (NaN) bounds nothing: it is never the smaller.
            least = if distance < least { distance } else { least };
            distance
        }));
        if least >= -eps {
            return;
        }
        next.clear();
        let closed = kept.len() > 2;
        for (i, &p) in kept.iter().enumerate() {
            let last = i + 1 == kept.len();
            let following = if last { 0 } else { i + 1 };
            let (from, to) = (distances[i], distances[following]);
            let goes_on = closed || !last;
            let leaves = to < -eps && goes_on;
            if from >= -eps {
                let on_line = leaves && from <= eps;
                next.push(if on_line { Vertex { line: Line::Window(j), ..p } } else { p });
            }
            if leaves && from > eps {
                next.push(crossing(window, &p, &kept[following], from / (from - to), j, Line::Window(j)));
            } else if from < -eps && to > eps && goes_on {
                next.push(crossing(window, &p, &kept[following], from / (from - to), j, p.line));
            }
        }
        std::mem::swap(kept, next);
    }
}

/// Where the outline, on its way from `p` to `q`, meets side `j` of the window.
fn crossing(window: &Outline, p: &Vertex, q: &Vertex, share: f64, j: u16, line: Line) -> Vertex {
    let at = p.at + share * (q.at - p.at);
    match p.line {
        Line::Own(i) => Vertex { at, own: Part::Side(i), other: Part::Side(j), line },
        // Two sides of the window meet in the corner where the second begins.
        Line::Window(k) => {
            let corner = if window.next(j as usize) == k as usize { k } else { j };
            let corner_at = window.corners[corner as usize].at;
            let adjacent = corner == k || window.next(k as usize) == j as usize;
            Vertex {
                at: if adjacent { corner_at } else { at },
                own: Part::Inside,
                other: Part::Corner(corner),
                line,
            }
        }
    }
}
