//! The start and end of a server: health, reflection, addresses, drain.

use std::{path::Path, pin::pin, sync::Arc, time::Duration};

use futures_util::StreamExt;
use hullcast::{
    proto::GetServerInfoRequest,
    service::{App, Limits, Listener, ServerOptions, run},
    store::blobs,
};
use tokio::net::TcpStream;
use tonic::Code;
use tonic_health::pb::{
    HealthCheckRequest, health_check_response::ServingStatus, health_client::HealthClient,
};
use tonic_reflection::pb::{v1, v1alpha};

use crate::support::{
    Setup, TestServer, raw, refusal, refused,
    scenes::{register_request, two_boxes},
};

fn draining(drain: Duration) -> Setup {
    Setup { options: ServerOptions { drain, ..ServerOptions::default() }, ..Setup::default() }
}

/// Catches a service that health does not know, and one that is served but not reported as such.
#[tokio::test(flavor = "multi_thread")]
async fn health_is_answered_per_service() {
    let server = TestServer::start().await;
    let mut health = HealthClient::new(server.channel());
    for service in ["", "hullcast.v1.HullService", "hullcast.v1.ContactService", "hullcast.v1.ServerService"]
    {
        let request = HealthCheckRequest { service: service.into() };
        let answer = health.check(request).await.unwrap().into_inner();
        assert_eq!(answer.status(), ServingStatus::Serving, "{service}");
    }
    let request = HealthCheckRequest { service: "hullcast.v1.Nothing".into() };
    let status = health.check(request).await.unwrap_err();
    assert_eq!(refusal(&status), refused(Code::NotFound, "NOT_FOUND", ""));
}

/// Catches reflection, in either version of its protocol, that gives a client such as grpcurl no
/// services or no types.
#[tokio::test(flavor = "multi_thread")]
async fn reflection_lists_and_describes_every_service() {
    let server = TestServer::start().await;
    let services = ["ContactService", "HullService", "ServerService"].map(|s| format!("hullcast.v1.{s}"));

    let mut client = v1::server_reflection_client::ServerReflectionClient::new(server.channel());
    use v1::{
        ServerReflectionRequest, server_reflection_request::MessageRequest,
        server_reflection_response::MessageResponse,
    };
    let ask = |message| ServerReflectionRequest { host: String::new(), message_request: Some(message) };
    let requests = [
        ask(MessageRequest::ListServices(String::new())),
        ask(MessageRequest::FileContainingSymbol("hullcast.v1.QueryContactsRequest".into())),
    ];
    let mut answers =
        client.server_reflection_info(futures_util::stream::iter(requests)).await.unwrap().into_inner();
    let Some(MessageResponse::ListServicesResponse(list)) =
        answers.message().await.unwrap().unwrap().message_response
    else {
        panic!("no list")
    };
    let listed: Vec<_> = list.service.into_iter().map(|service| service.name).collect();
    assert!(services.iter().all(|service| listed.contains(service)), "{listed:?}");
    assert!(listed.contains(&"grpc.health.v1.Health".to_owned()), "{listed:?}");
    let Some(MessageResponse::FileDescriptorResponse(files)) =
        answers.message().await.unwrap().unwrap().message_response
    else {
        panic!("no file")
    };
    assert!(!files.file_descriptor_proto.is_empty());

    let mut client = v1alpha::server_reflection_client::ServerReflectionClient::new(server.channel());
    let request = v1alpha::ServerReflectionRequest {
        host: String::new(),
        message_request: Some(
            v1alpha::server_reflection_request::MessageRequest::ListServices(String::new()),
        ),
    };
    let answers = client.server_reflection_info(futures_util::stream::iter([request])).await.unwrap();
    let answers: Vec<_> = answers.into_inner().collect().await;
    assert_eq!(answers.len(), 1);
    assert!(answers[0].is_ok());
}

/// HTTP/2 announces the limit on concurrent calls when the client connects. Catches a limit that is
/// published but not announced there.
#[tokio::test(flavor = "multi_thread")]
async fn concurrent_calls_are_limited_as_published() {
    let limits = Limits { max_streams_per_connection: 7, ..Limits::default() };
    let server = TestServer::with_limits(limits).await;
    let (_client, connection) = raw::connection(&server.address).await;
    let mut connection = pin!(connection);
    let mut told = connection.current_max_send_streams();
    for _ in 0..10_000 {
        if told == 7 {
            break;
        }
        let pause = tokio::time::timeout(Duration::from_millis(1), connection.as_mut()).await;
        assert!(pause.is_err(), "the connection ended: {pause:?}");
        told = connection.current_max_send_streams();
    }
    assert_eq!(told, 7);
}

/// Catches a stop that cuts off a call in flight, that waits for an idle stream, or that goes on
/// accepting connections.
#[tokio::test(flavor = "multi_thread")]
async fn stopping_ends_streams_and_refuses_the_rest() {
    // Longer than the test may take: the stop must not need the deadline.
    let mut server = draining(Duration::from_secs(3600)).start().await;
    let (shapes, request) = two_boxes();
    server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
    let (send, mut requests) = tokio::sync::mpsc::channel(1);
    let requests = futures_util::stream::poll_fn(move |cx| requests.poll_recv(cx));
    let mut answers = server.contacts().stream_contacts(requests).await.unwrap().into_inner();
    send.send(request).await.unwrap();
    assert!(answers.message().await.unwrap().is_some());
    server.begin_stop();
    let status = answers.message().await.unwrap_err();
    assert_eq!(refusal(&status), refused(Code::Unavailable, "STOPPING", ""));
    let address = server.address.clone();
    server.stopped().await;
    assert!(TcpStream::connect(&address).await.is_err());
}

/// Catches a stop that is not reported to a load balancer which watches health, or that waits until
/// the balancer stops watching.
#[tokio::test(flavor = "multi_thread")]
async fn watchers_of_health_hear_of_the_stop_and_do_not_delay_it() {
    let mut server = draining(Duration::from_secs(3600)).start().await;
    let mut health = HealthClient::new(server.channel());
    let request = HealthCheckRequest { service: "hullcast.v1.ContactService".into() };
    let mut watch = health.watch(request).await.unwrap().into_inner();
    let first = watch.message().await.unwrap().unwrap();
    assert_eq!(first.status(), ServingStatus::Serving);
    server.begin_stop();
    let last = watch.message().await.unwrap().unwrap();
    assert_eq!(last.status(), ServingStatus::NotServing);
    assert!(!matches!(watch.message().await, Ok(Some(_))));
    server.stopped().await;
}

/// Catches a stop that hangs on a client that never reads or closes.
#[tokio::test(flavor = "multi_thread")]
async fn a_stuck_client_is_cut_off_at_the_drain_deadline() {
    let mut server = draining(Duration::from_millis(100)).start().await;
    let mut client = raw::connect(&server.address).await;
    // A call whose request never ends.
    let path = "/hullcast.v1.ContactService/QueryContacts";
    let response = tokio::spawn(client.send_request(raw::call(path, &[], raw::Body::Never)));
    // Once the server answers a later call on the same connection, it has seen this one.
    let info = "/hullcast.v1.ServerService/GetServerInfo";
    let (status, _) = raw::status_on(&mut client, info, &[], raw::frame(false, &[])).await;
    assert_eq!(status.code(), Code::Ok);
    server.begin_stop();
    server.stopped().await;
    assert!(response.await.unwrap().is_err());
}

/// A connection that reaches its maximum age is told to close, its stream ends after the message
/// under way, and the next call uses a new connection. Catches a client that stays with an old
/// server.
#[tokio::test(flavor = "multi_thread")]
async fn connections_end_at_their_age() {
    let (shapes, request) = two_boxes();
    let mut age = Duration::from_millis(300);
    let server = loop {
        let mut setup = Setup::default();
        setup.options.max_connection_age = age;
        let server = setup.start().await;
        server.hulls().register_hulls(register_request(&shapes)).await.unwrap();
        let (send, mut requests) = tokio::sync::mpsc::channel(1);
        let requests = futures_util::stream::poll_fn(move |cx| requests.poll_recv(cx));
        let mut answers = server.contacts().stream_contacts(requests).await.unwrap().into_inner();
        let mut answered = 0;
        let status = loop {
            if send.send(request.clone()).await.is_err() {
                break answers.message().await.unwrap_err();
            }
            match answers.message().await {
                Ok(answer) => answered += u32::from(answer.is_some()),
                Err(status) => break status,
            }
        };
        assert_eq!(refusal(&status), refused(Code::Unavailable, "STOPPING", ""));
        if answered > 0 {
            break server;
        }
        // The machine is so busy that the connection reached its age before its first message; try
        // a longer age.
        age *= 4;
        assert!(age < Duration::from_secs(100), "no message was answered");
    };
    // A call that waits on a closing connection is not sent: tonic's client reports it as
    // cancelled, and the caller has to call again.
    for call in 0.. {
        match server.contacts().query_contacts(request.clone()).await {
            Ok(_) => break,
            Err(status) => assert!(status.code() == Code::Cancelled && call < 10, "{status}"),
        }
    }
}

/// Catches a Unix socket that is not served, that is left behind after the stop, or that the
/// leftover of a killed server blocks.
#[tokio::test(flavor = "multi_thread")]
async fn unix_sockets_and_several_addresses() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("socket");
    drop(std::os::unix::net::UnixListener::bind(&path).unwrap());
    assert!(path.exists(), "the file of the socket is gone");
    let unix = Listener::bind(&format!("unix:{}", path.display())).await.unwrap();
    assert_eq!(unix.to_string(), format!("unix:{}", path.display()));
    let taken = Listener::bind(&format!("unix:{}", path.display())).await;
    assert!(taken.is_err(), "the socket of a living server was taken");

    let tcp = Listener::bind("127.0.0.1:0").await.unwrap();
    let address = tcp.to_string();
    assert!(Listener::bind(&address).await.unwrap_err().to_string().contains(&address));
    let app = App::new(blobs::open("memory://").unwrap(), Limits::default(), 1).unwrap();
    let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
    let running = tokio::spawn(run(vec![unix, tcp], Arc::new(app), ServerOptions::default(), async {
        let _ = stopped.await;
        Duration::ZERO
    }));
    for channel in [crate::support::channel(&address).await, unix_channel(&path).await] {
        let mut info = hullcast::proto::server_service_client::ServerServiceClient::new(channel);
        info.get_server_info(GetServerInfoRequest {}).await.unwrap();
    }
    stop.send(()).unwrap();
    running.await.unwrap().unwrap();
    assert!(!path.exists());
}

async fn unix_channel(path: &Path) -> tonic::transport::Channel {
    let endpoint = tonic::transport::Endpoint::from_shared(format!("unix:{}", path.display())).unwrap();
    endpoint.connect().await.unwrap()
}
