//! The columns of an answer: their sizes, and the outputs that bring them.

use hullcast_proto::{Output, QueryContactsRequest, QueryContactsResponse};

/// The number of values of a pair's basis.
pub(crate) const BASIS: usize = widths::bases;

/// A column of [`QueryContactsResponse`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Column {
    /// The name of the field.
    pub(crate) name: &'static str,
    /// The owner of the values: a pair or a point.
    pub(crate) per: Per,
    /// The number of values per pair or point.
    pub(crate) width: usize,
    /// The outputs that bring the column; each of them suffices. Empty if the column needs no output.
    outputs: &'static [Output],
    /// Whether servers of the first version of the contract do not send the column.
    pub(crate) is_later: bool,
}

/// The owner of a column's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Per {
    /// Each pair of an answer to a search for pairs.
    FoundPair,
    /// Each pair.
    Pair,
    /// Each contact point.
    Point,
}

/// The outputs that a request asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Outputs(u32);

impl Outputs {
    /// The outputs of a request; if it names none, the usual ones.
    pub(crate) fn of(request: &QueryContactsRequest) -> Self {
        let usual = [Output::Alpha, Output::Normal, Output::Points];
        if request.outputs.is_empty() {
            return Self(usual.iter().fold(0, |bits, &output| bits | 1 << output as u32));
        }
        let known = request.outputs.iter().filter(|&&output| Output::try_from(output).is_ok());
        Self(known.fold(0, |bits, output| bits | 1 << output))
    }

    /// Whether this output is asked for.
    pub(crate) fn has(self, output: Output) -> bool {
        self.0 & 1 << output as u32 != 0
    }
}

impl Column {
    /// Whether an answer has the column.
    pub(crate) fn is_sent(&self, outputs: Outputs, is_search: bool) -> bool {
        match self.per {
            Per::FoundPair => is_search,
            _ => self.outputs.is_empty() || self.outputs.iter().any(|&output| outputs.has(output)),
        }
    }
}

macro_rules! columns {
    ($($name:ident: $per:ident $width:literal [$($output:ident)*] $is_later:literal;)*) => {
        /// The number of values per owner, by the names of the columns.
        #[allow(non_upper_case_globals, dead_code, reason = "one for each column, although few are needed")]
        mod widths {
            $(pub(super) const $name: usize = $width;)*
        }

        /// Each column of the table, with its number of values in an answer.
        pub(crate) fn lengths(answer: &QueryContactsResponse) -> impl Iterator<Item = (Column, usize)> {
            [$((
                Column {
                    name: stringify!($name),
                    per: Per::$per,
                    width: $width,
                    outputs: &[$(Output::$output),*],
                    is_later: $is_later,
                },
                answer.$name.len(),
            )),*]
            .into_iter()
        }

        /// Appends `part`, the answer for the next pairs of the same request, to `whole`.
        ///
        /// The columns of pairs and points are joined. The lists of missing hulls and invalid bodies describe
        /// the whole request, so the lists of `part` replace those of `whole`.
        pub fn append(whole: &mut QueryContactsResponse, part: QueryContactsResponse) {
            $(whole.$name.extend(part.$name);)*
            whole.missing_hulls = part.missing_hulls;
            whole.invalid_bodies = part.invalid_bodies;
        }
    };
}

// Each row has the name of the field, the owner of its values, the number of values per owner, the outputs
// that bring the column, and whether it is later than the first version of the contract.
columns! {
    pairs: FoundPair 2 [] false;
    outcomes: Pair 1 [] false;
    flags: Pair 1 [] false;
    alphas: Pair 1 [Alpha] false;
    alpha_lowers: Pair 1 [Alpha] false;
    alpha_uppers: Pair 1 [Alpha] false;
    separations: Pair 1 [Normal] false;
    normals: Pair 3 [Normal] false;
    point_counts: Pair 1 [Points WitnessB Features Matches] false;
    feature_kinds: Pair 2 [Features] false;
    feature_indices: Pair 4 [Features] false;
    bases: Pair 6 [Bases] false;
    iterations: Pair 1 [Diagnostics] false;
    support_calls: Pair 1 [Diagnostics] false;
    kept_areas: Pair 1 [Diagnostics] true;
    previous_pairs: Pair 1 [Matches] true;
    alpha_gradients: Pair 9 [AlphaGradient] true;
    separation_gradients: Pair 9 [SeparationGradient] true;
    normal_jacobians: Pair 27 [NormalJacobian] true;
    gradient_errors: Pair 1 [AlphaGradient SeparationGradient NormalJacobian] true;
    witness_as: Point 3 [Points] false;
    distances: Point 1 [Points] false;
    witness_bs: Point 3 [WitnessB] false;
    point_ids: Point 4 [Features] false;
    previous_points: Point 1 [Matches] true;
}

#[cfg(test)]
mod tests {
    use super::*;
    use prost::Message;
    use prost_types::FileDescriptorSet;

    /// Catches a column of the contract that the client neither checks nor joins.
    #[test]
    fn the_table_has_every_column_of_the_contract() {
        let files = FileDescriptorSet::decode(hullcast_proto::FILE_DESCRIPTOR_SET).expect("the contract");
        let messages = files.file.iter().flat_map(|file| &file.message_type);
        let answer = messages.clone().find(|message| message.name() == "QueryContactsResponse");
        let not_columns = [
            "request_id",
            "missing_hulls",
            "invalid_bodies",
            "ended_pairs",
            "more",
            "contract",
            "state_dropped",
            "unchanged",
        ];
        let mut expected: Vec<&str> =
            answer.expect("the message").field.iter().map(|field| field.name()).collect();
        expected.retain(|name| !not_columns.contains(name));
        let mut found: Vec<&str> =
            lengths(&QueryContactsResponse::default()).map(|(column, _)| column.name).collect();
        expected.sort_unstable();
        found.sort_unstable();
        assert_eq!(found, expected);
    }

    /// Catches an output that is forgotten or invented, and a newer output that breaks an older client.
    #[test]
    fn outputs_are_those_of_the_request() {
        let of = |outputs: &[i32]| {
            Outputs::of(&QueryContactsRequest { outputs: outputs.to_vec(), ..Default::default() })
        };
        let usual = of(&[]);
        assert!(usual.has(Output::Alpha) && usual.has(Output::Normal) && usual.has(Output::Points));
        assert!(!usual.has(Output::Bases));
        assert_eq!(of(&[Output::Bases as i32, 900, -1]), of(&[Output::Bases as i32]));
    }
}
