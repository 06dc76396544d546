//! Answers that their callers do not read.

use std::{io, time::Duration};

use bytes::Bytes;
use futures_util::{StreamExt, future::join_all, stream};
use prost::Message;

use crate::{
    messages::{field, row, same_pair},
    raw,
    scenes::{box_points, plain, round_points},
    support::{
        FIND, QUERY, REFLECTION, STREAM,
        arena::Arena,
        http2::{Peer, Windows},
    },
};

attacks! {
    /// Catches answers that stay in memory for as long as their caller does not read them.
    queries: "150 answers of 50 MB that are never read" => unread_queries;
    /// Catches unread answers that are bounded only on TCP.
    over_unix: "150 answers of 50 MB that are never read, over a Unix socket",
        |s: Setup| s.over_unix() => unread_queries;
    /// Catches unread answers that are bounded only without TLS.
    over_tls: "150 answers of 50 MB that are never read, over TLS", |s: Setup| s.tls() => unread_queries;
    /// Catches answers that a caller reads at one byte per second.
    slowly: "answers that are read at one byte per second" => one_byte_a_second;
    /// Catches hulls that calls pin for as long as their answers are not read.
    pinned: "40 FindContacts that pin 40 hulls in a small cache and are never read",
        |s: Setup| s.cache(16 << 20) => pinned;
    /// Catches flow-control windows that no budget counts.
    windows: "600 connections that fill their windows and read nothing" => windows;
    /// Catches answers of the reflection service that no budget counts.
    reflection: "answers of the reflection service that are never read" => reflection;
}

/// The server may send so little that each answer stops after its first bytes.
const STUCK: Windows = Windows { stream: 1000, connection: i32::MAX as u32 };

/// The bytes of a query whose answer has about 350 bytes per pair.
async fn question(arena: &Arena, pairs: usize) -> Bytes {
    let ids = arena.register(&[plain(box_points(0.5, 0.5, 0.5))]).await;
    raw::frame(false, &same_pair(&ids, pairs, 0.9).encode_to_vec())
}

async fn unread_queries(arena: &Arena) {
    let question = question(arena, arena.size().of(131_072)).await;
    arena.begin().await;
    let calls = (0..10).map(async |_| {
        let mut peer = arena.peer(STUCK).await?;
        let mut calls = Vec::new();
        for _ in 0..15 {
            calls.push(peer.ask(QUERY, &question).await?);
        }
        for call in calls {
            peer.answered(call).await?;
        }
        Ok::<Peer, io::Error>(peer)
    });
    let held = join_all(calls).await;
    arena.bystander_answered(arena.size().of(400)).await;
    drop(held);
}

async fn one_byte_a_second(arena: &Arena) {
    let question = question(arena, 10_000).await;
    arena.begin().await;
    let calls = (0..8).map(async |_| {
        let mut peer = arena.peer(STUCK).await?;
        let call = peer.ask(QUERY, &question).await?;
        loop {
            tokio::select! {
                ended = peer.ended(call) => return ended,
                () = tokio::time::sleep(Duration::from_secs(1)) => peer.allow(call, 1).await?,
            }
        }
    });
    // The server ends each call, because the caller does not take its answer in time.
    tokio::join!(join_all(calls), arena.bystander_answered(arena.size().of(400)));
}

async fn pinned(arena: &Arena) {
    let vertices = arena.size().of(5000);
    let shapes: Vec<_> = (0..40).map(|seed| plain(round_points(vertices, seed))).collect();
    let ids = arena.register(&shapes).await;
    let bodies = arena.size().of(131_072);
    arena.begin().await;
    let calls = ids.iter().map(async |id| {
        let question = raw::frame(false, &row(id, bodies, 1.9).encode_to_vec());
        let mut peer = arena.peer(STUCK).await?;
        let call = peer.ask(FIND, &question).await?;
        peer.answered(call).await?;
        Ok::<Peer, io::Error>(peer)
    });
    let held = join_all(calls).await;
    arena.bystander_answered(arena.size().of(400)).await;
    drop(held);
}

async fn windows(arena: &Arena) {
    let question = question(arena, arena.size().of(131_072) / 10).await;
    arena.begin().await;
    let connections = (0..arena.size().of(600)).map(async |_| {
        let mut peer = arena.peer(STUCK).await?;
        let call = peer.call(STREAM, &[]).await?;
        // Send until the server takes no more.
        let fill = async { while peer.body(call, &question, false).await.is_ok() {} };
        let _ = tokio::time::timeout(Duration::from_millis(500), fill).await;
        Ok::<Peer, io::Error>(peer)
    });
    let held: Vec<_> = stream::iter(connections).buffer_unordered(32).collect().await;
    arena.bystander_answered(arena.size().of(400)).await;
    drop(held);
}

async fn reflection(arena: &Arena) {
    // A `file_containing_symbol` request of the reflection service.
    let question = raw::frame(false, &field(4, b"hullcast.v1.ContactService"));
    let questions = question.repeat(arena.size().of(1000));
    arena.begin().await;
    let connections = (0..arena.size().of(100)).map(async |_| {
        let mut peer = arena.peer(STUCK).await?;
        for _ in 0..8 {
            let call = peer.call(REFLECTION, &[]).await?;
            let fill = async { while peer.body(call, &questions, false).await.is_ok() {} };
            let _ = tokio::time::timeout(Duration::from_millis(100), fill).await;
        }
        Ok::<Peer, io::Error>(peer)
    });
    let held: Vec<_> = stream::iter(connections).buffer_unordered(32).collect().await;
    arena.bystander_answered(arena.size().of(400)).await;
    drop(held);
}
