//! Measures one setting on one cell: the time and the errors of every pair.

use std::{hint::black_box, time::Instant};

use glam::DVec3;

use super::cases::{Case, Cell, HullPose};
use super::patch::{area, convex, hausdorff};
use super::peer_files::{PeerAnswer, PeerContact};
use super::settings::{CENTRES, Centre, SIMPLIFICATIONS, Setting};
use super::truth::WorldPair;
use crate::Error;
use hullcast_contact::{
    Basis, Body, ConvexHull, Flags, HullOptions, Manifold, Outcome, Query, Workspace, contact_manifold,
};

/// The time of a pair is that of the fastest of this many calls, which leaves out disturbances by other
/// work of the machine.
const ROUNDS: usize = 3;

/// Nanoseconds per second.
const NANO: f64 = 1e9;

/// A patch jumps if a movement of 1e-5 of the size moves it by more than this fraction of the size.
const JUMP: f64 = 0.01;

/// A cell with its hulls built in every way, and the true answers for its pairs.
pub(super) struct Prepared {
    pub(super) cell: Cell,
    /// The hulls, by centre and then by simplification.
    hulls: Vec<Vec<Vec<ConvexHull>>>,
    /// The true answers, by centre.
    truths: Vec<Vec<Truth>>,
    /// For each overlapping pair the depth and direction of the least translation.
    least_translations: Vec<Option<(f64, DVec3)>>,
}

/// The true answer for a pair with one choice of centres.
struct Truth {
    /// The growth scale, inside a certified bracket at rounding level.
    alpha: f64,
    normal: DVec3,
    patch: Vec<DVec3>,
    area: f64,
}

/// The measurements of one pair.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    pub(super) nanoseconds: f64,
    /// Width of the bracket, relative to alpha, or `None` for another library.
    pub(super) gap: Option<f64>,
    /// Fraction of the whole hulls' alpha that the normal does not prove. This value and the next two are
    /// none if another library finds no contact.
    pub(super) optimality: Option<f64>,
    /// Radians between the normal and an optimal one.
    pub(super) angle: Option<f64>,
    /// Error of the separation relative to the hulls' size. The true separation is that of the whole
    /// hulls along the same normal.
    pub(super) separation: Option<f64>,
    /// Depth divided by that of the least translation, if the pair overlaps.
    pub(super) depth: Option<f64>,
    /// Radians between the normal and the direction of the least translation, if the pair overlaps.
    pub(super) axis: Option<f64>,
    /// Hausdorff distance of the patch from the whole one, relative to the hulls' size.
    pub(super) hausdorff: f64,
    /// Area of the patch divided by that of the whole one, if that has an area.
    pub(super) area: Option<f64>,
    /// Whether the pair is not in contact, or has a flag other than the one for dropped points.
    pub(super) flagged: bool,
    pub(super) flickers: bool,
}

impl Prepared {
    /// Builds every hull in every way.
    ///
    /// # Errors
    /// The points of a hull are refused.
    pub(super) fn new(cell: Cell) -> Result<Self, Error> {
        let plain = |points: &Vec<[f64; 3]>| ConvexHull::new(points);
        let plain: Vec<ConvexHull> = cell.hulls.iter().map(plain).collect::<Result<_, _>>()?;
        let mut hulls = Vec::new();
        for centre in CENTRES {
            let mut of_centre = Vec::new();
            for simplification in SIMPLIFICATIONS {
                let setting = Setting { simplification, centre, ..Setting::DEFAULT };
                let built = cell.hulls.iter().zip(&plain).map(|(points, whole)| {
                    let options = HullOptions {
                        contraction_point: contraction_point(whole, centre),
                        simplification: setting.simplified(whole.circumradius()),
                        ..HullOptions::default()
                    };
                    ConvexHull::with_options(points, &options)
                });
                of_centre.push(built.collect::<Result<Vec<_>, _>>()?);
            }
            hulls.push(of_centre);
        }
        let truth = |hulls: &Vec<Vec<ConvexHull>>| -> Vec<Truth> {
            cell.cases.iter().map(|case| Truth::new(&hulls[0], case, cell.margin)).collect()
        };
        let truths: Vec<Vec<Truth>> = hulls.iter().map(truth).collect();
        let least = cell.cases.iter().zip(&truths[0]).map(|(case, truth)| {
            let pair = WorldPair::new(&plain[case.hulls[0]], &plain[case.hulls[1]], case);
            (truth.alpha < 1.0).then(|| pair.least_translation())
        });
        let least_translations = least.collect();
        Ok(Self { hulls, truths, least_translations, cell })
    }

    /// Measures every pair with the setting.
    pub(super) fn measure(&self, setting: &Setting) -> Vec<Sample> {
        let centre = CENTRES.iter().position(|&centre| centre == setting.centre).unwrap_or(0);
        let level = SIMPLIFICATIONS.iter().position(|&level| level == setting.simplification).unwrap_or(0);
        let hulls = &self.hulls[centre][level];
        let query = Query { margin: self.cell.margin, accuracy: setting.accuracy(), ..Query::default() };
        let mut workspace = Workspace::default();
        let mut answer = |case: &Case, b: &HullPose, warm: Option<&Basis>| -> (Manifold, f64) {
            let bodies =
                [Body::new(&hulls[case.hulls[0]], case.a.pose()), Body::new(&hulls[case.hulls[1]], b.pose())];
            let mut nanoseconds = f64::INFINITY;
            let mut manifold = Manifold::default();
            for _ in 0..ROUNDS {
                let begin = Instant::now();
                let found = contact_manifold(&bodies[0], &bodies[1], black_box(&query), warm, &mut workspace);
                nanoseconds = nanoseconds.min(begin.elapsed().as_secs_f64() * NANO);
                manifold.clone_from(found);
            }
            (manifold, nanoseconds)
        };
        let sample = |(i, case): (usize, &Case)| {
            let before = setting.warm.then(|| answer(case, &case.before, None).0.basis).flatten();
            let (manifold, nanoseconds) = answer(case, &case.b, before.as_ref());
            let (nudged, _) = answer(case, &case.nudged, before.as_ref());
            let found =
                Found { normal: manifold.normal, separation: manifold.separation, patch: polygon(&manifold) };
            Sample {
                nanoseconds,
                gap: Some((manifold.alpha_upper - manifold.alpha_lower) / manifold.alpha),
                flagged: Flags { reduced: false, ..manifold.flags } != Flags::default()
                    || manifold.outcome != Outcome::Contact,
                ..self.judged(centre, i, Some(&found), &polygon(&nudged))
            }
        };
        self.cell.cases.iter().enumerate().map(sample).collect()
    }

    /// Judges every answer of another library by the same measures. The true answers are those about the
    /// centres of mass.
    pub(super) fn judge(&self, answers: &[PeerAnswer]) -> Vec<Sample> {
        let found = |contact: &PeerContact| {
            let normal = DVec3::from_array(contact.normal);
            Found { normal, separation: contact.separation, patch: convex(&contact.positions(), normal) }
        };
        let sample = |(i, answer): (usize, &PeerAnswer)| {
            let nudged = answer.nudged.as_ref().map(|contact| found(contact).patch);
            let here = answer.contact.as_ref().map(found);
            let judged = self.judged(0, i, here.as_ref(), &nudged.unwrap_or_default());
            Sample { nanoseconds: answer.nanoseconds, ..judged }
        };
        answers.iter().enumerate().map(sample).collect()
    }

    /// Compares an answer for case `i` with the true answer for one choice of centres. Leaves out time, gap
    /// and flags.
    fn judged(&self, centre: usize, i: usize, found: Option<&Found>, nudged: &[DVec3]) -> Sample {
        let (case, truth) = (&self.cell.cases[i], &self.truths[centre][i]);
        let [a, b] = case.hulls.map(|hull| &self.hulls[centre][0][hull]);
        let pair = WorldPair::new(a, b, case);
        let patch = found.map_or(&[][..], |found| &found.patch);
        let spanned = found.map_or(0.0, |found| area(patch, found.normal));
        let least = self.least_translations[i];
        let angle = |m: DVec3, n: DVec3| m.cross(n).length().atan2(m.dot(n));
        let off = |found: &Found| (found.separation - pair.separation(found.normal)).abs() / pair.size;
        Sample {
            nanoseconds: f64::NAN,
            gap: None,
            optimality: found.map(|found| (1.0 - pair.proven(found.normal) / truth.alpha).max(0.0)),
            angle: found.map(|found| angle(found.normal, truth.normal)),
            separation: found.map(off),
            depth: found.and_then(|found| least.map(|(depth, _)| -found.separation / depth)),
            axis: found.and_then(|found| least.map(|(_, axis)| angle(found.normal, axis))),
            hausdorff: hausdorff(patch, &truth.patch) / pair.size,
            area: (truth.area > 0.0).then(|| spanned / truth.area),
            flagged: found.is_none(),
            flickers: hausdorff(patch, nudged) / pair.size > JUMP,
        }
    }
}

/// An answer of this or another library, world frame.
struct Found {
    normal: DVec3,
    separation: f64,
    /// Corners of the patch, in order about the normal.
    patch: Vec<DVec3>,
}

impl Truth {
    fn new(hulls: &[ConvexHull], case: &Case, margin: f64) -> Self {
        let bodies =
            [(0, &case.a), (1, &case.b)].map(|(side, at)| Body::new(&hulls[case.hulls[side]], at.pose()));
        let query = Query { margin, ..Query::default() };
        let mut workspace = Workspace::default();
        let manifold = contact_manifold(&bodies[0], &bodies[1], &query, None, &mut workspace);
        let patch = polygon(manifold);
        let area = area(&patch, manifold.normal);
        Self { alpha: manifold.alpha, normal: manifold.normal, patch, area }
    }
}

/// The patch: the points midway between the witnesses.
fn polygon(manifold: &Manifold) -> Vec<DVec3> {
    let middle = |p: &hullcast_contact::ContactPoint| p.witness_a + manifold.normal * (0.5 * p.distance);
    manifold.points.iter().map(middle).collect()
}

/// The contraction point for a choice of centre, or `None` for the centre of mass.
fn contraction_point(hull: &ConvexHull, centre: Centre) -> Option<[f64; 3]> {
    let at = match centre {
        Centre::Mass => return None,
        Centre::Ball => centre_of_ball(hull),
        Centre::Offset => DVec3::splat(0.5 * hull.unit_inradius() / 3_f64.sqrt()),
    };
    Some((hull.contraction_point() + at * hull.scale()).to_array())
}

/// Approximate centre of the largest ball inside the hull, hull units. The search steps away from the
/// nearest face, with shorter and shorter steps.
fn centre_of_ball(hull: &ConvexHull) -> DVec3 {
    let nearest = |at: DVec3| {
        let depths = hull.faces().iter().map(|face| (face.offset - face.normal.dot(at), face.normal));
        depths.min_by(|(p, _), (q, _)| p.total_cmp(q)).unwrap_or((0.0, DVec3::ZERO))
    };
    let (mut at, mut step) = (DVec3::ZERO, 0.5 * hull.unit_inradius());
    let mut best = (nearest(at).0, at);
    for _ in 0..300 {
        at -= nearest(at).1 * step;
        step *= 0.98;
        if nearest(at).0 > best.0 {
            best = (nearest(at).0, at);
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::super::cases;
    use super::*;

    /// The bounds of growth distance must hold: `r (1 - alpha) <= least translation <= depth`. Catches a
    /// wrong least translation, from an axis left out or one that is not a normal.
    #[test]
    fn least_translations_are_between_their_bounds() {
        let mut overlapping = 0;
        for cell in cases::generated(40).unwrap() {
            let prepared = Prepared::new(cell).unwrap();
            for (i, case) in prepared.cell.cases.iter().enumerate() {
                let Some((least, axis)) = prepared.least_translations[i] else { continue };
                let hulls = &prepared.hulls[0][0];
                let [a, b] = case.hulls.map(|hull| &hulls[hull]);
                let truth = &prepared.truths[0][i];
                let pair = WorldPair::new(a, b, case);
                let (shortest, depth) =
                    ((a.inradius() + b.inradius()) * (1.0 - truth.alpha), -pair.separation(truth.normal));
                assert!((-pair.separation(axis) - least).abs() < 1e-9 * pair.size);
                assert!(least >= shortest * (1.0 - 1e-9), "{least} {shortest}");
                assert!(least <= depth * (1.0 + 1e-5), "{least} {depth}");
                overlapping += 1;
            }
        }
        assert!(overlapping > 200, "{overlapping}");
    }

    /// The default must have no errors, and each coarser knob must show in its own measure. Catches an
    /// error that is reported although there is none, and an error that is missed.
    #[test]
    fn errors_are_seen_where_they_are() {
        let cells = cases::generated(60).unwrap();
        let prepared = Prepared::new(cells.into_iter().nth(4).unwrap()).unwrap();
        let most = |setting: Setting, of: fn(&Sample) -> f64| {
            prepared.measure(&setting).iter().map(of).fold(0.0, f64::max)
        };
        let default = Setting::DEFAULT;
        assert!(most(default, |s| s.gap.unwrap()) < 1e-13);
        assert!(most(default, |s| s.optimality.unwrap()) < 1e-13);
        assert!(most(default, |s| s.separation.unwrap()) < 1e-13);
        assert_eq!(most(default, |s| s.hausdorff), 0.0);
        assert!(most(default, |s| (s.area.unwrap_or(1.0) - 1.0).abs()) == 0.0);
        let coarse = Setting { relative_tolerance: 0.1, ..default };
        assert!(most(coarse, |s| s.gap.unwrap()) > 1e-3 && most(coarse, |s| s.optimality.unwrap()) > 1e-6);
        let few = Setting { max_points: 1, ..default };
        assert!(most(few, |s| s.hausdorff) > 0.01);
        let simple = Setting { simplification: 0.05, ..default };
        assert!(most(simple, |s| s.separation.unwrap()) > 1e-4);
    }

    /// Our own answers, with their corners in another order, must have our own errors, and pairs without an
    /// answer must be flagged, with an infinitely distant patch. Catches another library that is compared
    /// with other true answers than hullcast is, and one that gains by leaving out answers.
    #[test]
    fn a_peer_is_judged_as_we_are() {
        let cell = cases::generated(40).unwrap().swap_remove(1);
        let prepared = Prepared::new(cell).unwrap();
        let contact = |truth: &Truth, case: &Case| -> PeerContact {
            let [a, b] = case.hulls.map(|hull| &prepared.hulls[0][0][hull]);
            let mut points: Vec<[f64; 3]> = truth.patch.iter().map(|p| p.to_array()).collect();
            points.reverse();
            points.extend_from_within(..1);
            let separation = WorldPair::new(a, b, case).separation(truth.normal);
            PeerContact { normal: truth.normal.to_array(), separation, points }
        };
        let both = prepared.truths[0].iter().zip(&prepared.cell.cases);
        let answer = |(i, (truth, case)): (usize, (&Truth, &Case))| {
            let contact = (i > 0).then(|| contact(truth, case));
            PeerAnswer { nanoseconds: 5.0, nudged: None, contact }
        };
        let answers: Vec<PeerAnswer> = both.enumerate().map(answer).collect();
        let samples = prepared.judge(&answers);
        assert!(samples[0].flagged && samples[0].optimality.is_none());
        assert_eq!((samples[0].hausdorff, samples[0].nanoseconds), (f64::INFINITY, 5.0));
        assert!(!samples[0].flickers, "nothing, and nothing");
        let mut areas = 0;
        for sample in &samples[1..] {
            assert!(!sample.flagged && sample.flickers && sample.gap.is_none());
            let errors = [sample.optimality, sample.angle, sample.separation].map(Option::unwrap);
            assert!(errors.iter().all(|&e| e < 1e-12) && sample.hausdorff < 1e-12, "{sample:?}");
            areas += usize::from(sample.area.is_some_and(|ratio| (ratio - 1.0).abs() < 1e-9));
        }
        assert!(areas > 20, "{areas}");
    }
}
