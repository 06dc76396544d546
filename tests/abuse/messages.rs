//! Messages and hulls that attacks use.

use hullcast::{
    proto::{Accuracy, Output, QueryContactsRequest},
    store::HullDefinition,
};

use crate::scenes::{outputs, plain};

/// Appends a number as a protobuf varint.
pub(crate) fn varint(message: &mut Vec<u8>, mut value: usize) {
    while value >= 128 {
        message.push((value % 128) as u8 | 128);
        value /= 128;
    }
    message.push(value as u8);
}

/// A length-delimited protobuf field: tag, length and content.
pub(crate) fn field(number: usize, content: &[u8]) -> Vec<u8> {
    let mut message = Vec::with_capacity(content.len() + 16);
    varint(&mut message, number << 3 | 2);
    varint(&mut message, content.len());
    message.extend_from_slice(content);
    message
}

/// An unknown field of `bytes` bytes. It is a valid message of every type.
pub(crate) fn unknown_field(bytes: usize) -> Vec<u8> {
    field(1023, &vec![7; bytes])
}

/// Repeats `unit` as often as fits in `bytes` bytes.
pub(crate) fn repeated(unit: &[u8], bytes: usize) -> Vec<u8> {
    unit.repeat(bytes / unit.len())
}

/// A request for the same pair `pairs` times: one body of the first and one of the last hull, `distance`
/// apart.
pub(crate) fn same_pair(ids: &[Vec<u8>], pairs: usize, distance: f64) -> QueryContactsRequest {
    QueryContactsRequest {
        hull_ids: ids.to_vec(),
        body_hulls: vec![0, (ids.len() - 1) as u32],
        positions: vec![0.0, 0.0, 0.0, 0.01, 0.02, distance],
        rotations: vec![0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        pairs: [0, 1].repeat(pairs),
        outputs: outputs(&[
            Output::Alpha,
            Output::Normal,
            Output::Points,
            Output::Features,
            Output::Bases,
            Output::Diagnostics,
        ]),
        ..Default::default()
    }
}

/// Limits the answer of a request to 4 points per pair.
pub(crate) fn few_points(mut request: QueryContactsRequest) -> QueryContactsRequest {
    request.accuracy = Some(Accuracy { max_points: 4, ..Default::default() });
    request
}

/// A row of bodies of one hull; neighbours are `step` apart.
pub(crate) fn row(id: &[u8], bodies: usize, step: f64) -> QueryContactsRequest {
    QueryContactsRequest {
        hull_ids: vec![id.to_vec()],
        body_hulls: vec![0; bodies],
        positions: (0..bodies).flat_map(|body| [step * body as f64, 0.0, 0.0]).collect(),
        rotations: [0.0, 0.0, 0.0, 1.0].repeat(bodies),
        outputs: outputs(&crate::scenes::ALL),
        ..Default::default()
    }
}

/// A prism of height 1 whose two large faces have `sides` sides.
pub(crate) fn prism(sides: usize) -> HullDefinition {
    let corner = |i: usize| (std::f64::consts::TAU * i as f64 / sides as f64).sin_cos();
    plain(
        (0..2 * sides).map(|i| (corner(i % sides), i / sides)).map(|((s, c), z)| [c, s, z as f64]).collect(),
    )
}

/// Points on circles of latitude. Any four neighbouring points lie in one plane up to rounding.
pub(crate) fn globe(rings: usize, around: usize) -> HullDefinition {
    let mut points = Vec::with_capacity(rings * around);
    for ring in 1..=rings {
        let (sin, cos) = (std::f64::consts::PI * ring as f64 / (rings + 1) as f64).sin_cos();
        for i in 0..around {
            let (s, c) = (std::f64::consts::TAU * i as f64 / around as f64).sin_cos();
            points.push([sin * c, sin * s, cos]);
        }
    }
    plain(points)
}

/// A lattice on the surface of a cube, with each point moved by less than the rounding error of its
/// coordinates. Most decisions need exact arithmetic.
pub(crate) fn lattice(side: usize) -> HullDefinition {
    let mut random = crate::scenes::Random::new(5);
    let mut points = Vec::new();
    for x in 0..side {
        for y in 0..side {
            for z in [0, side - 1] {
                let [x, y, z] = [x, y, z].map(|i| i as f64 / (side - 1) as f64 * 2.0 - 1.0);
                for [x, y, z] in [[x, y, z], [y, z, x], [z, x, y]] {
                    points.push([x, y, z].map(|c| c + 1e-16 * random.signed()));
                }
            }
        }
    }
    plain(points)
}
