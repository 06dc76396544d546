//! The pairs that are measured: hulls in contact, in cells of one kind each.

use glam::{DQuat, DVec3};

use crate::Error;
use hullcast_batch::scene_file::SceneFile;
use hullcast_contact::workload::{Family, Random, Regime, Workload};
use hullcast_contact::{Body, ConvexHull, HullOptions, Outcome, Pose, Query, Workspace, contact_manifold};

/// Margin of generated pairs, whose hulls have a size of about 0.3 to 1.
const GENERATED_MARGIN: f64 = 0.005;

/// Range of the growth scales of the pairs that are made up for a scene without contacts.
const SHALLOW: (f64, f64) = (0.95, 0.995);

/// Range of the growth scales of deep pairs.
const DEEP: (f64, f64) = (0.2, 0.8);

/// The pool of a cell; results of a pool are also reported together. Typical contacts form one pool.
/// The other one is of pairs so deep that the least translation belongs to other features.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CellPool {
    All,
    Deep,
}

impl CellPool {
    /// The name in the table.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::All => "all",
            Self::Deep => "deep",
        }
    }
}

/// Pairs of one kind.
#[derive(Clone, Debug)]
pub(super) struct Cell {
    pub(super) name: String,
    pub(super) pool: CellPool,
    pub(super) hulls: Vec<Vec<[f64; 3]>>,
    pub(super) cases: Vec<Case>,
    pub(super) margin: f64,
}

/// A pair, with the pose of B one step earlier and its pose after a tiny movement.
#[derive(Clone, Copy, Debug)]
pub(super) struct Case {
    /// Indices into the cell's hulls.
    pub(super) hulls: [usize; 2],
    pub(super) a: HullPose,
    pub(super) b: HullPose,
    /// The pose of B one step earlier, for warm starts.
    pub(super) before: HullPose,
    /// The pose of B after a tiny movement, for detecting flicker.
    pub(super) nudged: HullPose,
}

/// The pose of a hull's frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct HullPose {
    pub(super) position: DVec3,
    pub(super) rotation: DQuat,
}

impl HullPose {
    fn new(position: [f64; 3], rotation: [f64; 4]) -> Self {
        let rotation = DQuat::from_array(rotation).normalize();
        Self { position: DVec3::from_array(position), rotation }
    }

    /// The pose in the library's type.
    pub(super) fn pose(&self) -> Pose {
        Pose::new(self.position.to_array(), self.rotation.to_array())
            .unwrap_or_else(|e| unreachable!("checked when it was made: {e}"))
    }

    /// The world position of a hull's contraction point.
    fn centre(&self, hull: &ConvexHull) -> DVec3 {
        self.position + self.rotation * hull.contraction_point()
    }

    /// The pose moved by `length` and rotated by `angle` radians, in random directions.
    fn moved(self, length: f64, angle: f64, random: &mut Random) -> Self {
        let turn = DQuat::from_axis_angle(random.direction(), angle);
        Self {
            position: self.position + random.direction() * length,
            rotation: (turn * self.rotation).normalize(),
        }
    }
}

/// Movements of B, as fractions of the hulls' size: the movement of one step, and a tiny one.
const STEP: f64 = 1e-3;
const NUDGE: f64 = 1e-5;

impl Case {
    fn new(hulls: [usize; 2], a: HullPose, b: HullPose, size: f64, random: &mut Random) -> Self {
        let before = b.moved(STEP * size, STEP, random);
        let nudged = b.moved(NUDGE * size, NUDGE, random);
        Self { hulls, a, b, before, nudged }
    }
}

/// Cells of the workload's families: shallow, resting and deep.
pub(super) fn generated(pairs: usize) -> Result<Vec<Cell>, Error> {
    let mut cells = Vec::new();
    for family in Family::ALL {
        for regime in [Regime::Shallow, Regime::Resting] {
            let Workload { hulls, pairs, .. } = Workload::generate(family, regime, pairs, 1)?;
            let mut random = Random::new(2);
            let case = |pair: &hullcast_contact::workload::GeneratedPair| {
                let [a, b] = [0, 1].map(|i| HullPose::new(pair.positions[i], pair.rotations[i]));
                Case::new(pair.hulls, a, b, 1.0, &mut random)
            };
            let cases = pairs.iter().map(case).collect();
            let name = format!("{} {}", family.name(), regime.name());
            cells.push(Cell { name, pool: CellPool::All, hulls, cases, margin: GENERATED_MARGIN });
        }
        cells.push(deep(family, pairs)?);
    }
    Ok(cells)
}

/// Shallow pairs that are moved together along the line of their centres, on which the growth scale is
/// linear.
fn deep(family: Family, pairs: usize) -> Result<Cell, Error> {
    let Workload { hulls, pairs, .. } = Workload::generate(family, Regime::Shallow, pairs, 4)?;
    let built: Vec<ConvexHull> =
        hulls.iter().map(|points| ConvexHull::new(points)).collect::<Result<_, _>>()?;
    let mut random = Random::new(5);
    let mut cases = Vec::new();
    for pair in &pairs {
        let [a, mut b] = [0, 1].map(|i| HullPose::new(pair.positions[i], pair.rotations[i]));
        let Some(scale) = alpha(&built, pair.hulls, a, b, GENERATED_MARGIN) else { continue };
        let [from, to] = [(a, 0), (b, 1)].map(|(at, side)| at.centre(&built[pair.hulls[side]]));
        let share = random.within(DEEP.0, DEEP.1) / scale;
        b.position += (to - from) * (share - 1.0);
        cases.push(Case::new(pair.hulls, a, b, 1.0, &mut random));
    }
    Ok(Cell {
        name: format!("{} deep", family.name()),
        pool: CellPool::Deep,
        hulls,
        cases,
        margin: GENERATED_MARGIN,
    })
}

/// The pairs of a scene file that are in contact, taken evenly over its frames. If there are none,
/// `pairs` random pairs of its hulls are brought into shallow overlap.
pub(super) fn of_scene(scene: &SceneFile, pairs: usize) -> Result<Cell, Error> {
    scene.check_poses()?;
    let hulls: Vec<Vec<[f64; 3]>> = scene.hulls.iter().map(|hull| hull.vertices.clone()).collect();
    let built = hulls.iter().enumerate().map(|(i, points)| {
        ConvexHull::with_options(points, &HullOptions::default())
            .map_err(|e| format!("{}, hulls[{i}]: {e}", scene.name))
    });
    let built: Vec<ConvexHull> = built.collect::<Result<_, _>>()?;
    let mut random = Random::new(3);
    let mut cases = Vec::new();
    for frame in &scene.frames {
        let place = |body: usize| {
            let position = [0, 1, 2].map(|i| frame.positions[3 * body + i]);
            let rotation = [0, 1, 2, 3].map(|i| frame.rotations[4 * body + i]);
            HullPose::new(position, rotation)
        };
        for pair in scene.pairs.chunks_exact(2) {
            let bodies = [pair[0] as usize, pair[1] as usize];
            let shapes = bodies.map(|body| scene.body_hulls[body] as usize);
            let [a, b] = bodies.map(place);
            if alpha(&built, shapes, a, b, scene.margin).is_some() {
                let size = built[shapes[1]].circumradius();
                cases.push(Case::new(shapes, a, b, size, &mut random));
            }
        }
    }
    if cases.is_empty() && !built.is_empty() {
        cases = (0..pairs).filter_map(|_| brought_together(&built, &mut random)).collect();
    }
    let every = cases.len().div_ceil(pairs).max(1);
    let cases = cases.into_iter().step_by(every).collect();
    Ok(Cell { name: scene.name.clone(), pool: CellPool::All, hulls, cases, margin: scene.margin })
}

/// The growth scale of a pair, if it is in contact.
fn alpha(built: &[ConvexHull], shapes: [usize; 2], a: HullPose, b: HullPose, margin: f64) -> Option<f64> {
    let query = Query { margin, ..Query::default() };
    let mut workspace = Workspace::default();
    let bodies = [Body::new(&built[shapes[0]], a.pose()), Body::new(&built[shapes[1]], b.pose())];
    let manifold = contact_manifold(&bodies[0], &bodies[1], &query, None, &mut workspace);
    (manifold.outcome == Outcome::Contact).then_some(manifold.alpha)
}

/// Two random hulls in random orientations, brought into shallow overlap. The growth scale is linear in
/// the offset of the centres, so one query determines where to put B.
fn brought_together(built: &[ConvexHull], random: &mut Random) -> Option<Case> {
    let shapes = [random.below(built.len()), random.below(built.len())];
    let [a, b] = [0, 1].map(|_| HullPose { position: DVec3::ZERO, rotation: random.rotation() });
    let size = built[shapes[0]].circumradius() + built[shapes[1]].circumradius();
    let offset = random.direction() * size;
    let meeting = a.centre(&built[shapes[0]]) - b.centre(&built[shapes[1]]);
    let apart = HullPose { position: meeting + offset, ..b };
    let scale = alpha(built, shapes, a, apart, f64::INFINITY)?;
    let b = HullPose { position: meeting + offset * (random.within(SHALLOW.0, SHALLOW.1) / scale), ..b };
    Some(Case::new(shapes, a, b, size, random))
}
