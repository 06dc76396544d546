//! Compares simplified hulls with a recording (tests/golden/simplified.txt).
//!
//! The store keeps the definition of a hull, and the hull is simplified again whenever it is
//! loaded. So a definition has to give the same hull, bit for bit, in every later version.

use std::fmt::Write;

use hullcast_contact::{ConvexHull, HullError, HullOptions, Simplification};

use crate::clouds::{Points, Random, ball, box_grid, cube, lattice_ball, moved, rotated, scaled, sphere};

/// The definition of a simplified hull.
struct Definition {
    name: String,
    points: Points,
    options: HullOptions,
}

/// A ring of radius 1 at height `z`, made of rational points of the circle. Sine and cosine differ
/// between machines; these divisions do not.
fn ring(sides: usize, z: f64) -> Points {
    let point = |i: usize| {
        // `t` runs from -1 to 1 over one half of the circle. The other half is opposite.
        let half = sides.div_ceil(2);
        let t = 2.0 * (i % half) as f64 / half as f64 - 1.0;
        let [x, y] = [(1.0 - t * t) / (1.0 + t * t), 2.0 * t / (1.0 + t * t)];
        if i < half { [x, y, z] } else { [-x, -y, z] }
    };
    (0..sides).map(point).collect()
}

fn cylinder(sides: usize, half_height: f64) -> Points {
    [ring(sides, -half_height), ring(sides, half_height)].concat()
}

/// A bowl that is nearly flat: its height is a thousandth of the squared distance from its middle.
fn bowl(side: i32) -> Points {
    let along = move || (-side..=side).map(f64::from);
    along().flat_map(|x| along().map(move |y| [x, y, 0.001 * (x * x + y * y)])).collect()
}

/// Two dense patches far apart.
fn dumbbell(count: usize, random: &mut Random) -> Points {
    let end = |x: f64, random: &mut Random| moved(&scaled(&sphere(count, random), [0.02; 3]), [x, 0.0, 0.0]);
    [end(-1.0, random), end(1.0, random)].concat()
}

/// One shape of each family. The seed varies size, position and rotation.
fn shapes(seed: u64) -> Vec<(&'static str, Points)> {
    let mut random = Random::new(seed);
    // The last two seeds make large hulls.
    let count = if seed < 3 { 40 + random.below(160) } else { 600 + random.below(900) };
    let mut shapes = vec![
        ("sphere", sphere(count, &mut random)),
        ("cloud", ball(4 * count, &mut random)),
        ("cylinder", cylinder(count / 2, 0.4)),
        ("plate", cylinder(count / 2, 1e-3)),
        ("needle", scaled(&sphere(count, &mut random), [1.0, 0.01, 0.003])),
        ("box with points", [cube(), scaled(&sphere(count, &mut random), [1.02; 3])].concat()),
        ("bowl", bowl(3 + 3 * seed as i32)),
        ("dumbbell", dumbbell(count / 2, &mut random)),
        ("lattice ball", lattice_ball(4 + (seed % 3) as i32)),
        ("box grid", box_grid(3)),
    ];
    for (_, points) in &mut shapes {
        if random.below(2) == 0 {
            *points = rotated(points, &mut random);
        }
        if random.below(3) == 0 {
            let [x, y, z] = std::array::from_fn(|_| 30.0 * random.signed());
            *points = moved(points, [x, y, z]);
        }
    }
    shapes
}

/// 200 definitions: ten families, five seeds, four simplifications.
fn definitions() -> Vec<Definition> {
    let mut definitions = Vec::new();
    for seed in 0..5 {
        for (family, points) in shapes(seed) {
            let Ok(whole) = ConvexHull::new(&points) else { continue };
            let (count, size) = (whole.vertex_count() as u32, whole.circumradius());
            let centre = whole.center_of_mass().to_array();
            // A point between the centre and a vertex is inside the whole hull, but outside most of
            // the hulls that are tried on the way.
            let vertex = points[whole.registered_indices()[count as usize / 2] as usize];
            let near = |share: f64| Some([0, 1, 2].map(|k| centre[k] + share * (vertex[k] - centre[k])));
            let cases = [
                (Some((count / 2).max(4)), None, None),
                (None, Some([0.1, 0.03, 0.01, 0.003, 0.001][seed as usize] * size), None),
                (Some((3 * count / 4).max(4)), Some(0.2 * size), near(0.3)),
                (None, Some(0.5 * size), near([0.8, 0.9, 0.97, 0.99, 0.999][seed as usize])),
            ];
            for (max_vertices, max_deviation, contraction_point) in cases {
                let simplification = Some(Simplification { max_vertices, max_deviation });
                let options = HullOptions { contraction_point, simplification, ..HullOptions::default() };
                let name = format!("{family}, seed {seed}, case {}", definitions.len() % 4);
                definitions.push(Definition { name, points: points.clone(), options });
            }
        }
    }
    definitions
}

/// A digest (FNV-1a) of everything that a query reads of a hull.
fn digest(hull: &ConvexHull) -> u64 {
    let mut digest = 0xcbf2_9ce4_8422_2325_u64;
    let mut add = |bits: u64| {
        for byte in bits.to_le_bytes() {
            digest = (digest ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3);
        }
    };
    hull.registered_indices().iter().for_each(|&i| add(u64::from(i)));
    hull.vertices().iter().flat_map(|v| v.to_array()).for_each(|c| add(c.to_bits()));
    for (i, face) in hull.faces().iter().enumerate() {
        face.normal.to_array().iter().chain(&[face.offset, face.area]).for_each(|c| add(c.to_bits()));
        hull.face_outline(i).for_each(|v| add(u64::from(v)));
    }
    let lengths = [hull.inradius(), hull.circumradius(), hull.volume(), hull.deviation()];
    lengths.iter().for_each(|length| add(length.to_bits()));
    digest
}

fn line(definition: &Definition, built: &Result<ConvexHull, HullError>) -> String {
    let mut line = format!("{}: ", definition.name);
    let written = match built {
        Ok(hull) => {
            let (vertices, deviation) = (hull.vertex_count(), hull.deviation().to_bits());
            write!(line, "{vertices} vertices, deviation {deviation:016x}, digest {:016x}", digest(hull))
        }
        Err(error) => write!(line, "{}", error.kind.reason()),
    };
    written.expect("writing to a String cannot fail");
    line
}

fn lines() -> Vec<String> {
    let built = |d: &Definition| line(d, &ConvexHull::with_options(&d.points, &d.options));
    definitions().iter().map(built).collect()
}

/// Catches every change of the hull that a stored definition is simplified to: a different vertex
/// that is taken, a distance that is rounded differently, a build that is tried earlier or later.
#[test]
fn simplified_hulls_are_those_recorded() {
    let recorded = include_str!("../../../../tests/golden/simplified.txt");
    let found = lines();
    assert_eq!(found.len(), 200);
    assert!(found.iter().filter(|line| line.contains("digest")).count() >= 150);
    for (found, recorded) in found.iter().zip(recorded.lines()) {
        assert_eq!(found, recorded);
    }
    assert_eq!(recorded.lines().count(), 200);
}

/// Prints the content of tests/golden/simplified.txt. The file may change only together with the
/// version of the identity.
#[test]
#[ignore = "prints the recorded file anew"]
fn print_simplified_hulls() {
    lines().iter().for_each(|line| println!("recorded {line}"));
}
