//! Tests of which triangles count as one face.

use std::collections::BTreeSet;

use crate::check::{CheckCounts, check};
use crate::clouds::{Random, box_grid, noisy, prism, rotated, scaled, sphere};
use crate::hull;

/// Catches a merge of exactly coplanar triangles only, which leaves hundreds of facets on turned
/// shapes, and a fitted plane that is tilted.
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

/// Catches opposite faces, rims and neighbours of thin shapes that are merged. A tolerance that
/// depended only on the circumradius would merge the two sides of a plate into one face.
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

/// Catches noise below the tolerance that splits the six faces of a box, and points that are lost as
/// vertices.
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

/// Found by fuzzing; a fault of the check, not of the hull. An edge that is as short as the distance
/// by which a merged third face is off its plane can run in the other direction in the outline of
/// its neighbour.
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
    check(&points, &hull(&points), &mut CheckCounts::default());
}

/// Found by fuzzing; a fault of the check, not of the hull. If corners nearly coincide, two faces can
/// share an edge and a second edge along it: a fold thinner than the merge tolerance. One side of the
/// fold runs against the outlines.
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
    check(&points, &hull(&points), &mut CheckCounts::default());
}

/// Found by fuzzing: vertices that differed as points but coincided in hull units made a face without
/// area, whose outline bounded nothing.
#[test]
fn vertices_that_coincide_about_the_contraction_point_make_no_face() {
    let mut random = Random::new(12);
    let mut coinciding = 0;
    for size in [1e-10, 1e-15, 1e-18, 1e-40] {
        for _ in 0..40 {
            let mut points = vec![[1.0, 0.1, 0.0], [1.0, -1.0, 0.2], [0.5, 0.7, 1.0]];
            points.extend(scaled(&sphere(6, &mut random), [size; 3]));
            let hull = hull(&points);
            check(&points, &hull, &mut CheckCounts::default());
            assert!(hull.faces().iter().all(|face| face.area > 0.1 * size * size), "{size:e}");
            let places: BTreeSet<_> =
                hull.vertices().iter().map(|v| v.to_array().map(f64::to_bits)).collect();
            coinciding += usize::from(places.len() < hull.vertex_count());
        }
    }
    assert!(coinciding >= 80, "{coinciding}");
}

/// Found by fuzzing; a fault of the check, not of the hull. The line that two faces share goes back
/// for a part of its way, between vertices that are nearer to it than the merge tolerance. That part
/// is one of the edges.
#[test]
fn edges_that_fold_back_may_be_a_part_of_others() {
    let points = [
        [-9.1796875e30, -8.270612654572988e30, -3.982917136430708e30],
        [-9.1796875e30, 5.723441540500091e30, -7.176968686718244e30],
        [-6.179687499999999e30, -1.321594838037348e31, 1.199539390029902e31],
        [5.522155631427116e30, -1.647660897625489e30, -7.934721207176621e29],
        [9.179687499976725e30, 3.879125084283397e19, -6.206600134853435e19],
        [-8.992448270518076e30, 8.867622117530127e30, 4.993046119517969e29],
        [2.875331855001485e30, 1.7638461189428372e30, 3.1733296081289607e30],
        [-9.179705557133703e30, -4.086185359322447e30, -7.319910704323384e30],
        [-9.179688328068256e30, -5.019980579637524e30, 6.357239884469941e30],
        [9.179697248376146e30, -1.6247293577959213e25, 2.5995669724734742e25],
        [-6.179687499999999e30, -8.13217087981959e30, 1.3155732940051912e31],
        [-9.179687501741409e30, -2.0426726330247573e30, -8.94953357350034e30],
        [-9.179687500001977e30, 9.179687500003295e30, -5.272148382322616e18],
        [-4.5898437500232744e30, -6.20295949089095e30, -2.987187852385097e30],
        [-9.179687808058321e30, 9.179687617062162e30, 7.639846349242726e23],
        [-9.179687858678232e30, 5.723441676797823e30, 7.176969576240259e30],
        [-9.179687731405311e30, -8.27061256663897e30, -3.9829165625455364e30],
        [-9.179687770454957e30, -2.042672533154222e30, -8.94953289812829e30],
        [-9.179687828306285e30, 5.723441665256479e30, -7.176967872518655e30],
        [9.179687203511945e30, 1.126654608901273e23, 7.352903763355677e23],
        [-6.179687591115841e30, -1.321594834574946e31, 1.1995394126266308e31],
        [-9.179687842769117e30, -8.270612524320722e30, 3.982917986498121e30],
        [-9.17968788657958e30, -2.0426724531271295e30, 8.949534383975004e30],
        [9.179687316298759e30, 6.9836418241311936e22, 4.5545928909434455e23],
    ];
    check(&points, &hull(&points), &mut CheckCounts::default());
}
