//! TLS and tokens, tested over real connections.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use hullcast::{
    proto::{
        DeleteHullsRequest, GetServerInfoRequest, HasHullsRequest, QueryContactsRequest,
        hull_service_client::HullServiceClient, server_service_client::ServerServiceClient,
    },
    service::{Security, SecurityFiles, ServerOptions},
};
use rcgen::{BasicConstraints, Certificate, CertificateParams, IsCa, Issuer, KeyPair};
use tonic::{
    Code, Request, Status,
    transport::{Channel, ClientTlsConfig, Endpoint, Identity},
};
use tonic_health::pb::{HealthCheckRequest, health_client::HealthClient};

use crate::support::{
    Setup, TestServer, refusal, refused,
    scenes::{register_request, two_boxes},
};

/// A certificate authority that signs certificates for localhost.
pub(crate) struct Authority {
    pub(crate) certificate: Certificate,
    issuer: Issuer<'static, KeyPair>,
}

impl Authority {
    pub(crate) fn new() -> Self {
        let mut params = CertificateParams::new(["localhost".to_owned()]).unwrap();
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        let key = KeyPair::generate().unwrap();
        let certificate = params.self_signed(&key).unwrap();
        Self { certificate, issuer: Issuer::new(params, key) }
    }

    fn pem(&self) -> tonic::transport::Certificate {
        tonic::transport::Certificate::from_pem(self.certificate.pem())
    }

    /// The authority's own certificate, which names localhost too, and its key, as PEM.
    pub(crate) fn itself(&self) -> (String, String) {
        (self.certificate.pem(), self.issuer.key().serialize_pem())
    }

    /// A new certificate and its key, as PEM.
    pub(crate) fn sign(&self) -> (String, String) {
        let key = KeyPair::generate().unwrap();
        let params = CertificateParams::new(["localhost".to_owned()]).unwrap();
        (params.signed_by(&key, &self.issuer).unwrap().pem(), key.serialize_pem())
    }
}

pub(crate) fn write(directory: &Path, (certificate, key): &(String, String)) -> SecurityFiles {
    let files = SecurityFiles {
        tls_certificate: directory.join("certificate.pem"),
        tls_key: directory.join("key.pem"),
        ..SecurityFiles::default()
    };
    std::fs::write(&files.tls_certificate, certificate).unwrap();
    std::fs::write(&files.tls_key, key).unwrap();
    files
}

/// The files of a server of `authority` that admits only clients of the authority `clients`.
pub(crate) fn mutual(directory: &Path, authority: &Authority, clients: &Authority) -> SecurityFiles {
    let mut files = write(directory, &authority.sign());
    files.tls_client_ca = directory.join("clients.pem");
    std::fs::write(&files.tls_client_ca, clients.certificate.pem()).unwrap();
    files
}

pub(crate) fn setup(files: &SecurityFiles) -> (Setup, Arc<Security>) {
    let security = Arc::new(Security::open(files).unwrap());
    let options = ServerOptions { security: security.clone(), ..ServerOptions::default() };
    (Setup { options, ..Setup::default() }, security)
}

/// Whether a call succeeds with this TLS configuration of the client.
async fn reaches(server: &TestServer, tls: ClientTlsConfig) -> bool {
    let endpoint = Endpoint::from_shared(format!("https://{}", server.address)).unwrap();
    let endpoint = endpoint.tls_config(tls.domain_name("localhost")).unwrap();
    let Ok(channel) = endpoint.connect().await else { return false };
    ServerServiceClient::new(channel).get_server_info(GetServerInfoRequest {}).await.is_ok()
}

/// Catches a server that also answers in plain text on a TLS port, and a certificate of an unknown
/// authority that a client accepts.
#[tokio::test(flavor = "multi_thread")]
async fn tls_is_spoken_and_nothing_else() {
    let (authority, stranger) = (Authority::new(), Authority::new());
    let directory = tempfile::tempdir().unwrap();
    let (setup, _) = setup(&write(directory.path(), &authority.sign()));
    let server = setup.start_lazily().await;
    let trusting = |authority: &Authority| ClientTlsConfig::new().ca_certificate(authority.pem());
    assert!(reaches(&server, trusting(&authority)).await);
    assert!(!reaches(&server, trusting(&stranger)).await);
    let plain = Endpoint::from_shared(format!("http://{}", server.address)).unwrap();
    let answered = async {
        let channel = plain.connect().await.ok()?;
        ServerServiceClient::new(channel).get_server_info(GetServerInfoRequest {}).await.ok()
    };
    assert!(answered.await.is_none());
}

/// Catches mutual TLS that admits a client without a certificate, or with one of another authority.
#[tokio::test(flavor = "multi_thread")]
async fn mutual_tls_asks_for_a_certificate_of_its_authority() {
    let (authority, clients) = (Authority::new(), Authority::new());
    let directory = tempfile::tempdir().unwrap();
    let files = mutual(directory.path(), &authority, &clients);
    let server = setup(&files).0.start_lazily().await;
    let trusting = || ClientTlsConfig::new().ca_certificate(authority.pem());
    let with =
        |(certificate, key): (String, String)| trusting().identity(Identity::from_pem(certificate, key));
    assert!(reaches(&server, with(clients.sign())).await);
    assert!(!reaches(&server, with(authority.sign())).await);
    assert!(!reaches(&server, trusting()).await);
}

/// Catches a new certificate that needs a restart, and a half-written one that replaces the old
/// one.
#[tokio::test(flavor = "multi_thread")]
async fn certificates_change_under_the_server() {
    let [old, new] = [(); 2].map(|()| Authority::new());
    let directory = tempfile::tempdir().unwrap();
    let (setup, security) = setup(&write(directory.path(), &old.sign()));
    let server = setup.start_lazily().await;
    let reached = async || {
        let mut reached = [false; 2];
        for (reached, authority) in reached.iter_mut().zip([&old, &new]) {
            *reached = reaches(&server, ClientTlsConfig::new().ca_certificate(authority.pem())).await;
        }
        reached
    };
    assert_eq!(reached().await, [true, false]);
    let (certificate, key) = new.sign();
    // The key does not belong to the certificate, as between the writes of the two files.
    let files = write(directory.path(), &(certificate.clone(), old.sign().1));
    security.reload();
    assert_eq!(reached().await, [true, false]);
    std::fs::write(&files.tls_key, key).unwrap();
    security.reload();
    assert_eq!(reached().await, [false, true]);
}

/// Catches an incomplete configuration that is only noticed when the first client connects.
#[test]
fn half_a_configuration_does_not_open() {
    let directory = tempfile::tempdir().unwrap();
    let whole = write(directory.path(), &Authority::new().sign());
    assert!(Security::open(&whole).unwrap().encrypts());
    let none = SecurityFiles::default();
    assert!(!Security::open(&none).unwrap().encrypts());
    let spoilt = [
        SecurityFiles { tls_key: PathBuf::new(), ..whole.clone() },
        SecurityFiles { tls_certificate: PathBuf::new(), ..whole.clone() },
        SecurityFiles { tls_client_ca: whole.tls_key.clone(), ..whole.clone() },
        SecurityFiles { tls_client_ca: whole.tls_certificate.clone(), ..none.clone() },
        SecurityFiles { tls_certificate: whole.tls_key.clone(), ..whole.clone() },
        SecurityFiles { query_tokens: directory.path().join("none"), ..none },
    ];
    for files in spoilt {
        assert!(Security::open(&files).is_err(), "{files:?}");
    }
}

/// A call of the hull service with this token.
async fn with_token<M, A>(
    channel: Channel,
    token: Option<&str>,
    message: M,
    call: impl AsyncFnOnce(HullServiceClient<Channel>, Request<M>) -> Result<A, Status>,
) -> Result<(), Status> {
    let mut request = Request::new(message);
    if let Some(token) = token {
        request.metadata_mut().insert("authorization", format!("Bearer {token}").parse().unwrap());
    }
    call(HullServiceClient::new(channel), request).await.map(|_| ())
}

/// Catches a method that is not guarded, or guarded by the wrong list, and a health check that
/// requires a token from a load balancer.
#[tokio::test(flavor = "multi_thread")]
async fn tokens_guard_every_method() {
    let directory = tempfile::tempdir().unwrap();
    let files = SecurityFiles {
        query_tokens: directory.path().join("query"),
        register_tokens: directory.path().join("register"),
        ..SecurityFiles::default()
    };
    std::fs::write(&files.query_tokens, "reader").unwrap();
    std::fs::write(&files.register_tokens, "writer").unwrap();
    let (mut setup, _) = setup(&files);
    setup.options.reload_every = Duration::from_millis(10);
    let server = setup.start().await;
    let (shapes, _) = two_boxes();
    let outcome = |result: Result<(), Status>| match result {
        Ok(()) => String::new(),
        Err(status) => refusal(&status).reason,
    };
    let mut said = Vec::new();
    for token in [Some("writer"), Some("reader"), Some("nobody"), None] {
        let register = with_token(server.channel(), token, register_request(&shapes), async |mut c, r| {
            c.register_hulls(r).await
        });
        let has = with_token(server.channel(), token, HasHullsRequest::default(), async |mut c, r| {
            c.has_hulls(r).await
        });
        let delete = with_token(server.channel(), token, DeleteHullsRequest::default(), async |mut c, r| {
            c.delete_hulls(r).await
        });
        said.push([outcome(register.await), outcome(has.await), outcome(delete.await)]);
    }
    let unknown = ["UNKNOWN_TOKEN"; 3];
    assert_eq!(said, [[""; 3], ["TOKEN_MAY_NOT", "", "TOKEN_MAY_NOT"], unknown, ["MISSING_TOKEN"; 3]]);

    // All other methods, and unknown ones, require a token too; a stream is refused at once.
    let mut contacts = server.contacts();
    let status = contacts.query_contacts(QueryContactsRequest::default()).await.unwrap_err();
    assert_eq!(refusal(&status), refused(Code::Unauthenticated, "MISSING_TOKEN", ""));
    let status = contacts.stream_contacts(futures_util::stream::pending()).await.unwrap_err();
    assert_eq!(refusal(&status), refused(Code::Unauthenticated, "MISSING_TOKEN", ""));
    let status = server.info().get_server_info(GetServerInfoRequest {}).await.unwrap_err();
    assert_eq!(status.code(), Code::Unauthenticated);
    HealthClient::new(server.channel()).check(HealthCheckRequest::default()).await.unwrap();

    // The tokens are rotated: the server reads the file again by itself.
    std::fs::write(&files.query_tokens, "reader\nsuccessor").unwrap();
    let mut tries = 0;
    loop {
        let has =
            with_token(server.channel(), Some("successor"), HasHullsRequest::default(), async |mut c, r| {
                c.has_hulls(r).await
            });
        match has.await {
            Ok(()) => break,
            Err(status) => assert_eq!(refusal(&status).reason, "UNKNOWN_TOKEN"),
        }
        tries += 1;
        assert!(tries < 1000, "the file of tokens was never read again");
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
}
