//! Makes responses of columns, and reads the columns of responses.

use crate::{
    batch::{
        Columns,
        columns::{COLUMNS, Column, Values},
    },
    proto::{CONTRACT, QueryContactsResponse},
};

/// The response to a checked request.
pub fn response(
    request_id: u64,
    columns: Columns,
    missing_hulls: Vec<u32>,
    invalid_bodies: Vec<u32>,
) -> QueryContactsResponse {
    macro_rules! response {
        ($($column:ident)*) => {
            QueryContactsResponse {
                request_id,
                missing_hulls,
                invalid_bodies,
                contract: CONTRACT,
                $($column: columns.$column,)*
                ..Default::default()
            }
        };
    }
    hullcast_batch::with_columns!(response)
}

/// Takes the columns of the table out of a response.
pub(in crate::service) fn take_columns(response: &mut QueryContactsResponse) -> Columns {
    let mut columns = Columns::default();
    macro_rules! take {
        ($($column:ident)*) => { $(columns.$column = std::mem::take(&mut response.$column);)* };
    }
    hullcast_batch::with_columns!(take);
    columns
}

/// The values of each column of the table, in a response.
pub fn response_columns(
    response: &QueryContactsResponse,
) -> impl Iterator<Item = (&'static Column, Values<'_>)> {
    macro_rules! values {
        ($($column:ident)*) => { [$(Values::from(&response.$column[..])),*] };
    }
    let values = hullcast_batch::with_columns!(values);
    COLUMNS.iter().zip(values)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use prost::Message as _;
    use prost_types::{FieldDescriptorProto, FileDescriptorSet, field_descriptor_proto::Type};

    use super::*;
    use crate::{
        batch::{
            Output,
            codes::{feature, flag, outcome},
            columns::Per,
        },
        proto::{self, FILE_DESCRIPTOR_SET, FeatureKind, Flag, Outcome},
    };

    /// Catches a number of the library that means something else in the contract, and a value of the contract
    /// that the library does not have.
    #[test]
    fn the_numbers_are_those_of_the_contract() {
        let outcomes = [
            (outcome::CONTACT, Outcome::Contact),
            (outcome::SEPARATED, Outcome::Separated),
            (outcome::UNDECIDED, Outcome::Undecided),
            (outcome::INVALID, Outcome::Invalid),
        ];
        let flags = [
            (flag::ESTIMATED, Flag::Estimated),
            (flag::COINCIDENT, Flag::Coincident),
            (flag::GAP_OPEN, Flag::GapOpen),
            (flag::REDUCED, Flag::Reduced),
            (flag::UNKNOWN_HULL, Flag::UnknownHull),
            (flag::HULL_UNAVAILABLE, Flag::HullUnavailable),
            (flag::INVALID_BODY, Flag::InvalidBody),
            (flag::KINK, Flag::Kink),
        ];
        let features = [
            (feature::NONE, FeatureKind::None),
            (feature::VERTEX, FeatureKind::Vertex),
            (feature::EDGE, FeatureKind::Edge),
            (feature::FACE, FeatureKind::Face),
        ];
        let codes = |codes: Vec<(u8, i32)>, is_known: fn(i32) -> bool, count: usize| {
            assert!(codes.iter().all(|&(ours, wire)| i32::from(ours) == wire), "{codes:?}");
            assert_eq!((0..=255).filter(|&number| is_known(number)).count(), count);
        };
        // The contract has a value 0 besides the outcomes and the flags.
        codes(outcomes.map(|(ours, wire)| (ours, wire as i32)).into(), Outcome::is_valid, outcomes.len() + 1);
        codes(flags.map(|(ours, wire)| (ours, wire as i32)).into(), Flag::is_valid, flags.len() + 1);
        codes(features.map(|(ours, wire)| (ours, wire as i32)).into(), FeatureKind::is_valid, features.len());
        for number in -1..256 {
            let name = proto::Output::try_from(number).ok().map(|wire| wire.as_str_name());
            let ours = Output::from_number(number).map(|output| format!("OUTPUT_{}", output.name()));
            // Outcomes are sent always.
            let listed = name.filter(|name| !["OUTPUT_UNSPECIFIED", "OUTPUT_OUTCOME"].contains(name));
            assert_eq!(listed.map(String::from), ours, "{number}");
        }
    }

    /// The repeated and byte fields of the response in a descriptor set, by their name and type.
    fn response_fields(descriptors: &[u8]) -> Vec<(String, Type)> {
        let set = FileDescriptorSet::decode(descriptors).unwrap();
        let messages = set.file.into_iter().flat_map(|file| file.message_type);
        let message = messages.into_iter().find(|message| message.name() == "QueryContactsResponse").unwrap();
        let is_column = |field: &FieldDescriptorProto| {
            let others = ["request_id", "missing_hulls", "invalid_bodies", "ended_pairs", "more", "contract"];
            let of_steps = ["state_dropped", "unchanged"];
            others.iter().chain(&of_steps).all(|other| field.name() != *other)
        };
        let columns = message.field.into_iter().filter(is_column);
        columns.map(|field| (field.name().to_owned(), field.r#type())).collect()
    }

    /// Catches a column of the contract that the table lacks, a row of the table with another type, and a row
    /// that is wrong about whether the first version of the contract had the column.
    #[test]
    fn the_table_is_that_of_the_contract() {
        let response = QueryContactsResponse::default();
        let mut ours: Vec<(String, Type)> = response_columns(&response)
            .map(|(column, values)| {
                let element = match values {
                    Values::U8(_) => Type::Bytes,
                    Values::U32(_) => Type::Fixed32,
                    Values::F64(_) => Type::Double,
                };
                (column.name.to_owned(), element)
            })
            .collect();
        let mut contract = response_fields(FILE_DESCRIPTOR_SET);
        ours.sort();
        contract.sort();
        assert_eq!(ours, contract);
        let first = include_bytes!("../../../tests/golden/first_contract.binpb");
        let first: Vec<String> = response_fields(first).into_iter().map(|(name, _)| name).collect();
        for column in COLUMNS {
            assert_eq!(column.is_later, !first.iter().any(|name| name == column.name), "{}", column.name);
            assert!(column.per != Per::FoundPair || column.name == "pairs");
        }
    }

    /// The text of a definition in the Python client, from its name to the line that closes it.
    fn python(name: &str) -> &'static str {
        let text = include_str!("../../../client/src/hullcast/_wire.py");
        let begin = text.find(&format!("\n{name}")).unwrap_or_else(|| panic!("_wire.py has no {name}")) + 1;
        let one_line = text[begin..].find('\n').unwrap();
        let first = &text[begin..begin + one_line];
        let end = if first.ends_with('{') { text[begin..].find("\n}").unwrap() } else { one_line };
        &text[begin..begin + end]
    }

    /// Catches a column that the Python client lacks, reads with another width, expects of another output, or
    /// expects of a server of the first version.
    #[test]
    fn the_python_client_has_the_same_table() {
        let is_of = |column: &&Column, per: Per| column.per == per && !column.outputs.is_empty();
        for (name, per) in [("PAIR_COLUMNS", Per::Pair), ("POINT_COLUMNS", Per::Point)] {
            let text = python(name);
            let ours: Vec<_> = COLUMNS.iter().filter(|column| is_of(column, per)).collect();
            for column in &ours {
                let entry = format!("\"{}\": {}", column.name, column.width);
                assert!(text.contains(&entry), "{name} lacks {entry}");
            }
            assert_eq!(text.matches(": ").count(), ours.len(), "{name} has a column too many");
        }
        let outputs = python("OUTPUT_COLUMNS");
        for &output in Output::ALL {
            let begins = format!("\"{}\": (", output.name());
            let line = outputs.lines().find_map(|line| line.trim().strip_prefix(&begins)).unwrap_or_default();
            let mut theirs: Vec<_> = line.split('"').skip(1).step_by(2).collect();
            let mut ours: Vec<_> =
                COLUMNS.iter().filter(|c| c.outputs.contains(&output)).map(|column| column.name).collect();
            theirs.sort_unstable();
            ours.sort_unstable();
            assert_eq!(theirs, ours, "OUTPUT_COLUMNS: {}", output.name());
        }
        let later = python("LATER_COLUMNS");
        for column in COLUMNS {
            assert_eq!(later.contains(&format!("\"{}\"", column.name)), column.is_later, "{}", column.name);
        }
    }

    /// Catches a column that the Rust client lacks, expects with another size or of another output, or expects of
    /// a server of the first version.
    #[test]
    fn the_rust_client_has_the_same_table() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/crates/client/src/columns.rs");
        let text = std::fs::read_to_string(file).unwrap();
        let table = text.split("\ncolumns! {\n").nth(1).and_then(|rest| rest.split("\n}").next()).unwrap();
        let theirs: BTreeSet<String> = table.lines().map(|line| line.trim().to_owned()).collect();
        let row = |column: &Column| {
            let outputs: Vec<String> = column.outputs.iter().map(|output| format!("{output:?}")).collect();
            let (name, per, width) = (column.name, column.per, column.width);
            format!("{name}: {per:?} {width} [{}] {};", outputs.join(" "), column.is_later)
        };
        assert_eq!(theirs, COLUMNS.iter().map(row).collect());
    }

    /// Catches a column that gets lost between the library and a response, or when parts are joined.
    #[test]
    fn every_column_reaches_the_response() {
        let mut columns = Columns::default();
        let outputs = crate::batch::Outputs::of(Output::ALL.iter().copied());
        columns.push_pair([3, 4]);
        let point = crate::contact::ContactPoint {
            witness_a: glam::DVec3::X,
            distance: 0.5,
            id: [crate::contact::Element::Inside; 2],
        };
        let manifold = crate::contact::Manifold { points: vec![point], ..Default::default() };
        columns.push(&manifold, outputs);
        columns.push_derivatives(None, outputs);
        let expected: Vec<String> = columns.values().map(|column| format!("{column:?}")).collect();
        let part = response(7, columns, vec![1], vec![2]);
        let found: Vec<String> = response_columns(&part).map(|column| format!("{column:?}")).collect();
        assert_eq!(found, expected);
        let mut whole = QueryContactsResponse::default();
        hullcast_client::append(&mut whole, part.clone());
        hullcast_client::append(&mut whole, part.clone());
        assert_eq!((whole.missing_hulls.len(), whole.invalid_bodies.len()), (1, 1));
        for ((column, one), (_, two)) in response_columns(&part).zip(response_columns(&whole)) {
            assert!(!one.is_empty() && 2 * one.len() == two.len(), "{}", column.name);
        }
    }
}
