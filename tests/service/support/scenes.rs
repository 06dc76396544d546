//! Seeded scenes, and the answers that the library gives for them without the server.

use hullcast::{
    contact::{
        Accuracy, Basis, Body, ConvexHull, Derivatives, Element, Feature, KinkScratch, Manifold, Outcome,
        Pose, Query, Solver, Wanted, Workspace, contact_manifold, derivatives,
    },
    proto::{self, Output, QueryContactsRequest, QueryContactsResponse},
    store::{HullDefinition, identity::id_of},
    workload,
};

const NONE: u32 = u32::MAX;

/// The generator of the library, with the draws of the scenes.
pub(crate) struct Random(workload::Random);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(workload::Random::new(seed))
    }

    /// A number in [-1, 1).
    pub(crate) fn signed(&mut self) -> f64 {
        self.0.within(-1.0, 1.0)
    }

    pub(crate) fn below(&mut self, count: usize) -> usize {
        (self.0.bits() % count as u64) as usize
    }

    fn unit<const N: usize>(&mut self) -> [f64; N] {
        loop {
            let v: [f64; N] = std::array::from_fn(|_| self.signed());
            let norm = v.iter().map(|c| c * c).sum::<f64>().sqrt();
            if (0.1..=1.0).contains(&norm) {
                return v.map(|c| c / norm);
            }
        }
    }
}

pub(crate) fn box_points(x: f64, y: f64, z: f64) -> Vec<[f64; 3]> {
    (0..8)
        .map(|i: u32| {
            let sign = |bit: u32| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
            [sign(0) * x, sign(1) * y, sign(2) * z]
        })
        .collect()
}

/// Points on the unit sphere.
pub(crate) fn round_points(count: usize, seed: u64) -> Vec<[f64; 3]> {
    let mut random = Random::new(seed);
    (0..count).map(|_| random.unit()).collect()
}

pub(crate) fn plain(points: Vec<[f64; 3]>) -> HullDefinition {
    HullDefinition { points, ..HullDefinition::default() }
}

/// A cube, a plate, two round hulls, and a box with its own contraction point.
pub(crate) fn shapes() -> Vec<HullDefinition> {
    vec![
        plain(box_points(0.5, 0.5, 0.5)),
        plain(box_points(1.0, 0.7, 0.02)),
        plain(round_points(12, 1)),
        plain(round_points(60, 2)),
        HullDefinition {
            points: box_points(0.4, 0.6, 0.3),
            contraction_point: Some([0.1, -0.2, 0.05]),
            ..HullDefinition::default()
        },
    ]
}

pub(crate) fn wire_hull(definition: &HullDefinition) -> proto::HullDefinition {
    proto::HullDefinition {
        vertices: definition.points.iter().flatten().copied().collect(),
        contraction_point: definition.contraction_point.map_or(vec![], |point| point.to_vec()),
        simplification: definition.simplification.map(|wanted| proto::Simplification {
            max_vertices: wanted.max_vertices,
            max_deviation: wanted.max_deviation,
        }),
        planarity: definition.planarity,
    }
}

pub(crate) fn register_request(definitions: &[HullDefinition]) -> proto::RegisterHullsRequest {
    proto::RegisterHullsRequest { hulls: definitions.iter().map(wire_hull).collect() }
}

pub(crate) fn id(definition: &HullDefinition) -> Vec<u8> {
    id_of(&definition.identity_bytes()).0.to_vec()
}

/// `bodies` of `shapes` at random poses, in a cube so small that about half of the pairs meet, and
/// `pairs` random pairs. Some pairs are of a body with itself, and some are repeated.
pub(crate) fn scene(
    shapes: &[HullDefinition],
    bodies: usize,
    pairs: usize,
    seed: u64,
) -> QueryContactsRequest {
    let mut random = Random::new(seed);
    let mut request = QueryContactsRequest {
        request_id: seed,
        hull_ids: shapes.iter().map(id).collect(),
        margin: 0.05,
        ..Default::default()
    };
    for _ in 0..bodies {
        request.body_hulls.push(random.below(shapes.len()) as u32);
        request.positions.extend([0; 3].map(|_| random.signed()));
        request.rotations.extend(random.unit::<4>());
    }
    for _ in 0..2 * pairs {
        request.pairs.push(random.below(bodies) as u32);
    }
    request
}

/// Two overlapping unit boxes: the smallest valid request.
pub(crate) fn two_boxes() -> (Vec<HullDefinition>, QueryContactsRequest) {
    let shapes = vec![plain(box_points(0.5, 0.5, 0.5))];
    let request = QueryContactsRequest {
        request_id: 7,
        hull_ids: shapes.iter().map(id).collect(),
        body_hulls: vec![0, 0],
        positions: vec![0.0, 0.0, 0.0, 0.1, 0.2, 0.9],
        rotations: vec![0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        pairs: vec![0, 1],
        ..Default::default()
    };
    (shapes, request)
}

/// All outputs of the contract that every method has.
pub(crate) const ALL: [Output; 11] = [
    Output::Outcome,
    Output::Alpha,
    Output::Normal,
    Output::Points,
    Output::WitnessB,
    Output::Features,
    Output::Bases,
    Output::Diagnostics,
    Output::AlphaGradient,
    Output::SeparationGradient,
    Output::NormalJacobian,
];

pub(crate) fn outputs(outputs: &[Output]) -> Vec<i32> {
    outputs.iter().map(|&output| output as i32).collect()
}

/// The answer that the contract specifies, computed pair by pair with the library and without any
/// code of the service. All hulls of the request must be known.
pub(crate) fn expected(request: &QueryContactsRequest, shapes: &[HullDefinition]) -> QueryContactsResponse {
    let hulls: Vec<ConvexHull> = shapes.iter().map(|shape| shape.build(usize::MAX).unwrap()).collect();
    let asked: Vec<Output> = match request.outputs.is_empty() {
        true => vec![Output::Alpha, Output::Normal, Output::Points],
        false => request.outputs.iter().filter_map(|&output| Output::try_from(output).ok()).collect(),
    };
    let query = query(request, &asked);
    let (request_id, contract) = (request.request_id, proto::CONTRACT);
    let mut answer = QueryContactsResponse { request_id, contract, ..Default::default() };
    for body in 0..request.body_hulls.len() {
        if pose(request, body).is_none() {
            answer.invalid_bodies.push(body as u32);
        }
    }
    for (pair, bodies) in request.pairs.chunks(2).enumerate() {
        let [a, b] = [bodies[0] as usize, bodies[1] as usize]
            .map(|body| Some(Body::new(&hulls[request.body_hulls[body] as usize], pose(request, body)?)));
        let (Some(a), Some(b)) = (a, b) else {
            push_invalid(&mut answer, &asked);
            continue;
        };
        let warm = request.warm_starts.chunks(6).nth(pair).and_then(|basis| {
            let known = |vertices: &[u32], body: &Body<'_>| {
                vertices.iter().all(|&vertex| (vertex as usize) < body.hull.registered_count())
            };
            (known(&basis[..3], &a) && known(&basis[3..], &b))
                .then(|| Basis { a: basis[..3].try_into().unwrap(), b: basis[3..].try_into().unwrap() })
        });
        // A new workspace for every pair, so that an answer cannot depend on earlier pairs.
        let mut workspace = Workspace::default();
        let manifold = contact_manifold(&a, &b, &query, warm.as_ref(), &mut workspace);
        push_pair(&mut answer, manifold, &asked);
        if any_points(&asked) {
            push_points(&mut answer, manifold, &asked);
        }
        if any_derivatives(&asked) {
            let found = derivatives(&a, &b, manifold, &mut KinkScratch::default());
            push_derivatives(&mut answer, found.as_ref(), &asked);
        }
    }
    answer
}

fn any_points(asked: &[Output]) -> bool {
    asked.iter().any(|output| matches!(output, Output::Points | Output::WitnessB | Output::Features))
}

fn any_derivatives(asked: &[Output]) -> bool {
    let is_one = |output: &Output| {
        matches!(output, Output::AlphaGradient | Output::SeparationGradient | Output::NormalJacobian)
    };
    asked.iter().any(is_one)
}

fn push_derivatives(answer: &mut QueryContactsResponse, found: Option<&Derivatives>, asked: &[Output]) {
    let has = |output| asked.contains(&output);
    if found.is_some_and(|found| found.kink) {
        *answer.flags.last_mut().unwrap() |= 128;
    }
    answer.gradient_errors.push(found.map_or(f64::NAN, |found| found.error));
    if has(Output::AlphaGradient) {
        answer.alpha_gradients.extend(found.map_or([f64::NAN; 9], |found| found.alpha));
    }
    if has(Output::SeparationGradient) {
        answer.separation_gradients.extend(found.map_or([f64::NAN; 9], |found| found.separation));
    }
    if has(Output::NormalJacobian) {
        let rows = found.map_or([[f64::NAN; 9]; 3], |found| found.normal);
        answer.normal_jacobians.extend(rows.into_iter().flatten());
    }
}

fn push_pair(answer: &mut QueryContactsResponse, manifold: &Manifold, asked: &[Output]) {
    let has = |output| asked.contains(&output);
    answer.outcomes.push(match manifold.outcome {
        Outcome::Contact => 1,
        Outcome::Separated => 2,
        Outcome::Undecided => 3,
    });
    let flags = &manifold.flags;
    let bits = [flags.estimated, flags.coincident, flags.gap_open, flags.reduced];
    answer.flags.push(bits.iter().enumerate().map(|(i, &set)| u8::from(set) << i).sum());
    if has(Output::Alpha) {
        answer.alphas.push(manifold.alpha);
        answer.alpha_lowers.push(manifold.alpha_lower);
        answer.alpha_uppers.push(manifold.alpha_upper);
    }
    if has(Output::Normal) {
        answer.separations.push(manifold.separation);
        answer.normals.extend(manifold.normal.to_array());
    }
    if has(Output::Bases) {
        let none = Basis { a: [NONE; 3], b: [NONE; 3] };
        let basis = manifold.basis.unwrap_or(none);
        answer.bases.extend(basis.a.into_iter().chain(basis.b));
    }
    if has(Output::Diagnostics) {
        answer.iterations.push(manifold.iterations);
        answer.support_calls.push(manifold.support_calls);
        answer.kept_areas.push(manifold.kept_area);
    }
}

fn push_points(answer: &mut QueryContactsResponse, manifold: &Manifold, asked: &[Output]) {
    let has = |output| asked.contains(&output);
    answer.point_counts.push(manifold.points.len() as u32);
    for point in &manifold.points {
        if has(Output::Points) {
            answer.witness_as.extend(point.witness_a.to_array());
            answer.distances.push(point.distance);
        }
        if has(Output::WitnessB) {
            answer.witness_bs.extend((point.witness_a + point.distance * manifold.normal).to_array());
        }
        if has(Output::Features) {
            for element in point.id {
                answer.point_ids.extend(match element {
                    Element::Vertex(vertex) => [vertex, vertex],
                    Element::Edge(ends) => ends,
                    Element::Inside => [NONE, NONE],
                });
            }
        }
    }
    for side in (0..2).filter(|_| has(Output::Features)) {
        let (kind, indices) = match manifold.features.map(|features| features[side]) {
            None => (0, [NONE, NONE]),
            Some(Feature::Vertex(vertex)) => (1, [vertex, NONE]),
            Some(Feature::Edge(ends)) => (2, ends),
            Some(Feature::Face(face)) => (3, [face, NONE]),
        };
        answer.feature_kinds.push(kind);
        answer.feature_indices.extend(indices);
    }
}

fn query(request: &QueryContactsRequest, asked: &[Output]) -> Query {
    let accuracy = request.accuracy.unwrap_or_default();
    Query {
        margin: request.margin,
        accuracy: Accuracy {
            solver: match accuracy.solver() {
                proto::Solver::GjkRayCast => Solver::GjkRayCast,
                _ => Solver::Portal,
            },
            relative_tolerance: accuracy.relative_tolerance,
            feature_angle: accuracy.feature_angle.unwrap_or(0.01),
            max_points: accuracy.max_points,
            ..Accuracy::default()
        },
        wanted: if any_points(asked) {
            Wanted::Points
        } else if [Output::Alpha, Output::Normal, Output::Bases].iter().any(|output| asked.contains(output))
            || any_derivatives(asked)
        {
            Wanted::Growth
        } else {
            Wanted::Outcome
        },
    }
}

fn pose(request: &QueryContactsRequest, body: usize) -> Option<Pose> {
    let position = request.positions[3 * body..][..3].try_into().unwrap();
    let rotation = request.rotations[4 * body..][..4].try_into().unwrap();
    Pose::new(position, rotation).ok()
}

/// Adds the answer for a pair with an unusable body.
fn push_invalid(answer: &mut QueryContactsResponse, asked: &[Output]) {
    let has = |output| asked.contains(&output);
    answer.outcomes.push(4);
    answer.flags.push(64);
    if has(Output::Alpha) {
        answer.alphas.push(f64::NAN);
        answer.alpha_lowers.push(f64::NAN);
        answer.alpha_uppers.push(f64::NAN);
    }
    if has(Output::Normal) {
        answer.separations.push(f64::NAN);
        answer.normals.extend([f64::NAN; 3]);
    }
    if any_points(asked) {
        answer.point_counts.push(0);
    }
    if has(Output::Features) {
        answer.feature_kinds.extend([0, 0]);
        answer.feature_indices.extend([NONE; 4]);
    }
    if has(Output::Bases) {
        answer.bases.extend([NONE; 6]);
    }
    if has(Output::Diagnostics) {
        answer.iterations.push(0);
        answer.support_calls.push(0);
        answer.kept_areas.push(f64::NAN);
    }
    if any_derivatives(asked) {
        push_derivatives(answer, None, asked);
    }
}

/// Appends the answers for further pairs.
pub(crate) fn append(joined: &mut QueryContactsResponse, part: QueryContactsResponse) {
    macro_rules! append {
        ($($column:ident)*) => { $(joined.$column.extend(part.$column);)* };
    }
    hullcast_batch::with_columns!(append);
}

/// Asserts that two messages are equal bit for bit, including NaN and the sign of zero.
#[track_caller]
pub(crate) fn assert_same(found: &QueryContactsResponse, expected: &QueryContactsResponse) {
    use prost::Message;
    if found.encode_to_vec() != expected.encode_to_vec() {
        // The bytes decide; the comparison of the messages shows the column that differs.
        assert_eq!(found, expected);
        panic!("equal except for the sign of a zero or the bits of a NaN");
    }
}
