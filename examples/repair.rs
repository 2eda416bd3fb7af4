//! Repairs a file with the library: `cargo run --release --example repair -- broken.off repaired.stl`.

use std::error::Error;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use meshmend::format::Limits;
use meshmend::repair::{Context, Options, OutputFormat, Progress, Stage, StepStatus, monotonic_clock, repair};

/// Prints the progress of the repair to standard error.
struct Percent;

impl Progress for Percent {
    fn report(&self, stage: Stage, _tier: Option<u8>, percent: u8) {
        let _ = writeln!(std::io::stderr(), "{stage:?} {percent} %");
    }

    fn log(&self, _line: &str) {}
}

/// Repairs one file into another, and prints what was done.
pub fn repair_file(broken: &Path, repaired: &Path, mut out: impl Write) -> Result<(), Box<dyn Error>> {
    let options = Options { output: OutputFormat::Stl, ..Options::default() };
    // Another thread may set this flag to end the repair.
    let cancel = AtomicBool::new(false);
    let clock = monotonic_clock();
    let context = Context::new(&Percent, &cancel, &clock, Duration::from_secs(60));
    // No remesher: tiers 1 and 2 run without Blender.
    let result = repair(&std::fs::read(broken)?, &options, &Limits::default(), None, &context)?;

    let report = &result.report;
    writeln!(out, "{}", report.summary)?;
    for step in report.steps.iter().filter(|step| step.status == StepStatus::Done) {
        for change in &step.changed {
            writeln!(out, "  {}: {}", change.kind.as_str().replace('_', " "), change.count)?;
        }
    }
    if let Some(after) = &report.after {
        writeln!(out, "{} faces before, {} after", report.before.measures.faces, after.measures.faces)?;
    }
    for flag in &report.red_flags {
        writeln!(out, "red flag: {}", flag.detail)?;
    }
    std::fs::write(repaired, &result.bytes)?;
    Ok(())
}

#[cfg_attr(test, expect(dead_code, reason = "the tests call repair_file"))]
fn main() -> Result<(), Box<dyn Error>> {
    let mut paths = std::env::args_os().skip(1).map(PathBuf::from);
    let (Some(broken), Some(repaired)) = (paths.next(), paths.next()) else {
        return Err("usage: repair BROKEN REPAIRED".into());
    };
    repair_file(&broken, &repaired, std::io::stdout())
}
