//! A slow network in one process: a TCP proxy that delays bytes and limits their rate, in both
//! directions.

use std::io;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep_until};

/// Starts a proxy to `server` and returns the address to connect to.
pub async fn proxy(server: String, one_way: Duration, bytes_per_second: f64) -> io::Result<String> {
    let listener = TcpListener::bind("127.0.0.1:0").await?;
    let address = listener.local_addr()?.to_string();
    tokio::spawn(async move {
        while let Ok((client, _)) = listener.accept().await {
            let Ok(server) = TcpStream::connect(&server).await else { continue };
            let (client_in, client_out) = client.into_split();
            let (server_in, server_out) = server.into_split();
            tokio::spawn(pass(client_in, server_out, one_way, bytes_per_second));
            tokio::spawn(pass(server_in, client_out, one_way, bytes_per_second));
        }
    });
    Ok(address)
}

/// The largest number of pieces in transit: enough for 1 Gbit/s and 100 ms.
const PIECES: usize = 256;
const PIECE_BYTES: usize = 64 << 10;

async fn pass(
    mut from: impl AsyncReadExt + Unpin,
    mut to: impl AsyncWriteExt + Unpin,
    delay: Duration,
    bytes_per_second: f64,
) {
    let (send, mut receive) = mpsc::channel::<(Instant, Vec<u8>)>(PIECES);
    let reading = async move {
        let mut free = Instant::now();
        loop {
            let mut piece = Vec::with_capacity(PIECE_BYTES);
            if !matches!(from.read_buf(&mut piece).await, Ok(1..)) {
                return;
            }
            // The line transmits one piece after another.
            free = free.max(Instant::now()) + Duration::from_secs_f64(piece.len() as f64 / bytes_per_second);
            if send.send((free + delay, piece)).await.is_err() {
                return;
            }
        }
    };
    let writing = async move {
        while let Some((at, piece)) = receive.recv().await {
            sleep_until(at).await;
            if to.write_all(&piece).await.is_err() {
                return;
            }
        }
    };
    tokio::join!(reading, writing);
}
