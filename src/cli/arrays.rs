//! An answer as numpy arrays, in the format that `Manifolds.save` of the Python client writes too.

use std::fs::File;
use std::io;
use std::path::Path;

use super::npz::Npz;
use super::report::AnsweredFrame;
use hullcast::batch::{Output, Outputs, columns::Values};
use hullcast::service::wire::response_columns;

/// The format's name, which must be that of `client/src/hullcast/_export.py`.
const FORMAT: &str = "hullcast.manifolds.v1";

impl AnsweredFrame<'_> {
    /// Writes the requested columns under their names on the wire, and `pairs`. A column with
    /// several numbers per row becomes a two-dimensional array.
    ///
    /// # Errors
    /// The file cannot be written.
    pub(crate) fn write_npz(&self, path: &Path, outputs: &[i32]) -> io::Result<()> {
        let c = self.columns;
        let outputs = Outputs::of(outputs.iter().filter_map(|&output| Output::from_number(output)));
        let mut file = Npz::new(io::BufWriter::new(File::create(path)?));
        file.text("format", FORMAT)?;
        file.array("pairs", &self.scene.pairs, 2)?;
        file.array("missing_hulls", &c.missing_hulls, 1)?;
        file.array("invalid_bodies", &c.invalid_bodies, 1)?;
        let unknown = vec![f64::NAN; c.outcomes.len()];
        for (column, values) in response_columns(c).filter(|(column, _)| column.is_sent(outputs)) {
            // A server of the first version of the contract does not send a later column, so its values are
            // unknown.
            let lacks = column.is_later && values.is_empty();
            match if lacks { Values::F64(&unknown) } else { values } {
                Values::U8(values) => file.array(column.name, values, column.width)?,
                Values::U32(values) => file.array(column.name, values, column.width)?,
                Values::F64(values) => file.array(column.name, values, column.width)?,
            }
        }
        file.finish()?;
        Ok(())
    }
}
