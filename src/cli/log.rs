//! Sends log lines to standard error, and traces to a collector if one is configured.
//!
//! Standard error may be a pipe that nobody reads at the moment. A thread that writes to a full pipe waits, and
//! if the threads that serve calls wrote there themselves, the whole server would wait for the reader of its
//! log. Therefore they put each line into a bounded queue, and one thread of its own writes the lines. If the
//! queue is full, a line is left out, and the next line that is written tells how many were. (The crate
//! tracing-appender does the same, but it panics if the system refuses its thread.)

use std::{
    io::{self, Write},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
        mpsc::{Receiver, RecvTimeoutError, SyncSender, channel, sync_channel},
    },
    thread,
    time::Duration,
};

use hullcast::trace;
use tracing_subscriber::{
    Layer,
    filter::{FilterExt, LevelFilter, filter_fn},
    fmt::MakeWriter,
    layer::SubscriberExt,
    util::SubscriberInitExt,
};

use super::{
    Error,
    exit::Exit,
    runtime, serve_values,
    settings::{LogFormat, Settings},
    traces::Traces,
};

/// The number of lines that wait for standard error. A line has some hundred bytes.
const WAITING_LINES: usize = 1024;

/// The time that the waiting lines have to be written when the program ends.
const LAST_LINES: Duration = Duration::from_secs(1);

/// The log and the traces, for as long as this is held.
pub(crate) struct Observability {
    traces: Option<Traces>,
    ended: Receiver<()>,
    lines: LogQueue,
}

/// Starts the log and the traces.
///
/// # Errors
/// A setting is wrong, or the system refuses a thread.
pub(crate) fn start(settings: &Settings) -> Result<Observability, Error> {
    let named = |why| Exit::Usage.error(format!("log {:?}: {why}", settings.log));
    let filter = serve_values::filter(&settings.log).map_err(named)?;
    // Without the hint, the filter would count as one for every level.
    let of_log = filter_fn(|metadata| metadata.target() != trace::TARGET);
    let filter = filter.and(of_log.with_max_level_hint(LevelFilter::TRACE));
    let (lines, ended) = LogQueue::to(io::stderr())
        .map_err(|error| Exit::Failed.error(runtime::refused(&error.to_string())))?;
    let log = tracing_subscriber::fmt::layer().with_writer(lines.clone());
    let log = match settings.log_format {
        LogFormat::Text => log.with_ansi(false).boxed(),
        LogFormat::Json => log.json().boxed(),
    };
    let is_traced = !settings.otlp_endpoint.is_empty();
    let traces = is_traced.then(|| Traces::open(settings)).transpose()?;
    let subscriber = tracing_subscriber::registry().with(log.with_filter(filter));
    // A layer that is absent (`None`) must not be added: it has no filter, so every span of every library
    // would be created and closed for it, several for each message.
    match &traces {
        None => subscriber.init(),
        Some(traces) => subscriber.with(traces.layer()).init(),
    }
    Ok(Observability { traces, ended, lines })
}

impl Observability {
    /// Sends what waits: the traces to their collector, and the lines to standard error, if it takes them.
    pub(crate) fn flush(self) {
        if let Some(traces) = self.traces {
            traces.flush();
        }
        if self.lines.queue.try_send(LogLine::Last).is_ok() {
            let _: Result<(), RecvTimeoutError> = self.ended.recv_timeout(LAST_LINES);
        }
    }
}

enum LogLine {
    Text(Vec<u8>),
    /// Everything before this has been written when the thread meets it.
    Last,
}

/// Puts lines into the queue.
#[derive(Clone)]
struct LogQueue {
    queue: SyncSender<LogLine>,
    left_out: Arc<AtomicU64>,
}

impl LogQueue {
    /// A queue of lines for `output`. The receiver hears when the last line has been written.
    fn to(mut output: impl Write + Send + 'static) -> io::Result<(Self, Receiver<()>)> {
        let (queue, lines) = sync_channel(WAITING_LINES);
        let (end, ended) = channel();
        let left_out = Arc::<AtomicU64>::default();
        let missing = left_out.clone();
        thread::Builder::new().name("log".into()).spawn(move || {
            for line in lines {
                let LogLine::Text(text) = line else { break };
                // Nothing can be done about an output that takes no more lines.
                let _ = output.write_all(&text);
                let count = missing.swap(0, Ordering::Relaxed);
                if count > 0 {
                    let _ = writeln!(output, "{count} log lines were left out, because the log was not read");
                }
            }
            let _ = end.send(());
        })?;
        Ok((Self { queue, left_out }, ended))
    }
}

impl Write for LogQueue {
    /// Takes one line, as the log's layer writes it.
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        if self.queue.try_send(LogLine::Text(line.to_vec())).is_err() {
            self.left_out.fetch_add(1, Ordering::Relaxed);
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl MakeWriter<'_> for LogQueue {
    type Writer = Self;

    fn make_writer(&self) -> Self {
        self.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An output that takes a line when the test gives permission.
    struct Slow(Receiver<()>, std::sync::mpsc::Sender<String>);

    impl Write for Slow {
        fn write(&mut self, text: &[u8]) -> io::Result<usize> {
            let _ = self.0.recv();
            let _ = self.1.send(String::from_utf8_lossy(text).into_owned());
            Ok(text.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    /// Catches a writer that waits for an output that takes nothing, a queue without a bound, and lines that
    /// are left out without a word.
    #[test]
    fn a_log_that_is_not_read_holds_nobody_up() {
        let (permit, permits) = channel();
        let (written, lines) = channel();
        let (mut log, ended) = LogQueue::to(Slow(permits, written)).unwrap();
        for _ in 0..3 * WAITING_LINES {
            log.write_all(b"a line\n").unwrap();
        }
        let left_out = log.left_out.load(Ordering::Relaxed);
        assert!(left_out >= 2 * WAITING_LINES as u64 - 1, "{left_out}");
        drop(permit);
        log.queue.send(LogLine::Last).unwrap();
        ended.recv().unwrap();
        let lines: Vec<_> = lines.try_iter().collect();
        assert!(lines.iter().any(|line| line.contains("left out")), "{} lines", lines.len());
        assert_eq!(lines.iter().filter(|line| *line == "a line\n").count() as u64, 3 * 1024 - left_out);
    }
}
