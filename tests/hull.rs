//! Hulls, checked against the definitions alone.

use hullcast::contact::hull::ConvexHull;

/// The unit cube's counts, sizes and numbering by hand: a wrong orientation,
/// scale or merge shows here first.
#[test]
fn a_cube_is_known_by_hand() {
    let cube: Vec<[f64; 3]> =
        (0..8).map(|i| [0, 1, 2].map(|k| if i >> k & 1 == 1 { 1.0 } else { -1.0 })).collect();
    let hull = ConvexHull::new(&cube).unwrap();
    assert_eq!((hull.vertex_count(), hull.face_count(), hull.edge_count()), (8, 6, 12));
    assert_eq!((hull.volume(), hull.scale()), (8.0, 2.0));
    assert!((1.0 - 1e-14..=1.0).contains(&hull.inradius()));
    for face in 0..6 {
        assert_eq!((hull.outline(face).len(), hull.face_neighbours(face).len()), (4, 4));
        let normal = hull.face_normal(face);
        let corners: Vec<_> = hull.outline(face).iter().map(|&v| hull.vertices()[v as usize]).collect();
        assert!(corners.iter().all(|c| c.dot(normal) == 0.5));
        assert!((corners[1] - corners[0]).cross(corners[2] - corners[1]).dot(normal) > 0.0);
    }
    for (ends, faces) in hull.edge_vertices().iter().zip(hull.edge_faces()) {
        let left = hull.outline(faces[0] as usize);
        let place = left.iter().position(|v| *v == ends[0]).unwrap();
        assert_eq!(left[(place + 1) % 4], ends[1]);
    }
}
