//! A batch of pairs, and the computation of each pair's answer.

mod chunks;
mod cost;
mod engine;
mod run;

use std::sync::Arc;

pub use engine::{Bounds, Engine};

use self::cost::LEAST_STEPS;
use super::{
    Outputs,
    wire::{Columns, Invalid, Poses, Scene, Setting},
};
use crate::{
    budget::Permit,
    contact::{Basis, Body, Outcome, Workspace, contact_manifold},
    store::{Hulls, Lease},
};

/// A batch that is ready to be computed: checked, with its hulls.
#[derive(Debug)]
pub struct Batch {
    hulls: Arc<Hulls>,
    setting: Arc<Setting>,
    poses: Arc<Poses>,
    /// Pairs that replace the setting's pairs. The answer leaves out those that are SEPARATED.
    candidates: Option<Vec<u32>>,
    /// Empty, or 6 per pair: registered indices of vertices, unchecked.
    warm_starts: Vec<u32>,
    /// The outputs that are kept: all that are sent, and the bases if a stream keeps them.
    kept: Outputs,
    /// The lease on the hulls, released with the answer.
    lease: Option<Arc<Lease>>,
    /// The memory of the scene. None if the batch belongs to no call, or if the call keeps the
    /// memory.
    _memory: Option<Permit>,
}

impl Batch {
    /// A batch of a scene with its hulls, and the indices of the scene's unusable bodies.
    pub fn new(scene: Scene, hulls: Arc<Hulls>) -> (Self, Vec<u32>) {
        let Scene { setting, poses, warm_starts, invalid_bodies, memory, .. } = scene;
        let kept = setting.outputs;
        let poses = Arc::new(poses);
        let batch =
            Self { hulls, setting, poses, candidates: None, warm_starts, kept, lease: None, _memory: memory };
        (batch, invalid_bodies)
    }

    /// A batch of pairs that may meet, 2 indices per pair. Its answer contains those that are not
    /// SEPARATED.
    pub fn of_candidates(
        hulls: Arc<Hulls>,
        setting: Arc<Setting>,
        poses: Arc<Poses>,
        candidates: Vec<u32>,
    ) -> Self {
        let kept = setting.outputs;
        Self {
            hulls,
            setting,
            poses,
            candidates: Some(candidates),
            warm_starts: Vec::new(),
            kept,
            lease: None,
            _memory: None,
        }
    }

    fn pairs(&self) -> &[u32] {
        self.candidates.as_deref().unwrap_or(&self.setting.pairs)
    }

    /// The number of pairs.
    pub fn pair_count(&self) -> usize {
        self.pairs().len() / 2
    }

    /// Keeps the hulls leased until the batch is answered.
    pub fn lease(&mut self, lease: Arc<Lease>) {
        self.lease = Some(lease);
    }

    /// Adds the bases to the columns, even if they are not sent.
    pub fn keep_bases(&mut self) {
        self.kept.bases = true;
    }
}

impl Batch {
    /// Computes pair `pair` and adds it to `columns`. Returns the steps that it took.
    fn pair(&self, pair: usize, workspace: &mut Workspace, columns: &mut Columns) -> u64 {
        let mut invalid = Invalid::default();
        let bodies = [0, 1].map(|side| self.pairs()[2 * pair + side]);
        let [a, b] = bodies.map(|body| self.body(body, &mut invalid));
        match (a, b) {
            (Some(a), Some(b)) => {
                let warm = self.warm_start(pair, &a, &b);
                let manifold = contact_manifold(&a, &b, &self.setting.query, warm.as_ref(), workspace);
                if self.candidates.is_some() {
                    if manifold.outcome == Outcome::Separated {
                        return workspace.take_steps();
                    }
                    columns.push_pair(bodies);
                }
                columns.push(manifold, self.kept);
            }
            _ => columns.push_invalid(invalid, self.kept),
        }
        LEAST_STEPS + workspace.take_steps()
    }

    fn body(&self, index: u32, invalid: &mut Invalid) -> Option<Body<'_>> {
        let index = index as usize;
        let hull = match &self.hulls[self.setting.body_hulls[index] as usize] {
            Ok(hull) => Some(hull),
            Err(missing) => {
                invalid.hull(*missing);
                None
            }
        };
        let pose = self.poses.get(index);
        if pose.is_none() {
            invalid.body();
        }
        Some(Body::new(hull?, pose?))
    }

    /// The pair's basis from an earlier answer, or `None` if it contains indices that are not registered
    /// for these hulls.
    fn warm_start(&self, pair: usize, a: &Body<'_>, b: &Body<'_>) -> Option<Basis> {
        let (bases, _) = self.warm_starts.as_chunks::<6>();
        let &[a0, a1, a2, b0, b1, b2] = bases.get(pair)?;
        let basis = Basis { a: [a0, a1, a2], b: [b0, b1, b2] };
        let of = |vertices: [u32; 3], body: &Body<'_>| {
            vertices.iter().all(|&vertex| (vertex as usize) < body.hull.registered_count())
        };
        (of(basis.a, a) && of(basis.b, b)).then_some(basis)
    }
}
