pub mod options;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use clap::Args;
use meshmend::blender::OnDemandBlender;
use meshmend::jobs::JobReport;
use meshmend::render::Drawing;
use meshmend::repair::{Context, HandedOut, RepairError, Repaired, Report, draw, monotonic_clock, repair};

use self::options::{RepairOptionArgs, format_named};
use super::engine::{Bar, BlenderArgs, LimitArgs, read_file, remarks};
use super::exit;
use super::files::write_file;

/// Arguments of `meshmend repair`.
#[derive(Debug, Args)]
pub struct RepairArgs {
    /// The model: STL, OBJ, PLY, OFF, 3MF, GLB, glTF, Vertex/Face text, or a ZIP archive of one of them, told by its content.
    input: PathBuf,
    /// Where the result goes; its ending (.stl, .obj, .ply, .off, .mesh, .glb, .3mf, .zip) is the format.
    #[arg(short, long, env = "MESHMEND_OUTPUT")]
    output: PathBuf,
    /// Where the report goes, as JSON.
    #[arg(long, env = "MESHMEND_REPORT", value_name = "FILE")]
    report: Option<PathBuf>,
    #[command(flatten)]
    options: RepairOptionArgs,
    /// Where to draw what was found and what was changed: before.png, after.png, defects.glb, defects.ply, change.png, change.glb
    /// and change.ply. The folder is made.
    #[arg(long, env = "MESHMEND_PICTURES", value_name = "FOLDER")]
    pictures: Option<PathBuf>,
    /// Show what each step does.
    #[arg(short, long, env = "MESHMEND_VERBOSE")]
    verbose: bool,
    #[command(flatten)]
    limits: LimitArgs,
    #[command(flatten)]
    blender: BlenderArgs,
}

/// Runs `meshmend repair`.
pub fn run(args: &RepairArgs) -> ExitCode {
    let options = format_named(&args.output).and_then(|format| args.options.options(format));
    let prepared = options.and_then(|options| {
        let limits = args.limits.limits();
        read_file(&args.input, &limits).map(|bytes| (options, limits, bytes))
    });
    let (options, limits, bytes) = match prepared {
        Ok(prepared) => prepared,
        Err(message) => return exit::fail(exit::BAD_INPUT, message),
    };
    let cancel = stop_on_interrupt();
    let clock = monotonic_clock();
    let bar = Bar::new(args.verbose);
    let context = Context::new(&bar, &cancel, &clock, Duration::from_secs_f64(options.deadline_s));
    let blender = OnDemandBlender::new(args.blender.config());
    let repaired = repair(&bytes, &options, &limits, Some(&blender), &context);
    bar.finish();
    let repaired = match repaired {
        Ok(repaired) => repaired,
        Err(error @ (RepairError::Read(_) | RepairError::Options(_))) => {
            return exit::fail(exit::BAD_INPUT, format!("{}: {error}", args.input.display()));
        }
        Err(error) => return exit::fail(exit::INTERNAL, error),
    };
    if let Err(message) = write(args, &repaired) {
        return exit::fail(exit::INTERNAL, message);
    }
    if let Some(folder) = &args.pictures {
        let result = (repaired.report.verdict.file != HandedOut::None).then_some(repaired.bytes.as_slice());
        match draw(&bytes, result, &options, &limits, &context) {
            Ok(drawings) => {
                if let Err(message) = write_drawings(folder, "", &drawings) {
                    return exit::fail(exit::INTERNAL, message);
                }
            }
            // The result is there, and how good it is does not hang on its pictures.
            Err(error) => drop(writeln!(std::io::stderr(), "  note: without pictures: {error}")),
        }
    }
    tell(&repaired.report, &args.output);
    ExitCode::from(exit::of(&repaired.report))
}

/// Writes the model, where one is handed out, and the report, where it is wanted.
fn write(args: &RepairArgs, repaired: &Repaired) -> Result<(), String> {
    if repaired.report.verdict.file != HandedOut::None {
        write_file(&args.output, &repaired.bytes)?;
    }
    let Some(path) = &args.report else { return Ok(()) };
    let report = JobReport::Repair(Box::new(repaired.report.clone()));
    serde_json::to_vec_pretty(&report).map_err(|e| e.to_string()).and_then(|json| write_file(path, &json))
}

/// Writes drawings into a folder, which is made where it is not there, under their names after a prefix.
pub fn write_drawings(folder: &Path, prefix: &str, drawings: &[Drawing]) -> Result<(), String> {
    std::fs::create_dir_all(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    drawings
        .iter()
        .try_for_each(|drawing| write_file(&folder.join(format!("{prefix}{}", drawing.name)), &drawing.bytes))
}

/// The result in a few lines on standard error, so that standard output stays free. Where nothing was written, the last line says so.
fn tell(report: &Report, output: &Path) {
    let output = output.display();
    let mut lines = vec![format!("{output}: {}", report.summary)];
    let flags = report.red_flags.iter().map(|flag| flag.detail.as_str());
    let assumptions = report.assumptions.iter().map(|it| (it.detail.as_str(), it.option.as_deref()));
    lines.extend(remarks(flags, assumptions, &report.warnings));
    if report.refusal().is_some() {
        lines.push(format!(
            "meshmend: {output} was not written: the result is not printable, which --require printable asks for"
        ));
    } else if report.verdict.file == HandedOut::None {
        lines.push(format!("meshmend: {output} was not written: there is no model that could be"));
    }
    let _ = writeln!(std::io::stderr(), "{}", lines.join("\n"));
}

/// Cancels the repair at the first interrupt, so that Blender and its scratch folder are cleared away.
fn stop_on_interrupt() -> Arc<AtomicBool> {
    let cancel = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&cancel);
    std::thread::spawn(move || {
        let Ok(runtime) = tokio::runtime::Builder::new_current_thread().enable_all().build() else { return };
        runtime.block_on(async {
            while tokio::signal::ctrl_c().await.is_ok() {
                if flag.swap(true, Ordering::Relaxed) {
                    std::process::exit(exit::INTERRUPTED.into());
                }
            }
        });
    });
    cancel
}
