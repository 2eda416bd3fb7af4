use std::io::{self, IsTerminal};
use std::time::Duration;

use clap::{Args, ValueEnum};
use meshmend::telemetry;
use metrics_exporter_prometheus::{BuildError, Matcher, PrometheusBuilder, PrometheusHandle};

/// How often recorded values are sorted into their buckets.
const UPKEEP: Duration = Duration::from_secs(5);

/// What the service tells of itself.
#[derive(Debug, Args)]
pub struct LogArgs {
    /// What to log, as `level` or `target=level,...`.
    #[arg(long, env = "MESHMEND_LOG", default_value = "info")]
    log: String,
    /// How log lines look.
    #[arg(long, env = "MESHMEND_LOG_FORMAT", value_enum, default_value_t)]
    log_format: LogFormat,
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

impl LogArgs {
    /// Begins to log.
    pub fn start(&self) -> Result<(), String> {
        let filter = tracing_subscriber::EnvFilter::try_new(format!("sqlx=warn,{}", self.log))
            .map_err(|e| format!("--log '{}': {e}", self.log))?;
        let builder = tracing_subscriber::fmt().with_env_filter(filter).with_writer(io::stderr);
        match self.log_format {
            LogFormat::Text => builder.with_ansi(io::stderr().is_terminal()).init(),
            LogFormat::Json => builder.json().init(),
        }
        Ok(())
    }
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
