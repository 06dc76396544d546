//! Rows about the poses of the hulls, and about the query.

use super::{About, Row};
use crate::case::{Case, Shape, any_shape, cuboid};
use crate::judge::U;
use crate::scene::{Random, box_points, scaled};

fn any_alpha(random: &mut Random) -> f64 {
    match random.below(4) {
        0 => random.range(0.02, 0.9),
        1 => random.range(0.9, 1.0),
        2 => random.range(1.0, 1.1),
        _ => random.range(1.1, 3.0),
    }
}

fn any_case(random: &mut Random) -> Case {
    let shapes = [any_shape(random), any_shape(random)];
    let alpha = any_alpha(random);
    Case::aimed(random, shapes, alpha)
}

/// Scenes scaled by powers of two, which must keep every bit, and by powers of ten, which must keep
/// the budget.
pub(super) fn scale() -> Vec<Row> {
    let binary = |k: i32| {
        Row::new("scale", format!("2^{k}"), move |random| {
            let twin = any_case(random);
            let case = twin.scaled(2f64.powi(k));
            Case { twin: Some(Box::new(twin)), ..case }
        })
    };
    let decimal =
        |k: i32| Row::new("scale", format!("1e{k}"), move |random| any_case(random).scaled(10f64.powi(k)));
    let binary = [-60, -30, -7, -1, 1, 7, 30, 60].map(binary);
    binary.into_iter().chain([-12, -6, -3, 3, 6, 12].map(decimal)).collect()
}

/// Scenes far from the world's origin.
pub(super) fn world_offset() -> Vec<Row> {
    let row = |length: f64| {
        Row::new("world offset", format!("{length:e}"), move |random| {
            let direction = random.direction();
            any_case(random).moved(scaled(direction, length))
        })
    };
    [0.0, 1e3, 1e6, 1e9, 1e12].map(row).into()
}

pub(super) fn coincident(row: Row) -> Row {
    row.about(About::Coincident).meets(|met| met.coincident)
}

/// Centre distances from zero to absurdly large, in units of the pair's inradius. In the first rows
/// the hulls lie about their frames' origins, so the centre offset has no noise. In the last rows
/// they lie off the origins, where an offset below its own noise must be COINCIDENT.
pub(super) fn centre_distance() -> Vec<Row> {
    let centred = |share: f64| {
        let row = Row::new("centre distance", format!("{share:e} r"), move |random| {
            let shapes = [0; 2].map(|_| {
                let half = [0; 3].map(|_| random.range(0.2, 1.0));
                Shape::centred(box_points(half))
            });
            let inner: f64 = shapes.iter().map(|s| s.hull.inradius()).sum();
            let d = scaled(random.direction(), share * inner);
            Case::new(shapes, d, [random.rotation(), random.rotation()])
        });
        if share == 0.0 { coincident(row) } else { row }
    };
    let noise = |share: f64| {
        let row = Row::new("centre distance", format!("{share} u M"), move |random| {
            let away = scaled(random.direction(), 3.0);
            let half = [0; 3].map(|_| random.range(0.2, 1.0));
            let points = box_points(half).iter().map(|p| std::array::from_fn(|k| p[k] + away[k])).collect();
            let shape = Shape::new(points);
            let rotation = random.rotation();
            let d = scaled(random.direction(), share * U * 2.0 * 3.0);
            Case::new([shape.clone(), shape], d, [rotation, rotation])
        });
        // Offsets below 8 u M count as noise.
        if share < 8.0 { coincident(row) } else { row }
    };
    let centred = [0.0, 1e-290, 1e-100, 1e-16, 1e-12, 1e-8, 1e-3, 1e15].map(centred);
    centred.into_iter().chain([0.0, 4.0, 100.0].map(noise)).collect()
}

/// Growth scales near 1, and very small and very large ones.
pub(super) fn alpha() -> Vec<Row> {
    let at = |name: String, alpha: fn(&mut Random, f64) -> f64, by: f64| {
        Row::new("alpha", name, move |random| {
            let shapes = [any_shape(random), any_shape(random)];
            let alpha = alpha(random, by);
            Case::aimed(random, shapes, alpha)
        })
    };
    let near = |by: f64| {
        at(format!("1 +- {by:e}"), |random, by| if random.below(2) == 0 { 1.0 + by } else { 1.0 - by }, by)
    };
    let far = |by: f64| at(format!("{by:e}"), |_, by| by, by);
    let near = [0.0, 1e-15, 1e-14, 1e-12, 1e-9, 1e-6, 1e-3].map(near);
    near.into_iter().chain([1e-6, 1e-3, 1e3, 1e6].map(far)).collect()
}

/// Distances that differ from the margin by a small fraction of it. The margins are in units of `R`.
pub(super) fn margin() -> Vec<Row> {
    let row = |share: f64| {
        Row::new("margin", format!("{share:e} R"), move |random| {
            let case = any_case(random);
            let outer: f64 = case.shapes.iter().map(|s| s.hull.circumradius()).sum();
            let margin = share * outer;
            let off = [0.0, 1e-12, -1e-12, 1e-9, -1e-9, 1e-3, -1e-3][random.below(7)];
            // For a margin of 0 the difference is a fraction of the hulls' size instead.
            let distance = margin + off * if share == 0.0 { outer } else { margin };
            let case = Case::along(case.shapes, random.direction(), case.rotations, 1.5);
            case.at_distance(distance.max(0.0)).with_margins([margin])
        })
        .meets(|met| met.contact.min(met.separated))
    };
    [0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.1, 1.0].map(row).into()
}

/// A flat plate with a small box beside it. The growth normal is nearly the plate's own normal, and
/// the separation along it is small, so growth distance would report a contact (a "ghost")
/// although the hulls are far apart.
pub(super) fn ghosts() -> Vec<Row> {
    let row = |thin: f64| {
        Row::new("ghosts", format!("plate {thin}"), move |random| {
            let plate = cuboid([random.range(0.8, 1.2), random.range(0.8, 1.2), thin]);
            let small = cuboid([0; 3].map(|_| random.range(0.01, 0.03)));
            let rotations = [
                [0.0, 0.0, 0.0, 1.0],
                if random.below(2) == 0 { [0.0, 0.0, 0.0, 1.0] } else { random.rotation() },
            ];
            let d = [random.range(1.15, 1.5), random.range(-0.3, 0.3), thin + random.range(0.01, 0.04)];
            let case = Case::new([plate, small], d, rotations);
            let exact = case.exact();
            let distance = exact.distance_squared(exact.support(&exact.d)).value();
            case.with_margins([0.02, 0.5, 0.9, 0.999, 1.001, 1.1].map(|share| share * distance))
        })
        .meets(|met| met.ghosts)
    };
    [0.1, 0.03, 0.01, 1e-3].map(row).into()
}

/// Iteration limits combined with tolerances. The bracket must be valid in each.
pub(super) fn budgets() -> Vec<Row> {
    let row = |(limit, tolerance): (u32, f64)| {
        let row = Row::new("budget", format!("{limit} steps, {tolerance:e}"), move |random| Case {
            relative_tolerance: tolerance,
            max_iterations: limit,
            ..any_case(random)
        });
        match limit {
            0..=5 => row.about(About::GapOpen).meets(|met| met.open),
            10 => row.about(About::GapOpen),
            _ => row,
        }
    };
    let limits = [1, 2, 3, 5, 10, 30, 100].map(|limit| (limit, 0.0));
    let tolerances = [1e-12, 1e-9, 1e-6, 1e-3, 1e-1, 1.0].map(|tolerance| (1000, tolerance));
    let both = [(3, 1e-3), (5, 1e-6)];
    limits.into_iter().chain(tolerances).chain(both).map(row).collect()
}

/// Quaternions that are not of unit norm. The exact rotation is the normalised quaternion's.
pub(super) fn quaternions() -> Vec<Row> {
    let row = |off: f64| {
        Row::new("quaternion norm", format!("1 +- {off:e}"), move |random| {
            let mut case = any_case(random);
            for q in &mut case.rotations {
                let by = if random.below(2) == 0 { 1.0 + off } else { 1.0 - off };
                *q = q.map(|c| c * by);
            }
            case
        })
    };
    [1e-15, 1e-9, 9.9e-4].map(row).into()
}
