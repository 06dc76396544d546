//! Seeded clouds of points, chosen to break hull builders.

use hullcast_contact::workload;

/// The generator of the library, with the draws that the recorded cases were made with.
pub(crate) struct Random(workload::Random);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(workload::Random::new(seed))
    }

    pub(crate) fn bits(&mut self) -> u64 {
        self.0.bits()
    }

    /// A number in [-1, 1).
    pub(crate) fn signed(&mut self) -> f64 {
        self.0.within(-1.0, 1.0)
    }

    /// A number below `limit`, by the remainder: the recorded cases depend on it.
    pub(crate) fn below(&mut self, limit: usize) -> usize {
        (self.bits() % limit as u64) as usize
    }

    pub(crate) fn shuffle<T>(&mut self, items: &mut [T]) {
        for i in (1..items.len()).rev() {
            items.swap(i, self.below(i + 1));
        }
    }
}

pub(crate) type Points = Vec<[f64; 3]>;

/// A named cloud.
pub(crate) struct Cloud {
    pub(crate) name: String,
    pub(crate) points: Points,
}

/// The points rotated about a random axis by a random angle.
pub(crate) fn rotated(points: &[[f64; 3]], random: &mut Random) -> Points {
    let [x, y, z, w] = std::array::from_fn(|_| random.signed());
    let s = 2.0 / (x * x + y * y + z * z + w * w);
    let rows = [
        [1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
        [s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x)],
        [s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y)],
    ];
    points.iter().map(|p| rows.map(|r| r[0] * p[0] + r[1] * p[1] + r[2] * p[2])).collect()
}

pub(crate) fn scaled(points: &[[f64; 3]], by: [f64; 3]) -> Points {
    points.iter().map(|p| [p[0] * by[0], p[1] * by[1], p[2] * by[2]]).collect()
}

pub(crate) fn moved(points: &[[f64; 3]], by: [f64; 3]) -> Points {
    points.iter().map(|p| [p[0] + by[0], p[1] + by[1], p[2] + by[2]]).collect()
}

/// Every coordinate moved by up to `amount`.
pub(crate) fn noisy(points: &[[f64; 3]], amount: f64, random: &mut Random) -> Points {
    points.iter().map(|p| p.map(|c| c + amount * random.signed())).collect()
}

pub(crate) fn sphere(count: usize, random: &mut Random) -> Points {
    let mut points = Points::new();
    while points.len() < count {
        let p: [f64; 3] = std::array::from_fn(|_| random.signed());
        let length = (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]).sqrt();
        if (0.1..=1.0).contains(&length) {
            points.push(p.map(|c| c / length));
        }
    }
    points
}

pub(crate) fn ball(count: usize, random: &mut Random) -> Points {
    (0..count).map(|_| std::array::from_fn(|_| random.signed())).collect()
}

/// The corners of the box with half extents 1.
pub(crate) fn cube() -> Points {
    (0..8).map(|i| [0, 1, 2].map(|k| if i >> k & 1 == 1 { 1.0 } else { -1.0 })).collect()
}

/// A grid of points on the surface of the box with half extents 1, with `n + 1` points along each
/// edge.
pub(crate) fn box_grid(n: i32) -> Points {
    let mut points = Points::new();
    for (i, j, k) in (0..=n).flat_map(|i| (0..=n).flat_map(move |j| (0..=n).map(move |k| (i, j, k)))) {
        if [i, j, k].iter().any(|&c| c == 0 || c == n) {
            points.push([i, j, k].map(|c| 2.0 * f64::from(c) / f64::from(n) - 1.0));
        }
    }
    points
}

/// All integer points of a cube.
pub(crate) fn lattice(n: i32) -> Points {
    let range = move || -n..=n;
    let all = range().flat_map(|i| range().flat_map(move |j| range().map(move |k| [i, j, k])));
    all.map(|p| p.map(f64::from)).collect()
}

/// All integer points of a ball. Many of its facets are exactly coplanar, and many of its points
/// are exactly on one sphere.
pub(crate) fn lattice_ball(n: i32) -> Points {
    let mut points = lattice(n);
    points.retain(|p| p.iter().map(|c| c * c).sum::<f64>() <= f64::from(n * n));
    points
}

pub(crate) fn prism(sides: usize, half_height: f64) -> Points {
    let corner = |i: usize| {
        let angle = std::f64::consts::TAU * i as f64 / sides as f64;
        [angle.cos(), angle.sin()]
    };
    let ring = |z: f64| (0..sides).map(move |i| [corner(i)[0], corner(i)[1], z]);
    ring(-half_height).chain(ring(half_height)).collect()
}

/// Rings with the same number of points: the quads between the rings are planar only up to rounding.
pub(crate) fn globe(rings: usize, sides: usize) -> Points {
    let mut points = vec![[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]];
    for ring in 1..rings {
        let (radius, height) = (std::f64::consts::PI * ring as f64 / rings as f64).sin_cos();
        points.extend((0..sides).map(|i| {
            let angle = std::f64::consts::TAU * i as f64 / sides as f64;
            [radius * angle.cos(), radius * angle.sin(), height]
        }));
    }
    points
}

/// Groups of points on a sphere. The points of a group are about `spread` apart.
fn clusters(spread: f64, random: &mut Random) -> Points {
    let around = |p: &[f64; 3], random: &mut Random| noisy(&vec![*p; 12], spread, random);
    sphere(12, random).iter().flat_map(|p| around(p, random)).collect()
}

/// The clouds of the sweeps. Each of them has a valid hull.
pub(crate) fn clouds() -> Vec<Cloud> {
    let mut random = Random::new(20);
    let random = &mut random;
    let mut all = Vec::new();
    let mut add = |name: String, points: Points| all.push(Cloud { name, points });
    add("tetrahedron".into(), vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    add("cube".into(), cube());
    for count in [4, 5, 8, 16, 64, 256, 1024] {
        add(format!("sphere {count}"), sphere(count, random));
        add(format!("ball {count}"), ball(count, random));
    }
    for n in [2, 5, 12] {
        add(format!("box grid {n}"), box_grid(n));
        add(format!("box grid {n} turned"), rotated(&box_grid(n), random));
    }
    for sides in [3, 4, 6, 17, 100] {
        add(format!("prism {sides}"), prism(sides, 0.5));
        add(format!("prism {sides} turned"), rotated(&prism(sides, 0.5), random));
    }
    for n in [1, 2, 3, 5] {
        add(format!("lattice {n}"), lattice(n));
        add(format!("lattice ball {n}"), lattice_ball(n));
    }
    add("globe".into(), globe(12, 24));
    add("globe turned".into(), rotated(&globe(12, 24), random));
    for exponent in 1..=6 {
        let thin = 10_f64.powi(-exponent);
        for (name, by) in [("plate", [1.0, 0.7, thin]), ("needle", [1.0, thin, 0.6 * thin])] {
            for (shape, points) in [("box", cube()), ("sphere", sphere(60, random)), ("prism", prism(9, 1.0))]
            {
                let flat = scaled(&points, by);
                add(format!("{name} {shape} 1e{exponent} turned"), rotated(&flat, random));
                add(format!("{name} {shape} 1e{exponent}"), flat);
            }
        }
    }
    for exponent in 6..=15 {
        let amount = 10_f64.powi(-exponent);
        add(format!("noise 1e-{exponent} on a box grid"), noisy(&box_grid(6), amount, random));
        let turned = rotated(&prism(40, 0.3), random);
        add(format!("noise 1e-{exponent} on a prism"), noisy(&turned, amount, random));
        add(format!("clusters 1e-{exponent}"), clusters(amount, random));
    }
    for exponent in -9..=0 {
        // A flat roof on a box. Each of its two halves is inclined by an angle of about `height`.
        let (height, mut points) = (10_f64.powi(exponent), box_grid(4));
        points.extend((-4..=4).map(|i| [f64::from(i) / 4.0, 0.0, 1.0 + height]));
        add(format!("roof 1e{exponent}"), points);
    }
    let mut doubled = sphere(50, random);
    doubled.extend(doubled.clone());
    add("duplicates".into(), doubled);
    for exponent in [3, 6, 9, 12] {
        let offset = [10_f64.powi(exponent), -3.0 * 10_f64.powi(exponent), 7.0];
        add(format!("cube at 1e{exponent}"), moved(&cube(), offset));
        add(format!("sphere at 1e{exponent}"), moved(&sphere(80, random), offset));
    }
    for exponent in [-50, -23, -6, 6, 23, 49] {
        let size = 10_f64.powi(exponent);
        add(format!("sphere of 1e{exponent}"), scaled(&sphere(80, random), [size; 3]));
        add(format!("box grid of 1e{exponent}"), scaled(&box_grid(3), [size; 3]));
    }
    let mut tiny = sphere(60, random);
    tiny.iter_mut().zip(1..).for_each(|(p, i)| p[i % 3] = 5e-324 * i as f64);
    add("subnormal coordinates".into(), tiny);
    all
}

/// A random shape with up to three random distortions. Most of these clouds have a valid hull; some
/// are lines, planes, or too thin for double precision.
pub(crate) fn random_cloud(seed: u64) -> Points {
    let random = &mut Random::new(seed);
    let mut points = match random.below(8) {
        0 => {
            let (size, count) = (1 + random.below(4), 4 + random.below(60));
            let coordinate = |random: &mut Random| random.below(2 * size + 1) as f64 - size as f64;
            (0..count).map(|_| [(); 3].map(|()| coordinate(random))).collect()
        }
        1 => sphere(4 + random.below(100), random),
        2 => ball(4 + random.below(100), random),
        3 => prism(3 + random.below(60), 1.0),
        4 => box_grid(1 + random.below(6) as i32),
        5 => lattice_ball(1 + random.below(5) as i32),
        6 => globe(2 + random.below(8), 3 + random.below(12)),
        _ => clusters(10_f64.powi(-(random.below(17) as i32)), random),
    };
    for _ in 0..random.below(4) {
        points = distorted(&points, random);
    }
    points
}

fn distorted(points: &[[f64; 3]], random: &mut Random) -> Points {
    let share = |random: &mut Random, decades| 10_f64.powi(-(random.below(decades) as i32));
    match random.below(7) {
        0 => rotated(points, random),
        1 => scaled(points, [1.0, 1.0, share(random, 7)]),
        2 => scaled(points, [1.0, share(random, 4), share(random, 4)]),
        // Rounded as in meshes that were stored in single precision, or in whole millimetres.
        3 => points.iter().map(|p| p.map(|c| f64::from(c as f32))).collect(),
        4 => points.iter().map(|p| p.map(|c| (c * 1000.0).round() / 1000.0)).collect(),
        5 => noisy(points, 1e-3 * share(random, 14), random),
        _ => {
            let far = 1.0 / share(random, 10);
            moved(points, [far, 0.3, -far])
        }
    }
}
