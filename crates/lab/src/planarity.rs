//! `lab planarity`: measures the cost and the benefit of the planarity of a hull's faces (docs/tradeoff.md).
//!
//! Shapes are rotated at random, rounded as files round coordinates, and placed on a face. For every planarity, the
//! contact patch is compared with that of the unrounded shape in the same pose.

mod measure;
mod shapes;
mod tables;

use std::path::PathBuf;

use clap::value_parser;
use hullcast_batch::scene_file::SceneFile;

use crate::{Error, print};
use shapes::ShapeGroup;

/// Measures the patches of rounded shapes for each planarity of faces.
///
/// The shapes are boxes, prisms, barrels, frusta, cylinders and the links of two robots. The command writes one
/// row per group of shapes, rounding and planarity, and prints the tables of docs/tradeoff.md.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct Args {
    /// Scene files in the format hullcast.scene.v1, each of which adds a group with its hulls. These are many, so
    /// only one in a hundred of the orientations is measured.
    scenes: Vec<PathBuf>,
    /// The path of the table.
    #[arg(long, value_name = "FILE", default_value = "planarity.csv")]
    out: PathBuf,
    /// The number of random orientations of each shape.
    #[arg(long, value_name = "COUNT", default_value_t = 1000, value_parser = value_parser!(u32).range(1..),
          allow_negative_numbers = true)]
    orientations: u32,
}

/// Runs `lab planarity`.
///
/// # Errors
/// A scene is not valid, or the table cannot be written.
pub(crate) fn run(args: &Args) -> Result<(), Error> {
    let mut groups = shapes::groups()?;
    for path in &args.scenes {
        groups.push(ShapeGroup::of_scene(SceneFile::read("", path)?));
    }
    let orientations = args.orientations as usize;
    let figures = measure::figures(&groups, orientations);
    std::fs::write(&args.out, tables::csv(&figures))
        .map_err(|e| format!("--out {}: {e}", args.out.display()))?;
    print(&tables::tables(&figures, orientations))
}
