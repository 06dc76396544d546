//! The connection to the server that a subcommand uses: address, TLS and the caller's token.

use std::error::Error as StdError;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use tonic::metadata::{Ascii, MetadataValue};
use tonic::service::Interceptor;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::{Channel, ClientTlsConfig, Endpoint, Identity};
use tonic::{Request, Status};

use super::exit::Exit;
use super::trust::Trust;
use super::{Error, reach};
use hullcast::proto::GetServerInfoRequest;
use hullcast::proto::contact_service_client::ContactServiceClient;
use hullcast::proto::hull_service_client::HullServiceClient;
use hullcast::proto::server_service_client::ServerServiceClient;
use hullcast::small_file;

/// Largest message in either direction, so large that only the server's limits matter.
const MAX_MESSAGE_BYTES: usize = 2 << 30;
/// Window of HTTP/2 flow control, into which a batch of some thousand pairs fits.
const WINDOW_BYTES: u32 = 8 << 20;
/// Time after which an attempt to connect is given up, because an unreachable server sends nothing.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
/// Interval and timeout of keep-alive pings. A call in progress notices a lost server after twice this
/// time.
const KEEP_ALIVE: Duration = Duration::from_secs(10);

/// The options for querying a server instead of this process.
#[derive(clap::Args, Clone, Debug, Default)]
#[command(next_help_heading = "Who answers")]
pub(crate) struct RemoteArgs {
    /// Send the queries to this server instead of this process: host:port, unix:PATH, http://host:port or
    /// https://host:port. The port is 50051 if the address has none [default: this process].
    #[arg(long, value_name = "ADDRESS", value_parser = reach::addresses)]
    pub(crate) remote: Option<String>,
    /// PEM file of the authorities that may have signed the server's certificate, or of a self-signed
    /// certificate [default: the system's authorities].
    #[arg(long, value_name = "FILE", requires = "remote")]
    tls_ca: Option<PathBuf>,
    /// PEM file of this client's certificate, for a server that asks for one [default: none].
    #[arg(long, value_name = "FILE", requires = "tls_key")]
    tls_certificate: Option<PathBuf>,
    /// PEM file of the private key of this client's certificate [default: none].
    #[arg(long, value_name = "FILE", requires = "tls_certificate")]
    tls_key: Option<PathBuf>,
    /// File whose first line is the token to send [default: no token].
    #[arg(long, value_name = "FILE", requires = "remote")]
    token_file: Option<PathBuf>,
}

/// A connection to a server.
#[derive(Clone, Debug)]
pub(crate) struct Connection(InterceptedService<Channel, Token>);

impl Connection {
    /// Opens a new connection to the server at `address`.
    ///
    /// # Errors
    /// No server answers at the address, or a file cannot be read.
    pub(crate) async fn open(address: &str, args: &RemoteArgs) -> Result<Self, Error> {
        let url = reach::url(address)?;
        let token = args.token()?;
        let mut endpoint = Endpoint::from_shared(url.clone())?
            .initial_stream_window_size(WINDOW_BYTES)
            .initial_connection_window_size(WINDOW_BYTES)
            .connect_timeout(CONNECT_TIMEOUT)
            .http2_keep_alive_interval(KEEP_ALIVE)
            .keep_alive_timeout(KEEP_ALIVE)
            .tcp_nodelay(true);
        if url.starts_with("https://") {
            endpoint = args.encrypted(endpoint)?;
        } else if args.tls_ca.is_some() {
            let host = url.trim_start_matches("http://");
            return Err(Exit::Usage.error(format!(
                "--tls-ca is for encrypted connections, and {address} is not one: write https://{host}, or leave \
                 --tls-ca out"
            )));
        }
        let channel = match endpoint.connect().await {
            Ok(channel) => channel,
            Err(error) => return Err(Exit::Unreachable.error(reach::failed(address, &url, &error).await)),
        };
        let connection = Self(InterceptedService::new(channel, token));
        // Without TLS, a connection counts as open before the server has sent anything.
        let mut server = ServerServiceClient::new(connection.0.clone());
        let asked = server.get_server_info(GetServerInfoRequest {});
        let Ok(answered) = tokio::time::timeout(CONNECT_TIMEOUT, asked).await else {
            // A server that is only busy answers the beginning of HTTP/2 at once.
            let late = Status::deadline_exceeded("no answer");
            return match reach::mismatch(address, &url, &late).await {
                Some(text) => Err(Exit::Unreachable.error(text)),
                None => Ok(connection),
            };
        };
        match answered {
            // Only statuses that tonic makes itself have a source, so any other answer shows that a server
            // is there. If a connection merely broke, the next one may work: the call itself will tell.
            Err(status) if status.source().is_some() => match reach::mismatch(address, &url, &status).await {
                Some(text) => Err(Exit::Unreachable.error(text)),
                None => Ok(connection),
            },
            _ => Ok(connection),
        }
    }

    /// A number for the next request, which identifies its answer.
    pub(crate) fn next_request_id() -> u64 {
        static NEXT: AtomicU64 = AtomicU64::new(1);
        // The number contains the process id, so that a proxy cannot mix up the answers of two processes.
        (u64::from(std::process::id()) << 32).wrapping_add(NEXT.fetch_add(1, Ordering::Relaxed))
    }

    /// A client for queries on this connection.
    pub(crate) fn contacts(&self) -> ContactServiceClient<InterceptedService<Channel, Token>> {
        ContactServiceClient::new(self.0.clone())
            .max_decoding_message_size(MAX_MESSAGE_BYTES)
            .max_encoding_message_size(MAX_MESSAGE_BYTES)
    }

    /// A client for registrations on this connection.
    pub(crate) fn hulls(&self) -> HullServiceClient<InterceptedService<Channel, Token>> {
        HullServiceClient::new(self.0.clone())
            .max_decoding_message_size(MAX_MESSAGE_BYTES)
            .max_encoding_message_size(MAX_MESSAGE_BYTES)
    }
}

impl RemoteArgs {
    /// The endpoint, with TLS if the arguments ask for it.
    fn encrypted(&self, endpoint: Endpoint) -> Result<Endpoint, Error> {
        let mut tls = ClientTlsConfig::new();
        if let (Some(certificate), Some(key)) = (&self.tls_certificate, &self.tls_key) {
            let certificate = pem("--tls-certificate", certificate)?;
            tls = tls.identity(Identity::from_pem(certificate, pem("--tls-key", key)?));
        }
        let Some(path) = &self.tls_ca else { return Ok(endpoint.tls_config(tls.with_native_roots())?) };
        let trust = Trust::new(&pem("--tls-ca", path)?)
            .map_err(|why| Exit::Input.error(format!("--tls-ca {}: {why}", path.display())))?;
        Ok(endpoint.tls_config_with_verifier(tls, Arc::new(trust))?)
    }

    fn token(&self) -> Result<Token, Error> {
        let Some(path) = &self.token_file else { return Ok(Token(None)) };
        let text = String::from_utf8_lossy(&read("--token-file", path)?).into_owned();
        let token = text.lines().next().unwrap_or_default().trim();
        if token.is_empty() || !token.bytes().all(|byte| byte.is_ascii_graphic()) {
            let path = path.display();
            let rule = "the first line is the token: one or more visible ASCII characters";
            return Err(Exit::Input.error(format!("--token-file {path}: {rule}")));
        }
        Ok(Token(Some(format!("Bearer {token}").parse()?)))
    }
}

fn read(option: &str, path: &Path) -> Result<Vec<u8>, Error> {
    small_file::read(path)
        .map_err(|error| Exit::Input.error(format!("{option} {}: cannot be read: {error}", path.display())))
}

/// The content of a PEM file. Fails if it has no PEM block, since TLS would ignore such a file.
fn pem(option: &str, path: &Path) -> Result<Vec<u8>, Error> {
    let content = read(option, path)?;
    if content.windows(11).any(|bytes| bytes == b"-----BEGIN ") {
        return Ok(content);
    }
    let path = path.display();
    Err(Exit::Input.error(format!("{option} {path}: not a PEM file (it has no line -----BEGIN ...-----)")))
}

/// The token that is sent with every call, if there is one.
#[derive(Clone, Debug)]
pub(crate) struct Token(Option<MetadataValue<Ascii>>);

impl Interceptor for Token {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Token(Some(token)) = self {
            request.metadata_mut().insert("authorization", token.clone());
        }
        Ok(request)
    }
}

/// The innermost cause of an error. If the failure is tonic's own, its message says less than the cause.
pub(crate) fn root_cause(error: &(dyn StdError + 'static)) -> String {
    let mut cause = error;
    while let Some(next) = cause.source() {
        cause = next;
    }
    cause.to_string()
}
