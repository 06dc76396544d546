//! The bodies that have changed since the message before.

use std::sync::Arc;

use hullcast_contact::{Pose, Stopped, stop::Meter};

use crate::{
    codes::NO_INDEX,
    motion::Motions,
    scene::{Bodies, FaultKind, Hulls, Missing, Poses, SceneError, SceneFault, SceneTemplate},
};

/// The poses of the message before.
#[derive(Debug)]
pub enum FormerPoses {
    /// Those of now, except that these bodies, in ascending order, had these poses.
    Except(Vec<u32>, Poses),
    /// All poses, as the bodies were numbered.
    All(Arc<Poses>),
}

/// The bodies that have changed since the message before, and their former poses.
#[derive(Debug)]
pub struct Changes {
    /// Whether each body has changed. Empty if none has.
    changed: Vec<bool>,
    former: FormerPoses,
}

/// Which hulls of a message were there: for each, the reason why it was missing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Presence(Vec<Option<Missing>>);

impl Presence {
    /// The presence of these hulls.
    pub fn of(hulls: &Hulls) -> Self {
        Self(hulls.iter().map(|hull| hull.as_ref().err().copied()).collect())
    }

    /// The bytes of the list.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.0[..])
    }

    fn get(&self, hull: u32) -> Option<Missing> {
        self.0.get(hull as usize).copied().flatten()
    }
}

impl Changes {
    /// No body has changed.
    pub fn none() -> Self {
        Self { changed: Vec::new(), former: FormerPoses::Except(Vec::new(), Poses::default()) }
    }

    /// These bodies have changed, without former poses.
    #[cfg(test)]
    pub(super) fn of_test(changed: Vec<bool>) -> Self {
        Self { changed, ..Self::none() }
    }

    /// The bodies whose poses or motions have other bits than before. `bodies_now` is empty if the bodies have
    /// the numbers that they had; otherwise it has the number of each old body now, and a body that has no old
    /// number has changed.
    ///
    /// # Errors
    /// The work was stopped.
    pub fn of_poses(
        former: &Arc<Poses>,
        poses: &Poses,
        bodies_now: Option<&[u32]>,
        meter: &Meter<'_>,
    ) -> Result<Self, Stopped> {
        let mut changed = vec![true; poses.count()];
        for old in 0..former.count() {
            meter.spend(3)?;
            let now = bodies_now.map_or(old, |now| now[old] as usize);
            if let Some(changed) = changed.get_mut(now) {
                *changed = !former.is_same(old, poses, now);
            }
        }
        if !changed.contains(&true) {
            changed.clear();
        }
        Ok(Self { changed, former: FormerPoses::All(former.clone()) })
    }

    /// Puts the poses of some bodies into `poses`, and returns the bodies whose poses had other bits. `moved`
    /// are their indices, in ascending order.
    ///
    /// # Errors
    /// An index is too large or not above the one before, there is not one pose for each, or the work was
    /// stopped.
    pub fn of_moved(
        poses: &mut Poses,
        moved: Vec<u32>,
        mut sent: Poses,
        meter: &Meter<'_>,
    ) -> Result<Self, SceneError> {
        let bodies = poses.count();
        let mut changed = vec![false; bodies];
        for (at, &body) in moved.iter().enumerate() {
            meter.spend(5)?;
            let fault = if body as usize >= bodies {
                Some((FaultKind::Index, format!("body index {body} is out of range: the scene has {bodies}")))
            } else if at > 0 && moved[at - 1] >= body {
                let before = moved[at - 1];
                Some((FaultKind::Value, format!("got {body} after {before}, must be strictly ascending")))
            } else {
                None
            };
            if let Some((kind, message)) = fault {
                return Err(SceneFault { kind, field: "moved", index: Some(at), message }.into());
            }
        }
        for (at, &body) in moved.iter().enumerate() {
            meter.spend(5)?;
            changed[body as usize] = poses.exchange(body as usize, &mut sent, at);
        }
        if !changed.contains(&true) {
            changed.clear();
        }
        Ok(Self { changed, former: FormerPoses::Except(moved, sent) })
    }

    /// Adds the bodies that no longer add what they did to the margins of their pairs, because they, or the time
    /// of the step, have changed. The bodies have the numbers that they had.
    ///
    /// # Errors
    /// The work was stopped.
    pub fn add_motions(
        &mut self,
        bodies: usize,
        before: &Motions,
        now: &Motions,
        meter: &Meter<'_>,
    ) -> Result<(), Stopped> {
        if now.is_kept_from(before) {
            return Ok(());
        }
        for body in 0..bodies {
            meter.spend(3)?;
            if !before.is_same(body, now, body) {
                self.add(body, bodies);
            }
        }
        Ok(())
    }

    /// Adds the bodies whose own margins have other bits than before. `bodies_now` has the number of each old body
    /// now.
    ///
    /// # Errors
    /// The work was stopped.
    pub fn add_margins(
        &mut self,
        before: &SceneTemplate,
        now: &SceneTemplate,
        bodies_now: &[u32],
        meter: &Meter<'_>,
    ) -> Result<(), Stopped> {
        if before.margins().is_empty() && now.margins().is_empty() {
            return Ok(());
        }
        let of = |template: &SceneTemplate, body: usize| {
            template.margins().get(body).copied().unwrap_or_default().to_bits()
        };
        for (old, &body) in bodies_now.iter().enumerate() {
            meter.spend(2)?;
            if body != NO_INDEX && of(before, old) != of(now, body as usize) {
                self.add(body as usize, now.body_count());
            }
        }
        Ok(())
    }

    /// Adds a body of `bodies`.
    fn add(&mut self, body: usize, bodies: usize) {
        if self.changed.is_empty() {
            self.changed.resize(bodies, false);
        }
        self.changed[body] = true;
    }

    /// Adds the bodies whose hulls were missing before and are there now, or the other way round. `hull_before`
    /// gives, for a body of now, the presence that its hull had.
    ///
    /// # Errors
    /// The work was stopped.
    pub fn add_presence(
        &mut self,
        template: &SceneTemplate,
        before: &Presence,
        now: &Presence,
        hulls_before: Option<&[u32]>,
        meter: &Meter<'_>,
    ) -> Result<(), Stopped> {
        if hulls_before.is_none() && before == now {
            return Ok(());
        }
        for (body, &hull) in template.body_hulls().iter().enumerate() {
            meter.spend(2)?;
            let hull_before = hulls_before.map_or(hull, |before| before[hull as usize]);
            let same = hull_before != NO_INDEX && before.get(hull_before) == now.get(hull);
            if !same {
                self.add(body, template.body_count());
            }
        }
        Ok(())
    }

    /// Whether a body has changed.
    pub(super) fn has(&self, body: u32) -> bool {
        self.changed.get(body as usize).copied().unwrap_or(false)
    }

    /// The bodies that have changed, in ascending order.
    ///
    /// # Errors
    /// The work was stopped.
    pub fn bodies(&self, meter: &Meter<'_>) -> Result<Vec<u32>, Stopped> {
        meter.spend(self.changed.len() as u64)?;
        let changed = self.changed.iter().zip(0..);
        Ok(changed.filter(|(changed, _)| **changed).map(|(_, body)| body).collect())
    }

    /// Whether no body has changed.
    pub fn is_empty(&self) -> bool {
        self.changed.is_empty()
    }

    /// The pose that a body had. It was numbered `old` and is numbered `now`.
    pub(super) fn former_pose(&self, old: u32, now: u32, bodies: &Bodies) -> Option<Pose> {
        match &self.former {
            FormerPoses::All(poses) => poses.get(old as usize),
            FormerPoses::Except(moved, poses) => match moved.binary_search(&now) {
                Ok(at) => poses.get(at),
                Err(_) => bodies.pose(now),
            },
        }
    }
}

/// The number of each body of the message before, or [`NO_INDEX`], from `previous_bodies`: for each body its
/// number in the message before, or [`NO_INDEX`].
///
/// # Errors
/// There is not one entry per body, an index is too large or listed twice, or the work was stopped.
pub fn bodies_now(
    previous_bodies: &[u32],
    bodies: usize,
    bodies_before: usize,
    meter: &Meter<'_>,
) -> Result<Vec<u32>, SceneError> {
    let field = "previous_bodies";
    crate::scene::has_length(previous_bodies.len(), bodies, field, "none or one per body")?;
    let mut now = vec![NO_INDEX; bodies_before];
    for (body, &before) in previous_bodies.iter().enumerate() {
        meter.spend(3)?;
        if before == NO_INDEX {
            continue;
        }
        let fault = |kind, message: String| SceneFault { kind, field, index: Some(body), message };
        match now.get_mut(before as usize) {
            Some(place) if *place == NO_INDEX => *place = body as u32,
            Some(place) => {
                let message = format!("body {before} was listed before, for body {place}: list it once");
                return Err(fault(FaultKind::Value, message).into());
            }
            None => {
                let message = format!(
                    "body index {before} is out of range: the message before has {bodies_before} bodies; a new \
                     body has 2^32 - 1"
                );
                return Err(fault(FaultKind::Index, message).into());
            }
        }
    }
    Ok(now)
}
