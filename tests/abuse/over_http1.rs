//! Attacks over HTTP/1.1 and gRPC-web, which a server with the playground accepts.

use std::{io, time::Duration};

use futures_util::{StreamExt, future::join_all, stream};
use prost::Message;
use tokio::io::{AsyncReadExt, AsyncWriteExt};

use crate::{
    messages::{repeated, row, same_pair},
    raw,
    scenes::{box_points, plain},
    support::{FIND, GET, QUERY, REGISTER, arena::Arena, dial::Stream},
};

attacks! {
    /// Catches memory that is reserved for a declared length, in the HTTP/1.1 header or in the message
    /// header.
    declared: "1,000 gRPC-web requests that declare the largest message" => declared;
    /// Catches unfinished messages that hold memory for an unlimited time.
    unfinished: "1 GiB of gRPC-web messages that stop in the middle" => unfinished;
    /// Catches a cost per piece that makes tiny HTTP chunks expensive.
    chunks: "gRPC-web messages in chunks of one byte" => chunks;
    /// Catches a block of headers that grows without a limit.
    headers: "headers of HTTP/1.1 that do not end" => headers;
    /// Catches answers that stay in memory because the caller does not read them.
    unread: "100 gRPC-web answers that are never read" => unread;
    /// Catches files of the page that nothing counts or ends, and heads of answers that pile up.
    files: "100 connections that ask for files again and again and read nothing" => files;
    /// Catches elements that are allocated before they are counted.
    elements: "64 MiB of empty elements over gRPC-web" => elements;
}

/// The request line and headers of a gRPC-web request.
fn head(path: &str, length: &str) -> Vec<u8> {
    format!(
        "POST {path} HTTP/1.1\r\nhost: 127.0.0.1\r\ncontent-type: application/grpc-web+proto\r\n{length}\r\n\r\n"
    )
    .into_bytes()
}

fn content_length(bytes: usize) -> String {
    format!("content-length: {bytes}")
}

/// Opens `connections` connections and sends one of `said` on each, until the server takes no more of it.
/// Holds the connections until the bystander has been answered often enough.
async fn hold(arena: &Arena, said: &[Vec<u8>], connections: usize) {
    arena.begin().await;
    let say = (0..connections).map(async |i: usize| {
        let mut stream = arena.stream().await?;
        let time = Duration::from_secs(5);
        let _ = tokio::time::timeout(time, stream.write_all(&said[i % said.len()])).await;
        Ok::<Box<dyn Stream>, io::Error>(stream)
    });
    let held: Vec<_> = stream::iter(say).buffer_unordered(16).collect().await;
    arena.bystander_answered(arena.size().of(400)).await;
    drop(held);
}

async fn declared(arena: &Arena) {
    let bytes = arena.setup.message_bytes();
    let mut declared = vec![0];
    declared.extend((bytes as u32).to_be_bytes());
    let whole = [head(QUERY, &content_length(bytes + 5)), declared.clone()].concat();
    let chunked =
        [head(QUERY, "transfer-encoding: chunked"), b"5\r\n".to_vec(), declared, b"\r\n".to_vec()].concat();
    hold(arena, &[whole, chunked], arena.size().of(1000)).await;
}

async fn unfinished(arena: &Arena) {
    let bytes = arena.setup.message_bytes();
    let message = raw::frame(false, &vec![0; bytes]);
    let part = [head(QUERY, &content_length(bytes + 5)), message[..bytes].to_vec()].concat();
    hold(arena, &[part], 16).await;
}

async fn chunks(arena: &Arena) {
    let message = raw::frame(false, &vec![0; 1 << 20]);
    let pieces: Vec<u8> = message.iter().flat_map(|byte| [b'1', b'\r', b'\n', *byte, b'\r', b'\n']).collect();
    hold(arena, &[[head(QUERY, "transfer-encoding: chunked"), pieces].concat()], arena.size().of(100)).await;
}

async fn headers(arena: &Arena) {
    let endless = [head(QUERY, "x: y"), vec![b'x'; 4 << 20]].concat();
    let endless = endless[..endless.len()].to_vec();
    let many = format!("POST {QUERY} HTTP/1.1\r\n{}", "x: y\r\n".repeat(100_000)).into_bytes();
    let long = [b"POST ".to_vec(), vec![b'/'; 4 << 20]].concat();
    hold(arena, &[endless, many, long, b"POST / HTTP/1.1\r\nhost".to_vec()], arena.size().of(400)).await;
}

async fn unread(arena: &Arena) {
    let ids = arena.register(&[plain(box_points(0.5, 0.5, 0.5))]).await;
    let pairs = arena.size().of(131_072);
    let query = raw::frame(false, &same_pair(&ids, pairs, 0.9).encode_to_vec());
    let find = raw::frame(false, &row(&ids[0], pairs, 0.9).encode_to_vec());
    let whole = |path: &str, body: &[u8]| [head(path, &content_length(body.len())), body.to_vec()].concat();
    hold(arena, &[whole(QUERY, &query), whole(FIND, &find)], arena.size().of(100)).await;
}

async fn elements(arena: &Arena) {
    let body = raw::frame(false, &repeated(&[0x0a, 0], arena.setup.message_bytes()));
    arena.begin().await;
    let senders = join_all([REGISTER, GET].map(async |path| {
        let whole = [head(path, &content_length(body.len())), body.to_vec()].concat();
        loop {
            let Ok(mut stream) = arena.stream().await else { continue };
            if stream.write_all(&whole).await.is_ok() {
                let _ = stream.read(&mut [0; 100]).await;
            }
        }
    }));
    tokio::select! {
        () = arena.bystander_answered(arena.size().of(200)) => {}
        _ = senders => {}
    }
}

async fn files(arena: &Arena) {
    let asks =
        |line: &str| format!("{line} HTTP/1.1\r\nhost: 127.0.0.1\r\n\r\n").repeat(200_000).into_bytes();
    hold(arena, &[asks("GET /playground.js"), asks("HEAD /")], arena.size().of(100)).await;
}
