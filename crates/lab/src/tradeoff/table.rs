//! The results with one row per setting and cell, and the selection of the rows that no other beats.

use std::fmt::Write;

use super::measure::Sample;
use super::settings::{KNOBS, Setting};

/// The results of one setting, on one cell or on a pool of cells.
#[derive(Clone, Debug)]
pub(super) struct SettingRow {
    pub(super) cell: String,
    pub(super) setting: Setting,
    pub(super) figures: Figures,
}

/// The results of another library, on one cell or on a pool of cells.
#[derive(Clone, Debug)]
pub(super) struct PeerRow {
    pub(super) cell: String,
    pub(super) name: String,
    pub(super) figures: Figures,
}

/// The columns of times and errors.
#[derive(Clone, Copy, Debug)]
pub(super) struct Figures {
    pub(super) pairs: usize,
    pub(super) time: [f64; 3],
    /// Time relative to the default's: the geometric mean, over cells, of the ratio of the medians.
    pub(super) relative_time: f64,
    pub(super) gap: [f64; 2],
    pub(super) optimality: [f64; 3],
    pub(super) angle: [f64; 2],
    pub(super) separation: [f64; 2],
    pub(super) depth: [f64; 2],
    /// How far the ratio of depths is from 1, p95.
    pub(super) depth_off: f64,
    pub(super) axis: [f64; 2],
    pub(super) hausdorff: [f64; 2],
    pub(super) area: [f64; 2],
    pub(super) flagged: f64,
    pub(super) flickers: f64,
}

const COLUMNS: [&str; 24] = [
    "pairs",
    "ns_p50",
    "ns_p95",
    "ns_p99",
    "relative_time",
    "gap_p50",
    "gap_max",
    "optimality_p50",
    "optimality_p95",
    "optimality_max",
    "angle_p50",
    "angle_p95",
    "separation_p95",
    "separation_max",
    "depth_ratio_p50",
    "depth_ratio_p95",
    "depth_off_p95",
    "axis_angle_p50",
    "axis_angle_p95",
    "hausdorff_p50",
    "hausdorff_p95",
    "area_ratio_p50",
    "area_ratio_p05",
    "flagged",
];

impl Figures {
    pub(super) fn of(samples: &[Sample], relative_time: f64) -> Self {
        let count = samples.len().max(1) as f64;
        let share = |of: fn(&Sample) -> bool| samples.iter().filter(|s| of(s)).count() as f64 / count;
        let at = |of: fn(&Sample) -> Option<f64>| Sorted::new(samples.iter().filter_map(of));
        let (time, gap) = (at(|s| Some(s.nanoseconds)), at(|s| s.gap));
        let (optimality, angle) = (at(|s| s.optimality), at(|s| s.angle));
        let (separation, depth) = (at(|s| s.separation), at(|s| s.depth));
        let [depth_off] = at(|s| s.depth.map(|ratio| (ratio - 1.0).abs())).at([0.95]);
        let (hausdorff, area) = (at(|s| Some(s.hausdorff)), at(|s| s.area));
        Self {
            pairs: samples.len(),
            time: time.at([0.5, 0.95, 0.99]),
            relative_time,
            gap: gap.at([0.5, 1.0]),
            optimality: optimality.at([0.5, 0.95, 1.0]),
            angle: angle.at([0.5, 0.95]),
            separation: separation.at([0.95, 1.0]),
            depth: depth.at([0.5, 0.95]),
            depth_off,
            axis: at(|s| s.axis).at([0.5, 0.95]),
            hausdorff: hausdorff.at([0.5, 0.95]),
            area: area.at([0.5, 0.05]),
            flagged: share(|s| s.flagged),
            flickers: share(|s| s.flickers),
        }
    }

    fn values(&self) -> Vec<f64> {
        let lists: [&[f64]; 13] = [
            &[self.pairs as f64],
            &self.time,
            &[self.relative_time],
            &self.gap,
            &self.optimality,
            &self.angle,
            &self.separation,
            &self.depth,
            &[self.depth_off],
            &self.axis,
            &self.hausdorff,
            &self.area,
            &[self.flagged, self.flickers],
        ];
        lists.concat()
    }
}

/// Numbers in ascending order, for percentiles.
pub(super) struct Sorted(Vec<f64>);

impl Sorted {
    pub(super) fn new(numbers: impl Iterator<Item = f64>) -> Self {
        let mut numbers: Vec<f64> = numbers.collect();
        numbers.sort_unstable_by(f64::total_cmp);
        Self(numbers)
    }

    /// The quantiles for these fractions, each the nearest of the numbers; NaN if there are no numbers.
    pub(super) fn at<const N: usize>(&self, shares: [f64; N]) -> [f64; N] {
        let last = self.0.len().saturating_sub(1) as f64;
        shares.map(|share| self.0.get((share * last).round() as usize).copied().unwrap_or(f64::NAN))
    }
}

/// A header, then one line per row. Another library has its name in the solver's column, and no knobs.
pub(super) fn csv(rows: &[SettingRow], peers: &[PeerRow]) -> String {
    let mut text = format!("cell,{},{},flickers\n", KNOBS.join(","), COLUMNS.join(","));
    let mut line = |cell: &str, knobs: &str, figures: &Figures| {
        let values: Vec<String> = figures.values().iter().map(|value| short(*value)).collect();
        let _ = writeln!(text, "{cell},{knobs},{}", values.join(","));
    };
    for row in rows {
        line(&row.cell, &row.setting.values().join(","), &row.figures);
    }
    for row in peers {
        line(&row.cell, &format!("{}{}", row.name, ",".repeat(KNOBS.len() - 1)), &row.figures);
    }
    text
}

/// The number as text, with four digits, which are more than a measurement has.
fn short(value: f64) -> String {
    match value {
        _ if value == 0.0 || !value.is_finite() || value.fract() == 0.0 && value.abs() < 1e9 => {
            value.to_string()
        }
        _ if (1e-2..1e4).contains(&value.abs()) => format!("{value:.4}"),
        _ => format!("{value:.3e}"),
    }
}

/// The rows that no other row beats in both time and `error`, in ascending order of time.
pub(super) fn front(rows: &[SettingRow], error: impl Fn(&Figures) -> f64) -> Vec<usize> {
    let mut order: Vec<usize> = (0..rows.len()).collect();
    let key = |i: usize| (rows[i].figures.relative_time, error(&rows[i].figures));
    order.sort_unstable_by(|&i, &j| key(i).0.total_cmp(&key(j).0).then(key(i).1.total_cmp(&key(j).1)));
    let mut least = f64::INFINITY;
    order.retain(|&i| {
        let better = key(i).1 < least;
        least = least.min(key(i).1);
        better
    });
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(nanoseconds: f64, optimality: f64) -> Sample {
        Sample {
            nanoseconds,
            optimality: Some(optimality),
            gap: Some(0.0),
            angle: Some(0.0),
            separation: Some(0.0),
            depth: None,
            axis: None,
            hausdorff: 0.0,
            area: None,
            flagged: false,
            flickers: false,
        }
    }

    /// Catches percentiles of the wrong column or end, a header that does not fit its rows, and a front that
    /// contains a row beaten by another.
    #[test]
    fn figures_and_fronts_are_what_they_say() {
        let samples: Vec<Sample> = (0..101).map(|i| sample(f64::from(i), f64::from(100 - i))).collect();
        let figures = Figures::of(&samples, 1.0);
        assert_eq!((figures.time, figures.optimality), ([50.0, 95.0, 99.0], [50.0, 95.0, 100.0]));
        assert!(figures.depth[0].is_nan());
        let rows: Vec<SettingRow> = [(1.0, 5.0), (2.0, 5.0), (3.0, 1.0), (0.5, 9.0), (4.0, 2.0)]
            .map(|(time, error)| SettingRow {
                cell: "all".into(),
                setting: Setting::DEFAULT,
                figures: Figures::of(&[sample(time, error)], time),
            })
            .to_vec();
        assert_eq!(front(&rows, |f| f.optimality[2]), [3, 0, 2]);
        let peer = PeerRow { cell: "all".into(), name: "peer".into(), figures };
        let text = csv(&rows, &[peer]);
        let mut lines = text.lines().map(|line| line.split(',').count());
        let columns = lines.next().unwrap();
        assert_eq!(lines.map(|count| assert_eq!(count, columns)).count(), 6);
    }
}
