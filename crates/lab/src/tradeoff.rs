//! `lab tradeoff`: measures speed against accuracy.

mod advice;
mod cases;
mod chart;
mod measure;
mod patch;
mod peer_files;
mod peers;
mod settings;
mod table;
mod truth;

use std::collections::HashMap;
use std::path::PathBuf;

use clap::value_parser;

use crate::{Error, print, progress};
use cases::CellPool;
use chart::{Chart, LabelledPoint, Panel};
use hullcast_batch::scene_file::SceneFile;
use measure::{Prepared, Sample};
use peer_files::PeerAnswers;
use settings::Setting;
use table::{Figures, PeerRow, SettingRow, Sorted};

/// Measures the time and the errors of every setting.
///
/// Without a scene, the pairs are generated: boxes and polytopes of 16, 64 and 256 vertices, in shallow
/// overlap, resting face on face, and, as a group of its own, in deep overlap. With a scene, they are the
/// pairs of the scene that are in contact, or random pairs of its hulls if none are. The command writes
/// FILE.csv (one row per setting and kind of pair) and FILE.json (the points of the chart of time against
/// error, which client/examples/tradeoff.py draws), and prints which setting suits which need. Other libraries may answer the same pairs: `--ask` writes the pairs, and
/// `--peer` judges the answers.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct Args {
    /// Scene files in the format hullcast.scene.v1. A file may contain only hulls, with empty bodies and
    /// pairs.
    scenes: Vec<PathBuf>,
    /// The path of the result files, without their endings.
    #[arg(long, value_name = "FILE", default_value = "tradeoff", help_heading = "Results")]
    out: PathBuf,
    /// Most pairs of each kind.
    #[arg(long, value_name = "COUNT", default_value_t = 96, value_parser = value_parser!(u32).range(1..),
          allow_negative_numbers = true, help_heading = "Pairs")]
    pairs: u32,
    /// Write the pairs as JSON, for another library to answer, and measure nothing [default: measure].
    #[arg(long, value_name = "FILE", conflicts_with = "peer", help_heading = "Other libraries")]
    ask: Option<PathBuf>,
    /// A file with another library's answers, which are judged like those of hullcast; may be repeated
    /// [default: none].
    #[arg(long, value_name = "FILE", help_heading = "Other libraries")]
    peer: Vec<PathBuf>,
}

/// Runs `lab tradeoff`.
///
/// # Errors
/// A scene is not valid or has no pair to measure, or the results cannot be written.
pub(crate) fn run(args: &Args) -> Result<(), Error> {
    let pairs = args.pairs as usize;
    let cells = match &args.scenes[..] {
        [] => cases::generated(pairs)?,
        scenes => {
            let of = |path: &PathBuf| -> Result<_, Error> {
                let scene = SceneFile::read("", path)?;
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
    let peers: Vec<PeerAnswers> =
        args.peer.iter().map(|path| PeerAnswers::read(path, &cells)).collect::<Result<_, _>>()?;
    let (rows, others) = measured(cells, &peers)?;
    let of_pool = |pool: CellPool| -> (Vec<SettingRow>, Vec<PeerRow>) {
        let rows = rows.iter().filter(|row| row.cell == pool.name()).cloned();
        (rows.collect(), others.iter().filter(|row| row.cell == pool.name()).cloned().collect())
    };
    let (all, all_others) = of_pool(CellPool::All);
    let chart = serde_json::to_string(&chart(&all, &all_others))?;
    for (ending, text) in [("csv", table::csv(&rows, &others)), ("json", chart)] {
        let path = args.out.with_extension(ending);
        std::fs::write(&path, text).map_err(|e| format!("--out {}: {e}", path.display()))?;
    }
    let mut report = advice::text(&all);
    for pool in [CellPool::All, CellPool::Deep] {
        let (rows, others) = of_pool(pool);
        if !rows.is_empty() {
            report += &format!("\n{}", advice::beside(pool, &rows, &others));
        }
    }
    print(&report)
}

/// Measures every setting and judges every other library, on every cell and on each whole pool.
fn measured(
    cells: Vec<cases::Cell>,
    peers: &[PeerAnswers],
) -> Result<(Vec<SettingRow>, Vec<PeerRow>), Error> {
    let progress = progress::bar("kinds of pairs prepared", cells.len());
    let prepared = cells.into_iter().map(|cell| {
        let prepared = Prepared::new(cell);
        progress.inc(1);
        prepared
    });
    let cells: Vec<Prepared> = prepared.collect::<Result<_, _>>()?;
    drop(progress);
    let grid = Setting::grid();
    let progress = progress::bar("settings", grid.len());
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
        let mut pools = [CellPool::All, CellPool::Deep].map(|pool| (pool, Vec::new(), Vec::new()));
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
        rows.extend(of_setting.into_iter().map(|(cell, figures)| SettingRow { cell, setting, figures }));
        progress.inc(1);
    }
    drop(progress);
    let progress = progress::bar("other libraries", peers.len());
    let mut others = Vec::new();
    for peer in peers {
        let of_peer = figures(&|i, prepared| prepared.judge(peer.answers(i)));
        let row = |(cell, figures)| PeerRow { cell, name: peer.name.clone(), figures };
        others.extend(of_peer.into_iter().map(row));
        progress.inc(1);
    }
    Ok((rows, others))
}

/// Errors are drawn within this range: lower ones are rounding, and higher ones are total (the distance
/// of a missing patch is infinite).
const DRAWN: (f64, f64) = (1e-16, 1.0);

/// The chart of time against errors: all settings, those that no other beats, the recommended ones, and
/// other libraries.
fn chart(rows: &[SettingRow], peers: &[PeerRow]) -> Chart {
    type Of = fn(&Figures) -> f64;
    let errors: [(&str, Of); 3] = [
        ("normal short of optimal, p95", |f| f.optimality[1].clamp(DRAWN.0, DRAWN.1)),
        ("patch off by this share of the size, p95", |f| f.hausdorff[1].clamp(DRAWN.0, DRAWN.1)),
        ("depth off the least translation, p95", |f| f.depth_off.clamp(DRAWN.0, DRAWN.1)),
    ];
    let panel = |(title, error): (&'static str, Of)| {
        let at = |i: usize| [rows[i].figures.relative_time, error(&rows[i].figures)];
        let settings = (0..rows.len()).map(at).collect();
        let front = table::front(rows, error).into_iter().map(at).collect();
        // Needs with the same setting share a point and its label.
        let mut advised: Vec<LabelledPoint> = Vec::new();
        for need in &advice::NEEDS {
            let Some(row) = advice::choice(rows, need, false) else { continue };
            let at = [row.figures.relative_time, error(&row.figures)];
            match advised.iter_mut().find(|named| named.at == at) {
                Some(named) => named.name += &format!(", {}", need.name),
                None => advised.push(LabelledPoint { name: need.name.into(), at }),
            }
        }
        let of_peer = |peer: &PeerRow| LabelledPoint {
            name: peer.name.clone(),
            at: [peer.figures.relative_time, error(&peer.figures)],
        };
        Panel { title, settings, front, advised, others: peers.iter().map(of_peer).collect() }
    };
    Chart { x: "time over the default's", panels: errors.map(panel).into() }
}
