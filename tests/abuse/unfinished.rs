//! Messages that stop in the middle, and requests that stay open after their message.

use std::time::Duration;

use crate::{
    messages::unknown_field,
    raw,
    support::{
        QUERY, REGISTER, STREAM, WATCH,
        arena::Arena,
        http2::{Peer, Windows},
    },
};

attacks! {
    /// Catches messages that hold the whole budget because they never end.
    streams: "1 GiB of messages on streams that stop in the middle" => half_messages_on_streams;
    /// Catches unfinished messages to the health service, which needs no token.
    health: "messages to Health/Watch that stop in the middle, without a token",
        |s: Setup| s.tokens() => half_messages_to_health;
    /// Catches unfinished messages that are bounded only on TCP.
    over_unix: "1 GiB of messages that stop in the middle, over a Unix socket",
        |s: Setup| s.over_unix() => half_messages_on_streams;
    /// Catches decoded messages that are kept in memory until the request ends, although it never ends.
    open_requests: "whole messages of requests that do not end" => open_requests;
    /// Catches messages after the first one that are decoded for an unlimited time.
    further_messages: "a second and third message to methods that take one" => further_messages;
    /// Catches such messages to the health service, which needs no token.
    further_messages_to_health: "a second and third message to Health/Watch, without a token",
        |s: Setup| s.tokens() => further_messages_to_health;
    /// Catches callers that hold memory with a message that arrives at one byte per second.
    slowly: "messages that arrive at one byte per second" => one_byte_a_second;
}

async fn half_messages_on_streams(arena: &Arena) {
    half_messages(arena, STREAM).await;
}

async fn half_messages_to_health(arena: &Arena) {
    half_messages(arena, WATCH).await;
}

/// Sends sixteen of the largest messages without their last byte, and waits for the bystander.
async fn half_messages(arena: &Arena, path: &str) {
    let whole = raw::frame(false, &vec![0; arena.setup.message_bytes()]);
    arena.begin().await;
    let mut peers = Vec::new();
    for _ in 0..16 {
        if let Ok(mut peer) = arena.peer(Windows::OPEN).await {
            // The server may refuse the call, which ends the stream.
            let _ = send_part(&mut peer, path, &whole[..whole.len() - 1]).await;
            peers.push(peer);
        }
    }
    arena.bystander_answered(arena.size().of(400)).await;
}

async fn send_part(peer: &mut Peer, path: &str, part: &[u8]) -> std::io::Result<()> {
    let stream = peer.call(path, &[]).await?;
    // If the server neither takes the rest nor refuses it, it has stopped reading, which is defence enough.
    match tokio::time::timeout(Duration::from_secs(5), peer.body(stream, part, false)).await {
        Ok(sent) => sent,
        Err(_) => Ok(()),
    }
}

async fn open_requests(arena: &Arena) {
    let message = raw::frame(false, &unknown_field(arena.setup.message_bytes() / 2));
    arena.begin().await;
    let mut peers = Vec::new();
    for path in [QUERY, REGISTER].repeat(8) {
        if let Ok(mut peer) = arena.peer(Windows::OPEN).await {
            let _ = send_part(&mut peer, path, &message).await;
            peers.push(peer);
        }
    }
    arena.bystander_answered(arena.size().of(400)).await;
}

async fn further_messages(arena: &Arena) {
    send_further(arena, QUERY, arena.setup.message_bytes() / 4).await;
}

async fn further_messages_to_health(arena: &Arena) {
    send_further(arena, WATCH, 1000).await;
}

/// Sends message after message to methods that take one, until the bystander has been answered often
/// enough.
async fn send_further(arena: &Arena, path: &str, bytes: usize) {
    let message = raw::frame(false, &unknown_field(bytes));
    arena.begin().await;
    let flood = async {
        loop {
            let Ok(mut peer) = arena.peer(Windows::OPEN).await else { continue };
            let Ok(stream) = peer.call(path, &[]).await else { continue };
            while peer.body(stream, &message, false).await.is_ok() {}
        }
    };
    tokio::select! {
        () = arena.bystander_answered(arena.size().of(400)) => {}
        () = flood => {}
    }
}

async fn one_byte_a_second(arena: &Arena) {
    let message = raw::frame(false, &unknown_field(arena.setup.message_bytes() / 16));
    let (most, rest) = message.split_at(message.len() - 1000);
    arena.begin().await;
    let mut dribbles = Vec::new();
    for path in [QUERY, STREAM].repeat(8) {
        let Ok(mut peer) = arena.peer(Windows::OPEN).await else { continue };
        dribbles.push(async move {
            let stream = peer.call(path, &[]).await?;
            peer.body(stream, most, false).await?;
            for byte in rest {
                peer.body(stream, &[*byte], false).await?;
                tokio::time::sleep(Duration::from_secs(1)).await;
            }
            Ok::<_, std::io::Error>(())
        });
    }
    // Each call is ended by the server, because its message is late.
    let (ended, ()) = tokio::join!(
        futures_util::future::join_all(dribbles),
        arena.bystander_answered(arena.size().of(400))
    );
    assert!(ended.iter().all(Result::is_err), "the server waits for a message without a limit");
}
