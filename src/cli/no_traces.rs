//! Traces in a build without the feature `otlp`: opening them is refused.

use tracing::Subscriber;
use tracing_subscriber::{Layer, layer::Identity};

use super::Error;

/// A type without values, because such a build has no traces.
pub(crate) enum Traces {}

impl Traces {
    /// # Errors
    /// Always.
    pub(crate) fn open(endpoint: &str, _: f64) -> Result<Self, Error> {
        Err(format!("otlp_endpoint {endpoint}: needs the feature \"otlp\", which this build is without")
            .into())
    }

    pub(crate) fn layer<S: Subscriber>(&self) -> impl Layer<S> + use<S> {
        match *self {}
        #[allow(unreachable_code, reason = "the type of what cannot be")]
        Identity::new()
    }

    pub(crate) fn flush(self) {
        match self {}
    }
}
