//! The rule of matches, written from its words and without any code of the server.

use hullcast::{
    contact::{ConvexHull, Pose},
    proto::{QueryContactsRequest, QueryContactsResponse},
};

use super::NONE;

/// A scene with its answer.
pub(super) struct Answered<'a> {
    pub(super) request: &'a QueryContactsRequest,
    /// The bodies of each row.
    pub(super) pairs: &'a [u32],
    pub(super) answer: &'a QueryContactsResponse,
}

/// The columns of matches.
#[derive(Debug, PartialEq)]
pub(super) struct Matches {
    pub(super) previous_pairs: Vec<u32>,
    pub(super) previous_points: Vec<u32>,
    pub(super) ended_pairs: Vec<u32>,
}

impl Answered<'_> {
    fn rows(&self) -> usize {
        self.answer.outcomes.len()
    }

    fn pair(&self, row: usize) -> [u32; 2] {
        [self.pairs[2 * row], self.pairs[2 * row + 1]]
    }

    fn goes_on(&self, row: usize) -> bool {
        [1, 3].contains(&self.answer.outcomes[row])
    }

    fn points(&self, row: usize) -> std::ops::Range<usize> {
        let first: u32 = self.answer.point_counts[..row].iter().sum();
        first as usize..(first + self.answer.point_counts[row]) as usize
    }

    fn id(&self, point: usize, swapped: bool) -> [u32; 4] {
        let id: [u32; 4] = self.answer.point_ids[4 * point..][..4].try_into().unwrap();
        if swapped { [id[2], id[3], id[0], id[1]] } else { id }
    }

    /// The witnesses of a point, each in the frame of its body.
    fn local(&self, row: usize, point: usize, swapped: bool) -> [glam::DVec3; 2] {
        let [a, b] = self.pair(row).map(|body| {
            let position = self.request.positions[3 * body as usize..][..3].try_into().unwrap();
            let rotation = self.request.rotations[4 * body as usize..][..4].try_into().unwrap();
            Pose::new(position, rotation).unwrap()
        });
        let vector = |column: &[f64], at: usize| glam::DVec3::from_slice(&column[3 * at..][..3]);
        let on_a = vector(&self.answer.witness_as, point);
        let on_b = on_a + self.answer.distances[point] * vector(&self.answer.normals, row);
        let (on_a, on_b) = (a.local(on_a), b.local(on_b));
        if swapped { [on_b, on_a] } else { [on_a, on_b] }
    }
}

fn length(v: glam::DVec3) -> f64 {
    (v.x * v.x + v.y * v.y + v.z * v.z).sqrt()
}

/// The matches of two answers. `previous_bodies` has the old number of each body, or 2^32 - 1.
pub(super) fn matches(
    before: &Answered<'_>,
    after: &Answered<'_>,
    previous_bodies: &[u32],
    hulls: &[ConvexHull],
) -> Matches {
    let hull = |of: &Answered<'_>, body: u32| of.request.body_hulls[body as usize];
    // A body whose hull changed is new.
    let old_body = |body: u32| {
        let old = previous_bodies[body as usize];
        (old != NONE && hull(before, old) == hull(after, body)).then_some(old)
    };
    let mut used = vec![false; before.rows()];
    let mut goes_on = vec![false; before.rows()];
    let mut matches = Matches { previous_pairs: vec![], previous_points: vec![], ended_pairs: vec![] };
    for row in 0..after.rows() {
        let mut points = vec![NONE; after.points(row).len()];
        let mut previous = NONE;
        let [a, b] = after.pair(row);
        // Equal named pairs match in order, so each old row is used once.
        let olds = old_body(a).zip(old_body(b));
        let same = |old: &usize| {
            let [c, d] = before.pair(*old);
            olds.is_some_and(|olds| olds == (c, d) || olds == (d, c)) && !used[*old]
        };
        if let Some(old) = (0..before.rows()).find(same) {
            used[old] = true;
            let swapped = a != b && olds.map(|olds| olds.0) != Some(before.pair(old)[0]);
            if after.goes_on(row) && before.goes_on(old) {
                previous = old as u32;
                goes_on[old] = true;
                let radius = |body: u32| hulls[hull(after, body) as usize].circumradius();
                let reach = 0.02 * radius(a).min(radius(b));
                match_points(before, after, [old, row], swapped, reach, &mut points);
            }
        }
        matches.previous_pairs.push(previous);
        matches.previous_points.extend(points);
    }
    for row in (0..before.rows()).filter(|&row| before.goes_on(row) && !goes_on[row]) {
        matches.ended_pairs.extend(before.pair(row));
    }
    matches
}

fn match_points(
    before: &Answered<'_>,
    after: &Answered<'_>,
    [old, row]: [usize; 2],
    swapped: bool,
    reach: f64,
    matched: &mut [u32],
) {
    let (old_points, new_points) = (before.points(old), after.points(row));
    let mut taken = vec![false; old_points.len()];
    for (index, matched) in matched.iter_mut().enumerate() {
        let id = after.id(new_points.start + index, false);
        let same = |&old: &usize| !taken[old] && before.id(old_points.start + old, swapped) == id;
        if let Some(old) = (0..taken.len()).find(same) {
            (*matched, taken[old]) = (old as u32, true);
        }
    }
    let mut near = Vec::new();
    for new in (0..matched.len()).filter(|&new| matched[new] == NONE) {
        let here = after.local(row, new_points.start + new, false);
        for other in (0..taken.len()).filter(|&old| !taken[old]) {
            let there = before.local(old, old_points.start + other, swapped);
            let distance = length(here[0] - there[0]).max(length(here[1] - there[1]));
            if distance <= reach {
                near.push((distance, new, other));
            }
        }
    }
    near.sort_by(|one, other| one.0.total_cmp(&other.0).then((one.1, one.2).cmp(&(other.1, other.2))));
    for (_, new, old) in near {
        if matched[new] == NONE && !taken[old] {
            (matched[new], taken[old]) = (old as u32, true);
        }
    }
}
