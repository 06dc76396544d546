//! What the planarity of a hull's faces costs and buys (docs/tradeoff.md): `make planarity`.
//!
//! Shapes are turned at random, rounded as files round coordinates, and stood on a face. Their
//! patch is compared with that of the unrounded shape in the same pose, for every planarity.
//! Writes a row per shape group, rounding and planarity to the CSV file that is named, and
//! prints the tables of the page.

mod measure;
mod shapes;
mod tables;

use std::process::ExitCode;

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let (Some(path), orientations) = (arguments.next(), arguments.next()) else {
        eprintln!("usage: planarity CSV [ORIENTATIONS]");
        return ExitCode::from(2);
    };
    let Ok(orientations) = orientations.as_deref().unwrap_or("1000").parse() else {
        eprintln!("ORIENTATIONS is a number");
        return ExitCode::from(2);
    };
    let groups = shapes::groups();
    let cells = measure::cells(&groups, orientations);
    if let Err(error) = std::fs::write(&path, tables::csv(&cells)) {
        eprintln!("{path}: {error}");
        return ExitCode::from(2);
    }
    print!("{}", tables::tables(&cells, orientations));
    ExitCode::SUCCESS
}
