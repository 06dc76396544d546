//! parry3d's convex polyhedra and cuboids, in single and in double precision.
//!
//! The benchmark calls directly the function that parry3d's dispatcher would call. The types are known
//! at compile time, and buffers are reused. No user can call parry3d in a faster way.

/// The number of pairs that a pass answered with points.
type Touching = usize;

/// The time of an answer is that of the fastest of this many calls, as in `lab tradeoff`.
const ROUNDS: usize = 3;

macro_rules! peer {
    ($module:ident, $parry:ident, $real:ty) => {
        /// parry3d in one precision.
        pub mod $module {
            use $parry::math::{Pose3, Rot3, Vector};
            use $parry::query::details::{contact_manifold_cuboid_cuboid, contact_manifold_pfm_pfm};
            use $parry::query::{ContactManifold, TrackedContact};
            use $parry::shape::{ConvexPolyhedron, Cuboid};

            use super::{ROUNDS, Touching};
            use crate::cells::{Cell, HullPose, MARGIN, PosedPair};
            use crate::peer_files::{PeerAnswer, PeerContact, QuestionPair};

            type Manifold = ContactManifold<(), ()>;

            /// A shape of parry3d.
            pub trait Shape: Sized {
                /// The shape of a hull's points; `None` if parry3d refuses them.
                fn build(points: &[[f64; 3]]) -> Option<Self>;

                /// Computes the contact manifold; `relative` maps B's frame to A's.
                fn contact(relative: &Pose3, a: &Self, b: &Self, margin: $real, manifold: &mut Manifold);
            }

            impl Shape for ConvexPolyhedron {
                fn build(points: &[[f64; 3]]) -> Option<Self> {
                    let points: Vec<Vector> =
                        points.iter().map(|p| Vector::from_array(p.map(|c| c as $real))).collect();
                    Self::from_convex_hull(&points)
                }

                fn contact(relative: &Pose3, a: &Self, b: &Self, margin: $real, manifold: &mut Manifold) {
                    contact_manifold_pfm_pfm(relative, a, 0.0, None, b, 0.0, None, margin, manifold);
                }
            }

            impl Shape for Cuboid {
                /// `None` unless the points are the eight corners at plus and minus the half extents, to
                /// rounding.
                fn build(points: &[[f64; 3]]) -> Option<Self> {
                    let half = points.first()?.map(f64::abs);
                    let near = |p: &[f64; 3]| (0..3).all(|i| (p[i].abs() - half[i]).abs() < 1e-12 * half[i]);
                    let boxed = points.len() == 8 && points.iter().all(near);
                    boxed.then(|| Self::new(Vector::from_array(half.map(|c| c as $real))))
                }

                fn contact(relative: &Pose3, a: &Self, b: &Self, margin: $real, manifold: &mut Manifold) {
                    contact_manifold_cuboid_cuboid(relative, a, b, margin, manifold);
                }
            }

            /// The shapes and pairs of a cell.
            pub struct ParryPairs<S> {
                hulls: Vec<S>,
                /// For each pair the hulls, the poses in the cell, and the poses in the moved cell.
                pairs: Vec<([usize; 2], [[Pose3; 2]; 2])>,
                phase: usize,
                manifolds: Vec<Manifold>,
            }

            /// Builds a hull from its points.
            pub fn build(points: &[[f64; 3]]) -> Option<ConvexPolyhedron> {
                ConvexPolyhedron::build(points)
            }

            fn pose(pose: &HullPose) -> Pose3 {
                let [x, y, z] = pose.position.map(|c| c as $real);
                let [i, j, k, w] = pose.rotation.map(|c| c as $real);
                Pose3::from_parts(Vector::new(x, y, z), Rot3::from_xyzw(i, j, k, w).normalize())
            }

            impl<S: Shape> ParryPairs<S> {
                /// The shapes of a cell; `None` if parry3d refuses a hull.
                pub fn new(cell: &Cell, moved: &Cell) -> Option<Self> {
                    let poses = |pair: &PosedPair| [0, 1].map(|side| pose(&pair.poses[side]));
                    let pairs = cell.pairs.iter().zip(&moved.pairs);
                    let pairs = pairs.map(|(pair, moved)| (pair.hulls, [poses(pair), poses(moved)]));
                    let manifolds = cell.pairs.iter().map(|_| ContactManifold::new()).collect();
                    let hulls = cell.hulls.iter().map(|points| S::build(points)).collect::<Option<_>>()?;
                    Some(Self { hulls, pairs: pairs.collect(), phase: 0, manifolds })
                }

                /// Computes every pair without a warm start.
                pub fn cold(&mut self) -> Touching {
                    let mut touching = 0;
                    let manifold = &mut self.manifolds[0];
                    for (hulls, poses) in &self.pairs {
                        manifold.clear();
                        manifold.local_n1 = Vector::ZERO;
                        contact(&self.hulls, *hulls, &poses[0], manifold);
                        touching += usize::from(!manifold.points.is_empty());
                    }
                    touching
                }

                /// Computes every pair at its other pose, from its manifold of the previous pass.
                pub fn warm(&mut self) -> Touching {
                    self.phase ^= 1;
                    let mut touching = 0;
                    for ((hulls, poses), manifold) in self.pairs.iter().zip(&mut self.manifolds) {
                        contact(&self.hulls, *hulls, &poses[self.phase], manifold);
                        touching += usize::from(!manifold.points.is_empty());
                    }
                    touching
                }
            }

            fn contact<S: Shape>(
                hulls: &[S],
                [a, b]: [usize; 2],
                poses: &[Pose3; 2],
                manifold: &mut Manifold,
            ) {
                S::contact(&poses[0].inv_mul(&poses[1]), &hulls[a], &hulls[b], MARGIN as $real, manifold);
            }

            /// The shapes of hulls from their points; `None` if parry3d refuses one.
            pub fn built(hulls: &[Vec<[f64; 3]>]) -> Option<Vec<ConvexPolyhedron>> {
                hulls.iter().map(|points| build(points)).collect()
            }

            /// Answers one pair without a warm start, and again with B nudged.
            pub fn answer(hulls: &[ConvexPolyhedron], pair: &QuestionPair, margin: f64) -> PeerAnswer {
                let [a, b] = pair.hulls.map(|hull| &hulls[hull]);
                let mut manifold = Manifold::new();
                let mut nanoseconds = f64::INFINITY;
                let poses = [at(&pair.a), at(&pair.b)];
                for _ in 0..ROUNDS {
                    let begin = std::time::Instant::now();
                    from_nothing(&poses, a, b, margin, &mut manifold);
                    nanoseconds = nanoseconds.min(begin.elapsed().as_secs_f64() * 1e9);
                }
                let contact = found(&poses, &manifold);
                let poses = [poses[0], at(&pair.nudged)];
                from_nothing(&poses, a, b, margin, &mut manifold);
                PeerAnswer { nanoseconds, contact, nudged: found(&poses, &manifold) }
            }

            fn at(&[x, y, z, i, j, k, w]: &[f64; 7]) -> Pose3 {
                pose(&HullPose { position: [x, y, z], rotation: [i, j, k, w] })
            }

            fn from_nothing(
                poses: &[Pose3; 2],
                a: &ConvexPolyhedron,
                b: &ConvexPolyhedron,
                margin: f64,
                manifold: &mut Manifold,
            ) {
                manifold.clear();
                manifold.local_n1 = Vector::ZERO;
                let relative = std::hint::black_box(poses)[0].inv_mul(&poses[1]);
                ConvexPolyhedron::contact(&relative, a, b, margin as $real, manifold);
            }

            /// The contact in a manifold; `None` if it has no point.
            fn found(poses: &[Pose3; 2], manifold: &Manifold) -> Option<PeerContact> {
                let array = |v: Vector| v.to_array().map(f64::from);
                let deepest = manifold.points.iter().map(|p| f64::from(p.dist)).reduce(f64::min)?;
                let middle = |p: &TrackedContact<()>| {
                    let [a, b] = [poses[0].transform_point(p.local_p1), poses[1].transform_point(p.local_p2)];
                    array((a + b) * 0.5)
                };
                Some(PeerContact {
                    normal: array(poses[0].rotation * manifold.local_n1),
                    separation: deepest,
                    points: manifold.points.iter().map(middle).collect(),
                })
            }

            /// The shapes for hulls of any kind.
            pub type Hulls = ParryPairs<ConvexPolyhedron>;

            /// The shapes that parry3d has for boxes only.
            pub type Cuboids = ParryPairs<Cuboid>;
        }
    };
}

peer!(single, parry3d, f32);
peer!(double, parry3d_f64, f64);
