//! The Gauss map step by brute force: the features that the definition allows for a direction, from
//! all faces, edges and vertices of a hull and without a search.
//!
//! The direction carries some roundings when it is expressed in the hull's frame. A vertex near the
//! limit may therefore count as in the support set or not, and a face near the limit as within the
//! angle or not. So there are two sets: a certain candidate excludes features of lower rank, and a
//! possible candidate is allowed as an answer.

use std::collections::BTreeSet;

use glam::DVec3;
use hullcast_contact::{ConvexHull, Feature};

use super::judge::U;

/// A hull and a direction: the question whose answer is checked.
pub(crate) struct FeatureQuestion<'a> {
    pub(crate) hull: &'a ConvexHull,
    /// The outward unit direction in the hull's frame.
    pub(crate) n: DVec3,
    /// The depth of the support set: `64 u R` of the pair, in hull units.
    pub(crate) depth: f64,
    pub(crate) feature_angle: f64,
    /// The hull's vertices in the basis, by their registered indices.
    pub(crate) basis: Vec<u32>,
}

/// The rounding allowed in unit quantities, and in heights in hull units with the pair's `R`.
const SLACK: f64 = 32.0 * U;

/// The certain candidates, and the possible ones, which include the certain ones.
#[derive(Default)]
struct Candidates {
    certain: BTreeSet<usize>,
    possible: BTreeSet<usize>,
}

impl Candidates {
    /// An item is a candidate if its `measure` is at most 0; `slack` is the uncertainty of the
    /// measure.
    fn of(count: usize, slack: f64, measure: impl Fn(usize) -> f64) -> Self {
        let below = |limit: f64| (0..count).filter(|&i| measure(i) <= limit).collect();
        Self { certain: below(-slack), possible: below(slack) }
    }
}

/// The reason why the definition does not allow `feature`, or `None` if it does.
pub(crate) fn objection(question: &FeatureQuestion<'_>, feature: Feature) -> Option<String> {
    let support = question.support();
    let [faces, edges] = [question.faces(&support), question.edges(&support)];
    match feature {
        Feature::Face(face) => question.face_objection(face as usize, &faces),
        _ if !faces.certain.is_empty() => Some(format!("faces {:?} touch", faces.certain)),
        Feature::Edge(ends) => question.edge_objection(ends, &edges),
        _ if !edges.certain.is_empty() => Some(format!("edges {:?} touch", edges.certain)),
        Feature::Vertex(v) => {
            let v = question.own(v);
            let lower = support.certain.range(..v).next();
            let holds = support.possible.contains(&v) && lower.is_none();
            (!holds).then(|| format!("vertex {v} of {:?}", support.possible))
        }
    }
}

impl FeatureQuestion<'_> {
    fn own(&self, registered: u32) -> usize {
        self.hull.vertex_of_registered(registered).map_or(usize::MAX, |v| v as usize)
    }

    /// The vertices within the depth of the highest one, together with those of the basis.
    fn support(&self) -> Candidates {
        let height = |v: usize| self.n.dot(self.hull.vertices()[v]);
        let count = self.hull.vertex_count();
        let highest = (0..count).map(height).fold(f64::NEG_INFINITY, f64::max);
        // A quarter of the depth covers the rounding of the direction and of the heights.
        let mut support = Candidates::of(count, 0.25 * self.depth, |v| (highest - height(v)) - self.depth);
        for &v in &self.basis {
            support.certain.insert(self.own(v));
            support.possible.insert(self.own(v));
        }
        support
    }

    /// The faces within the angle that are reached from the support set through such faces, and the
    /// faces whose corners are all in the support set.
    fn faces(&self, support: &Candidates) -> Candidates {
        let faces = self.hull.faces();
        let sine = self.feature_angle.sin();
        let within = Candidates::of(faces.len(), SLACK, |f| {
            if faces[f].normal.dot(self.n) > SLACK {
                self.n.cross(faces[f].normal).length() - sine
            } else {
                f64::INFINITY
            }
        });
        let outward = Candidates::of(faces.len(), SLACK, |f| -faces[f].normal.dot(self.n));
        let reached = |within: &BTreeSet<usize>, support: &BTreeSet<usize>, outward: &BTreeSet<usize>| {
            let at_support =
                |f: &usize| support.iter().any(|&v| self.hull.vertex_faces(v).contains(&(*f as u32)));
            let mut found: BTreeSet<usize> = within.iter().copied().filter(at_support).collect();
            loop {
                let across = |&[f, g]: &[u32; 2]| {
                    let [f, g] = [f as usize, g as usize];
                    [(f, g), (g, f)]
                        .into_iter()
                        .find(|(from, to)| found.contains(from) && !found.contains(to))
                };
                let next = self.hull.edge_faces().iter().filter_map(across).map(|(_, to)| to);
                let next: Vec<usize> = next.filter(|to| within.contains(to)).collect();
                if next.is_empty() {
                    break;
                }
                found.extend(next);
            }
            let flat = |f: &usize| self.hull.outline(*f).iter().all(|&v| support.contains(&(v as usize)));
            found.extend(outward.iter().copied().filter(flat));
            found
        };
        Candidates {
            certain: reached(&within.certain, &support.certain, &outward.certain),
            possible: reached(&within.possible, &support.possible, &outward.possible),
        }
    }

    fn face_objection(&self, face: usize, faces: &Candidates) -> Option<String> {
        let cosine = |f: usize| self.hull.faces()[f].normal.dot(self.n);
        let area = |f: usize| self.hull.faces()[f].area;
        if !faces.possible.contains(&face) {
            return Some(format!("face {face} is no candidate"));
        }
        let nearest = faces.possible.iter().map(|&f| cosine(f)).fold(f64::NEG_INFINITY, f64::max);
        // A face beats another if it is certainly nearer, or certainly tied and preferred.
        let beats = |&&g: &&usize| {
            cosine(g) > cosine(face) + 8.0 * U + SLACK
                || (cosine(g) >= nearest - 4.0 * U
                    && (area(g) > area(face) || (area(g) == area(face) && g < face)))
        };
        faces.certain.iter().find(beats).map(|g| format!("face {g} before {face}"))
    }

    /// The edges with one end in the support set that are perpendicular to the direction to within
    /// the angle and whose arc contains the direction's projection; and the edges with both ends in
    /// the set.
    fn edges(&self, support: &Candidates) -> Candidates {
        let (hull, n) = (self.hull, self.n);
        let of = |support: &BTreeSet<usize>, slack: f64| -> BTreeSet<usize> {
            let holds = |&e: &usize| {
                let [v, w] = hull.edge_vertices()[e].map(|v| v as usize);
                let both = support.contains(&v) && support.contains(&w);
                let across = self.across(e) <= self.feature_angle.sin() + slack;
                let one = support.contains(&v) || support.contains(&w);
                both || (one && across && arc_holds(hull, e, n, slack))
            };
            (0..hull.edge_count()).filter(holds).collect()
        };
        let mut certain = of(&support.certain, -SLACK);
        // An edge has no direction if its vertices coincide once taken relative to the contraction
        // point.
        certain.retain(|&e| !self.across(e).is_nan());
        Candidates { certain, possible: of(&support.possible, SLACK) }
    }

    /// `|n . e|`, where `e` is the edge's unit direction.
    fn across(&self, e: usize) -> f64 {
        let [v, w] = self.hull.edge_vertices()[e].map(|v| self.hull.vertices()[v as usize]);
        self.n.dot((w - v).normalize()).abs()
    }

    fn edge_objection(&self, ends: [u32; 2], edges: &Candidates) -> Option<String> {
        let ends = ends.map(|v| self.own(v) as u32);
        let Some(edge) = self.hull.edge_vertices().iter().position(|&e| e == ends) else {
            return Some(format!("no edge {ends:?}"));
        };
        if !edges.possible.contains(&edge) {
            return Some(format!("edge {edge} is no candidate"));
        }
        let least = edges.possible.iter().map(|&e| self.across(e)).fold(f64::INFINITY, f64::min);
        let beats = |&&e: &&usize| {
            self.across(e) < self.across(edge) - 8.0 * U - SLACK
                || (self.across(e) <= least + 4.0 * U && e < edge)
        };
        edges.certain.iter().find(beats).map(|e| format!("edge {e} before {edge}"))
    }
}

/// Whether the projection of `n` onto the plane of the arc between the edge's faces lies on the
/// arc, inside its ends by more than `-slack`.
fn arc_holds(hull: &ConvexHull, edge: usize, n: DVec3, slack: f64) -> bool {
    let [v, w] = hull.edge_vertices()[edge].map(|v| hull.vertices()[v as usize]);
    let along = (w - v).normalize();
    let [m0, m1] = hull.edge_faces()[edge].map(|f| hull.faces()[f as usize].normal);
    // Sines of signed angles from one end; the arc is shorter than half a turn.
    let side = m0.cross(m1).dot(along).signum();
    let from = |m: DVec3, to: DVec3| side * m.cross(to).dot(along);
    // The normals of merged faces may deviate from the edge by their planarity, so the test allows
    // for that.
    let slack = slack + slack.signum() * 64.0 * U;
    from(m0, n) >= -slack && from(n, m1) >= -slack
}
