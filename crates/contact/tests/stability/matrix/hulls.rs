//! Rows about the shape of the hulls.

use std::rc::Rc;

use super::Row;
use crate::case::{Case, Shape, any_shape, cuboid, turn};
use crate::scene::{Random, box_points, cloud, prism_points, scaled};

const ALPHAS: [f64; 6] = [0.05, 0.5, 0.9, 0.999, 1.001, 1.7];

fn any_alpha(random: &mut Random) -> f64 {
    ALPHAS[random.below(ALPHAS.len())] * random.range(0.95, 1.05)
}

fn plate(random: &mut Random, thin: f64) -> Rc<Shape> {
    let (x, y) = (random.range(0.5, 1.0), random.range(0.5, 1.0));
    if random.below(3) == 0 { Shape::new(prism_points(7, x, thin)) } else { cuboid([x, y, thin]) }
}

fn needle(random: &mut Random, thin: f64) -> Rc<Shape> {
    if random.below(3) == 0 {
        Shape::new(prism_points(6, thin, 1.0))
    } else {
        cuboid([thin, thin * random.range(0.5, 1.0), 1.0])
    }
}

/// Plates and needles of growing aspect ratio, at any attitude and stacked.
pub(super) fn aspect() -> Vec<Row> {
    let mut rows = Vec::new();
    for power in [0, 1, 2, 3, 4, 5, 6] {
        let thin = 0.3 * 10f64.powi(-power);
        let mut row = |name: &str, make: fn(&mut Random, f64) -> Case| {
            let make = move |random: &mut Random| make(random, thin);
            rows.push(Row::new("aspect ratio", format!("1e{power} {name}"), make));
        };
        row("plates", |random, thin| {
            let shapes = [plate(random, thin), plate(random, thin)];
            let alpha = any_alpha(random);
            Case::aimed(random, shapes, alpha)
        });
        row("needle, plate", |random, thin| {
            let shapes = [needle(random, thin), plate(random, thin)];
            let alpha = any_alpha(random);
            Case::aimed(random, shapes, alpha)
        });
        row("needles", |random, thin| {
            let shapes = [needle(random, thin), needle(random, thin)];
            let alpha = any_alpha(random);
            Case::aimed(random, shapes, alpha)
        });
        row("stacked", |random, thin| {
            let shapes = [plate(random, thin), plate(random, thin)];
            let (sin, cos) = random.range(0.0, std::f64::consts::TAU).sin_cos();
            let tilt = 10f64.powf(random.range(-9.0, -2.0)) * thin.max(1e-3);
            let rotations = [[0.0, 0.0, 0.0, 1.0], turn([cos, sin, 0.0], tilt)];
            let (x, y) = (random.range(-0.3, 0.3), random.range(-0.3, 0.3));
            let height = 2.0 * thin * (1.0 + [0.0, 1e-2, -1e-2, 1e-6][random.below(4)]);
            Case::new(shapes, [x, y, height], rotations)
        });
    }
    rows
}

/// A small hull that nearly touches the faces, edges and corners of a large one.
pub(super) fn size_ratio() -> Vec<Row> {
    let row = |power: i32| {
        Row::new("size ratio", format!("1e{power}"), move |random| {
            let small = any_shape(random);
            let centre = small.hull.contraction_point().to_array();
            let by = 10f64.powi(-power);
            let points = small.points.iter().map(|&p| scaled(p, by)).collect();
            let small = Shape::about(points, Some(scaled(centre, by)));
            let large = any_shape(random);
            let shapes = if random.below(2) == 0 { [large, small] } else { [small, large] };
            // The gap or overlap is at most about the small hull's size.
            let alpha = 1.0 + by * random.range(-1.0, 1.0);
            Case::aimed(random, shapes, alpha)
        })
    };
    (0..=6).map(row).collect()
}

/// Hulls with many vertices. The exact simplex method evaluates every vertex at each step.
pub(super) fn vertices() -> Vec<Row> {
    let row = |count: usize| {
        let mut pool: Vec<Rc<Shape>> = Vec::new();
        let make = move |random: &mut Random| {
            while pool.len() < 4 {
                let half = [1.0, random.range(0.4, 1.0), random.range(0.2, 1.0)];
                let points = match pool.len() {
                    0 if count >= 6 => prism_points(count / 2, half[0], half[1]),
                    _ => cloud(random, count, half),
                };
                // A cloud of four points may be nearly flat; flat hulls belong to the rows of the
                // aspect ratio.
                let round = |s: &Shape| s.hull.inradius() > 0.02 * s.hull.circumradius();
                pool.extend(Some(Shape::new(points)).filter(|s| round(s)));
            }
            let shapes = [pool[random.below(4)].clone(), pool[random.below(4)].clone()];
            let alpha = any_alpha(random);
            Case::aimed(random, shapes, alpha)
        };
        Row::new("vertices", count, make).thinned(count.div_ceil(512))
    };
    [4, 8, 64, 256, 1024, 4096, 10_000].map(row).into()
}

/// Sizes near both ends of the accepted range, and the size at which another library panics. Powers
/// of two are the subject of the scale's rows.
pub(super) fn tiny() -> Vec<Row> {
    let row = |size: f64| {
        Row::new("hull size", format!("{size:e}"), move |random| {
            let shapes = [any_shape(random), any_shape(random)];
            let alpha = any_alpha(random);
            Case::aimed(random, shapes, alpha).scaled(size)
        })
    };
    [1e-49, 1e-23, 1e23, 1e49].map(row).into()
}

/// Contraction points near a face. The aspect ratio `R/r` about the contraction point grows.
pub(super) fn contraction_point() -> Vec<Row> {
    let row = |depth: f64| {
        Row::new("contraction point", format!("{depth:e} inside"), move |random| {
            let half = [0; 3].map(|_| random.range(0.3, 1.0));
            let near = [random.range(-0.2, 0.2), random.range(-0.2, 0.2), half[2] - depth];
            let shapes = [Shape::about(box_points(half), Some(near)), any_shape(random)];
            let shapes = if random.below(4) == 0 { [shapes[0].clone(), shapes[0].clone()] } else { shapes };
            let alpha = any_alpha(random);
            Case::aimed(random, shapes, alpha)
        })
    };
    [0.1, 1e-3, 1e-6, 1e-9].map(row).into()
}
