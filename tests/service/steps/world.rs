//! A random simulation: bodies that move a little, jump, appear and vanish.

use hullcast::{proto::QueryContactsRequest, store::HullDefinition};

use super::{NONE, all_outputs};
use crate::support::scenes::{Random, id};

/// A body of the simulation. Its number in the scene is its place in the list.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct SimulatedBody {
    pub(super) hull: u32,
    pub(super) position: [f64; 3],
    pub(super) rotation: [f64; 4],
    pub(super) world: u32,
    pub(super) group: u32,
    pub(super) margin: f64,
    /// A number that no other body has ever had.
    pub(super) key: u64,
}

pub(super) struct World {
    pub(super) random: Random,
    pub(super) bodies: Vec<SimulatedBody>,
    shapes: Vec<HullDefinition>,
    next_key: u64,
    spread: f64,
    /// The margin that all pairs share.
    margin: f64,
}

/// The way in which a step changes the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Change {
    Nothing,
    Some,
    All,
    Jump,
    BadPose,
    /// Bodies come and go, change their places in the list, or get another hull.
    ComeAndGo,
    /// Bodies get other worlds, groups or margins, or all pairs get another margin.
    Rules,
}

pub(super) const CHANGES: [Change; 7] = [
    Change::Nothing,
    Change::Some,
    Change::All,
    Change::Jump,
    Change::BadPose,
    Change::ComeAndGo,
    Change::Rules,
];

impl Change {
    /// Whether the next message may inherit: bodies, rules and margins are those of before.
    pub(super) fn may_inherit(self) -> bool {
        !matches!(self, Self::ComeAndGo | Self::Rules)
    }
}

impl World {
    pub(super) fn new(shapes: &[HullDefinition], bodies: usize, spread: f64, seed: u64) -> Self {
        let (random, shapes) = (Random::new(seed), shapes.to_vec());
        let mut world = Self { random, bodies: Vec::new(), shapes, next_key: 0, spread, margin: 0.05 };
        for _ in 0..bodies {
            let body = world.new_body();
            world.bodies.push(body);
        }
        world
    }

    pub(super) fn new_body(&mut self) -> SimulatedBody {
        self.next_key += 1;
        let random = &mut self.random;
        SimulatedBody {
            hull: random.below(self.shapes.len()) as u32,
            position: [0; 3].map(|_| self.spread * random.signed()),
            rotation: [0; 4].map(|_| 0.5 + 0.4 * random.signed()),
            world: [0, 0, 0, 1, NONE][random.below(5)],
            group: [0, 0, 0, 1, 2][random.below(5)],
            margin: 0.0,
            key: self.next_key,
        }
    }

    /// Moves a body a little.
    fn nudge(&mut self, body: usize) {
        let random = &mut self.random;
        let body = &mut self.bodies[body];
        body.position.iter_mut().for_each(|x| *x += 0.02 * random.signed());
        body.rotation.iter_mut().for_each(|x| *x += 1e-3 * random.signed());
        if !body.position[0].is_finite() {
            body.position = [0; 3].map(|_| random.signed());
        }
    }

    /// Makes a random change.
    pub(super) fn change(&mut self) -> Change {
        let change = CHANGES[self.random.below(CHANGES.len())];
        let count = self.bodies.len();
        let some = self.random.below(count.max(1));
        match change {
            Change::Nothing => {}
            Change::Some => (0..=count / 10).for_each(|_| {
                let body = self.random.below(count);
                self.nudge(body);
            }),
            Change::All => (0..count).for_each(|body| self.nudge(body)),
            Change::Jump => self.bodies[some].position = [0; 3].map(|_| self.random.signed()),
            Change::BadPose => self.bodies[some].position[0] = f64::NAN,
            Change::Rules => self.change_rules(),
            Change::ComeAndGo => {
                for _ in 0..self.random.below(3) {
                    let gone = self.random.below(self.bodies.len());
                    self.bodies.remove(gone);
                }
                for _ in 0..self.random.below(3) {
                    let (body, at) = (self.new_body(), self.random.below(self.bodies.len()));
                    self.bodies.insert(at, body);
                }
                // Bodies change their places, so that pairs change the order of their bodies.
                let (a, b) = (self.random.below(self.bodies.len()), self.random.below(self.bodies.len()));
                self.bodies.swap(a, b);
                if self.random.below(3) == 0 {
                    let hull = self.random.below(self.shapes.len()) as u32;
                    self.bodies[a].hull = hull;
                }
            }
        }
        change
    }

    /// Changes a rule or margin of some bodies, or the margin of all pairs.
    fn change_rules(&mut self) {
        for _ in 0..=self.random.below(3) {
            let (body, other) = (self.random.below(self.bodies.len()), self.new_body());
            let (world, group) = (other.world, other.group);
            match self.random.below(4) {
                0 => self.bodies[body].world = world,
                1 => self.bodies[body].group = group,
                2 => self.bodies[body].margin = [0.0, 0.02, 0.3][self.random.below(3)],
                _ => self.margin = [0.05, 0.01, 0.2][self.random.below(3)],
            }
        }
    }

    /// The whole scene as a request with `find`.
    pub(super) fn request(&self, request_id: u64) -> QueryContactsRequest {
        QueryContactsRequest {
            request_id,
            find: true,
            hull_ids: self.shapes.iter().map(id).collect(),
            body_hulls: self.bodies.iter().map(|body| body.hull).collect(),
            positions: self.bodies.iter().flat_map(|body| body.position).collect(),
            rotations: self.bodies.iter().flat_map(|body| body.rotation).collect(),
            worlds: self.bodies.iter().map(|body| body.world).collect(),
            groups: self.bodies.iter().map(|body| body.group).collect(),
            ignored_groups: vec![1, 2],
            margin: self.margin,
            margins: self.bodies.iter().map(|body| body.margin).collect(),
            outputs: all_outputs(),
            ..Default::default()
        }
    }

    /// The numbers that the bodies had in an earlier scene.
    pub(super) fn previous_bodies(&self, before: &[SimulatedBody]) -> Vec<u32> {
        let number = |body: &SimulatedBody| before.iter().position(|old| old.key == body.key);
        self.bodies.iter().map(|body| number(body).map_or(NONE, |number| number as u32)).collect()
    }

    /// The bodies with other poses than in an earlier scene of the same bodies.
    pub(super) fn moved(&self, before: &[SimulatedBody]) -> Vec<u32> {
        let bits = |body: &SimulatedBody| (body.position.map(f64::to_bits), body.rotation.map(f64::to_bits));
        let pairs = self.bodies.iter().zip(before).zip(0..);
        pairs.filter(|((now, then), _)| bits(now) != bits(then)).map(|(_, number)| number).collect()
    }

    /// A message that inherits and has the poses of these bodies.
    pub(super) fn moved_request(&self, request_id: u64, moved: Vec<u32>) -> QueryContactsRequest {
        let of = |&body: &u32| &self.bodies[body as usize];
        QueryContactsRequest {
            request_id,
            inherit: true,
            positions: moved.iter().flat_map(|body| of(body).position).collect(),
            rotations: moved.iter().flat_map(|body| of(body).rotation).collect(),
            moved,
            ..Default::default()
        }
    }

    /// A message that inherits and has all poses.
    pub(super) fn poses_request(&self, request_id: u64) -> QueryContactsRequest {
        let all: Vec<u32> = (0..self.bodies.len() as u32).collect();
        QueryContactsRequest { moved: vec![], ..self.moved_request(request_id, all) }
    }
}
