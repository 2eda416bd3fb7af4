//! Logs, traces and metrics of the service: their flags, and how they start.

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

/// Interval at which the recorder moves new samples into their buckets.
const UPKEEP_INTERVAL: Duration = Duration::from_secs(5);
/// Time limit for one export of traces to the collector.
const EXPORT_TIMEOUT: Duration = Duration::from_secs(5);

/// The flags for logs and traces.
#[derive(Debug, Args)]
pub struct TelemetryArgs {
    /// Log filter, as `level` or `target=level,...`.
    #[arg(long, env = "MESHMEND_LOG", default_value = "info")]
    log: String,
    /// Format of the log lines.
    #[arg(long, env = "MESHMEND_LOG_FORMAT", value_enum, default_value_t)]
    log_format: LogFormat,
    /// OpenTelemetry collector for traces (OTLP over HTTP), as http://host:4318. Default: no traces are sent.
    #[arg(long, env = "MESHMEND_OTLP_ENDPOINT", value_name = "URL", value_parser = parse_collector_url)]
    otlp_endpoint: Option<Url>,
    /// Share of requests whose traces are sent, 0 to 1. A sampling decision in the traceparent header of a request
    /// takes precedence.
    #[arg(long, env = "MESHMEND_TRACE_RATIO", default_value_t = 1.0, value_parser = parse_ratio)]
    trace_ratio: f64,
}

/// Format of the log lines.
#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum LogFormat {
    /// For people.
    #[default]
    Text,
    /// One JSON object per line.
    Json,
}

/// Logging and tracing, as long as this value lives. Dropping it sends the remaining traces.
pub struct Telemetry(SdkTracerProvider);

impl Drop for Telemetry {
    fn drop(&mut self) {
        // The exporter has already logged failed exports.
        let _ = self.0.shutdown();
    }
}

impl TelemetryArgs {
    /// Starts logging and tracing.
    ///
    /// # Errors
    /// An unusable log filter or collector, with the name of its flag.
    pub fn start(&self) -> Result<Telemetry, String> {
        let filter = EnvFilter::try_new(format!("sqlx=warn,opentelemetry=warn,{}", self.log))
            .map_err(|e| format!("--log '{}': {e}", self.log))?;
        let log = tracing_subscriber::fmt::layer().with_writer(io::stderr);
        let log = match self.log_format {
            LogFormat::Text => log.with_ansi(io::stderr().is_terminal()).boxed(),
            LogFormat::Json => log.json().boxed(),
        };
        let provider = self.tracer_provider().map_err(|e| format!("--otlp-endpoint: {e}"))?;
        let spans = tracing_opentelemetry::layer()
            .with_tracer(provider.tracer("meshmend"))
            .with_location(false)
            .with_threads(false)
            .with_target(false)
            .with_tracked_inactivity(false)
            .with_filter(Targets::new().with_target("meshmend", Level::INFO));
        tracing_subscriber::registry().with(log.with_filter(filter)).with(spans).init();
        Ok(Telemetry(provider))
    }

    /// The exporter of spans. Without a collector no span is exported, but spans still have trace ids, which appear in the log.
    fn tracer_provider(&self) -> Result<SdkTracerProvider, ExporterBuildError> {
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
            .with_timeout(EXPORT_TIMEOUT)
            .build()?;
        let sampler = Sampler::ParentBased(Box::new(Sampler::TraceIdRatioBased(self.trace_ratio)));
        Ok(provider.with_sampler(sampler).with_batch_exporter(exporter).build())
    }
}

/// Parses `--otlp-endpoint`.
fn parse_collector_url(text: &str) -> Result<Url, String> {
    match Url::parse(text) {
        Ok(url) if url.scheme() == "http" && url.has_host() => Ok(url),
        _ => {
            Err("expected http://host:port without TLS; to reach a remote collector, run a local one that forwards with TLS".to_owned())
        }
    }
}

/// Parses `--trace-ratio`.
fn parse_ratio(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|ratio| (0.0..=1.0).contains(ratio))
        .ok_or_else(|| "expected a number from 0 to 1".to_owned())
}

/// Installs the Prometheus recorder and its upkeep task.
///
/// # Errors
/// A recorder is already installed.
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
            tokio::time::sleep(UPKEEP_INTERVAL).await;
            upkeep.run_upkeep();
        }
    });
    Ok(handle)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_collector_needs_an_http_url_and_a_ratio_lies_between_0_and_1() {
        assert!(parse_collector_url("http://127.0.0.1:4318").is_ok());
        for text in ["", "127.0.0.1:4318", "https://collector:4318", "grpc://collector:4317", "http:"] {
            assert!(parse_collector_url(text).is_err(), "{text}");
        }
        assert_eq!([parse_ratio("0"), parse_ratio("0.25"), parse_ratio("1")], [Ok(0.0), Ok(0.25), Ok(1.0)]);
        for text in ["", "-0.1", "1.1", "NaN", "all"] {
            assert!(parse_ratio(text).is_err(), "{text}");
        }
    }
}
