//! TLS by rustls on ring, the only crypto provider in the dependency tree.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use tokio_rustls::rustls::{
    RootCertStore, ServerConfig,
    crypto::ring,
    pki_types::{CertificateDer, PrivateKeyDer, pem::PemObject},
    server::WebPkiClientVerifier,
};

use super::{
    SecurityFiles,
    reloaded::{LoadError, Reloaded},
};

/// The TLS configuration of certificate, key and, if given, the authorities of clients.
#[derive(Debug)]
pub(super) struct Tls(Reloaded<Arc<ServerConfig>>);

impl Tls {
    /// None if no certificate is named.
    ///
    /// # Errors
    /// A file cannot be read or used, or a file that another one needs is not named.
    pub(super) fn open(files: &SecurityFiles) -> Result<Option<Self>, LoadError> {
        let given = |path: &PathBuf| !path.as_os_str().is_empty();
        let mut paths = vec![files.tls_certificate.clone(), files.tls_key.clone()];
        match (given(&files.tls_certificate), given(&files.tls_key), given(&files.tls_client_ca)) {
            (false, false, false) => return Ok(None),
            (true, true, false) => {}
            (true, true, true) => paths.push(files.tls_client_ca.clone()),
            (false, _, _) => return Err(LoadError::new(Path::new("tls_certificate"), "is missing")),
            (true, false, _) => return Err(LoadError::new(Path::new("tls_key"), "is missing")),
        }
        Reloaded::open(paths, config).map(|config| Some(Self(config)))
    }

    pub(super) fn config(&self) -> Arc<ServerConfig> {
        (*self.0.get()).clone()
    }

    pub(super) fn reload(&self) {
        self.0.reload();
    }
}

/// The configuration from the contents of certificate, key and, if given, authorities.
fn config(contents: &[(&Path, Vec<u8>)]) -> Result<Arc<ServerConfig>, LoadError> {
    let [(chain_path, chain), (key_path, key), authorities @ ..] = contents else {
        return Err(LoadError::new(Path::new("tls"), "certificate and key are needed"));
    };
    let provider = Arc::new(ring::default_provider());
    let builder = ServerConfig::builder_with_provider(provider.clone())
        .with_safe_default_protocol_versions()
        .map_err(|error| LoadError::new(chain_path, error))?;
    let builder = match authorities.first() {
        None => builder.with_no_client_auth(),
        Some((path, bytes)) => {
            let mut roots = RootCertStore::empty();
            for authority in certificates(path, bytes)? {
                roots.add(authority).map_err(|error| LoadError::new(path, error))?;
            }
            let verifier = WebPkiClientVerifier::builder_with_provider(Arc::new(roots), provider).build();
            builder.with_client_cert_verifier(verifier.map_err(|error| LoadError::new(path, error))?)
        }
    };
    let key = PrivateKeyDer::from_pem_slice(key).map_err(|error| LoadError::new(key_path, error))?;
    let mut config = builder
        .with_single_cert(certificates(chain_path, chain)?, key)
        .map_err(|error| LoadError::new(chain_path, error))?;
    config.alpn_protocols = vec![b"h2".to_vec()];
    Ok(Arc::new(config))
}

fn certificates(path: &Path, pem: &[u8]) -> Result<Vec<CertificateDer<'static>>, LoadError> {
    let found: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(pem).collect();
    match found {
        Ok(certificates) if certificates.is_empty() => Err(LoadError::new(path, "no certificate in it")),
        Ok(certificates) => Ok(certificates),
        Err(error) => Err(LoadError::new(path, error)),
    }
}
