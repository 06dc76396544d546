//! Shows the progress of a measurement on standard error, if that is a terminal.

use indicatif::{ProgressBar, ProgressFinish, ProgressStyle};

/// The progress of work in `total` parts. `what` names the parts, as in "settings". Call `inc` for each
/// finished part. The line is removed when the value is dropped.
pub(crate) fn bar(what: &'static str, total: usize) -> ProgressBar {
    let bar = ProgressBar::new(total as u64).with_finish(ProgressFinish::AndClear).with_message(what);
    match ProgressStyle::with_template("{msg} {bar:30} {pos}/{len}, {elapsed} so far, {eta} left") {
        Ok(style) => bar.with_style(style),
        Err(_) => bar,
    }
}
