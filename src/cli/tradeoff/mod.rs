//! `hullcast tradeoff`: measures speed against accuracy.

mod advice;
mod cases;
mod chart;
mod measure;
mod patch;
mod peers;
mod settings;
mod table;
mod truth;

use std::collections::HashMap;
use std::path::PathBuf;

use indicatif::{ProgressBar, ProgressStyle};

use super::Error;
use super::scene::Scene;
use cases::Pool;
use chart::{Chart, Series};
use measure::{Prepared, Sample};
use peers::Peer;
use settings::Setting;
use table::{Figures, PeerRow, Row, Sorted};

/// Speed against accuracy, measured: every setting's time and errors.
///
/// Without a scene on generated pairs: boxes and polytopes of 16, 64 and 256 vertices, in
/// shallow overlap, resting face on face, and, apart from these, in deep overlap; with one on its pairs that are in contact, or on
/// random pairs of its hulls where none is. Writes FILE.csv (a row a setting and kind of pair),
/// FILE.svg and FILE.png (time against error), and prints which setting to take for which need.
/// Other libraries may answer the same pairs: `--ask` writes these, `--peer` judges answers.
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
    /// Writes the pairs for another library to answer, as JSON, and measures nothing.
    #[arg(long, value_name = "FILE", conflicts_with = "peer")]
    ask: Option<PathBuf>,
    /// A file of another library's answers, judged beside ours.
    #[arg(long, value_name = "FILE")]
    peer: Vec<PathBuf>,
}

/// Runs `hullcast tradeoff`.
///
/// # Errors
/// A scene is not valid or has no pair to measure, or the results cannot be written.
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
    if let Some(path) = &args.ask {
        return peers::ask(&cells, path);
    }
    let peers: Vec<Peer> = args.peer.iter().map(|path| Peer::read(path, &cells)).collect::<Result<_, _>>()?;
    let (rows, others) = measured(cells, &peers)?;
    let of_pool = |pool: Pool| -> (Vec<Row>, Vec<PeerRow>) {
        let rows = rows.iter().filter(|row| row.cell == pool.name()).cloned();
        (rows.collect(), others.iter().filter(|row| row.cell == pool.name()).cloned().collect())
    };
    let (all, all_others) = of_pool(Pool::All);
    let chart = chart(&all, &all_others);
    let csv = table::csv(&rows, &others).into_bytes();
    for (ending, bytes) in [("csv", csv), ("svg", chart.svg().into_bytes()), ("png", chart.png()?)] {
        let path = args.out.with_extension(ending);
        std::fs::write(&path, bytes).map_err(|e| format!("{}: {e}", path.display()))?;
    }
    print!("{}", advice::text(&all));
    for pool in [Pool::All, Pool::Deep] {
        let (rows, others) = of_pool(pool);
        if !rows.is_empty() {
            print!("\n{}", advice::beside(pool, &rows, &others));
        }
    }
    Ok(())
}

/// Measures every setting and judges every other library, on every cell and on each whole pool.
fn measured(cells: Vec<cases::Cell>, peers: &[Peer]) -> Result<(Vec<Row>, Vec<PeerRow>), Error> {
    let cells: Vec<Prepared> = cells.into_iter().map(Prepared::new).collect::<Result<_, _>>()?;
    let grid = Setting::grid();
    let progress = ProgressBar::new(grid.len() as u64)
        .with_style(ProgressStyle::with_template("{bar:40} {pos}/{len} settings, {eta} left")?);
    // The first setting is the one by which times are divided: one run warms up, one is kept.
    let median = |prepared: &Prepared, setting: &Setting| -> f64 {
        let [median] = Sorted::new(prepared.measure(setting).iter().map(|s| s.nanoseconds)).at([0.5]);
        median
    };
    let mut default: HashMap<String, f64> = HashMap::new();
    for cell in &cells {
        median(cell, &Setting::DEFAULT);
        default.insert(cell.cell.name.clone(), median(cell, &Setting::DEFAULT));
    }
    // The figures of one contender for each cell and then for each pool, with their names.
    let figures = |of: &dyn Fn(usize, &Prepared) -> Vec<Sample>| -> Vec<(String, Figures)> {
        let mut figures = Vec::new();
        let mut pools = [Pool::All, Pool::Deep].map(|pool| (pool, Vec::new(), Vec::new()));
        for (i, prepared) in cells.iter().enumerate() {
            let samples = of(i, prepared);
            let [time] = Sorted::new(samples.iter().map(|s| s.nanoseconds)).at([0.5]);
            let relative = time / default[&prepared.cell.name];
            figures.push((prepared.cell.name.clone(), Figures::of(&samples, relative)));
            for (_, together, logs) in pools.iter_mut().filter(|(pool, ..)| *pool == prepared.cell.pool) {
                together.extend_from_slice(&samples);
                logs.push(relative.ln());
            }
        }
        for (pool, together, logs) in pools.iter().filter(|(_, together, _)| !together.is_empty()) {
            let relative = (logs.iter().sum::<f64>() / logs.len() as f64).exp();
            figures.push((pool.name().into(), Figures::of(together, relative)));
        }
        figures
    };
    let mut rows = Vec::new();
    for &setting in &grid {
        let of_setting = figures(&|_, prepared| prepared.measure(&setting));
        rows.extend(of_setting.into_iter().map(|(cell, figures)| Row { cell, setting, figures }));
        progress.inc(1);
    }
    progress.finish_and_clear();
    let mut others = Vec::new();
    for peer in peers {
        let of_peer = figures(&|i, prepared| prepared.judge(peer.answers(i)));
        let row = |(cell, figures)| PeerRow { cell, name: peer.name.clone(), figures };
        others.extend(of_peer.into_iter().map(row));
    }
    Ok((rows, others))
}

/// Errors are drawn within this range: lower ones are rounding, and higher ones are total (the distance
/// of a missing patch is infinite).
const DRAWN: (f64, f64) = (1e-16, 1.0);

/// The chart of time against errors: all settings, those that no other beats, the recommended ones, and
/// other libraries.
fn chart(rows: &[Row], peers: &[PeerRow]) -> Chart {
    type Of = fn(&Figures) -> f64;
    let errors: [(&str, Of); 3] = [
        ("normal short of optimal, p95", |f| f.optimality[1].clamp(DRAWN.0, DRAWN.1)),
        ("patch off by this share of the size, p95", |f| f.hausdorff[1].clamp(DRAWN.0, DRAWN.1)),
        ("depth off the least translation, p95", |f| f.depth_off.clamp(DRAWN.0, DRAWN.1)),
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
        let of_peer =
            |peer: &PeerRow| Series::other(&peer.name, (peer.figures.relative_time, error(&peer.figures)));
        series.extend(peers.iter().map(of_peer));
        chart::Panel { title, x: "time over the default's", series }
    };
    Chart { panels: errors.map(panel).into() }
}
