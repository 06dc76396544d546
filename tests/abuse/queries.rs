//! Pairs and scenes that cost more to compute than their number suggests.

use futures_util::future::join_all;
use hullcast::proto::QueryContactsRequest;
use prost::Message;

use crate::{
    messages::{few_points, globe, prism, row, same_pair},
    raw,
    scenes::{box_points, plain},
    support::{FIND, QUERY, arena::Arena, http2::Windows, setup::Size},
};

attacks! {
    /// Catches clipping in quadratic time, and limits that count pairs although they should count cost.
    clipping: "pairs of two faces of 8,192 sides, in batches of 32 and 64" => clipping;
    /// Catches pairs on which every decision needs exact arithmetic.
    degenerate: "131,072 near-degenerate pairs at a time" => degenerate;
    /// Catches a search for pairs that finds nothing and cannot be interrupted.
    one_group: "FindContacts: bodies at one place, all of one group" => one_group;
    /// Catches ignored pairs that are sorted on a thread that serves connections.
    ignored_pairs: "FindContacts with 4.5 million ignored pairs" => ignored_pairs;
    /// Catches a fixed cost per world of the search for pairs.
    worlds: "FindContacts with 65,000 worlds" => worlds;
    /// Catches a queue that takes work in the order of arrival, instead of in turn between callers.
    backlog: "16 batches of 512 costly pairs that are sent at once" => backlog;
}

/// The number of the bystander's queries that are answered before the attacker's backlog is.
const BEFORE_BACKLOG: usize = 20;

/// Pairs of two faces of thousands of sides. One is turned a little, so that each side crosses another.
async fn faces(arena: &Arena) -> impl Fn(usize) -> QueryContactsRequest {
    let ids = arena.register(&[prism(arena.size().of(8192))]).await;
    move |pairs| {
        let mut request = few_points(same_pair(&ids, pairs, 0.9));
        let (sin, cos) = 1e-4_f64.sin_cos();
        request.rotations[6..].copy_from_slice(&[sin, cos]);
        request
    }
}

async fn clipping(arena: &Arena) {
    let faces = faces(arena).await;
    arena.begin().await;
    flood(arena, &[32, 64, 32, 64].map(|pairs| (QUERY, faces(pairs)))).await;
}

async fn backlog(arena: &Arena) {
    let question = raw::frame(false, &faces(arena).await(512).encode_to_vec());
    arena.begin().await;
    let sent = (0..16).map(async |_| {
        let mut peer = arena.peer(Windows::OPEN).await.expect("a connection");
        let call = peer.ask(QUERY, &question).await.expect("a call");
        (peer, call)
    });
    let sent = join_all(sent).await;
    // A call that is refused ends at once, so the last one to end is computed.
    tokio::select! {
        () = arena.bystander_answered(BEFORE_BACKLOG) => {}
        _ = join_all(sent.iter().map(|(peer, call)| peer.ended(*call))) => {
            panic!("the backlog ended before the bystander's query number {BEFORE_BACKLOG}")
        }
    }
}

async fn degenerate(arena: &Arena) {
    let side = match arena.size() {
        Size::Full => 32,
        Size::Tenth => 12,
    };
    let ids = arena.register(&[globe(side, side)]).await;
    let pairs = arena.size().of(131_072);
    arena.begin().await;
    let mut requests = Vec::new();
    for distance in [0.0, 1e-300, 1.0, 2.0] {
        let mut request = few_points(same_pair(&ids, pairs, distance));
        request.positions[3..5].fill(0.0);
        requests.push((QUERY, request));
    }
    flood(arena, &requests).await;
}

/// A scene of bodies of one box, all at the same position.
async fn crowd(arena: &Arena, bodies: usize) -> QueryContactsRequest {
    let ids = arena.register(&[plain(box_points(0.5, 0.5, 0.5))]).await;
    row(&ids[0], bodies, 0.0)
}

async fn one_group(arena: &Arena) {
    let bodies = arena.size().of(131_072);
    let request = QueryContactsRequest { groups: vec![1; bodies], ..crowd(arena, bodies).await };
    arena.begin().await;
    flood(arena, &[(FIND, request.clone()), (FIND, request)]).await;
}

async fn ignored_pairs(arena: &Arena) {
    let bodies = arena.size().of(131_072);
    let rules = arena.size().of(4_500_000) as u32;
    let mut request = QueryContactsRequest {
        groups: (1..=bodies as u32).collect(),
        ignored_groups: (0..rules).flat_map(|i| [i.wrapping_mul(2_654_435_761) | 1, i + 1]).collect(),
        ..crowd(arena, bodies).await
    };
    request.positions = (0..bodies).flat_map(|body| [2.0 * body as f64, 0.0, 0.0]).collect();
    arena.begin().await;
    flood(arena, &[(FIND, request.clone()), (FIND, request)]).await;
}

async fn worlds(arena: &Arena) {
    let bodies = arena.size().of(131_072);
    let request = QueryContactsRequest {
        worlds: (0..bodies as u32).map(|body| body / 2).collect(),
        groups: vec![1; bodies],
        ..crowd(arena, bodies).await
    };
    arena.begin().await;
    flood(arena, &[(FIND, request.clone()), (FIND, request)]).await;
}

/// Sends each request again and again on a connection of its own, until the bystander has been answered
/// often enough. Then the calls in progress are cancelled.
async fn flood(arena: &Arena, questions: &[(&'static str, QueryContactsRequest)]) {
    let callers = questions.iter().map(async |(path, request)| {
        let question = raw::frame(false, &request.encode_to_vec());
        loop {
            let Ok(mut peer) = arena.peer(Windows::OPEN).await else { continue };
            while let Ok(call) = peer.ask(path, &question).await
                && peer.ended(call).await.is_ok()
            {}
        }
    });
    tokio::select! {
        () = arena.bystander_answered(arena.size().of(400)) => {}
        _ = join_all(callers) => {}
    }
}
