//! Connections that work, and the causes of those that do not.

use hullcast_client::{Cause, Client, Error};
use tokio::io::AsyncWriteExt;
use tokio::net::TcpListener;

use crate::{
    security::{Authority, mutual, setup, write},
    support::TestServer,
};

/// The cause for which a connection cannot be made. The text has to name the address.
async fn cause(client: hullcast_client::Builder, address: &str) -> Cause {
    match client.connect().await {
        Err(Error::Unreachable(why)) => {
            assert_eq!(why.address, address);
            assert!(why.to_string().contains(address), "{why}");
            why.cause
        }
        other => panic!("{address}: {other:?}"),
    }
}

async fn cause_at(address: &str) -> Cause {
    cause(Client::builder(address), address).await
}

/// Catches a caller who is not told that the server is absent or that the peer is of another kind, or who is
/// told another cause.
#[tokio::test(flavor = "multi_thread")]
async fn the_cause_of_a_failed_connection_is_named() {
    let closed = TcpListener::bind("127.0.0.1:0").await.unwrap().local_addr().unwrap().to_string();
    let silent = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let web = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let (at_silent, at_web) = [&silent, &web].map(|peer| peer.local_addr().unwrap().to_string()).into();
    tokio::spawn(async move {
        while let Ok((mut stream, _)) = web.accept().await {
            let _ = stream.write_all(b"HTTP/1.1 400 Bad Request\r\n\r\n").await;
        }
    });
    let server = TestServer::start().await;
    let encrypted = format!("https://{}", server.address);
    let found = tokio::join!(
        cause_at(&closed),
        cause_at("unix:/nonexistent/socket"),
        cause_at(&at_silent),
        cause_at(&at_web),
        cause_at(&encrypted),
    );
    let expected = (Cause::Refused, Cause::NoSocket, Cause::Silent, Cause::NotHttp2, Cause::NotTls);
    assert_eq!(found, expected);
    drop(silent);
}

/// Catches a certificate that is refused although its authority is trusted, and a certificate that is
/// accepted, or refused with the wrong remedy, although it is not.
#[tokio::test(flavor = "multi_thread")]
async fn certificates_are_trusted_by_their_authority() {
    let (authority, stranger) = (Authority::new(), Authority::new());
    let directory = tempfile::tempdir().unwrap();
    let server = setup(&write(directory.path(), &authority.sign())).0.start_lazily().await;
    let port = server.address.rsplit_once(':').unwrap().1;
    let address = format!("https://localhost:{port}");
    let trusting =
        |authority: &Authority| Client::builder(address.as_str()).authority(authority.certificate.pem());
    trusting(&authority).connect().await.unwrap().info().await.unwrap();
    // The two authorities have the same name, so TLS names the signature as the fault.
    let untrusted = cause(trusting(&stranger), &address).await;
    assert!(matches!(untrusted, Cause::Untrusted(_)), "{untrusted:?}");
    let other_name = format!("https://127.0.0.1:{port}");
    let builder = Client::builder(other_name.as_str()).authority(authority.certificate.pem());
    assert_eq!(cause(builder, &other_name).await, Cause::OtherName);
    let plain = format!("localhost:{port}");
    assert_eq!(cause_at(&plain).await, Cause::SpeaksTls);
}

/// Catches a self-signed certificate that is refused although it was given, and another one that is accepted
/// or not explained.
#[tokio::test(flavor = "multi_thread")]
async fn a_self_signed_certificate_is_trusted_if_it_is_given() {
    let [own, other] = [(); 2].map(|()| Authority::new());
    let directory = tempfile::tempdir().unwrap();
    let files = write(directory.path(), &own.itself());
    let server = setup(&files).0.start_lazily().await;
    let address = format!("https://localhost:{}", server.address.rsplit_once(':').unwrap().1);
    let trusting =
        |authority: &Authority| Client::builder(address.as_str()).authority(authority.certificate.pem());
    trusting(&own).connect().await.unwrap().info().await.unwrap();
    assert_eq!(cause(trusting(&other), &address).await, Cause::SelfSigned);
}

/// Catches a client's certificate that does not reach the server.
#[tokio::test(flavor = "multi_thread")]
async fn a_clients_certificate_admits_it() {
    let (authority, clients) = (Authority::new(), Authority::new());
    let directory = tempfile::tempdir().unwrap();
    let files = mutual(directory.path(), &authority, &clients);
    let server = setup(&files).0.start_lazily().await;
    let address = format!("https://localhost:{}", server.address.rsplit_once(':').unwrap().1);
    let trusting = || Client::builder(address.as_str()).authority(authority.certificate.pem()).retries(false);
    let (certificate, key) = clients.sign();
    trusting().identity(certificate, key).connect().await.unwrap().info().await.unwrap();
    let without = async { trusting().connect().await?.info().await };
    assert!(without.await.is_err());
}

/// Catches a token that is not sent, and a refusal whose code and reason the caller cannot read.
#[tokio::test(flavor = "multi_thread")]
async fn the_token_is_sent_with_every_call() {
    let directory = tempfile::tempdir().unwrap();
    let [readers, writers] = ["reader", "writer"].map(|name| {
        let path = directory.path().join(name);
        std::fs::write(&path, format!("{name}\n")).unwrap();
        path
    });
    let files = hullcast::service::SecurityFiles {
        query_tokens: readers,
        register_tokens: writers,
        ..hullcast::service::SecurityFiles::default()
    };
    let server = setup(&files).0.start_lazily().await;
    let cube = super::hulls(&crate::support::scenes::shapes()[..1]);
    let client = async |token: Option<&str>| {
        let builder = super::builder(&server);
        let builder = match token {
            Some(token) => builder.token(token),
            None => builder,
        };
        builder.connect().await.unwrap()
    };
    for (token, reason) in
        [(None, "MISSING_TOKEN"), (Some("stranger"), "UNKNOWN_TOKEN"), (Some("reader"), "TOKEN_MAY_NOT")]
    {
        match client(token).await.register(&cube).await {
            Err(Error::Refused(refusal)) => assert_eq!(refusal.reason, reason),
            other => panic!("{other:?}"),
        }
    }
    client(Some("writer")).await.register(&cube).await.unwrap();
    client(Some("reader")).await.register(&cube).await.expect("a hull that is there needs no registration");
}
