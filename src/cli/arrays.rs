//! An answer as numpy arrays, in the format that `Manifolds.save` of the Python client writes too.

use std::fs::File;
use std::io;
use std::path::Path;

use super::npz::Npz;
use super::report::Answered;
use hullcast::proto::Output;

/// The format's name, which must be that of `client/src/hullcast/_export.py`.
const FORMAT: &str = "hullcast.manifolds.v1";

impl Answered<'_> {
    /// Writes the requested columns under their names on the wire, and `pairs`. A column with
    /// several numbers per row becomes a two-dimensional array.
    ///
    /// # Errors
    /// The file cannot be written.
    pub(crate) fn write_npz(&self, path: &Path, outputs: &[i32]) -> io::Result<()> {
        use Output::{Alpha, Bases, Diagnostics, Features, Normal, Points, WitnessB};
        let c = self.columns;
        let asked = |any: &[Output]| any.iter().any(|&output| outputs.contains(&(output as i32)));
        let mut file = Npz::new(io::BufWriter::new(File::create(path)?));
        file.text("format", FORMAT)?;
        file.array("pairs", &self.scene.pairs, 2)?;
        file.array("outcomes", &c.outcomes, 1)?;
        file.array("flags", &c.flags, 1)?;
        file.array("missing_hulls", &c.missing_hulls, 1)?;
        file.array("invalid_bodies", &c.invalid_bodies, 1)?;
        // A server with the first version of the contract does not send this column, so its values
        // are unknown.
        let unknown = vec![f64::NAN; c.outcomes.len()];
        let kept_areas = if c.kept_areas.is_empty() { &unknown } else { &c.kept_areas };
        let floats: [(&str, &[f64], usize, Output); 9] = [
            ("alphas", &c.alphas, 1, Alpha),
            ("alpha_lowers", &c.alpha_lowers, 1, Alpha),
            ("alpha_uppers", &c.alpha_uppers, 1, Alpha),
            ("separations", &c.separations, 1, Normal),
            ("normals", &c.normals, 3, Normal),
            ("witness_as", &c.witness_as, 3, Points),
            ("distances", &c.distances, 1, Points),
            ("witness_bs", &c.witness_bs, 3, WitnessB),
            ("kept_areas", kept_areas, 1, Diagnostics),
        ];
        for (name, column, width, _) in floats.into_iter().filter(|(.., output)| asked(&[*output])) {
            file.array(name, column, width)?;
        }
        if asked(&[Points, WitnessB, Features]) {
            file.array("point_counts", &c.point_counts, 1)?;
        }
        if asked(&[Features]) {
            file.array("feature_kinds", &c.feature_kinds, 2)?;
        }
        let integers: [(&str, &[u32], usize, Output); 5] = [
            ("feature_indices", &c.feature_indices, 4, Features),
            ("point_ids", &c.point_ids, 4, Features),
            ("bases", &c.bases, 6, Bases),
            ("iterations", &c.iterations, 1, Diagnostics),
            ("support_calls", &c.support_calls, 1, Diagnostics),
        ];
        for (name, column, width, _) in integers.into_iter().filter(|(.., output)| asked(&[*output])) {
            file.array(name, column, width)?;
        }
        file.finish()?;
        Ok(())
    }
}
