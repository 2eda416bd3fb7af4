//! Shared by the commands that work on local files: limits, Blender, reading and writing files, progress, and remarks on a result.

use std::fs::File;
use std::io::{Read, Write};
use std::path::Path;

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
#[cfg(target_os = "linux")]
use meshmend::blender::BlenderConfig;
use meshmend::format::Limits;
use meshmend::repair::{Progress, Stage};
use tempfile::NamedTempFile;

/// The limits of reading a file.
#[derive(Debug, Clone, Args)]
pub struct LimitArgs {
    /// Largest file, or total size of the files of one job, in MiB.
    #[arg(long, env = "MESHMEND_MAX_FILE_MIB", default_value_t = 512, value_parser = clap::value_parser!(u64).range(1..=65_536))]
    pub max_file_mib: u64,
    /// Maximum number of triangles in a file.
    #[arg(long, env = "MESHMEND_MAX_FILE_FACES", default_value_t = Limits::default().max_faces)]
    pub max_file_faces: u64,
    /// Maximum number of vertices in a file.
    #[arg(long, env = "MESHMEND_MAX_FILE_VERTICES", default_value_t = Limits::default().max_vertices)]
    pub max_file_vertices: u64,
}

impl LimitArgs {
    /// The limits as the readers take them.
    pub fn limits(&self) -> Limits {
        Limits {
            max_bytes: self.max_file_mib << 20,
            max_faces: self.max_file_faces,
            max_vertices: self.max_file_vertices,
        }
    }
}

/// The Blender to use, and its memory.
#[cfg(target_os = "linux")]
#[derive(Debug, Clone, Args)]
pub struct BlenderArgs {
    /// Blender program, or a Python that has the module bpy. Default: `blender` on PATH, then `.venv-blender`.
    #[arg(long, env = "MESHMEND_BLENDER", value_name = "PROGRAM")]
    pub blender: Option<std::path::PathBuf>,
    /// Memory for one Blender process, in MiB. Voxels are enlarged until the estimate is below this limit. 0: no
    /// limit.
    #[arg(long, env = "MESHMEND_BLENDER_MEMORY_MIB", default_value_t = 4096)]
    pub blender_memory_mib: u64,
    /// Memory for all Blender processes on this machine together, in MiB, which limits how many run at once.
    /// Default: half of the machine's memory.
    #[arg(long, env = "MESHMEND_BLENDER_TOTAL_MEMORY_MIB")]
    pub blender_total_memory_mib: Option<u64>,
    /// Folder of the lock files with which all processes on this machine share the Blender slots. Default: one folder
    /// per user in /tmp.
    #[arg(long, env = "MESHMEND_BLENDER_SLOTS", value_name = "FOLDER")]
    pub blender_slots: Option<std::path::PathBuf>,
}

#[cfg(target_os = "linux")]
impl BlenderArgs {
    /// The settings as the Blender module takes them.
    pub fn config(&self) -> BlenderConfig {
        BlenderConfig {
            program: self.blender.clone(),
            memory: self.blender_memory_mib.saturating_mul(1 << 20),
            memory_together: self.blender_total_memory_mib.map(|mib| mib.saturating_mul(1 << 20)),
            // Jobs run in another working directory, so the path must be absolute.
            slots: self.blender_slots.as_ref().map(|path| std::path::absolute(path).unwrap_or_else(|_| path.clone())),
            ..BlenderConfig::default()
        }
    }
}

/// Reads a file, up to `limits.max_bytes`.
///
/// # Errors
/// The path with what is wrong: the file is unreadable or too large.
pub fn read_file(path: &Path, limits: &Limits) -> Result<Vec<u8>, String> {
    let name = path.display();
    let file = File::open(path).map_err(|e| format!("{name}: {e}"))?;
    // The stated length saves growing the list; a pipe states none.
    let stated = file.metadata().map_or(0, |metadata| metadata.len().min(limits.max_bytes));
    let mut bytes = Vec::with_capacity(usize::try_from(stated).unwrap_or(0));
    file.take(limits.max_bytes.saturating_add(1)).read_to_end(&mut bytes).map_err(|e| format!("{name}: {e}"))?;
    if bytes.len() as u64 > limits.max_bytes {
        return Err(format!("{name}: the file is larger than {} MiB; raise --max-file-mib", limits.max_bytes >> 20));
    }
    Ok(bytes)
}

/// Creates a temporary file in the folder of `path`. It is deleted unless it is renamed to `path`, so no partial file is ever visible.
///
/// # Errors
/// The folder is missing or not writable.
pub fn temporary_file_next_to(path: &Path) -> std::io::Result<NamedTempFile> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut builder = tempfile::Builder::new();
    builder.prefix(".meshmend-");
    // Elsewhere the folder decides who may read the file.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o644));
    builder.tempfile_in(folder)
}

/// Writes a file atomically: into a temporary file, which is then renamed.
///
/// # Errors
/// The path with the message of the operating system.
pub fn write_file(path: &Path, bytes: &[u8]) -> Result<(), String> {
    let name = path.display();
    let mut file = temporary_file_next_to(path).map_err(|e| format!("{name}: {e}"))?;
    file.write_all(bytes).map_err(|e| format!("{name}: {e}"))?;
    file.persist(path).map_err(|e| format!("{name}: {}", e.error))?;
    Ok(())
}

/// Shows progress as a bar on a terminal, and nothing elsewhere.
pub struct ProgressReporter {
    bar: ProgressBar,
    verbose: bool,
}

impl ProgressReporter {
    /// Starts at 0 %; `verbose` also prints the log of the steps.
    pub fn new(verbose: bool) -> Self {
        let bar = ProgressBar::new(100);
        if let Ok(style) = ProgressStyle::with_template("{msg:24} [{bar:40}] {percent:>3} %  {elapsed}") {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.enable_steady_tick(std::time::Duration::from_millis(200));
        Self { bar, verbose }
    }

    /// Removes the bar.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

impl Progress for ProgressReporter {
    fn report(&self, stage: Stage, tier: Option<u8>, percent: u8) {
        self.bar.set_message(stage_description(stage, tier));
        self.bar.set_position(u64::from(percent));
    }

    fn log(&self, line: &str) {
        if self.verbose {
            self.bar.suspend(|| {
                let _ = writeln!(std::io::stderr(), "{line}");
            });
        }
    }
}

/// Describes a stage for the progress display.
pub fn stage_description(stage: Stage, tier: Option<u8>) -> String {
    let stage = match stage {
        Stage::Read => "reading",
        Stage::Inspect => "inspecting",
        Stage::Repair => "repairing",
        Stage::Wait => "waiting for Blender",
        Stage::Verify => "verifying",
        Stage::Finish => "finishing",
    };
    tier.map_or_else(|| stage.to_owned(), |tier| format!("{stage}, tier {tier}"))
}

/// Converts an option of the API, `name=value`, to the flag `--name value`.
fn flag_of_option(option: &str) -> String {
    let (name, value) = option.split_once('=').map_or((option, None), |(name, value)| (name, Some(value)));
    let name = name.replace('_', "-");
    value.map_or_else(|| format!("--{name}"), |value| format!("--{name} {value}"))
}

/// The lines below a summary: red flags, assumptions with the flag that changes each, and warnings.
pub fn remark_lines<'a>(
    flags: impl Iterator<Item = &'a str>,
    assumptions: impl Iterator<Item = (&'a str, Option<&'a str>)>,
    warnings: &'a [String],
) -> impl Iterator<Item = String> {
    let flags = flags.map(|flag| format!("  red flag: {flag}"));
    let assumed = assumptions.map(|(detail, option)| match option {
        Some(option) => format!("  assumed: {detail} (to change: {})", flag_of_option(option)),
        None => format!("  assumed: {detail}"),
    });
    flags.chain(assumed).chain(warnings.iter().map(|warning| format!("  note: {warning}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_assumption_is_printed_with_the_flag_that_changes_the_assumption() {
        let assumed = [("2 sheets were thickened", Some("open_sheets=auto")), ("lengths are in mm", None)];
        let warnings = ["colours were lost".to_owned()];
        let lines: Vec<_> = remark_lines(["a part is lost"].into_iter(), assumed.into_iter(), &warnings).collect();
        assert_eq!(
            lines,
            [
                "  red flag: a part is lost",
                "  assumed: 2 sheets were thickened (to change: --open-sheets auto)",
                "  assumed: lengths are in mm",
                "  note: colours were lost",
            ]
        );
    }
}
