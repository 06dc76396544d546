//! The pairs that the tests judge: shapes, poses, and functions that bring a pair to a wanted
//! growth scale or distance.

use std::rc::Rc;

use hullcast_contact::{
    Accuracy, Body, ConvexHull, HullOptions, Manifold, Pose, Query, Solver, Workspace, certificate,
    contact_manifold,
};

use super::oracle::{Exact, Placed};
use super::scene::{Random, box_points, cloud, prism_points, scaled};

/// A hull and the points that it was registered from.
#[derive(Debug)]
pub(crate) struct Shape {
    pub(crate) points: Vec<[f64; 3]>,
    pub(crate) hull: ConvexHull,
}

impl Shape {
    pub(crate) fn new(points: Vec<[f64; 3]>) -> Rc<Self> {
        Self::about(points, None)
    }

    /// A hull with the given contraction point; `None` stands for the centre of mass.
    pub(crate) fn about(points: Vec<[f64; 3]>, contraction_point: Option<[f64; 3]>) -> Rc<Self> {
        Self::built(points, &HullOptions { contraction_point, ..HullOptions::default() })
    }

    /// A hull whose faces are merged with this planarity.
    pub(crate) fn merged(points: Vec<[f64; 3]>, planarity: f64) -> Rc<Self> {
        Self::built(points, &HullOptions { planarity: Some(planarity), ..HullOptions::default() })
    }

    fn built(points: Vec<[f64; 3]>, options: &HullOptions) -> Rc<Self> {
        match ConvexHull::with_options(&points, options) {
            Ok(hull) => Rc::new(Self { points, hull }),
            Err(error) => panic!("{error}: {points:?}"),
        }
    }

    /// A hull with its contraction point at the frame's origin: the centre offset of its bodies is
    /// exact.
    pub(crate) fn centred(points: Vec<[f64; 3]>) -> Rc<Self> {
        Self::about(points, Some([0.0; 3]))
    }

    fn scaled(&self, by: f64) -> Rc<Self> {
        let centre = self.hull.contraction_point().to_array();
        let points = self.points.iter().map(|&p| scaled(p, by)).collect();
        // If the contraction point was the centre of mass, the scaled hull uses its own centre of
        // mass.
        let own = self.hull.contraction_point() == self.hull.center_of_mass();
        Self::about(points, (!own).then(|| scaled(centre, by)))
    }
}

pub(crate) fn cuboid(half: [f64; 3]) -> Rc<Shape> {
    Shape::new(box_points(half))
}

/// A shape of about unit size: a box, a prism, a tetrahedron or a cloud, shifted from its frame's
/// origin.
pub(crate) fn any_shape(random: &mut Random) -> Rc<Shape> {
    let half = [0; 3].map(|_| random.range(0.3, 1.0));
    let away = scaled(random.direction(), random.range(0.0, 0.5));
    loop {
        let points = match random.below(5) {
            0 => return Shape::centred(box_points(half)),
            1 => box_points(half),
            2 => prism_points(3 + random.below(12), half[0], half[1]),
            3 => cloud(random, 4, half),
            _ => {
                let count = 5 + random.below(40);
                cloud(random, count, half)
            }
        };
        let points: Vec<[f64; 3]> = points.iter().map(|p| std::array::from_fn(|k| p[k] + away[k])).collect();
        // Four points may be nearly flat; flat hulls belong to the rows of the aspect ratio.
        if ConvexHull::new(&points).is_ok_and(|hull| hull.inradius() > 0.05 * hull.circumradius()) {
            return Shape::new(points);
        }
    }
}

/// Two bodies and the parameters of the query.
#[derive(Clone)]
pub(crate) struct Case {
    pub(crate) shapes: [Rc<Shape>; 2],
    pub(crate) positions: [[f64; 3]; 2],
    pub(crate) rotations: [[f64; 4]; 2],
    pub(crate) relative_tolerance: f64,
    pub(crate) max_iterations: u32,
    /// Outcomes are checked at these margins, and always at 0.
    pub(crate) margins: Vec<f64>,
    /// This scene at another scale. Its alpha must have the same bits.
    pub(crate) twin: Option<Box<Case>>,
    /// The contact must have at least this many points.
    pub(crate) least_points: usize,
}

impl Case {
    pub(crate) fn new(shapes: [Rc<Shape>; 2], d: [f64; 3], rotations: [[f64; 4]; 2]) -> Self {
        let Accuracy { relative_tolerance, max_iterations, .. } = Accuracy::default();
        Self {
            shapes,
            positions: [[0.0; 3], d],
            rotations,
            relative_tolerance,
            max_iterations,
            margins: Vec::new(),
            twin: None,
            least_points: 1,
        }
    }

    /// Random rotations and a random direction of the centre offset; the growth scale is `alpha`,
    /// to rounding.
    pub(crate) fn aimed(random: &mut Random, shapes: [Rc<Shape>; 2], alpha: f64) -> Self {
        let rotations = [random.rotation(), random.rotation()];
        let direction = random.direction();
        Self::along(shapes, direction, rotations, alpha)
    }

    /// The centre offset lies along `direction`; the growth scale is `alpha`, to rounding.
    pub(crate) fn along(
        shapes: [Rc<Shape>; 2],
        direction: [f64; 3],
        rotations: [[f64; 4]; 2],
        alpha: f64,
    ) -> Self {
        let reach: f64 = shapes.iter().map(|s| s.hull.circumradius()).sum();
        let mut case = Self::new(shapes, [0.0; 3], rotations);
        let centre =
            |side: usize, case: &Self| case.body(side).map(|b| b.hull.contraction_point().to_array());
        let turned = [0, 1].map(|side| rotate(rotations[side], centre(side, &case).expect("a pose")));
        let place = |by: f64| std::array::from_fn(|k| by * direction[k] - turned[1][k] + turned[0][k]);
        case.positions[1] = place(reach);
        let found = case.solve(&case.query(f64::INFINITY), &mut Workspace::default());
        case.positions[1] = place(reach * alpha / found.alpha);
        case
    }

    pub(crate) fn body(&self, side: usize) -> Option<Body<'_>> {
        let pose = Pose::new(self.positions[side], self.rotations[side]).ok()?;
        Some(Body::new(&self.shapes[side].hull, pose))
    }

    pub(crate) fn bodies(&self) -> [Body<'_>; 2] {
        [0, 1].map(|side| self.body(side).expect("a pose"))
    }

    pub(crate) fn query(&self, margin: f64) -> Query {
        let accuracy = Accuracy {
            relative_tolerance: self.relative_tolerance,
            max_iterations: self.max_iterations,
            ..Accuracy::default()
        };
        Query { margin, accuracy, ..Query::default() }
    }

    pub(crate) fn solve(&self, query: &Query, workspace: &mut Workspace) -> Manifold {
        let [a, b] = self.bodies();
        contact_manifold(&a, &b, query, None, workspace).clone()
    }

    /// The answer, after checking that its certificate holds.
    pub(crate) fn certified(&self, query: &Query) -> Manifold {
        let [a, b] = self.bodies();
        let m = self.solve(query, &mut Workspace::default());
        certificate::check(&a, &b, query, &m).unwrap_or_else(|v| panic!("{v}\n{m:?}\n{self:?}"));
        m
    }

    /// The certified answers of both solvers.
    pub(crate) fn certified_by_each(&self, query: &Query) -> [Manifold; 2] {
        Solver::ALL.map(|solver| {
            let accuracy = Accuracy { solver, ..query.accuracy };
            self.certified(&Query { accuracy, ..*query })
        })
    }

    pub(crate) fn exact(&self) -> Exact {
        Exact::new([0, 1].map(|side| Placed {
            points: &self.shapes[side].points,
            hull: &self.shapes[side].hull,
            position: self.positions[side],
            rotation: self.rotations[side],
        }))
    }

    /// The scene, `by` times as large.
    pub(crate) fn scaled(&self, by: f64) -> Self {
        Self {
            shapes: self.shapes.each_ref().map(|s| s.scaled(by)),
            positions: self.positions.map(|p| scaled(p, by)),
            ..self.clone()
        }
    }

    /// The scene, translated.
    pub(crate) fn moved(mut self, by: [f64; 3]) -> Self {
        for p in &mut self.positions {
            *p = std::array::from_fn(|k| p[k] + by[k]);
        }
        self
    }

    pub(crate) fn with_margins(mut self, margins: impl IntoIterator<Item = f64>) -> Self {
        self.margins.extend(margins);
        self
    }

    /// Moves B along the shortest connection so that the hulls are `distance` apart. Overlapping
    /// hulls stay as they are.
    pub(crate) fn at_distance(mut self, distance: f64) -> Self {
        // The second step removes the rounding of the first.
        for _ in 0..2 {
            let exact = self.exact();
            let found = exact.distance_squared(exact.support(&exact.d));
            let Some(direction) = found.direction() else { break };
            let by = -found.beyond(distance);
            self.positions[1] = std::array::from_fn(|k| self.positions[1][k] + by * direction[k]);
        }
        self
    }
}

/// The vector rotated by a quaternion of any length.
pub(crate) fn rotate([x, y, z, w]: [f64; 4], v: [f64; 3]) -> [f64; 3] {
    let s = 2.0 / (x * x + y * y + z * z + w * w);
    let rows = [
        [1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
        [s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x)],
        [s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y)],
    ];
    rows.map(|r| r[0] * v[0] + r[1] * v[1] + r[2] * v[2])
}

/// The quaternion of a rotation about `axis` (unit) by `angle` (radians).
pub(crate) fn turn(axis: [f64; 3], angle: f64) -> [f64; 4] {
    let (sin, cos) = (0.5 * angle).sin_cos();
    [axis[0] * sin, axis[1] * sin, axis[2] * sin, cos]
}

pub(crate) fn norm(v: [f64; 3]) -> f64 {
    let size = v.iter().fold(0.0f64, |m, x| m.max(x.abs()));
    if size > 0.0 { size * v.iter().map(|x| (x / size) * (x / size)).sum::<f64>().sqrt() } else { 0.0 }
}

/// Prints everything that is needed to run the case again.
impl std::fmt::Debug for Case {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Case")
            .field("points", &self.shapes.each_ref().map(|s| &s.points))
            .field("contraction", &self.shapes.each_ref().map(|s| s.hull.contraction_point()))
            .field("positions", &self.positions)
            .field("rotations", &self.rotations)
            .field("tolerance", &self.relative_tolerance)
            .field("limit", &self.max_iterations)
            .field("margins", &self.margins)
            .finish()
    }
}
