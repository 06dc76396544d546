//! Rows about faces that rest on faces: noise on the faces, tilts between them, ties.

use super::Row;
use crate::case::{Case, Shape, cuboid, turn};
use crate::scene::{Random, box_points, prism_points, scaled};

const LEVEL: [f64; 4] = [0.0, 0.0, 0.0, 1.0];
/// The default feature angle.
const FEATURE_ANGLE: f64 = 0.01;

/// A gap, or a depth of overlap, that is small compared with the hulls.
fn small_gap(random: &mut Random) -> f64 {
    [-1e-2, -1e-4, -1e-9, 0.0, 1e-9, 1e-3][random.below(6)]
}

/// A box with 25 more points spread over its top face; `height` moves them and the top corners.
fn dotted_box(random: &mut Random, height: impl Fn(&mut Random, f64, f64) -> f64) -> Vec<[f64; 3]> {
    let mut points = box_points([1.0, 0.8, 0.3]);
    for p in &mut points {
        p[2] += if p[2] > 0.0 { height(random, p[0], p[1]) } else { 0.0 };
    }
    for i in 0..25 {
        let (x, y) = (-0.9 + 0.45 * f64::from(i % 5), -0.7 + 0.35 * f64::from(i / 5));
        points.push([x, y, 0.3 + height(random, x, y)]);
    }
    points
}

/// Points of one face moved off its plane by noise. Up to the merge tolerance they form one face
/// whose patch has every corner; beyond it the hull must still be valid.
pub(super) fn facet_noise() -> Vec<Row> {
    let row = |noise: f64| {
        Row::new("facet noise", format!("{noise:e}"), move |random| {
            let points = dotted_box(random, |random, _, _| noise * random.range(-1.0, 1.0));
            let shapes = [Shape::new(points), cuboid([0.4, 0.3, 0.2])];
            let centre = shapes[0].hull.contraction_point().z;
            let spin = random.range(0.0, std::f64::consts::TAU);
            let d = [random.range(-0.3, 0.3), random.range(-0.3, 0.3), 0.5 + small_gap(random)];
            let case = Case::new(shapes, d, [LEVEL, turn([0.0, 0.0, 1.0], spin)]);
            debug_assert!(centre.abs() < 0.1);
            // The merge tolerance is 1e-6 R. Noise of at most half of that is certain to merge.
            Case { least_points: if noise <= 3e-7 { 4 } else { 1 }, ..case }
        })
        .meets(|met| met.faces)
    };
    [1e-15, 1e-12, 1e-9, 1e-7, 1e-6, 1e-4].map(row).into()
}

/// A top face folded along its middle, by an angle from 1e-9 to 10 degrees.
pub(super) fn dihedral() -> Vec<Row> {
    let row = |degrees: f64| {
        Row::new("dihedral angle", format!("{degrees:e} deg"), move |random| {
            let slope = (0.5 * degrees.to_radians()).tan();
            let points = dotted_box(random, |_, x, _| -slope * x.abs());
            let shapes = [Shape::new(points), cuboid([0.4, 0.3, 0.2])];
            let tilt = 0.5 * degrees.to_radians() * [0.0, 1.0, -1.0][random.below(3)];
            let d = [random.range(-0.3, 0.3), random.range(-0.3, 0.3), 0.5 + small_gap(random)];
            let case = Case::new(shapes, d, [LEVEL, turn([0.0, 1.0, 0.0], tilt)]);
            Case { least_points: if degrees <= 1e-6 { 4 } else { 1 }, ..case }
        })
    };
    [1e-9, 1e-6, 1e-4, 1e-2, 0.5, 1.0, 10.0].map(row).into()
}

/// A box tilted on another one. The patch has all four corners while the tilt is within the feature
/// angle, and at least one point beyond it.
pub(super) fn tilt() -> Vec<Row> {
    let row = |angle: f64| {
        Row::new("tilt", format!("{angle:e}"), move |random| {
            let shapes = [cuboid([1.0, 0.8, 0.3]), cuboid([0.4, 0.3, 0.2])];
            let (sin, cos) = random.range(0.0, std::f64::consts::TAU).sin_cos();
            let half = 0.5 * random.range(0.0, std::f64::consts::TAU);
            let [x, y, z, w] = turn([cos, sin, 0.0], angle);
            // The spin about z is applied first, then the tilt.
            let (s, c) = half.sin_cos();
            let rotation = [x * c + y * s, y * c - x * s, w * s + z * c, w * c - z * s];
            let d = [random.range(-0.3, 0.3), random.range(-0.3, 0.3), 0.5 + small_gap(random)];
            let both = if random.below(2) == 0 { [LEVEL, rotation] } else { [rotation, LEVEL] };
            let d = if both[0] == LEVEL { d } else { scaled(d, -1.0) };
            let shapes = if both[0] == LEVEL {
                shapes
            } else {
                let [a, b] = shapes;
                [b, a]
            };
            Case {
                least_points: if angle < 0.95 * FEATURE_ANGLE { 4 } else { 1 },
                ..Case::new(shapes, d, both)
            }
        })
        .meets(if angle < 0.95 * FEATURE_ANGLE {
            |met| met.faces.min(met.patches)
        } else {
            |met| met.overlapping
        })
    };
    let around = [0.9, 1.0, 1.1].map(|share| share * FEATURE_ANGLE);
    [0.0, 1e-12, 1e-9, 1e-6, 1e-4, 1e-3].into_iter().chain(around).chain([1e-1]).map(row).collect()
}

/// Pairs with several optimal normals.
pub(super) fn ties() -> Vec<Row> {
    let cube = || cuboid([0.5; 3]);
    let axes = |random: &mut Random, zeros: usize| {
        let mut d = [0; 3].map(|_| [1.0, -1.0][random.below(2)]);
        let first = random.below(3);
        (0..zeros).for_each(|i| d[(first + i) % 3] = 0.0);
        scaled(d, [0.25, 0.5, 0.75, 1.0, 1.5][random.below(5)])
    };
    let cubes = |name: &'static str, zeros: usize| {
        Row::new("ties", name, move |random| Case::new([cube(), cube()], axes(random, zeros), [LEVEL; 2]))
    };
    let integer = |random: &mut Random| [0; 3].map(|_| (1 + random.below(4)) as f64);
    let boxes = Row::new("ties", "integer boxes", move |random| {
        let shapes = [cuboid(integer(random)), cuboid(integer(random))];
        let d = [0; 3].map(|_| random.below(9) as f64 - 4.0);
        let quarter = |random: &mut Random| {
            // Rotations by 0, 120, 120 and 180 degrees, all exact with these quaternions.
            [LEVEL, [0.5, 0.5, 0.5, 0.5], [-0.5, 0.5, 0.5, 0.5], [1.0, 0.0, 0.0, 0.0]][random.below(4)]
        };
        let rotations = [quarter(random), quarter(random)];
        // Coincident centres are the subject of another row.
        let d = if d == [0.0; 3] { [0.0, 1.0, 0.0] } else { d };
        Case::new(shapes, d, rotations)
    });
    let prisms = Row::new("ties", "prisms on prisms", move |random| {
        let shape = Shape::centred(prism_points(3 + random.below(12), 1.0, 0.5));
        let d = [[0.0, 0.0, 0.5], [0.0, 0.0, 1.0], [0.5, 0.0, 0.0], [0.25, 0.0, 0.25]][random.below(4)];
        Case::new([shape.clone(), shape], d, [LEVEL; 2])
    });
    let identical = super::poses::coincident(Row::new("ties", "identical hulls", move |random| {
        let shape = Shape::centred(box_points(integer(random)));
        let rotation = random.rotation();
        Case::new([shape.clone(), shape], [0.0; 3], [rotation; 2])
    }));
    let tied = |row: Row| row.meets(|met| met.ties);
    let others = [tied(boxes), tied(prisms), identical];
    [cubes("cubes along faces", 2), cubes("cubes along edges", 1), cubes("cubes along diagonals", 0)]
        .into_iter()
        .map(tied)
        .chain(others)
        .collect()
}
