//! Runs work of the service itself, such as decoding and copying. Small work runs on the thread
//! that serves the call. Large work runs on the compute threads, which take turns between callers
//! and stop if the caller has left.

use super::{App, ServiceError, context::CallContext};
use crate::{
    compute::{ComputeError, LARGE_BYTES, Panicked},
    contact::{Stop, Stopped},
    log_limit::limited,
};

/// Bytes per elementary step of such work.
const BYTES_PER_STEP: usize = 2;

/// Runs `work`, which handles about `bytes` bytes.
///
/// # Errors
/// The errors of `work`; INTERNAL if it panicked.
pub(super) async fn offloaded<T: Send + 'static>(
    app: &App,
    context: &CallContext,
    bytes: usize,
    work: impl FnOnce(&Stop) -> Result<T, ServiceError> + Send + 'static,
) -> Result<T, ServiceError> {
    if bytes <= LARGE_BYTES {
        return work(&context.job.stop);
    }
    match app.engine().compute_threads().run_steps(steps(bytes), work, &context.job).await {
        Ok(done) => done,
        Err(ComputeError::Stopped) => Err(Stopped.into()),
        Err(ComputeError::Panicked(Panicked(why))) => {
            limited!(error, why, "work of the service panicked");
            Err(ServiceError::internal("the request could not be processed; the server's log has the reason"))
        }
    }
}

/// The estimated steps of work on `bytes` bytes.
fn steps(bytes: usize) -> u64 {
    (bytes / BYTES_PER_STEP) as u64
}
