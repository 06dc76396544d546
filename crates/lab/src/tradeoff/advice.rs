//! Recommends a setting for each need, and shows the effect of each knob by itself.

use std::fmt::Write;

use hullcast_contact::Solver;

use super::cases::CellPool;
use super::settings::{Centre, Setting};
use super::table::{Figures, PeerRow, SettingRow};

/// A need, and the errors that it tolerates.
pub(super) struct Need {
    pub(super) name: &'static str,
    what: &'static str,
    bears: fn(&Setting, &Figures) -> bool,
}

/// The needs, in ascending order of tolerance. A knob that changes which number is computed (the
/// contraction point) stays at its default.
pub(super) const NEEDS: [Need; 4] = [
    Need {
        name: "exact",
        what: "growth scale and normal to rounding, the whole patch",
        bears: |_, f| f.gap[1] <= 1e-12 && f.optimality[2] <= 1e-12 && f.hausdorff[1] <= 1e-12,
    },
    Need {
        name: "steady",
        what: "a simulation: normals within 1e-3 of optimal, patches within 1 % of the size",
        bears: |_, f| f.optimality[1] <= 1e-3 && f.hausdorff[1] <= 0.01,
    },
    Need {
        name: "light",
        what: "at most four points per pair, normals within 1e-3",
        bears: |s, f| (1..=4).contains(&s.max_points) && f.optimality[1] <= 1e-3 && f.hausdorff[1] <= 0.1,
    },
    Need {
        name: "rough",
        what: "many rough answers: normals within 2e-2, one point is enough",
        bears: |_, f| f.optimality[1] <= 0.02,
    },
];

/// Whether the setting has defaults for the knobs that a user does not choose for speed.
fn is_offered(setting: &Setting) -> bool {
    setting.centre == Setting::DEFAULT.centre && setting.max_iterations == Setting::DEFAULT.max_iterations
}

/// Settings within this factor of the fastest count as equally fast, and the simplest of them is
/// recommended.
const AS_FAST: f64 = 1.03;

/// The recommended setting for a need: the simplest among the fastest that satisfy it, with or without
/// a warm start.
pub(super) fn choice<'a>(rows: &'a [SettingRow], need: &Need, warm: bool) -> Option<&'a SettingRow> {
    let fit = |row: &&SettingRow| {
        row.setting.warm == warm && is_offered(&row.setting) && (need.bears)(&row.setting, &row.figures)
    };
    let fitting: Vec<&SettingRow> = rows.iter().filter(fit).collect();
    let time = |row: &SettingRow| row.figures.relative_time;
    let fastest = fitting.iter().map(|row| time(row)).fold(f64::INFINITY, f64::min);
    let as_fast = fitting.into_iter().filter(|row| time(row) <= fastest * AS_FAST);
    as_fast.min_by(|p, q| {
        let knobs = |row: &SettingRow| row.setting.changed().len();
        knobs(p).cmp(&knobs(q)).then(time(p).total_cmp(&time(q)))
    })
}

/// The recommendations as text. `rows` are those of all cells together.
pub(super) fn text(rows: &[SettingRow]) -> String {
    let mut text = String::new();
    let _ = writeln!(text, "Setting to choose for each need (time over that of the default, cold):\n");
    for need in NEEDS {
        let _ = writeln!(text, "{}: {}", need.name, need.what);
        for warm in [false, true] {
            let start = if warm { "warm" } else { "cold" };
            let _ = match choice(rows, &need, warm) {
                None => writeln!(text, "  {start}: nothing measured fits"),
                Some(row) => writeln!(text, "  {start}: {}\n    {}", row.setting, described(&row.figures)),
            };
        }
    }
    let _ = writeln!(text, "\nOne option changed, all others at their default:\n");
    let alone = |row: &&SettingRow| row.setting.changed().len() <= 1;
    for row in rows.iter().filter(alone) {
        let _ = writeln!(text, "  {}\n    {}", row.setting, described(&row.figures));
    }
    text
}

/// A table of a few settings of hullcast beside other libraries, with the same measures and the same
/// true answers.
pub(super) fn beside(pool: CellPool, rows: &[SettingRow], peers: &[PeerRow]) -> String {
    let default = Setting::DEFAULT;
    let ours = [
        ("hullcast", default),
        ("  warm", Setting { warm: true, ..default }),
        ("  four points", Setting { max_points: 4, ..default }),
        ("  one point", Setting { max_points: 1, ..default }),
        ("  feature angle 0", Setting { feature_angle: 0.0, ..default }),
        ("  feature angle 0.1", Setting { feature_angle: 0.1, ..default }),
        ("  about the ball", Setting { centre: Centre::Ball, ..default }),
        ("  about an offset", Setting { centre: Centre::Offset, ..default }),
        ("  ray cast", Setting { solver: Solver::GjkRayCast, ..default }),
    ];
    let of = |(name, setting): (&'static str, Setting)| {
        rows.iter().find(|row| row.setting == setting).map(|row| (name, &row.figures))
    };
    let all = ours.into_iter().filter_map(of);
    let all = all.chain(peers.iter().map(|peer| (peer.name.as_str(), &peer.figures)));
    let what = match pool {
        CellPool::All => "All pairs except deep ones",
        CellPool::Deep => "Deep pairs",
    };
    let mut text = format!("{what}, settings and other libraries (p95 unless p50 is named):\n\n");
    let mut line = |cells: [&str; COLUMNS.len()]| {
        let width = COLUMNS[0].1;
        let figures = COLUMNS.iter().zip(cells).skip(1).map(|(&(_, width), cell)| format!("{cell:>width$}"));
        let figures: String = figures.collect();
        let _ = writeln!(text, "{:<width$}{figures}", cells[0]);
    };
    line(COLUMNS.map(|(name, _)| name));
    for (name, f) in all {
        line([
            name,
            &format!("x{:.2}", f.relative_time),
            &format!("{:.0}", f.time[0]),
            &format!("{:.1}", 100.0 * f.flagged),
            &format!("{:.0e}", f.optimality[1]),
            &format!("{:.0e}", f.angle[1]),
            &format!("{:.0e}", f.separation[0]),
            &format!("x{:.3}", f.depth[0]),
            &format!("x{:.3}", f.depth[1]),
            &format!("{:.0e}", f.axis[1]),
            &format!("{:.0e}", f.hausdorff[1]),
            &format!("x{:.2}", f.area[0]),
            &format!("{:.1}", 100.0 * f.flickers),
        ]);
    }
    text
}

/// The columns of [`beside`]: names and widths.
const COLUMNS: [(&str, usize); 13] = [
    ("", 20),
    ("time", 7),
    ("ns p50", 8),
    ("flag %", 8),
    ("normal", 8),
    ("angle", 8),
    ("separ.", 8),
    ("depth p50", 11),
    ("depth", 9),
    ("axis", 8),
    ("patch", 8),
    ("area p50", 10),
    ("jump %", 8),
];

/// The main figures as text.
pub(super) fn described(f: &Figures) -> String {
    format!(
        "time x{:.2}, gap {:.1e} (max), normal {:.1e} short of optimal (p95), angle {:.1e} rad (p95), \
         depth x{:.2} the minimum translation (p95), patch {:.1e} of the size off (p95), area x{:.2} (p5), flagged {:.1} %, jumps {:.1} %",
        f.relative_time,
        f.gap[1],
        f.optimality[1],
        f.angle[1],
        f.depth[1],
        f.hausdorff[1],
        f.area[1],
        100.0 * f.flagged,
        100.0 * f.flickers
    )
}
