//! `hullcast tradeoff`: speed against accuracy, measured.

mod advice;
mod cases;
mod chart;
mod measure;
mod patch;
mod settings;
mod table;
mod truth;

use std::collections::HashMap;
use std::path::PathBuf;

use indicatif::{ProgressBar, ProgressStyle};

use super::Error;
use super::scene::Scene;
use chart::{Chart, Series};
use measure::Prepared;
use settings::Setting;
use table::{Figures, Row, Sorted};

/// Speed against accuracy, measured: every setting's time and errors.
///
/// Without a scene on generated pairs: boxes and polytopes of 16, 64 and 256 vertices, in
/// shallow overlap and resting face on face; with one on its pairs that are in contact, or on
/// random pairs of its hulls where none is. Writes FILE.csv (a row a setting and kind of pair),
/// FILE.svg and FILE.png (time against error), and prints which setting to take for which need.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct Args {
    /// Scene files, hullcast.scene.v1; a file may be hulls alone, with empty bodies and pairs.
    scenes: Vec<PathBuf>,
    /// Where the results go, without an ending.
    #[arg(long, value_name = "FILE", default_value = "tradeoff")]
    out: PathBuf,
    /// Pairs of each kind at most.
    #[arg(long, value_name = "COUNT", default_value_t = 96, value_parser = clap::value_parser!(u32).range(1..))]
    pairs: u32,
}

/// Runs `hullcast tradeoff`.
///
/// # Errors
/// A scene is faulty or has no pair to measure, or the results cannot be written.
pub(crate) fn run(args: &Args) -> Result<(), Error> {
    let pairs = args.pairs as usize;
    let cells = match &args.scenes[..] {
        [] => cases::generated(pairs)?,
        scenes => {
            let of = |path: &PathBuf| -> Result<_, Error> {
                let scene = Scene::read(path).map_err(|e| format!("{}: {e}", path.display()))?;
                let cell = cases::of_scene(&scene, pairs)?;
                match cell.cases.is_empty() {
                    true => Err(format!("{}: no pair to measure", path.display()).into()),
                    false => Ok(cell),
                }
            };
            scenes.iter().map(of).collect::<Result<_, _>>()?
        }
    };
    let rows = measured(cells)?;
    let all: Vec<Row> = rows.iter().filter(|row| row.cell == ALL).cloned().collect();
    let chart = chart(&all);
    for (ending, bytes) in
        [("csv", table::csv(&rows).into_bytes()), ("svg", chart.svg().into_bytes()), ("png", chart.png()?)]
    {
        let path = args.out.with_extension(ending);
        std::fs::write(&path, bytes).map_err(|e| format!("{}: {e}", path.display()))?;
    }
    print!("{}", advice::text(&all));
    Ok(())
}

/// The name of all cells together.
const ALL: &str = "all";

/// Every setting on every cell, then on all of them.
fn measured(cells: Vec<cases::Cell>) -> Result<Vec<Row>, Error> {
    let cells: Vec<Prepared> = cells.into_iter().map(Prepared::new).collect::<Result<_, _>>()?;
    let grid = Setting::grid();
    let progress = ProgressBar::new(grid.len() as u64)
        .with_style(ProgressStyle::with_template("{bar:40} {pos}/{len} settings, {eta} left")?);
    // The first setting, by which times are divided: once to warm up, once to keep.
    let median = |prepared: &Prepared, setting: &Setting| -> f64 {
        let [median] = Sorted::new(prepared.measure(setting).iter().map(|s| s.nanoseconds)).at([0.5]);
        median
    };
    let mut default: HashMap<String, f64> = HashMap::new();
    for cell in &cells {
        median(cell, &Setting::DEFAULT);
        default.insert(cell.cell.name.clone(), median(cell, &Setting::DEFAULT));
    }
    let mut rows = Vec::new();
    for setting in &grid {
        let (mut together, mut logs) = (Vec::new(), 0.0);
        for prepared in &cells {
            let samples = prepared.measure(setting);
            let [time] = Sorted::new(samples.iter().map(|s| s.nanoseconds)).at([0.5]);
            let name = &prepared.cell.name;
            let relative = time / default[name];
            logs += relative.ln();
            rows.push(Row {
                cell: name.clone(),
                setting: *setting,
                figures: Figures::of(&samples, relative),
            });
            together.extend(samples);
        }
        let figures = Figures::of(&together, (logs / cells.len() as f64).exp());
        rows.push(Row { cell: ALL.into(), setting: *setting, figures });
        progress.inc(1);
    }
    progress.finish_and_clear();
    Ok(rows)
}

/// Errors are drawn within these: below is rounding, above is all of it (a patch that is not
/// there is infinitely far).
const DRAWN: (f64, f64) = (1e-16, 1.0);

/// Time against two errors: all settings, those that none beats, and those advised.
fn chart(rows: &[Row]) -> Chart {
    type Of = fn(&Figures) -> f64;
    let errors: [(&str, Of); 2] = [
        ("normal short of optimal, p95", |f| f.optimality[1].clamp(DRAWN.0, DRAWN.1)),
        ("patch off by this share of the size, p95", |f| f.hausdorff[1].clamp(DRAWN.0, DRAWN.1)),
    ];
    let panel = |(title, error): (&'static str, Of)| {
        let at = |i: usize| (rows[i].figures.relative_time, error(&rows[i].figures));
        let all = (0..rows.len()).map(at).collect();
        let front = table::front(rows, error).into_iter().map(at).collect();
        let mut series = vec![Series::cloud(all), Series::line(front)];
        let mut named: Vec<((f64, f64), String)> = Vec::new();
        for need in &advice::NEEDS {
            let Some(row) = advice::choice(rows, need, false) else { continue };
            let at = (row.figures.relative_time, error(&row.figures));
            match named.iter_mut().find(|(there, _)| *there == at) {
                Some((_, names)) => *names += &format!(", {}", need.name),
                None => named.push((at, need.name.into())),
            }
        }
        series.extend(named.into_iter().map(|(at, names)| Series::named(names, at)));
        chart::Panel { title, x: "time over the default's", series }
    };
    Chart { panels: errors.map(panel).into() }
}
