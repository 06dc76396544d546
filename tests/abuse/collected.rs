//! Small requests for large answers.

use futures_util::future::join_all;
use hullcast::proto::GetHullsRequest;
use prost_types::FieldMask;

use crate::{
    scenes::{plain, round_points},
    support::{arena::Arena, bystander::with_token},
};

attacks! {
    /// Catches an answer whose size is checked only after the whole answer was collected.
    repeated_ids: "GetHulls that names one hull of 16,384 vertices 4,000 times" => repeated_ids;
}

async fn repeated_ids(arena: &Arena) {
    let ids = arena.register(&[plain(round_points(arena.size().of(16_384), 1))]).await;
    let request = GetHullsRequest {
        ids: vec![ids[0].clone(); arena.size().of(4000)],
        field_mask: Some(FieldMask { paths: vec!["vertices".into(), "faces".into()] }),
    };
    let callers = join_all((0..8).map(|_| arena.hulls())).await;
    arena.begin().await;
    let flood = join_all(callers.into_iter().map(async |mut hulls| {
        loop {
            let answer = hulls.get_hulls(with_token(request.clone())).await;
            assert!(answer.is_err(), "the server sent an answer of gigabytes");
        }
    }));
    tokio::select! {
        () = arena.bystander_answered(arena.size().of(400)) => {}
        _ = flood => {}
    }
}
