//! The content of one input: two hulls, and several poses and queries for them.

use hullcast_contact::{Accuracy, ConvexHull, Query, Wanted, Workspace, contact_manifold};
use libfuzzer_sys::arbitrary::{self, Arbitrary, Unstructured};

use crate::bytes::ByteSource;
use crate::poses::PosePair;
use crate::shape::Shape;

/// More iterations than any pair needs.
pub const UNLIMITED: u32 = 1000;

/// Coordinates of at least this size can be rotated without losing bits that matter, even if
/// products of them fall below the normal doubles.
const LEAST_TURNED: f64 = 1e-200;

/// The number of questions per pair of hulls.
const QUESTIONS: usize = 8;

/// Points, which may or may not have a hull.
#[derive(Debug)]
pub struct Cloud(pub Vec<[f64; 3]>);

/// Two hulls, and questions about them.
pub struct PairScene {
    shapes: [Shape; 2],
    pub questions: Vec<Question>,
    /// If set, a power of two: all questions are asked again with everything scaled by it.
    pub scale: Option<f64>,
}

/// The poses of two hulls, and a query about them.
#[derive(Clone, Debug)]
pub struct Question {
    pub poses: PosePair,
    /// The query; its solver is set by the target, which runs both.
    pub query: Query,
    /// A warm start as a client may send it; its indices may not be registered vertices.
    pub odd_warm_start: [u32; 6],
}

impl PairScene {
    pub fn hulls(&self) -> [&ConvexHull; 2] {
        self.shapes.each_ref().map(|shape| &shape.hull)
    }

    /// The scene with all lengths multiplied by `by`. None if the hulls or lengths would leave the
    /// accepted range, or could not be rotated as exactly as before.
    pub fn scaled(&self, by: f64) -> Option<Self> {
        let exact = |x: f64| x == 0.0 || x.abs() >= LEAST_TURNED;
        let length = |x: f64| Some(x * by).filter(|&y| exact(x) && exact(y) && y.is_finite());
        let vector = |v: [f64; 3]| Some([length(v[0])?, length(v[1])?, length(v[2])?]);
        let shape = |shape: &Shape| {
            let contraction_point = match shape.contraction_point {
                Some(p) => Some(vector(p)?),
                None => None,
            };
            Shape::new(shape.points.iter().map(|&p| vector(p)).collect::<Option<_>>()?, contraction_point)
        };
        let question = |q: &Question| {
            let [a, b] = q.poses.positions.map(vector);
            let poses = PosePair { positions: [a?, b?], ..q.poses };
            let margin = if q.query.margin.is_finite() { length(q.query.margin)? } else { f64::INFINITY };
            let within = poses.positions.iter().flatten().all(|x| x.abs() <= 1e100);
            within.then_some(Question { poses, query: Query { margin, ..q.query }, ..*q })
        };
        let [a, b] = self.shapes.each_ref().map(shape);
        let questions = self.questions.iter().map(question).collect::<Option<_>>()?;
        Some(Self { shapes: [a?, b?], questions, scale: None })
    }
}

impl<'a> Arbitrary<'a> for Cloud {
    fn arbitrary(u: &mut Unstructured<'a>) -> arbitrary::Result<Self> {
        Ok(Self(ByteSource::all(u)?.cloud(64)))
    }
}

impl<'a> Arbitrary<'a> for PairScene {
    fn arbitrary(u: &mut Unstructured<'a>) -> arbitrary::Result<Self> {
        let bytes = &mut ByteSource::all(u)?;
        let shapes = [bytes.shape(24), bytes.shape(24)];
        let scale = (bytes.below(8) == 0).then(|| 2f64.powi(i32::from(bytes.byte() as i8)));
        let questions = (0..QUESTIONS).map(|_| bytes.question(shapes.each_ref().map(|s| &s.hull))).collect();
        Ok(Self { shapes, questions, scale })
    }
}

impl ByteSource<'_> {
    fn question(&mut self, hulls: [&ConvexHull; 2]) -> Question {
        let poses = self.poses(hulls);
        let mut query = self.query();
        let size: f64 = hulls.iter().map(|hull| hull.circumradius()).sum();
        query.margin = match self.below(8) {
            0 | 1 => 0.0,
            2 => self.share() * size,
            3 => self.little().abs() * size,
            4 => self.one_of(&[1e-9, 0.01, 1.0]),
            5 => {
                // The separation along the growth normal, off by some ulps.
                let [a, b] = poses.bodies(hulls);
                let open = Query { margin: f64::INFINITY, ..Query::default() };
                let found = contact_manifold(&a, &b, &open, None, &mut Workspace::default()).separation;
                self.nudged(found.max(0.0)).max(0.0)
            }
            _ => f64::INFINITY,
        };
        let odd_warm_start = [(); 6].map(|()| u32::from(self.byte()) * 0x0101_0101 % 29);
        Question { poses, query, odd_warm_start }
    }

    /// A query without a margin.
    fn query(&mut self) -> Query {
        let accuracy = Accuracy {
            relative_tolerance: self.one_of(&[0.0, 0.0, 0.0, 0.0, 1e-9, 1e-3, 0.1, 1.0]),
            feature_angle: self.one_of(&[0.01, 0.01, 0.01, 0.0, 0.1, 0.5]),
            max_points: self.one_of(&[0, 0, 0, 1, 4]),
            max_iterations: self.one_of(&[UNLIMITED, UNLIMITED, UNLIMITED, UNLIMITED, 1, 2, 5]),
            ..Accuracy::default()
        };
        let wanted =
            self.one_of(&[Wanted::Points, Wanted::Points, Wanted::Points, Wanted::Growth, Wanted::Outcome]);
        Query { margin: 0.0, accuracy, wanted }
    }
}

/// Prints everything that is needed to make a test of the scene.
impl std::fmt::Debug for PairScene {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("PairScene")
            .field("points", &self.shapes.each_ref().map(|s| &s.points))
            .field("contraction_points", &self.shapes.each_ref().map(|s| s.contraction_point))
            .field("questions", &self.questions)
            .field("scale", &self.scale)
            .finish()
    }
}
