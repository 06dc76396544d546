//! A minimal HTTP/2 client for tests that break the protocol's rules or never read.

use std::{
    collections::HashMap,
    io,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use tokio::{
    io::{AsyncReadExt, AsyncWriteExt, ReadHalf, WriteHalf},
    sync::{Mutex as AsyncMutex, Notify},
    task::JoinHandle,
};

use super::dial::Stream;

pub(crate) const DATA: u8 = 0;
pub(crate) const HEADERS: u8 = 1;
pub(crate) const RST_STREAM: u8 = 3;
pub(crate) const SETTINGS: u8 = 4;
pub(crate) const PING: u8 = 6;
const GOAWAY: u8 = 7;
pub(crate) const WINDOW_UPDATE: u8 = 8;
pub(crate) const CONTINUATION: u8 = 9;

pub(crate) const END_STREAM: u8 = 1;
pub(crate) const ACK: u8 = 1;
pub(crate) const END_HEADERS: u8 = 4;

const INITIAL_WINDOW_SIZE: u16 = 4;

/// The payload of the frames that carry a request's bytes; every peer accepts this size.
const FRAME_BYTES: usize = 16_384;

/// The initial flow-control window of a connection (RFC 9113, section 6.9.2).
const FIRST_WINDOW: u32 = 65_535;

/// The number of bytes that the server may send on each stream and on the connection. The peer enlarges the
/// windows only when a test tells it to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Windows {
    pub(crate) stream: u32,
    pub(crate) connection: u32,
}

impl Windows {
    /// The peer reads everything, up to 2 GiB.
    pub(crate) const OPEN: Self = Self { stream: i32::MAX as u32, connection: i32::MAX as u32 };
}

/// One end of a connection. Headers that arrive are not decoded.
pub(crate) struct Peer {
    writer: Arc<AsyncMutex<WriteHalf<Box<dyn Stream>>>>,
    seen: Arc<Seen>,
    reader: JoinHandle<()>,
    next: u32,
}

#[derive(Default)]
struct Seen {
    state: Mutex<State>,
    changed: Notify,
}

/// The state of the connection as learned from the server's frames.
#[derive(Default)]
struct State {
    /// Bytes that the peer may still send on the connection; `stream_windows` has this number for each stream.
    window: i64,
    stream_windows: HashMap<u32, i64>,
    initial_window: i64,
    has_settings: bool,
    received: HashMap<u32, usize>,
    ended: HashMap<u32, bool>,
    closed: bool,
}

impl Peer {
    /// Sends the preface and settings, and waits for the server's settings.
    pub(crate) async fn open(stream: Box<dyn Stream>, windows: Windows) -> io::Result<Self> {
        let (reading, writing) = tokio::io::split(stream);
        let writer = Arc::new(AsyncMutex::new(writing));
        let seen = Arc::<Seen>::default();
        {
            let mut state = seen.lock();
            (state.window, state.initial_window) = (FIRST_WINDOW.into(), FIRST_WINDOW.into());
        }
        let reader = tokio::spawn(read(reading, writer.clone(), seen.clone()));
        let peer = Self { writer, seen, reader, next: 1 };
        let mut settings = INITIAL_WINDOW_SIZE.to_be_bytes().to_vec();
        settings.extend(windows.stream.to_be_bytes());
        let mut hello = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n".to_vec();
        hello.extend(frame(SETTINGS, 0, 0, &settings));
        if windows.connection > FIRST_WINDOW {
            hello.extend(frame(WINDOW_UPDATE, 0, 0, &(windows.connection - FIRST_WINDOW).to_be_bytes()));
        }
        peer.send(&hello).await?;
        peer.until(|state| state.has_settings).await?;
        Ok(peer)
    }

    /// Sends raw bytes.
    pub(crate) async fn send(&self, bytes: &[u8]) -> io::Result<()> {
        self.writer.lock().await.write_all(bytes).await
    }

    /// Takes the number of the next stream.
    pub(crate) fn next_stream(&mut self) -> u32 {
        let stream = self.next;
        self.next += 2;
        stream
    }

    /// Begins a call of `path`: sends its headers only.
    pub(crate) async fn call(&mut self, path: &str, headers: &[(&str, &str)]) -> io::Result<u32> {
        let stream = self.next_stream();
        self.send(&frame(HEADERS, END_HEADERS, stream, &header_block(path, headers))).await?;
        Ok(stream)
    }

    /// Sends bytes of a request's body as fast as the server's windows allow.
    pub(crate) async fn body(&self, stream: u32, mut bytes: &[u8], is_last: bool) -> io::Result<()> {
        loop {
            let length = match bytes.is_empty() {
                true => 0,
                false => self.room(stream, bytes.len().min(FRAME_BYTES)).await?,
            };
            let (now, later) = bytes.split_at(length);
            let ends = is_last && later.is_empty();
            self.send(&frame(DATA, if ends { END_STREAM } else { 0 }, stream, now)).await?;
            bytes = later;
            if bytes.is_empty() {
                return Ok(());
            }
        }
    }

    /// Sends a whole call without waiting for the answer.
    pub(crate) async fn ask(&mut self, path: &str, body: &[u8]) -> io::Result<u32> {
        let stream = self.call(path, &[]).await?;
        self.body(stream, body, true).await?;
        Ok(stream)
    }

    /// Cancels a call with RST_STREAM.
    pub(crate) async fn reset(&self, stream: u32) -> io::Result<()> {
        const CANCEL: [u8; 4] = 8u32.to_be_bytes();
        self.send(&frame(RST_STREAM, 0, stream, &CANCEL)).await
    }

    /// Allows the server to send more on a stream and on the connection.
    pub(crate) async fn allow(&self, stream: u32, bytes: u32) -> io::Result<()> {
        let mut both = frame(WINDOW_UPDATE, 0, stream, &bytes.to_be_bytes());
        both.extend(frame(WINDOW_UPDATE, 0, 0, &bytes.to_be_bytes()));
        self.send(&both).await
    }

    /// Waits until the server has ended a stream, with success or with an error.
    pub(crate) async fn ended(&self, stream: u32) -> io::Result<()> {
        self.until(|state| state.ended.contains_key(&stream)).await
    }

    /// The number of answer bytes received on a stream.
    pub(crate) fn received(&self, stream: u32) -> usize {
        self.seen.lock().received.get(&stream).copied().unwrap_or(0)
    }

    /// Waits until the server has sent something on a stream, or has ended it.
    pub(crate) async fn answered(&self, stream: u32) -> io::Result<()> {
        self.until(|state| state.received.contains_key(&stream) || state.ended.contains_key(&stream)).await
    }

    /// Waits until `bytes` bytes were received on a stream, or the server has ended it.
    pub(crate) async fn received_at_least(&self, stream: u32, bytes: usize) -> io::Result<()> {
        let has_them = |state: &State| state.received.get(&stream).is_some_and(|have| *have >= bytes);
        self.until(|state| has_them(state) || state.ended.contains_key(&stream)).await
    }

    /// Takes at most `most` bytes of the windows once there is room.
    async fn room(&self, stream: u32, most: usize) -> io::Result<usize> {
        let mut room = 0;
        self.until(|state| {
            if state.ended.contains_key(&stream) {
                return true;
            }
            let initial = state.initial_window;
            let own = state.stream_windows.entry(stream).or_insert(initial);
            room = most.min(usize::try_from(state.window.min(*own)).unwrap_or(0));
            *own -= room as i64;
            state.window -= room as i64;
            room > 0
        })
        .await?;
        if room == 0 { Err(gone()) } else { Ok(room) }
    }

    async fn until(&self, mut is_met: impl FnMut(&mut State) -> bool) -> io::Result<()> {
        loop {
            let changed = self.seen.changed.notified();
            {
                let mut state = self.seen.lock();
                if is_met(&mut state) {
                    return Ok(());
                }
                if state.closed {
                    return Err(gone());
                }
            }
            changed.await;
        }
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        self.reader.abort();
    }
}

impl Seen {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn gone() -> io::Error {
    io::Error::new(io::ErrorKind::ConnectionReset, "the server ended the stream or the connection")
}

async fn read(
    mut reading: ReadHalf<Box<dyn Stream>>,
    writer: Arc<AsyncMutex<WriteHalf<Box<dyn Stream>>>>,
    seen: Arc<Seen>,
) {
    while let Ok((kind, flags, stream, payload)) = read_frame(&mut reading).await {
        // The server's settings apply once they are acknowledged. A PING may stay unanswered: if a flood
        // fills the connection, writing the answer would block this reader.
        let sent = match kind {
            SETTINGS if flags & ACK == 0 => {
                writer.lock().await.write_all(&frame(SETTINGS, ACK, 0, &[])).await
            }
            PING if flags & ACK == 0 => match writer.try_lock() {
                Ok(mut writer) => writer.write_all(&frame(PING, ACK, 0, &payload)).await,
                Err(_) => Ok(()),
            },
            _ => Ok(()),
        };
        seen.lock().take(kind, flags, stream, &payload);
        seen.changed.notify_waiters();
        if sent.is_err() {
            break;
        }
    }
    seen.lock().closed = true;
    seen.changed.notify_waiters();
}

async fn read_frame(reading: &mut ReadHalf<Box<dyn Stream>>) -> io::Result<(u8, u8, u32, Vec<u8>)> {
    let mut head = [0; 9];
    reading.read_exact(&mut head).await?;
    let mut payload = vec![0; u32::from_be_bytes([0, head[0], head[1], head[2]]) as usize];
    reading.read_exact(&mut payload).await?;
    let stream = u32::from_be_bytes([head[5], head[6], head[7], head[8]]) & 0x7fff_ffff;
    Ok((head[3], head[4], stream, payload))
}

impl State {
    fn take(&mut self, kind: u8, flags: u8, stream: u32, payload: &[u8]) {
        match kind {
            DATA => *self.received.entry(stream).or_default() += payload.len(),
            RST_STREAM => {
                self.ended.insert(stream, true);
            }
            GOAWAY => self.closed = true,
            WINDOW_UPDATE => {
                let more = payload.first_chunk().map_or(0, |bytes| i64::from(u32::from_be_bytes(*bytes)));
                if stream == 0 {
                    self.window += more;
                } else {
                    let initial = self.initial_window;
                    *self.stream_windows.entry(stream).or_insert(initial) += more;
                }
            }
            SETTINGS if flags & ACK == 0 => {
                self.has_settings = true;
                for setting in payload.chunks_exact(6) {
                    if setting[..2] == INITIAL_WINDOW_SIZE.to_be_bytes() {
                        let [.., a, b, c, d] = *setting else { continue };
                        self.initial_window = u32::from_be_bytes([a, b, c, d]).into();
                    }
                }
            }
            _ => {}
        }
        if matches!(kind, DATA | HEADERS) && flags & END_STREAM != 0 {
            self.ended.insert(stream, false);
        }
    }
}

/// A frame of HTTP/2.
pub(crate) fn frame(kind: u8, flags: u8, stream: u32, payload: &[u8]) -> Vec<u8> {
    let mut frame = (payload.len() as u32).to_be_bytes()[1..].to_vec();
    frame.extend([kind, flags]);
    frame.extend(stream.to_be_bytes());
    frame.extend_from_slice(payload);
    frame
}

/// The headers of a gRPC call. Each is an HPACK literal that is not stored in the table.
pub(crate) fn header_block(path: &str, headers: &[(&str, &str)]) -> Vec<u8> {
    let always = [
        (":method", "POST"),
        (":scheme", "http"),
        (":authority", "localhost"),
        (":path", path),
        ("content-type", "application/grpc"),
        ("te", "trailers"),
    ];
    let mut block = Vec::new();
    for (name, value) in always.iter().chain(headers) {
        literal(&mut block, name, value);
    }
    block
}

/// Appends a header as an HPACK literal that is not stored in the table.
pub(crate) fn literal(block: &mut Vec<u8>, name: &str, value: &str) {
    block.push(0);
    for text in [name, value] {
        length(block, text.len());
        block.extend_from_slice(text.as_bytes());
    }
}

/// Appends an HPACK integer with a prefix of 7 bits (RFC 7541, section 5.1).
fn length(block: &mut Vec<u8>, mut length: usize) {
    if length < 127 {
        return block.push(length as u8);
    }
    block.push(127);
    length -= 127;
    while length >= 128 {
        block.push((length % 128) as u8 | 128);
        length /= 128;
    }
    block.push(length as u8);
}
