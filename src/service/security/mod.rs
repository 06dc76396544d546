//! Who may connect and what they may do: TLS, and tokens with roles.

mod reloaded;
mod tls;
mod tokens;

use std::{path::PathBuf, sync::Arc};

use http::HeaderMap;
pub use reloaded::LoadError;
use tls::Tls;
use tokens::{Role, Tokens};
use tokio_rustls::rustls::ServerConfig;

use super::ServiceError;

/// The files that security is made of; a path that is empty is none.
#[derive(Clone, Debug, Default)]
pub struct SecurityFiles {
    /// PEM: the server's certificate and those it leads to.
    pub tls_certificate: PathBuf,
    /// PEM: its private key.
    pub tls_key: PathBuf,
    /// PEM: clients must have a certificate of one of these authorities.
    pub tls_client_ca: PathBuf,
    /// Tokens, one a line, that may query.
    pub query_tokens: PathBuf,
    /// Tokens, one a line, that may also register and delete.
    pub register_tokens: PathBuf,
}

/// Read from files, and read again while the server runs.
#[derive(Debug, Default)]
pub struct Security {
    tls: Option<Tls>,
    tokens: Option<Tokens>,
}

impl Security {
    /// Reads the files.
    ///
    /// # Errors
    /// A file cannot be read or used, or one is missing beside another.
    pub fn open(files: &SecurityFiles) -> Result<Self, LoadError> {
        Ok(Self { tls: Tls::open(files)?, tokens: Tokens::open(files)? })
    }

    /// Whether TCP connections are encrypted.
    pub fn encrypts(&self) -> bool {
        self.tls.is_some()
    }

    /// Reads what has changed; a file that cannot be used is logged, and what was read
    /// before stays in force.
    pub fn reload(&self) {
        if let Some(tls) = &self.tls {
            tls.reload();
        }
        if let Some(tokens) = &self.tokens {
            tokens.reload();
        }
    }

    /// For the next connection over TCP; none for plain text.
    pub(super) fn tls_config(&self) -> Option<Arc<ServerConfig>> {
        self.tls.as_ref().map(Tls::config)
    }

    /// Whether a call of `path` with these headers may go on; the name of its token, where it
    /// needs one.
    ///
    /// # Errors
    /// UNAUTHENTICATED without a known token, PERMISSION_DENIED with one that may not.
    pub(super) fn check(&self, path: &str, headers: &HeaderMap) -> Result<Option<Arc<str>>, ServiceError> {
        match (&self.tokens, needed(path)) {
            (Some(tokens), Some(role)) => tokens.check(role, headers).map(Some),
            _ => Ok(None),
        }
    }
}

/// What a call needs; health is for balancers, which have no token.
fn needed(path: &str) -> Option<Role> {
    match path {
        "/hullcast.v1.HullService/RegisterHulls" | "/hullcast.v1.HullService/DeleteHulls" => {
            Some(Role::Register)
        }
        _ if path.starts_with("/grpc.health.v1.Health/") => None,
        _ => Some(Role::Query),
    }
}
