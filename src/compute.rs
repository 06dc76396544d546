//! The threads that compute, beside the async runtime's, so that a long batch
//! never keeps the server from answering a short one.

use std::{
    any::Any,
    fmt,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::Arc,
};

use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};
use tokio::sync::oneshot;

/// A pool of threads for computation.
#[derive(Clone, Debug)]
pub struct Compute {
    pool: Arc<ThreadPool>,
}

/// The computation panicked: a bug, that ends its own call alone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Panicked(pub String);

impl fmt::Display for Panicked {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "panicked: {}", self.0)
    }
}

impl Compute {
    /// Starts `threads` threads; 0: one a core.
    ///
    /// # Errors
    /// The system has no more threads.
    pub fn new(threads: usize) -> Result<Self, ThreadPoolBuildError> {
        let pool =
            ThreadPoolBuilder::new().num_threads(threads).thread_name(|i| format!("compute-{i}")).build()?;
        Ok(Self { pool: Arc::new(pool) })
    }

    /// How many threads compute.
    pub fn threads(&self) -> usize {
        self.pool.current_num_threads()
    }

    /// Runs `work` on the pool, where its rayon iterators are split over all threads.
    pub async fn run<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Panicked> {
        let (send, receive) = oneshot::channel();
        self.pool.spawn(move || {
            // Whoever waited may be gone: nothing to do then.
            let _ = send.send(caught(work));
        });
        receive.await.unwrap_or_else(|_| Err(Panicked("the pool dropped the work".into())))
    }
}

/// `work`, here and now, its panic caught.
pub fn caught<T>(work: impl FnOnce() -> T) -> Result<T, Panicked> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|payload| Panicked(text(&*payload)))
}

fn text(payload: &(dyn Any + Send)) -> String {
    let text = payload.downcast_ref::<&str>().map(|s| (*s).to_owned());
    text.or_else(|| payload.downcast_ref::<String>().cloned()).unwrap_or_else(|| "no message".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a bug in one call's computation that takes the process with it.
    #[tokio::test]
    async fn a_panic_is_an_error_of_its_own_call() {
        let compute = Compute::new(2).unwrap();
        let failed = compute.run(|| -> u32 { panic!("on purpose") }).await;
        assert_eq!(failed, Err(Panicked("on purpose".into())));
        assert_eq!(compute.run(|| 7).await, Ok(7));
    }
}
