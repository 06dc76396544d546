//! Chooses calls, and writes their records on a thread of its own.

use std::{
    collections::HashSet,
    fs::{self, File, OpenOptions},
    io::{self, Write},
    os::unix::fs::{DirBuilderExt, OpenOptionsExt},
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
        mpsc::{Receiver, Sender, SyncSender, channel, sync_channel},
    },
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use bytes::Bytes;
use prometheus_client::metrics::gauge::Gauge;
use prost::Message as _;

use super::{
    RecordOptions, Tape,
    format::{Call, Content, Header, MAGIC, append},
    reader::{EXTENSION, files},
};
use crate::{
    log_limit::limited,
    metrics::{Metrics, RecordFate},
    proto::{
        CONTRACT,
        methods::{FIND_CONTACTS, QUERY_CONTACTS, STREAM_CONTACTS},
    },
    store::HullId,
};

/// The most memory of the tapes of calls under way and of the queue, in bytes. The thread that writes takes up to about
/// twice the largest record and its hulls besides.
pub const QUEUE_BYTES: u64 = 64 << 20;

/// A directory has at most this number of files when all are full, so that little is deleted at a time.
const FILES: u64 = 4;

/// Finds the identity bytes of a hull.
pub(crate) type HullSource = Box<dyn Fn(HullId) -> Option<Vec<u8>> + Send>;

/// Records the calls of a server.
#[derive(Debug)]
pub struct Recorder {
    options: RecordOptions,
    metrics: Arc<Metrics>,
    queue: Sender<Queued>,
    held: Arc<AtomicU64>,
    /// The number of calls so far.
    calls: AtomicU64,
}

/// The work of the thread.
enum Queued {
    Record(Call, Room),
    /// Everything before this is written.
    Flush(SyncSender<()>),
}

/// Memory of the queue that a tape has taken. Dropping it gives the memory back.
#[derive(Debug)]
pub(super) struct Room {
    held: Arc<AtomicU64>,
    /// Shows `held`.
    gauge: Gauge,
    bytes: u64,
}

impl Recorder {
    /// Starts to record. `hulls` finds the hulls that the calls name; it is called on the thread that writes.
    ///
    /// # Errors
    /// The directory cannot be created or read, or the thread cannot be started.
    pub(crate) fn start(
        options: RecordOptions,
        hulls: HullSource,
        metrics: Arc<Metrics>,
    ) -> io::Result<Arc<Self>> {
        fs::DirBuilder::new().recursive(true).mode(0o700).create(&options.directory)?;
        let mut closed = Vec::new();
        for path in files(&options.directory)? {
            closed.push((path.clone(), fs::metadata(&path)?.len()));
        }
        let (queue, queued) = channel();
        let writer = Writer {
            directory: options.directory.clone(),
            max_bytes: options.max_bytes,
            closed,
            current: None,
            hulls,
            metrics: metrics.clone(),
        };
        std::thread::Builder::new().name("records".into()).spawn(move || writer.run(&queued))?;
        Ok(Arc::new(Self { options, metrics, queue, held: Arc::default(), calls: AtomicU64::new(0) }))
    }

    /// The tape of a call that begins now, if it may have to be recorded.
    pub fn tape(self: &Arc<Self>, method: &'static str, is_stream: bool) -> Option<Tape> {
        let call = self.calls.fetch_add(1, Ordering::Relaxed);
        let chosen = |calls: u64| (calls as f64 * self.options.share).floor();
        let is_chosen = chosen(call + 1) > chosen(call);
        let RecordOptions { failed, flagged, slow, .. } = self.options;
        if !(is_chosen || failed || flagged || slow.is_some()) {
            return None;
        }
        let tape = Tape::begin(self.clone(), method, is_stream, is_chosen);
        if tape.is_none() {
            self.count_dropped();
        }
        tape
    }

    /// Waits until every record that is queued now is written, at most `within`.
    pub fn flush(&self, within: Duration) {
        let (done, wait) = sync_channel(1);
        if self.queue.send(Queued::Flush(done)).is_ok() {
            let _ = wait.recv_timeout(within);
        }
    }

    pub(super) fn options(&self) -> &RecordOptions {
        &self.options
    }

    pub(super) fn room(&self, bytes: u64) -> Option<Room> {
        let mut room =
            Room { held: self.held.clone(), gauge: self.metrics.record_queue_bytes.clone(), bytes: 0 };
        room.grow(bytes).then_some(room)
    }

    pub(super) fn submit(&self, call: Call, room: Room) {
        // The thread ends only with this recorder.
        let _ = self.queue.send(Queued::Record(call, room));
    }

    pub(super) fn count_dropped(&self) {
        self.metrics.recorded(RecordFate::Dropped);
    }

    pub(super) fn count_too_large(&self) {
        self.metrics.recorded(RecordFate::TooLarge);
    }
}

impl Room {
    /// Takes more memory. Returns false, and takes nothing, if there is not enough.
    pub(super) fn grow(&mut self, more: u64) -> bool {
        let fits = |held: u64| held.checked_add(more).filter(|held| *held <= QUEUE_BYTES);
        let taken = self.held.fetch_update(Ordering::Relaxed, Ordering::Relaxed, fits).is_ok();
        if taken {
            self.gauge.inc_by(more as i64);
            self.bytes += more;
        }
        taken
    }

    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }
}

impl Drop for Room {
    fn drop(&mut self) {
        self.gauge.dec_by(self.bytes as i64);
        self.held.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

/// The thread that writes.
struct Writer {
    directory: PathBuf,
    max_bytes: u64,
    /// The files that are not written to any more and their lengths, oldest first.
    closed: Vec<(PathBuf, u64)>,
    current: Option<OpenFile>,
    hulls: HullSource,
    metrics: Arc<Metrics>,
}

/// The file that is written to.
struct OpenFile {
    path: PathBuf,
    file: File,
    bytes: u64,
    /// The hulls that the file has.
    hulls: HashSet<HullId>,
}

/// The methods whose requests name hulls.
const SCENE_METHODS: [&str; 3] = [QUERY_CONTACTS, FIND_CONTACTS, STREAM_CONTACTS];

/// The hulls that a request names. The other fields are skipped.
#[derive(Clone, PartialEq, prost::Message)]
struct NamedHulls {
    #[prost(bytes = "bytes", repeated, tag = "3")]
    hull_ids: Vec<Bytes>,
}

impl Writer {
    fn run(mut self, queued: &Receiver<Queued>) {
        while let Ok(queued) = queued.recv() {
            match queued {
                Queued::Flush(done) => _ = done.send(()),
                Queued::Record(call, _room) => {
                    let fate = self.write(call).unwrap_or_else(|error| {
                        let directory = self.directory.display();
                        limited!(warn, %error, %directory, "a record could not be written");
                        RecordFate::Failed
                    });
                    self.metrics.recorded(fate);
                    self.metrics.record_bytes.set(i64::try_from(self.total()).unwrap_or(i64::MAX));
                }
            }
        }
    }

    fn total(&self) -> u64 {
        let current = self.current.as_ref().map_or(0, |file| file.bytes);
        self.closed.iter().map(|(_, bytes)| bytes).sum::<u64>() + current
    }

    /// Writes a record, its new hulls before it, as one group.
    fn write(&mut self, mut call: Call) -> io::Result<RecordFate> {
        if self.current.as_ref().is_some_and(|file| file.bytes >= self.max_bytes / FILES) {
            self.close();
        }
        let mut group = Vec::new();
        if self.current.is_none() {
            group.extend_from_slice(MAGIC);
            append(Content::Header(header()), &mut group);
        }
        let (mut asked, mut new) = (HashSet::new(), HashSet::new());
        for id in named(&call) {
            let has = self.current.as_ref().is_some_and(|file| file.hulls.contains(&id));
            if has || !asked.insert(id) {
                continue;
            }
            let found =
                (self.hulls)(id).is_some_and(|hull| append(Content::Hull(Bytes::from(hull)), &mut group));
            if found {
                new.insert(id);
            }
            call.missing_hulls += u32::from(!found);
            if group.len() as u64 > self.max_bytes / FILES {
                return Ok(RecordFate::TooLarge);
            }
        }
        if !append(Content::Call(call), &mut group) || group.len() as u64 > self.max_bytes / FILES {
            return Ok(RecordFate::TooLarge);
        }
        self.make_room(group.len() as u64)?;
        let file = match &mut self.current {
            Some(file) => file,
            None => self.current.insert(OpenFile::create(&self.directory)?),
        };
        if let Err(error) = file.file.write_all(&group) {
            self.take_back();
            return Err(error);
        }
        file.bytes += group.len() as u64;
        file.hulls.extend(new);
        Ok(RecordFate::Written)
    }

    /// Deletes the oldest files until there is room for `bytes` more.
    fn make_room(&mut self, bytes: u64) -> io::Result<()> {
        while self.total() + bytes > self.max_bytes && !self.closed.is_empty() {
            match fs::remove_file(&self.closed[0].0) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
                _ => _ = self.closed.remove(0),
            }
        }
        Ok(())
    }

    /// Removes the part of a record that was written before the write failed, so that a full disk does not fill with
    /// such parts.
    fn take_back(&mut self) {
        let Some(file) = &self.current else { return };
        if file.bytes == 0 {
            let _ = fs::remove_file(&file.path);
            self.current = None;
        } else if file.file.set_len(file.bytes).is_err() {
            // The file ends within an entry now. The next record begins a file of its own.
            self.close();
        }
    }

    /// Ends the current file. The next record begins a new one.
    fn close(&mut self) {
        if let Some(file) = self.current.take() {
            self.closed.push((file.path, file.bytes));
        }
    }
}

impl OpenFile {
    fn create(directory: &std::path::Path) -> io::Result<Self> {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos();
        let path = directory.join(format!("{now:020}-{}.{EXTENSION}", std::process::id()));
        let file = OpenOptions::new().append(true).create_new(true).mode(0o600).open(&path)?;
        Ok(Self { path, file, bytes: 0, hulls: HashSet::new() })
    }
}

fn header() -> Header {
    Header {
        version: env!("CARGO_PKG_VERSION").into(),
        instruction_set: crate::contact::instruction_set().into(),
        contract: CONTRACT,
    }
}

/// The hulls that the messages of a request name, with repetitions. A message that is no message names none.
fn named(call: &Call) -> Vec<HullId> {
    if !SCENE_METHODS.contains(&call.method.as_str()) {
        return Vec::new();
    }
    let messages = call.messages().unwrap_or_default();
    let named = messages.into_iter().filter_map(|message| NamedHulls::decode(message).ok());
    named.flat_map(|named| named.hull_ids).filter_map(|id| Some(HullId((*id).try_into().ok()?))).collect()
}
