//! The pairs that are timed: the project's generated families and regimes, as plain numbers that
//! every contender can read.

use hullcast_contact::workload::{Family, Random, Regime, Workload, WorkloadError};

/// Contacts are wanted within this distance, which parry3d calls `prediction`. The hulls' lengths are
/// about 0.3 to 1.
pub const MARGIN: f64 = 0.005;

/// Seed of the generated pairs.
const SEED: u64 = 1;

/// A hull's pose: position and quaternion `x, y, z, w`.
#[derive(Clone, Copy)]
pub struct HullPose {
    pub position: [f64; 3],
    pub rotation: [f64; 4],
}

/// Two hulls and their poses.
#[derive(Clone)]
pub struct PosedPair {
    pub hulls: [usize; 2],
    pub poses: [HullPose; 2],
}

/// A family in a regime.
#[derive(Clone)]
pub struct Cell {
    pub label: String,
    pub hulls: Vec<Vec<[f64; 3]>>,
    pub pairs: Vec<PosedPair>,
}

/// Generates `pairs` pairs of each family in each regime.
///
/// # Errors
/// No error is expected.
pub fn generate(pairs: usize) -> Result<Vec<Cell>, WorkloadError> {
    let kinds = Family::ALL.into_iter().flat_map(|family| Regime::ALL.map(|regime| (family, regime)));
    kinds.map(|(family, regime)| cell(family, regime, pairs)).collect()
}

fn cell(family: Family, regime: Regime, pairs: usize) -> Result<Cell, WorkloadError> {
    let workload = Workload::generate(family, regime, pairs, SEED)?;
    let label = format!("{} {}", family.name(), regime.name());
    let pairs = workload.pairs.iter().map(|pair| {
        let pose = |side| HullPose { position: pair.positions[side], rotation: pair.rotations[side] };
        PosedPair { hulls: pair.hulls, poses: [pose(0), pose(1)] }
    });
    Ok(Cell { label, pairs: pairs.collect(), hulls: workload.hulls })
}

/// Shallow and separated pairs of each family. Each pair has hulls of its own, and together they are
/// so large that no pass finds them in a cache.
///
/// # Errors
/// No error is expected.
pub fn streamed() -> Result<Vec<Cell>, WorkloadError> {
    let kinds = Family::ALL.into_iter().flat_map(|f| [Regime::Shallow, Regime::Separated].map(|r| (f, r)));
    kinds
        .map(|(family, regime)| {
            let pairs = match family {
                Family::Box => 32_000,
                Family::Poly16 => 16_000,
                Family::Poly64 => 4_000,
                Family::Poly256 => 1_000,
            };
            let mut cell = cell(family, regime, pairs)?;
            let hulls = std::mem::take(&mut cell.hulls);
            for pair in &mut cell.pairs {
                let own = pair.hulls.map(|hull| hulls[hull].clone());
                pair.hulls = [cell.hulls.len(), cell.hulls.len() + 1];
                cell.hulls.extend(own);
            }
            Ok(cell)
        })
        .collect()
}

/// `count` points on the unit sphere.
pub fn sphere(count: usize, seed: u64) -> Vec<[f64; 3]> {
    let mut random = Random::new(seed);
    (0..count).map(|_| random.direction().to_array()).collect()
}

impl Cell {
    /// A copy of the cell with the same bodies in the world, whose hulls are turned in their own frames. A box
    /// is then not along the axes of its frame, so hullcast takes the path for all hulls.
    pub fn turned(&self) -> Self {
        let mut cell = self.clone();
        let turn = [0.36, -0.48, 0.64, 0.48];
        let back = [-0.36, 0.48, -0.64, 0.48];
        for point in cell.hulls.iter_mut().flatten() {
            let [x, y, z, _] = multiply(multiply(turn, [point[0], point[1], point[2], 0.0]), back);
            *point = [x, y, z];
        }
        for pose in cell.pairs.iter_mut().flat_map(|pair| &mut pair.poses) {
            pose.rotation = multiply(pose.rotation, back);
        }
        cell
    }

    /// A copy of the cell in which every B is moved by `step` along a direction, and rotated by `step`
    /// radians about it. The direction varies from pair to pair.
    pub fn moved(&self, step: f64) -> Self {
        let mut cell = self.clone();
        for (index, pair) in cell.pairs.iter_mut().enumerate() {
            // The directions are points of a golden-angle spiral: spread over the sphere, not random.
            let z = 1.0 - (2 * index + 1) as f64 / self.pairs.len() as f64;
            let turn = index as f64 * 2.399963229728653;
            let radius = (1.0 - z * z).sqrt();
            let direction = [radius * turn.cos(), radius * turn.sin(), z];
            let pose = &mut pair.poses[1];
            for (coordinate, along) in pose.position.iter_mut().zip(direction) {
                *coordinate += step * along;
            }
            let (sine, cosine) = (step / 2.0).sin_cos();
            let [x, y, z] = direction.map(|c| c * sine);
            pose.rotation = multiply([x, y, z, cosine], pose.rotation);
        }
        cell
    }
}

/// The quaternion of the rotation `q` followed by the rotation `p`, where `q` is the second argument.
fn multiply([px, py, pz, pw]: [f64; 4], [x, y, z, w]: [f64; 4]) -> [f64; 4] {
    [
        pw * x + px * w + py * z - pz * y,
        pw * y - px * z + py * w + pz * x,
        pw * z + px * y - py * x + pz * w,
        pw * w - px * x - py * y - pz * z,
    ]
}
