//! Well-formed messages with which the fuzzing of the handlers starts.

use hullcast::store::identity::{self, id_of};
use hullcast_proto::{Accuracy, GetHullsRequest, HullDefinition, ListHullsRequest};
use hullcast_proto::{QueryContactsRequest, RegisterHullsRequest};
use prost::Message;

const CORNER: [[f64; 3]; 4] = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

fn cube() -> Vec<[f64; 3]> {
    (0..8).map(|i| [0, 1, 2].map(|k| if i >> k & 1 == 1 { 1.0 } else { -1.0 })).collect()
}

/// The hulls that the fuzzer's server has registered from the start.
pub fn hulls() -> RegisterHullsRequest {
    let definition = |points: &[[f64; 3]]| HullDefinition { vertices: points.concat(), ..Default::default() };
    RegisterHullsRequest { hulls: vec![definition(&CORNER), definition(&cube())] }
}

fn ids() -> Vec<Vec<u8>> {
    let id = |points: Vec<[f64; 3]>| {
        let definition = identity::HullDefinition { points, ..Default::default() };
        id_of(&definition.identity_bytes()).0.to_vec()
    };
    vec![id(CORNER.to_vec()), id(cube())]
}

/// Two bodies and one pair.
fn scene(margin: f64) -> QueryContactsRequest {
    QueryContactsRequest {
        request_id: 7,
        hull_ids: ids(),
        body_hulls: vec![0, 1],
        positions: vec![0.0, 0.0, 0.0, 0.5, 1.25, 0.25],
        rotations: vec![0.0, 0.0, 0.0, 1.0, 0.5, 0.5, 0.5, 0.5],
        pairs: vec![0, 1],
        margin,
        ..Default::default()
    }
}

/// The first message of a stream that finds its pairs: six bodies, some of which touch.
pub fn step_scene() -> QueryContactsRequest {
    QueryContactsRequest {
        find: true,
        body_hulls: vec![0, 1, 1, 0, 1, 0],
        positions: [0.0, 0.5, 1.0, 1.5, 9.0, 1.25].repeat(3),
        rotations: [0.0, 0.0, 0.0, 1.0].repeat(6),
        pairs: vec![],
        outputs: (1..=9).collect(),
        ..scene(0.25)
    }
}

/// The seeds: a name, the index of the method in the fuzzer's list, and the message.
pub fn all() -> Vec<(&'static str, u8, Vec<u8>)> {
    let query = scene(f64::INFINITY);
    let everything = QueryContactsRequest {
        outputs: (1..=8).collect(),
        accuracy: Some(Accuracy {
            solver: 2,
            relative_tolerance: 1e-3,
            feature_angle: Some(0.1),
            max_points: 4,
            ..Default::default()
        }),
        warm_starts: vec![0, 1, 2, 0, 1, 2],
        margins: vec![0.1, 0.0],
        linear_velocities: vec![1.0, 0.0, 0.0, -1.0, 0.0, 0.0],
        angular_velocities: vec![0.0, 2.0, 0.0, 0.0, 0.0, 0.5],
        time_step: 0.25,
        turning_points: vec![0.0, 0.0, 0.5, 0.0, 0.0, 0.0],
        ..query.clone()
    };
    let invalid = QueryContactsRequest { positions: vec![f64::NAN; 6], ..query.clone() };
    let unknown = QueryContactsRequest { hull_ids: vec![vec![1; 32], ids()[1].clone()], ..query.clone() };
    let many = QueryContactsRequest { pairs: [0, 1].repeat(9), ..scene(0.01) };
    let bad = RegisterHullsRequest {
        hulls: vec![HullDefinition {
            vertices: [&CORNER[..3], &CORNER[..3]].concat().concat(),
            contraction_point: vec![0.1, 0.1, 0.1],
            simplification: None,
            planarity: Some(1e-3),
        }],
    };
    let found = QueryContactsRequest {
        body_hulls: vec![0, 1, 1, 0],
        positions: [0.0, 0.5, 1.0, 1.5].repeat(3),
        rotations: [0.0, 0.0, 0.0, 1.0].repeat(4),
        pairs: vec![],
        worlds: vec![1, 1, u32::MAX, 2],
        groups: vec![1, 2, 3, 0],
        ignored_groups: vec![1, 2],
        ..scene(1.0)
    };
    let moved = QueryContactsRequest {
        request_id: 8,
        inherit: true,
        moved: vec![1, 4],
        positions: vec![0.5, 0.25, 0.5, 1.0, 1.0, 1.5],
        rotations: vec![0.0, 0.0, 0.0, 1.0, 0.5, 0.5, 0.5, 0.5],
        ..Default::default()
    };
    let still = QueryContactsRequest { moved: vec![], positions: vec![], rotations: vec![], ..moved.clone() };
    let changed = QueryContactsRequest { previous_bodies: vec![3, u32::MAX, 1, 0, 5, 2], ..step_scene() };
    let named = QueryContactsRequest {
        find: false,
        pairs: vec![0, 1, 3, 1, 1, 3, 2, 2],
        previous_bodies: vec![1, 0, 2, 3, 4, 5],
        ..step_scene()
    };
    let sped = QueryContactsRequest {
        linear_velocities: vec![1.0; 6],
        angular_velocities: vec![0.5; 6],
        time_step: 0.125,
        ..moved.clone()
    };
    let widened = QueryContactsRequest {
        margins: vec![0.125; 6],
        turning_points: vec![0.5; 18],
        linear_velocities: vec![1.0; 18],
        time_step: 0.125,
        ..step_scene()
    };
    // Elements of two bytes each, and a group that contains an unknown field.
    let empty = |tag: u8| [tag << 3 | 2, 0].repeat(20);
    let group = [0xa3, 0x38, 8, 1, 0xa4, 0x38];
    let odd = [&query.encode_to_vec()[..], &group, &[13 << 3, 2], &[12 << 3 | 2, 2, 5 << 3, 9]].concat();
    vec![
        ("query-odd", 0, odd),
        ("query-empty-ids", 0, empty(3)),
        ("register-empty", 2, empty(1)),
        ("get-empty-ids", 3, empty(1)),
        ("get-empty-masks", 3, empty(2)),
        ("query", 0, query.encode_to_vec()),
        ("query-everything", 0, everything.encode_to_vec()),
        ("query-invalid-body", 0, invalid.encode_to_vec()),
        ("query-unknown-hull", 0, unknown.encode_to_vec()),
        ("query-many", 0, many.encode_to_vec()),
        ("register", 2, hulls().encode_to_vec()),
        ("register-bad", 2, bad.encode_to_vec()),
        ("get", 3, GetHullsRequest { ids: ids(), ..Default::default() }.encode_to_vec()),
        ("list", 4, ListHullsRequest { page_size: 1, ..Default::default() }.encode_to_vec()),
        ("stream", 5, query.encode_to_vec()),
        ("step-find", 5, step_scene().encode_to_vec()),
        ("step-moved", 5, moved.encode_to_vec()),
        ("step-still", 5, still.encode_to_vec()),
        ("step-bodies", 5, changed.encode_to_vec()),
        ("step-named", 5, named.encode_to_vec()),
        ("step-velocities", 5, sped.encode_to_vec()),
        ("step-margins", 5, widened.encode_to_vec()),
        ("find", 6, QueryContactsRequest { pairs: vec![], ..scene(0.5) }.encode_to_vec()),
        ("find-worlds", 6, found.encode_to_vec()),
    ]
}
