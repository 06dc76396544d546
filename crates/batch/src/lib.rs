//! Contact manifolds of many pairs, computed on several threads. No network, and no protobuf.
//!
//! [`hullcast_contact`] answers one pair. This crate answers a [`Scene`]: hulls, bodies that are hulls at poses,
//! and pairs of bodies. The answer is a set of [`Columns`], one array per quantity.
//!
//! An example: two cubes, of which one stands on the other and overlaps it by 0.01.
//!
//! ```
//! use std::sync::Arc;
//!
//! use hullcast_batch::{Compute, Engine, Job, Scene, Unlimited, codes::outcome, wait};
//! use hullcast_contact::ConvexHull;
//!
//! let sign = |corner: u32, axis: u32| if corner >> axis & 1 == 0 { -0.5 } else { 0.5 };
//! let corners: Vec<[f64; 3]> = (0..8).map(|i| [sign(i, 0), sign(i, 1), sign(i, 2)]).collect();
//! let scene = Scene {
//!     hulls: vec![Ok(Arc::new(ConvexHull::new(&corners)?))],
//!     body_hulls: vec![0, 0, 0],
//!     positions: vec![0.0, 0.0, 0.0, 0.2, 0.0, 0.99, 9.0, 0.0, 0.0],
//!     rotations: [0.0, 0.0, 0.0, 1.0].repeat(3),
//!     pairs: vec![0, 1, 1, 2],
//!     margin: 0.01,
//!     ..Scene::default()
//! };
//!
//! // One thread per core, answers of at most 64 MiB, and a job that another thread could stop.
//! let engine = Engine::new(Compute::new(0)?, 64 << 20);
//! let job = Job::new(());
//! let batch = scene.clone().batch(&job.stop)?;
//! let (columns, _) = wait(engine.compute(batch, &job, Unlimited, ()))?;
//! assert_eq!(columns.outcomes, [outcome::CONTACT, outcome::SEPARATED]);
//! assert_eq!(columns.point_counts, [4, 0]);
//! assert_eq!(columns.normals[..3], [0.0, 0.0, 1.0]);
//! assert!(columns.distances.iter().all(|distance| (distance + 0.01).abs() < 1e-15));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The pairs need not be known: a [`Finder`] searches the scene for those that may meet.
//!
//! ```
//! # use std::sync::Arc;
//! # use hullcast_batch::{Compute, Engine, Finder, Job, MemoryPool, Scene, broad_phase::Rules, wait};
//! # use hullcast_contact::ConvexHull;
//! # let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
//! # let hull = Arc::new(ConvexHull::new(&corners)?);
//! # let scene = Scene {
//! #     hulls: vec![Ok(hull)],
//! #     body_hulls: vec![0, 0, 0],
//! #     positions: vec![0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 9.0, 0.0, 0.0],
//! #     rotations: [0.0, 0.0, 0.0, 1.0].repeat(3),
//! #     ..Scene::default()
//! # };
//! # let (engine, job) = (Engine::new(Compute::new(0)?, 64 << 20), Job::new(()));
//! let pool = MemoryPool::new(1 << 30);
//! let (bodies, _) = scene.bodies(&job.stop)?;
//! let threads = engine.compute_threads();
//! let mut finder = wait(Finder::new(bodies, Rules::default(), 4096, threads, &job))?;
//! let mut pairs = Vec::new();
//! while let Some(candidates) = wait(finder.next(threads, &job))? {
//!     let batch = finder.batch(candidates);
//!     let (columns, _memory) = wait(engine.compute(batch, &job, pool.memory(), ()))?;
//!     pairs.extend(columns.pairs);
//! }
//! assert_eq!(pairs, [0, 1]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! | module | contents |
//! |---|---|
//! | [`scene`] | scenes, and the checks that make them safe to compute |
//! | [`motion`] | the motion of bodies during a step, and the margins of pairs that follow from it |
//! | [`outputs`], [`columns`], [`codes`] | the parts of an answer that a query can ask for, the table of columns, the numbers in them |
//! | [`engine`], [`Batch`] | computes batches: small ones at once, others in chunks on the compute threads |
//! | [`memory`] | the memory that answers take |
//! | [`compute`] | the compute threads, which callers share by the cost of their work |
//! | [`find`], [`broad_phase`] | finds the pairs of a scene that may meet |
//! | [`steps`], [`matches`] | the steps of a simulation: what an answer takes from the one before, and which points are the same |
//! | [`scene_file`], [`counted`] | scene files, and counts in messages |
//! | [`lock`], [`ById`] | locks whose holders may panic; tables whose keys this process chose |
//!
//! An answer does not depend on the number of threads, nor on how a batch is cut. Work ends early if its
//! [`Job`] is stopped, or if the future that waits for it is dropped.

#![warn(unreachable_pub)]

mod batch;
pub mod broad_phase;
mod by_id;
pub mod codes;
pub mod columns;
pub mod compute;
mod counted;
pub mod engine;
pub mod find;
pub mod lock;
pub mod matches;
pub mod memory;
pub mod motion;
pub mod outputs;
pub mod scene;
pub mod scene_file;
pub mod steps;
mod wait;

pub use batch::Batch;
pub use by_id::{ById, IdHasher};
pub use columns::Columns;
pub use compute::{Compute, Job};
pub use counted::counted;
pub use engine::{Engine, EngineError};
pub use find::Finder;
pub use memory::{Memory, MemoryPool, Unlimited};
pub use motion::{MotionColumns, Motions};
pub use outputs::{Output, Outputs};
pub use scene::{Hulls, Missing, Scene};
pub use wait::wait;
