//! TLS with rustls and ring, the only crypto provider in the dependency tree.

use std::{path::Path, sync::Arc};

use tokio_rustls::rustls::{
    self, InconsistentKeys, RootCertStore, ServerConfig,
    crypto::ring,
    pki_types::{
        CertificateDer, PrivateKeyDer,
        pem::{self, PemObject},
    },
    server::WebPkiClientVerifier,
};

use super::{
    SecurityFiles,
    reloaded::{LoadError, Reloaded, SettingFile},
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
        let given = |path: &Path| !path.as_os_str().is_empty();
        let mut named = vec![
            SettingFile::new("tls_certificate", &files.tls_certificate),
            SettingFile::new("tls_key", &files.tls_key),
        ];
        match (given(&files.tls_certificate), given(&files.tls_key), given(&files.tls_client_ca)) {
            (false, false, false) => return Ok(None),
            (true, true, false) => {}
            (true, true, true) => named.push(SettingFile::new("tls_client_ca", &files.tls_client_ca)),
            (false, _, _) => return Err(LoadError::Missing { setting: "tls_certificate" }),
            (true, false, _) => return Err(LoadError::Missing { setting: "tls_key" }),
        }
        Reloaded::open(named, config).map(|config| Some(Self(config)))
    }

    pub(super) fn config(&self) -> Arc<ServerConfig> {
        (*self.0.get()).clone()
    }

    pub(super) fn reload(&self) {
        self.0.reload();
    }
}

/// The configuration from the contents of certificate, key and, if given, authorities.
fn config(contents: &[(&SettingFile, Vec<u8>)]) -> Result<Arc<ServerConfig>, LoadError> {
    let [(chain_file, chain), (key_file, key), authorities @ ..] = contents else {
        return Err(LoadError::Missing { setting: "tls_certificate" });
    };
    let provider = Arc::new(ring::default_provider());
    let builder = ServerConfig::builder_with_provider(provider.clone())
        .with_safe_default_protocol_versions()
        .map_err(|error| LoadError::new(chain_file, error))?;
    let builder = match authorities.first() {
        None => builder.with_no_client_auth(),
        Some((file, bytes)) => {
            let mut roots = RootCertStore::empty();
            for authority in certificates(file, bytes)? {
                roots.add(authority).map_err(|error| LoadError::new(file, error))?;
            }
            let verifier = WebPkiClientVerifier::builder_with_provider(Arc::new(roots), provider).build();
            builder.with_client_cert_verifier(verifier.map_err(|error| LoadError::new(file, error))?)
        }
    };
    let key = match PrivateKeyDer::from_pem_slice(key) {
        Ok(key) => key,
        Err(pem::Error::NoItemsFound) => return Err(LoadError::new(key_file, "no private key (PEM) in it")),
        Err(error) => return Err(LoadError::new(key_file, error)),
    };
    let config = builder.with_single_cert(certificates(chain_file, chain)?, key);
    let mut config = config.map_err(|error| match error {
        rustls::Error::InconsistentKeys(InconsistentKeys::KeyMismatch) => {
            let certificate = chain_file.path().display();
            let why = format!(
                "it is not the key of the certificate {certificate}: give the key that belongs to it"
            );
            LoadError::new(key_file, why)
        }
        error => LoadError::new(chain_file, error),
    })?;
    config.alpn_protocols = vec![b"h2".to_vec()];
    Ok(Arc::new(config))
}

fn certificates(file: &SettingFile, pem: &[u8]) -> Result<Vec<CertificateDer<'static>>, LoadError> {
    let found: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(pem).collect();
    match found {
        Ok(certificates) if certificates.is_empty() => {
            Err(LoadError::new(file, "no certificate (PEM) in it"))
        }
        Ok(certificates) => Ok(certificates),
        Err(error) => Err(LoadError::new(file, error)),
    }
}
