use super::account::Ended;
use super::assumed::counted;
use super::input::Input;
use super::requests::ask_of_printable;
use super::verdict::Judged;
use super::{Category, ChangeKind, LeftOut, Operator, Options, Outcome, Step, StepStatus};
use crate::inspect::{DefectKind, Inspection};

/// What a printable result keeps though it is not ideal, in words; empty where there is nothing of the kind.
pub(super) fn what_remains(after: &Inspection) -> String {
    if !after.measures.printable() {
        return String::new();
    }
    let kinds = [(DefectKind::DegenerateFace, "with a very short edge"), (DefectKind::FlatFace, "of almost no height")];
    let found = kinds.map(|(kind, what)| {
        let count = after.count(kind);
        (count > 0).then(|| format!("{} {what}", counted(count, "face", "faces")))
    });
    let remaining: Vec<String> = found.into_iter().flatten().collect();
    if remaining.is_empty() {
        return String::new();
    }
    format!(" Left as found, since slicers accept them: {}.", remaining.join(", "))
}

/// The outcome in words, with what to do next where it is not good.
pub(super) fn in_words(ended: &Ended, input: &Input<'_>, options: &Options) -> String {
    let outcome = ended.outcome;
    let after = ended.judged.as_ref().map(|judged| &judged.measures);
    let out_of_time = input.time.left_out();
    let is_left_out = |what| out_of_time.contains(&what);
    let was_printable = input.before.measures.printable();
    let deadline = options.deadline_s;
    let left = after.map_or_else(String::new, |after| after.faults().join(", "));
    let mut text = match outcome {
        Outcome::AlreadyPrintable => return "The model is printable already; its geometry was not touched.".to_owned(),
        Outcome::Repaired if was_printable && options.asks_for_fewer_faces() => {
            return "The model was printable already; it has fewer faces now, as was asked for.".to_owned();
        }
        Outcome::Repaired if was_printable && ask_of_printable(options) => {
            return "The model was printable already; it was changed as the options ask.".to_owned();
        }
        Outcome::Repaired => return "The model was repaired and is printable.".to_owned(),
        Outcome::PartiallyRepaired if left.is_empty() => {
            "The result passes every check, but a red flag is up: compare it with the original before you print it."
                .to_owned()
        }
        Outcome::PartiallyRepaired => format!("The model is better than it was, but not printable: {left}."),
        Outcome::Unrepairable if is_left_out(LeftOut::InputVerification) => {
            return format!(
                "The deadline of {deadline} s came before the model was inspected, so it is not known whether it is printable; it is {}. \
                 Raise deadline_s.",
                if after.is_some() { "handed back unchanged" } else { "not handed out" }
            );
        }
        Outcome::Unrepairable if after.is_none() && is_left_out(LeftOut::Verification) => {
            return format!(
                "The deadline of {deadline} s came before a result was verified, so nothing is handed out. Raise deadline_s."
            );
        }
        Outcome::Unrepairable if after.is_none() => {
            "The file has no face that could be written: nothing is handed out. Export the model again.".to_owned()
        }
        Outcome::Unrepairable if ended.plan.category == Category::OpenSheet => {
            return "The model is an open surface that encloses nothing, so there is no solid to print; it is handed \
                    back unchanged. Ask for open_sheets thicken or base to have it made solid."
                .to_owned();
        }
        Outcome::Unrepairable if is_left_out(LeftOut::Repair) => {
            format!("Nothing made the model better in the time there was; it is handed back unchanged: {left}.")
        }
        Outcome::Unrepairable => {
            format!("Nothing that ran made the model better; it is handed back unchanged: {left}.")
        }
    };
    if ended.plan.category == Category::OpenSheet && outcome == Outcome::PartiallyRepaired {
        text.push_str(
            " It is an open surface that encloses nothing: ask for open_sheets thicken or base to have it made solid.",
        );
    }
    if let Some(left) = left_open_by_options(&ended.steps) {
        text.push_str(&left);
    }
    if is_left_out(LeftOut::Repair) || is_left_out(LeftOut::Verification) {
        text.push_str(&format!(" The deadline of {deadline} s came before everything was tried: raise deadline_s."));
    }
    let skipped = ended.steps.iter().any(|s| s.tier == 3 && s.status == StepStatus::Skipped);
    if skipped {
        text.push_str(" A remesh with Blender was planned and could not run.");
    } else if options.max_tier < 3 {
        text.push_str(" Raising max_tier to 3 lets Blender try.");
    }
    text
}

/// The holes that the options leave open, with what to do.
fn left_open_by_options(steps: &[Step]) -> Option<String> {
    let changes = steps.iter().filter(|step| step.status == StepStatus::Done).flat_map(|step| &step.changed);
    let most = changes.filter(|it| it.what == ChangeKind::HolesOverLimit).map(|it| it.count).max()?;
    let plural = if most == 1 { "hole was" } else { "holes were" };
    Some(format!(
        " {most} {plural} left open by max_hole_edges, max_hole_size or max_holes: raise them, or set open_sheets=thicken for a \
         shell."
    ))
}

/// What was left when faces were to be removed and none was.
pub(super) fn why_no_face_went(steps: &[Step]) -> Option<String> {
    let last = steps.iter().rev().find(|step| step.operator == Some(Operator::Simplify))?;
    Some(last.note.clone().unwrap_or_else(|| "no face could be removed".to_owned()))
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
