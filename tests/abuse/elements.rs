//! Messages of many small elements, and other forms of protobuf that cost more to decode than
//! to send.

use futures_util::future::join_all;

use crate::{
    messages::{field, repeated, varint},
    raw,
    support::{GET, HAS, QUERY, REGISTER, arena::Arena, http2::Windows},
};

attacks! {
    /// Catches elements that are counted after they were allocated.
    empty: "64 MiB of empty elements of two bytes, to every method that has such" => empty_elements;
    /// Catches columns that are decoded element after element, or that grow without a count.
    columns: "64 MiB of unpacked and of split columns" => columns;
    /// Catches fields that are decoded again and again, and recursion without a bound.
    fields: "64 MiB of repeated singular fields, unknown fields and nested groups" => fields;
    /// Catches the same over a Unix socket.
    over_unix: "64 MiB of empty elements over a Unix socket", |s: Setup| s.over_unix() => empty_elements;
}

async fn empty_elements(arena: &Arena) {
    let bytes = arena.setup.message_bytes();
    let mask = field(2, &repeated(&[0x0a, 0], bytes - 16));
    flood(
        arena,
        vec![
            // hulls, ids, hull_ids, the paths of field_mask, outputs
            (REGISTER, repeated(&[0x0a, 0], bytes)),
            (GET, repeated(&[0x0a, 0], bytes)),
            (HAS, repeated(&[0x0a, 0], bytes)),
            (QUERY, repeated(&[0x1a, 0], bytes)),
            (GET, mask),
            (QUERY, repeated(&[0x68, 1], bytes)),
        ],
    )
    .await;
}

async fn columns(arena: &Arena) {
    let bytes = arena.setup.message_bytes();
    flood(
        arena,
        vec![
            // pairs and positions, an element each; positions in chunks of one element and of none
            (QUERY, repeated(&[0x3d, 1, 0, 0, 0], bytes)),
            (QUERY, repeated(&[0x29, 0, 0, 0, 0, 0, 0, 0, 0], bytes)),
            (QUERY, repeated(&[0x2a, 8, 0, 0, 0, 0, 0, 0, 0, 0], bytes)),
            (QUERY, repeated(&[0x2a, 0], bytes)),
            // the vertices of one hull, in chunks of one element
            (REGISTER, field(1, &repeated(&[0x0a, 8, 0, 0, 0, 0, 0, 0, 0, 0], bytes - 16))),
        ],
    )
    .await;
}

async fn fields(arena: &Arena) {
    let bytes = arena.setup.message_bytes();
    let mut unknown = Vec::new();
    varint(&mut unknown, 1000 << 3);
    unknown.push(1);
    flood(
        arena,
        vec![
            // accuracy, request_id, an unknown number, an unknown group in a group in a group
            (QUERY, repeated(&[0x62, 0], bytes)),
            (QUERY, repeated(&[0x08, 1], bytes)),
            (QUERY, repeated(&unknown, bytes)),
            (QUERY, repeated(&[0xa3, 6], bytes)),
        ],
    )
    .await;
}

/// Sends each message on two connections, again and again, until the bystander was answered
/// often enough beside each.
async fn flood(arena: &Arena, messages: Vec<(&'static str, Vec<u8>)>) {
    arena.begin().await;
    let answers = arena.size().of(400) / messages.len();
    for (path, message) in messages {
        let message = raw::frame(false, &message);
        let senders = join_all((0..2).map(async |_| {
            loop {
                let Ok(mut peer) = arena.peer(Windows::OPEN).await else { continue };
                while let Ok(call) = peer.ask(path, &message).await
                    && peer.ended(call).await.is_ok()
                {}
            }
        }));
        tokio::select! {
            () = arena.bystander_answered(answers.max(4)) => {}
            _ = senders => {}
        }
    }
}
