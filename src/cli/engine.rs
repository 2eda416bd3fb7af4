//! What commands that work on files here share: limits, Blender, files, progress, and remarks on a result.

use std::fs::File;
use std::io::{Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use meshmend::blender::BlenderConfig;
use meshmend::format::Limits;
use meshmend::repair::{Progress, Stage};
use tempfile::NamedTempFile;

/// What a reader may spend.
#[derive(Debug, Clone, Args)]
pub struct LimitArgs {
    /// Largest file, or all files of a job together, in MiB.
    #[arg(long, env = "MESHMEND_MAX_FILE_MIB", default_value_t = 512, value_parser = clap::value_parser!(u64).range(1..=65_536))]
    pub max_file_mib: u64,
    /// Most triangles of a file.
    #[arg(long, env = "MESHMEND_MAX_FILE_FACES", default_value_t = Limits::default().max_faces)]
    pub max_file_faces: u64,
    /// Most vertices of a file.
    #[arg(long, env = "MESHMEND_MAX_FILE_VERTICES", default_value_t = Limits::default().max_vertices)]
    pub max_file_vertices: u64,
}

impl LimitArgs {
    pub fn limits(&self) -> Limits {
        Limits {
            max_bytes: self.max_file_mib << 20,
            max_faces: self.max_file_faces,
            max_vertices: self.max_file_vertices,
        }
    }
}

/// Where Blender is.
#[derive(Debug, Clone, Args)]
pub struct BlenderArgs {
    /// Blender, or a Python that has bpy. Without it: `blender` on PATH, then `.venv-blender`.
    #[arg(long, env = "MESHMEND_BLENDER", value_name = "PROGRAM")]
    pub blender: Option<PathBuf>,
    /// Memory that one Blender may take for a model, in MiB; voxels are made larger until the estimate is below. 0 for no limit.
    #[arg(long, env = "MESHMEND_BLENDER_MEMORY_MIB", default_value_t = 4096)]
    pub blender_memory_mib: u64,
    /// Memory that all Blenders on this machine may take together, in MiB, which is how many run at once; without it, half of
    /// the machine's.
    #[arg(long, env = "MESHMEND_BLENDERS_MEMORY_MIB")]
    pub blenders_memory_mib: Option<u64>,
    /// Folder of the locks by which all processes on this machine wait for a free Blender; without it, one for each user in /tmp.
    #[arg(long, env = "MESHMEND_BLENDER_SLOTS", value_name = "FOLDER")]
    pub blender_slots: Option<PathBuf>,
}

impl BlenderArgs {
    pub fn config(&self) -> BlenderConfig {
        BlenderConfig {
            program: self.blender.clone(),
            memory: self.blender_memory_mib.saturating_mul(1 << 20),
            memory_together: self.blenders_memory_mib.map(|mib| mib.saturating_mul(1 << 20)),
            // Jobs run elsewhere.
            slots: self.blender_slots.as_ref().map(|path| std::path::absolute(path).unwrap_or_else(|_| path.clone())),
            ..BlenderConfig::default()
        }
    }
}

/// Reads a file of at most the limit's size.
pub fn read_file(path: &Path, limits: &Limits) -> Result<Vec<u8>, String> {
    let name = path.display();
    let file = File::open(path).map_err(|e| format!("{name}: {e}"))?;
    let mut bytes = Vec::new();
    file.take(limits.max_bytes.saturating_add(1)).read_to_end(&mut bytes).map_err(|e| format!("{name}: {e}"))?;
    if bytes.len() as u64 > limits.max_bytes {
        return Err(format!("{name}: larger than {} MiB; raise --max-file-mib", limits.max_bytes >> 20));
    }
    Ok(bytes)
}

/// A file beside a place, which goes unless it is moved there, so that no half file is ever seen.
pub fn temporary_beside(path: &Path) -> std::io::Result<NamedTempFile> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    tempfile::Builder::new()
        .prefix(".meshmend-")
        .permissions(std::fs::Permissions::from_mode(0o644))
        .tempfile_in(folder)
}

/// Writes beside the place and then moves.
pub fn write_file(path: &Path, bytes: &[u8]) -> Result<(), String> {
    let name = path.display();
    let mut file = temporary_beside(path).map_err(|e| format!("{name}: {e}"))?;
    file.write_all(bytes).map_err(|e| format!("{name}: {e}"))?;
    file.persist(path).map_err(|e| format!("{name}: {}", e.error))?;
    Ok(())
}

/// Progress as a bar on a terminal; nothing where there is none.
pub struct Bar {
    bar: ProgressBar,
    verbose: bool,
}

impl Bar {
    pub fn new(verbose: bool) -> Self {
        let bar = ProgressBar::new(100);
        if let Ok(style) = ProgressStyle::with_template("{msg:24} [{bar:40}] {percent:>3} %  {elapsed}") {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.enable_steady_tick(std::time::Duration::from_millis(200));
        Self { bar, verbose }
    }

    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

impl Progress for Bar {
    fn report(&self, stage: Stage, tier: Option<u8>, percent: u8) {
        self.bar.set_message(stage_in_words(stage, tier));
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

/// What is being done, in words.
pub fn stage_in_words(stage: Stage, tier: Option<u8>) -> String {
    let stage = match stage {
        Stage::Read => "reading",
        Stage::Inspect => "inspecting",
        Stage::Repair => "repairing",
        Stage::Wait => "waiting for a Blender",
        Stage::Verify => "verifying",
        Stage::Finish => "finishing",
    };
    tier.map_or_else(|| stage.to_owned(), |tier| format!("{stage}, tier {tier}"))
}

/// An option of the API, `name=value`, as a flag.
fn as_flag(option: &str) -> String {
    let (name, value) = option.split_once('=').map_or((option, None), |(name, value)| (name, Some(value)));
    let name = name.replace('_', "-");
    value.map_or_else(|| format!("--{name}"), |value| format!("--{name} {value}"))
}

/// What a person should know of a result: its red flags, its assumptions with the option that decides otherwise, and its warnings.
pub fn remarks<'a>(
    flags: impl Iterator<Item = &'a str>,
    assumptions: impl Iterator<Item = (&'a str, Option<&'a str>)>,
    warnings: &'a [String],
) -> impl Iterator<Item = String> {
    let flags = flags.map(|flag| format!("  red flag: {flag}"));
    let assumed = assumptions.map(|(detail, option)| match option {
        Some(option) => format!("  assumed: {detail} ({} decides otherwise)", as_flag(option)),
        None => format!("  assumed: {detail}"),
    });
    flags.chain(assumed).chain(warnings.iter().map(|warning| format!("  note: {warning}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_assumed_is_told_with_the_flag_that_decides_otherwise() {
        let assumed = [("2 sheets were thickened", Some("open_sheets=auto")), ("lengths are in mm", None)];
        let warnings = ["colours were lost".to_owned()];
        let lines: Vec<_> = remarks(["a part is lost"].into_iter(), assumed.into_iter(), &warnings).collect();
        assert_eq!(
            lines,
            [
                "  red flag: a part is lost",
                "  assumed: 2 sheets were thickened (--open-sheets auto decides otherwise)",
                "  assumed: lengths are in mm",
                "  note: colours were lost",
            ]
        );
    }
}
