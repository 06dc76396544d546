//! Traces in a build without the feature `otlp`: opening them is refused.

use tracing::Subscriber;
use tracing_subscriber::{Layer, layer::Identity};

use super::{Error, exit::Exit, settings::Settings};

/// A type without values, because such a build has no traces.
pub(crate) enum Traces {}

impl Traces {
    /// # Errors
    /// Always.
    pub(crate) fn open(settings: &Settings) -> Result<Self, Error> {
        let (name, endpoint) = (settings.shown("otlp_endpoint"), &settings.otlp_endpoint);
        let remedy = "cargo build --release --features otlp";
        Err(Exit::Usage.error(format!(
            "{name} {endpoint}: this server was built without traces: build it by `{remedy}`"
        )))
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
