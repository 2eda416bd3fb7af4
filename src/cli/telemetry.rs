use std::io::{self, IsTerminal};
use std::time::Duration;

use clap::{Args, ValueEnum};
use meshmend::telemetry;
use metrics_exporter_prometheus::{BuildError, Matcher, PrometheusBuilder, PrometheusHandle};
use opentelemetry::KeyValue;
use opentelemetry::trace::TracerProvider;
use opentelemetry_otlp::{ExporterBuildError, Protocol, SpanExporter, WithExportConfig};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::trace::{Sampler, SdkTracerProvider};
use tracing::Level;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Layer};
use url::Url;

/// How often recorded values are sorted into their buckets.
const UPKEEP: Duration = Duration::from_secs(5);
/// Longest time that a collector may take for what it is sent.
const SENDING: Duration = Duration::from_secs(5);

/// What the service tells of itself.
#[derive(Debug, Args)]
pub struct TelemetryArgs {
    /// What to log, as `level` or `target=level,...`.
    #[arg(long, env = "MESHMEND_LOG", default_value = "info")]
    log: String,
    /// How log lines look.
    #[arg(long, env = "MESHMEND_LOG_FORMAT", value_enum, default_value_t)]
    log_format: LogFormat,
    /// Address of an OpenTelemetry collector that traces are sent to (OTLP over HTTP), as http://host:4318; without it none are.
    #[arg(long, env = "MESHMEND_OTLP_ENDPOINT", value_name = "URL", value_parser = collector)]
    otlp_endpoint: Option<Url>,
    /// Share of requests whose traces are sent, 0 to 1. A request whose traceparent says whether it is sampled is as that says.
    #[arg(long, env = "MESHMEND_TRACE_RATIO", default_value_t = 1.0, value_parser = ratio)]
    trace_ratio: f64,
}

/// How log lines look.
#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum LogFormat {
    /// For people.
    #[default]
    Text,
    /// One JSON object a line.
    Json,
}

/// What logs and traces, until it is dropped; then the traces that are still here are sent.
pub struct Telemetry(SdkTracerProvider);

impl Drop for Telemetry {
    fn drop(&mut self) {
        // What can't be sent was told in the log.
        let _ = self.0.shutdown();
    }
}

impl TelemetryArgs {
    /// Begins to log and to trace.
    pub fn start(&self) -> Result<Telemetry, String> {
        let filter = EnvFilter::try_new(format!("sqlx=warn,opentelemetry=warn,{}", self.log))
            .map_err(|e| format!("--log '{}': {e}", self.log))?;
        let lines = tracing_subscriber::fmt::layer().with_writer(io::stderr);
        let lines = match self.log_format {
            LogFormat::Text => lines.with_ansi(io::stderr().is_terminal()).boxed(),
            LogFormat::Json => lines.json().boxed(),
        };
        let provider = self.traces().map_err(|e| format!("--otlp-endpoint: {e}"))?;
        let spans = tracing_opentelemetry::layer()
            .with_tracer(provider.tracer("meshmend"))
            .with_location(false)
            .with_threads(false)
            .with_target(false)
            .with_tracked_inactivity(false)
            .with_filter(Targets::new().with_target("meshmend", Level::INFO));
        tracing_subscriber::registry().with(lines.with_filter(filter)).with(spans).init();
        Ok(Telemetry(provider))
    }

    /// Where spans go. Without a collector nowhere, but each has a name still, which its log lines have too.
    fn traces(&self) -> Result<SdkTracerProvider, ExporterBuildError> {
        let resource = Resource::builder()
            .with_service_name("meshmend")
            .with_attribute(KeyValue::new("service.version", env!("CARGO_PKG_VERSION")))
            .build();
        let provider = SdkTracerProvider::builder().with_resource(resource);
        let Some(collector) = &self.otlp_endpoint else {
            return Ok(provider.with_sampler(Sampler::ParentBased(Box::new(Sampler::AlwaysOff))).build());
        };
        let exporter = SpanExporter::builder()
            .with_http()
            .with_protocol(Protocol::HttpBinary)
            .with_endpoint(format!("{}/v1/traces", collector.as_str().trim_end_matches('/')))
            .with_timeout(SENDING)
            .build()?;
        let sampler = Sampler::ParentBased(Box::new(Sampler::TraceIdRatioBased(self.trace_ratio)));
        Ok(provider.with_sampler(sampler).with_batch_exporter(exporter).build())
    }
}

fn collector(text: &str) -> Result<Url, String> {
    match Url::parse(text) {
        Ok(url) if url.scheme() == "http" && url.has_host() => Ok(url),
        _ => {
            Err("expected http://host:port; for a collector elsewhere, run one beside this that speaks TLS".to_owned())
        }
    }
}

fn ratio(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|ratio| (0.0..=1.0).contains(ratio)).ok_or_else(|| "expected 0 to 1".to_owned())
}

/// Begins to keep metrics.
pub fn install_metrics() -> Result<PrometheusHandle, BuildError> {
    const SECONDS: [f64; 16] =
        [0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0, 30.0, 60.0, 120.0, 600.0];
    const BYTES: [f64; 6] = [1e4, 1e5, 1e6, 1e7, 1e8, 1e9];
    let handle = PrometheusBuilder::new()
        .set_buckets_for_metric(Matcher::Suffix("_seconds".to_owned()), &SECONDS)?
        .set_buckets_for_metric(Matcher::Suffix("_bytes".to_owned()), &BYTES)?
        .install_recorder()?;
    telemetry::describe();
    let upkeep = handle.clone();
    tokio::spawn(async move {
        loop {
            tokio::time::sleep(UPKEEP).await;
            upkeep.run_upkeep();
        }
    });
    Ok(handle)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_collector_is_an_address_without_tls_and_a_ratio_a_share() {
        assert!(collector("http://127.0.0.1:4318").is_ok());
        for text in ["", "127.0.0.1:4318", "https://collector:4318", "grpc://collector:4317", "http:"] {
            assert!(collector(text).is_err(), "{text}");
        }
        assert_eq!([ratio("0"), ratio("0.25"), ratio("1")], [Ok(0.0), Ok(0.25), Ok(1.0)]);
        for text in ["", "-0.1", "1.1", "NaN", "all"] {
            assert!(ratio(text).is_err(), "{text}");
        }
    }
}
