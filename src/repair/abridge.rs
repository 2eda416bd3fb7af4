use std::ops::Deref;

use serde::{Deserialize, Serialize, Serializer};

use super::{Candidate, Ledger, Options, Plan, Report, Step, StepStatus};

/// Options as a report writes them.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(from = "Options")]
pub struct ReportedOptions {
    options: Options,
    /// Whether options that have their default are left out.
    only_changed: bool,
}

impl From<Options> for ReportedOptions {
    fn from(options: Options) -> Self {
        Self { options, only_changed: false }
    }
}

impl Deref for ReportedOptions {
    type Target = Options;

    fn deref(&self) -> &Options {
        &self.options
    }
}

impl Serialize for ReportedOptions {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if self.only_changed {
            self.options.to_changed_fields().serialize(serializer)
        } else {
            self.options.serialize(serializer)
        }
    }
}

impl Report {
    /// Shortens each list to its first `most` items, and leaves out statistics, planned operators, strategies that did not run and steps
    /// of tiers 1 and 2 that changed nothing. Counts, the verdict, flags and assumptions stay.
    pub fn abridge(&mut self, most: usize) {
        self.abridged = true;
        self.options.only_changed = true;
        self.before.abridge(most);
        // What is printed is the result, where there is one: of the input its size is enough.
        if self.after.as_ref().is_some_and(|after| after.print.is_some())
            && let Some(print) = &mut self.before.print
        {
            print.thinnest_wall = None;
            print.overhang.beyond.clear();
        }
        self.after.iter_mut().for_each(|after| after.abridge(most));
        self.ledger.iter_mut().for_each(|ledger| abridge_ledger(ledger, most));
        self.plan.abridge(&self.steps);
        abridge_steps(&mut self.steps, most);
        abridge_candidates(&mut self.candidates, most);
        self.objects.truncate(most);
        for object in &mut self.objects {
            object.before.abridge(most);
            object.after.iter_mut().for_each(|after| after.abridge(most));
            object.ledger.iter_mut().for_each(|ledger| abridge_ledger(ledger, most));
            object.plan.abridge(&object.steps);
            abridge_steps(&mut object.steps, most);
            abridge_candidates(&mut object.candidates, most);
        }
    }
}

impl Plan {
    /// Leaves out the strategies after the last that ran, and the operators of each action: the steps name those that did something.
    fn abridge(&mut self, steps: &[Step]) {
        let ran =
            steps.iter().filter(|step| step.status != StepStatus::Skipped).map(|step| step.rung as usize + 1).max();
        self.rungs.truncate(ran.unwrap_or(0));
        for action in self.rungs.iter_mut().flat_map(|rung| &mut rung.actions) {
            action.operators.clear();
        }
    }
}

fn abridge_ledger(ledger: &mut Ledger, most: usize) {
    ledger.certificates.truncate(most);
    ledger.lost_parts.truncate(most);
}

/// Keeps steps that changed something or went wrong, and of them the first `8 * most`.
fn abridge_steps(steps: &mut Vec<Step>, most: usize) {
    steps.retain(|step| match step.status {
        StepStatus::Done => !step.changed.is_empty() || step.program.is_some() || step.unfixed.is_some(),
        StepStatus::Failed | StepStatus::Undone => true,
        // That there is no Blender is worth knowing.
        StepStatus::Skipped => step.tier == 3,
    });
    steps.truncate(8 * most);
    for faces in steps.iter_mut().filter_map(|step| step.unfixed.as_mut()) {
        faces.faces.truncate(most);
    }
}

/// Keeps the chosen candidate and the first `most`; the flags of the chosen one are those of the report.
fn abridge_candidates(candidates: &mut Vec<Candidate>, most: usize) {
    let mut kept = 0;
    candidates.retain(|candidate| {
        kept += usize::from(!candidate.chosen);
        candidate.chosen || kept <= most
    });
    for candidate in candidates {
        candidate.red_flags.iter_mut().for_each(|flag| flag.places.clear());
        if candidate.chosen {
            candidate.red_flags.clear();
        }
    }
}
