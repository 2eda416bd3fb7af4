use tracing::Span;

use crate::context::Stage;
use crate::jobs::{Job, JobProgress};
use crate::repair::Step;
use crate::telemetry::{self, label};

/// The stages of a child's work as spans of a trace, by its lines of progress: each lasts until the next.
#[derive(Default)]
pub(super) struct Stages {
    now: Option<(Stage, Option<u8>)>,
    span: Option<Span>,
}

impl Stages {
    pub fn at(&mut self, progress: JobProgress) {
        let JobProgress { stage, tier, .. } = progress;
        if self.now != Some((stage, tier)) {
            let name = tier.map_or_else(|| label(&stage), |tier| format!("{} tier {tier}", label(&stage)));
            self.span = None;
            self.span = Some(tracing::info_span!("stage", otel.name = name, stage = ?stage, tier));
            self.now = Some((stage, tier));
        }
    }
}

/// Counts and times what a repair did, by its report.
pub(super) fn record_steps(steps: &[Step]) {
    for step in steps {
        let (tier, action) = (step.tier.to_string(), label(&step.action));
        metrics::histogram!(telemetry::STEP, "tier" => tier.clone(), "action" => action.clone())
            .record(step.milliseconds / 1000.0);
        metrics::counter!(telemetry::STEPS, "tier" => tier, "action" => action, "status" => label(&step.status))
            .increment(1);
        metrics::counter!(telemetry::BLENDER_RUNS).increment(step.runs.into());
        metrics::counter!(telemetry::BLENDER_RESTARTS).increment(step.runs.saturating_sub(1).into());
    }
}

/// Logs and counts how an attempt ended, in the span of the attempt.
pub(super) fn record_end(job: &Job, milliseconds: u64) {
    let status = job.status.as_str();
    let outcome = job.outcome.map(|outcome| label(&outcome));
    let code = job.problem.as_ref().map(|problem| label(&problem.code));
    // A field without a value is left out of the line.
    tracing::info!(status, outcome = outcome.as_deref(), code = code.as_deref(), milliseconds, "attempt ended");
    if let Some(code) = code {
        telemetry::failed(&Span::current(), code);
    }
    let outcome = outcome.unwrap_or_default();
    metrics::counter!(telemetry::ATTEMPTS, "status" => status, "outcome" => outcome).increment(1);
}
