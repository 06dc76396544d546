//! Object stores over the network: S3 and compatible servers, Google Cloud Storage, Azure Blob
//! Storage. Each needs the feature of its name.
//!
//! Credentials, region and endpoint come from the environment, under the provider's own names
//! (`AWS_ACCESS_KEY_ID`, `AWS_ENDPOINT`, `GOOGLE_SERVICE_ACCOUNT`, `AZURE_STORAGE_ACCOUNT_NAME` …).

use std::{sync::Arc, time::Duration};

use object_store::{BackoffConfig, ClientOptions, ObjectStore, RetryConfig, prefix::PrefixStore};

use super::objects::OpenedBucket;

/// A request without an answer after this time is tried again. In this time the largest hull can be
/// sent at 6 MB/s.
const REQUEST: Duration = Duration::from_secs(10);
const CONNECT: Duration = Duration::from_secs(2);
/// No attempt starts later than this after the first one, so that the caller learns of an outage.
const RETRIES: Duration = Duration::from_secs(10);
const MAX_RETRIES: usize = 6;

/// Opens `scheme://bucket/prefix`. Returns `None` if this build does not support the scheme.
pub(super) fn open(scheme: &str, url: &str) -> Option<object_store::Result<OpenedBucket>> {
    // The client of the store uses the installed crypto provider. The installation fails if there
    // is one already, which is fine.
    let _ = tokio_rustls::rustls::crypto::ring::default_provider().install_default();
    let (bare, absent): (object_store::Result<Arc<dyn ObjectStore>>, _) = match scheme {
        #[cfg(feature = "s3")]
        "s3" => {
            let builder = object_store::aws::AmazonS3Builder::from_env().with_url(url);
            let built = builder.with_retry(retries()).with_client_options(options("AWS")).build();
            (built.map(|store| Arc::new(store) as _), "NoSuchKey")
        }
        #[cfg(feature = "gcs")]
        "gs" => {
            let builder = object_store::gcp::GoogleCloudStorageBuilder::from_env().with_url(url);
            let built = builder.with_retry(retries()).with_client_options(options("GOOGLE")).build();
            (built.map(|store| Arc::new(store) as _), "NoSuchKey")
        }
        #[cfg(feature = "azure")]
        "az" => {
            let builder = object_store::azure::MicrosoftAzureBuilder::from_env().with_url(url);
            let built = builder.with_retry(retries()).with_client_options(options("AZURE")).build();
            (built.map(|store| Arc::new(store) as _), "BlobNotFound")
        }
        _ => return None,
    };
    let prefix = url.splitn(4, '/').nth(3).unwrap_or_default();
    Some(bare.map(|store| match prefix.is_empty() {
        true => (store, absent),
        false => (Arc::new(PrefixStore::new(store, prefix)) as _, absent),
    }))
}

fn retries() -> RetryConfig {
    let backoff = BackoffConfig {
        init_backoff: Duration::from_millis(50),
        max_backoff: Duration::from_secs(2),
        base: 2.0,
    };
    RetryConfig { backoff, max_retries: MAX_RETRIES, retry_timeout: RETRIES }
}

/// Plain text is allowed only if the environment allows it, for example by `AWS_ALLOW_HTTP=true`.
fn options(provider: &str) -> ClientOptions {
    let plain = std::env::var(format!("{provider}_ALLOW_HTTP"));
    let plain = plain.is_ok_and(|value| value.eq_ignore_ascii_case("true") || value == "1");
    ClientOptions::new().with_timeout(REQUEST).with_connect_timeout(CONNECT).with_allow_http(plain)
}
