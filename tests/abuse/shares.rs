//! Attacks on the rule that all clients of one address count as one caller.

use futures_util::{StreamExt, future::join_all, stream};

use crate::{
    raw,
    support::{
        QUERY,
        arena::{ATTACKER, Arena, parts},
        dial,
        http2::{Peer, Windows},
    },
};

attacks! {
    /// Catches two clients of one address that together get more than one caller's share, and a share that
    /// leaves nothing for another address.
    one_address: "two clients of one address that send endless messages" => one_address;
}

/// A second address, which is not the attacker's.
const OTHER: &str = "127.0.0.4";

async fn one_address(arena: &Arena) {
    let bytes = arena.setup.message_bytes();
    let whole = raw::frame(false, &vec![0; bytes]);
    arena.begin().await;
    let budget = arena.setup.memory_bytes() as f64;
    // Each client tries to take three quarters of the budget.
    let wanted = (budget * 0.75) as usize / bytes + 1;
    let clients = join_all((0..2).map(|_| hold(arena, ATTACKER, wanted, &whole))).await;
    let metrics = arena.server.metrics().await;
    let held: f64 =
        parts(&metrics).iter().filter_map(|part| part.rsplit_once("} ")?.1.parse::<f64>().ok()).sum();
    assert!(held <= budget * 0.55, "{held} bytes of {budget} for one address and a bystander");
    assert!(held >= budget * 0.2, "{held} bytes of {budget}: the address was refused too early");
    // The free part of the budget is available to an address that comes later.
    let other = hold(arena, OTHER, 1, &whole[..whole.len() / 2]).await;
    assert_eq!(other.len(), 1);
    arena.bystander_answered(arena.size().of(400)).await;
    drop((clients, other));
}

/// Sends `messages` messages without their last byte from one address. Returns the connections on which the
/// server accepted all of the bytes.
async fn hold(arena: &Arena, from: &'static str, messages: usize, whole: &[u8]) -> Vec<Peer> {
    let part = &whole[..whole.len() - 1];
    let sent = (0..messages).map(async |_| {
        let stream = dial::tcp(from, arena.server.address).await.ok()?;
        let mut peer = Peer::open(Box::new(stream), Windows::OPEN).await.ok()?;
        let call = peer.call(QUERY, &[]).await.ok()?;
        peer.body(call, part, false).await.ok()?;
        Some(peer)
    });
    stream::iter(sent).buffer_unordered(4).filter_map(async |peer| peer).collect().await
}
