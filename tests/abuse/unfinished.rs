//! Messages that stop in the middle, and requests that do not end after their message.

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
    /// Catches the same on the health service, without a token.
    health: "the same on Health/Watch without a token", |s: Setup| s.tokens() => half_messages_to_health;
    /// Catches the same over a Unix socket.
    over_unix: "the same over a Unix socket", |s: Setup| s.over_unix() => half_messages_on_streams;
    /// Catches decoded messages that are held until a request ends that never does.
    open_requests: "whole messages of requests that do not end" => open_requests;
    /// Catches messages after the first that are decoded for as long as the caller likes.
    further_messages: "a second and third message to methods that take one" => further_messages;
    /// Catches the same on the health service, without a token.
    further_messages_to_health: "the same to Health/Watch without a token", |s: Setup| s.tokens()
        => further_messages_to_health;
    /// Catches callers who hold memory with a message that arrives at one byte a second.
    slowly: "messages that arrive at one byte a second" => one_byte_a_second;
}

async fn half_messages_on_streams(arena: &Arena) {
    half_messages(arena, STREAM).await;
}

async fn half_messages_to_health(arena: &Arena) {
    half_messages(arena, WATCH).await;
}

/// Sends all but the end of sixteen of the largest messages, and waits for the bystander.
async fn half_messages(arena: &Arena, path: &str) {
    let whole = raw::frame(false, &vec![0; arena.setup.message_bytes()]);
    arena.begin().await;
    let mut peers = Vec::new();
    for _ in 0..16 {
        if let Ok(mut peer) = arena.peer(Windows::OPEN).await {
            // The server may refuse, which ends the stream.
            let _ = send_part(&mut peer, path, &whole[..whole.len() - 1]).await;
            peers.push(peer);
        }
    }
    arena.bystander_answered(arena.size().of(400)).await;
}

async fn send_part(peer: &mut Peer, path: &str, part: &[u8]) -> std::io::Result<()> {
    let stream = peer.call(path, &[]).await?;
    // A server that neither takes the rest nor refuses it has stopped reading, which is enough.
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

/// Sends message after message to methods that take one, until the bystander was answered
/// often enough.
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
    assert!(ended.iter().all(Result::is_err), "a message may take for ever");
}
