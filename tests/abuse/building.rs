//! Registrations that cost more than their size suggests, and callers that leave before the end.

use std::time::Duration;

use futures_util::future::join_all;
use hullcast::{contact::Simplification, proto::RegisterHullsRequest, store::HullDefinition};
use prost::Message;

use crate::{
    messages::{globe, lattice, same_pair},
    raw,
    scenes::{box_points, plain, register_request, round_points, wire_hull},
    support::{QUERY, REGISTER, arena::Arena, http2::Windows},
};

attacks! {
    /// Catches work that continues after its caller has left, and waiting calls whose memory no budget
    /// counts.
    simplification: "simplifying 4 hulls of 8,192 points; 40 cancelled registrations of 59 MiB behind it"
        => simplification;
    /// Catches a hull that is built without a limit on the number of its points.
    points: "2.8 million points in one definition" => points;
    /// Catches hulls on which every decision needs exact arithmetic.
    degenerate: "hulls that force exact arithmetic everywhere" => degenerate;
    /// Catches batches that are computed after their callers have left, and cancelled calls that keep
    /// memory.
    cancelled: "maximal batches that are cancelled at once, again and again" => cancelled;
}

fn simplified(points: usize) -> HullDefinition {
    HullDefinition {
        simplification: Some(Simplification { max_vertices: Some(8), max_deviation: None }),
        ..plain(round_points(points, 3))
    }
}

fn message(hulls: &[HullDefinition]) -> Vec<u8> {
    raw::frame(false, &register_request(hulls).encode_to_vec()).to_vec()
}

async fn simplification(arena: &Arena) {
    let costly = message(&vec![simplified(arena.size().of(8192)); 4]);
    let points = arena.size().of(200_000);
    let hull = wire_hull(&plain(round_points(points, 4)));
    let count = arena.setup.message_bytes() * 9 / 10 / (24 * points);
    let behind = raw::frame(false, &RegisterHullsRequest { hulls: vec![hull; count] }.encode_to_vec());
    arena.begin().await;
    let mut peers = Vec::new();
    for _ in 0..2 {
        let mut peer = arena.peer(Windows::OPEN).await.expect("a connection");
        let call = peer.ask(REGISTER, &costly).await.expect("a call");
        peers.push((peer, call));
    }
    tokio::time::sleep(Duration::from_secs(1)).await;
    for (peer, call) in &peers {
        let _ = peer.reset(*call).await;
    }
    for _ in 0..40 {
        // The server may defend itself by refusing the call.
        let Ok(mut peer) = arena.peer(Windows::OPEN).await else { continue };
        if let Ok(call) = peer.ask(REGISTER, &behind).await {
            let _ = peer.reset(call).await;
            peers.push((peer, call));
        }
    }
    arena.bystander_answered(arena.size().of(400)).await;
}

/// Sends each message again and again on connections of its own, until the bystander has been answered
/// often enough.
async fn flood(arena: &Arena, messages: &[Vec<u8>]) {
    let callers = messages.iter().map(async |message| {
        loop {
            let Ok(mut peer) = arena.peer(Windows::OPEN).await else { continue };
            while let Ok(call) = peer.ask(REGISTER, message).await
                && peer.ended(call).await.is_ok()
            {}
        }
    });
    tokio::select! {
        () = arena.bystander_answered(arena.size().of(400)) => {}
        _ = join_all(callers) => {}
    }
}

async fn points(arena: &Arena) {
    let points = arena.setup.message_bytes() / 24 - 16;
    let message = message(&[plain(round_points(points, 6))]);
    arena.begin().await;
    flood(arena, &[message.clone(), message]).await;
}

async fn degenerate(arena: &Arena) {
    let side = match arena.size() {
        crate::support::setup::Size::Full => 128,
        crate::support::setup::Size::Tenth => 40,
    };
    // A different contraction point makes each message a new hull, so that the cache cannot help.
    let messages: Vec<_> = (0..8)
        .map(|i| {
            let shape = if i % 2 == 0 { globe(side, side - 1) } else { lattice(side) };
            message(&[HullDefinition { contraction_point: Some([1e-3 * f64::from(i), 0.0, 0.0]), ..shape }])
        })
        .collect();
    arena.begin().await;
    flood(arena, &messages).await;
}

async fn cancelled(arena: &Arena) {
    let ids = arena.register(&[plain(box_points(0.5, 0.5, 0.5))]).await;
    let question = same_pair(&ids, arena.size().of(131_072), 0.9).encode_to_vec();
    let question = raw::frame(false, &question);
    arena.begin().await;
    let callers = (0..4).map(async |_| {
        loop {
            let Ok(mut peer) = arena.peer(Windows::OPEN).await else { continue };
            while let Ok(call) = peer.ask(QUERY, &question).await
                && peer.reset(call).await.is_ok()
            {}
        }
    });
    tokio::select! {
        () = arena.bystander_answered(arena.size().of(800)) => {}
        _ = join_all(callers) => {}
    }
}
