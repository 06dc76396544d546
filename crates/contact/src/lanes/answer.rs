//! From the numbers of a lane to the manifold of its pair, with the names of features, points and basis.

use glam::{DMat3, DVec3};

use super::Numbers;
use super::rectangles::{Made, Shared};
use super::simd::Row;
use crate::growth::boxes::{Octagon, triangle};
use crate::growth::{Cost, Solution};
use crate::hull::BoxRow;
use crate::pair::Pair;
use crate::{Basis, ContactPoint, ConvexHull, Element, Feature, Manifold, Outcome, Query, Steps, Wanted};

/// The work of a lane, for diagnostics: one direction, with the support values of both boxes.
const COST: Cost = Cost { iterations: 1, support_calls: 2 };

/// One lane of a group's results.
pub(super) struct Lane<'n> {
    pub(super) numbers: &'n Numbers,
    pub(super) lane: usize,
    pub(super) rows: [&'n BoxRow; 2],
}

/// A feature of a box by its code: the octant of its lowest corner, and the axes along which it extends,
/// as bits.
#[derive(Clone, Copy)]
struct Code {
    octant: usize,
    extent: usize,
}

impl Code {
    /// The digits of base 3 are 0 for a negative coordinate, 1 for an axis of the extent, 2 for a positive
    /// one.
    fn new(code: f64) -> Self {
        let code = code as usize;
        let digits = [code % 3, code / 3 % 3, code / 9 % 3];
        let bits = |digit: usize| (0..3).fold(0, |bits, i| bits | usize::from(digits[i] == digit) << i);
        Self { octant: bits(2), extent: bits(1) }
    }

    /// The number of the axis of a face's normal, or of an edge.
    fn axis(self) -> usize {
        let single = if self.extent.count_ones() == 2 { !self.extent & 7 } else { self.extent };
        single.trailing_zeros() as usize
    }

    fn named(self, row: &BoxRow) -> Feature {
        match self.extent.count_ones() {
            0 => Feature::Vertex(row.vertices[self.octant]),
            1 => Feature::Edge(edge(row, [self.octant, self.octant | self.extent])),
            _ => Feature::Face(row.faces[2 * self.axis() + usize::from(self.octant != 0)]),
        }
    }

    /// The part of this feature that names a single point.
    fn element(self, row: &BoxRow) -> Element {
        match self.named(row) {
            Feature::Vertex(v) => Element::Vertex(v),
            Feature::Edge(ends) => Element::Edge(ends),
            Feature::Face(_) => Element::Inside,
        }
    }

    /// The octants of a face's corners, in the order of `rectangles`. `first` is the sign of its axis u.
    fn corners(self, first: bool) -> [usize; 4] {
        let axis = self.axis();
        let (u, v) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
        // The axis v points along its coordinate if the face's normal does.
        let along_v = self.octant != 0;
        [(true, true), (false, true), (false, false), (true, false)].map(|(plus_u, plus_v)| {
            self.octant | if plus_u == first { u } else { 0 } | if plus_v == along_v { v } else { 0 }
        })
    }
}

fn edge(row: &BoxRow, octants: [usize; 2]) -> [u32; 2] {
    let [v, w] = octants.map(|octant| row.vertices[octant]);
    [v.min(w), v.max(w)]
}

impl Lane<'_> {
    fn has(&self, bits: u32) -> bool {
        bits >> self.lane & 1 == 1
    }

    fn vector(&self, rows: &[Row; 3]) -> DVec3 {
        DVec3::from_array(rows.each_ref().map(|row| row[self.lane]))
    }

    /// Whether the lane has a growth scale and a normal.
    pub(super) fn is_solved(&self) -> bool {
        self.has(self.numbers.solved)
    }

    /// Writes the answer as far as the lane has it, and returns whether that is all of it.
    pub(super) fn is_complete(&self, manifold: &mut Manifold, query: &Query) -> bool {
        manifold.reset();
        if self.has(self.numbers.separated) {
            self.write_separated(manifold);
            return true;
        }
        if !self.is_solved() {
            return false;
        }
        self.write_growth(manifold);
        if query.wanted == Wanted::Points && !self.write_points(manifold, query) {
            return false;
        }
        self.is_near(manifold, query)
    }

    /// Whether the hulls are certainly within the margin.
    fn is_near(&self, manifold: &Manifold, query: &Query) -> bool {
        let [a, b] = self.rows.map(BoxRow::off_box);
        manifold.alpha_upper <= 1.0
            || query.margin == f64::INFINITY
            || manifold.points.iter().any(|point| point.distance.abs() + (a + b) <= query.margin)
    }

    fn write_separated(&self, manifold: &mut Manifold) {
        let Numbers { lower, separation, normal, .. } = self.numbers;
        manifold.outcome = Outcome::Separated;
        manifold.alpha_lower = lower[self.lane];
        manifold.alpha = lower[self.lane];
        manifold.alpha_upper = f64::INFINITY;
        manifold.separation = separation[self.lane];
        manifold.normal = self.vector(normal);
        (manifold.iterations, manifold.support_calls) = (COST.iterations, COST.support_calls);
    }

    fn write_growth(&self, manifold: &mut Manifold) {
        let Numbers { alpha, lower, upper, separation, normal, .. } = self.numbers;
        let [a, b] = self.basis();
        manifold.outcome = Outcome::Contact;
        manifold.alpha = alpha[self.lane];
        manifold.alpha_lower = lower[self.lane];
        manifold.alpha_upper = upper[self.lane];
        manifold.separation = separation[self.lane];
        manifold.normal = self.vector(normal);
        manifold.basis = Some(Basis {
            a: a.map(|octant| self.rows[0].vertices[octant]),
            b: b.map(|octant| self.rows[1].vertices[octant]),
        });
        (manifold.iterations, manifold.support_calls) = (COST.iterations, COST.support_calls);
    }

    /// The octants of the basis in A and in B: three corners of the facet through which the ray leaves.
    fn basis(&self) -> [[usize; 3]; 2] {
        let Numbers { n, n_in_b, in_a, in_b, axis_a, axis_b, of_edges, of_b, between, .. } = self.numbers;
        let (n, n_in_b) = (self.vector(n), self.vector(n_in_b));
        let (i, j) = (axis_a[self.lane] as usize, axis_b[self.lane] as usize);
        if self.has(*between) {
            return self.octagon(i, j);
        }
        let (in_a, in_b) = (self.vector(in_a).to_array(), self.vector(in_b).to_array());
        let (a, b) = (octant(n), octant(-n_in_b));
        let put =
            |octant: usize, axis: usize, sign: f64| octant & !(1 << axis) | usize::from(sign > 0.0) << axis;
        let mut corners = [[a; 3], [b; 3]];
        if self.has(*of_edges) {
            for (k, (x, y)) in triangle(in_a[i], in_b[j]).into_iter().enumerate() {
                corners[0][k] = put(a, i, x);
                corners[1][k] = put(b, j, y);
            }
            return corners;
        }
        let (side, axis, own, point) = if self.has(*of_b) { (1, j, b, in_b) } else { (0, i, a, in_a) };
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for (k, (x, y)) in triangle(point[u], point[v]).into_iter().enumerate() {
            corners[side][k] = put(put(own, u, x), v, y);
        }
        corners
    }

    /// The basis of parallel faces, of which the axis of one body is known.
    #[cold]
    fn octagon(&self, i: usize, j: usize) -> [[usize; 3]; 2] {
        let Numbers { half_a, half_b, d, axes, alpha, of_b, .. } = self.numbers;
        let axes = DMat3::from_cols_array_2d(&axes.each_ref().map(|column| self.vector(column).to_array()));
        let largest = |v: DVec3| v.abs().max_position();
        let (i, j) = if self.has(*of_b) { (largest(axes.col(j)), j) } else { (i, largest(axes.row(i))) };
        let ray = self.vector(d);
        let octagon = Octagon { half_a: self.vector(half_a), half_b: self.vector(half_b), axes, ray };
        let corners = octagon.triangle(i, j, ray / alpha[self.lane]);
        [corners.map(|[a, _]| a), corners.map(|[_, b]| b)]
    }

    /// Writes features and points. Returns false if they are not certain, or more than asked for.
    fn write_points(&self, manifold: &mut Manifold, query: &Query) -> bool {
        let Numbers { feature_a, feature_b, features_sure, single, rectangles_sure, .. } = self.numbers;
        if !self.has(*features_sure) {
            return false;
        }
        let codes = [feature_a, feature_b].map(|row| Code::new(row[self.lane]));
        let [a, b] = self.rows;
        manifold.features = Some([codes[0].named(a), codes[1].named(b)]);
        if self.has(*single) {
            manifold.points.push(ContactPoint {
                witness_a: self.vector(&self.numbers.witness),
                distance: self.numbers.distance[self.lane],
                id: [codes[0].element(a), codes[1].element(b)],
            });
            return true;
        }
        let most = query.accuracy.max_points as usize;
        self.has(*rectangles_sure)
            && self.write_rectangles(manifold, codes)
            && (most == 0 || manifold.points.len() <= most)
    }

    /// Writes the points of two faces, beginning with the lowest id.
    fn write_rectangles(&self, manifold: &mut Manifold, [a, b]: [Code; 2]) -> bool {
        let (corners_a, corners_b) = (a.corners(true), b.corners(false));
        let [row_a, row_b] = self.rows;
        let side = |row: &BoxRow, corners: [usize; 4], k: usize| {
            Element::Edge(edge(row, [corners[k], corners[(k + 1) % 4]]))
        };
        let (mut first, mut least) = (0, [u128::MAX; 2]);
        let points = &mut manifold.points;
        let sure = self.numbers.rectangles.walk(self.lane, |Shared { witness, distance, made }| {
            let id = match made {
                Made::CornerOfA(k) => [Element::Vertex(row_a.vertices[corners_a[k]]), Element::Inside],
                Made::CornerOfB(k) => [Element::Inside, Element::Vertex(row_b.vertices[corners_b[k]])],
                Made::Crossing(i, j) => [side(row_a, corners_a, i), side(row_b, corners_b, j)],
            };
            let key = id.map(Element::key);
            if key < least {
                (first, least) = (points.len(), key);
            }
            points.push(ContactPoint { witness_a: DVec3::from_array(witness), distance, id });
        });
        points.rotate_left(first);
        sure
    }

    /// The growth scale and normal of the lane, for the steps of the general path.
    fn solution(&self, pair: &Pair<'_>) -> Solution {
        let Numbers { n, n_in_b, alpha, lower, upper, .. } = self.numbers;
        let normal = self.vector(n);
        let vertex =
            |hull: &ConvexHull, octant: usize| hull.box_shape().map_or(0, |shape| shape.corner(octant));
        let support = |a: usize, b: usize| pair.support_of(vertex(pair.a, a), vertex(pair.b, b));
        let [a, b] = self.basis();
        Solution {
            alpha: alpha[self.lane],
            lower: lower[self.lane],
            upper: upper[self.lane],
            normal,
            support: support(octant(normal), octant(-self.vector(n_in_b))),
            triple: [0, 1, 2].map(|k| support(a[k], b[k])),
            gap_open: false,
            coarse: false,
            coincident: false,
            cost: COST,
        }
    }
}

/// The octant of a direction by the signs of its coordinates, those of zeros included, as `copysign` takes
/// them.
fn octant(v: DVec3) -> usize {
    let bit = |i: usize| usize::from(v[i].is_sign_positive()) << i;
    bit(0) | bit(1) | bit(2)
}

impl Steps {
    /// Completes the answer of a lane that has growth scale and normal: features and points if the lane
    /// has none, and the outcome.
    pub(super) fn complete(&mut self, pair: &Pair<'_>, lane: &Lane<'_>, query: &Query) {
        let solution = lane.solution(pair);
        self.manifold.reset();
        self.conclude(pair, solution, query.margin / pair.unit, query);
        if self.manifold.outcome == Outcome::Separated {
            return;
        }
        // The numbers of step 1 stay those of the lane, whatever else was asked for.
        let Manifold { outcome, iterations, support_calls, .. } = self.manifold;
        lane.write_growth(&mut self.manifold);
        (self.manifold.outcome, self.manifold.iterations) = (outcome, iterations);
        self.manifold.support_calls = support_calls;
    }
}
