//! A server that is told to stop while it is attacked.

use std::time::Duration;

use prost::Message;

use crate::{
    messages::same_pair,
    raw,
    scenes::{box_points, plain},
    support::{
        QUERY, STREAM,
        arena::Arena,
        http2::{Peer, Windows},
        server::Server,
        setup::{Setup, Size},
    },
};

/// Catches a server that its callers can keep from stopping, with calls that compute, answers that nobody
/// reads, messages that do not end, and connections that send nothing.
#[test]
fn an_attacked_server_stops_in_time() {
    let _alone = crate::support::trial::alone();
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    runtime.expect("a runtime").block_on(async {
        let setup = Setup::new(Size::Tenth).with("--grace-seconds=0").with("--drain-seconds=1");
        let arena = Arena::new(setup).await;
        let ids = arena.register(&[plain(box_points(0.5, 0.5, 0.5))]).await;
        let question = raw::frame(false, &same_pair(&ids, 13_000, 0.9).encode_to_vec());
        let mut held = Vec::new();
        for _ in 0..10 {
            let mut peer =
                arena.peer(Windows { stream: 1000, connection: 1 << 20 }).await.expect("a connection");
            // The server may defend itself by closing a connection whose answers are not read.
            let _ = hold(&mut peer, &question).await;
            held.push(peer);
        }
        let mut server: Server = arena.server;
        server.terminate();
        // The drain takes 1 s and the calls would take much longer than 20 s, so this limit tells the two
        // apart.
        let status = tokio::time::timeout(Duration::from_secs(20), server.ended()).await;
        let status = status.expect("the server stops although it is attacked");
        assert!(status.success(), "{status}");
        assert!(!server.log().contains("panicked"), "{}", server.log());
    });
}

/// Starts a call that computes and whose answer is not read, a stream that is not read, and a message that
/// does not end.
async fn hold(peer: &mut Peer, question: &[u8]) -> std::io::Result<()> {
    peer.ask(QUERY, question).await?;
    let stream = peer.call(STREAM, &[]).await?;
    peer.body(stream, question, false).await?;
    let stream = peer.call(STREAM, &[]).await?;
    peer.body(stream, &question[..question.len() / 2], false).await
}
