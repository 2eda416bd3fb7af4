//! `meshmend compare`: measures how one model differs from another.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use clap::Args;
use meshmend::format::{Limits, ReadMesh, read};
use meshmend::inspect::{Analysis, CompareOptions, Comparison, Deviation, Measures, Original, measures};
use meshmend::repair::{Cancelled, Context, monotonic_clock};

use super::engine::{LimitArgs, ProgressReporter, read_file};
use super::exit;

/// Arguments of `meshmend compare`.
#[derive(Debug, Args)]
pub struct CompareArgs {
    /// The original model: STL, OBJ, PLY or OFF. The content decides the format, not the name.
    before: PathBuf,
    /// The changed model.
    after: PathBuf,
    /// Print JSON instead of text.
    #[arg(long, env = "MESHMEND_JSON")]
    json: bool,
    /// Maximum number of sample points on each surface, of vertices of each surface, and of points in the bounding
    /// box.
    #[arg(long, env = "MESHMEND_SAMPLES", default_value_t = CompareOptions::default().samples, value_parser = clap::value_parser!(u32).range(100..=10_000_000))]
    samples: u32,
    #[command(flatten)]
    limits: LimitArgs,
}

/// Runs `meshmend compare`.
pub fn run(args: &CompareArgs) -> ExitCode {
    let limits = args.limits.limits();
    let files = read_model(&args.before, &limits).and_then(|before| Ok([before, read_model(&args.after, &limits)?]));
    let files = match files {
        Ok(files) => files,
        Err(message) => return exit::fail(exit::BAD_INPUT, message),
    };
    let options = CompareOptions { samples: args.samples, vertices: args.samples, inside: args.samples };
    let (before, after, comparison) = match measure(&files, options) {
        Ok(measured) => measured,
        Err(error) => return exit::fail(exit::INTERNAL, error),
    };
    let text = if args.json {
        let side = |file: &ReadMesh, measures: &Measures| {
            serde_json::json!({
                "format": file.format, "dialect": file.dialect, "measures": measures, "warnings": file.warnings,
            })
        };
        let (before, after) = (side(&files[0], &before), side(&files[1], &after));
        let value = serde_json::json!({ "before": before, "after": after, "comparison": comparison });
        format!("{value:#}\n")
    } else {
        as_text(&before, &after, &comparison)
    };
    if let Err(error) = std::io::stdout().write_all(text.as_bytes()) {
        return exit::fail(exit::INTERNAL, error);
    }
    ExitCode::from(if comparison.faithful { exit::PRINTABLE } else { exit::PARTIAL })
}

/// Reads one model.
fn read_model(path: &Path, limits: &Limits) -> Result<ReadMesh, String> {
    let bytes = read_file(path, limits)?;
    read(&bytes, limits).map_err(|error| format!("{}: {error}", path.display()))
}

/// Measures both models and compares them.
fn measure(files: &[ReadMesh; 2], options: CompareOptions) -> Result<(Measures, Measures, Comparison), Cancelled> {
    let (clock, cancel, progress) = (monotonic_clock(), AtomicBool::new(false), ProgressReporter::new(false));
    let context = Context::new(&progress, &cancel, &clock, Duration::MAX);
    let before = Analysis::new((&files[0].soup).into(), &context)?;
    let after = Analysis::new((&files[1].soup).into(), &context)?;
    let (measured, measured_after) = (measures(&before, &context)?, measures(&after, &context)?);
    let comparison = Original::new(&before, &measured, options).compare(&after, &measured_after, &context)?;
    progress.finish();
    Ok((measured, measured_after, comparison))
}

fn as_text(before: &Measures, after: &Measures, comparison: &Comparison) -> String {
    let changes = &comparison.changes;
    let signed = |pct: Option<f64>| pct.map_or_else(String::new, |pct| format!("{pct:+.3} %"));
    let number = |x: f64| format!("{x:.6}");
    let volume = |m: &Measures| format!("{}{}", number(m.volume.value), if m.volume.reliable { "" } else { " ?" });
    let mut text = format!("{:<24}{:>18}{:>18}{:>16}\n", "", "before", "after", "change");
    let mut row = |name: &str, before: String, after: String, change: String| {
        let _ = writeln!(text, "{name:<24}{before:>18}{after:>18}{change:>16}");
    };
    for (name, before, after, change) in [
        ("faces", before.faces, after.faces, changes.faces),
        ("vertices", before.vertices, after.vertices, changes.vertices),
        ("parts", before.parts, after.parts, changes.parts),
    ] {
        row(name, before.to_string(), after.to_string(), format!("{change:+}"));
    }
    row("area", number(before.area), number(after.area), signed(changes.area_change_pct));
    row("volume", volume(before), volume(after), signed(changes.volume_change_pct));
    let diagonal = |m: &Measures| m.bounding_box.map_or_else(|| "-".to_owned(), |b| number(b.diagonal()));
    row("bounding box diagonal", diagonal(before), diagonal(after), String::new());
    let mut line = |name: &str, value: String| {
        let _ = writeln!(text, "{name:<24}{value}");
    };
    let percent = |pct: Option<f64>| pct.map_or_else(|| "-".to_owned(), |pct| format!("{pct:.3} %"));
    line("faces kept", percent(Some(changes.faces_kept_pct)));
    line("bounding box moved by", percent(changes.bounding_box_change_pct));
    line("visible surface lost", percent(changes.surface_lost_pct));
    if let Some(inside) = comparison.inside {
        line("inside and outside agree", format!("{:.3} % of {} points", inside.agree_pct, inside.points));
        line("both inside", percent(inside.overlap_pct));
    }
    line("faithful", if comparison.faithful { "yes" } else { "no" }.to_owned());
    let deviations = [
        ("visible before to after", &changes.lost),
        ("before to after", &comparison.deviation),
        ("after to before", &changes.added),
    ];
    if deviations.iter().any(|(_, deviation)| deviation.is_some()) {
        let headers = ["max", "mean", "rms", "50 %", "95 %", "99 %"].map(|header| format!("{header:>12}")).concat();
        let _ = writeln!(text, "\n{:<24}{headers}", "distance");
    }
    for (name, deviation) in deviations {
        if let Some(deviation) = deviation {
            append_distances(&mut text, name, deviation);
        }
    }
    text
}

/// Appends the distances in one direction, in the model's unit and in percent of the diagonal.
fn append_distances(text: &mut String, name: &str, deviation: &Deviation) {
    for (name, spread, unit) in [(name, deviation.distance, ""), ("", deviation.percent, " %")] {
        let _ = write!(text, "{name:<24}");
        for value in [spread.max, spread.mean, spread.rms, spread.p50, spread.p95, spread.p99] {
            let _ = write!(text, "{:>12}", format!("{value:.5}{unit}"));
        }
        let _ = writeln!(text);
    }
    let at = deviation.farthest.map(|x| format!("{x:.5}")).join(", ");
    let rest = if deviation.complete { "" } else { "; some could not be measured" };
    let _ = writeln!(
        text,
        "{:<24}farthest at ({at}); {} samples, {} vertices{rest}",
        "", deviation.samples, deviation.vertices
    );
}
