//! Checks an answer against its definition, without trusting the solver that found it.
//!
//! The check uses no solver, no Gauss map and none of the frames of the other modules. It goes through
//! all vertices and faces, in the world's axes about A's centre, so each contact point costs time
//! linear in the sizes of both hulls.
//!
//! ```text
//! check(A, B, query, answer):                      with s(n) = n.d - h_K(n), g(n) = n.d / h_K(n)
//!     n is a unit vector
//!     SEPARATED: s(n) >= margin, stated separation <= s(n), alpha_lower <= g(n)
//!     otherwise: alpha_lower <= alpha <= alpha_upper, and the bracket is as narrow as asked
//!                alpha_lower <= g(n)                       the normal proves the lower bound,
//!                sum of the basis' weights <= alpha_upper  and the basis the upper one
//!                stated separation = s(n)
//!                each point: distance >= s(n), both witnesses on their hulls near the support planes
//! ```
//!
//! Each comparison allows for rounding, with the factors in `tolerance`.
//!
//! One property stays unchecked. If the projected features of a CONTACT pair miss each other, nothing
//! here shows that the hulls are within the margin: that needs the distance between the hulls.

use glam::DVec3;

use super::exact::{Dd, Dd3, dd_cross, dd_dot, exponent_above, power_of_two, triple_product};
use super::tolerance::{BAND, BRACKET, EDGE_ON, MERGE, NOISE, SUBNORMAL, U, UNIT_NORMAL};
use super::{Basis, Body, Feature, Manifold, Outcome, Query, Wanted};

/// A property that an answer does not have: `found` exceeds `allowed`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Violation {
    /// The property.
    pub property: &'static str,
    /// The value that violates it, caller's units.
    pub found: f64,
    /// The largest value that the property allows, caller's units.
    pub allowed: f64,
}

impl std::fmt::Display for Violation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {:e}, allowed {:e}", self.property, self.found, self.allowed)
    }
}

impl std::error::Error for Violation {}

/// Checks `manifold` as the answer to `query` for `a` and `b`.
///
/// # Errors
/// The first [`Violation`] found.
pub fn check(a: &Body<'_>, b: &Body<'_>, query: &Query, manifold: &Manifold) -> Result<(), Violation> {
    let scene = Scene::new(a, b, manifold.normal);
    at_most("length of the normal off 1", (manifold.normal.length() - 1.0).abs(), UNIT_NORMAL)?;
    if manifold.outcome == Outcome::Separated {
        return separated(&scene, query, manifold);
    }
    bracket(&scene, query, manifold)?;
    let error = (manifold.separation - scene.separation).abs();
    at_most("separation off that of the normal", error, scene.band())?;
    if query.wanted == Wanted::Points {
        points(&scene, query, manifold)?;
    }
    Ok(())
}

fn at_most(property: &'static str, found: f64, allowed: f64) -> Result<(), Violation> {
    if found <= allowed { Ok(()) } else { Err(Violation { property, found, allowed }) }
}

/// The pair in the world's axes with A's centre as the origin; caller's units.
struct Scene<'a> {
    a: &'a Body<'a>,
    b: &'a Body<'a>,
    d: DVec3,
    /// `d` times a power of two that brings the lengths that enter it near 1. Subnormal lengths would
    /// lose most of their bits when they are rotated.
    ray: DVec3,
    /// The sum of the lengths that enter `d`, times the same power of two.
    ray_m: f64,
    /// The power of two: `d = ray_unit * ray` and `m = ray_unit * ray_m`, to the range of doubles.
    ray_unit: f64,
    m: f64,
    inradius: f64,
    circumradius: f64,
    /// Distances of both bodies from the world's origin: world points are rounded in proportion.
    world: f64,
    normal: DVec3,
    /// Support value of the centred Minkowski difference along the normal.
    reach: f64,
    separation: f64,
}

impl<'a> Scene<'a> {
    fn new(a: &'a Body<'a>, b: &'a Body<'a>, normal: DVec3) -> Self {
        let t = b.pose.translation - a.pose.translation;
        let (ca, cb) = (a.hull.contraction_point(), b.hull.contraction_point());
        let exponent = exponent_above(t.abs().max(ca.abs()).max(cb.abs()).max_element());
        let [ray_unit, up] = [exponent, -exponent].map(power_of_two);
        let [t, ca, cb] = [t, ca, cb].map(|v| v * up);
        let ray = t + (b.pose.rotation * cb - a.pose.rotation * ca);
        let ray_m = t.length() + ca.length() + cb.length();
        let d = ray * ray_unit;
        let highest = |body: &Body<'_>, n: DVec3| {
            (0..body.hull.vertex_count()).map(|v| n.dot(vertex(body, v))).fold(f64::NEG_INFINITY, f64::max)
        };
        let reach = highest(a, normal) + highest(b, -normal);
        Self {
            a,
            b,
            d,
            ray,
            ray_m,
            ray_unit,
            m: ray_m * ray_unit,
            inradius: a.hull.inradius() + b.hull.inradius(),
            circumradius: a.hull.circumradius() + b.hull.circumradius(),
            world: a.pose.translation.length() + b.pose.translation.length(),
            normal,
            reach,
            separation: normal.dot(d) - reach,
        }
    }

    /// The growth scale along the normal. It is a lower bound of alpha, except for rounding.
    fn growth(&self) -> f64 {
        self.normal.dot(self.ray) / self.reach * self.ray_unit
    }

    /// How much a separation may be off by rounding.
    fn band(&self) -> f64 {
        U * (BAND * (self.circumradius + self.d.length()) + NOISE * self.m)
    }
}

/// A vertex relative to its hull's contraction point, world axes.
fn vertex(body: &Body<'_>, v: usize) -> DVec3 {
    body.pose.rotation * (body.hull.vertices()[v] * body.hull.scale())
}

fn separated(scene: &Scene<'_>, query: &Query, manifold: &Manifold) -> Result<(), Violation> {
    at_most("margin of a separated pair", query.margin, scene.separation)?;
    at_most("lower bound of the distance", manifold.separation, scene.separation)?;
    at_most("lower bound of alpha", manifold.alpha_lower, scene.growth() + SUBNORMAL)?;
    let none =
        manifold.points.is_empty() && manifold.basis.is_none() && manifold.alpha_upper == f64::INFINITY;
    at_most("points, basis or upper bound of a separated pair", f64::from(u8::from(!none)), 0.0)
}

fn bracket(scene: &Scene<'_>, query: &Query, manifold: &Manifold) -> Result<(), Violation> {
    let Manifold { alpha, alpha_lower, alpha_upper, flags, .. } = *manifold;
    at_most("lower end of the bracket above alpha", alpha_lower, alpha)?;
    at_most("alpha above the upper end of the bracket", alpha, alpha_upper)?;
    let noise = NOISE * U * scene.ray_m / scene.inradius * scene.ray_unit;
    let tolerance = query.accuracy.relative_tolerance + BRACKET * U * scene.circumradius / scene.inradius;
    if flags.coincident {
        at_most("offset of coincident centres", scene.ray.length(), NOISE * U * scene.ray_m)?;
        return at_most("alpha of coincident centres", alpha, 0.0);
    }
    let growth = scene.growth();
    // A lower bound of 0 needs no proof.
    at_most(
        "lower end of the bracket above what the normal shows",
        alpha_lower,
        growth.max(0.0) + SUBNORMAL,
    )?;
    // A query for the outcome only does not ask for a bracket.
    if flags.gap_open || query.wanted == Wanted::Outcome {
        return Ok(());
    }
    let wide = alpha_upper * tolerance + 2.0 * noise + SUBNORMAL;
    at_most("width of the bracket", alpha_upper - alpha_lower, wide)?;
    at_most("optimality gap of the normal", alpha - growth, alpha * tolerance + noise + SUBNORMAL)?;
    // A solver that stops early may stop before it has a basis. There may also be no basis if the
    // hulls are so thin that the rounding error of alpha is as large as alpha.
    let early = query.accuracy.relative_tolerance > 0.0
        || tolerance >= 1.0
        || manifold.iterations >= query.accuracy.max_iterations;
    let without = if early { 0.0 } else { f64::INFINITY };
    let shown = manifold.basis.as_ref().map_or(without, |basis| shown_upper(scene, basis));
    at_most("what the basis shows above the upper end of the bracket", shown, alpha_upper + SUBNORMAL)
}

/// The upper bound of alpha that a basis proves, without the allowance for noise.
fn shown_upper(scene: &Scene<'_>, basis: &Basis) -> f64 {
    let find = |body: &Body<'_>, registered| {
        body.hull.vertex_of_registered(registered).map(|v| vertex(body, v as usize))
    };
    let corner = |i: usize| Some(find(scene.a, basis.a[i])? - find(scene.b, basis.b[i])?);
    let (Some(u0), Some(u1), Some(u2)) = (corner(0), corner(1), corner(2)) else { return f64::INFINITY };
    // Scale, so that no product of three lengths overflows or underflows. The factors are powers of
    // two, so that a flat triple stays flat.
    let [size, far] =
        [scene.circumradius, scene.ray.abs().max_element()].map(|x| power_of_two(exponent_above(x)));
    let ([u0, u1, u2], d) = ([u0, u1, u2].map(|u| u / size), scene.ray / far);
    let m = scene.ray_m / far;
    let bound = |weights: [f64; 3]| {
        let [l0, l1, l2] = weights.map(|l| l.max(0.0));
        let missing = d - (u0 * l0 + u1 * l1 + u2 * l2);
        let rounding = NOISE * U * (l0 + l1 + l2 + m);
        l0 + l1 + l2 + (missing.length() - rounding).max(0.0) * size / scene.inradius
    };
    // In a thin triple, a weight that should be 0 may be rounded to far below 0. Then two of the
    // points, or one, prove the bound without the rest.
    let [w01, w12, w20] = [[u0, u1], [u1, u2], [u2, u0]].map(|[u, v]| weights_of_two(d, u, v));
    let [w0, w1, w2] = [u0, u1, u2].map(|u| d.dot(u) / u.length_squared());
    let candidates = [
        weights_of_three(d, u0, u1, u2),
        [w01[0], w01[1], 0.0],
        [0.0, w12[0], w12[1]],
        [w20[1], 0.0, w20[0]],
        [w0, 0.0, 0.0],
        [0.0, w1, 0.0],
        [0.0, 0.0, w2],
    ];
    let shown = candidates.map(bound).into_iter().fold(f64::INFINITY, f64::min);
    shown * (far / size) * scene.ray_unit * (1.0 - BRACKET * U)
}

fn wide(v: DVec3) -> Dd3 {
    v.to_array().map(Dd::from)
}

/// Weights whose combination of the three vectors is `d` (Cramer's rule).
fn weights_of_three(d: DVec3, u0: DVec3, u1: DVec3, u2: DVec3) -> [f64; 3] {
    let volume = triple_product(u0, u1, u2);
    [(d, u1, u2), (u0, d, u2), (u0, u1, d)].map(|(a, b, c)| triple_product(a, b, c) / volume)
}

/// Weights whose combination of the two vectors comes nearest to `d`.
fn weights_of_two(d: DVec3, u: DVec3, v: DVec3) -> [f64; 2] {
    let across = dd_cross(wide(u), wide(v));
    let whole = dd_dot(across, across).value();
    let along = |a, b| dd_dot(across, dd_cross(wide(a), wide(b))).value();
    [along(d, v), along(u, d)].map(|x| x / whole)
}

fn points(scene: &Scene<'_>, query: &Query, manifold: &Manifold) -> Result<(), Violation> {
    at_most("answers without a point", f64::from(u8::from(manifold.points.is_empty())), 0.0)?;
    let Some([feature_a, feature_b]) = manifold.features else {
        return at_most("answers without features", 1.0, 0.0);
    };
    let planarity = scene.a.hull.geometric_error() + scene.b.hull.geometric_error();
    let eps = 2.0 * MERGE * U * (scene.circumradius + scene.m) + 4.0 * U * scene.world;
    let sine = query.accuracy.feature_angle.sin();
    // The basis belongs to the features. It lies in the support plane to the tolerance asked for,
    // unless an iteration limit stopped the solver.
    let stopped = manifold.flags.gap_open || manifold.iterations >= query.accuracy.max_iterations;
    let gap = if stopped { f64::INFINITY } else { query.accuracy.relative_tolerance };
    for p in &manifold.points {
        let slack = scene.band() + 2.0 * planarity + eps;
        at_most("separation above the distance of a point", scene.separation - p.distance, slack)?;
        // With an open bracket the basis need not support, and the features need not touch.
        if manifold.flags.estimated || manifold.flags.gap_open {
            continue;
        }
        let from_a = (p.witness_a - scene.a.pose.translation)
            - scene.a.pose.rotation * scene.a.hull.contraction_point();
        let from_b = from_a + p.distance * scene.normal - scene.d;
        for (body, feature, at, n) in
            [(scene.a, feature_a, from_a, scene.normal), (scene.b, feature_b, from_b, -scene.normal)]
        {
            // The witness lies on the face's plane. Vertices of the face may be below this plane by the
            // planarity, which is a longer distance along the contact normal.
            let lifted = planarity / faced(body, feature, n);
            at_most("witness outside its hull", outside(body, at), lifted + eps)?;
            let highest = (0..body.hull.vertex_count())
                .map(|v| n.dot(vertex(body, v)))
                .fold(f64::NEG_INFINITY, f64::max);
            let tilt = if matches!(feature, Feature::Vertex(_)) { 0.0 } else { 2.0 * sine };
            let below = 2.0 * body.hull.circumradius() * tilt + gap * scene.reach + planarity + eps;
            at_most("witness below the support plane", highest - n.dot(at), below)?;
        }
    }
    Ok(())
}

/// Cosine of the angle between a touched face and the contact plane. It is below 1 if the face is
/// tilted within the feature angle, or if the query allowed an inaccurate normal. It is clamped,
/// because a face that is seen edge-on is replaced by its two ends.
fn faced(body: &Body<'_>, feature: Feature, n: DVec3) -> f64 {
    let Feature::Face(f) = feature else { return 1.0 };
    (body.pose.rotation * body.hull.faces()[f as usize].normal).dot(n).clamp(EDGE_ON, 1.0)
}

/// How far a point is outside the planes of the hull's faces.
fn outside(body: &Body<'_>, at: DVec3) -> f64 {
    let (hull, own) = (body.hull, body.pose.rotation.transpose() * at);
    let planes = hull.faces().iter().map(|face| (face.normal, face.offset));
    planes.map(|(m, offset)| m.dot(own) - offset * hull.scale()).fold(f64::NEG_INFINITY, f64::max)
}
