//! Starts the async runtime.

use std::panic::{self, AssertUnwindSafe};

use tokio::runtime::{Builder, Runtime};

use super::Error;
use super::exit::Exit;

/// The runtime as it is built by default, with threads of its own.
///
/// # Errors
/// Those of [`start`].
pub(crate) fn with_threads() -> Result<Runtime, Error> {
    start(Builder::new_multi_thread().enable_all())
}

/// Starts a runtime.
///
/// # Errors
/// The system refuses it threads, memory or file descriptors.
pub(crate) fn start(builder: &mut Builder) -> Result<Runtime, Error> {
    // tokio panics if the system refuses to start one of its threads. Its message would stand beside the
    // one below.
    let hook = panic::take_hook();
    panic::set_hook(Box::new(|_| {}));
    let built = panic::catch_unwind(AssertUnwindSafe(|| builder.build()));
    panic::set_hook(hook);
    let why = match built {
        Ok(Ok(runtime)) => return Ok(runtime),
        Ok(Err(error)) => error.to_string(),
        Err(panicked) => panicked.downcast_ref::<String>().cloned().unwrap_or_default(),
    };
    Err(Exit::Failed.error(refused(&why)))
}

/// The message about a system that refuses to start threads. `why` is its own reason.
pub(crate) fn refused(why: &str) -> String {
    format!(
        "the system refuses to start a thread ({why}): raise its limits of address space (ulimit -v) and of \
         processes (ulimit -u, TasksMax)"
    )
}
