//! Two bodies in one frame.
//!
//! The frame has A's axes and A's contraction point as its origin. Its lengths are in *pair units*, a
//! power of two of the caller's units that brings the larger hull to about 1. Every computation
//! between the poses and the answer happens in this frame, so nothing is computed far from the origin.

use glam::{DMat3, DVec3};

use super::cost::{Count, scan_steps};
use super::support::{Columns, farthest_both};
use super::tolerance::{BAND, BRACKET, MERGE, NOISE, TRIPLE_PRODUCT, U};
use super::{Body, ConvexHull};

/// A vertex of the centred Minkowski difference `K = (A - pA) - (B - pB)`, and the two vertices whose
/// difference it is.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Support {
    /// A's frame, pair units.
    pub(crate) point: DVec3,
    /// Vertex of A; [`Support::INNER`] for a point inside `K`.
    pub(crate) a: u32,
    /// Vertex of B.
    pub(crate) b: u32,
}

impl Support {
    /// Stands in place of a vertex index if the point is not a vertex.
    pub(crate) const INNER: u32 = u32::MAX;

    /// A point of `K` that is not one of its vertices.
    pub(crate) fn inner(point: DVec3) -> Self {
        Self { point, a: Self::INNER, b: Self::INNER }
    }

    /// Whether both points come from the same pair of vertices.
    pub(crate) fn same(&self, other: &Self) -> bool {
        (self.a == other.a) & (self.b == other.b) & (self.a != Self::INNER)
    }
}

/// Two bodies in one frame.
pub(crate) struct Pair<'a> {
    pub(crate) a: &'a ConvexHull,
    pub(crate) b: &'a ConvexHull,
    /// Pair units per hull unit of A and of B: powers of two, the larger one is 1.
    pub(crate) scale_a: f64,
    pub(crate) scale_b: f64,
    /// B's axes in A's frame, without translation or scale.
    pub(crate) rotation: DMat3,
    /// Centre offset `pB - pA`, pair units.
    pub(crate) d: DVec3,
    /// Length of `d`.
    pub(crate) distance: f64,
    /// `d` times a power of two that brings its largest coordinate into [1, 2). Alpha is homogeneous
    /// in `d`, so solving for the ray instead works for however small an alpha.
    pub(crate) ray: DVec3,
    /// `alpha = 2^alpha_exponent` times the growth scale of `ray`.
    pub(crate) alpha_exponent: i32,
    /// `M` of [`tolerance`](super::tolerance): the sum of the lengths that enter `d`, pair units.
    pub(crate) m: f64,
    /// This sum in units of `ray`.
    pub(crate) ray_m: f64,
    /// Sum of the inradii, rounded down; pair units.
    pub(crate) inradius: f64,
    /// Sum of the circumradii, rounded up; pair units.
    pub(crate) circumradius: f64,
    /// A triple product of the ray and two points of `K` whose magnitude exceeds this has the correct
    /// sign in double precision.
    pub(crate) sure_turn: f64,
    /// Caller's units per pair unit, a power of two.
    pub(crate) unit: f64,
    /// Rotation from A's axes to the world's. The origin of the pair's frame is the world point
    /// `translation_a + rotation_a * (contraction point of A)`.
    pub(crate) rotation_a: DMat3,
    pub(crate) translation_a: DVec3,
    /// B's vertices in A's frame, pair units, if B is small.
    turned: Option<&'a Columns>,
    /// The steps counted for this pair so far, without the scans that [`Pair::steps`] adds.
    pub(crate) count: Count,
}

/// A hull with more vertices is not rotated in advance, because the support calls would save less time
/// than the rotation takes.
const MOST_TURNED: usize = 32;

/// The largest exponent of lengths that can be squared and rotated without overflow or underflow.
const SAFE_EXPONENT: i32 = 400;

/// A bound of the length of [`Pair::ray`], whose coordinates are below 2.
const LONGEST_RAY: f64 = 4.0;

impl<'a> Pair<'a> {
    pub(crate) fn new(a: &Body<'a>, b: &Body<'a>) -> Self {
        let (hull_a, hull_b) = (a.hull, b.hull);
        let unit = if hull_a.scale() > hull_b.scale() { hull_a.scale() } else { hull_b.scale() };
        let (scale_a, scale_b) = (hull_a.scale() / unit, hull_b.scale() / unit);
        let (ra, rb) = (a.pose.rotation, b.pose.rotation);

        // d is formed in the world, where the translations are subtracted first. Near the ends of the
        // range of doubles the offsets are scaled, because rotating them there would lose bits.
        let (mut ca, mut cb) = (hull_a.contraction_point(), hull_b.contraction_point());
        let (mut reach_a, mut reach_b) = (hull_a.contraction_distance(), hull_b.contraction_distance());
        let mut t = b.pose.translation - a.pose.translation;
        let mut world = 0;
        if exponent((t.abs() + ca.abs() + cb.abs()).element_sum()).abs() > SAFE_EXPONENT {
            world = exponent(t.abs().max(ca.abs()).max(cb.abs()).max_element());
            [t, ca, cb] = [t, ca, cb].map(|v| shift_vec(v, -world));
            [reach_a, reach_b] = [reach_a, reach_b].map(|x| shift(x, -world));
        }
        let d_scaled = ra.transpose() * (t + (rb * cb - ra * ca));
        let m_scaled = t.length() + reach_a + reach_b;
        let own = exponent(d_scaled.abs().max_element());
        let ray = shift_vec(d_scaled, -own);
        let to_pair = world - exponent(unit);
        let d = shift_vec(d_scaled, to_pair);
        let inradius = (hull_a.unit_inradius() * scale_a + hull_b.unit_inradius() * scale_b).next_down();
        let circumradius =
            (hull_a.unit_circumradius() * scale_a + hull_b.unit_circumradius() * scale_b).next_up();
        Self {
            a: hull_a,
            b: hull_b,
            scale_a,
            scale_b,
            rotation: ra.transpose() * rb,
            d,
            distance: d.length(),
            ray,
            alpha_exponent: to_pair + own,
            m: shift(m_scaled, to_pair),
            ray_m: shift(m_scaled, -own),
            inradius,
            circumradius,
            sure_turn: TRIPLE_PRODUCT * U * LONGEST_RAY * circumradius * circumradius,
            unit,
            rotation_a: ra,
            translation_a: a.pose.translation,
            turned: None,
            count: Count::default(),
        }
    }

    /// Rotates B's vertices into A's frame once for all support calls, if B is small enough for that to
    /// pay.
    pub(crate) fn turn(&mut self, buffer: &'a mut Columns) {
        if self.b.vertex_count() <= MOST_TURNED {
            buffer.turn(self.b.columns(), self.scale_b, &self.rotation);
            self.turned = Some(buffer);
        }
    }

    /// Vertex `i` of A, relative to A's contraction point.
    #[inline]
    pub(crate) fn vertex_a(&self, i: u32) -> DVec3 {
        self.a.vertex(i) * self.scale_a
    }

    /// Vertex `i` of B in A's axes, relative to B's contraction point.
    #[inline]
    pub(crate) fn vertex_b(&self, i: u32) -> DVec3 {
        match self.turned {
            Some(turned) => turned.vertex(i),
            None => self.rotation * (self.b.vertex(i) * self.scale_b),
        }
    }

    /// The vertex of `K` that vertex `a` of A and vertex `b` of B make.
    #[inline]
    pub(crate) fn support_of(&self, a: u32, b: u32) -> Support {
        Support { point: self.vertex_a(a) - self.vertex_b(b), a, b }
    }

    /// The vertex of `K` farthest along `n` (A's frame, any length). Among equals the lowest index wins
    /// in each hull.
    #[inline]
    pub(crate) fn support(&self, n: DVec3) -> Support {
        let (a, b) = match self.turned {
            Some(turned) => farthest_both(self.a.columns(), turned, n),
            None => (
                self.a.counted_support(n, &self.count),
                self.b.counted_support(-self.direction_in_b(n), &self.count),
            ),
        };
        self.support_of(a, b)
    }

    /// The elementary steps taken for this pair, with `support_calls` calls of the support mapping.
    /// Calls that scan all vertices of both hulls are counted here, because each is too short to be
    /// counted when it is made.
    pub(crate) fn steps(&self, support_calls: u32) -> u64 {
        let scan = scan_steps(self.a.vertex_count() + self.b.vertex_count());
        let scans = if self.turned.is_some() { u64::from(support_calls / 2) } else { 0 };
        self.count.steps() + scans * scan
    }

    /// A direction of A's frame, in B's frame.
    #[inline]
    pub(crate) fn direction_in_b(&self, n: DVec3) -> DVec3 {
        self.rotation.transpose() * n
    }

    /// Half the width of the band around the margin in which rounding leaves the outcome open and the
    /// pair counts as within the margin; pair units.
    pub(crate) fn rounding_band(&self) -> f64 {
        U * (BAND * (self.circumradius + self.distance) + NOISE * self.m)
    }

    /// Points of the contact plane closer than this count as one point; pair units.
    pub(crate) fn merge_distance(&self) -> f64 {
        MERGE * U * (self.circumradius + self.m)
    }

    /// The widest bracket that counts as closed, for a growth scale of `ray` with the upper bound
    /// `upper`.
    pub(crate) fn closed_width(&self, upper: f64, relative_tolerance: f64) -> f64 {
        upper * (relative_tolerance + BRACKET * U * self.circumradius / self.inradius)
            + 2.0 * NOISE * U * self.ray_m / self.inradius
    }

    /// The world's unit vector along a direction of A's frame.
    pub(crate) fn direction_to_world(&self, n: DVec3) -> DVec3 {
        (self.rotation_a * n).normalize()
    }

    /// An offset in the pair's frame, in the world's axes and the caller's units.
    pub(crate) fn offset_to_world(&self, offset: DVec3) -> DVec3 {
        self.rotation_a * offset * self.unit
    }

    /// The offset from the origin of A's own frame to A's contraction point, in the world's axes and the
    /// caller's units.
    pub(crate) fn centre_offset_a(&self) -> DVec3 {
        self.rotation_a * self.a.contraction_point()
    }
}

/// The exponent of the power of two at or below `x`, so that `x * 2^-exponent(x)` is in [1, 2);
/// 0 for 0.
#[inline]
fn exponent(x: f64) -> i32 {
    let biased = ((x.to_bits() >> 52) & 0x7ff) as i32;
    if biased != 0 { biased - 1023 } else { small_exponent(x) }
}

#[cold]
fn small_exponent(x: f64) -> i32 {
    if x == 0.0 { 0 } else { exponent(x * 2f64.powi(64)) - 64 }
}

/// `x * 2^k`; exact unless the result is subnormal or overflows.
#[inline]
pub(crate) fn shift(mut x: f64, mut k: i32) -> f64 {
    let power = |k: i32| f64::from_bits(((k + 1023) as u64) << 52);
    while k.abs() > 1000 {
        let step = 1000 * k.signum();
        x *= power(step);
        k -= step;
    }
    x * power(k)
}

#[inline]
fn shift_vec(v: DVec3, k: i32) -> DVec3 {
    if k.abs() <= 1000 { v * shift(1.0, k) } else { DVec3::new(shift(v.x, k), shift(v.y, k), shift(v.z, k)) }
}
