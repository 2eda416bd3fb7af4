use tracing::Span;

use crate::context::Stage;
use crate::jobs::JobProgress;
use crate::telemetry::label;

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
