//! Messages of many small elements, and other forms of protobuf that cost the server more to decode than
//! they cost the sender.

use futures_util::future::join_all;

use crate::{
    messages::{field, repeated, varint},
    raw,
    support::{GET, HAS, QUERY, REGISTER, arena::Arena, http2::Windows},
};

attacks! {
    /// Catches elements that are allocated before they are counted.
    empty: "64 MiB of empty elements of two bytes, to every method with repeated messages" => empty_elements;
    /// Catches packed arrays that are decoded one element at a time, or that grow without a limit on their
    /// count.
    columns: "64 MiB of repeated numbers, unpacked or split into many packed pieces" => columns;
    /// Catches repeated singular fields that are decoded in full each time, and recursion without a limit.
    fields: "64 MiB of repeated singular fields, unknown fields and nested groups" => fields;
    /// Catches elements that are counted in time only on TCP.
    over_unix: "64 MiB of empty elements over a Unix socket", |s: Setup| s.over_unix() => empty_elements;
}

async fn empty_elements(arena: &Arena) {
    let bytes = arena.setup.message_bytes();
    let mask = field(2, &repeated(&[0x0a, 0], bytes - 16));
    flood(
        arena,
        vec![
            // One row each for hulls, ids, hull_ids, the paths of field_mask, and outputs.
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
            // Pairs and positions as unpacked elements; positions in packed pieces of one element and of
            // none.
            (QUERY, repeated(&[0x3d, 1, 0, 0, 0], bytes)),
            (QUERY, repeated(&[0x29, 0, 0, 0, 0, 0, 0, 0, 0], bytes)),
            (QUERY, repeated(&[0x2a, 8, 0, 0, 0, 0, 0, 0, 0, 0], bytes)),
            (QUERY, repeated(&[0x2a, 0], bytes)),
            // The vertices of one hull, in packed pieces of one element.
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
            // accuracy; request_id; a number with an unknown tag; an unknown group nested in two others.
            (QUERY, repeated(&[0x62, 0], bytes)),
            (QUERY, repeated(&[0x08, 1], bytes)),
            (QUERY, repeated(&unknown, bytes)),
            (QUERY, repeated(&[0xa3, 6], bytes)),
        ],
    )
    .await;
}

/// Sends each message again and again on two connections, until the bystander has been answered often
/// enough during each one.
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
