//! Answers to requests that are refused before they count as calls, and files, that nobody reads.

use std::io;

use futures_util::{StreamExt, stream};

use crate::support::{
    arena::Arena,
    http2::{END_HEADERS, END_STREAM, HEADERS, Peer, Windows, frame, header_block, literal},
};

attacks! {
    /// Catches refusals whose text waits, outside the budget, for its caller to read it.
    streams: "1,000 connections with 1,000 refused requests each that are never read" => refused;
    /// Catches refused requests whose streams stay open because the request does not end.
    unended: "1,000 connections with 1,000 refused requests each that do not end" => unended;
    /// Catches files of the page that are copied for each request, or that nothing cuts.
    files: "1,000 connections with 1,000 files of the page each that are never read" => files;
}

const SHUT: Windows = Windows { stream: 0, connection: 65_535 };

/// The headers of a request that is not gRPC.
fn get(path: &str) -> Vec<u8> {
    let mut block = Vec::new();
    for (name, value) in
        [(":method", "GET"), (":scheme", "http"), (":authority", "localhost"), (":path", path)]
    {
        literal(&mut block, name, value);
    }
    block
}

async fn hold(arena: &Arena, block: &[u8], flags: u8) {
    arena.begin().await;
    let connections = (0..arena.size().of(1000)).map(async |_| {
        let mut peer = arena.peer(SHUT).await?;
        let all: Vec<u8> =
            (0..1000).flat_map(|_| frame(HEADERS, END_HEADERS | flags, peer.next_stream(), block)).collect();
        peer.send(&all).await?;
        Ok::<Peer, io::Error>(peer)
    });
    let held: Vec<_> = stream::iter(connections).buffer_unordered(32).collect().await;
    arena.bystander_answered(arena.size().of(400)).await;
    drop(held);
}

async fn refused(arena: &Arena) {
    hold(arena, &get("/x"), END_STREAM).await;
}

async fn unended(arena: &Arena) {
    let kind = header_block("/x", &[("content-type", "text/plain")]);
    hold(arena, &kind, 0).await;
}

async fn files(arena: &Arena) {
    hold(arena, &get("/playground.js"), END_STREAM).await;
}
