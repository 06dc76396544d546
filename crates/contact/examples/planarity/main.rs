//! Measures the cost and the benefit of the planarity of a hull's faces (docs/tradeoff.md); run by `make planarity`.
//!
//! Shapes are rotated at random, rounded as files round coordinates, and placed on a face. For every planarity, the
//! contact patch is compared with that of the unrounded shape in the same pose. The program writes one row per group of
//! shapes, rounding and planarity to the given CSV file, and prints the tables of the page. Each scene file adds a
//! group with its hulls. These are many, so only one in a hundred of the orientations is measured.

mod measure;
mod shapes;
mod tables;

use std::process::ExitCode;

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let (Some(path), Some(orientations)) = (arguments.next(), arguments.next()) else {
        eprintln!("usage: planarity CSV ORIENTATIONS [SCENE.json]...");
        return ExitCode::from(2);
    };
    let Ok(orientations) = orientations.parse() else {
        eprintln!("ORIENTATIONS is {orientations:?}, must be a number");
        return ExitCode::from(2);
    };
    let mut groups = shapes::groups();
    groups.extend(arguments.map(|scene| shapes::group_of(&scene)));
    let cells = measure::cells(&groups, orientations);
    if let Err(error) = std::fs::write(&path, tables::csv(&cells)) {
        eprintln!("{path}: {error}");
        return ExitCode::from(2);
    }
    print!("{}", tables::tables(&cells, orientations));
    ExitCode::SUCCESS
}
