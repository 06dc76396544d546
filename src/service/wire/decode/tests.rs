//! Tests of requests that aim at the server's memory or time, and of requests in every form that
//! prost reads.

use bytes::BufMut;
use prost::{
    Message,
    encoding::{WireType, encode_key, encode_varint},
};

use super::*;
use crate::{
    contact::STEPS_BETWEEN_LOOKS,
    service::{Reason, sizes::HULL_BYTES},
};

/// The size of large messages. It is large enough that an allocation per element would be noticed.
const LARGE: usize = 2 << 20;

fn limits() -> Limits {
    Limits { max_hulls_per_request: 100, max_points_per_hull: 20_000, ..Limits::default() }
}

/// A length-delimited field.
fn field(tag: u32, content: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    encode_key(tag, WireType::LengthDelimited, &mut bytes);
    encode_varint(content.len() as u64, &mut bytes);
    bytes.put_slice(content);
    bytes
}

/// `count` doubles, each as a field of its own.
fn unpacked(tag: u32, count: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    for i in 0..count {
        encode_key(tag, WireType::SixtyFourBit, &mut bytes);
        bytes.put_f64_le(i as f64);
    }
    bytes
}

fn decode(method: &str, message: &[u8]) -> Result<usize, ServiceError> {
    decoded_bytes(method, message, &limits(), &Stop::default())
}

/// A valid query without pairs.
fn query(bodies: usize) -> proto::QueryContactsRequest {
    proto::QueryContactsRequest {
        hull_ids: (0..100).map(|i| vec![i; 32]).collect(),
        body_hulls: vec![99; bodies],
        positions: vec![0.5; 3 * bodies],
        rotations: [0.0, 0.0, 0.0, 1.0].repeat(bodies),
        margin: 0.1,
        ..Default::default()
    }
}

/// Messages with many elements of at most two bytes, and columns over a limit, must be refused with
/// the field's name, and with almost no allocation. Catches memory that grows with the number of
/// elements before they are counted.
#[test]
fn elements_are_counted_before_anything_is_allocated() {
    let empty = |tag| field(tag, &[]).repeat(LARGE / 2);
    let cases = [
        ("RegisterHulls", empty(1), "TOO_MANY_HULLS", "hulls"),
        ("GetHulls", empty(1), "TOO_MANY_HULLS", "ids"),
        ("HasHulls", empty(1), "TOO_MANY_HULLS", "ids"),
        ("DeleteHulls", empty(1), "TOO_MANY_HULLS", "ids"),
        ("QueryContacts", empty(3), "TOO_MANY_HULLS", "hull_ids"),
        ("FindContacts", empty(3), "TOO_MANY_HULLS", "hull_ids"),
        ("GetHulls", field(2, &empty(1)), "TOO_MANY_PATHS", "field_mask.paths"),
        ("GetHulls", field(2, &field(1, b"info")).repeat(1 << 20), "TOO_MANY_PATHS", "field_mask.paths"),
        ("QueryContacts", field(13, &vec![1; LARGE]), "TOO_MANY_OUTPUTS", "outputs"),
        ("QueryContacts", [13 << 3, 1].repeat(LARGE / 2), "TOO_MANY_OUTPUTS", "outputs"),
        ("QueryContacts", field(4, &vec![0; LARGE]), "TOO_MANY_BODIES", "body_hulls"),
        ("QueryContacts", field(7, &vec![0; LARGE]), "TOO_MANY_PAIRS", "pairs"),
        // The first message contains an empty message, the last one hulls with only an unknown
        // field.
        ("QueryContacts", [field(12, &[]), empty(3)].concat(), "TOO_MANY_HULLS", "hull_ids"),
        ("RegisterHulls", field(1, &field(99, &[])).repeat(1 << 20), "TOO_MANY_HULLS", "hulls"),
    ];
    for (method, message, reason, name) in cases {
        let mut refused = None;
        let made = allocation_counter::measure(|| refused = decode(method, &message).err());
        let refused = refused.unwrap_or_else(|| panic!("{method} takes {name}"));
        let field = refused.location.as_ref().map(|location| location.field);
        assert_eq!((refused.reason.name(), field), (reason, Some(name)), "{method}: {refused}");
        assert!(made.bytes_max < CONSTANT_BYTES as u64, "{method} {name}: {made:?}");
    }
}

/// Hulls at the limit must be accepted, and a hull one point over it refused without affecting the
/// others. Catches a hull that is copied before it is known to be too large.
#[test]
fn points_of_a_hull_at_their_limit_and_one_past() {
    let (limits, stop) = (limits(), Stop::default());
    let points = limits.max_points_per_hull as usize;
    let hull = |points: usize| field(1, &field(1, &vec![0; 24 * points]));
    let message = [hull(points), hull(points + 1), hull(10 * points), hull(4)].concat();
    let mut read = None;
    let made = allocation_counter::measure(|| {
        let mut take = |_| Ok(());
        let resources = &mut DecodeResources::new(&limits, &stop, &mut take);
        read = Some(proto::RegisterHullsRequest::read(&message, resources).unwrap());
    });
    let read = read.unwrap();
    assert_eq!(read[0].as_ref().map(|hull| hull.points.len()), Ok(points));
    assert_eq!(read[3].as_ref().map(|hull| hull.points.len()), Ok(4));
    for (refused, found) in [(&read[1], points + 1), (&read[2], 10 * points)] {
        let error = refused.as_ref().unwrap_err();
        assert_eq!((&*error.reason, &*error.field), ("TOO_MANY_POINTS", "vertices"));
        assert!(
            error.message.starts_with(&format!("got {found} points, at most {points} are allowed")),
            "{error:?}"
        );
    }
    assert!(made.bytes_max <= (24 * (points + 4) + 4 * HULL_BYTES) as u64, "{made:?}");
}

/// Catches lists of outputs and paths that are refused at their limit, or accepted past it.
#[test]
fn outputs_and_paths_at_their_limits_and_one_past() {
    let outputs = |count: usize| [query(1).encode_to_vec(), field(13, &vec![1; count])].concat();
    let paths = |count: usize| field(2, &field(1, b"info").repeat(count));
    for (method, good, bad, reason) in [
        ("QueryContacts", outputs(256), outputs(257), "TOO_MANY_OUTPUTS"),
        ("GetHulls", paths(256), paths(257), "TOO_MANY_PATHS"),
    ] {
        assert!(decode(method, &good).is_ok(), "{reason}");
        assert_eq!(decode(method, &bad).unwrap_err().reason.name(), reason);
    }
}

/// Large messages that are accepted, in every form that prost reads, and large messages whose fault
/// is found late.
fn large_messages() -> Vec<(&'static str, Vec<u8>)> {
    let whole = query(100_000);
    // Columns in many parts, with repeated singular fields and unknown fields between them.
    let mut split = Vec::new();
    for body in 0..50_000 {
        let part = proto::QueryContactsRequest {
            hull_ids: if body < 100 { vec![vec![body as u8; 32]] } else { vec![] },
            body_hulls: vec![0],
            positions: vec![0.5; 3],
            rotations: vec![0.0, 0.0, 0.0, 1.0],
            accuracy: Some(proto::Accuracy { max_points: 3, ..Default::default() }),
            request_id: body,
            ..Default::default()
        };
        part.encode(&mut split).unwrap();
        split.extend(field(900, b"unknown"));
    }
    // Bodies with an unusable pose are listed, which takes 4 bytes more per body.
    let unusable = proto::QueryContactsRequest { positions: vec![f64::NAN; 300_000], ..whole.clone() };
    let group = |content: &[u8]| [&[0xa3, 0x38], content, &[0xa4, 0x38]].concat();
    let hulls = |hull: Vec<u8>| field(1, &hull).repeat(100);
    vec![
        ("QueryContacts", whole.encode_to_vec()),
        ("FindContacts", whole.encode_to_vec()),
        ("QueryContacts", split),
        ("QueryContacts", unusable.encode_to_vec()),
        ("QueryContacts", unpacked(5, LARGE / 9)),
        ("QueryContacts", field(5, &vec![0; LARGE])),
        ("QueryContacts", group(&[8, 1].repeat(LARGE / 2))),
        ("QueryContacts", field(12, &[0x10, 1].repeat(LARGE / 2))),
        ("QueryContacts", field(900, &vec![0xff; LARGE])),
        ("RegisterHulls", hulls(field(1, &vec![0; 24 * 3000]))),
        ("RegisterHulls", hulls(unpacked(1, 30_000))),
        ("RegisterHulls", hulls([field(1, &[0; 96]), field(3, &[8, 9]).repeat(10_000)].concat())),
        ("RegisterHulls", field(1, &field(2, &vec![0; LARGE]))),
        ("RegisterHulls", [0x0a, 0].repeat(100)),
        ("GetHulls", [field(1, &[7; 32]).repeat(100), field(900, &vec![0; LARGE])].concat()),
        ("GetHulls", field(2, &field(1, &vec![1; LARGE]))),
        ("HasHulls", field(1, &[7; 32]).repeat(100)),
        ("HasHulls", field(1, &vec![7; LARGE])),
        ("ListHulls", field(2, &vec![b'a'; LARGE])),
        ("ListHulls", field(2, &[b'a'; 64]).repeat(1 << 17)),
        ("GetServerInfo", field(1, &vec![0; LARGE])),
    ]
}

/// Catches memory beyond the documented multiple of a message, whether it is accepted or refused,
/// and memory that is allocated without being taken from the budget.
#[test]
fn decoding_takes_at_most_twice_the_message() {
    let mut accepted = 0;
    for (method, message) in large_messages() {
        let mut result = None;
        let made = allocation_counter::measure(|| result = Some(decode(method, &message)));
        let stated = 2 * message.len() + 100 * HULL_BYTES + CONSTANT_BYTES;
        assert!(made.bytes_max <= stated as u64, "{method}: {made:?}, {} bytes", message.len());
        if let Some(Ok(taken)) = result {
            accepted += 1;
            assert!(taken <= stated, "{method}: {taken}");
            let counted = (taken + CONSTANT_BYTES) as u64;
            assert!(made.bytes_max <= counted, "{method}: {made:?}, {taken} taken");
        }
    }
    assert!(accepted >= 12, "{accepted}");
}

/// Catches memory that is allocated although the budget has no room for it.
#[test]
fn nothing_is_allocated_without_room() {
    let none = || ServiceError::new(Reason::TooBusy, "no room");
    let message = query(100_000).encode_to_vec();
    let (limits, stop) = (limits(), Stop::default());
    let made = allocation_counter::measure(|| {
        let mut take = |_| Err(none());
        let mut resources = DecodeResources::new(&limits, &stop, &mut take);
        assert_eq!(proto::QueryContactsRequest::read(&message, &mut resources).err(), Some(none()));
        drop(resources);
        let resources = &mut DecodeResources::new(&limits, &stop, &mut take);
        let hulls = field(1, &field(1, &vec![0; 24 * 3000]));
        assert_eq!(proto::RegisterHullsRequest::read(&hulls, resources).err(), Some(none()));
    });
    // The encoded message with the hulls is made inside the measurement.
    assert!(made.bytes_max <= 4 * 24 * 3000, "{made:?}");
}

/// Catches decoding and validation that go on for more than a millisecond after the work was
/// stopped, in any part of a message.
#[test]
fn decoding_looks_at_the_flag() {
    for (method, message) in large_messages() {
        let stop = Stop::default();
        let _ = decoded_bytes(method, &message, &limits(), &stop);
        assert!(stop.largest_between_looks() <= STEPS_BETWEEN_LOOKS, "{method}");
        let stopped = Stop::default();
        stopped.stop();
        let result = decoded_bytes(method, &message, &limits(), &stopped);
        // Shorter work need not check the flag.
        if stop.steps() >= STEPS_BETWEEN_LOOKS / 4 {
            assert_eq!(result, Err(ServiceError::deadline_exceeded()), "{method}");
            assert!(stopped.steps() <= STEPS_BETWEEN_LOOKS, "{method}");
        }
    }
}

/// The message as prost reads it, encoded again, or `None` if prost refuses it.
fn as_prost<M: Message + Default>(bytes: &[u8]) -> Option<Vec<u8>> {
    M::decode(bytes).ok().map(|message| message.encode_to_vec())
}

/// Decodes well-formed messages of every kind, truncated at every byte and with every bit flipped.
/// Catches bytes that prost accepts but the decoder calls malformed, bytes that prost refuses but
/// the decoder accepts, and a query that is read differently.
#[test]
fn the_bytes_that_prost_accepts_are_accepted() {
    let mut query = query(2);
    query.hull_ids.truncate(2);
    query.body_hulls = vec![0, 1];
    query.pairs = vec![0, 1];
    query.outputs = vec![1, 300, 8];
    query.accuracy = Some(proto::Accuracy { feature_angle: Some(0.25), max_points: 7, ..Default::default() });
    let mut odd = query.encode_to_vec();
    odd.extend(unpacked(5, 1));
    odd.extend([13 << 3, 2, 0xa3, 0x38, 8, 1, 0xa4, 0x38]);
    odd.extend(field(12, &[0x28, 9]));
    let hull = proto::HullDefinition {
        vertices: vec![0.5; 12],
        contraction_point: vec![0.25; 3],
        simplification: Some(proto::Simplification { max_vertices: Some(9), max_deviation: Some(0.5) }),
        planarity: Some(1e-3),
    };
    let hulls = proto::RegisterHullsRequest { hulls: vec![hull.clone(), hull] };
    let mask = prost_types::FieldMask { paths: vec!["info".into(), "faces".into()] };
    let get = proto::GetHullsRequest { ids: vec![vec![5; 32]; 2], field_mask: Some(mask) };
    let list = proto::ListHullsRequest { page_size: 300, page_token: "ab".repeat(32) };
    type Prost = fn(&[u8]) -> Option<Vec<u8>>;
    let seeds: [(&str, Vec<u8>, Prost); 6] = [
        ("QueryContacts", query.encode_to_vec(), as_prost::<proto::QueryContactsRequest>),
        ("QueryContacts", odd, as_prost::<proto::QueryContactsRequest>),
        ("RegisterHulls", hulls.encode_to_vec(), as_prost::<proto::RegisterHullsRequest>),
        ("GetHulls", get.encode_to_vec(), as_prost::<proto::GetHullsRequest>),
        ("HasHulls", get.encode_to_vec(), as_prost::<proto::HasHullsRequest>),
        ("ListHulls", list.encode_to_vec(), as_prost::<proto::ListHullsRequest>),
    ];
    let (limits, stop) = (limits(), Stop::default());
    let (mut read, mut refused) = (0, 0);
    for (method, seed, prost) in seeds {
        let cut = (0..=seed.len()).map(|end| seed[..end].to_vec());
        let flipped = (0..8 * seed.len()).map(|bit| {
            let mut bytes = seed.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            bytes
        });
        for bytes in cut.chain(flipped) {
            let prost = prost(&bytes);
            match (decode(method, &bytes), &prost) {
                (Err(error), Some(_)) => {
                    assert_ne!(error.reason, Reason::MalformedMessage, "{method} {bytes:?}")
                }
                (Ok(_), None) => panic!("{method} {bytes:?}"),
                (Err(_), None) => refused += 1,
                (Ok(_), Some(_)) => read += 1,
            }
            if method == "QueryContacts" {
                let mut take = |_| Ok(());
                let resources = &mut DecodeResources::new(&limits, &stop, &mut take);
                if let Ok(request) = proto::QueryContactsRequest::read(&bytes, resources) {
                    assert_eq!(Some(request.encode_to_vec()), prost, "{bytes:?}");
                }
            }
        }
    }
    assert!(read > 500 && refused > 500, "{read} read, {refused} refused");
}
