//! Edges, corners and outlines of the faces.

use std::cmp::Ordering;

use glam::DVec3;

use super::csr::Csr;
use super::merge::{Groups, Surface};
use super::quickhull::Triangulation;
use crate::contact::exact::orient2d;

/// Between two faces: their common boundary, straightened.
#[derive(Clone, Copy, Debug)]
struct Piece {
    /// The boundary's vertices: `chain[start..=end]`.
    start: usize,
    end: usize,
    /// The face on the left of going from start to end, seen from outside, and
    /// the one on the right.
    faces: [u32; 2],
}

/// An edge's ends, lower vertex first, and the faces on the left and right of going
/// from the one to the other.
type Edge = ([u32; 2], [u32; 2]);

/// Faces' and edges' places in one another.
pub(super) struct Topology {
    pub(super) edge_vertices: Vec<[u32; 2]>,
    pub(super) edge_faces: Vec<[u32; 2]>,
    pub(super) outlines: Csr,
    pub(super) face_areas: Vec<f64>,
}

/// Reads edges and outlines off the groups' boundaries; none where a face has no
/// outline at double precision (needles of an aspect beyond 1e13).
pub(super) fn topology(surface: &Surface<'_>, groups: &Groups) -> Option<Topology> {
    let (edges, corners) = if groups.planes.len() == groups.of.len() {
        (triangles_edges(surface, groups), triangles_corners(surface, groups))
    } else {
        let edges = Boundary::new(surface, groups).edges();
        let corners = Csr::from_pairs(
            groups.planes.len(),
            surface.vertices.len(),
            edges.iter().flat_map(|&([u, v], [f, g])| [(f, u), (f, v), (g, u), (g, v)]),
        );
        (edges, corners)
    };
    let mut sweep = Sweep::default();
    let mut outlines = Csr::with_capacity(groups.planes.len(), corners.items.len());
    for (face, plane) in groups.planes.iter().enumerate() {
        outlines.push_row(sweep.outline(surface.vertices, corners.row(face), plane.normal));
    }
    if (0..groups.planes.len()).any(|face| outlines.row(face).len() < 3) {
        return None;
    }
    // The length of the vector area: of an outline thinner than its vertices'
    // rounding the vector itself may point anywhere.
    let area = |face: usize| {
        let corner = |i: usize| surface.vertices[outlines.row(face)[i] as usize];
        let first = corner(0);
        let fan = |i| (corner(i) - first).cross(corner(i + 1) - first);
        0.5 * (1..outlines.row(face).len() - 1).map(fan).sum::<DVec3>().length()
    };
    let face_areas = (0..groups.planes.len()).map(area).collect();
    let (edge_vertices, edge_faces) = edges.into_iter().unzip();
    Some(Topology { edge_vertices, edge_faces, outlines, face_areas })
}

/// Where every face is one triangle, as on rounded bodies: their sides.
fn triangles_edges(surface: &Surface<'_>, groups: &Groups) -> Vec<Edge> {
    let Triangulation { triangles, neighbours } = surface.triangulation;
    let ends = |side: u32| {
        let (triangle, i) = (triangles[side as usize / 3], side as usize % 3);
        [triangle[i], triangle[(i + 1) % 3]]
    };
    // In their order by counting, as to no two the lower one is anyone's guess.
    let sides = (0..3 * triangles.len() as u32).map(|side| (ends(side), side));
    let lower = sides.filter(|([from, to], _)| from < to);
    let by_end = Csr::from_ordered_pairs(surface.vertices.len(), lower.map(|([_, to], side)| (to, side)));
    let starts = by_end.items.iter().map(|&side| (ends(side)[0], side));
    let by_start = Csr::from_ordered_pairs(surface.vertices.len(), starts);
    let edge = |&side: &u32| {
        let (left, i) = (side as usize / 3, side as usize % 3);
        (ends(side), [left as u32, neighbours[left][i]].map(|t| groups.of[t as usize]))
    };
    by_start.items.iter().map(edge).collect()
}

/// And their corners, in no order.
fn triangles_corners(surface: &Surface<'_>, groups: &Groups) -> Csr {
    let corners = surface.triangulation.triangles.iter().zip(&groups.of);
    Csr::from_ordered_pairs(
        groups.planes.len(),
        corners.flat_map(|(corners, &face)| corners.map(|v| (face, v))),
    )
}

/// By vertices, then by faces.
fn sort(edges: &mut [Edge]) {
    edges.sort_unstable_by_key(|([u, v], [left, right])| {
        [u, v, left, right].into_iter().fold(0_u128, |key, &part| key << 32 | u128::from(part))
    });
}

/// A corner in the plane of its face, and its vertex.
type Corner = ([f64; 2], u32);

/// Makes outlines; keeps its buffers from one to the next.
#[derive(Default)]
struct Sweep {
    sorted: Vec<Corner>,
    polygon: Vec<Corner>,
    outline: Vec<u32>,
}

impl Sweep {
    /// The convex polygon of `corners` seen against `normal`, anticlockwise and
    /// strictly convex: A. M. Andrew's monotone chain (1979) on exact turns. Less than
    /// three of a face thinner than the rounding of its vertices.
    fn outline(&mut self, vertices: &[DVec3], corners: &[u32], normal: DVec3) -> &[u32] {
        // Dropping the normal's largest coordinate keeps the others exact.
        let size = normal.abs();
        let flat = |v: u32| {
            let p = vertices[v as usize];
            let (point, height) = if size.x >= size.y && size.x >= size.z {
                ([p.y, p.z], normal.x)
            } else if size.y >= size.z {
                ([p.z, p.x], normal.y)
            } else {
                ([p.x, p.y], normal.z)
            };
            if height > 0.0 { point } else { [point[1], point[0]] }
        };
        let Self { sorted, polygon, outline } = self;
        outline.clear();
        if let &[u, v, w] = corners {
            // Both chains at once.
            let [a, b, c] = [u, v, w].map(|v| (flat(v), v));
            let first = |p: &Corner, q: &Corner| along(p, q).is_lt();
            let [a, b, c] = match (first(&a, &b), first(&b, &c), first(&c, &a)) {
                (true, _, false) => [a, b, c],
                (false, true, _) => [b, c, a],
                _ => [c, a, b],
            };
            match orient2d(a.0, b.0, c.0) {
                turn if turn > 0.0 => outline.extend([a.1, b.1, c.1]),
                turn if turn < 0.0 => outline.extend([a.1, c.1, b.1]),
                _ => {}
            }
            return outline;
        }
        sorted.clear();
        sorted.extend(corners.iter().map(|&v| (flat(v), v)));
        sorted.sort_unstable_by(along);
        sorted.dedup_by_key(|(p, _)| *p);
        polygon.clear();
        add_chain(polygon, sorted.iter());
        add_chain(polygon, sorted.iter().rev());
        outline.extend(polygon.iter().map(|(_, v)| *v));
        outline
    }
}

/// The order along a chain.
fn along((p, v): &Corner, (q, w): &Corner) -> Ordering {
    p[0].total_cmp(&q[0]).then(p[1].total_cmp(&q[1])).then(v.cmp(w))
}

/// Adds the convex chain of `points`, without its last.
fn add_chain<'a>(polygon: &mut Vec<Corner>, points: impl Iterator<Item = &'a Corner>) {
    let start = polygon.len();
    for &(p, v) in points {
        while let [.., (a, _), (b, _)] = polygon[start..] {
            if orient2d(a, b, p) > 0.0 {
                break;
            }
            polygon.pop();
        }
        polygon.push((p, v));
    }
    polygon.pop();
}

/// The boundaries between groups, as chains of vertices.
struct Boundary<'a> {
    surface: &'a Surface<'a>,
    groups: &'a Groups,
    /// Per vertex: how many sides of triangles at it separate groups.
    crossings: Vec<u32>,
    /// Per side of a triangle (3 each): whether a chain has it.
    traced: Vec<bool>,
    chains: Vec<u32>,
    pieces: Vec<Piece>,
}

impl<'a> Boundary<'a> {
    fn new(surface: &'a Surface<'a>, groups: &'a Groups) -> Self {
        let triangles = surface.normals.len();
        let mut boundary = Self {
            surface,
            groups,
            crossings: vec![0; surface.vertices.len()],
            traced: vec![false; 3 * triangles],
            chains: Vec::new(),
            pieces: Vec::new(),
        };
        for (t, side) in boundary.sides() {
            if boundary.separates(t, side) {
                let start = boundary.start(t, side);
                boundary.crossings[start as usize] += 1;
            }
        }
        boundary
    }

    /// Every side of every triangle.
    fn sides(&self) -> impl Iterator<Item = (u32, usize)> + use<> {
        (0..self.surface.normals.len() as u32).flat_map(|t| (0..3).map(move |side| (t, side)))
    }

    fn start(&self, t: u32, side: usize) -> u32 {
        self.surface.triangulation.triangles[t as usize][side]
    }

    fn across(&self, t: u32, side: usize) -> u32 {
        self.surface.triangulation.neighbours[t as usize][side]
    }

    fn group(&self, t: u32) -> u32 {
        self.groups.of[t as usize]
    }

    fn separates(&self, t: u32, side: usize) -> bool {
        self.group(t) != self.group(self.across(t, side))
    }

    /// Whether three or more faces' corners meet in `v`, so that edges end there.
    fn is_corner(&self, v: u32) -> bool {
        self.crossings[v as usize] >= 3
    }

    /// Chains from corner to corner, then loops without a corner, each once:
    /// with the lower group on the left.
    fn trace(&mut self) {
        for loops in [false, true] {
            for (t, side) in self.sides() {
                let is_start = loops || self.is_corner(self.start(t, side));
                let is_lower = self.group(t) < self.group(self.across(t, side));
                if is_start && is_lower && !self.traced[3 * t as usize + side] {
                    self.trace_chain(t, side);
                }
            }
        }
    }

    /// Follows the boundary with the group of `t` on the left.
    fn trace_chain(&mut self, mut t: u32, mut side: usize) {
        let faces = [self.group(t), self.group(self.across(t, side))];
        let start = self.chains.len();
        let first = self.start(t, side);
        self.chains.push(first);
        loop {
            self.traced[3 * t as usize + side] = true;
            let end = self.start(t, (side + 1) % 3);
            self.chains.push(end);
            if self.is_corner(end) || end == first {
                break;
            }
            (t, side) = self.following(t, side);
        }
        let end = self.chains.len() - 1;
        let whole = Piece { start, end, faces };
        if self.chains[start] == self.chains[end] { self.open_loop(whole) } else { self.straighten(whole) }
    }

    /// The next side of the boundary of `t`'s group.
    fn following(&self, t: u32, side: usize) -> (u32, usize) {
        // About the side's end, within the group, to where the group ends.
        let (mut t, mut side) = (t, (side + 1) % 3);
        while !self.separates(t, side) {
            let pivot = self.start(t, side);
            t = self.across(t, side);
            side = self.surface.triangulation.slot(t, pivot);
        }
        (t, side)
    }

    /// Cuts a loop without corners into three, so that it bounds a polygon.
    fn open_loop(&mut self, whole: Piece) {
        let first = self.vertex(whole.start);
        let far = |i: &usize| (self.vertex(*i) - first).length_squared();
        let middle = (whole.start + 1..whole.end).max_by(|i, j| far(i).total_cmp(&far(j)));
        let middle = middle.unwrap_or(whole.start + 1);
        let halves = [Piece { end: middle, ..whole }, Piece { start: middle, ..whole }];
        let before = self.pieces.len();
        halves.into_iter().for_each(|half| self.straighten(half));
        if self.pieces.len() == before + 2 {
            let cut = (before..before + 2).find(|&i| self.split(i));
            debug_assert!(cut.is_some(), "a loop of triangles' sides has three vertices");
        }
    }

    /// Keeps a chain as one edge where it is straight to the merge tolerance,
    /// else cuts it at the vertex farthest off.
    fn straighten(&mut self, whole: Piece) {
        if whole.end - whole.start < 2 {
            return self.pieces.push(whole);
        }
        let mut open = vec![whole];
        while let Some(piece) = open.pop() {
            match self.farthest_off(piece) {
                Some((cut, distance)) if distance > self.groups.tolerance => {
                    open.push(Piece { start: cut, ..piece });
                    open.push(Piece { end: cut, ..piece });
                }
                _ => self.pieces.push(piece),
            }
        }
    }

    fn vertex(&self, place: usize) -> DVec3 {
        self.surface.vertices[self.chains[place] as usize]
    }

    /// The vertex inside the chain that is farthest from the line through its ends.
    fn farthest_off(&self, piece: Piece) -> Option<(usize, f64)> {
        if piece.end - piece.start < 2 {
            return None;
        }
        let (from, to) = (self.vertex(piece.start), self.vertex(piece.end));
        let along = (to - from).normalize_or_zero();
        let off = |i: usize| (i, (self.vertex(i) - from).cross(along).length());
        (piece.start + 1..piece.end).map(off).max_by(|(_, a), (_, b)| a.total_cmp(b))
    }

    /// Cuts piece `i` at its farthest vertex; false where it has none inside.
    fn split(&mut self, i: usize) -> bool {
        let piece = self.pieces[i];
        let Some((cut, _)) = self.farthest_off(piece) else { return false };
        self.pieces[i].end = cut;
        self.pieces.push(Piece { start: cut, ..piece });
        true
    }

    /// The piece's ends, lower vertex first.
    fn ends(&self, piece: Piece) -> [u32; 2] {
        let (from, to) = (self.chains[piece.start], self.chains[piece.end]);
        [from.min(to), from.max(to)]
    }

    /// Per edge its ends, lower first, and the faces on its left and right; ascending.
    fn edges(mut self) -> Vec<Edge> {
        self.trace();
        loop {
            let mut edges: Vec<Edge> = self.pieces.iter().map(|&piece| self.edge(piece)).collect();
            sort(&mut edges);
            let double = |two: &[Edge]| two[0].0 == two[1].0;
            if !edges.windows(2).any(double) || !self.split_doubles() {
                return edges;
            }
        }
    }

    /// Two edges between the same corners bound a face that is a mere lens: all
    /// but the direct one are cut, so that it is a polygon. False where none has
    /// a vertex left inside to be cut at.
    fn split_doubles(&mut self) -> bool {
        let mut order: Vec<usize> = (0..self.pieces.len()).collect();
        let length = |i: usize| self.pieces[i].end - self.pieces[i].start;
        order.sort_unstable_by_key(|&i| (self.ends(self.pieces[i]), length(i), i));
        let doubles: Vec<usize> = order
            .windows(2)
            .filter(|w| self.ends(self.pieces[w[0]]) == self.ends(self.pieces[w[1]]))
            .map(|w| w[1])
            .collect();
        doubles.into_iter().filter(|&i| self.split(i)).count() > 0
    }

    fn edge(&self, piece: Piece) -> Edge {
        let [left, right] = piece.faces;
        let forward = self.chains[piece.start] < self.chains[piece.end];
        (self.ends(piece), if forward { [left, right] } else { [right, left] })
    }
}
