//! The batches of a load run, and the library's answers to them.

use std::collections::HashMap;
use std::path::Path;

use prost::Message;

use crate::cli::Error;
use crate::cli::answer::{definition, request};
use crate::cli::exit::Exit;
use crate::cli::options::QueryOptions;
use crate::cli::progress::Progress;
use crate::cli::scene::{Frame, HullPoints, SceneFile, check_poses};
use crate::cli::values::counted;
use hullcast::batch::columns::{Columns, InvalidPair};
use hullcast::contact::{Body, ConvexHull, KinkScratch, Workspace, contact_manifold, derivatives};
use hullcast::proto;
use hullcast::service::Limits;
use hullcast::service::wire;
use hullcast::store::HullId;
use hullcast::workload::{Family, Regime, Workload};

/// Margin of generated batches, whose hulls have a size of about 0.3 to 1.
const GENERATED_MARGIN: f64 = 0.005;

/// Scenes to query, all with the same hulls.
#[derive(Clone, Debug)]
pub(crate) struct Batches {
    title: String,
    /// One scene per batch; or a single one from a scene file, with one frame per batch.
    scenes: Vec<SceneFile>,
}

/// Requests and their correct answers.
#[derive(Debug)]
pub(crate) struct SampledRequests {
    requests: Vec<proto::QueryContactsRequest>,
    /// The encoded answers, one per request; empty if nothing is checked.
    expected: Vec<Vec<u8>>,
    /// One answer in this many is checked; 0 means none.
    verify: u64,
}

impl Batches {
    /// Batches of the configurations of a scene file. The scene's pairs are repeated until there are
    /// `pairs` of them.
    ///
    /// # Errors
    /// The scene is not valid, or has no pairs.
    pub(crate) fn of_scene(path: &Path, pairs: Option<u32>) -> Result<Self, Error> {
        let mut scene = SceneFile::read("--scene", path)?;
        check_poses(&scene)?;
        if scene.pairs.is_empty() {
            return Err(Exit::Input.error(format!("--scene {}: pairs: is empty", path.display())));
        }
        let count = pairs.map_or(scene.pairs.len() / 2, |n| n as usize);
        scene.pairs = scene.pairs.iter().copied().cycle().take(2 * count).collect();
        let title = format!("{}, {} a batch", scene.name, counted(count, "pair"));
        Ok(Self { title, scenes: vec![scene] })
    }

    /// `count` batches of `pairs` pairs from a generated workload, where each body is in one pair.
    ///
    /// # Errors
    /// No error is expected.
    pub(crate) fn generated(
        family: Family,
        regime: Regime,
        pairs: u32,
        count: u32,
        seed: u64,
    ) -> Result<Self, Error> {
        let all = Workload::generate(family, regime, pairs as usize * count as usize, seed)?;
        let hulls: Vec<HullPoints> = all
            .hulls
            .into_iter()
            .map(|vertices| HullPoints {
                name: String::new(),
                vertices,
                contraction_point: None,
                planarity: None,
            })
            .collect();
        let name = format!("{} {}", family.name(), regime.name());
        let scenes = all.pairs.chunks(pairs as usize).map(|part| SceneFile {
            name: name.clone(),
            hulls: hulls.clone(),
            body_hulls: part.iter().flat_map(|p| p.hulls.map(|h| h as u32)).collect(),
            body_names: vec![String::new(); 2 * part.len()],
            frames: vec![Frame {
                name: String::new(),
                positions: part.iter().flat_map(|p| p.positions.into_iter().flatten()).collect(),
                rotations: part.iter().flat_map(|p| p.rotations.into_iter().flatten()).collect(),
            }],
            pairs: (0..2 * part.len() as u32).collect(),
            margin: GENERATED_MARGIN,
            margins: Vec::new(),
        });
        let scenes = scenes.collect();
        Ok(Self { title: format!("{name}, {} a batch", counted(pairs, "pair")), scenes })
    }

    /// Title for display.
    pub(crate) fn title(&self) -> &str {
        &self.title
    }

    /// The hulls of every batch.
    pub(crate) fn hulls(&self) -> &[HullPoints] {
        self.scenes.first().map_or(&[], |s| &s.hulls)
    }

    /// The margin of the scene, or that of generated batches.
    pub(crate) fn margin(&self) -> f64 {
        self.scenes.first().map_or(GENERATED_MARGIN, |s| s.margin)
    }

    /// The requests. If answers are checked, also the library's own answers.
    ///
    /// # Errors
    /// The library refuses a request.
    pub(crate) fn prepare(
        &self,
        ids: &[HullId],
        options: &QueryOptions,
        verify: u64,
    ) -> Result<SampledRequests, Error> {
        let requests: Vec<_> = self
            .scenes
            .iter()
            .flat_map(|scene| scene.frames.iter().map(move |frame| request(scene, frame, ids, options)))
            .collect();
        let mut expected = Vec::new();
        if verify > 0 {
            let library = Oracle::new(self.hulls(), ids)?;
            let progress = Progress::new("batches computed, to check answers by", requests.len());
            for request in &requests {
                progress.add(1);
                expected.push(library.answer(request.clone())?.encode_to_vec());
            }
        }
        Ok(SampledRequests { requests, expected, verify })
    }
}

impl SampledRequests {
    /// The request of batch `number`. Requests repeat in a cycle.
    pub(crate) fn request(&self, number: u64) -> proto::QueryContactsRequest {
        self.requests[number as usize % self.requests.len()].clone()
    }

    /// Whether the answer to batch `number` equals the library's bit for bit, or `None` if this
    /// answer is not checked.
    pub(crate) fn check(&self, number: u64, response: &proto::QueryContactsResponse) -> Option<bool> {
        if self.verify == 0 || !number.is_multiple_of(self.verify) {
            return None;
        }
        let expected = &self.expected[number as usize % self.expected.len()];
        // The answers are compared as bytes, so that NaN equals NaN and 0.0 does not equal -0.0.
        Some(*expected == response.encode_to_vec())
    }
}

/// The library, called for one pair at a time on one thread.
struct Oracle {
    hulls: HashMap<HullId, ConvexHull>,
}

impl Oracle {
    fn new(points: &[HullPoints], ids: &[HullId]) -> Result<Self, Error> {
        let limit = Limits::default().max_vertices_per_hull as usize;
        let mut hulls = HashMap::new();
        for (points, id) in points.iter().zip(ids) {
            hulls.insert(*id, definition(points).build(limit)?);
        }
        Ok(Self { hulls })
    }

    fn answer(&self, request: proto::QueryContactsRequest) -> Result<proto::QueryContactsResponse, Error> {
        let scene = wire::scene(request, &Limits::default())?;
        let template = &scene.template;
        let body = |index: u32, invalid: &mut InvalidPair| {
            let pose = scene.poses.get(index as usize);
            if pose.is_none() {
                invalid.body();
            }
            let id = &scene.hull_ids[template.body_hulls()[index as usize] as usize];
            Some(Body::new(self.hulls.get(id)?, pose?))
        };
        let (pairs, _) = template.pairs().as_chunks::<2>();
        let mut columns = Columns::default();
        let (mut workspace, mut kinks) = (Workspace::default(), KinkScratch::default());
        for &[a, b] in pairs {
            let mut invalid = InvalidPair::default();
            match (body(a, &mut invalid), body(b, &mut invalid)) {
                (Some(a), Some(b)) => {
                    let manifold = contact_manifold(&a, &b, template.query(), None, &mut workspace);
                    columns.push(manifold, template.outputs());
                    if template.outputs().any_derivatives() {
                        let found = derivatives(&a, &b, manifold, &mut kinks);
                        columns.push_derivatives(found.as_ref(), template.outputs());
                    }
                }
                _ => columns.push_invalid(invalid, template.outputs()),
            }
        }
        Ok(wire::response(scene.request_id, columns, Vec::new(), scene.invalid_bodies))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::answer::Answerer;
    use crate::cli::options::{AccuracyArgs, OutputArg};

    /// Catches a check that passes an answer with one wrong bit, or checks nothing.
    #[tokio::test]
    async fn one_wrong_bit_is_found() {
        let batches = Batches::generated(Family::Poly16, Regime::Resting, 20, 2, 1).unwrap();
        let (answerer, ids) = Answerer::local(batches.hulls(), 1).unwrap();
        let options = AccuracyArgs::default().query_options(0.005, &[OutputArg::Alpha, OutputArg::Points]);
        let sampled = batches.prepare(&ids, &options, 3).unwrap();
        let right = answerer.answer(sampled.request(3)).await.unwrap();
        let mut wrong = right.clone();
        let last = wrong.alphas.last_mut().unwrap();
        *last = last.next_up();
        assert_eq!(right.outcomes.len(), 20);
        assert_eq!(sampled.check(3, &right), Some(true));
        assert_eq!(sampled.check(3, &wrong), Some(false));
        assert_eq!(sampled.check(4, &wrong), None);
    }
}
