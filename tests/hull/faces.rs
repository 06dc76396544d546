//! What counts as one face.

use std::collections::BTreeSet;

use crate::check::{Met, check};
use crate::clouds::{Random, box_grid, noisy, prism, rotated, scaled, sphere};
use crate::hull;

/// Exact merging alone leaves hundreds of facets on turned shapes.
#[test]
fn turned_boxes_and_prisms_keep_their_faces() {
    let mut random = Random::new(4);
    let grid = box_grid(30);
    assert_eq!(hull(&grid).vertex_count(), 8, "a point inside a face or an edge was kept");
    assert_eq!(hull(&prism(1000, 0.5)).face_count(), 1002);
    for _ in 0..3 {
        let box_hull = hull(&rotated(&grid, &mut random));
        assert_eq!((box_hull.face_count(), box_hull.edge_count()), (6, 12));
        assert!((0..6).all(|face| box_hull.outline(face).len() == 4));
        let prism_hull = hull(&rotated(&prism(1000, 0.5), &mut random));
        assert_eq!((prism_hull.face_count(), prism_hull.edge_count()), (1002, 3000));
        assert!(prism_hull.geometric_error() < 1e-14, "a fitted plane is tilted");
    }
}

/// Opposite faces, rims and neighbours of thin shapes stay apart: a tolerance
/// of the circumradius alone would make one face of a plate's two sides.
#[test]
fn thin_shapes_keep_their_faces() {
    let mut random = Random::new(5);
    for thin in [1.0, 1e-3, 1e-6, 1e-8] {
        for by in [[1.0, 0.7, thin], [1.0, thin, 0.6 * thin]] {
            let points = scaled(&prism(7, 1.0), by);
            assert_eq!(hull(&points).face_count(), 9, "{by:?}");
            assert_eq!(hull(&rotated(&points, &mut random)).face_count(), 9, "{by:?} turned");
        }
    }
}

/// Noise below the tolerance leaves a box's six faces; every point stays a
/// vertex that supports.
#[test]
fn noise_on_faces_merges() {
    let mut random = Random::new(6);
    let mut vertices = 0;
    for amount in [1e-15, 1e-12, 1e-9, 1e-7] {
        let points = noisy(&rotated(&box_grid(8), &mut random), amount, &mut random);
        let hull = hull(&points);
        assert_eq!(hull.face_count(), 6, "{amount:e}");
        assert!(hull.geometric_error() < 4.0 * amount + 1e-14);
        vertices += hull.vertex_count();
    }
    assert!(vertices > 200, "{vertices}");
}

/// Found by fuzzing, and none of the hull's: an edge as short as a third face, merged to
/// the tolerance, is off its plane runs the other way in its neighbour's outline.
#[test]
fn edges_within_a_merged_face_may_fold() {
    let [x, y] = [6.802236877180397e19, 5.7069614478038925e19];
    let points = [
        [3.6875, 3.09375, y],
        [5.573204538870989e16, 3.09375, 0.0],
        [0.0, 0.0, 0.78125],
        [126701535232.0, 0.0, 0.0],
        [3.09375, 3.09375, 0.0],
        [0.0, 3.09375, 3.09375],
        [3.6875, x, 6.642809450371482e16],
        [x, y, 0.0],
        [x, 3.6875, 1.7005592192950993e19],
        [3.09375, 0.0, 3.09375],
        [x, x, 114.0],
    ];
    check(&points, &hull(&points), &mut Met::default());
}

/// Found by fuzzing, and none of the hull's: where corners all but coincide, two faces may
/// meet along an edge and along it again, a fold thinner than the merge tolerance, of which
/// one side runs against the outlines.
#[test]
fn edges_beside_corners_that_nearly_coincide_may_fold_back() {
    let [x, y] = [6.802236877180397e19, 5.7069614478038925e19];
    let points = [
        [3.6875, 3.09375, y],
        [5.573204538870989e16, 3.09375, 0.0],
        [3.09375, 1.125, 3.34375],
        [0.0, 0.0, y],
        [99.0, 3.09375, 3.09375],
        [3.6875, x, 6.642809450371482e16],
        [x, 99.0, 0.0],
        [3.09375, 3.09375, 0.0],
        [3.09375, 3.09375, 0.375],
        [3.09375, 0.0, 3.09375],
        [0.0, 0.0, 3.09375],
        [3.09375, 0.0, 3.6875],
        [3.6875, 0.0, 3321888768.0],
        [y, 1.7005592192950993e19, 0.0],
    ];
    check(&points, &hull(&points), &mut Met::default());
}

/// Found by fuzzing: vertices that differ, but not once they are about the
/// contraction point, made a face of no area, whose outline bounded nothing.
#[test]
fn vertices_that_coincide_about_the_contraction_point_make_no_face() {
    let mut random = Random::new(12);
    let mut coinciding = 0;
    for size in [1e-10, 1e-15, 1e-18, 1e-40] {
        for _ in 0..40 {
            let mut points = vec![[1.0, 0.1, 0.0], [1.0, -1.0, 0.2], [0.5, 0.7, 1.0]];
            points.extend(scaled(&sphere(6, &mut random), [size; 3]));
            let hull = hull(&points);
            check(&points, &hull, &mut Met::default());
            assert!(hull.faces().iter().all(|face| face.area > 0.1 * size * size), "{size:e}");
            let places: BTreeSet<_> =
                hull.vertices().iter().map(|v| v.to_array().map(f64::to_bits)).collect();
            coinciding += usize::from(places.len() < hull.vertex_count());
        }
    }
    assert!(coinciding >= 80, "{coinciding}");
}
