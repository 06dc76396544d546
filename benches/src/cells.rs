//! What is timed: the project's own generated families and regimes, as plain
//! numbers for every contender.

use hullcast::workload::{Family, Random, Regime, Workload, WorkloadError};

/// Contacts within it are wanted, as `prediction` for parry3d: lengths are some 0.3 to 1.
pub const MARGIN: f64 = 0.005;

/// Of the generated pairs.
const SEED: u64 = 1;

/// Where a hull is: position and quaternion `x, y, z, w`.
#[derive(Clone, Copy)]
pub struct Place {
    pub position: [f64; 3],
    pub rotation: [f64; 4],
}

/// Two hulls and where they are.
#[derive(Clone)]
pub struct Pair {
    pub hulls: [usize; 2],
    pub places: [Place; 2],
}

/// A family in a regime.
#[derive(Clone)]
pub struct Cell {
    pub label: String,
    pub hulls: Vec<Vec<[f64; 3]>>,
    pub pairs: Vec<Pair>,
}

/// So many pairs of each family in each regime.
///
/// # Errors
/// None is expected.
pub fn generate(pairs: usize) -> Result<Vec<Cell>, WorkloadError> {
    let kinds = Family::ALL.into_iter().flat_map(|family| Regime::ALL.map(|regime| (family, regime)));
    kinds.map(|(family, regime)| cell(family, regime, pairs)).collect()
}

fn cell(family: Family, regime: Regime, pairs: usize) -> Result<Cell, WorkloadError> {
    let workload = Workload::generate(family, regime, pairs, SEED)?;
    let label = format!("{} {}", family.name(), regime.name());
    let pairs = workload.pairs.iter().map(|pair| {
        let place = |side| Place { position: pair.positions[side], rotation: pair.rotations[side] };
        Pair { hulls: pair.hulls, places: [place(0), place(1)] }
    });
    Ok(Cell { label, pairs: pairs.collect(), hulls: workload.hulls })
}

/// Shallow and separated pairs of each family, each with hulls of its own, together so
/// large that no pass finds them in a cache.
///
/// # Errors
/// None is expected.
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
    /// The same with every B moved by `step` along, and turned by `step` radians
    /// about, a direction that varies from pair to pair.
    pub fn moved(&self, step: f64) -> Self {
        let mut cell = self.clone();
        for (index, pair) in cell.pairs.iter_mut().enumerate() {
            // Points of a golden-angle spiral: spread over the sphere, no randomness.
            let z = 1.0 - (2 * index + 1) as f64 / self.pairs.len() as f64;
            let turn = index as f64 * 2.399963229728653;
            let radius = (1.0 - z * z).sqrt();
            let direction = [radius * turn.cos(), radius * turn.sin(), z];
            let place = &mut pair.places[1];
            for (coordinate, along) in place.position.iter_mut().zip(direction) {
                *coordinate += step * along;
            }
            let (sine, cosine) = (step / 2.0).sin_cos();
            let [x, y, z] = direction.map(|c| c * sine);
            place.rotation = multiply([x, y, z, cosine], place.rotation);
        }
        cell
    }
}

/// The quaternion that turns as `q` and then as `p`.
fn multiply([px, py, pz, pw]: [f64; 4], [x, y, z, w]: [f64; 4]) -> [f64; 4] {
    [
        pw * x + px * w + py * z - pz * y,
        pw * y - px * z + py * w + pz * x,
        pw * z + px * y - py * x + pz * w,
        pw * w - px * x - py * y - pz * z,
    ]
}
