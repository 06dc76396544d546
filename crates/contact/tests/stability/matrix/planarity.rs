//! Rows about the planarity of faces: coordinates rounded as files round them, and coarse merges.

use std::rc::Rc;

use super::Row;
use crate::case::{Case, Shape, any_shape, cuboid, rotate};
use crate::scene::{Random, box_points, cloud, prism_points};

const LEVEL: [f64; 4] = [0.0, 0.0, 0.0, 1.0];
const PLANARITIES: [f64; 4] = [0.0, 1e-4, 1e-3, 1e-2];

/// The points with their coordinates rounded to this many decimals, as a file writes them.
fn rounded(points: &[[f64; 3]], digits: i32) -> Vec<[f64; 3]> {
    let unit = 10_f64.powi(digits);
    points.iter().map(|p| p.map(|x| (x * unit).round() / unit)).collect()
}

/// A shape of about unit size with rounded coordinates. Some are round shapes with many vertices: a
/// coarse planarity merges their faces across the curvature.
fn shape(random: &mut Random, planarity: f64) -> Rc<Shape> {
    let points = match random.below(3) {
        0 => cloud(random, 150, [1.0, 0.7, 0.5]),
        1 => prism_points(48, 0.8, 0.5),
        _ => any_shape(random).points.clone(),
    };
    let (turn, digits) = (random.rotation(), 3 + random.below(4) as i32);
    let turned: Vec<[f64; 3]> = points.iter().map(|&p| rotate(turn, p)).collect();
    Shape::merged(rounded(&turned, digits), planarity)
}

/// Two such shapes at any attitude, at growth scales from deep overlap to clear separation.
pub(super) fn any() -> Vec<Row> {
    let row = |planarity: f64| {
        Row::new("planarity", format!("{planarity:e}"), move |random| {
            let shapes = [shape(random, planarity), shape(random, planarity)];
            let alpha = [0.05, 0.5, 0.9, 0.999, 1.001, 1.7][random.below(6)];
            Case::aimed(random, shapes, alpha)
        })
    };
    PLANARITIES.map(row).into()
}

/// A box or a prism that stands on a face of a larger box. Its coordinates were written in a turned
/// frame with five decimals, so its faces are not exactly planar. If the planarity allows for that
/// rounding, the face must keep all its corners in the patch.
pub(super) fn resting() -> Vec<Row> {
    let row = |planarity: f64| {
        Row::new("planarity", format!("{planarity:e} resting"), move |random| {
            let sides = 3 + random.below(6);
            let points =
                if sides == 4 { box_points([0.4, 0.3, 0.25]) } else { prism_points(sides, 0.4, 0.25) };
            let [x, y, z, w] = random.rotation();
            let turned: Vec<[f64; 3]> = points.iter().map(|&p| rotate([x, y, z, w], p)).collect();
            let shapes = [cuboid([1.0, 0.8, 0.3]), Shape::merged(rounded(&turned, 5), planarity)];
            let gap = [-1e-2, -1e-4, 1e-3][random.below(3)];
            let d = [random.range(-0.3, 0.3), random.range(-0.3, 0.3), 0.55 + gap];
            let case = Case::new(shapes, d, [LEVEL, [-x, -y, -z, w]]);
            Case { least_points: if planarity >= 1e-3 { sides } else { 1 }, ..case }
        })
        .meets(if planarity >= 1e-3 { |met| met.faces } else { |met| met.overlapping })
    };
    PLANARITIES.map(row).into()
}
