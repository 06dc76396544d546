//! Decides which certificates of servers are trusted if the caller names the certificates to trust.
//!
//! A self-signed certificate, as `openssl req -x509` makes it, is marked as the certificate of an
//! authority. The usual rules (RFC 5280) do not accept the certificate of an authority as that of a
//! server. But the caller has named this very certificate, and other gRPC clients accept it. So it is
//! accepted if the PEM text contains it byte for byte, it is valid now, and it names the server.

use std::sync::Arc;

use tokio_rustls::rustls::{
    CertificateError, DigitallySignedStruct, Error, RootCertStore, SignatureScheme,
    client::{
        WebPkiServerVerifier,
        danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier},
        verify_server_name,
    },
    crypto::ring,
    pki_types::{CertificateDer, ServerName, UnixTime, pem::PemObject},
    server::ParsedCertificate,
};

/// Trusts the certificates of a PEM text, and those that they have signed.
#[derive(Debug)]
pub(crate) struct Trust {
    usual: Arc<WebPkiServerVerifier>,
    given: Vec<CertificateDer<'static>>,
}

impl Trust {
    /// Reads the authorities from a PEM text.
    ///
    /// # Errors
    /// The text says what is wrong with the content.
    pub(crate) fn new(pem: &[u8]) -> Result<Self, String> {
        let given: Vec<_> =
            CertificateDer::pem_slice_iter(pem).collect::<Result<_, _>>().map_err(|e| e.to_string())?;
        let mut roots = RootCertStore::empty();
        let (taken, _) = roots.add_parsable_certificates(given.iter().cloned());
        if taken == 0 {
            return Err("no certificate in it".into());
        }
        let provider = Arc::new(ring::default_provider());
        let usual = WebPkiServerVerifier::builder_with_provider(Arc::new(roots), provider)
            .build()
            .map_err(|e| e.to_string())?;
        Ok(Self { usual, given })
    }
}

impl ServerCertVerifier for Trust {
    fn verify_server_cert(
        &self,
        end_entity: &CertificateDer<'_>,
        intermediates: &[CertificateDer<'_>],
        server_name: &ServerName<'_>,
        ocsp_response: &[u8],
        now: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        let usual = self.usual.verify_server_cert(end_entity, intermediates, server_name, ocsp_response, now);
        match usual {
            // `Other` stands for the refusal of an authority's certificate. This refusal comes
            // after the check of the time, for which there is an error of its own.
            Err(Error::InvalidCertificate(CertificateError::Other(_))) if self.given.contains(end_entity) => {
                verify_server_name(&ParsedCertificate::try_from(end_entity)?, server_name)?;
                Ok(ServerCertVerified::assertion())
            }
            other => other,
        }
    }

    fn verify_tls12_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        self.usual.verify_tls12_signature(message, certificate, signature)
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        self.usual.verify_tls13_signature(message, certificate, signature)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.usual.supported_verify_schemes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rcgen::{BasicConstraints, CertificateParams, IsCa, KeyPair, date_time_ymd};

    /// A self-signed certificate for `localhost`, marked as the certificate of an authority.
    fn self_signed(last_year: i32) -> rcgen::Certificate {
        let mut params = CertificateParams::new(vec!["localhost".into()]).unwrap();
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        params.not_before = date_time_ymd(2000, 1, 1);
        params.not_after = date_time_ymd(last_year, 1, 1);
        params.self_signed(&KeyPair::generate().unwrap()).unwrap()
    }

    /// Catches a certificate that is trusted although it was not given, names another server
    /// or has expired, and one that was given and is refused.
    #[test]
    fn the_given_certificate_itself_is_trusted_and_no_other() {
        let (own, other, expired) = (self_signed(4000), self_signed(4000), self_signed(2001));
        let verdict = |given: &rcgen::Certificate, shown: &rcgen::Certificate, name: &'static str| {
            let trust = Trust::new(given.pem().as_bytes()).unwrap();
            let name = ServerName::try_from(name).unwrap();
            trust.verify_server_cert(shown.der(), &[], &name, &[], UnixTime::now()).map(|_| ())
        };
        assert_eq!(verdict(&own, &own, "localhost"), Ok(()));
        assert!(verdict(&own, &own, "elsewhere").is_err());
        assert!(verdict(&own, &other, "localhost").is_err());
        assert!(verdict(&expired, &expired, "localhost").is_err());
        for wrong in [&b""[..], b"text", b"-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n"] {
            assert!(Trust::new(wrong).is_err());
        }
    }
}
