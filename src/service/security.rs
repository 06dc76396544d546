//! Decides which clients may connect and make calls, by TLS and by tokens with roles.

mod reloaded;
mod tls;
mod token_lines;
mod tokens;

use std::{path::PathBuf, sync::Arc, thread};

use http::HeaderMap;
pub use reloaded::LoadError;
use tls::Tls;
use tokens::{Role, Tokens};
use tokio::sync::oneshot;
use tokio_rustls::rustls::ServerConfig;

use super::{ServiceError, method::Method};
use crate::{log_limit::limited, proto::methods};

/// The files with certificates, keys and tokens. An empty path stands for no file.
#[derive(Clone, Debug, Default)]
pub struct SecurityFiles {
    /// PEM: the server's certificate, followed by its chain.
    pub tls_certificate: PathBuf,
    /// PEM: the private key of the certificate.
    pub tls_key: PathBuf,
    /// PEM: the authorities that must have signed a client's certificate.
    pub tls_client_ca: PathBuf,
    /// The tokens that may query, one per line.
    pub query_tokens: PathBuf,
    /// The tokens that may also register and delete, one per line.
    pub register_tokens: PathBuf,
}

/// The TLS configuration and the tokens, read from files again while the server runs.
#[derive(Debug, Default)]
pub struct Security {
    tls: Option<Tls>,
    tokens: Option<Tokens>,
}

impl Security {
    /// Reads the files.
    ///
    /// # Errors
    /// A file cannot be read or used, or a file that another one needs is not named.
    pub fn open(files: &SecurityFiles) -> Result<Self, LoadError> {
        Ok(Self { tls: Tls::open(files)?, tokens: Tokens::open(files)? })
    }

    /// Whether TCP connections are encrypted.
    pub fn encrypts(&self) -> bool {
        self.tls.is_some()
    }

    /// Reads changed files. If a file cannot be used, the error is logged and its previous contents
    /// stay in force.
    pub fn reload(&self) {
        if let Some(tls) = &self.tls {
            tls.reload();
        }
        if let Some(tokens) = &self.tokens {
            tokens.reload();
        }
    }

    /// Reads changed files on a thread of its own, because reading blocks. If the system refuses a thread, the
    /// previous contents stay in force until the next time. (tokio's `spawn_blocking` would panic.)
    pub async fn reload_aside(self: Arc<Self>) {
        let (end, ended) = oneshot::channel();
        let read = move || {
            self.reload();
            let _ = end.send(());
        };
        match thread::Builder::new().name("reload".into()).spawn(read) {
            Ok(_) => {
                let _ = ended.await;
            }
            Err(error) => {
                let said =
                    "certificates and tokens are not read again now: the system refuses to start a thread";
                limited!(error, %error, said);
            }
        }
    }

    /// The TLS configuration for the next TCP connection, or `None` for plain text.
    pub(super) fn tls_config(&self) -> Option<Arc<ServerConfig>> {
        self.tls.as_ref().map(Tls::config)
    }

    /// Checks whether a call of `method` with these headers is allowed. Returns the name of its
    /// token, if it needs one.
    ///
    /// # Errors
    /// UNAUTHENTICATED without a known token, PERMISSION_DENIED if the token's role does not allow
    /// the call.
    pub(super) fn check(
        &self,
        method: &Method,
        headers: &HeaderMap,
    ) -> Result<Option<Arc<str>>, ServiceError> {
        match (&self.tokens, needed_role(method)) {
            (Some(tokens), Some(role)) => tokens.check(role, headers).map(Some),
            _ => Ok(None),
        }
    }
}

/// The role that a call needs. Health checks need none, because load balancers have no token.
fn needed_role(method: &Method) -> Option<Role> {
    match &*method.name {
        methods::REGISTER_HULLS | methods::DELETE_HULLS => Some(Role::Register),
        _ if method.is_health() => None,
        _ => Some(Role::Query),
    }
}
