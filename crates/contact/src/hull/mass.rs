//! Volume, centre of mass and inertia tensor of a triangulated solid at unit density.
//!
//! The solid is the sum of the tetrahedra that join each triangle to one point, the apex. With
//! `a`, `b`, `c` the corners of a triangle relative to the apex, and `w` six times the volume of
//! its tetrahedron:
//!
//! ```text
//! volume        = sum w / 6
//! centre        = apex + (sum w (a + b + c)) / (4 sum w)
//! second moment = sum w (a a^T + b b^T + c c^T + s s^T) / 120,   s = a + b + c
//! inertia       = trace(second moment) I - second moment
//! ```
//!
//! The apex for volume and centre is a vertex, so every `w` is positive and the sums lose nothing
//! to cancellation. The apex for the second moment is the centre. Both passes are linear. The
//! integration over tetrahedra is that of S. L. Lien and J. T. Kajiya, *A symbolic method for
//! calculating the integral properties of arbitrary nonconvex polyhedra*, IEEE Computer Graphics
//! and Applications 4(10), 1984. Terms that cancel are computed in double-double numbers, because
//! the volumes of a plate's tetrahedra are small differences of large products.

use glam::{DMat3, DVec3};

use crate::exact::{Dd, Dd3, dd_dot, exact_difference};
use crate::stop::{Meter, Stopped};

/// Steps per tetrahedron of a sum.
const PART: u64 = 60;

/// The mass properties of a solid of unit density, in the units of its vertices.
pub(super) struct Mass {
    pub(super) volume: f64,
    /// The centre of mass.
    pub(super) centre: DVec3,
    /// About the centre of mass.
    pub(super) inertia: DMat3,
}

/// Sums the tetrahedra that join each triangle to one apex. `areas` holds the doubled vector area
/// of each triangle.
pub(super) fn mass(
    points: &[DVec3],
    triangles: &[[u32; 3]],
    areas: &[Dd3],
    meter: &Meter<'_>,
) -> Result<Mass, Stopped> {
    let corners = |t: &[u32; 3]| t.map(|v| points[v as usize]);
    // Seen from a vertex every tetrahedron is positive, so the sums lose nothing.
    let apex = points[triangles[0][0] as usize];
    let (mut six_volume, mut moment) = (Dd::default(), [Dd::default(); 3]);
    for (triangle, &area) in triangles.iter().zip(areas) {
        meter.spend(PART)?;
        let [a, b, c] = corners(triangle);
        let part = six_times_volume(area, a, apex);
        six_volume = six_volume + part;
        let weighted = (part * ((a - apex) + (b - apex) + (c - apex))).to_array();
        moment.iter_mut().zip(weighted).for_each(|(m, w)| *m = *m + w);
    }
    let six_volume = six_volume.value();
    let centre = apex + DVec3::from_array(moment.map(Dd::value)) / (4.0 * six_volume);
    // For a tetrahedron with one corner at the origin, the integral of x x^T is its volume / 20
    // times (a a^T + b b^T + c c^T + s s^T), where s = a + b + c is the sum of its corners.
    let mut second = DMat3::ZERO;
    for (triangle, &area) in triangles.iter().zip(areas) {
        meter.spend(PART)?;
        let [a, b, c] = corners(triangle);
        let part = six_times_volume_nearly(area, a, centre);
        let (a, b, c) = (a - centre, b - centre, c - centre);
        let sum = a + b + c;
        second += part * (outer(a) + outer(b) + outer(c) + outer(sum));
    }
    let second = second * (1.0 / 120.0);
    let trace = second.x_axis.x + second.y_axis.y + second.z_axis.z;
    let inertia = DMat3::from_diagonal(DVec3::splat(trace)) - second;
    Ok(Mass { volume: six_volume / 6.0, centre, inertia })
}

/// [`six_times_volume`] to about 20 roundoffs. Uses double-double numbers only if the result is a
/// small difference of large products.
fn six_times_volume_nearly(area: Dd3, a: DVec3, apex: DVec3) -> f64 {
    let products = DVec3::from_array(area.map(Dd::value)) * (a - apex);
    let sum = products.element_sum();
    if 4.0 * sum.abs() >= products.abs().element_sum() { sum } else { six_times_volume(area, a, apex) }
}

/// Six times the volume of the tetrahedron that joins a triangle to `apex`. `a` is a corner of the
/// triangle and `area` its doubled vector area. Computed in double-double numbers, because for a
/// plate the result is a small difference of large products.
fn six_times_volume(area: Dd3, a: DVec3, apex: DVec3) -> f64 {
    dd_dot(area, exact_difference(a, apex)).value()
}

/// The outer product `v v^T`.
fn outer(v: DVec3) -> DMat3 {
    DMat3::from_cols(v * v.x, v * v.y, v * v.z)
}
