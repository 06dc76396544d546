//! Unlimited numbers of connections and of long-lived calls.

use std::{io, time::Duration};

use futures_util::{StreamExt, future::join_all, stream};
use tokio::io::AsyncWriteExt;
use tonic_health::pb::{HealthCheckRequest, health_client::HealthClient};

use crate::{
    raw,
    support::{
        WATCH,
        arena::{ATTACKER, Arena},
        dial,
        http2::{Peer, Windows},
        server::REGISTER_TOKEN,
    },
};

attacks! {
    /// Catches one address that can take all connections, so that a health checker cannot connect.
    idle: "all the connections that one address can open" => idle;
    /// Catches long-lived calls that no budget counts.
    watches: "1,024 Watch streams on many connections" => watches;
    /// Catches unfinished handshakes that keep other clients from finishing theirs.
    handshakes: "endless TLS handshakes: complete, broken off and left half done",
        |s: Setup| s.tls() => handshakes;
    /// Catches a server that fails, or fills its log, when it has no file descriptors left.
    descriptors: "100 idle connections to a server that may open 256 files",
        |s: Setup| Setup { ulimit: Some("-n 256".into()), ..s } => descriptors;
    /// Catches refused tokens that cost too much to refuse, and a log line for each refused token.
    tokens: "endless calls with wrong tokens", |s: Setup| s.tokens() => tokens;
    /// Catches a path that reaches a method although it is not the method's exact path, so that the check
    /// of the token is passed by.
    paths: "paths that resemble a method's path, without a token", |s: Setup| s.tokens() => paths;
}

/// An address that has no open connection.
const NEWCOMER: &str = "127.0.0.5";

async fn idle(arena: &Arena) {
    // The attacker needs as many file descriptors as the server.
    let limit = rustix::process::getrlimit(rustix::process::Resource::Nofile).maximum;
    let room = limit.map_or(usize::MAX, |limit| limit as usize).saturating_sub(200);
    let count = arena.size().of(11_000).min(room);
    raise_limit();
    arena.begin().await;
    let connections = (0..count).map(async |_| {
        let peer = tokio::time::timeout(Duration::from_secs(5), arena.peer(Windows::OPEN)).await;
        peer.ok()?.ok()
    });
    let held: Vec<_> = stream::iter(connections).buffer_unordered(64).collect().await;
    let channel = dial::channel(NEWCOMER, arena.server.address, None).await;
    let request = HealthCheckRequest { service: String::new() };
    HealthClient::new(channel).check(request).await.expect("health is answered on a new connection");
    arena.bystander_answered(arena.size().of(400)).await;
    drop(held);
}

/// Lets this process open as many files as the system allows.
fn raise_limit() {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    let maximum = getrlimit(Resource::Nofile).maximum;
    let _ = setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum });
}

async fn watches(arena: &Arena) {
    let question = raw::frame(false, &[]);
    arena.begin().await;
    let connections = (0..arena.size().of(128)).map(async |_| {
        let mut peer = arena.peer(Windows { stream: 0, connection: 1 << 20 }).await?;
        for _ in 0..8 {
            peer.ask(WATCH, &question).await?;
        }
        Ok::<Peer, io::Error>(peer)
    });
    let held = join_all(connections).await;
    arena.bystander_answered(arena.size().of(400)).await;
    drop(held);
}

async fn handshakes(arena: &Arena) {
    // The header of a TLS record and the beginning of a ClientHello.
    let half = [22, 3, 1, 2, 0, 1, 0, 1, 252, 3, 3];
    arena.begin().await;
    let mut held = Vec::new();
    for _ in 0..arena.size().of(1000) {
        let Ok(mut stream) = dial::tcp(ATTACKER, arena.server.address).await else { continue };
        let _ = stream.write_all(&half).await;
        held.push(stream);
    }
    let attackers = (0..16).map(async |i| {
        loop {
            let handshake = arena.stream();
            if i % 2 == 0 {
                let _ = handshake.await;
            } else {
                let _ = tokio::time::timeout(Duration::from_micros(500), handshake).await;
            }
        }
    });
    tokio::select! {
        () = arena.bystander_answered(arena.size().of(400)) => {}
        _ = join_all::<_>(attackers) => {}
    }
    drop(held);
}

async fn descriptors(arena: &Arena) {
    arena.begin().await;
    let mut held = Vec::new();
    for _ in 0..100 {
        if let Ok(stream) = dial::tcp(ATTACKER, arena.server.address).await {
            held.push(stream);
        }
    }
    arena.bystander_answered(arena.size().of(800)).await;
    // A registration opens files too, so the store must also have kept some descriptors.
    arena.bystander.register_a_new_hull().await;
    drop(held);
    assert!(arena.server.log().lines().count() < 40, "{}", arena.server.log());
}

async fn tokens(arena: &Arena) {
    let question = raw::frame(false, &[]);
    let wrong = format!("Bearer {}", "x".repeat(REGISTER_TOKEN.len()));
    arena.begin().await;
    flood(arena, crate::support::QUERY, &[("authorization", &wrong)], &question).await;
    assert!(arena.server.log().lines().count() < 100, "each refused token wrote a log line");
}

async fn paths(arena: &Arena) {
    let question = raw::frame(false, &[]);
    arena.begin().await;
    for path in [
        "/hullcast.v1.ContactService//QueryContacts",
        "/hullcast.v1.ContactService/QueryContacts/",
        "/grpc.health.v1.Health/../hullcast.v1.ContactService/QueryContacts",
        "/grpc.health.v1.Health/Check/../../hullcast.v1.HullService/DeleteHulls",
        "/HULLCAST.V1.ContactService/QueryContacts",
        "/hullcast.v1.HullService/DeleteHulls?/grpc.health.v1.Health/Check",
        "/hullcast.v1.HullService%2fDeleteHulls",
        "/",
    ] {
        flood(arena, path, &[], &question).await;
    }
}

/// Makes the call again and again until the bystander has been answered often enough. Asserts that no call
/// receives an answer message.
async fn flood(arena: &Arena, path: &str, headers: &[(&str, &str)], question: &[u8]) {
    let attackers = (0..4).map(async |_| {
        loop {
            let Ok(mut peer) = arena.peer(Windows::OPEN).await else { continue };
            while let Ok(call) = peer.call(path, headers).await {
                // The server may refuse the call as soon as it has the headers.
                let _ = peer.body(call, question, true).await;
                if peer.ended(call).await.is_err() {
                    break;
                }
                assert_eq!(peer.received(call), 0, "{path} is answered");
            }
        }
    });
    tokio::select! {
        () = arena.bystander_answered(arena.size().of(100)) => {}
        _ = join_all::<_>(attackers) => {}
    }
}
