//! Sends traces to an OpenTelemetry collector, over OTLP on gRPC.

use std::time::Duration;

use hullcast::trace;
use opentelemetry::{KeyValue, trace::TracerProvider};
use opentelemetry_otlp::{
    SpanExporter, WithExportConfig, WithTonicConfig, tonic_types::transport::ClientTlsConfig,
};
use opentelemetry_sdk::{
    Resource,
    trace::{Sampler, SdkTracerProvider},
};
use tracing::Subscriber;
use tracing_subscriber::{Layer, filter::filter_fn, registry::LookupSpan};

use super::{Error, exit::Exit, settings::Settings};

/// The time at the end for sending the remaining spans. A collector that does not answer delays the end
/// by no more than this.
const FLUSH: Duration = Duration::from_secs(2);

/// Sends spans from a thread of its own. Spans that cannot be sent are dropped.
pub(crate) struct Traces(SdkTracerProvider);

impl Traces {
    /// Opens the exporter. Must be called inside a runtime. It connects when there are spans to send.
    ///
    /// # Errors
    /// The endpoint is not a URL.
    pub(crate) fn open(settings: &Settings) -> Result<Self, Error> {
        let (endpoint, share) = (&settings.otlp_endpoint, settings.otlp_share);
        let mut exporter = SpanExporter::builder().with_tonic().with_endpoint(endpoint);
        if endpoint.starts_with("https:") {
            exporter = exporter.with_tls_config(ClientTlsConfig::new().with_enabled_roots());
        }
        let exporter = exporter.build().map_err(|error| {
            Exit::Usage.error(format!("{} {endpoint}: {error}", settings.shown("otlp_endpoint")))
        })?;
        let about =
            Resource::builder().with_attribute(KeyValue::new("service.version", env!("CARGO_PKG_VERSION")));
        let about = match std::env::var_os("OTEL_SERVICE_NAME") {
            Some(_) => about,
            None => about.with_service_name("hullcast"),
        };
        let provider = SdkTracerProvider::builder()
            .with_batch_exporter(exporter)
            .with_sampler(Sampler::ParentBased(Box::new(Sampler::TraceIdRatioBased(share))))
            .with_resource(about.build());
        Ok(Self(provider.build()))
    }

    /// The layer that receives the spans to be sent.
    pub(crate) fn layer<S: Subscriber + for<'a> LookupSpan<'a>>(&self) -> impl Layer<S> + use<S> {
        tracing_opentelemetry::layer()
            .with_tracer(self.0.tracer("hullcast"))
            .with_context_activation(false)
            .with_location(false)
            .with_threads(false)
            .with_target(false)
            .with_tracked_inactivity(false)
            .with_filter(filter_fn(|metadata| metadata.is_span() && metadata.target() == trace::TARGET))
    }

    /// Sends the remaining spans.
    pub(crate) fn flush(self) {
        if let Err(error) = self.0.shutdown_with_timeout(FLUSH) {
            tracing::warn!(%error, "traces were not sent");
        }
    }
}
