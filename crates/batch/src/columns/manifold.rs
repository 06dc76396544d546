//! The values of columns, from the answer of a pair.

use hullcast_contact::{ContactPoint, Element, Feature, Manifold, Outcome};

use crate::{
    codes::{NO_INDEX, feature, flag, outcome},
    scene::Missing,
};

/// The reason why a pair is not answered. It affects only pairs of the body or hull at fault.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InvalidPair {
    unknown_hull: bool,
    hull_unavailable: bool,
    invalid_body: bool,
}

impl InvalidPair {
    /// Records that the pose of a body is not usable.
    pub fn body(&mut self) {
        self.invalid_body = true;
    }

    /// Records that the hull of a body is missing.
    pub fn hull(&mut self, missing: Missing) {
        match missing {
            Missing::Unknown => self.unknown_hull = true,
            Missing::Unavailable => self.hull_unavailable = true,
        }
    }

    pub(super) fn flags(self) -> u8 {
        bit(self.unknown_hull, flag::UNKNOWN_HULL)
            | bit(self.hull_unavailable, flag::HULL_UNAVAILABLE)
            | bit(self.invalid_body, flag::INVALID_BODY)
    }
}

pub(super) fn bit(set: bool, flag: u8) -> u8 {
    if set { flag } else { 0 }
}

pub(super) fn outcome_code(outcome: Outcome) -> u8 {
    match outcome {
        Outcome::Contact => outcome::CONTACT,
        Outcome::Separated => outcome::SEPARATED,
        Outcome::Undecided => outcome::UNDECIDED,
    }
}

pub(super) fn flag_bits(manifold: &Manifold) -> u8 {
    let flags = &manifold.flags;
    bit(flags.estimated, flag::ESTIMATED)
        | bit(flags.coincident, flag::COINCIDENT)
        | bit(flags.gap_open, flag::GAP_OPEN)
        | bit(flags.reduced, flag::REDUCED)
}

pub(super) fn witness_b(manifold: &Manifold, point: &ContactPoint) -> [f64; 3] {
    (point.witness_a + point.distance * manifold.normal).to_array()
}

pub(super) fn point_id(point: &ContactPoint) -> [u32; 4] {
    let [[a0, a1], [b0, b1]] = point.id.map(|element| match element {
        Element::Vertex(vertex) => [vertex, vertex],
        Element::Edge(ends) => ends,
        Element::Inside => [NO_INDEX, NO_INDEX],
    });
    [a0, a1, b0, b1]
}

/// The features of A and of B, each as its kind and its indices.
pub(super) fn features(manifold: &Manifold) -> [(u8, [u32; 2]); 2] {
    let features = manifold.features.map(|features| features.map(Some)).unwrap_or_default();
    features.map(|touched| match touched {
        None => (feature::NONE, [NO_INDEX, NO_INDEX]),
        Some(Feature::Vertex(vertex)) => (feature::VERTEX, [vertex, NO_INDEX]),
        Some(Feature::Edge(ends)) => (feature::EDGE, ends),
        Some(Feature::Face(face)) => (feature::FACE, [face, NO_INDEX]),
    })
}

pub(super) fn feature_indices(manifold: &Manifold) -> [u32; 4] {
    let [(_, [a0, a1]), (_, [b0, b1])] = features(manifold);
    [a0, a1, b0, b1]
}

pub(super) fn basis(manifold: &Manifold) -> [u32; 6] {
    let basis = manifold.basis.map(|basis| (basis.a, basis.b));
    basis.map_or([NO_INDEX; 6], |([a0, a1, a2], [b0, b1, b2])| [a0, a1, a2, b0, b1, b2])
}

pub(super) fn rows(jacobian: &[[f64; 9]; 3]) -> [f64; 27] {
    std::array::from_fn(|i| jacobian[i / 9][i % 9])
}
