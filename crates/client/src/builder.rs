//! Settings of a connection, and how it is made.

use std::error::Error as StdError;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use hullcast_proto::GetServerInfoRequest;
use tokio_rustls::rustls::{
    self,
    crypto::ring,
    pki_types::{
        CertificateDer, PrivateKeyDer, ServerName,
        pem::{Error as PemError, PemObject},
    },
    sign::CertifiedKey,
};
use tonic::metadata::{Ascii, MetadataValue};
use tonic::service::{Interceptor, interceptor::InterceptedService};
use tonic::transport::{ClientTlsConfig, Endpoint, Identity};
use tonic::{Request, Status};

use crate::client::Client;
use crate::error::{Defect, Setting, SettingError};
use crate::reach::{Unreachable, failed, mismatch, root_cause};
use crate::trust::Trust;
use crate::{Address, Error};

/// Window of HTTP/2 flow control, into which a batch of some thousand pairs fits.
const WINDOW_BYTES: u32 = 8 << 20;
/// Time after which an attempt to connect is given up, because an unreachable server sends nothing.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
/// Interval and timeout of keep-alive pings. A call in progress notices a lost server after twice this
/// time.
const KEEP_ALIVE: Duration = Duration::from_secs(10);
/// The usual timeout of a call.
const TIMEOUT: Duration = Duration::from_secs(60);

/// The settings of a connection, made by [`Client::builder`].
///
/// ```no_run
/// # async fn example() -> Result<(), hullcast_client::Error> {
/// let authority = std::fs::read("ca.pem").expect("a PEM file");
/// let client = hullcast_client::Client::builder("https://contacts.example:443")
///     .authority(authority)
///     .token("the token")
///     .timeout(Some(std::time::Duration::from_secs(10)))
///     .connect()
///     .await?;
/// # Ok(())
/// # }
/// ```
#[derive(Clone)]
#[must_use = "a connection is opened by `connect`"]
pub struct Builder {
    address: String,
    authority: Option<Vec<u8>>,
    identity: Option<(Vec<u8>, Vec<u8>)>,
    token: Option<String>,
    timeout: Option<Duration>,
    retries: bool,
}

impl Builder {
    pub(crate) fn new(address: String) -> Self {
        Self { address, authority: None, identity: None, token: None, timeout: Some(TIMEOUT), retries: true }
    }

    /// The authorities that may have signed the server's certificate, or the server's own self-signed
    /// certificate, as PEM text. By default the authorities of the system are trusted.
    ///
    /// The address has to begin with `https://`.
    pub fn authority(mut self, pem: impl Into<Vec<u8>>) -> Self {
        self.authority = Some(pem.into());
        self
    }

    /// The certificate of this client and its private key, as PEM texts, for a server that asks for a
    /// certificate. By default the client has none.
    ///
    /// The address has to begin with `https://`.
    pub fn identity(mut self, certificate_pem: impl Into<Vec<u8>>, key_pem: impl Into<Vec<u8>>) -> Self {
        self.identity = Some((certificate_pem.into(), key_pem.into()));
        self
    }

    /// The token that is sent with every call. By default none is sent.
    ///
    /// The token travels unencrypted unless the address begins with `https://`.
    pub fn token(mut self, token: impl Into<String>) -> Self {
        self.token = Some(token.into());
        self
    }

    /// The time within which each call of [`Client`] has to be answered, with all its messages and
    /// repetitions. By default 60 seconds; `None` means that only the server's own limit applies.
    pub fn timeout(mut self, timeout: Option<Duration>) -> Self {
        self.timeout = timeout;
        self
    }

    /// Whether the client repeats a call that a busy server refused, or whose server was lost. By default it
    /// does: every call is idempotent. A busy server states the time to wait, and the timeout bounds the
    /// repetitions. A lost server is called again up to five times.
    pub fn retries(mut self, retries: bool) -> Self {
        self.retries = retries;
        self
    }

    /// Connects to the server.
    ///
    /// # Errors
    /// [`Error::Address`] and [`Error::Setting`] if an argument cannot be used; [`Error::Unreachable`] if no
    /// server answers within some seconds, or if the peer is not a hullcast server, or if TLS does not fit.
    /// `connect` succeeds even if the server refuses the token; the first call then reports the refusal.
    pub async fn connect(self) -> Result<Client, Error> {
        let address: Address = self.address.parse()?;
        let token = Token::new(self.token.as_deref())?;
        let endpoint = self.endpoint(&address)?;
        let unreachable = |cause| Unreachable { address: self.address.clone(), cause };
        let channel = match endpoint.connect().await {
            Ok(channel) => channel,
            Err(error) => return Err(unreachable(failed(&address, &error).await).into()),
        };
        let service = InterceptedService::new(channel, token);
        let client = Client::new(service, self.address.clone(), self.timeout, self.retries);
        // Without TLS, a connection counts as open before the server has sent anything.
        let mut server = client.server();
        let asked = server.get_server_info(GetServerInfoRequest {});
        let doubt = match tokio::time::timeout(CONNECT_TIMEOUT, asked).await {
            Ok(Ok(info)) => {
                client.keep_limits(info.get_ref());
                return Ok(client);
            }
            // Only statuses that tonic makes itself have a source, so any other answer shows that a server
            // is there. If the connection only broke, the first call opens another one.
            Ok(Err(status)) if status.source().is_some() => mismatch(&address, &status).await,
            Ok(Err(_)) => None,
            // A server that is only busy answers the beginning of HTTP/2 at once.
            Err(_) => mismatch(&address, &Status::deadline_exceeded("no answer")).await,
        };
        match doubt {
            Some(cause) => Err(unreachable(cause).into()),
            None => Ok(client),
        }
    }

    fn endpoint(&self, address: &Address) -> Result<Endpoint, Error> {
        let endpoint = Endpoint::from_shared(address.to_string())
            .map_err(|_| crate::AddressError::Malformed(self.address.clone()))?
            .initial_stream_window_size(WINDOW_BYTES)
            .initial_connection_window_size(WINDOW_BYTES)
            .connect_timeout(CONNECT_TIMEOUT)
            .http2_keep_alive_interval(KEEP_ALIVE)
            .keep_alive_timeout(KEEP_ALIVE)
            .tcp_nodelay(true);
        if address.is_encrypted() {
            return self.encrypted(address, endpoint);
        }
        match (&self.authority, &self.identity) {
            (Some(_), _) => Err(setting(Setting::Authority, Defect::NotEncrypted)),
            (None, Some(_)) => Err(setting(Setting::Certificate, Defect::NotEncrypted)),
            (None, None) => Ok(endpoint),
        }
    }

    fn encrypted(&self, address: &Address, endpoint: Endpoint) -> Result<Endpoint, Error> {
        ServerName::try_from(address.host().unwrap_or_default())
            .map_err(|_| crate::AddressError::Malformed(self.address.clone()))?;
        let mut tls = ClientTlsConfig::new();
        if let Some((certificate, key)) = &self.identity {
            let certificate = pem(Setting::Certificate, certificate)?;
            let key = pem(Setting::Key, key)?;
            check_identity(certificate, key)?;
            tls = tls.identity(Identity::from_pem(certificate, key));
        }
        let unusable = |why| setting(Setting::Authority, Defect::Unusable(why));
        let configured = match &self.authority {
            None => endpoint.tls_config(tls.with_native_roots()),
            Some(authority) => {
                let trust = Trust::new(pem(Setting::Authority, authority)?).map_err(unusable)?;
                endpoint.tls_config_with_verifier(tls, Arc::new(trust))
            }
        };
        // Everything else has been checked, so the authorities are at fault: this system may have none.
        configured.map_err(|error| unusable(root_cause(&error)))
    }
}

impl fmt::Debug for Builder {
    /// Shows neither the key nor the token.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Builder").field("address", &self.address).finish_non_exhaustive()
    }
}

fn setting(setting: Setting, defect: Defect) -> Error {
    SettingError { setting, defect }.into()
}

/// Checks that TLS can use a certificate with its key, so that an error names the one at fault.
fn check_identity(certificate_pem: &[u8], key_pem: &[u8]) -> Result<(), Error> {
    let unusable = |place, why: String| setting(place, Defect::Unusable(why));
    let certificates: Vec<_> = CertificateDer::pem_slice_iter(certificate_pem)
        .collect::<Result<_, _>>()
        .map_err(|error| unusable(Setting::Certificate, error.to_string()))?;
    if certificates.is_empty() {
        return Err(unusable(Setting::Certificate, "no certificate in it".into()));
    }
    let key = PrivateKeyDer::from_pem_slice(key_pem).map_err(|error| match error {
        PemError::NoItemsFound => unusable(Setting::Key, "no private key in it".into()),
        error => unusable(Setting::Key, error.to_string()),
    })?;
    match CertifiedKey::from_der(certificates, key, &ring::default_provider()) {
        Ok(_) => Ok(()),
        Err(rustls::Error::InconsistentKeys(_)) => {
            Err(unusable(Setting::Key, "it is not the key of the certificate".into()))
        }
        Err(error @ rustls::Error::InvalidCertificate(_)) => {
            Err(unusable(Setting::Certificate, error.to_string()))
        }
        Err(error) => Err(unusable(Setting::Key, error.to_string())),
    }
}

/// Returns the text if it has a PEM block. TLS would ignore a text without one.
fn pem(place: Setting, text: &[u8]) -> Result<&[u8], Error> {
    if text.windows(11).any(|bytes| bytes == b"-----BEGIN ") {
        return Ok(text);
    }
    Err(setting(place, Defect::NotPem))
}

/// The token that is sent with every call, if there is one.
#[derive(Clone, Debug)]
pub(crate) struct Token(Option<MetadataValue<Ascii>>);

impl Token {
    fn new(token: Option<&str>) -> Result<Self, Error> {
        let Some(token) = token else { return Ok(Self(None)) };
        let is_visible = !token.is_empty() && token.bytes().all(|byte| byte.is_ascii_graphic());
        let header = format!("Bearer {token}").parse::<MetadataValue<Ascii>>().ok().filter(|_| is_visible);
        let mut header = header.ok_or_else(|| setting(Setting::Token, Defect::NotAToken))?;
        header.set_sensitive(true);
        Ok(Self(Some(header)))
    }
}

impl Interceptor for Token {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Token(Some(token)) = self {
            request.metadata_mut().insert("authorization", token.clone());
        }
        Ok(request)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rcgen::{CertificateParams, KeyPair};

    /// Catches a setting that is ignored, refused only after a server was called, or refused under the name of
    /// another.
    #[tokio::test]
    async fn unusable_settings_are_named() {
        let builder = |address: &str| Client::builder(address);
        let pem = "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n";
        let secured = || builder("https://localhost:1");
        let [own, other] = [(); 2].map(|()| KeyPair::generate().expect("a key"));
        let signed =
            CertificateParams::new(vec!["client".into()]).and_then(|params| params.self_signed(&own));
        let certificate = signed.expect("a certificate").pem();
        let [own, other] = [own, other].map(|key| key.serialize_pem());
        for (builder, expected) in [
            (builder("localhost:1").authority(pem), (Setting::Authority, Some(Defect::NotEncrypted))),
            (builder("localhost:1").identity(pem, pem), (Setting::Certificate, Some(Defect::NotEncrypted))),
            (secured().authority("words"), (Setting::Authority, Some(Defect::NotPem))),
            (secured().authority(pem), (Setting::Authority, None)),
            (secured().identity("words", pem), (Setting::Certificate, Some(Defect::NotPem))),
            (secured().identity(pem, "words"), (Setting::Key, Some(Defect::NotPem))),
            (secured().identity(pem, own.as_str()), (Setting::Certificate, None)),
            (secured().identity(own.as_str(), own.as_str()), (Setting::Certificate, None)),
            (secured().identity(certificate.as_str(), certificate.as_str()), (Setting::Key, None)),
            (secured().identity(certificate.as_str(), other), (Setting::Key, None)),
            (secured().token(""), (Setting::Token, Some(Defect::NotAToken))),
            (secured().token("two words"), (Setting::Token, Some(Defect::NotAToken))),
            (secured().token("line\nbreak"), (Setting::Token, Some(Defect::NotAToken))),
        ] {
            let error = builder.connect().await.expect_err("a setting that cannot be used");
            let Error::Setting(SettingError { setting, defect }) = error else { panic!("{error}") };
            assert_eq!(setting, expected.0);
            match expected.1 {
                Some(expected) => assert_eq!(defect, expected),
                None => assert!(matches!(defect, Defect::Unusable(_)), "{defect}"),
            }
        }
        for address in ["a b", "https://a..b"] {
            let error = builder(address).connect().await.expect_err("not an address");
            assert!(matches!(error, Error::Address(_)), "{error}");
        }
    }

    /// Catches a token or a key that the debug output shows.
    #[test]
    fn secrets_are_not_shown() {
        let builder = Client::builder("localhost").token("secret-token").identity("a", "secret-key");
        assert!(!format!("{builder:?}").contains("secret"));
        assert!(!format!("{:?}", Token::new(Some("secret-token"))).contains("secret"));
    }
}
