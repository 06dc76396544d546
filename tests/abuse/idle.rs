//! Streams that were answered and stay open, and frames that hold more than one message.

use std::{io, time::Duration};

use futures_util::future::join_all;
use prost::Message;

use crate::{
    messages::{same_pair, unknown_field},
    raw,
    scenes::{box_points, plain},
    support::{
        STREAM,
        arena::Arena,
        http2::{Peer, Windows},
    },
};

attacks! {
    /// Catches buffers of received messages that live as long as their stream.
    requests: "streams that stay open after one large message", |s: Setup| s.cache(SMALL_CACHE)
        => large_requests;
    /// Catches buffers of sent answers that live as long as their stream.
    answers: "streams that stay open after one large answer", |s: Setup| s.cache(SMALL_CACHE)
        => large_answers;
    /// Catches a message whose memory is given back when the message before it is decoded.
    second_message: "streams that stop in the middle of a second message", |s: Setup| s.cache(SMALL_CACHE)
        => second_message;
    /// Catches messages that take more memory than the bytes that they came with.
    tiny_messages: "1 MiB of empty messages on each of 100 streams, answers not read" => tiny_messages;
}

/// With a small cache the server may use less memory, so that fewer streams suffice.
const SMALL_CACHE: u64 = 16 << 20;

/// Streams of one connection.
const STREAMS: usize = 50;

/// The number of parts of this size that are a quarter more than the memory which the server may use.
fn too_many(arena: &Arena, bytes: usize) -> usize {
    let all = arena.setup.memory_bytes() + arena.setup.cache_bytes() + (256 << 20);
    all as usize / bytes * 5 / 4
}

/// Opens `count` streams one after the other and begins each with `begin`. A stream that is refused is a
/// defence. Returns the connections, which stay open.
async fn streams(
    arena: &Arena,
    count: usize,
    begin: impl AsyncFn(&mut Peer, u32) -> io::Result<()>,
) -> Vec<Peer> {
    let mut peers = Vec::new();
    for _ in 0..count.div_ceil(STREAMS) {
        let Ok(mut peer) = arena.peer(Windows::OPEN).await else { continue };
        for _ in 0..STREAMS {
            let Ok(stream) = peer.call(STREAM, &[]).await else { break };
            let _ = tokio::time::timeout(Duration::from_secs(5), begin(&mut peer, stream)).await;
        }
        peers.push(peer);
    }
    peers
}

async fn large_requests(arena: &Arena) {
    let bytes = arena.setup.message_bytes() * 3 / 4;
    let message = raw::frame(false, &unknown_field(bytes));
    arena.begin().await;
    let peers = streams(arena, too_many(arena, bytes), async |peer, stream| {
        peer.body(stream, &message, false).await?;
        peer.answered(stream).await
    })
    .await;
    arena.bystander_answered(arena.size().of(400)).await;
    drop(peers);
}

async fn large_answers(arena: &Arena) {
    let ids = arena.register(&[plain(box_points(0.5, 0.5, 0.5))]).await;
    let question = same_pair(&ids, arena.size().of(131_072), 0.9);
    // Each pair is answered with four points: more than 300 bytes.
    let bytes = 300 * question.pairs.len() / 2;
    let message = raw::frame(false, &question.encode_to_vec());
    arena.begin().await;
    let peers = streams(arena, too_many(arena, bytes), async |peer, stream| {
        peer.body(stream, &message, false).await?;
        peer.received_at_least(stream, bytes).await
    })
    .await;
    arena.bystander_answered(arena.size().of(400)).await;
    drop(peers);
}

async fn second_message(arena: &Arena) {
    let whole = raw::frame(false, &vec![0; arena.setup.message_bytes()]);
    let part = &whole[..arena.setup.message_bytes() / 16];
    // The first message is empty: a head and nothing else.
    let both = [&[0; 5], part].concat();
    arena.begin().await;
    let peers = streams(arena, too_many(arena, part.len()), async |peer, stream| {
        peer.body(stream, &both, false).await
    })
    .await;
    arena.bystander_answered(arena.size().of(400)).await;
    drop(peers);
}

async fn tiny_messages(arena: &Arena) {
    let messages = vec![0; 1 << 20];
    arena.begin().await;
    let mut peers = Vec::new();
    for _ in 0..10 {
        let Ok(mut peer) = arena.peer(Windows { stream: 0, connection: 0 }).await else { continue };
        let mut opened = Vec::new();
        for _ in 0..10 {
            opened.extend(peer.call(STREAM, &[]).await.ok());
        }
        peers.push((peer, opened));
    }
    let sent = peers.iter().flat_map(|(peer, opened)| opened.iter().map(move |&stream| (peer, stream)));
    let sent = sent.map(|(peer, stream)| {
        // A server that does not take the rest defends itself.
        let patience = Duration::from_millis(arena.size().of(5_000) as u64);
        tokio::time::timeout(patience, peer.body(stream, &messages, false))
    });
    let sent = join_all(sent).await;
    assert_eq!(sent.len(), 100);
    arena.bystander_answered(arena.size().of(400)).await;
}
