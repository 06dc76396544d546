//! Requests for generated pairs.

use std::error::Error;

use bytes::Bytes;
use hullcast_client::{Client, Hull};
use hullcast_contact::workload::{Family, Regime, Workload};
use hullcast_contact::{Body, ConvexHull, Pose, Query, Workspace, contact_manifold};
use hullcast_proto::{Output, QueryContactsRequest};
use prost::Message;

use crate::cells::MARGIN;

pub const QUERY: &str = "/hullcast.v1.ContactService/QueryContacts";
pub const STREAM: &str = "/hullcast.v1.ContactService/StreamContacts";

/// Generated pairs, each with two bodies of its own.
pub struct GeneratedBatch {
    pub workload: Workload,
}

impl GeneratedBatch {
    pub fn generate(family: Family, regime: Regime, pairs: usize, seed: u64) -> Result<Self, Box<dyn Error>> {
        Ok(Self { workload: Workload::generate(family, regime, pairs, seed)? })
    }

    /// Registers the hulls with the server.
    pub async fn register(&self, address: &str) -> Result<(), Box<dyn Error>> {
        let hulls: Vec<Hull> = self.workload.hulls.iter().map(|points| Hull::new(points.clone())).collect();
        Client::connect(address).await?.put(&hulls).await?;
        Ok(())
    }

    fn used_hulls(&self) -> Vec<usize> {
        let mut used: Vec<usize> = self.workload.pairs.iter().flat_map(|pair| pair.hulls).collect();
        used.sort_unstable();
        used.dedup();
        used
    }

    /// The points of the hulls that a request names, in the request's order.
    pub fn used(&self) -> Vec<&Vec<[f64; 3]>> {
        self.used_hulls().into_iter().map(|hull| &self.workload.hulls[hull]).collect()
    }

    /// The request for all pairs. It names the hulls that the pairs use.
    pub fn request(&self, outputs: &[Output]) -> QueryContactsRequest {
        let pairs = &self.workload.pairs;
        let used = self.used_hulls();
        let id = |&hull: &usize| Hull::new(self.workload.hulls[hull].clone()).id().0.to_vec();
        let place = |hull| used.partition_point(|&other| other < hull) as u32;
        QueryContactsRequest {
            hull_ids: used.iter().map(id).collect(),
            body_hulls: pairs.iter().flat_map(|pair| pair.hulls.map(place)).collect(),
            positions: pairs.iter().flat_map(|pair| pair.positions).flatten().collect(),
            rotations: pairs.iter().flat_map(|pair| pair.rotations).flatten().collect(),
            pairs: (0..2 * pairs.len() as u32).collect(),
            margin: MARGIN,
            outputs: outputs.iter().map(|&output| output as i32).collect(),
            ..Default::default()
        }
    }

    /// The request as encoded bytes.
    pub fn message(&self, outputs: &[Output]) -> Bytes {
        self.request(outputs).encode_to_vec().into()
    }

    /// A message that inherits all but the poses from the one before it on its stream, as encoded bytes.
    pub fn poses(&self) -> Bytes {
        let QueryContactsRequest { positions, rotations, .. } = self.request(&[]);
        let poses = QueryContactsRequest { inherit: true, positions, rotations, ..Default::default() };
        poses.encode_to_vec().into()
    }

    /// Nanoseconds per pair for whole manifolds in one thread that does nothing else.
    pub fn library(&self) -> Result<f64, Box<dyn Error>> {
        let hulls: Vec<ConvexHull> =
            self.workload.hulls.iter().map(|points| ConvexHull::new(points)).collect::<Result<_, _>>()?;
        let query = Query { margin: MARGIN, ..Query::default() };
        let mut workspace = Workspace::default();
        let mut best = f64::INFINITY;
        for _ in 0..20 {
            let start = std::time::Instant::now();
            for pair in &self.workload.pairs {
                let body = |side: usize| -> Result<Body<'_>, Box<dyn Error>> {
                    let pose = Pose::new(pair.positions[side], pair.rotations[side])?;
                    Ok(Body::new(&hulls[pair.hulls[side]], pose))
                };
                std::hint::black_box(contact_manifold(&body(0)?, &body(1)?, &query, None, &mut workspace));
            }
            best = best.min(start.elapsed().as_nanos() as f64 / self.workload.pairs.len() as f64);
        }
        Ok(best)
    }
}
