//! Generated pairs for load tests and benchmarks: families of hulls, in regimes of contact. The same
//! seed gives the same pairs.
//!
//! Half extents are 0.3 to 1. The origin of a hull's frame is its centre of mass, so the default
//! contraction point is the origin to rounding.

use std::f64::consts::TAU;

use glam::{DQuat, DVec3};

use crate::{
    Body, ConvexHull, HullError, InvalidPose, Manifold, Pose, Query, Wanted, Workspace, contact_manifold,
};

/// Number of distinct hulls in a workload.
const HULLS: usize = 32;
/// Each coordinate of the first body's position is within plus and minus this.
const HALF_WORLD: f64 = 5.0;
/// Standard deviation of the offset between the centres of resting faces, along each tangent.
const REST_OFFSET: f64 = 0.03;
/// Largest number of draws for a resting pair. Another draw is needed when small faces miss each other.
const REST_ATTEMPTS: usize = 32;
/// Normals are equal, to rounding, if the sine of the angle between them is below this.
const SAME_DIRECTION: f64 = 1e-9;

/// The shape of the hulls.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Family {
    /// Boxes.
    Box,
    /// 16 points on an ellipsoid.
    Poly16,
    /// 64 points on an ellipsoid.
    Poly64,
    /// 256 points on an ellipsoid.
    Poly256,
}

impl Family {
    /// Every family, in order of the number of vertices.
    pub const ALL: [Self; 4] = [Self::Box, Self::Poly16, Self::Poly64, Self::Poly256];

    /// The name that the command line and the tables use.
    pub fn name(self) -> &'static str {
        match self {
            Self::Box => "box",
            Self::Poly16 => "poly16",
            Self::Poly64 => "poly64",
            Self::Poly256 => "poly256",
        }
    }
}

/// How the two hulls of a pair meet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Regime {
    /// Random orientations, growth scale 0.95 to 0.995.
    Shallow,
    /// A face of B on a face of A with a random spin, gap -0.01 to 0.002.
    Resting,
    /// Random orientations, growth scale 1.02 to 1.5.
    Separated,
}

impl Regime {
    /// Every regime.
    pub const ALL: [Self; 3] = [Self::Shallow, Self::Resting, Self::Separated];

    /// The name that the command line and the tables use.
    pub fn name(self) -> &'static str {
        match self {
            Self::Shallow => "shallow",
            Self::Resting => "resting",
            Self::Separated => "separated",
        }
    }
}

/// Hulls, and pairs of these hulls.
#[derive(Clone, Debug, PartialEq)]
pub struct Workload {
    /// The shape of the hulls.
    pub family: Family,
    /// How the two hulls of each pair meet.
    pub regime: Regime,
    /// Vertices of each hull, in its own frame.
    pub hulls: Vec<Vec<[f64; 3]>>,
    /// The pairs to query.
    pub pairs: Vec<GeneratedPair>,
}

/// Two hulls, each with a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeneratedPair {
    /// The hulls of A and B, as indices into the workload's hulls.
    pub hulls: [usize; 2],
    /// World position of each hull's origin.
    pub positions: [[f64; 3]; 2],
    /// Rotation of each hull, as a quaternion x, y, z, w.
    pub rotations: [[f64; 4]; 2],
}

/// Generation produced a hull or a pose that is not valid, which is a bug of this module.
#[derive(Clone, Debug, PartialEq)]
pub enum WorkloadError {
    /// A generated point cloud has no valid hull.
    Hull(HullError),
    /// A generated pose is not usable.
    Pose(InvalidPose),
}

impl From<HullError> for WorkloadError {
    fn from(error: HullError) -> Self {
        Self::Hull(error)
    }
}

impl From<InvalidPose> for WorkloadError {
    fn from(error: InvalidPose) -> Self {
        Self::Pose(error)
    }
}

impl std::fmt::Display for WorkloadError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Hull(error) => write!(f, "a generated hull is refused: {error}"),
            Self::Pose(error) => write!(f, "a generated pose is refused: {error}"),
        }
    }
}

impl std::error::Error for WorkloadError {}

impl Workload {
    /// Generates `pairs` pairs of the family in the regime.
    ///
    /// # Errors
    /// No error is expected; see [`WorkloadError`].
    pub fn generate(family: Family, regime: Regime, pairs: usize, seed: u64) -> Result<Self, WorkloadError> {
        let mut random = Random::new(seed);
        let mut all = Vec::with_capacity(HULLS);
        for _ in 0..HULLS {
            all.push(Shape::random(family, &mut random)?);
        }
        let mut placer = Placer { workspace: Workspace::default() };
        let mut placed = Vec::with_capacity(pairs);
        for _ in 0..pairs {
            let hulls = [random.below(HULLS), random.below(HULLS)];
            let shapes = hulls.map(|i| &all[i]);
            let rotation_a = random.rotation();
            let (offset, rotation_b) = match regime {
                Regime::Shallow => placer.grown(shapes, rotation_a, [0.95, 0.995], &mut random)?,
                Regime::Separated => placer.grown(shapes, rotation_a, [1.02, 1.5], &mut random)?,
                Regime::Resting => placer.resting(shapes, rotation_a, &mut random)?,
            };
            let position = DVec3::from_array([(); 3].map(|()| random.within(-HALF_WORLD, HALF_WORLD)));
            placed.push(GeneratedPair {
                hulls,
                positions: [position.to_array(), (position + offset).to_array()],
                rotations: [rotation_a.to_array(), rotation_b.to_array()],
            });
        }
        Ok(Self { family, regime, hulls: all.into_iter().map(|s| s.vertices).collect(), pairs: placed })
    }
}

/// A hull whose origin is its centre of mass.
struct Shape {
    vertices: Vec<[f64; 3]>,
    hull: ConvexHull,
}

impl Shape {
    fn random(family: Family, random: &mut Random) -> Result<Self, HullError> {
        let half_extents = DVec3::from_array([(); 3].map(|()| random.within(0.3, 1.0)));
        let points: Vec<DVec3> = match family {
            Family::Box => (0..8).map(|corner| half_extents * corner_signs(corner)).collect(),
            Family::Poly16 => random.on_ellipsoid(16, half_extents),
            Family::Poly64 => random.on_ellipsoid(64, half_extents),
            Family::Poly256 => random.on_ellipsoid(256, half_extents),
        };
        let plain: Vec<[f64; 3]> = points.iter().map(|p| p.to_array()).collect();
        let centre = ConvexHull::new(&plain)?.center_of_mass();
        let vertices: Vec<[f64; 3]> = points.iter().map(|&p| (p - centre).to_array()).collect();
        let hull = ConvexHull::new(&vertices)?;
        Ok(Self { vertices, hull })
    }

    /// The mean of a face's corners, and its outward normal; hull frame.
    fn face(&self, face: usize) -> (DVec3, DVec3) {
        let corners = self.hull.face_outline(face);
        let count = corners.len() as f64;
        let sum: DVec3 = corners.map(|v| DVec3::from_array(self.vertices[v as usize])).sum();
        (sum / count, self.hull.face_normal(face))
    }
}

/// The signs of a box's corner: bit 0 of `corner` gives x, bit 1 y, bit 2 z.
fn corner_signs(corner: u32) -> DVec3 {
    let sign = |bit: u32| if corner >> bit & 1 == 0 { -1.0 } else { 1.0 };
    DVec3::new(sign(0), sign(1), sign(2))
}

/// Places pairs: computes B's offset from A and B's rotation.
struct Placer {
    workspace: Workspace,
}

impl Placer {
    /// A random rotation and direction with a growth scale within `range`. The growth scale is linear in
    /// the offset, so it is measured for a unit offset, and the offset is scaled.
    fn grown(
        &mut self,
        [a, b]: [&Shape; 2],
        rotation_a: DQuat,
        range: [f64; 2],
        random: &mut Random,
    ) -> Result<(DVec3, DQuat), InvalidPose> {
        let rotation_b = random.rotation();
        let direction = random.direction();
        let alpha = self.measure([a, b], [rotation_a, rotation_b], direction)?.alpha;
        Ok((direction * (random.within(range[0], range[1]) / alpha), rotation_b))
    }

    /// Puts a random face of B on a random face of A. Draws again while other features than these two
    /// touch first.
    fn resting(
        &mut self,
        [a, b]: [&Shape; 2],
        rotation_a: DQuat,
        random: &mut Random,
    ) -> Result<(DVec3, DQuat), InvalidPose> {
        let mut placed = face_on_face([a, b], rotation_a, random);
        for _ in 0..REST_ATTEMPTS {
            let manifold = self.measure([a, b], [rotation_a, placed.rotation_b], placed.offset)?;
            if manifold.normal.cross(placed.normal).length() < SAME_DIRECTION {
                break;
            }
            placed = face_on_face([a, b], rotation_a, random);
        }
        Ok((placed.offset, placed.rotation_b))
    }

    /// The answer of step 1 with A at the origin.
    fn measure(
        &mut self,
        [a, b]: [&Shape; 2],
        rotations: [DQuat; 2],
        offset: DVec3,
    ) -> Result<&Manifold, InvalidPose> {
        let body_a = Body::new(&a.hull, Pose::new([0.0; 3], rotations[0].to_array())?);
        let body_b = Body::new(&b.hull, Pose::new(offset.to_array(), rotations[1].to_array())?);
        let query = Query { margin: f64::INFINITY, wanted: Wanted::Growth, ..Query::default() };
        Ok(contact_manifold(&body_a, &body_b, &query, None, &mut self.workspace))
    }
}

/// A placement of B on A.
struct Resting {
    offset: DVec3,
    rotation_b: DQuat,
    /// Normal of A's face, world frame.
    normal: DVec3,
}

fn face_on_face([a, b]: [&Shape; 2], rotation_a: DQuat, random: &mut Random) -> Resting {
    let (centre_a, normal_a) = a.face(random.below(a.hull.face_count()));
    let (centre_b, normal_b) = b.face(random.below(b.hull.face_count()));
    let normal = rotation_a * normal_a;
    let spin = DQuat::from_axis_angle(normal, random.within(0.0, TAU));
    let rotation_b =
        (spin * DQuat::from_rotation_arc(rotation_a * normal_b, -normal) * rotation_a).normalize();
    let (u, v) = normal.any_orthonormal_pair();
    let slide = REST_OFFSET * (random.normal() * u + random.normal() * v);
    let gap = random.within(-0.01, 0.002) * normal;
    let offset = rotation_a * centre_a + slide + gap - rotation_b * centre_b;
    Resting { offset, rotation_b, normal }
}

/// The SplitMix64 generator (G. L. Steele, D. Lea and C. H. Flood, *Fast splittable pseudorandom number
/// generators*, 2014, doi:10.1145/2660193.2660195): small, and identical on every machine.
#[derive(Clone, Debug)]
pub struct Random(u64);

impl Random {
    /// A generator whose sequence depends on the seed only.
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A uniform number in [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// A uniform number in [low, high).
    pub fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// A uniform integer in `0..count`; `count` is at least 1.
    pub fn below(&mut self, count: usize) -> usize {
        ((u128::from(self.bits()) * count as u128) >> 64) as usize
    }

    /// A standard normal number, by the Box-Muller transform.
    pub fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.unit()).ln()).sqrt() * (TAU * self.unit()).cos()
    }

    /// A uniform direction on the unit sphere.
    pub fn direction(&mut self) -> DVec3 {
        let z = self.within(-1.0, 1.0);
        let (sine, cosine) = self.within(0.0, TAU).sin_cos();
        let radius = (1.0 - z * z).sqrt();
        DVec3::new(radius * cosine, radius * sine, z)
    }

    /// A uniform rotation, by Shoemake's method.
    pub fn rotation(&mut self) -> DQuat {
        let share = self.unit();
        let (s1, c1) = self.within(0.0, TAU).sin_cos();
        let (s2, c2) = self.within(0.0, TAU).sin_cos();
        let (p, q) = ((1.0 - share).sqrt(), share.sqrt());
        DQuat::from_xyzw(p * s1, p * c1, q * s2, q * c2)
    }

    fn on_ellipsoid(&mut self, count: usize, half_extents: DVec3) -> Vec<DVec3> {
        (0..count).map(|_| half_extents * self.direction()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Measures every pair's growth scale again, or its gap along the face normal. Catches a workload that
    /// does not match its name.
    #[test]
    fn every_pair_is_of_its_regime() {
        let query = Query { margin: f64::INFINITY, wanted: Wanted::Growth, ..Query::default() };
        let mut workspace = Workspace::default();
        let mut seen = 0;
        for family in Family::ALL {
            for regime in Regime::ALL {
                let workload = Workload::generate(family, regime, 40, 7).unwrap();
                let hulls: Vec<ConvexHull> =
                    workload.hulls.iter().map(|v| ConvexHull::new(v).unwrap()).collect();
                for pair in &workload.pairs {
                    let [a, b] = [0, 1].map(|k| {
                        let pose = Pose::new(pair.positions[k], pair.rotations[k]).unwrap();
                        Body::new(&hulls[pair.hulls[k]], pose)
                    });
                    let m = contact_manifold(&a, &b, &query, None, &mut workspace);
                    let within = match regime {
                        Regime::Shallow => (0.95 - 1e-9..0.995 + 1e-9).contains(&m.alpha),
                        Regime::Separated => (1.02 - 1e-9..1.5 + 1e-9).contains(&m.alpha),
                        Regime::Resting => (-0.01 - 1e-9..0.002 + 1e-9).contains(&m.separation),
                    };
                    assert!(within, "{} {}: {m:?}", family.name(), regime.name());
                    seen += 1;
                }
            }
        }
        assert_eq!(seen, 4 * 3 * 40);
    }

    /// Catches a generator that depends on anything but its seed.
    #[test]
    fn the_seed_decides() {
        let make = |seed| Workload::generate(Family::Poly16, Regime::Resting, 8, seed).unwrap();
        assert_eq!(make(1), make(1));
        assert_ne!(make(1).pairs, make(2).pairs);
        assert_eq!(make(1).hulls.len(), HULLS);
    }
}
