//! A feature clipped by a face: Sutherland and Hodgman, *Reentrant polygon
//! clipping* (1974), with the name of what makes each vertex carried along.
//!
//! A side of the window cuts where the subject passes from more than `eps`
//! inside to more than `eps` outside; a vertex within `eps` of the side's line is
//! on it, and stands for the crossing itself. Within `eps` of both sides of a
//! sharp corner may be far beyond the corner: there it is cut off.

use glam::DVec2;

use super::outline::{Outline, height_on};
use crate::contact::manifold::Element;

/// A vertex of the intersection: where it is, how high it is over both features,
/// what makes it. All are known where it is made, and go along with it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Vertex {
    pub(super) at: DVec2,
    /// Of the subject.
    pub(super) own_height: f64,
    pub(super) own: Element,
    /// Of the window.
    pub(super) other_height: f64,
    pub(super) other: Element,
    /// What the outline follows from here.
    line: Line,
}

#[derive(Clone, Copy, Debug)]
enum Line {
    /// A side of the subject.
    Own(u32),
    /// A side of the window.
    Window(u32),
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
            own_height: c.height,
            own: Element::Vertex(c.vertex),
            other_height: window.height(c.at),
            other: Element::Inside,
            line: Line::Own(i),
        }));
        let mut on_line = false;
        for j in 0..window.sides.len() {
            on_line |= self.cut(subject, window, j as u32, eps);
        }
        if on_line {
            self.cut_corners(subject, window, eps);
        }
    }

    /// Cuts by side `j` of the window; whether a vertex outside by no more than
    /// `eps` stays.
    fn cut(&mut self, subject: &Outline, window: &Outline, j: u32, eps: f64) -> bool {
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
            return least < 0.0;
        }
        next.clear();
        let closed = kept.len() > 2;
        let mut stays = false;
        for (i, &p) in kept.iter().enumerate() {
            let last = i + 1 == kept.len();
            let following = if last { 0 } else { i + 1 };
            let (from, to) = (distances[i], distances[following]);
            let goes_on = closed || !last;
            let leaves = to < -eps && goes_on;
            if from >= -eps {
                stays |= from < 0.0;
                let on_line = leaves && from <= eps;
                next.push(if on_line { Vertex { line: Line::Window(j), ..p } } else { p });
            }
            if leaves && from > eps {
                let crossing = crossing(subject, window, &p, &kept[following], from / (from - to), j);
                next.push(Vertex { line: Line::Window(j), ..crossing });
            } else if from < -eps && to > eps && goes_on {
                next.push(crossing(subject, window, &p, &kept[following], from / (from - to), j));
            }
        }
        std::mem::swap(kept, next);
        stays
    }

    /// Cuts what is more than `eps` beyond a sharp corner, across the corner.
    fn cut_corners(&mut self, subject: &Outline, window: &Outline, eps: f64) {
        let Self { kept, next, .. } = self;
        let mut before = window.sides.len() - 1;
        for (j, corner) in window.corners.iter().enumerate() {
            let inward = window.sides[before].inward + window.sides[j].inward;
            before = j;
            // Of sides at right angles and wider ones `eps` is near the corner itself.
            if !(inward.length_squared() < SHARP) {
                continue;
            }
            let inward = inward.normalize_or_zero();
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
                    next.push(Vertex {
                        at: corner.at,
                        own_height: subject.height(corner.at),
                        own: Element::Inside,
                        other_height: corner.height,
                        other: Element::Vertex(corner.vertex),
                        line: Line::Window(j as u32),
                    });
                }
            }
            std::mem::swap(kept, next);
        }
    }
}

/// Square of the sum of the unit inward directions of a corner's sides: 2 at a
/// right angle.
const SHARP: f64 = 1.999;

/// Where the outline, on its way from `p` to `q`, meets side `j` of the window.
fn crossing(subject: &Outline, window: &Outline, p: &Vertex, q: &Vertex, share: f64, j: u32) -> Vertex {
    let at = p.at + share * (q.at - p.at);
    match p.line {
        Line::Own(i) => Vertex {
            at,
            own_height: p.own_height + share * (q.own_height - p.own_height),
            own: subject.side_name(i as usize),
            other_height: height_on(window.side(j as usize), at),
            other: window.side_name(j as usize),
            line: p.line,
        },
        // Two sides of the window meet in the corner where the second begins.
        Line::Window(k) => {
            let corner = if window.next(j as usize) == k as usize { k } else { j };
            let adjacent = corner == k || window.next(k as usize) == j as usize;
            let corner = &window.corners[corner as usize];
            let at = if adjacent { corner.at } else { at };
            Vertex {
                at,
                own_height: subject.height(at),
                own: Element::Inside,
                other_height: corner.height,
                other: Element::Vertex(corner.vertex),
                line: p.line,
            }
        }
    }
}
