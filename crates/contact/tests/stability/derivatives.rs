//! Derivatives of answers, compared with exact arithmetic: by translation with exact finite steps, by rotation
//! with differences that shrink, at kinks with the definition of the generalised gradient.

use std::rc::Rc;

use glam::{DQuat, DVec3};
use hullcast_contact::{
    Basis, ConvexHull, Derivatives, KinkScratch, Manifold, Query, Workspace, contact_manifold, derivatives,
};

use crate::case::{Shape, any_shape};
use crate::exact::quotient;
use crate::oracle::{Corner, Exact, Growth, Placed};
use crate::scene::{IDENTITY, Random, at, box_points, cloud, prism_points, scaled};

/// Two shapes at poses.
#[derive(Clone)]
struct Posed {
    shapes: [Rc<Shape>; 2],
    positions: [[f64; 3]; 2],
    rotations: [[f64; 4]; 2],
}

impl Posed {
    fn new(shapes: [Rc<Shape>; 2], d: [f64; 3], rotations: [[f64; 4]; 2]) -> Self {
        Self { shapes, positions: [[0.0; 3], d], rotations }
    }

    /// The ray meets the thinnest triangular face of A in its middle, one of B's vertices beyond it.
    fn at_thinnest_face(shapes: [Rc<Shape>; 2], rotations: [[f64; 4]; 2], alpha: f64) -> Self {
        let [(a, turn_a), (b, turn_b)] = [0, 1].map(|i| (&shapes[i].hull, DQuat::from_array(rotations[i])));
        let vertex = |hull: &ConvexHull, v: usize| hull.vertices()[v] * hull.scale();
        let corners = |f: usize| a.outline(f).iter().map(|&v| vertex(a, v as usize)).collect::<Vec<_>>();
        let height = |f: usize| match corners(f)[..] {
            [u, v, w] => {
                let longest = u.distance(v).max(v.distance(w)).max(w.distance(u));
                (v - u).cross(w - u).length() / longest
            }
            _ => f64::INFINITY,
        };
        let face = (0..a.face_count()).min_by(|&f, &g| height(f).total_cmp(&height(g))).expect("a face");
        let outline = corners(face);
        let middle = turn_a * (outline.iter().sum::<DVec3>() / outline.len() as f64);
        let n = turn_a * a.faces()[face].normal;
        let tips = (0..b.vertex_count()).map(|v| turn_b * vertex(b, v));
        let tip = tips.min_by(|u, v| n.dot(*u).total_cmp(&n.dot(*v))).expect("a vertex");
        let d = (middle - tip) * alpha + turn_a * a.contraction_point() - turn_b * b.contraction_point();
        Self::new(shapes, d.to_array(), rotations)
    }

    fn solve(&self) -> (Manifold, Derivatives) {
        let [a, b] = [0, 1].map(|i| at(&self.shapes[i].hull, self.positions[i], self.rotations[i]));
        let query = Query { margin: f64::INFINITY, ..Query::default() };
        let manifold = contact_manifold(&a, &b, &query, None, &mut Workspace::default()).clone();
        let found = derivatives(&a, &b, &manifold, &mut KinkScratch::default()).expect("a basis");
        (manifold, found)
    }

    fn exact(&self) -> Exact {
        Exact::new([0, 1].map(|i| Placed {
            points: &self.shapes[i].points,
            hull: &self.shapes[i].hull,
            position: self.positions[i],
            rotation: self.rotations[i],
        }))
    }

    fn moved(&self, t: [f64; 3]) -> Self {
        let mut moved = self.clone();
        moved.positions[1] = std::array::from_fn(|k| self.positions[1][k] + t[k]);
        moved
    }

    /// The body rotated about `axis`, a unit vector, by the angle whose half has this tangent.
    fn rotated(&self, side: usize, axis: usize, tangent: f64) -> Self {
        let mut rotated = self.clone();
        let [x, y, z, w] = self.rotations[side];
        let mut turn = [0.0; 3];
        turn[axis] = tangent;
        let [i, j, k] = turn;
        rotated.rotations[side] = [
            x + i * w + j * z - k * y,
            y + j * w + k * x - i * z,
            z + k * w + i * y - j * x,
            w - i * x - j * y - k * z,
        ];
        rotated
    }

    /// The length by which rotations are scaled in [`Derivatives::error`].
    fn reach(&self, alpha: f64) -> f64 {
        let hulls = self.shapes.each_ref().map(|shape| &shape.hull);
        let offset = hulls.map(|h| h.contraction_point().length()).into_iter().fold(0.0, f64::max);
        offset + (hulls[0].circumradius() + hulls[1].circumradius()) * alpha.max(1.0)
    }
}

fn corners(basis: &Basis) -> [Corner; 3] {
    [0, 1, 2].map(|i| [basis.a[i] as usize, basis.b[i] as usize])
}

fn block(row: &[f64; 9], i: usize) -> DVec3 {
    DVec3::from_slice(&row[3 * i..3 * i + 3])
}

/// The exact growth scale of `new` minus that of `old`, rounded once.
fn difference(new: &Growth, old: &Growth) -> f64 {
    quotient(&(&new.num * &old.den - &old.num * &new.den), &(&new.den * &old.den), 0)
}

/// A pair of random shapes with a growth scale between about 0.3 and 2. Its coordinates are multiples of
/// 2^-20, so that moving it by such a multiple rounds nothing.
fn random_pair(random: &mut Random) -> Posed {
    let shapes = [any_shape(random), any_shape(random)];
    let length = random.range(0.3, 2.0);
    let d = random.direction().map(|x| coarse(x * length));
    Posed::new(shapes, d, [random.rotation(), random.rotation()])
}

fn coarse(x: f64) -> f64 {
    let unit = f64::from(1 << 20);
    (x * unit).round() / unit
}

/// While the basis stays optimal, the growth scale changes by exactly the gradient times the step, however
/// long the step is. Catches a wrong plane, a wrong unit, and a wrong sign.
#[test]
fn by_translation_alpha_is_linear_on_the_cone_of_a_basis() {
    let random = &mut Random::new(21);
    let mut steps = [0; 3];
    for _ in 0..600 {
        let pair = random_pair(random);
        let (manifold, found) = pair.solve();
        let basis = corners(manifold.basis.as_ref().expect("a basis"));
        let here = pair.exact().growth(Some(basis));
        let g = block(&found.alpha, 0);
        for (taken, length) in steps.iter_mut().zip([1e-3, 1e-2, 1e-1]) {
            let t = random.direction().map(|x| coarse(x * length));
            let there = pair.moved(t).exact().growth(Some(basis));
            if here.pivots + there.pivots > 0 {
                continue;
            }
            let t = DVec3::from(t);
            let off = (difference(&there, &here) - g.dot(t)).abs();
            assert!(off <= (found.error + 8.0 * f64::EPSILON) * g.length() * t.length(), "{off:e} {found:?}");
            *taken += 1;
        }
    }
    assert!(steps[0] > 500 && steps[1] > 400 && steps[2] > 100, "{steps:?}");
}

/// Central differences approach the derivative as the step shrinks: those of alpha in exact arithmetic, those
/// of separation and normal by the answers. Catches a lever about the wrong point, a row in the wrong axes,
/// and a term that is left out. Four steps down by 8 must shrink the error by 16 at least.
#[test]
fn by_rotation_differences_shrink_to_the_derivative() {
    let random = &mut Random::new(22);
    let mut compared = 0;
    for _ in 0..400 {
        let pair = random_pair(random);
        let (manifold, found) = pair.solve();
        let basis = corners(manifold.basis.as_ref().expect("a basis"));
        let (side, axis) = (random.below(2), random.below(3));
        let column = 3 + 3 * side + axis;
        let expected = [
            found.alpha[column],
            found.separation[column],
            found.normal[0][column],
            found.normal[1][column],
            found.normal[2][column],
        ];
        let errors: Option<Vec<[f64; 5]>> = [2f64.powi(-7), 2f64.powi(-10), 2f64.powi(-13)]
            .into_iter()
            .map(|tangent| {
                let [more, less] = [tangent, -tangent].map(|t| pair.rotated(side, axis, t));
                let [up, down] = [&more, &less].map(|p| p.exact().growth(Some(basis)));
                // At another basis the derivative is another one.
                if up.pivots + down.pivots > 0 {
                    return None;
                }
                let angle = 4.0 * tangent.atan();
                let [m, l] = [more.solve().0, less.solve().0];
                let n = (m.normal - l.normal) / angle;
                let slopes =
                    [difference(&up, &down) / angle, (m.separation - l.separation) / angle, n.x, n.y, n.z];
                Some(std::array::from_fn(|i| (slopes[i] - expected[i]).abs()))
            })
            .collect();
        let Some(errors) = errors else { continue };
        for (i, value) in expected.iter().enumerate() {
            // The answers' own rounding, divided by the step.
            let floor = 1e-11 * (1.0 + value.abs()) + 1e4 * found.error;
            for step in errors.windows(2) {
                assert!(step[1][i] <= step[0][i] / 16.0 + floor, "{i}: {errors:?} {found:?}");
            }
            assert!(errors[2][i] <= 1e-3 * (1.0 + value.abs()), "{i}: {errors:?} {found:?}");
        }
        compared += 1;
    }
    assert!(compared > 250, "{compared}");
}

/// A rotation of both bodies together about A's origin, with B's origin moved along, changes neither alpha nor
/// separation and turns the normal; all within the stated error. Catches rows that contradict each other,
/// and an error that is stated too small for separation and normal.
fn check_common_rotation(pair: &Posed, alpha: f64, n: DVec3, found: &Derivatives) {
    let offset = DVec3::from(pair.positions[1]) - DVec3::from(pair.positions[0]);
    let reach = pair.reach(alpha);
    for (row, scale) in [(&found.alpha, block(&found.alpha, 0).length()), (&found.separation, 1.0)] {
        // t = w x offset, so g.t = w.(offset x g).
        let left = block(row, 1) + block(row, 2) + offset.cross(block(row, 0));
        let allowed = (2.0 * found.error + 64.0 * f64::EPSILON) * scale * (reach + offset.length());
        assert!(left.length() <= allowed, "{left} {allowed:e} {found:?}");
    }
    for (k, axis) in DVec3::AXES.into_iter().enumerate() {
        let turned = axis.cross(n);
        for (row, turned) in found.normal.iter().zip(turned.to_array()) {
            let off = (row[3 + k] + row[6 + k] - turned).abs();
            assert!(off <= 2.0 * found.error + 8.0 * f64::EPSILON, "{off:e} {found:?}");
        }
    }
}

/// On large facets, on tiny ones, and on slivers the gradient of alpha is off by at most the stated error, and
/// the stated error follows the condition of the basis. Catches a bound that forgets a factor, and a formula
/// that loses more than its bound.
#[test]
fn the_error_bound_holds_on_nearly_flat_bases() {
    let random = &mut Random::new(23);
    let sliver = |random: &mut Random, width: f64| {
        let mut points = cloud(random, 12, [1.0, 0.8, 0.6]);
        let beside: Vec<_> =
            points.iter().map(|p| [p[0] + width * random.range(0.5, 1.0), p[1], p[2]]).collect();
        points.extend(beside);
        Shape::new(points)
    };
    let (mut flat, mut worst) = ([0; 3], 0.0_f64);
    for round in 0..600 {
        let mut shape = || match round % 6 {
            0 => any_shape(random),
            1 => Shape::new(cloud(random, 400, [1.0, 0.7, 0.5])),
            2 => sliver(random, 1e-2),
            3 => sliver(random, 1e-4),
            4 => Shape::new(prism_points(100, 1.0, 0.3)),
            _ => Shape::new(cloud(random, 60, [1.0, 1.0, 0.02])),
        };
        let shapes = [shape(), shape()];
        let (alpha, rotations) = (random.range(0.3, 2.0), [random.rotation(), random.rotation()]);
        let mut pair = Posed::at_thinnest_face(shapes, rotations, alpha);
        pair.positions = pair.positions.map(|p| std::array::from_fn(|k| p[k] + [3.0, -2.0, 1.0][k]));
        let (manifold, found) = pair.solve();
        let exact = pair.exact().gradient(corners(manifold.basis.as_ref().expect("a basis")));
        let (g, reach) = (block(&exact, 0).length(), pair.reach(manifold.alpha));
        for (i, scale) in [g, g * reach, g * reach].into_iter().enumerate() {
            let off = (block(&found.alpha, i) - block(&exact, i)).length() / scale;
            assert!(off <= found.error, "round {round}, {i}: {off:e} {found:?}");
            worst = worst.max(off / found.error);
        }
        check_common_rotation(&pair, manifold.alpha, manifold.normal, &found);
        for (count, least) in flat.iter_mut().zip([0.0, 1e-10, 1e-8]) {
            *count += usize::from(found.error > least);
        }
    }
    println!("with errors above 0, 1e-10, 1e-8: {flat:?}; at worst {worst:.3} of the bound");
    assert!(flat[0] == 600 && flat[1] > 150 && flat[2] > 50, "{flat:?}");
}

/// A rotation by an eighth of a turn about an axis.
fn eighth(axis: usize) -> [f64; 4] {
    let (sine, cosine) = std::f64::consts::FRAC_PI_8.sin_cos();
    let mut q = [0.0, 0.0, 0.0, cosine];
    q[axis] = sine;
    q
}

fn octahedron() -> Rc<Shape> {
    let tips = (0..6)
        .map(|i| std::array::from_fn(|k| if k == i / 2 { 1.0 - 2.0 * f64::from(i as u8 % 2) } else { 0.0 }));
    Shape::centred(tips.collect())
}

/// Pairs with one known facet each, and whether their gradient is unique.
fn planted() -> Vec<(&'static str, Posed, bool)> {
    let cube = Shape::centred(box_points([1.0; 3]));
    let upright = [IDENTITY; 2];
    let cubes = |d, rotations| Posed::new([cube.clone(), cube.clone()], d, rotations);
    // The tip of the octahedron on the top face of the cube: the facet is the face, one higher.
    let tip = |x: f64, y: f64| Posed::new([cube.clone(), octahedron()], scaled([x, y, 2.0], 0.875), upright);
    let tips = |d| Posed::new([octahedron(), octahedron()], d, upright);
    // B's edge along y, or along x, on A's edge along x.
    let edges = |axis, d| cubes(d, [eighth(0), eighth(axis)]);
    vec![
        ("face on face", cubes([0.3, 0.2, 1.9], upright), true),
        ("face on face, over a corner", cubes([1.5, 1.25, 1.9], upright), true),
        ("edge on face", cubes([0.3, 0.2, 2.3], [IDENTITY, eighth(0)]), true),
        ("edge along edge", edges(0, [0.25, 0.0, 2.7]), true),
        ("ray through a side of the facet", tip(1.0, 0.25), true),
        ("ray through a corner of the facet", tip(1.0, 1.0), true),
        ("tip on tip", tips([0.0, 0.0, 1.875]), true),
        ("ray through an edge of both", tips([0.5, 0.0, 1.375]), true),
        ("coincident centres", cubes([0.0; 3], [IDENTITY, eighth(2)]), true),
        ("vertex on a quad", tip(0.5, 0.25), false),
        ("vertex on a quad, on its diagonal", tip(0.5, 0.5), false),
        ("vertex on a quad, in its centre", tip(0.0, 0.0), false),
        ("edge on edge", edges(1, [0.3, 0.2, 2.7]), false),
        ("edge on edge, on the diagonal", edges(1, [0.25, 0.25, 2.7]), false),
        ("edge on edge, in the middle", edges(1, [0.0, 0.0, 2.7]), false),
    ]
}

/// Every planted kink is flagged, and nothing else. Catches a rule by weights or by coplanar vertices, which
/// flags edges on edges and diagonals.
#[test]
fn planted_kinks_are_flagged_and_others_are_not() {
    for (name, pair, expected) in planted() {
        assert_eq!(pair.solve().1.kink, expected, "{name}");
    }
    // Almost no random pair is at a kink.
    let random = &mut Random::new(24);
    let kinks = (0..2000).filter(|_| random_pair(random).solve().1.kink).count();
    assert!(kinks <= 2, "{kinks}");
}

/// At a kink, the gradient is that of one optimal basis. Alpha is convex in the translation, so it lies nowhere
/// below its linear approximation, and the whole gradient lies in the convex hull of the gradients at poses
/// nearby: along no direction is it beyond all of them. Catches a gradient at a kink that belongs to no optimal facet.
#[test]
fn a_gradient_at_a_kink_is_of_the_generalised_gradient() {
    let random = &mut Random::new(25);
    let (mut steps, mut limits) = (0, 0);
    for (name, pair, kink) in planted() {
        let (manifold, found) = pair.solve();
        let g = block(&found.alpha, 0);
        let here = pair.exact().growth(None);
        for length in [1e-6, 1e-3, 0.3] {
            for _ in 0..10 {
                let t = random.direction().map(|x| x * length);
                let moved = pair.moved(t);
                let t = DVec3::from(moved.positions[1]) - DVec3::from(pair.positions[1]);
                let below = g.dot(t) - difference(&moved.exact().growth(None), &here);
                assert!(below <= 1e-14 * g.length() * (1.0 + t.length()), "{name}: {below:e}");
                steps += 1;
            }
        }
        let near = |random: &mut Random| {
            let mut near = pair.moved(random.direction().map(|x| x * 1e-7));
            for (side, axis) in (0..2).flat_map(|side| [0, 1, 2].map(|axis| (side, axis))) {
                near = near.rotated(side, axis, random.range(-1e-7, 1e-7));
            }
            near.solve().1
        };
        // With coincident centres any direction is optimal, and few of those nearby are this one.
        if manifold.flags.coincident {
            continue;
        }
        let nearby: Vec<Derivatives> = (0..500).map(|_| near(random)).collect();
        for _ in 0..200 {
            let along: [f64; 9] = std::array::from_fn(|_| random.range(-1.0, 1.0));
            let value = |found: &Derivatives| along.iter().zip(&found.alpha).map(|(x, y)| x * y).sum::<f64>();
            let highest = nearby.iter().map(value).fold(f64::NEG_INFINITY, f64::max);
            assert!(value(&found) <= highest + 1e-5, "{name}: {found:?}");
        }
        let close = |other: &Derivatives| (0..9).all(|k| (other.alpha[k] - found.alpha[k]).abs() < 1e-5);
        assert!(kink || nearby.iter().all(|other| close(other) && !other.kink), "{name}: {found:?}");
        limits += 1;
    }
    assert!(steps == 15 * 30 && limits == 14, "{steps} {limits}");
}
