//! The edges of faces that are groups of several triangles: the boundaries between the groups,
//! straightened.
//!
//! The boundary between two groups is a chain of triangle sides. Its ends are *corners*, vertices
//! where three or more boundaries meet. Vertices along the chain can be off a straight line by
//! about the tolerance of the merge. So the chain is replaced by few straight edges, by the
//! algorithm of D. H. Douglas and T. K. Peucker (1973, doi:10.3138/FM57-6770-U75U-7727):
//!
//! ```text
//! straighten(chain): find the vertex farthest from the line through both ends;
//!                    if it is farther than the tolerance, cut there and straighten both halves;
//!                    otherwise the chain is one edge
//!
//!          v3                        v3
//!      v2      v4         ->        /  \
//!   v1            v5             v1      v5      (v2 and v4 were within the tolerance)
//! ```
//!
//! A vertex that is dropped stays a vertex of the hull and of the support mapping; it is just not a
//! corner of a face. Two cases need extra cuts, so that every face is bounded by a polygon. A
//! chain without a corner is a loop (one group surrounds another); it is cut into three. Two
//! edges between the same two corners would bound a face with two corners; all but the shortest
//! chain are cut.
//!
//! Tracing the chains is linear. Straightening a chain of `k` vertices takes `O(k log k)` time if
//! the cuts are even and `O(k^2)` at worst.

use glam::DVec3;

use super::edge::{Edge, sort_edges};
use super::merge::{Groups, Surface};
use crate::sort::{COMPARISON, sort};
use crate::stop::{Meter, Stopped};

/// Steps per side of a triangle, or per vertex of a chain.
const SIDE: u64 = 6;

/// A part of the boundary between two faces. After straightening it is one edge.
#[derive(Clone, Copy, Debug)]
struct Piece {
    /// The vertices of the part are `chains[start..=end]`.
    start: usize,
    end: usize,
    /// The faces on the left and on the right of the way from start to end, seen from outside.
    faces: [u32; 2],
}

/// The boundaries between groups, as chains of vertices.
pub(super) struct Boundary<'a> {
    surface: &'a Surface<'a>,
    groups: &'a Groups,
    /// For each vertex, the number of triangle sides at it that separate groups.
    crossings: Vec<u32>,
    /// For each side of each triangle (3 per triangle), whether a chain contains it.
    traced: Vec<bool>,
    chains: Vec<u32>,
    pieces: Vec<Piece>,
    meter: &'a Meter<'a>,
}

impl<'a> Boundary<'a> {
    pub(super) fn new(surface: &'a Surface<'a>, groups: &'a Groups, meter: &'a Meter<'a>) -> Self {
        let triangles = surface.normals.len();
        let mut boundary = Self {
            surface,
            groups,
            crossings: vec![0; surface.vertices.len()],
            traced: vec![false; 3 * triangles],
            chains: Vec::new(),
            pieces: Vec::new(),
            meter,
        };
        for (t, side) in boundary.sides() {
            if boundary.separates(t, side) {
                let start = boundary.start(t, side);
                boundary.crossings[start as usize] += 1;
            }
        }
        boundary
    }

    /// Every side of every triangle, as pairs of a triangle and a side.
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

    /// Whether three or more boundaries between groups meet in `v`, so that edges end there.
    fn is_corner(&self, v: u32) -> bool {
        self.crossings[v as usize] >= 3
    }

    /// Traces the chains from corner to corner, then the loops without a corner. Each is traced
    /// once, with the group of the lower index on its left.
    fn trace(&mut self) -> Result<(), Stopped> {
        for loops in [false, true] {
            self.meter.spend(SIDE * 3 * self.surface.normals.len() as u64)?;
            for (t, side) in self.sides() {
                let is_start = loops || self.is_corner(self.start(t, side));
                let is_lower = self.group(t) < self.group(self.across(t, side));
                if is_start && is_lower && !self.traced[3 * t as usize + side] {
                    self.trace_chain(t, side)?;
                }
            }
        }
        Ok(())
    }

    /// Follows the boundary from this side, with the group of `t` on the left.
    fn trace_chain(&mut self, mut t: u32, mut side: usize) -> Result<(), Stopped> {
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
            (t, side) = self.following(t, side)?;
        }
        let end = self.chains.len() - 1;
        let whole = Piece { start, end, faces };
        if self.chains[start] == self.chains[end] { self.open_loop(whole) } else { self.straighten(whole) }
    }

    /// The next side of the boundary of the group of `t`.
    fn following(&self, t: u32, side: usize) -> Result<(u32, usize), Stopped> {
        // Turn about the end of the side, from triangle to triangle of the group, until the next
        // side separates groups.
        let (mut t, mut side) = (t, (side + 1) % 3);
        while !self.separates(t, side) {
            self.meter.spend(SIDE)?;
            let pivot = self.start(t, side);
            t = self.across(t, side);
            side = self.surface.triangulation.slot(t, pivot);
        }
        Ok((t, side))
    }

    /// Cuts a loop that starts and ends in one vertex into at least three pieces, so that it
    /// bounds a polygon.
    fn open_loop(&mut self, whole: Piece) -> Result<(), Stopped> {
        self.meter.spend(SIDE * (whole.end - whole.start) as u64)?;
        let first = self.vertex(whole.start);
        let far = |i: &usize| (self.vertex(*i) - first).length_squared();
        let middle = (whole.start + 1..whole.end).max_by(|i, j| far(i).total_cmp(&far(j)));
        let middle = middle.unwrap_or(whole.start + 1);
        let halves = [Piece { end: middle, ..whole }, Piece { start: middle, ..whole }];
        let before = self.pieces.len();
        for half in halves {
            self.straighten(half)?;
        }
        if self.pieces.len() == before + 2 {
            let cut = self.split(before)? || self.split(before + 1)?;
            debug_assert!(cut, "a loop of triangles' sides has three vertices");
        }
        Ok(())
    }

    /// Keeps a chain as one edge if it is straight to within the merge tolerance. Otherwise cuts it
    /// at the vertex that is farthest off, and treats both parts in the same way.
    fn straighten(&mut self, whole: Piece) -> Result<(), Stopped> {
        if whole.end - whole.start < 2 {
            self.pieces.push(whole);
            return Ok(());
        }
        let mut open = vec![whole];
        while let Some(piece) = open.pop() {
            match self.farthest_off(piece)? {
                Some((cut, distance)) if distance > self.groups.tolerance => {
                    open.push(Piece { start: cut, ..piece });
                    open.push(Piece { end: cut, ..piece });
                }
                _ => self.pieces.push(piece),
            }
        }
        Ok(())
    }

    fn vertex(&self, place: usize) -> DVec3 {
        self.surface.vertices[self.chains[place] as usize]
    }

    /// The inner vertex of the chain that is farthest from the line through the ends, and its
    /// distance. `None` if the chain has no inner vertex.
    fn farthest_off(&self, piece: Piece) -> Result<Option<(usize, f64)>, Stopped> {
        self.meter.spend(SIDE * (piece.end - piece.start) as u64)?;
        if piece.end - piece.start < 2 {
            return Ok(None);
        }
        let (from, to) = (self.vertex(piece.start), self.vertex(piece.end));
        let along = (to - from).normalize_or_zero();
        let off = |i: usize| (i, (self.vertex(i) - from).cross(along).length());
        Ok((piece.start + 1..piece.end).map(off).max_by(|(_, a), (_, b)| a.total_cmp(b)))
    }

    /// Cuts piece `i` at its farthest vertex. Returns false if it has no inner vertex.
    fn split(&mut self, i: usize) -> Result<bool, Stopped> {
        let piece = self.pieces[i];
        let Some((cut, _)) = self.farthest_off(piece)? else { return Ok(false) };
        self.pieces[i].end = cut;
        self.pieces.push(Piece { start: cut, ..piece });
        Ok(true)
    }

    /// The end vertices of the piece, the lower index first.
    fn ends(&self, piece: Piece) -> [u32; 2] {
        let (from, to) = (self.chains[piece.start], self.chains[piece.end]);
        [from.min(to), from.max(to)]
    }

    /// Returns the edges in ascending order, and the largest distance of a vertex that was
    /// straightened away from the line of its edge.
    pub(super) fn edges(mut self) -> Result<(Vec<Edge>, f64), Stopped> {
        // These are the steps of `new`, which finds the corners.
        self.meter.spend(SIDE * 3 * self.surface.normals.len() as u64)?;
        self.trace()?;
        loop {
            let mut edges: Vec<Edge> = self.pieces.iter().map(|&piece| self.edge(piece)).collect();
            sort_edges(&mut edges, self.meter)?;
            let double = |two: &[Edge]| two[0].0 == two[1].0;
            if !edges.windows(2).any(double) || !self.split_doubles()? {
                let mut straightened = 0.0f64;
                for &piece in &self.pieces {
                    let farthest = self.farthest_off(piece)?;
                    straightened = straightened.max(farthest.map_or(0.0, |(_, distance)| distance));
                }
                return Ok((edges, straightened));
            }
        }
    }

    /// Cuts edges that share both ends with another edge. Two such edges would bound a face with
    /// two corners only. The one with the shortest chain is kept, and each of the others is cut
    /// once. Returns false if none of them has an inner vertex at which to cut.
    fn split_doubles(&mut self) -> Result<bool, Stopped> {
        let mut order: Vec<usize> = (0..self.pieces.len()).collect();
        let length = |i: usize| self.pieces[i].end - self.pieces[i].start;
        let key = |i: usize| (self.ends(self.pieces[i]), length(i), i);
        sort(&mut order, self.meter, COMPARISON, |&i, &j| key(i).cmp(&key(j)))?;
        let doubles: Vec<usize> = order
            .windows(2)
            .filter(|w| self.ends(self.pieces[w[0]]) == self.ends(self.pieces[w[1]]))
            .map(|w| w[1])
            .collect();
        let mut any = false;
        for i in doubles {
            any |= self.split(i)?;
        }
        Ok(any)
    }

    fn edge(&self, piece: Piece) -> Edge {
        let [left, right] = piece.faces;
        let forward = self.chains[piece.start] < self.chains[piece.end];
        (self.ends(piece), if forward { [left, right] } else { [right, left] })
    }
}
