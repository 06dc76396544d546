//! Fields of steps in the wrong place or with wrong values.

use hullcast::proto::{Output, QueryContactsRequest};

use super::{NONE, Stepper, all_outputs};
use crate::support::{
    TestServer, invalid, refusal,
    scenes::{register_request, two_boxes},
};

type Spoil = fn(&mut QueryContactsRequest);

/// The message that finds the pairs of two boxes.
fn find() -> QueryContactsRequest {
    QueryContactsRequest { find: true, pairs: vec![], outputs: all_outputs(), ..two_boxes().1 }
}

/// Catches a field of steps that a unary method ignores in silence, and with it answers another question.
#[tokio::test(flavor = "multi_thread")]
async fn fields_of_steps_are_refused_outside_a_stream() {
    let server = TestServer::start().await;
    let cases: [(Spoil, &str); 5] = [
        (|r| r.find = true, "find"),
        (|r| r.moved = vec![0], "moved"),
        (|r| r.previous_bodies = vec![0, 1], "previous_bodies"),
        (|r| r.outputs = vec![Output::Matches.into()], "outputs"),
        (|r| r.inherit = true, "inherit"),
    ];
    for (spoil, field) in cases {
        let mut request = two_boxes().1;
        spoil(&mut request);
        let refused = server.contacts().query_contacts(request.clone()).await.unwrap_err();
        assert_eq!(refusal(&refused), invalid("FIELD_NOT_ALLOWED", field));
        let search = QueryContactsRequest { pairs: vec![], ..request };
        let refused = server.contacts().find_contacts(search).await.unwrap_err();
        assert_eq!(refusal(&refused), invalid("FIELD_NOT_ALLOWED", field));
    }
}

/// Catches a field that a message of a stream must not have together with another one, and a value out of range.
#[tokio::test(flavor = "multi_thread")]
async fn a_first_message_names_its_fault() {
    let server = TestServer::start().await;
    let cases: [(Spoil, &str, &str); 10] = [
        (|r| r.pairs = vec![0, 1], "FIELD_NOT_ALLOWED", "pairs"),
        (|r| r.warm_starts = vec![0; 6], "FIELD_NOT_ALLOWED", "warm_starts"),
        (|r| r.moved = vec![0], "FIELD_NOT_ALLOWED", "moved"),
        (|r| r.margin = f64::INFINITY, "VALUE_OUT_OF_RANGE", "margin"),
        (|r| r.worlds = vec![0], "LENGTH_MISMATCH", "worlds"),
        (|r| r.previous_bodies = vec![0, 1], "NOTHING_TO_INHERIT", "previous_bodies"),
        (|r| (r.find, r.worlds) = (false, vec![0, 0]), "FIELD_NOT_ALLOWED", "worlds"),
        (|r| (r.find, r.groups) = (false, vec![0, 0]), "FIELD_NOT_ALLOWED", "groups"),
        (|r| (r.find, r.ignored_groups) = (false, vec![1, 2]), "FIELD_NOT_ALLOWED", "ignored_groups"),
        (|r| r.inherit = true, "NOTHING_TO_INHERIT", "inherit"),
    ];
    for (spoil, reason, field) in cases {
        let mut request = find();
        spoil(&mut request);
        let mut stream = Stepper::open(&server).await;
        assert_eq!(stream.step(request).await.unwrap_err(), invalid(reason, field), "{field}");
    }
}

/// Catches a wrong list of moved bodies that moves another body, and an inherited field that is ignored.
#[tokio::test(flavor = "multi_thread")]
async fn a_later_message_names_its_fault() {
    let server = TestServer::start().await;
    server.hulls().register_hulls(register_request(&two_boxes().0)).await.unwrap();
    let cases: [(Spoil, &str, &str); 16] = [
        (|r| r.find = true, "FIELD_NOT_ALLOWED", "find"),
        (|r| r.margins = vec![0.0; 2], "FIELD_NOT_ALLOWED", "margins"),
        (|r| r.turning_points = vec![0.0; 6], "LENGTH_MISMATCH", "turning_points"),
        (|r| r.previous_bodies = vec![0, 1], "FIELD_NOT_ALLOWED", "previous_bodies"),
        (|r| r.worlds = vec![0, 0], "FIELD_NOT_ALLOWED", "worlds"),
        (|r| r.outputs = vec![9], "FIELD_NOT_ALLOWED", "outputs"),
        (|r| r.moved = vec![2], "INDEX_OUT_OF_RANGE", "moved[0]"),
        (
            |r| (r.moved, r.positions, r.rotations) = (vec![0, 2], vec![0.0; 6], vec![1.0; 8]),
            "INDEX_OUT_OF_RANGE",
            "moved[1]",
        ),
        (
            |r| (r.moved, r.positions, r.rotations) = (vec![1, 0], vec![0.0; 6], vec![1.0; 8]),
            "VALUE_OUT_OF_RANGE",
            "moved[1]",
        ),
        (
            |r| (r.moved, r.positions, r.rotations) = (vec![1, 1], vec![0.0; 6], vec![1.0; 8]),
            "VALUE_OUT_OF_RANGE",
            "moved[1]",
        ),
        (|r| r.positions.push(0.0), "LENGTH_MISMATCH", "positions"),
        (|r| r.positions.clear(), "LENGTH_MISMATCH", "positions"),
        (|r| r.rotations.clear(), "LENGTH_MISMATCH", "rotations"),
        (|r| r.moved.clear(), "LENGTH_MISMATCH", "positions"),
        (|r| r.time_step = -1.0, "VALUE_OUT_OF_RANGE", "time_step"),
        (|r| r.linear_velocities = vec![0.0; 2], "LENGTH_MISMATCH", "linear_velocities"),
    ];
    for (spoil, reason, field) in cases {
        let mut stream = Stepper::open(&server).await;
        stream.step(find()).await.unwrap();
        let mut request = QueryContactsRequest {
            inherit: true,
            moved: vec![1],
            positions: vec![0.0, 0.0, 0.9],
            rotations: vec![0.0, 0.0, 0.0, 1.0],
            ..Default::default()
        };
        spoil(&mut request);
        assert_eq!(stream.step(request).await.unwrap_err(), invalid(reason, field), "{field}");
    }
    let cases: [(&[u32], &str, &str); 4] = [
        (&[0], "LENGTH_MISMATCH", "previous_bodies"),
        (&[0, 2], "INDEX_OUT_OF_RANGE", "previous_bodies[1]"),
        (&[1, 1], "VALUE_OUT_OF_RANGE", "previous_bodies[1]"),
        (&[NONE, NONE], "", ""),
    ];
    for (previous_bodies, reason, field) in cases {
        let mut stream = Stepper::open(&server).await;
        stream.step(find()).await.unwrap();
        let request = QueryContactsRequest { previous_bodies: previous_bodies.to_vec(), ..find() };
        match stream.step(request).await {
            Ok(answer) => assert!(reason.is_empty() && answer.whole.previous_pairs == [NONE]),
            Err(refusal) => assert_eq!(refusal, invalid(reason, field), "{field}"),
        }
    }
}
