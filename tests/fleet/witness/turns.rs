//! Whether tenants are served fairly.

use std::collections::BTreeMap;

use meshmend::jobs::{Job, Status};

use super::{Invariant, Witness, millis};

/// What counts for a tenant's turn.
#[derive(Default)]
struct Turn {
    running: u32,
    is_due: bool,
    claimed_at: Option<i64>,
}

impl Witness {
    /// Judges whose job was claimed at `now`, from the accounts before the claim.
    pub(super) fn check_turn(&mut self, now: i64, claimed: Option<&Job>) {
        let mut turns: BTreeMap<&str, Turn> = BTreeMap::new();
        for view in self.jobs.values() {
            let turn = turns.entry(&view.row.tenant).or_default();
            turn.running += u32::from(view.row.status == Status::Running);
            turn.is_due |= view.row.status == Status::Queued && millis(view.row.run_at) <= now;
            turn.claimed_at = turn.claimed_at.max(view.claimed_at);
        }
        let own = claimed.and_then(|job| turns.get(job.tenant.as_str()));
        let mut unfair = None;
        if let Some(own) = own.filter(|own| own.running >= self.max_running) {
            unfair = Some(format!("a tenant with {} running jobs was served", own.running));
        }
        for (tenant, other) in turns.iter().filter(|(_, turn)| turn.is_due && turn.running < self.max_running) {
            let is_passed_over = match own {
                None => claimed.is_none(),
                Some(own) if own.running != other.running => other.running < own.running,
                // By the clock nobody can tell who waited longer after it was set back.
                Some(own) => now >= self.latest && other.claimed_at < own.claimed_at,
            };
            if is_passed_over {
                unfair.get_or_insert(format!("tenant {tenant} was passed over"));
            }
        }
        if let Some(detail) = unfair {
            self.violated(Invariant::TenantsAreServedFairly, detail);
        }
    }
}
