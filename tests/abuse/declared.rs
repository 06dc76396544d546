//! Messages whose headers declare a length that the caller never sends.

use std::io;

use crate::support::{
    QUERY, WATCH,
    arena::Arena,
    http2::{DATA, END_HEADERS, HEADERS, Peer, Windows, frame, header_block},
};

attacks! {
    /// Catches memory that is reserved for a declared length before the bytes arrive.
    lengths: "10,000 streams that declare the largest message and send 5 bytes" => many_lengths;
    /// Catches that reservation for a caller that has not presented a token.
    lengths_without_a_token: "2,000 health streams without a token that declare 4 MiB", |s: Setup| s.tokens()
        => watch_lengths;
    /// Catches an allocation failure that ends the process when the address space is limited.
    lengths_in_a_small_address_space: "1,000 streams that declare the largest message, 8 GiB of addresses",
        |s: Setup| Setup { ulimit: Some("-v 8388608".into()), ..s } => some_lengths;
    /// Catches a reservation that is bounded only on TCP.
    lengths_over_unix: "1,000 streams that declare the largest message, over a Unix socket",
        |s: Setup| s.over_unix() => some_lengths;
    /// Catches a reservation that is bounded only without TLS.
    lengths_over_tls: "1,000 streams that declare the largest message, over TLS",
        |s: Setup| s.tls() => some_lengths;
}

async fn many_lengths(arena: &Arena) {
    declare(arena, QUERY, 10, arena.setup.message_bytes()).await;
}

async fn some_lengths(arena: &Arena) {
    declare(arena, QUERY, 1, arena.setup.message_bytes()).await;
}

async fn watch_lengths(arena: &Arena) {
    declare(arena, WATCH, 2, 4 << 20).await;
}

/// Opens connections with 1,000 streams each that declare `bytes`, and waits for the bystander.
async fn declare(arena: &Arena, path: &str, connections: usize, bytes: usize) {
    arena.begin().await;
    let mut peers = Vec::new();
    for _ in 0..connections {
        // The server may defend itself by refusing or closing the connection.
        if let Ok(mut peer) = arena.peer(Windows::OPEN).await {
            let _ = declarations(&mut peer, path, arena.size().of(1000), bytes).await;
            peers.push(peer);
        }
    }
    arena.bystander_answered(arena.size().of(400)).await;
}

async fn declarations(peer: &mut Peer, path: &str, streams: usize, bytes: usize) -> io::Result<()> {
    let mut head = vec![0];
    head.extend((bytes as u32).to_be_bytes());
    let block = header_block(path, &[]);
    for _ in 0..streams {
        let stream = peer.next_stream();
        let mut both = frame(HEADERS, END_HEADERS, stream, &block);
        both.extend(frame(DATA, 0, stream, &head));
        peer.send(&both).await?;
    }
    Ok(())
}
