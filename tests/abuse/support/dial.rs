//! Connections from chosen loopback addresses.

use std::{io, net::SocketAddr, path::Path, sync::Arc};

use hyper_util::rt::TokioIo;
use tokio::{
    io::{AsyncRead, AsyncWrite},
    net::{TcpSocket, TcpStream, UnixStream},
};
use tokio_rustls::{
    TlsConnector,
    rustls::{
        ClientConfig, RootCertStore,
        pki_types::{CertificateDer, ServerName, pem::PemObject},
    },
};
use tonic::transport::{Channel, Endpoint};

/// A byte stream of any kind.
pub(crate) trait Stream: AsyncRead + AsyncWrite + Send + Unpin {}

impl<T: AsyncRead + AsyncWrite + Send + Unpin> Stream for T {}

/// A TCP connection whose own address is `from`.
pub(crate) async fn tcp(from: &str, to: SocketAddr) -> io::Result<TcpStream> {
    let socket = TcpSocket::new_v4()?;
    // Without reuse, thousands of closed connections would use up the local ports.
    socket.set_reuseaddr(true)?;
    socket.bind(format!("{from}:0").parse().expect("an address"))?;
    let stream = socket.connect(to).await?;
    stream.set_nodelay(true)?;
    Ok(stream)
}

/// A TLS connection whose own address is `from`. `certificate` is the one to trust.
pub(crate) async fn tls(from: &str, to: SocketAddr, certificate: &str) -> io::Result<Box<dyn Stream>> {
    let name = ServerName::try_from("localhost").expect("a name");
    let stream = tcp(from, to).await?;
    Ok(Box::new(TlsConnector::from(trusting(certificate)).connect(name, stream).await?))
}

/// A connection to a Unix socket.
pub(crate) async fn unix(path: &Path) -> io::Result<Box<dyn Stream>> {
    Ok(Box::new(UnixStream::connect(path).await?))
}

fn trusting(certificate: &str) -> Arc<ClientConfig> {
    let mut roots = RootCertStore::empty();
    let certificate = CertificateDer::from_pem_slice(certificate.as_bytes()).expect("a certificate");
    roots.add(certificate).expect("an authority");
    let mut config = ClientConfig::builder().with_root_certificates(roots).with_no_client_auth();
    config.alpn_protocols = vec![b"h2".to_vec()];
    Arc::new(config)
}

/// An ordinary gRPC channel whose connection comes from `from`.
pub(crate) async fn channel(from: &'static str, to: SocketAddr, certificate: Option<String>) -> Channel {
    let connector = tower::service_fn(move |_| {
        let certificate = certificate.clone();
        async move {
            let stream: Box<dyn Stream> = match certificate {
                None => Box::new(tcp(from, to).await?),
                Some(certificate) => tls(from, to, &certificate).await?,
            };
            Ok::<_, io::Error>(TokioIo::new(stream))
        }
    });
    let endpoint = Endpoint::from_static("http://localhost");
    endpoint.connect_with_connector(connector).await.expect("a connection")
}
