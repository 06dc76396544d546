//! Writes answers as columns: receives manifolds and makes a response.

use crate::{
    contact::{Element, Feature, Manifold, Outcome, Stop, Stopped},
    proto::{self, FeatureKind, Flag},
    service::Outputs,
    store::Missing,
};

/// The index of a missing basis, feature or id.
const NONE: u32 = u32::MAX;

/// Bytes that are copied between two checks of the stop flag: about half a millisecond.
const BYTES_BETWEEN_LOOKS: usize = 2 << 20;

/// Declares all columns in one place, with the methods that treat them alike.
macro_rules! columns {
    ($($column:ident: $element:ty,)*) => {
        /// The columns of consecutive pairs, as in `QueryContactsResponse`. A column that was not
        /// requested stays empty.
        #[derive(Clone, Debug, Default, PartialEq)]
        pub struct Columns {
            $($column: Vec<$element>,)*
            points: usize,
            solver_iterations: u64,
        }

        impl Columns {
            /// Bytes copied per elementary step.
            pub const BYTES_PER_STEP: usize = 4;

            /// Joins the parts in order, with one allocation per column.
            ///
            /// # Errors
            /// The work was stopped.
            pub fn concatenated(parts: &[Self], stop: &Stop) -> Result<Self, Stopped> {
                let mut copied = 0;
                let points = parts.iter().map(|part| part.points).sum();
                let solver_iterations = parts.iter().map(|part| part.solver_iterations).sum();
                let mut whole = Self { points, solver_iterations, ..Self::default() };
                $(whole.$column.reserve_exact(parts.iter().map(|part| part.$column.len()).sum());
                for part in parts {
                    whole.$column.extend_from_slice(&part.$column);
                    copied += size_of_val(&part.$column[..]);
                    if copied > BYTES_BETWEEN_LOOKS {
                        stop.spend((std::mem::take(&mut copied) / Self::BYTES_PER_STEP) as u64)?;
                    }
                })*
                stop.spend((copied / Self::BYTES_PER_STEP) as u64)?;
                Ok(whole)
            }

            /// The bytes of all elements.
            pub fn filled_bytes(&self) -> usize {
                0 $(+ size_of_val(&self.$column[..]))*
            }

            /// Removes all pairs; the allocated memory stays.
            pub fn clear(&mut self) {
                $(self.$column.clear();)*
                self.points = 0;
                self.solver_iterations = 0;
            }

            /// The bytes of allocated memory.
            pub fn heap_bytes(&self) -> usize {
                0 $(+ self.$column.capacity() * size_of::<$element>())*
            }
        }
    };
}

columns! {
    pairs: u32,
    outcomes: u8,
    flags: u8,
    alphas: f64,
    alpha_lowers: f64,
    alpha_uppers: f64,
    separations: f64,
    normals: f64,
    point_counts: u32,
    witness_as: f64,
    distances: f64,
    witness_bs: f64,
    feature_kinds: u8,
    feature_indices: u32,
    point_ids: u32,
    bases: u32,
    iterations: u32,
    support_calls: u32,
    kept_areas: f64,
}

/// The reason why a pair is not answered. It affects only pairs of the body or hull at fault.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Invalid {
    unknown_hull: bool,
    hull_unavailable: bool,
    invalid_body: bool,
}

impl Invalid {
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

    fn flags(self) -> u8 {
        bit(self.unknown_hull, Flag::UnknownHull)
            | bit(self.hull_unavailable, Flag::HullUnavailable)
            | bit(self.invalid_body, Flag::InvalidBody)
    }
}

fn bit(set: bool, flag: Flag) -> u8 {
    if set { flag as u8 } else { 0 }
}

impl Columns {
    /// The number of pairs.
    pub fn len(&self) -> usize {
        self.outcomes.len()
    }

    /// Whether there are no pairs.
    pub fn is_empty(&self) -> bool {
        self.outcomes.is_empty()
    }

    /// Bytes on the wire, without the tags and lengths of the columns.
    pub fn wire_bytes(&self, outputs: Outputs) -> usize {
        self.len() * outputs.pair_bytes() + self.points * outputs.point_bytes()
    }

    /// The solver's iterations over all pairs, including those that are not sent.
    pub fn solver_iterations(&self) -> u64 {
        self.solver_iterations
    }

    /// One flag byte per pair, as on the wire.
    pub fn flags(&self) -> &[u8] {
        &self.flags
    }

    /// The number of pairs with each outcome: CONTACT, SEPARATED, UNDECIDED, INVALID.
    pub fn outcome_counts(&self) -> [usize; 4] {
        let mut counts = [0; 4];
        for &outcome in &self.outcomes {
            counts[outcome as usize - 1] += 1;
        }
        counts
    }

    /// Adds the bodies of the next pair, if the request did not name them.
    pub fn push_pair(&mut self, bodies: [u32; 2]) {
        self.pairs.extend_from_slice(&bodies);
    }

    /// Adds a pair's answer.
    pub fn push(&mut self, manifold: &Manifold, outputs: Outputs) {
        let flags = &manifold.flags;
        self.solver_iterations += u64::from(manifold.iterations);
        self.outcomes.push(match manifold.outcome {
            Outcome::Contact => proto::Outcome::Contact as u8,
            Outcome::Separated => proto::Outcome::Separated as u8,
            Outcome::Undecided => proto::Outcome::Undecided as u8,
        });
        self.flags.push(
            bit(flags.estimated, Flag::Estimated)
                | bit(flags.coincident, Flag::Coincident)
                | bit(flags.gap_open, Flag::GapOpen)
                | bit(flags.reduced, Flag::Reduced),
        );
        if outputs.alpha {
            self.alphas.push(manifold.alpha);
            self.alpha_lowers.push(manifold.alpha_lower);
            self.alpha_uppers.push(manifold.alpha_upper);
        }
        if outputs.normal {
            self.separations.push(manifold.separation);
            self.normals.extend_from_slice(&manifold.normal.to_array());
        }
        if outputs.any_points() {
            self.push_points(manifold, outputs);
        }
        if outputs.bases {
            match &manifold.basis {
                Some(basis) => {
                    self.bases.extend_from_slice(&basis.a);
                    self.bases.extend_from_slice(&basis.b);
                }
                None => self.bases.extend_from_slice(&[NONE; 6]),
            }
        }
        if outputs.diagnostics {
            self.iterations.push(manifold.iterations);
            self.support_calls.push(manifold.support_calls);
            self.kept_areas.push(manifold.kept_area);
        }
    }

    fn push_points(&mut self, manifold: &Manifold, outputs: Outputs) {
        self.points += manifold.points.len();
        self.point_counts.push(manifold.points.len() as u32);
        for point in &manifold.points {
            if outputs.points {
                self.witness_as.extend_from_slice(&point.witness_a.to_array());
                self.distances.push(point.distance);
            }
            if outputs.witness_b {
                let witness_b = point.witness_a + point.distance * manifold.normal;
                self.witness_bs.extend_from_slice(&witness_b.to_array());
            }
            if outputs.features {
                for element in point.id {
                    self.point_ids.extend_from_slice(&element_indices(element));
                }
            }
        }
        if outputs.features {
            let features = manifold.features.map(|features| features.map(Some)).unwrap_or_default();
            for feature in features {
                let (kind, indices) = feature_indices(feature);
                self.feature_kinds.push(kind as u8);
                self.feature_indices.extend_from_slice(&indices);
            }
        }
    }

    /// Adds a pair without an answer; its numbers are NaN.
    pub fn push_invalid(&mut self, invalid: Invalid, outputs: Outputs) {
        self.outcomes.push(proto::Outcome::Invalid as u8);
        self.flags.push(invalid.flags());
        if outputs.alpha {
            self.alphas.push(f64::NAN);
            self.alpha_lowers.push(f64::NAN);
            self.alpha_uppers.push(f64::NAN);
        }
        if outputs.normal {
            self.separations.push(f64::NAN);
            self.normals.extend_from_slice(&[f64::NAN; 3]);
        }
        if outputs.any_points() {
            self.point_counts.push(0);
        }
        if outputs.features {
            self.feature_kinds.extend_from_slice(&[FeatureKind::None as u8; 2]);
            self.feature_indices.extend_from_slice(&[NONE; 4]);
        }
        if outputs.bases {
            self.bases.extend_from_slice(&[NONE; 6]);
        }
        if outputs.diagnostics {
            self.iterations.push(0);
            self.support_calls.push(0);
            self.kept_areas.push(f64::NAN);
        }
    }

    /// The bases. They also stay in the columns if they are sent.
    pub fn kept_bases(&mut self, outputs: Outputs) -> Vec<u32> {
        if outputs.bases { self.bases.clone() } else { std::mem::take(&mut self.bases) }
    }
}

fn element_indices(element: Element) -> [u32; 2] {
    match element {
        Element::Vertex(vertex) => [vertex, vertex],
        Element::Edge(ends) => ends,
        Element::Inside => [NONE, NONE],
    }
}

fn feature_indices(feature: Option<Feature>) -> (FeatureKind, [u32; 2]) {
    match feature {
        None => (FeatureKind::None, [NONE, NONE]),
        Some(Feature::Vertex(vertex)) => (FeatureKind::Vertex, [vertex, NONE]),
        Some(Feature::Edge(ends)) => (FeatureKind::Edge, ends),
        Some(Feature::Face(face)) => (FeatureKind::Face, [face, NONE]),
    }
}

/// The response to a checked request.
pub fn response(
    request_id: u64,
    columns: Columns,
    missing_hulls: Vec<u32>,
    invalid_bodies: Vec<u32>,
) -> proto::QueryContactsResponse {
    proto::QueryContactsResponse {
        request_id,
        outcomes: columns.outcomes,
        flags: columns.flags,
        alphas: columns.alphas,
        alpha_lowers: columns.alpha_lowers,
        alpha_uppers: columns.alpha_uppers,
        separations: columns.separations,
        normals: columns.normals,
        point_counts: columns.point_counts,
        witness_as: columns.witness_as,
        distances: columns.distances,
        witness_bs: columns.witness_bs,
        feature_kinds: columns.feature_kinds,
        feature_indices: columns.feature_indices,
        point_ids: columns.point_ids,
        bases: columns.bases,
        pairs: columns.pairs,
        missing_hulls,
        invalid_bodies,
        iterations: columns.iterations,
        support_calls: columns.support_calls,
        kept_areas: columns.kept_areas,
    }
}
