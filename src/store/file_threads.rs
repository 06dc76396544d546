//! Threads for file operations, separate from those of the async runtime.
//!
//! A file operation can block forever, for example on a network file system whose server is gone.
//! On separate threads, blocked operations keep no other work of the process from running. Nothing
//! waits for these threads to end: the process may exit while one of them is blocked.

use std::{
    fmt, io,
    sync::{
        Arc, Mutex,
        mpsc::{Receiver, SyncSender, TrySendError, sync_channel},
    },
    thread,
};

use tokio::sync::oneshot;

use crate::compute::catch_panic;
use crate::lock::locked;

type Task = Box<dyn FnOnce() + Send>;

/// The number of operations that may wait for a thread. A further operation fails. The registry
/// starts far fewer at a time.
const WAITING: usize = 256;

/// The threads. They end when this is dropped and their last operation has returned.
pub(super) struct FileThreads {
    tasks: SyncSender<Task>,
}

impl fmt::Debug for FileThreads {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("FileThreads").finish_non_exhaustive()
    }
}

impl FileThreads {
    /// Starts `count` threads.
    ///
    /// # Errors
    /// The system has no more threads.
    pub(super) fn start(count: usize) -> io::Result<Self> {
        let (tasks, queue) = sync_channel::<Task>(WAITING);
        let queue = Arc::new(Mutex::new(queue));
        for index in 0..count {
            let queue = queue.clone();
            thread::Builder::new().name(format!("file-{index}")).spawn(move || {
                while let Some(task) = next(&queue) {
                    task();
                }
            })?;
        }
        Ok(Self { tasks })
    }

    /// Runs `operation` on one of the threads. It does not run if its caller has left before its
    /// turn.
    ///
    /// # Errors
    /// The operation panicked, or too many operations wait for a thread.
    pub(super) async fn run<T: Send + 'static>(
        &self,
        operation: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, String> {
        let (send, receive) = oneshot::channel();
        let task = Box::new(move || {
            if !send.is_closed() {
                let _ = send.send(catch_panic(operation).map_err(|panicked| panicked.to_string()));
            }
        });
        match self.tasks.try_send(task) {
            Ok(()) => receive.await.unwrap_or_else(|_| Err("the file threads ended".into())),
            Err(TrySendError::Full(_)) => Err("too many file operations are waiting".into()),
            Err(TrySendError::Disconnected(_)) => Err("the file threads ended".into()),
        }
    }
}

/// The next task, or `None` if the threads have to end.
fn next(queue: &Mutex<Receiver<Task>>) -> Option<Task> {
    locked(queue).recv().ok()
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;

    /// Catches operations that wait without bound behind blocked ones, an operation that runs
    /// although its caller has left, and a panic that ends a thread.
    #[tokio::test]
    async fn waiting_operations_are_bounded() {
        let threads = FileThreads::start(1).unwrap();
        assert!(threads.run(|| -> u32 { panic!("on purpose") }).await.unwrap_err().contains("on purpose"));
        assert_eq!(threads.run(|| 7).await, Ok(7));
        let ((started, has_started), (unblock, blocked)) = (channel(), channel::<()>());
        let mut blocking = Box::pin(threads.run(move || {
            started.send(()).unwrap();
            let _ = blocked.recv();
        }));
        assert!(futures_util::poll!(blocking.as_mut()).is_pending());
        has_started.recv().unwrap();
        let ran = Arc::new(Mutex::new(0));
        let mut waiting: Vec<_> = (0..=WAITING)
            .map(|_| {
                let ran = ran.clone();
                Box::pin(threads.run(move || *ran.lock().unwrap() += 1))
            })
            .collect();
        for operation in &mut waiting[..WAITING] {
            assert!(futures_util::poll!(operation.as_mut()).is_pending());
        }
        let one_more = waiting.pop().unwrap().await;
        assert!(one_more.unwrap_err().contains("too many"));
        waiting.truncate(1);
        drop(unblock);
        waiting.pop().unwrap().await.unwrap();
        threads.run(|| ()).await.unwrap();
        assert_eq!(*ran.lock().unwrap(), 1, "the others have nobody who waits for them");
    }
}
