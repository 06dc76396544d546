//! A new server for every test, clients of it, and requests for it.

#[allow(dead_code, reason = "shared with the tests of faults")]
pub(crate) mod process;
pub(crate) mod raw;
pub(crate) mod scenes;
pub(crate) mod store;

use std::{sync::Arc, time::Duration};

use hullcast::{
    budget::Part,
    proto::{
        contact_service_client::ContactServiceClient, hull_service_client::HullServiceClient,
        server_service_client::ServerServiceClient,
    },
    service::{App, Limits, Listener, ServerOptions, run},
    store::{BlobStore, blobs},
};
use tokio::{sync::oneshot, task::JoinHandle};
use tonic::{Code, Status, transport::Channel};
use tonic_types::StatusExt;

/// The real server, in this process, on a free port.
pub(crate) struct TestServer {
    pub(crate) app: Arc<App>,
    pub(crate) address: String,
    channel: Channel,
    stop: Option<oneshot::Sender<()>>,
    running: JoinHandle<()>,
}

pub(crate) struct Setup {
    pub(crate) store: Arc<dyn BlobStore>,
    pub(crate) limits: Limits,
    pub(crate) threads: usize,
    pub(crate) options: ServerOptions,
    pub(crate) grace: Duration,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            store: blobs::open("memory://").unwrap(),
            limits: Limits::default(),
            threads: 2,
            options: ServerOptions::default(),
            grace: Duration::ZERO,
        }
    }
}

impl Setup {
    pub(crate) async fn start(self) -> TestServer {
        let mut server = self.start_lazily().await;
        server.channel = channel(&server.address).await;
        // The kernel accepts connections before the server is ready.
        while !server.app.readiness().accepts_calls() {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        server
    }

    /// Starts the server without connecting a client to it.
    pub(crate) async fn start_lazily(self) -> TestServer {
        let app = Arc::new(App::new(self.store, self.limits, self.threads).unwrap());
        let listener = Listener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.to_string();
        let (stop, stopped) = oneshot::channel();
        let server = run(vec![listener], app.clone(), self.options, async move {
            let _ = stopped.await;
            self.grace
        });
        let running = tokio::spawn(async { server.await.unwrap() });
        let channel = Channel::from_shared(format!("http://{address}")).unwrap().connect_lazy();
        TestServer { app, address, channel, stop: Some(stop), running }
    }
}

/// A new connection.
pub(crate) async fn channel(address: &str) -> Channel {
    Channel::from_shared(format!("http://{address}")).unwrap().connect().await.unwrap()
}

impl TestServer {
    pub(crate) async fn start() -> Self {
        Setup::default().start().await
    }

    pub(crate) async fn with_limits(limits: Limits) -> Self {
        Setup { limits, ..Setup::default() }.start().await
    }

    pub(crate) fn channel(&self) -> Channel {
        self.channel.clone()
    }

    pub(crate) fn contacts(&self) -> ContactServiceClient<Channel> {
        ContactServiceClient::new(self.channel()).max_decoding_message_size(usize::MAX)
    }

    pub(crate) fn hulls(&self) -> HullServiceClient<Channel> {
        HullServiceClient::new(self.channel()).max_decoding_message_size(usize::MAX)
    }

    pub(crate) fn info(&self) -> ServerServiceClient<Channel> {
        ServerServiceClient::new(self.channel())
    }

    /// Tells the server to stop, without waiting for it.
    pub(crate) fn begin_stop(&mut self) {
        self.stop.take().unwrap().send(()).unwrap();
    }

    /// The value of the only line of the metrics that begins with `name` and a space.
    pub(crate) fn metric(&self, name: &str) -> f64 {
        let text = self.app.metrics_text();
        let values: Vec<_> = text.lines().filter_map(|l| l.strip_prefix(name)?.strip_prefix(' ')).collect();
        assert_eq!(values.len(), 1, "{name} in {text}");
        values[0].parse().unwrap()
    }

    /// Waits until a metric has this value.
    pub(crate) async fn until(&self, name: &str, value: f64) {
        while self.metric(name) != value {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    /// Waits until no call holds memory of the budget. The memory of open connections is not counted.
    pub(crate) async fn until_calls_hold_nothing(&self) {
        let memory = self.app.memory();
        while memory.used() > memory.used_by(Part::Connections) {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    /// Waits until the server has stopped.
    pub(crate) async fn stopped(self) {
        self.running.await.unwrap();
    }
}

/// An error as a client must be able to read it: code, reason, and field with index.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Refusal {
    pub(crate) code: Code,
    pub(crate) reason: String,
    pub(crate) field: String,
}

/// The error in `status`. Every error must have an `ErrorInfo` of the domain `hullcast`.
pub(crate) fn refusal(status: &Status) -> Refusal {
    let details = status.get_error_details();
    let info = details.error_info().unwrap_or_else(|| panic!("no ErrorInfo in {status:?}"));
    assert_eq!(info.domain, "hullcast");
    let mut field = info.metadata.get("field").cloned().unwrap_or_default();
    if let Some(index) = info.metadata.get("index") {
        field = format!("{field}[{index}]");
    }
    if status.code() == Code::InvalidArgument && !field.is_empty() {
        let violations = &details.bad_request().expect("BadRequest details").field_violations;
        assert_eq!(violations.len(), 1);
        assert_eq!(violations[0].field, field);
    }
    Refusal { code: status.code(), reason: info.reason.clone(), field }
}

pub(crate) fn refused(code: Code, reason: &str, field: &str) -> Refusal {
    Refusal { code, reason: reason.into(), field: field.into() }
}

pub(crate) fn invalid(reason: &str, field: &str) -> Refusal {
    refused(Code::InvalidArgument, reason, field)
}
