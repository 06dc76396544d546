//! Builds requests.

use std::collections::HashMap;

use hullcast_proto::{Output, QueryContactsRequest};

use crate::HullId;

/// A scene of bodies and the pairs to query, as a request.
///
/// A body is a registered hull at a pose. The request is a public field. Fields without a method here, such as
/// `accuracy`, `warm_starts`, `worlds`, `groups`, `margins`, `linear_velocities` and `time_step`, are set in it;
/// `QueryContactsRequest` describes them.
///
/// ```
/// use hullcast_client::{Hull, Scene};
/// use hullcast_client::proto::Output;
///
/// let tetrahedron = Hull::new([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
/// let mut scene = Scene::new(0.01);
/// let ground = scene.add_body(tetrahedron.id(), [0.0; 3], [0.0, 0.0, 0.0, 1.0]);
/// let other = scene.add_body(tetrahedron.id(), [0.3, 0.3, 0.3], [0.0, 0.0, 0.0, 1.0]);
/// scene.add_pair(ground, other);
/// scene.set_outputs(&[Output::Normal, Output::Points]);
/// assert_eq!(scene.request.pairs, [0, 1]);
/// assert_eq!(scene.request.hull_ids.len(), 1);
/// ```
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// The request for this scene.
    pub request: QueryContactsRequest,
    /// The index of each hull in `request.hull_ids`.
    places: HashMap<HullId, u32>,
}

impl Scene {
    /// A scene without bodies. Two hulls whose distance is at most `margin` count as a contact. The margin is a
    /// length in the caller's unit, at least 0.
    pub fn new(margin: f64) -> Self {
        let request = QueryContactsRequest { margin, ..QueryContactsRequest::default() };
        Self { request, places: HashMap::new() }
    }

    /// Adds a body and returns its index.
    ///
    /// `position` is the world position of the origin of the hull's frame, in the caller's unit of length.
    /// `rotation` is the quaternion x, y, z, w that rotates the hull's frame to the world's; the server
    /// normalises it.
    pub fn add_body(&mut self, hull: HullId, position: [f64; 3], rotation: [f64; 4]) -> u32 {
        let Self { request, places } = self;
        let place = *places.entry(hull).or_insert_with(|| {
            request.hull_ids.push(hull.0.to_vec());
            request.hull_ids.len() as u32 - 1
        });
        request.body_hulls.push(place);
        request.positions.extend(position);
        request.rotations.extend(rotation);
        request.body_hulls.len() as u32 - 1
    }

    /// Adds the pair of the bodies with indices `a` and `b` to the pairs of a query. The contact normal points
    /// from `a` to `b`. The request of a search ([`Client::find`](crate::Client::find)) has no pairs.
    pub fn add_pair(&mut self, a: u32, b: u32) {
        self.request.pairs.extend([a, b]);
    }

    /// Chooses the columns of the answer. Without this call they are those of ALPHA, NORMAL and POINTS.
    pub fn set_outputs(&mut self, outputs: &[Output]) {
        self.request.outputs = outputs.iter().map(|&output| output as i32).collect();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a hull that is listed twice, which a server refuses, and a body that gets another one's hull.
    #[test]
    fn each_hull_is_listed_once() {
        let [one, two] = [HullId([1; 32]), HullId([2; 32])];
        let mut scene = Scene::new(0.5);
        let bodies: Vec<u32> = [one, two, one]
            .iter()
            .map(|&hull| scene.add_body(hull, [0.0; 3], [0.0, 0.0, 0.0, 1.0]))
            .collect();
        assert_eq!(bodies, [0, 1, 2]);
        assert_eq!(scene.request.hull_ids, [one.0.to_vec(), two.0.to_vec()]);
        assert_eq!(scene.request.body_hulls, [0, 1, 0]);
        assert_eq!((scene.request.positions.len(), scene.request.rotations.len()), (9, 12));
    }
}
