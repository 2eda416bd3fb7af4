use super::verdict::Judged;
use super::{Category, Context, Outcome, Report, StepStatus};
use crate::inspect::Measures;

/// The outcome in words, with what to do next where it is not good.
pub(super) fn in_words(outcome: Outcome, report: &Report, after: Option<&Measures>, context: &Context<'_>) -> String {
    let left = after.map_or_else(String::new, wrong);
    let mut text = match outcome {
        Outcome::AlreadyPrintable => return "The model is printable already; its geometry was not touched.".to_owned(),
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
                    back unchanged. Give it a thickness in a modelling program, or ask for the preset blender-remesh."
                .to_owned();
        }
        Outcome::Unrepairable => {
            format!("Nothing that ran made the model better; it is handed back unchanged: {left}.")
        }
    };
    if report.plan.category == Category::OpenSheet && outcome == Outcome::PartiallyRepaired {
        text.push_str(" It is an open surface that encloses nothing: give it a thickness in a modelling program.");
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

/// What is wrong with a mesh, as a list in words.
fn wrong(m: &Measures) -> String {
    let counts = [
        (m.boundary_edges, "open edges"),
        (m.nonmanifold_edges, "non-manifold edges"),
        (m.nonmanifold_vertices, "non-manifold vertices"),
        (m.misoriented_edges, "edges between faces of opposite winding"),
        (m.degenerate_faces, "degenerate faces"),
        (m.duplicate_faces, "duplicate faces"),
        (m.nonfinite_faces, "faces that are not finite"),
        (m.inverted_parts, "parts turned inside out"),
        (m.self_intersections.pairs.unwrap_or(0), "pairs of intersecting faces"),
    ];
    let mut found: Vec<String> =
        counts.iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}")).collect();
    if !m.self_intersections.complete {
        found.push("so many overlapping faces that they were not all counted".to_owned());
    }
    if found.is_empty() && !m.printable() {
        found.push("it encloses no volume".to_owned());
    }
    found.join(", ")
}

/// A verdict in words, for a validation step.
pub(super) fn verdict_in_words(judged: &Judged) -> String {
    let mut text = match wrong(&judged.measures) {
        fine if fine.is_empty() => "printable".to_owned(),
        left => format!("not printable: {left}"),
    };
    for flag in &judged.red_flags {
        text.push_str("; ");
        text.push_str(&flag.detail);
    }
    text
}
