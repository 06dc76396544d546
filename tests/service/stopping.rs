//! Calls whose callers have left stop computing.

use std::time::Duration;

use hullcast::{
    budget::{Caller, Part},
    proto::QueryContactsRequest,
};
use prost::Message;

use crate::support::{
    Setup, TestServer,
    raw::{frame, status_of},
    scenes::{ALL, outputs, plain, register_request, round_points, scene, shapes},
};

/// So many pairs that no machine computes them before the server learns that the caller has left.
const PAIRS: usize = 131_072;

fn long() -> QueryContactsRequest {
    QueryContactsRequest {
        margin: f64::INFINITY,
        outputs: outputs(&ALL),
        ..scene(&shapes()[3..4], 1000, PAIRS, 3)
    }
}

async fn server() -> TestServer {
    let server = TestServer::start().await;
    server.hulls().register_hulls(register_request(&shapes())).await.unwrap();
    server
}

/// The number of pairs computed, once no call is under way and all capacity is free again. It must
/// not change after that.
async fn settled(server: &TestServer) -> u64 {
    server.until("hullcast_requests_in_flight", 0.0).await;
    let limit = server.app.limits().max_pairs_in_flight as usize;
    let nothing = hullcast::batch::Outputs::OUTCOME;
    while let Err(refused) = server.app.engine().admit(limit, nothing, &Caller::alone()) {
        assert_eq!(refused.reason, hullcast::service::Reason::TooBusy);
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    let computed = server.app.engine().pairs_computed();
    tokio::time::sleep(Duration::from_millis(100)).await;
    assert_eq!(
        server.app.engine().pairs_computed(),
        computed,
        "pairs were computed after all capacity was free"
    );
    computed
}

/// At least as many pairs, of bodies that all meet, for FindContacts.
fn long_to_find() -> QueryContactsRequest {
    QueryContactsRequest { pairs: vec![], margin: 10.0, ..long() }
}

#[derive(Clone, Copy, Debug)]
enum CallKind {
    Query,
    Stream,
    Find,
}

/// A client leaves after the first chunks; most pairs must stay uncomputed, and their capacity must
/// be free again. Catches computation that outlives its call.
#[tokio::test(flavor = "multi_thread")]
async fn a_cancelled_call_stops_computing() {
    let server = server().await;
    for kind in [CallKind::Query, CallKind::Stream, CallKind::Find] {
        let before = server.app.engine().pairs_computed();
        let mut contacts = server.contacts();
        let call = tokio::spawn(async move {
            match kind {
                CallKind::Query => contacts.query_contacts(long()).await.map(|_| ()),
                CallKind::Stream => {
                    let requests = futures_util::stream::iter([long()]);
                    let mut answers = contacts.stream_contacts(requests).await.unwrap().into_inner();
                    answers.message().await.map(|_| ())
                }
                CallKind::Find => {
                    let mut answers = contacts.find_contacts(long_to_find()).await.unwrap().into_inner();
                    while answers.message().await?.is_some() {}
                    Ok(())
                }
            }
        });
        while server.app.engine().pairs_computed() == before {
            tokio::time::sleep(Duration::from_micros(100)).await;
        }
        call.abort();
        assert!(call.await.unwrap_err().is_cancelled());
        let computed = settled(&server).await - before;
        assert!(computed > 0 && computed < PAIRS as u64, "{kind:?}: {computed} of {PAIRS}");
    }
}

/// Catches an expired call that is answered in time but still computed to the end.
#[tokio::test(flavor = "multi_thread")]
async fn an_expired_call_stops_computing() {
    let server = server().await;
    let [long, to_find] = [long(), long_to_find()].map(|request| frame(false, &request.encode_to_vec()));
    let calls = [("QueryContacts", &long), ("StreamContacts", &long), ("FindContacts", &to_find)];
    for (path, body) in calls {
        let before = server.app.engine().pairs_computed();
        let path = format!("/hullcast.v1.ContactService/{path}");
        let timeout = [("grpc-timeout", "30m")];
        let (status, _) = status_of(&server.address, &path, &timeout, body.clone()).await;
        assert_eq!(status.code(), tonic::Code::DeadlineExceeded, "{status:?}");
        let computed = settled(&server).await - before;
        assert!(computed < PAIRS as u64, "{computed} of {PAIRS}");
    }
}

/// Catches registrations that are in no budget while they wait to be built, and registrations that
/// keep their memory, or are still built, after their callers have left.
#[tokio::test(flavor = "multi_thread")]
async fn registrations_that_nobody_waits_for_give_their_memory_back() {
    const CALLS: usize = 10;
    let server = Setup { threads: 1, ..Setup::default() }.start().await;
    let known = shapes();
    server.hulls().register_hulls(register_request(&known)).await.unwrap();
    // The only compute thread is blocked by pairs that may not be computed.
    let controls = server.app.engine().test_controls();
    controls.allow(0);
    let mut contacts = server.contacts();
    let request = QueryContactsRequest { outputs: outputs(&ALL), ..scene(&known[..3], 20, 200, 1) };
    let query = tokio::spawn(async move { contacts.query_contacts(request).await });
    server.until("hullcast_pairs_in_flight", 200.0).await;
    let calls: Vec<_> = (0..CALLS as u64)
        .map(|seed| {
            let mut hulls = server.hulls();
            let request = register_request(&[plain(round_points(500, 100 + seed))]);
            tokio::spawn(async move { hulls.register_hulls(request).await })
        })
        .collect();
    let used = |part| server.app.memory().used_by(part);
    // Each registration is charged more than a kilobyte per point.
    while used(Part::Building) < (CALLS * 500 * 1024) as u64 {
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    for call in calls {
        call.abort();
        assert!(call.await.unwrap_err().is_cancelled());
    }
    controls.open();
    assert_eq!(query.await.unwrap().unwrap().into_inner().outcomes.len(), 200);
    server.until("hullcast_requests_in_flight", 0.0).await;
    for &part in &[Part::Building, Part::Decoded, Part::Answers] {
        while used(part) > 0 {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }
    // The thread may have started one registration before the pairs.
    let registered = server.metric("hullcast_registered_total") as usize - known.len();
    assert!(registered <= 1, "{registered} of {CALLS} were built");
}
