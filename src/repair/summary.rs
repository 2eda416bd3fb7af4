use super::verdict::Judged;
use super::{Category, Context, Operator, Outcome, Report, Step, StepStatus};
use crate::inspect::Measures;

/// The outcome in words, with what to do next where it is not good.
pub(super) fn in_words(outcome: Outcome, report: &Report, after: Option<&Measures>, context: &Context<'_>) -> String {
    let left = after.map_or_else(String::new, |after| after.faults().join(", "));
    let mut text = match outcome {
        Outcome::AlreadyPrintable => return "The model is printable already; its geometry was not touched.".to_owned(),
        Outcome::Repaired if report.before.measures.printable() && report.options.asks_for_fewer_faces() => {
            return "The model was printable already; it has fewer faces now, as was asked for.".to_owned();
        }
        Outcome::Repaired => return "The model was repaired and is printable.".to_owned(),
        Outcome::PartiallyRepaired if left.is_empty() => {
            "The result is printable, but a red flag is up: compare it with the original before you print it."
                .to_owned()
        }
        Outcome::PartiallyRepaired => format!("The model is better than it was, but not printable: {left}."),
        Outcome::Unrepairable if after.is_none() => {
            "The file has no face that could be written: nothing is handed out. Export the model again.".to_owned()
        }
        Outcome::Unrepairable if report.plan.category == Category::OpenSheet => {
            return "The model is an open surface that encloses nothing, so there is no solid to print; it is handed \
                    back unchanged. Ask for open_sheets thicken or base to have it made solid."
                .to_owned();
        }
        Outcome::Unrepairable => {
            format!("Nothing that ran made the model better; it is handed back unchanged: {left}.")
        }
    };
    if report.plan.category == Category::OpenSheet && outcome == Outcome::PartiallyRepaired {
        text.push_str(
            " It is an open surface that encloses nothing: ask for open_sheets thicken or base to have it made solid.",
        );
    }
    if context.remaining().is_zero() {
        text.push_str(" The time was over before everything was tried: raise deadline_s.");
    }
    let skipped = report.steps.iter().any(|s| s.tier == 3 && s.status == StepStatus::Skipped);
    if skipped {
        text.push_str(" A remesh with Blender was planned and could not run.");
    } else if report.options.max_tier < 3 {
        text.push_str(" Raising max_tier to 3 lets Blender try.");
    }
    text
}

/// What was left when faces were to be removed and none was.
pub(super) fn why_no_face_went(steps: &[Step]) -> Option<String> {
    let last = steps.iter().rev().find(|step| step.operator == Some(Operator::Simplify))?;
    Some(last.note.clone().unwrap_or_else(|| "no face could be removed".to_owned()))
}

/// What the steps that led to a result made that the input does not describe, for a person to know.
pub(super) fn liberties(steps: &[Step], rung: Option<u32>) -> Vec<String> {
    let took = |operator, what: &str| {
        let of_rung = steps.iter().filter(|s| Some(s.rung) == rung && s.status == StepStatus::Done);
        let changes = of_rung.filter(|s| s.operator == Some(operator)).flat_map(|s| &s.changed);
        changes.filter(|change| change.what == what).map(|change| change.count).sum::<u64>()
    };
    let words = [
        (
            took(Operator::JoinParts, "parts_joined"),
            "bands of surface join parts that were apart, which changes the model",
        ),
        (took(Operator::ThickenSheets, "sheets_thickened"), "open parts enclose nothing and were given a thickness"),
        (
            took(Operator::Resolve, "faces_around_open_rooms_thickened"),
            "faces around rooms into which one can look through holes were given a thickness, and the rooms left open",
        ),
        (took(Operator::AddBase, "bases_added"), "open parts enclose nothing and were put on a base"),
    ];
    words.into_iter().filter(|w| w.0 > 0).map(|(count, what)| format!("{count} {what}")).collect()
}

/// A verdict in words, for a validation step.
pub(super) fn verdict_in_words(judged: &Judged) -> String {
    let mut text = match judged.measures.faults().join(", ") {
        fine if fine.is_empty() => "printable".to_owned(),
        left => format!("not printable: {left}"),
    };
    for flag in &judged.red_flags {
        text.push_str("; ");
        text.push_str(&flag.detail);
    }
    text
}
