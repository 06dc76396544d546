//! Tests of stopping a build, and of the steps that a build counts.

use hullcast_contact::{
    BuildError, ConvexHull, HullOptions, STEPS_BETWEEN_LOOKS, Simplification, Stop,
    hull::{HullError, HullErrorKind},
};

use crate::clouds::{Points, Random, ball, box_grid, noisy, prism, rotated, scaled, sphere};

/// Clouds and options that together take every step of a build: exact predicates, integers of any
/// length, merged faces, a map of directions, duplicates, and simplification with one hull and with
/// many hulls that are tried.
fn builds() -> Vec<(&'static str, Points, HullOptions)> {
    let mut random = Random::new(91);
    let simplified = |max_vertices, max_deviation, contraction_point| HullOptions {
        contraction_point,
        simplification: Some(Simplification { max_vertices, max_deviation }),
        ..HullOptions::default()
    };
    let plain = HullOptions::default();
    let round = sphere(2000, &mut random);
    let near = round[17].map(|c| 0.999 * c);
    let cloud = ball(60_000, &mut random);
    vec![
        ("sphere", sphere(16_384, &mut random), plain),
        ("prism", rotated(&prism(4096, 0.3), &mut random), plain),
        ("box grid", noisy(&box_grid(40), 1e-15, &mut random), plain),
        ("tiny", scaled(&sphere(300, &mut random), [1e-48, 1e-49, 1e-48]), plain),
        ("duplicates", [cloud.clone(), cloud].concat(), plain),
        ("fewer", round.clone(), simplified(Some(1000), None, None)),
        ("about a corner", round, simplified(None, Some(1.0), Some(near))),
    ]
}

/// Catches a loop that counts no steps, a loop that does too many steps between two checks of the
/// flag, and a count that depends on more than the input.
#[test]
fn builds_look_at_the_flag_about_once_a_millisecond() {
    for (name, points, options) in builds() {
        let stop = Stop::default();
        let hull = ConvexHull::with_options_stoppable(&points, &options, &stop).unwrap();
        println!("{name}: {} steps, {} at once", stop.steps(), stop.largest_between_looks());
        assert!(stop.steps() > 20 * points.len() as u64, "{name}");
        assert!(stop.largest_between_looks() <= STEPS_BETWEEN_LOOKS, "{name}");
        let again = Stop::default();
        assert_eq!(ConvexHull::with_options_stoppable(&points, &options, &again), Ok(hull), "{name}");
        assert_eq!(again.steps(), stop.steps(), "{name}");
    }
}

/// Catches a step of the build that goes on although the build was asked to stop. Builds are stopped
/// from the start, and by another thread after each tenth of their steps.
#[test]
fn a_stopped_build_ends() {
    let mut stopped_on_the_way = 0;
    for (name, points, options) in builds() {
        let whole = Stop::default();
        ConvexHull::with_options_stoppable(&points, &options, &whole).unwrap();
        for tenth in 0..10 {
            let stop = Stop::default();
            if tenth == 0 {
                stop.stop();
            }
            let (built, at) = std::thread::scope(|scope| {
                let build = scope.spawn(|| ConvexHull::with_options_stoppable(&points, &options, &stop));
                while stop.steps() < whole.steps() / 10 * tenth && !build.is_finished() {
                    std::thread::yield_now();
                }
                stop.stop();
                let at = stop.steps();
                (build.join().unwrap(), at)
            });
            // Steps up to the next check of the flag, and those spent last.
            assert!(stop.steps() <= at + 2 * STEPS_BETWEEN_LOOKS, "{name}: {at}, {}", stop.steps());
            match built {
                Err(BuildError::Stopped) => stopped_on_the_way += usize::from(tenth > 0),
                Ok(hull) => assert!(tenth > 0 && hull.vertex_count() > 3, "{name}"),
                Err(BuildError::Hull(error)) => panic!("{name}: {error}"),
            }
        }
    }
    // It depends on the machine which of the small builds end before they are stopped.
    assert!(stopped_on_the_way > 10, "{stopped_on_the_way}");
}

/// Catches a refusal that is reported as a stop, and a stop that is reported as a refusal.
#[test]
fn a_refusal_is_no_stop() {
    let flat = prism(5, 0.0);
    let refused = ConvexHull::with_options_stoppable(&flat, &HullOptions::default(), &Stop::default());
    let Err(BuildError::Hull(HullError { kind, .. })) = refused else { panic!("{refused:?}") };
    assert_eq!(kind, HullErrorKind::Coplanar);
    let stop = Stop::default();
    stop.stop();
    let hull = sphere(5000, &mut Random::new(5));
    let stopped = ConvexHull::with_options_stoppable(&hull, &HullOptions::default(), &stop);
    assert_eq!(stopped, Err(BuildError::Stopped));
}

/// Catches a simplification that examines all vertices for each vertex, or builds a hull for each
/// vertex. Twice the vertices must take less than three times the steps; a quadratic algorithm would
/// take four times.
#[test]
fn simplification_takes_little_more_than_its_vertices() {
    let steps = |count: usize, near_a_corner: bool| {
        let points = sphere(count, &mut Random::new(3));
        let point = points[count - 1].map(|c| c * (1.0 - 2.0 / count as f64));
        let contraction_point = near_a_corner.then_some(point);
        let (max_vertices, max_deviation) =
            if near_a_corner { (None, Some(1.0)) } else { (Some(count as u32 - 1), None) };
        let simplification = Some(Simplification { max_vertices, max_deviation });
        let options = HullOptions { contraction_point, simplification, ..HullOptions::default() };
        let stop = Stop::default();
        let hull = ConvexHull::with_options_stoppable(&points, &options, &stop).unwrap();
        println!("{count} vertices, {} left: {} steps", hull.vertex_count(), stop.steps());
        stop.steps()
    };
    let mut before = steps(512, false);
    for count in [1024, 2048, 4096] {
        let now = steps(count, false);
        assert!(now < 3 * before, "{now} after {before}");
        // Only about a logarithmic number of the hulls that could be tried on the way is built.
        assert!(steps(count, true) < 2 * now);
        before = now;
    }
}
