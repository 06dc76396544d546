//! The measured shapes, and how files round their coordinates.

use std::f64::consts::TAU;
use std::path::Path;

use hullcast_batch::scene_file::{HullPoints, SceneFile, SceneFileError};

pub(super) type Points = Vec<[f64; 3]>;

/// Shapes of one kind.
pub(super) struct ShapeGroup {
    pub(super) name: String,
    pub(super) shapes: Vec<Points>,
    /// One in this many of the orientations is measured.
    pub(super) thinned: usize,
}

impl ShapeGroup {
    fn new(name: &str, shapes: Vec<Points>) -> Self {
        Self { name: name.to_owned(), shapes, thinned: 1 }
    }

    /// All hulls of a scene, with the scene's name.
    pub(super) fn of_scene(scene: SceneFile) -> Self {
        let shapes = scene.hulls.into_iter().map(|hull| hull.vertices).collect();
        Self { name: scene.name, shapes, thinned: 100 }
    }
}

/// Boxes, prisms, barrels, frusta, fine cylinders, and the links of two robots; in metres.
///
/// # Errors
/// A scene of the robots cannot be read.
pub(super) fn groups() -> Result<Vec<ShapeGroup>, SceneFileError> {
    let stack = |sides: usize, rings: &[(f64, f64)]| -> Points {
        let corner = |i: usize| (TAU * i as f64 / sides as f64).sin_cos();
        let ring = |&(radius, z): &(f64, f64)| {
            (0..sides).map(move |i| [radius * corner(i).1, radius * corner(i).0, z]).collect::<Points>()
        };
        rings.iter().flat_map(ring).collect()
    };
    Ok(vec![
        ShapeGroup::new("boxes", vec![cuboid([0.04; 3]), cuboid([0.3, 0.2, 0.05]), cuboid([1.0; 3])]),
        ShapeGroup::new(
            "prisms",
            vec![
                stack(6, &[(0.05, -0.05), (0.05, 0.05)]),
                stack(12, &[(0.2, -0.05), (0.2, 0.05)]),
                stack(5, &[(0.5, -0.4), (0.5, 0.4)]),
            ],
        ),
        ShapeGroup::new(
            "barrels",
            vec![
                stack(24, &[(0.3, -0.45), (0.38, -0.2), (0.38, 0.2), (0.3, 0.45)]),
                stack(16, &[(0.03, -0.05), (0.04, 0.0), (0.03, 0.05)]),
            ],
        ),
        ShapeGroup::new(
            "frusta",
            vec![
                stack(12, &[(0.05, -0.05), (0.03, 0.05)]),
                stack(12, &[(0.5, -0.3), (0.3, 0.3)]),
                stack(4, &[(0.2, -0.1), (0.1, 0.1)]),
            ],
        ),
        ShapeGroup::new(
            "cylinders",
            [32, 64, 128].map(|sides| stack(sides, &[(0.1, -0.1), (0.1, 0.1)])).into(),
        ),
        ShapeGroup::new("links", links()?),
    ])
}

fn cuboid(size: [f64; 3]) -> Points {
    let sign = |i: usize, k: usize| if i >> k & 1 == 0 { -0.5 } else { 0.5 };
    (0..8).map(|i| std::array::from_fn(|k| sign(i, k) * size[k])).collect()
}

/// The robots' hulls in the example scenes. Their names have the form `link/number`.
fn links() -> Result<Vec<Points>, SceneFileError> {
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/scenes");
    let mut links = Vec::new();
    for name in ["panda.json", "anymal_c.json"] {
        let hulls = SceneFile::read("", &scenes.join(name))?.hulls.into_iter();
        let own = |hull: HullPoints| hull.name.contains('/').then_some(hull.vertices);
        links.extend(hulls.filter_map(own));
    }
    Ok(links)
}

/// How a file rounds a coordinate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Rounding {
    None,
    Single,
    Decimals(i32),
}

pub(super) const ROUNDINGS: [Rounding; 5] =
    [Rounding::None, Rounding::Single, Rounding::Decimals(6), Rounding::Decimals(5), Rounding::Decimals(4)];

impl Rounding {
    pub(super) fn name(self) -> String {
        match self {
            Self::None => "unrounded".into(),
            Self::Single => "float32".into(),
            Self::Decimals(digits) => format!("{digits} decimals"),
        }
    }

    /// The double nearest to the written number.
    pub(super) fn of(self, x: f64) -> f64 {
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
