//! Times contact manifolds and hull building beside parry3d. Run by `make bench`; arguments name the
//! sections to run.
//!
//! Prints each table and puts it into docs/performance.md. A run of all sections also writes every
//! figure into docs/performance.csv.

use std::error::Error;

use hullcast_benches::cells::{self, Cell, MARGIN};
use hullcast_benches::ours::{self, BoxesInLanes, PosedPairs};
use hullcast_benches::parry;
use hullcast_benches::report::{DOCS, Table, provenance, replace_section};
use hullcast_benches::rounds::{Contender, Timing, interleave};
use hullcast_contact::workload::{Family, Regime};
use hullcast_contact::{Accuracy, ConvexHull, InstructionSet, Query, Solver, Wanted};

const ROUNDS: usize = 21;
/// Pairs of each family and regime.
const PAIRS: usize = 1000;
/// Motion between warm passes: a length, and an angle in radians.
const STEPS: [f64; 3] = [1e-3, 1e-2, 1e-1];
const CLOUDS: [usize; 4] = [16, 64, 256, 4096];

fn main() -> Result<(), Box<dyn Error>> {
    // The provenance is taken first, because the results make the working tree differ from its commit.
    replace_section("provenance", &provenance()?)?;
    let cells = cells::generate(PAIRS)?;
    let chosen: Vec<String> = std::env::args().skip(1).collect();
    let mut csv = String::new();
    for section in ["cold", "boxes", "lanes", "outputs", "warm", "streamed", "hulls"] {
        if !chosen.is_empty() && !chosen.iter().any(|name| name == section) {
            continue;
        }
        let table = match section {
            "cold" => cold(&cells)?,
            "boxes" => boxes(&cells)?,
            "lanes" => lanes(&cells)?,
            "outputs" => outputs(&cells)?,
            "warm" => warm(&cells)?,
            "streamed" => streamed()?,
            _ => building()?,
        };
        println!("{section}\n{}\n", table.text());
        replace_section(section, table.text())?;
        csv.push_str(table.csv());
    }
    if chosen.is_empty() {
        std::fs::write(format!("{DOCS}/performance.csv"), csv)?;
    }
    Ok(())
}

fn query(wanted: Wanted, solver: Solver) -> Query {
    Query { margin: MARGIN, wanted, accuracy: Accuracy { solver, ..Accuracy::default() } }
}

/// How many times as fast as one lane the widest lanes are at least. The loss of an `#[inline(always)]` takes
/// more than that.
const LEAST_GAIN: f64 = 1.5;
const NOT_INLINED: &str = "wide lanes gain nothing: a helper of crates/contact/src/lanes is not inlined";

const REFUSED: &str = "parry3d refuses a hull";
const UNUSABLE: &str = "a pose is not usable";

/// Whole manifolds without a warm start, and step 1 by itself.
fn cold(cells: &[Cell]) -> Result<Table, Box<dyn Error>> {
    let names =
        ["parry3d f32", "parry3d f64", "hullcast", "hullcast, paper's solver", "hullcast, step 1 only"];
    let mut table = Table::new("cold", &names);
    for cell in cells {
        let hulls = ours::hulls(cell)?;
        let scene = |query| PosedPairs::new(&hulls, cell, cell, query).ok_or(UNUSABLE);
        let mut single = parry::single::Hulls::new(cell, cell).ok_or(REFUSED)?;
        let mut double = parry::double::Hulls::new(cell, cell).ok_or(REFUSED)?;
        let mut whole = scene(query(Wanted::Points, Solver::Portal))?;
        let mut paper = scene(query(Wanted::Points, Solver::GjkRayCast))?;
        let mut growth = scene(query(Wanted::Growth, Solver::Portal))?;
        let mut contenders = [
            Contender { name: names[0], pass: Box::new(|| single.cold()) },
            Contender { name: names[1], pass: Box::new(|| double.cold()) },
            Contender { name: names[2], pass: Box::new(|| whole.cold()) },
            Contender { name: names[3], pass: Box::new(|| paper.cold()) },
            Contender { name: names[4], pass: Box::new(|| growth.cold()) },
        ];
        record(&mut table, &cell.label, interleave(&mut contenders, cell.pairs.len(), ROUNDS));
    }
    Ok(table)
}

/// Boxes, beside parry3d's shape for boxes.
fn boxes(cells: &[Cell]) -> Result<Table, Box<dyn Error>> {
    let names = ["parry3d f32 cuboid", "parry3d f64 cuboid", "hullcast"];
    let mut table = Table::new("boxes", &names);
    for cell in cells.iter().filter(|cell| cell.label.starts_with(Family::Box.name())) {
        let hulls = ours::hulls(cell)?;
        let mut single = parry::single::Cuboids::new(cell, cell).ok_or(REFUSED)?;
        let mut double = parry::double::Cuboids::new(cell, cell).ok_or(REFUSED)?;
        let points_query = query(Wanted::Points, Solver::Portal);
        let mut whole = PosedPairs::new(&hulls, cell, cell, points_query).ok_or(UNUSABLE)?;
        let mut contenders = [
            Contender { name: names[0], pass: Box::new(|| single.cold()) },
            Contender { name: names[1], pass: Box::new(|| double.cold()) },
            Contender { name: names[2], pass: Box::new(|| whole.cold()) },
        ];
        record(&mut table, &cell.label, interleave(&mut contenders, cell.pairs.len(), ROUNDS));
    }
    Ok(table)
}

/// Whole manifolds of boxes in lanes, with each instruction set of this machine, beside parry3d and the path
/// for all hulls. From the caches, and with hulls that are in no cache.
fn lanes(cells: &[Cell]) -> Result<Table, Box<dyn Error>> {
    let sets: Vec<_> = InstructionSet::available().collect();
    let mut names = vec!["parry3d f32", "parry3d f32 cuboid", "path for all hulls"];
    names.extend(sets.iter().map(|set| set.name()));
    let mut table = Table::new("boxes", &names);
    let streamed = cells::streamed()?;
    let cold = cells.iter().map(|cell| (cell, ""));
    for (cell, note) in cold.chain(streamed.iter().map(|cell| (cell, ", streamed"))) {
        if !cell.label.starts_with(Family::Box.name()) {
            continue;
        }
        let turned = cell.turned();
        let (hulls, turned_hulls) = (ours::hulls(cell)?, ours::hulls(&turned)?);
        let points_query = query(Wanted::Points, Solver::Portal);
        let mut single = parry::single::Hulls::new(cell, cell).ok_or(REFUSED)?;
        let mut cuboids = parry::single::Cuboids::new(cell, cell).ok_or(REFUSED)?;
        let mut general = PosedPairs::new(&turned_hulls, &turned, &turned, points_query).ok_or(UNUSABLE)?;
        let mut lanes = Vec::new();
        for &set in &sets {
            lanes.push(BoxesInLanes::new(&hulls, cell, points_query, set).ok_or(UNUSABLE)?);
        }
        let mut contenders = vec![
            Contender { name: names[0], pass: Box::new(|| single.cold()) },
            Contender { name: names[1], pass: Box::new(|| cuboids.cold()) },
            Contender { name: names[2], pass: Box::new(|| general.cold()) },
        ];
        for (&name, lanes) in names[3..].iter().zip(&mut lanes) {
            contenders.push(Contender { name, pass: Box::new(move || lanes.cold()) });
        }
        let timings = interleave(&mut contenders, cell.pairs.len(), ROUNDS);
        if let ([_, _, _, one, .., widest], "") = (&timings[..], note)
            && widest.nanoseconds > one.nanoseconds / LEAST_GAIN
        {
            return Err(NOT_INLINED.into());
        }
        record(&mut table, &format!("{}{note}", cell.label), timings);
    }
    Ok(table)
}

/// The three levels of output, from whole manifolds down to the outcome. Separated pairs are also timed
/// with an infinite margin, at which no solver stops early.
fn outputs(cells: &[Cell]) -> Result<Table, Box<dyn Error>> {
    let names = ["points", "growth scale and normal", "outcome"];
    let mut table = Table::new("asked for", &names);
    for cell in cells {
        let hulls = ours::hulls(cell)?;
        let apart = cell.label.ends_with(Regime::Separated.name());
        for (note, margin) in [("", MARGIN), (", any distance", f64::INFINITY)] {
            if !note.is_empty() && !apart {
                continue;
            }
            let scene = |wanted| {
                let query = Query { margin, ..query(wanted, Solver::Portal) };
                PosedPairs::new(&hulls, cell, cell, query).ok_or(UNUSABLE)
            };
            let mut points = scene(Wanted::Points)?;
            let mut growth = scene(Wanted::Growth)?;
            let mut outcome = scene(Wanted::Outcome)?;
            let mut contenders = [
                Contender { name: names[0], pass: Box::new(|| points.cold()) },
                Contender { name: names[1], pass: Box::new(|| growth.cold()) },
                Contender { name: names[2], pass: Box::new(|| outcome.cold()) },
            ];
            let timings = interleave(&mut contenders, cell.pairs.len(), ROUNDS);
            record(&mut table, &format!("{}{note}", cell.label), timings);
        }
    }
    Ok(table)
}

/// Whole manifolds, and step 1 by itself, each with the answer before a motion as its warm start.
fn warm(cells: &[Cell]) -> Result<Table, Box<dyn Error>> {
    let names = ["parry3d f32", "hullcast", "hullcast, step 1 only"];
    let mut table = Table::new("warm, motion", &names);
    for cell in cells {
        for step in STEPS {
            let moved = cell.moved(step);
            let hulls = ours::hulls(cell)?;
            let mut single = parry::single::Hulls::new(cell, &moved).ok_or(REFUSED)?;
            let scene =
                |wanted| PosedPairs::new(&hulls, cell, &moved, query(wanted, Solver::Portal)).ok_or(UNUSABLE);
            let (mut whole, mut growth) = (scene(Wanted::Points)?, scene(Wanted::Growth)?);
            let mut contenders = [
                Contender { name: names[0], pass: Box::new(|| single.warm()) },
                Contender { name: names[1], pass: Box::new(|| whole.warm()) },
                Contender { name: names[2], pass: Box::new(|| growth.warm()) },
            ];
            let timings = interleave(&mut contenders, cell.pairs.len(), ROUNDS);
            record(&mut table, &format!("{}, {step:e}", cell.label), timings);
        }
    }
    Ok(table)
}

/// Whole manifolds without a warm start, where each pair's hulls are in no cache.
fn streamed() -> Result<Table, Box<dyn Error>> {
    let names = ["parry3d f32", "hullcast"];
    let mut table = Table::new("streamed", &names);
    for cell in &cells::streamed()? {
        let hulls = ours::hulls(cell)?;
        let mut single = parry::single::Hulls::new(cell, cell).ok_or(REFUSED)?;
        let points_query = query(Wanted::Points, Solver::Portal);
        let mut whole = PosedPairs::new(&hulls, cell, cell, points_query).ok_or(UNUSABLE)?;
        let mut contenders = [
            Contender { name: names[0], pass: Box::new(|| single.cold()) },
            Contender { name: names[1], pass: Box::new(|| whole.cold()) },
        ];
        record(&mut table, &cell.label, interleave(&mut contenders, cell.pairs.len(), ROUNDS));
    }
    Ok(table)
}

/// Building hulls from points on a sphere.
fn building() -> Result<Table, Box<dyn Error>> {
    let names = ["parry3d f32", "parry3d f64", "hullcast"];
    let mut table = Table::new("points", &names);
    for count in CLOUDS {
        // Small clouds are built many times, so that a pass is long enough to time.
        let clouds: Vec<_> =
            (0..(512 / count).max(1)).map(|seed| cells::sphere(count, seed as u64)).collect();
        let each = |build: &dyn Fn(&[[f64; 3]]) -> bool| clouds.iter().filter(|cloud| build(cloud)).count();
        let mut contenders = [
            Contender { name: names[0], pass: Box::new(|| each(&|c| parry::single::build(c).is_some())) },
            Contender { name: names[1], pass: Box::new(|| each(&|c| parry::double::build(c).is_some())) },
            Contender { name: names[2], pass: Box::new(|| each(&|c| ConvexHull::new(c).is_ok())) },
        ];
        record(&mut table, &count.to_string(), interleave(&mut contenders, clouds.len(), ROUNDS));
    }
    Ok(table)
}

fn record(table: &mut Table, label: &str, timings: Vec<Timing>) {
    let last = timings.last();
    eprintln!(
        "{label}: {}",
        last.map_or(String::new(), |t| format!("{:.0} ns, {:.2}x", t.nanoseconds, t.ratio))
    );
    table.row(label, &timings);
}
