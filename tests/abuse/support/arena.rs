//! The server under attack, with connections for the attacker and for the bystander.

use std::{
    io,
    sync::{
        Arc, Mutex,
        atomic::{AtomicUsize, Ordering},
    },
    time::Duration,
};

use hullcast::{
    proto::{contact_service_client::ContactServiceClient, hull_service_client::HullServiceClient},
    store::HullDefinition,
};
use tonic::transport::Channel;

use super::{
    bystander::{Bystander, Working, with_token},
    dial::{self, Stream},
    http2::{Peer, Windows},
    server::{Server, status_bytes},
    setup::{Setup, Size},
};
use crate::scenes::{id, register_request};

/// The loopback addresses of the attacker and of the bystander.
pub(crate) const ATTACKER: &str = "127.0.0.2";
pub(crate) const BYSTANDER: &str = "127.0.0.3";

/// The server, and the means of the attacker and the bystander to reach it.
pub(crate) struct Arena {
    pub(crate) setup: Setup,
    pub(crate) server: Server,
    pub(crate) bystander: Bystander,
    begun: Mutex<Option<Begun>>,
}

/// The bystander's work and the idle state of the server, as of the beginning of the attack.
pub(crate) struct Begun {
    pub(crate) working: Working,
    pub(crate) idle_bytes: u64,
    pub(crate) idle_parts: Vec<String>,
}

impl Arena {
    pub(crate) async fn new(setup: Setup) -> Self {
        let server = Server::start(&setup);
        let channel = dial::channel(BYSTANDER, server.address, server.certificate.clone()).await;
        let bystander = Bystander::new(channel).await;
        Self { setup, server, bystander, begun: Mutex::default() }
    }

    pub(crate) fn size(&self) -> Size {
        self.setup.size
    }

    /// Begins the attack: records the current state as the idle state and starts the bystander's work.
    pub(crate) async fn begin(&self) {
        let idle_parts = parts(&self.server.metrics().await);
        let idle_bytes = status_bytes(self.server.pid(), "VmRSS");
        let working = self.bystander.start();
        let begun = Begun { working, idle_bytes, idle_parts };
        let before = self.begun.lock().expect("no panic").replace(begun);
        assert!(before.is_none(), "an attack begins once");
    }

    pub(crate) fn take_begun(&self) -> Begun {
        self.begun.lock().expect("no panic").take().expect("the attack calls Arena::begin")
    }

    fn answered(&self) -> Arc<AtomicUsize> {
        self.begun.lock().expect("no panic").as_ref().expect("the attack has begun").working.answered()
    }

    /// Waits until the bystander's next `count` queries are answered.
    pub(crate) async fn bystander_answered(&self, count: usize) {
        let answered = self.answered();
        let until = answered.load(Ordering::SeqCst) + count;
        while answered.load(Ordering::SeqCst) < until {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    /// Opens a connection for the attacker, of the kind that the setup asks for: Unix socket, TLS or TCP.
    pub(crate) async fn stream(&self) -> io::Result<Box<dyn Stream>> {
        match &self.server.certificate {
            _ if self.setup.over_unix => dial::unix(&self.server.socket).await,
            None => Ok(Box::new(dial::tcp(ATTACKER, self.server.address).await?)),
            Some(certificate) => dial::tls(ATTACKER, self.server.address, certificate).await,
        }
    }

    /// Opens an HTTP/2 connection for the attacker, which lets the server send as much as `windows` allows.
    pub(crate) async fn peer(&self, windows: Windows) -> io::Result<Peer> {
        Peer::open(self.stream().await?, windows).await
    }

    /// Opens an ordinary gRPC channel from the attacker's address.
    pub(crate) async fn channel(&self) -> Channel {
        dial::channel(ATTACKER, self.server.address, self.server.certificate.clone()).await
    }

    pub(crate) async fn contacts(&self) -> ContactServiceClient<Channel> {
        ContactServiceClient::new(self.channel().await).max_decoding_message_size(usize::MAX)
    }

    pub(crate) async fn hulls(&self) -> HullServiceClient<Channel> {
        HullServiceClient::new(self.channel().await).max_decoding_message_size(usize::MAX)
    }

    /// Registers hulls from the attacker's address, one per call, and returns their ids.
    pub(crate) async fn register(&self, shapes: &[HullDefinition]) -> Vec<Vec<u8>> {
        let mut hulls = self.hulls().await;
        for shape in shapes {
            let request = with_token(register_request(std::slice::from_ref(shape)));
            let answer = hulls.register_hulls(request).await.expect("a hull").into_inner();
            let result = answer.results.into_iter().next().and_then(|result| result.result);
            assert!(
                matches!(result, Some(hullcast::proto::register_hull_result::Result::Hull(_))),
                "{result:?}"
            );
        }
        shapes.iter().map(id).collect()
    }
}

/// The lines of the metrics that belong to the memory budget.
pub(crate) fn parts(metrics: &str) -> Vec<String> {
    let is_part = |line: &&str| {
        line.starts_with("hullcast_memory_bytes{") || line.starts_with("hullcast_request_bytes_in_flight ")
    };
    metrics.lines().filter(is_part).map(str::to_owned).collect()
}
