//! Derivatives of an answer by the poses: how growth scale, separation and normal change if a body moves.
//!
//! Near almost every pose one facet of `K` is the one that the ray leaves through. The basis names three
//! of its vertices, `u_i = a_i - b_i` about the centres, and the facet's plane is `g.u = 1`. While the ray
//! stays in the facet, everything follows from how the plane moves:
//!
//! ```text
//!            u2                    g = n / (n.u_i)        the facet's plane is g.u = 1
//!             /\                   alpha = g.d            because the ray meets it at x = d / alpha
//!            /  \                  x = sum of m_i u_i     with shares m_i, whose sum is 1
//!           / .x \                 a = sum of m_i a_i     the point of A at x, and
//!          /______\                b = sum of m_i b_i     that of B: x = a - b
//!        u0        u1              s = (alpha - 1) n.x    the separation along the normal
//! ```
//!
//! - **Translation of B relative to A by `t`**: the plane stays, so `alpha` changes by `g.t`. This is exact for
//!   finite steps too, while the ray stays in the facet: `alpha` is linear in `d` on the facet's cone. The
//!   separation changes by `n.t`, and the normal does not change.
//! - **Rotation of A by a small `w`** about the origin of its frame, which has the contraction point at `c`
//!   from it: `alpha` changes by `-((c + alpha a) x g).w`. Think of a point fixed to A at the lever
//!   `c + alpha a`: its velocity pushes against `g`. For B the sign is `+`, with its own `c` and `b`.
//! - **The normal** is perpendicular to the sides `e_i = u_i - u_0`. If `w` turns the part `f_i` of a side that
//!   belongs to A, then `e_i.dn = -n.(w x f_i) = -w.(f_i x n)`. With the dual vectors `p_1, p_2` of the sides
//!   in the plane (`p_i.e_j` is 1 if `i = j`, otherwise 0), the Jacobian is `N = -sum of p_i (f_i x n)^T`.
//!   For B the sign is `+`.
//! - **The separation** is `n.(d - x)` for the moving point `x` of the facet, so rotating A changes it by
//!   `((alpha - 1) N^T x - (c + a) x n).w`, and B by `((alpha - 1) N^T x + (c + b) x n).w`.
//!
//! Where several facets are optimal, or one facet breaks up under rotation, the derivative is not unique:
//! [`kink`] decides that.
//!
//! Only sides and points of the facet are multiplied, never two points that are nearly parallel, so a small
//! facet far from the origin loses no accuracy. What remains is the condition of the basis: a triangle whose
//! least height is `R / k` turns by up to `k` roundoffs, and the shares `m_i` are uncertain by as much.
//! The cost is a few dozen operations, and the search for the vertices in the facet's plane, which takes time
//! linear in the number of features there.
//!
//! Source: the facet is the optimal basis of a linear programme, so these are the sensitivities of linear
//! programming (D. Bertsimas and J. N. Tsitsiklis, *Introduction to Linear Optimization*, 1997, chapter 5),
//! written for the Minkowski difference of two bodies.

mod kink;

use glam::{DMat3, DVec3};

use crate::growth::triple::{Triple, weights_by_areas};
use crate::growth::triple_of;
use crate::pair::{Pair, Support};
use crate::tolerance::{GRADIENT, U};
use crate::{Body, Manifold};

pub use kink::KinkScratch;

/// The derivatives of an answer by the poses of its bodies.
///
/// Each row has nine columns: by a translation of B relative to A (3, the caller's units), by a rotation of
/// A (3, radians), and by a rotation of B (3, radians). All axes are the world's. A rotation is about the
/// origin of the body's own frame, where its pose puts it. A translation of A is the opposite of one of B.
#[derive(Clone, Debug, PartialEq)]
pub struct Derivatives {
    /// The gradient of the growth scale.
    pub alpha: [f64; 9],
    /// The gradient of the separation along the normal, caller's units.
    pub separation: [f64; 9],
    /// The Jacobian of the normal: a row for each of its coordinates. A translation does not turn the normal,
    /// so the first three columns are 0.
    pub normal: [[f64; 9]; 3],
    /// A bound of the rounding error. With `g` the first three numbers of `alpha`, and `l` the larger
    /// distance of a contraction point from its frame's origin plus the sum of the hulls' circumradii times
    /// `max(1, alpha)`, the error is at most this bound times: `|g|` for the translation in `alpha`, `l |g|` for
    /// a rotation; 1 and `l` in `separation`; 1 in each row of `normal`. It is infinite where the centres
    /// coincide, and where the bracket is open, because the basis is then not known to be optimal.
    pub error: f64,
    /// Whether the gradient is not unique. It is then that of one optimal basis: an element of the generalised
    /// gradient, and not always a one-sided derivative.
    pub kink: bool,
}

/// Computes the derivatives of `manifold`, the answer for `a` and `b`, from its basis.
///
/// `None` if there is no basis (always for separated pairs), or if its three points lie on a line.
///
/// If the query allowed a relative tolerance above 0, the basis may belong to a facet beside the optimal
/// one, and so do its derivatives.
///
/// ```
/// use hullcast_contact::{
///     Body, ConvexHull, KinkScratch, Pose, Query, Workspace, contact_manifold, derivatives,
/// };
///
/// let sign = |corner: u32, axis: u32| if corner >> axis & 1 == 0 { -0.5 } else { 0.5 };
/// let corners: Vec<[f64; 3]> = (0..8).map(|i| [sign(i, 0), sign(i, 1), sign(i, 2)]).collect();
/// let cube = ConvexHull::new(&corners)?;
/// let a = Body::new(&cube, Pose::new([0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0])?);
/// let b = Body::new(&cube, Pose::new([0.1, 0.2, 0.9], [0.1, 0.2, 0.3, 0.9])?);
///
/// let mut workspace = Workspace::default();
/// let query = Query { margin: f64::INFINITY, ..Query::default() };
/// let manifold = contact_manifold(&a, &b, &query, None, &mut workspace);
/// let found = derivatives(&a, &b, manifold, &mut KinkScratch::default()).expect("a basis");
/// assert!(!found.kink && found.error < 1e-12);
/// // The separation changes by the normal's share of a translation.
/// assert!((found.separation[2] - manifold.normal.z).abs() < 1e-15);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn derivatives(
    a: &Body<'_>,
    b: &Body<'_>,
    manifold: &Manifold,
    scratch: &mut KinkScratch,
) -> Option<Derivatives> {
    let pair = Pair::new(a, b);
    let triple = triple_of(&pair, manifold.basis.as_ref()?)?;
    let facet = Facet::new(&pair, triple, manifold.flags.coincident)?;
    let jacobians = facet.jacobians(&pair);
    let centres = [
        pair.rotation_a.transpose() * pair.centre_offset_a() / pair.unit,
        pair.rotation * (b.hull.contraction_point() / pair.unit),
    ];
    let (alpha, n, height) = (manifold.alpha, facet.n, facet.height);
    let mut found = Derivatives {
        alpha: [0.0; 9],
        separation: [0.0; 9],
        normal: [[0.0; 9]; 3],
        error: facet.error(&pair),
        kink: manifold.flags.coincident || kink::is_kink(&pair, &facet, scratch),
    };
    if manifold.flags.coincident || manifold.flags.gap_open {
        found.error = f64::INFINITY;
    }
    let world = |v: DVec3| (pair.rotation_a * v).to_array();
    put(&mut found.alpha, 0, world(n / height / pair.unit));
    put(&mut found.separation, 0, world(n));
    for (side, sign) in [(0, -1.0), (1, 1.0)] {
        let (centre, on_body, jacobian) = (centres[side], facet.at_body[side], jacobians[side]);
        let first = 3 + 3 * side;
        put(&mut found.alpha, first, world((centre + alpha * on_body).cross(n) * (sign / height)));
        let tilt = jacobian.transpose() * facet.x * (alpha - 1.0);
        let lever = (centre + on_body).cross(n) * sign;
        put(&mut found.separation, first, world((tilt + lever) * pair.unit));
        let in_world = pair.rotation_a * jacobian * pair.rotation_a.transpose();
        for (row, values) in found.normal.iter_mut().enumerate() {
            put(values, first, in_world.row(row).to_array());
        }
    }
    Some(found)
}

fn put(row: &mut [f64; 9], first: usize, values: [f64; 3]) {
    row[first..first + 3].copy_from_slice(&values);
}

/// The triangle of the basis, and where the ray meets its plane. A's frame, pair units.
struct Facet {
    triple: [Support; 3],
    /// Outward unit normal.
    n: DVec3,
    /// The distance of the plane from the centre of `K`.
    height: f64,
    /// The point of the plane on the ray, `d / alpha`.
    x: DVec3,
    /// The points of A and of B, about their own centres, whose difference is `x`.
    at_body: [DVec3; 2],
    /// Twice the area of the triangle; negative if its corners run clockwise about the normal.
    area: f64,
    /// The growth scale of the ray.
    growth: f64,
}

impl Facet {
    /// None if the three points lie on a line.
    fn new(pair: &Pair<'_>, triple: [Support; 3], coincident: bool) -> Option<Self> {
        let [u0, u1, u2] = triple.map(|u| u.point);
        let n = Triple::new(triple).normal().n.normalize();
        let n = if n.dot(u0) < 0.0 { -n } else { n };
        let area = (u1 - u0).cross(u2 - u0).dot(n);
        let height = n.dot(u0);
        let usable = area != 0.0 && height > 0.0 && area.is_finite() && height.is_finite();
        if !usable {
            return None;
        }
        let growth = n.dot(pair.ray) / height;
        // Coincident centres give no ray, and alpha is 0 whatever point of the facet stands for `x`.
        let shares = match coincident {
            true => [1.0 / 3.0; 3],
            false => weights_by_areas(pair.ray, &triple).map(|l| l / growth),
        };
        let mean = |points: [DVec3; 3]| points[0] * shares[0] + points[1] * shares[1] + points[2] * shares[2];
        let x = if coincident { mean([u0, u1, u2]) } else { pair.ray / growth };
        let at_body = [mean(triple.map(|u| pair.vertex_a(u.a))), mean(triple.map(|u| pair.vertex_b(u.b)))];
        Some(Self { triple, n, height, x, at_body, area, growth })
    }

    /// The Jacobians of the normal by rotations of A and of B.
    fn jacobians(&self, pair: &Pair<'_>) -> [DMat3; 2] {
        let [u0, u1, u2] = self.triple;
        let p1 = (u2.point - u0.point).cross(self.n) / self.area;
        let p2 = self.n.cross(u1.point - u0.point) / self.area;
        let jacobian = |vertex: &dyn Fn(&Support) -> DVec3, sign: f64| {
            let [f1, f2] = [&u1, &u2].map(|u| (vertex(u) - vertex(&u0)).cross(self.n) * sign);
            DMat3::from_cols(p1 * f1.x + p2 * f2.x, p1 * f1.y + p2 * f2.y, p1 * f1.z + p2 * f2.z)
        };
        [jacobian(&|u| pair.vertex_a(u.a), -1.0), jacobian(&|u| pair.vertex_b(u.b), 1.0)]
    }

    /// [`Derivatives::error`] of a certified basis.
    fn error(&self, pair: &Pair<'_>) -> f64 {
        let [u0, u1, u2] = self.triple.map(|u| u.point);
        let longest = (u1 - u0).length().max((u2 - u1).length()).max((u0 - u2).length());
        let reach = pair.circumradius;
        let condition = reach * longest / self.area.abs();
        let noise = 1.0 + pair.ray_m / (self.growth * reach);
        let error = GRADIENT * U * condition * condition * (reach / self.height) * noise;
        if error.is_nan() { f64::INFINITY } else { error }
    }
}
