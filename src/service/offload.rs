//! Work of the service itself, such as decoding and copying: small work is done on the thread
//! that serves the call, large work on the compute threads, which take turns between callers
//! and stop when nobody waits.

use std::ops::{Deref, DerefMut};

use super::{App, ServiceError, context::CallContext};
use crate::{
    compute::{Compute, Panicked},
    contact::Stop,
};

/// Work on more bytes than this is done on the compute threads. Up to this it takes at most
/// about a millisecond, and a thread that serves calls may do it.
const LARGE_BYTES: usize = 256 << 10;

/// Does `work` on about `bytes` bytes.
///
/// # Errors
/// Those of `work`; INTERNAL where it panicked.
pub(super) async fn offloaded<T: Send + 'static>(
    app: &App,
    context: &CallContext,
    bytes: usize,
    work: impl FnOnce(&Stop) -> Result<T, ServiceError> + Send + 'static,
) -> Result<T, ServiceError> {
    if bytes <= LARGE_BYTES {
        return work(&context.job.stop);
    }
    let stop = context.job.stop.clone();
    app.engine().compute_threads().run(move || work(&stop)).await.unwrap_or_else(|Panicked(why)| {
        tracing::error!(why, "work of the service panicked");
        Err(ServiceError::internal("the request could not be worked on"))
    })
}

/// A value whose memory a compute thread frees where it has many bytes: giving much memory back
/// to the system takes milliseconds, in which a thread that serves calls would serve none.
#[derive(Debug)]
pub(super) struct FreedOnCompute<T: Send + 'static> {
    /// None only while the wrapper is dropped or unwrapped.
    value: Option<T>,
    bytes: usize,
    compute: Compute,
}

impl<T: Send + 'static> FreedOnCompute<T> {
    /// A value of about `bytes` bytes.
    pub(super) fn new(value: T, bytes: usize, app: &App) -> Self {
        Self { value: Some(value), bytes, compute: app.engine().compute_threads().clone() }
    }

    /// The value, which its new owner frees.
    pub(super) fn into_inner(mut self) -> T {
        self.value.take().unwrap_or_else(|| unreachable!("a value is taken once"))
    }
}

impl<T: Send + 'static> Deref for FreedOnCompute<T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.value.as_ref().unwrap_or_else(|| unreachable!("a value that is taken is not used"))
    }
}

impl<T: Send + 'static> DerefMut for FreedOnCompute<T> {
    fn deref_mut(&mut self) -> &mut T {
        self.value.as_mut().unwrap_or_else(|| unreachable!("a value that is taken is not used"))
    }
}

impl<T: Send + 'static> Drop for FreedOnCompute<T> {
    fn drop(&mut self) {
        let large = self.value.take().filter(|_| self.bytes > LARGE_BYTES);
        if let (Some(value), Ok(runtime)) = (large, tokio::runtime::Handle::try_current()) {
            let compute = self.compute.clone();
            runtime.spawn(async move { compute.run(move || drop(value)).await });
        }
    }
}

#[cfg(test)]
mod tests {
    use std::{sync::mpsc, thread};

    use super::*;
    use crate::{service::Limits, store::blobs};

    /// Says on which thread it is dropped.
    struct Dropped(mpsc::Sender<Option<String>>);

    impl Drop for Dropped {
        fn drop(&mut self) {
            let _ = self.0.send(thread::current().name().map(str::to_owned));
        }
    }

    /// Catches much memory that is freed by a thread that serves calls, little memory that is
    /// handed to another thread, and a value that is freed by its wrapper after it was taken.
    #[tokio::test(flavor = "multi_thread")]
    async fn large_values_are_freed_on_the_compute_threads() {
        let app = App::new(blobs::open("memory://").unwrap(), Limits::default(), 1).unwrap();
        let (send, freed) = mpsc::channel();
        let here = thread::current().name().map(str::to_owned);
        for (bytes, elsewhere) in [(LARGE_BYTES, false), (LARGE_BYTES + 1, true)] {
            drop(FreedOnCompute::new(Dropped(send.clone()), bytes, &app));
            let thread = tokio::task::block_in_place(|| freed.recv().unwrap());
            let expected = if elsewhere { Some("compute-0".to_owned()) } else { here.clone() };
            assert_eq!(thread, expected);
        }
        let taken = FreedOnCompute::new(Dropped(send.clone()), LARGE_BYTES + 1, &app).into_inner();
        assert!(freed.try_recv().is_err());
        drop(taken);
        assert_eq!(freed.recv().unwrap(), here);
    }
}
