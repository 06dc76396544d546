//! Counts instructions instead of time, for machines too busy for timing. Run by `make bench-counts`.
//!
//! The program runs itself under valgrind's callgrind, once per case, and counts the instructions of
//! [`counted`]. Valgrind has no AVX-512, so the count is that of the AVX2 code. Prints the table and
//! puts it into docs/performance.md.

use std::error::Error;
use std::fmt::Write as _;
use std::hint::black_box;
use std::process::Command;

use hullcast_benches::cells::{self, MARGIN, sphere};
use hullcast_benches::ours::{self, PosedPairs};
use hullcast_benches::parry;
use hullcast_benches::report::{provenance, replace_section};
use hullcast_contact::{Accuracy, ConvexHull, Query, Solver, Wanted};

/// Pairs of each family and regime.
const PAIRS: usize = 200;
/// Motion between warm passes: a length, and an angle in radians.
const STEP: f64 = 1e-2;
const CLOUDS: [usize; 4] = [16, 64, 256, 4096];
const CONTENDERS: [&str; 4] = ["parry3d f32", "hullcast, step 1 only", "hullcast", "hullcast, warm"];
const BUILDERS: [&str; 2] = ["parry3d f32", "hullcast"];

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match &arguments[..] {
        [kind, label, contender] => run(kind, label, contender),
        _ => tables(),
    }
}

fn tables() -> Result<(), Box<dyn Error>> {
    let mut text = String::from("| instructions per pair |");
    head(&mut text, &CONTENDERS)?;
    for cell in cells::generate(PAIRS)? {
        row(&mut text, "contact", &cell.label, &CONTENDERS, PAIRS)?;
    }
    text.push_str("\n\n| instructions per point of a hull |");
    head(&mut text, &BUILDERS)?;
    for count in CLOUDS {
        row(&mut text, "hull", &count.to_string(), &BUILDERS, clouds(count).len() * count)?;
    }
    write!(text, "\n\n{}", provenance()?)?;
    println!("{text}");
    Ok(replace_section("counts", &text)?)
}

fn head(text: &mut String, contenders: &[&str]) -> Result<(), Box<dyn Error>> {
    contenders.iter().try_for_each(|name| write!(text, " {name} |"))?;
    Ok(write!(text, "\n|---|{}", "---|".repeat(contenders.len()))?)
}

fn row(
    text: &mut String,
    kind: &str,
    label: &str,
    contenders: &[&str],
    items: usize,
) -> Result<(), Box<dyn Error>> {
    write!(text, "\n| {label} |")?;
    for contender in contenders {
        write!(text, " {} |", instructions(&[kind, label, contender])? / items as u64)?;
    }
    eprintln!("{}", text.lines().last().unwrap_or_default());
    Ok(())
}

/// The number of instructions in `counted` when this program runs with these arguments.
fn instructions(arguments: &[&str]) -> Result<u64, Box<dyn Error>> {
    let run = Command::new("valgrind")
        .args(["--tool=callgrind", "--callgrind-out-file=/dev/null", "--collect-atstart=no"])
        .arg("--toggle-collect=*::counted")
        .arg(std::env::current_exe()?)
        .args(arguments)
        .output()
        .map_err(|error| format!("valgrind is needed: {error}"))?;
    let said = String::from_utf8_lossy(&run.stderr);
    let count = said.lines().find_map(|line| line.split_once("Collected :")?.1.trim().parse().ok());
    count.filter(|_| run.status.success()).ok_or_else(|| said.into())
}

/// Runs the pass whose instructions are counted.
#[inline(never)]
fn counted(pass: &mut dyn FnMut() -> usize) {
    black_box(pass());
}

fn clouds(count: usize) -> Vec<Vec<[f64; 3]>> {
    (0..(512 / count).max(1)).map(|seed| sphere(count, seed as u64)).collect()
}

fn run(kind: &str, label: &str, contender: &str) -> Result<(), Box<dyn Error>> {
    if kind == "hull" {
        let clouds = clouds(label.parse()?);
        let build: fn(&[[f64; 3]]) -> bool = match contender {
            "hullcast" => |points| ConvexHull::new(points).is_ok(),
            _ => |points| parry::single::build(points).is_some(),
        };
        counted(&mut || clouds.iter().filter(|cloud| build(cloud)).count());
        return Ok(());
    }
    let cells = cells::generate(PAIRS)?;
    let cell = cells.iter().find(|cell| cell.label == label).ok_or("no such cell")?;
    let moved = if contender == "hullcast, warm" { cell.moved(STEP) } else { cell.clone() };
    if contender == "parry3d f32" {
        let mut peer = parry::single::Hulls::new(cell, cell).ok_or("parry3d refuses a hull")?;
        counted(&mut || peer.cold());
        return Ok(());
    }
    let wanted = if contender == "hullcast, step 1 only" { Wanted::Growth } else { Wanted::Points };
    let accuracy = Accuracy { solver: Solver::Portal, ..Accuracy::default() };
    let hulls = ours::hulls(cell)?;
    let query = Query { margin: MARGIN, wanted, accuracy };
    let mut scene = PosedPairs::new(&hulls, cell, &moved, query).ok_or("a pose is not usable")?;
    if contender == "hullcast, warm" {
        scene.warm();
        counted(&mut || scene.warm());
    } else {
        counted(&mut || scene.cold());
    }
    Ok(())
}
