//! The measured shapes, and how files round their coordinates.

use std::f64::consts::TAU;

pub(crate) type Points = Vec<[f64; 3]>;

/// Shapes of one kind.
pub(crate) struct Group {
    pub(crate) name: String,
    pub(crate) shapes: Vec<Points>,
    /// One in this many of the orientations is measured.
    pub(crate) thinned: usize,
}

impl Group {
    fn new(name: &str, shapes: Vec<Points>) -> Self {
        Self { name: name.to_owned(), shapes, thinned: 1 }
    }
}

/// Boxes, prisms, barrels, frusta, fine cylinders, and the links of two robots; in metres.
pub(crate) fn groups() -> Vec<Group> {
    let stack = |sides: usize, rings: &[(f64, f64)]| -> Points {
        let corner = |i: usize| (TAU * i as f64 / sides as f64).sin_cos();
        let ring = |&(radius, z): &(f64, f64)| {
            (0..sides).map(move |i| [radius * corner(i).1, radius * corner(i).0, z]).collect::<Points>()
        };
        rings.iter().flat_map(ring).collect()
    };
    vec![
        Group::new("boxes", vec![cuboid([0.04; 3]), cuboid([0.3, 0.2, 0.05]), cuboid([1.0; 3])]),
        Group::new(
            "prisms",
            vec![
                stack(6, &[(0.05, -0.05), (0.05, 0.05)]),
                stack(12, &[(0.2, -0.05), (0.2, 0.05)]),
                stack(5, &[(0.5, -0.4), (0.5, 0.4)]),
            ],
        ),
        Group::new(
            "barrels",
            vec![
                stack(24, &[(0.3, -0.45), (0.38, -0.2), (0.38, 0.2), (0.3, 0.45)]),
                stack(16, &[(0.03, -0.05), (0.04, 0.0), (0.03, 0.05)]),
            ],
        ),
        Group::new(
            "frusta",
            vec![
                stack(12, &[(0.05, -0.05), (0.03, 0.05)]),
                stack(12, &[(0.5, -0.3), (0.3, 0.3)]),
                stack(4, &[(0.2, -0.1), (0.1, 0.1)]),
            ],
        ),
        Group::new("cylinders", [32, 64, 128].map(|sides| stack(sides, &[(0.1, -0.1), (0.1, 0.1)])).into()),
        Group::new("links", links()),
    ]
}

fn cuboid(size: [f64; 3]) -> Points {
    let sign = |i: usize, k: usize| if i >> k & 1 == 0 { -0.5 } else { 0.5 };
    (0..8).map(|i| std::array::from_fn(|k| sign(i, k) * size[k])).collect()
}

/// The robots' hulls in the example scenes. Their names have the form `link/number`.
fn links() -> Vec<Points> {
    let own = |hull: &serde_json::Value| hull["name"].as_str().is_some_and(|name| name.contains('/'));
    let scene = |name: &str| {
        let path = format!("{}/../../examples/scenes/{name}.json", env!("CARGO_MANIFEST_DIR"));
        hulls_of(&read(&path), own)
    };
    ["panda", "anymal_c"].into_iter().flat_map(scene).collect()
}

/// All hulls of a scene file, as a group with the scene's name.
pub(crate) fn group_of(path: &str) -> Group {
    let scene = read(path);
    let name = scene["name"].as_str().unwrap_or("given").to_owned();
    Group { name, shapes: hulls_of(&scene, |_| true), thinned: 100 }
}

fn read(path: &str) -> serde_json::Value {
    let text = std::fs::read(path).unwrap_or_else(|error| panic!("{path}: {error}"));
    serde_json::from_slice(&text).unwrap_or_else(|error| panic!("{path}: {error}"))
}

fn hulls_of(scene: &serde_json::Value, wanted: impl Fn(&serde_json::Value) -> bool) -> Vec<Points> {
    let hulls = scene["hulls"].as_array().expect("hulls").iter();
    let points = |hull: &serde_json::Value| serde_json::from_value(hull["vertices"].clone()).expect("points");
    hulls.filter(|hull| wanted(hull)).map(points).collect()
}

/// How a file rounds a coordinate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Rounding {
    None,
    Single,
    Decimals(i32),
}

pub(crate) const ROUNDINGS: [Rounding; 5] =
    [Rounding::None, Rounding::Single, Rounding::Decimals(6), Rounding::Decimals(5), Rounding::Decimals(4)];

impl Rounding {
    pub(crate) fn name(self) -> String {
        match self {
            Self::None => "unrounded".into(),
            Self::Single => "float32".into(),
            Self::Decimals(digits) => format!("{digits} decimals"),
        }
    }

    /// The double nearest to the written number.
    pub(crate) fn of(self, x: f64) -> f64 {
        match self {
            Self::None => x,
            Self::Single => f64::from(x as f32),
            Self::Decimals(digits) => {
                let unit = 10_f64.powi(digits);
                (x * unit).round() / unit
            }
        }
    }
}
