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

/// The part of `subject` (a point, a segment or a polygon) inside `window`, a
/// polygon; in order, with vertices nearer than `eps` still apart.
pub(super) fn clip(
    subject: &Outline,
    window: &Outline,
    eps: f64,
    kept: &mut Vec<Vertex>,
    next: &mut Vec<Vertex>,
) {
    kept.clear();
    kept.extend(subject.corners.iter().zip(0..).map(|(c, i)| Vertex {
        at: c.at,
        own: Part::Corner(i),
        other: Part::Inside,
        line: Line::Own(i),
    }));
    for j in 0..window.sides.len() {
        if cut(window, j as u16, eps, kept, next) {
            std::mem::swap(kept, next);
        }
    }
}

/// Cuts by side `j` of the window into `out`; whether it took anything away.
fn cut(window: &Outline, j: u16, eps: f64, vertices: &[Vertex], out: &mut Vec<Vertex>) -> bool {
    let side = window.sides[j as usize];
    // A side of no length (NaN) bounds nothing.
    if !vertices.iter().any(|v| side.distance(v.at) < -eps) {
        return false;
    }
    out.clear();
    let closed = vertices.len() > 2;
    let mut distance = vertices.first().map_or(0.0, |v| side.distance(v.at));
    for (i, &p) in vertices.iter().enumerate() {
        let last = i + 1 == vertices.len();
        let q = vertices[if last { 0 } else { i + 1 }];
        let (from, to) = (distance, side.distance(q.at));
        distance = to;
        let leaves = to < -eps && (closed || !last);
        if from >= -eps {
            let on_line = leaves && from <= eps;
            out.push(if on_line { Vertex { line: Line::Window(j), ..p } } else { p });
        }
        if leaves && from > eps {
            out.push(crossing(window, &p, &q, from / (from - to), j, Line::Window(j)));
        } else if from < -eps && to > eps && (closed || !last) {
            out.push(crossing(window, &p, &q, from / (from - to), j, p.line));
        }
    }
    true
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
