//! The connection, and how one call is made: its deadline and its repetitions.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use hullcast_proto::contact_service_client::ContactServiceClient;
use hullcast_proto::hull_service_client::HullServiceClient;
use hullcast_proto::server_service_client::ServerServiceClient;
use hullcast_proto::{GetServerInfoRequest, GetServerInfoResponse, Limits};
use tokio::sync::OnceCell;
use tokio::time::Instant;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Channel;
use tonic::{Request, Response, Status};

use crate::builder::{Builder, Token};
use crate::{Error, Malformed};

/// Largest message in either direction, so large that only the server's limits matter.
const MAX_MESSAGE_BYTES: usize = 2 << 30;
/// The most repetitions of a call whose server was lost.
const MAX_LOSSES: u32 = 5;
/// The pause before the first of these repetitions. It doubles each time.
const FIRST_PAUSE: Duration = Duration::from_millis(100);

/// The transport below the stubs.
pub(crate) type Service = InterceptedService<Channel, Token>;

/// A connection to a server.
///
/// A clone shares the connection, and many calls may be in flight at once. If the connection breaks, the next
/// call connects again.
///
/// A call of a method has one timeout ([`Builder::timeout`]). Unless the builder says otherwise, a call that a
/// busy server refuses is repeated after the time that the server states, and a call whose server was lost is
/// repeated up to five times. Dropping the future of a call cancels it on the server.
#[derive(Clone)]
pub struct Client {
    connection: Arc<Connection>,
}

struct Connection {
    service: Service,
    address: String,
    timeout: Option<Duration>,
    retries: bool,
    limits: OnceCell<Limits>,
}

/// The time at which a call has to be answered; `None` means that it may take any time.
pub(crate) type Deadline = Option<Instant>;

impl Client {
    /// Connects to the server at `address`, with the usual settings: [`Builder`] lists them.
    ///
    /// The address is `host`, `host:port`, `unix:PATH`, `http://host:port` or `https://host:port`. The port
    /// is 50051 if the address has none.
    ///
    /// # Errors
    /// Those of [`Builder::connect`].
    pub async fn connect(address: impl Into<String>) -> Result<Self, Error> {
        Self::builder(address).connect().await
    }

    /// The settings of a connection to the server at `address`.
    pub fn builder(address: impl Into<String>) -> Builder {
        Builder::new(address.into())
    }

    pub(crate) fn new(service: Service, address: String, timeout: Option<Duration>, retries: bool) -> Self {
        let limits = OnceCell::new();
        Self { connection: Arc::new(Connection { service, address, timeout, retries, limits }) }
    }

    /// The address of the server, as it was given.
    pub fn address(&self) -> &str {
        &self.connection.address
    }

    pub(crate) fn service(&self) -> Service {
        self.connection.service.clone()
    }

    /// Whether calls that fail are repeated.
    pub(crate) fn retries(&self) -> bool {
        self.connection.retries
    }

    /// The server's version, its limits and its use of memory.
    ///
    /// # Errors
    /// The server refuses the call, or it is lost.
    pub async fn info(&self) -> Result<GetServerInfoResponse, Error> {
        self.info_by(self.deadline()).await
    }

    pub(crate) async fn info_by(&self, deadline: Deadline) -> Result<GetServerInfoResponse, Error> {
        let info = self
            .call(deadline, &GetServerInfoRequest {}, |request| {
                let mut stub = self.server();
                async move { stub.get_server_info(request).await }
            })
            .await?;
        self.keep_limits(&info);
        Ok(info)
    }

    /// Remembers the limits, by which calls are split.
    pub(crate) fn keep_limits(&self, info: &GetServerInfoResponse) {
        if let Some(limits) = info.limits {
            // The limits of a server do not change while it runs, so the first ones may stay.
            let _ = self.connection.limits.set(limits);
        }
    }

    /// The limits of the server. Asks the server only if they are not known yet.
    pub(crate) async fn limits(&self, deadline: Deadline) -> Result<Limits, Error> {
        if let Some(limits) = self.connection.limits.get() {
            return Ok(*limits);
        }
        self.info_by(deadline).await?.limits.ok_or_else(|| Malformed::new("limits is absent").into())
    }

    /// The time at which a call that begins now has to be answered.
    pub(crate) fn deadline(&self) -> Deadline {
        // If the timeout ends beyond the range of the clock, there is no deadline.
        self.connection.timeout.and_then(|timeout| Instant::now().checked_add(timeout))
    }

    /// A number for the next request, which identifies its answer.
    pub(crate) fn next_request_id() -> u64 {
        static NEXT: AtomicU64 = AtomicU64::new(1);
        // The number contains the process id, so that a proxy cannot mix up the answers of two processes.
        (u64::from(std::process::id()) << 32).wrapping_add(NEXT.fetch_add(1, Ordering::Relaxed))
    }

    /// Sends a message and waits for the answer. Repeats the call as the settings of the connection say.
    pub(crate) async fn call<M: Clone, T, F>(
        &self,
        deadline: Deadline,
        message: &M,
        send: impl Fn(Request<M>) -> F,
    ) -> Result<T, Error>
    where
        F: Future<Output = Result<Response<T>, Status>>,
    {
        self.repeated(deadline, || async { once(deadline, message.clone(), &send).await }).await
    }

    /// Makes attempts until one succeeds, or fails for good, or until the deadline would pass.
    pub(crate) async fn repeated<T, F>(&self, deadline: Deadline, attempt: impl Fn() -> F) -> Result<T, Error>
    where
        F: Future<Output = Result<T, Error>>,
    {
        let mut losses = 0;
        loop {
            let error = match attempt().await {
                Ok(answer) => return Ok(answer),
                Err(error) => error,
            };
            self.wait_to_repeat(deadline, error, &mut losses).await?;
        }
    }

    /// Waits before a call that failed is repeated. `losses` counts the servers that this call has lost.
    ///
    /// # Errors
    /// `error`, if the call is not repeated: for good, or because the deadline would pass.
    pub(crate) async fn wait_to_repeat(
        &self,
        deadline: Deadline,
        error: Error,
        losses: &mut u32,
    ) -> Result<(), Error> {
        let Some(pause) = self.pause_after(&error, losses) else { return Err(error) };
        if deadline.is_some_and(|deadline| Instant::now() + pause >= deadline) {
            return Err(error);
        }
        tokio::time::sleep(pause).await;
        Ok(())
    }

    /// The pause before a call that failed is repeated; `None` if it is not repeated.
    fn pause_after(&self, error: &Error, losses: &mut u32) -> Option<Duration> {
        if !self.retries() {
            return None;
        }
        if let Error::Lost(_) = error {
            *losses += 1;
            return (*losses <= MAX_LOSSES).then(|| FIRST_PAUSE * (1 << (*losses - 1)));
        }
        error.retry_after()
    }

    pub(crate) fn contacts(&self) -> ContactServiceClient<Service> {
        ContactServiceClient::new(self.connection.service.clone())
            .max_decoding_message_size(MAX_MESSAGE_BYTES)
            .max_encoding_message_size(MAX_MESSAGE_BYTES)
    }

    pub(crate) fn hulls(&self) -> HullServiceClient<Service> {
        HullServiceClient::new(self.connection.service.clone())
            .max_decoding_message_size(MAX_MESSAGE_BYTES)
            .max_encoding_message_size(MAX_MESSAGE_BYTES)
    }

    pub(crate) fn server(&self) -> ServerServiceClient<Service> {
        ServerServiceClient::new(self.connection.service.clone())
    }
}

/// One attempt of a call.
pub(crate) async fn once<M, T, F>(
    deadline: Deadline,
    message: M,
    send: impl Fn(Request<M>) -> F,
) -> Result<T, Error>
where
    F: Future<Output = Result<Response<T>, Status>>,
{
    let mut request = Request::new(message);
    if let Some(deadline) = deadline {
        // With this header, the server stops its work at the deadline too.
        request.set_timeout(deadline.saturating_duration_since(Instant::now()));
    }
    Ok(by(deadline, send(request)).await??.into_inner())
}

/// Runs `work`, but no longer than until the deadline.
pub(crate) async fn by<T>(deadline: Deadline, work: impl Future<Output = T>) -> Result<T, Error> {
    match deadline {
        None => Ok(work.await),
        Some(deadline) => tokio::time::timeout_at(deadline, work).await.map_err(|_| Error::TimedOut),
    }
}

impl fmt::Debug for Client {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Client").field("address", &self.address()).finish_non_exhaustive()
    }
}
