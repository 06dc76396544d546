//! Volume, centre of mass and inertia at unit density.

use glam::{DMat3, DVec3};

use crate::contact::exact::{Dd, Dd3, dd_dot, exact_difference};
use crate::contact::stop::{Meter, Stopped};

/// Steps of one tetrahedron's part of a sum.
const PART: u64 = 60;

/// Of a solid, in the units of its vertices.
pub(super) struct Mass {
    pub(super) volume: f64,
    pub(super) center: DVec3,
    /// About the centre.
    pub(super) inertia: DMat3,
}

/// Adds up the tetrahedra between the triangles, of so large vector areas twice, and
/// one point.
pub(super) fn mass(
    points: &[DVec3],
    triangles: &[[u32; 3]],
    areas: &[Dd3],
    meter: &Meter<'_>,
) -> Result<Mass, Stopped> {
    let corners = |t: &[u32; 3]| t.map(|v| points[v as usize]);
    // From a vertex every tetrahedron is positive, so that the sums lose nothing.
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
    let center = apex + DVec3::from_array(moment.map(Dd::value)) / (4.0 * six_volume);
    // Of a tetrahedron with one corner at the origin: the integral of x x^T is
    // its volume / 20 times (sum of x x^T over corners + the sum's own).
    let mut second = DMat3::ZERO;
    for (triangle, &area) in triangles.iter().zip(areas) {
        meter.spend(PART)?;
        let [a, b, c] = corners(triangle);
        let part = six_times_volume_nearly(area, a, center);
        let (a, b, c) = (a - center, b - center, c - center);
        let sum = a + b + c;
        second += part * (outer(a) + outer(b) + outer(c) + outer(sum));
    }
    let second = second * (1.0 / 120.0);
    let trace = second.x_axis.x + second.y_axis.y + second.z_axis.z;
    let inertia = DMat3::from_diagonal(DVec3::splat(trace)) - second;
    Ok(Mass { volume: six_volume / 6.0, center, inertia })
}

/// The same to some 20 roundoffs: in double-double only where it is a small difference.
fn six_times_volume_nearly(area: Dd3, a: DVec3, apex: DVec3) -> f64 {
    let products = DVec3::from_array(area.map(Dd::value)) * (a - apex);
    let sum = products.element_sum();
    if 4.0 * sum.abs() >= products.abs().element_sum() { sum } else { six_times_volume(area, a, apex) }
}

/// Of the tetrahedron between `apex` and a triangle at `a` of twice the vector area
/// `area`: in double-double, since a plate's is a small difference of large products.
fn six_times_volume(area: Dd3, a: DVec3, apex: DVec3) -> f64 {
    dd_dot(area, exact_difference(a, apex)).value()
}

fn outer(v: DVec3) -> DMat3 {
    DMat3::from_cols(v * v.x, v * v.y, v * v.z)
}
