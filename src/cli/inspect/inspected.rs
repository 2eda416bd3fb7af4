//! The files to inspect and the flags for measuring them; the result for one file: exit code, pictures, JSON, goodness.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use clap::Args;
use meshmend::format::{Format, ReadMesh, sniff};
use meshmend::inspect::{Findings, Goodness, InspectOptions, Inspection, Lack, Shortfall, Thresholds, Tolerances};
use meshmend::printing::readiness::PrintReadiness;
use meshmend::render::{Marked, draw_inspected};
use meshmend::repair::{Context, monotonic_clock};
use meshmend::scene::Unit;
use serde_json::{Map, Value, json};

use super::numbers::format_number;
use crate::cli::engine::ProgressReporter;
use crate::cli::exit;
use crate::cli::repair::write_drawings;

/// The flags about the model, the printer and the tolerances.
#[derive(Debug, Args)]
pub struct MeasureArgs {
    /// Unit of the model. Default: mm.
    #[arg(long, env = "MESHMEND_UNIT", value_enum)]
    unit: Option<Unit>,
    /// Build direction, as a vector of any length.
    #[arg(long, env = "MESHMEND_UP", value_name = "X,Y,Z", value_parser = parse_vector, default_value = "0,0,1", allow_hyphen_values = true)]
    up: [f64; 3],
    /// Angle from the vertical, in degrees, for which the overhang area is also reported, in addition to 30, 45 and
    /// 60.
    #[arg(long, env = "MESHMEND_OVERHANG", value_name = "DEGREES", default_value_t = InspectOptions::default().overhang_deg, allow_negative_numbers = true)]
    overhang: f64,
    /// Sides of the printer's build volume, in mm; reports whether the model fits.
    #[arg(long, env = "MESHMEND_BUILD_VOLUME", value_name = "X,Y,Z", value_parser = parse_vector, allow_hyphen_values = true)]
    build_volume: Option<[f64; 3]>,
    /// Size below which something counts as zero: a length in the model's unit, or with % a share of the bounding
    /// box's diagonal. 0 finds only exact cases. Separate several with commas, or repeat the flag: `0.01,slit=0.1%`.
    /// Names: `linear` (used without a name); `foldover_height`, `degenerate`, `slit`, `t_junction` and `sheet`, which
    /// default to `linear`; `crack`; `tiny_part`; and `foldover_angle`, in radians.
    #[arg(long, env = "MESHMEND_TOLERANCE", value_name = "[NAME=]VALUE", value_parser = parse_tolerance, value_delimiter = ',', allow_negative_numbers = true)]
    tolerance: Vec<NamedTolerance>,
}

impl MeasureArgs {
    /// The checked options.
    ///
    /// # Errors
    /// The message for the first unusable value.
    pub fn options(&self) -> Result<InspectOptions, String> {
        let options = InspectOptions {
            tolerances: tolerances(&self.tolerance)?,
            unit: self.unit,
            up: self.up,
            overhang_deg: self.overhang,
            build_volume: self.build_volume,
            ..InspectOptions::default()
        };
        options.validate().map_err(|error| error.to_string())?;
        Ok(options)
    }
}

/// One `--tolerance`: its name, and its value in the JSON form of [`Tolerances`].
#[derive(Debug, Clone, PartialEq)]
struct NamedTolerance {
    name: String,
    value: Value,
}

/// Parses one value of `--tolerance`.
fn parse_tolerance(text: &str) -> Result<NamedTolerance, String> {
    let (name, value) = text.split_once('=').unwrap_or(("linear", text));
    let name = name.trim().replace('-', "_");
    let value = value.trim();
    let (number, is_percent) = value.strip_suffix('%').map_or((value, false), |number| (number.trim_end(), true));
    let number = number.parse().ok().filter(|number: &f64| number.is_finite());
    let value = match (number, name.as_str(), is_percent) {
        (Some(radians), "foldover_angle", false) => json!(radians),
        (_, "foldover_angle", _) => {
            return Err("expected an angle in radians, such as `foldover_angle=0.01`".to_owned());
        }
        (Some(percent), _, true) => json!({ "of_diagonal": percent / 100.0 }),
        (Some(length), _, false) => json!({ "absolute": length }),
        (None, ..) => {
            return Err(
                "expected a length in the model's unit or a percentage of its diagonal, such as 0.01, 0.001% or \
                        slit=0.01"
                    .to_owned(),
            );
        }
    };
    Ok(NamedTolerance { name, value })
}

/// Combines the values of `--tolerance`; the last value of a name counts.
fn tolerances(given: &[NamedTolerance]) -> Result<Tolerances, String> {
    let fields: Map<String, Value> =
        given.iter().map(|tolerance| (tolerance.name.clone(), tolerance.value.clone())).collect();
    serde_json::from_value(Value::Object(fields)).map_err(|error| format!("--tolerance: {error}"))
}

/// Parses `X,Y,Z`.
fn parse_vector(text: &str) -> Result<[f64; 3], String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|word| word.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x, y, z]) => Ok([x, y, z]),
        _ => Err("expected three numbers, such as 0,0,1".to_owned()),
    }
}

/// Bytes from the start of a file that identify its format.
const HEADER_BYTES: u64 = 4096;

/// A file to inspect.
pub struct Input {
    /// Its path.
    pub path: PathBuf,
    /// Whether the file is surely meant: it was given itself, or has the extension of a model. Other files of a folder only look
    /// like models; if they cannot be read, they are skipped.
    pub is_explicit: bool,
}

/// The given files; a folder is replaced by the models in it, sorted by name.
///
/// # Errors
/// A folder that is unreadable or has no models.
pub fn inputs(given: &[PathBuf]) -> Result<Vec<Input>, String> {
    let mut all = Vec::new();
    for path in given {
        if path.is_dir() {
            let models = models_in(path).map_err(|e| format!("{}: {e}", path.display()))?;
            if models.is_empty() {
                return Err(format!("{}: this folder contains no models", path.display()));
            }
            all.extend(models);
        } else {
            all.push(Input { path: path.clone(), is_explicit: true });
        }
    }
    Ok(all)
}

fn models_in(folder: &Path) -> std::io::Result<Vec<Input>> {
    let mut paths = std::fs::read_dir(folder)?.map(|entry| Ok(entry?.path())).collect::<std::io::Result<Vec<_>>>()?;
    paths.retain(|path| path.is_file());
    paths.sort();
    let inputs = paths.into_iter().map(|path| Input { is_explicit: has_model_extension(&path), path });
    Ok(inputs.filter(|input| input.is_explicit || looks_like_a_model(&input.path)).collect())
}

fn has_model_extension(path: &Path) -> bool {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    Format::ALL.iter().any(|format| extension.eq_ignore_ascii_case(format.extension()))
}

fn looks_like_a_model(path: &Path) -> bool {
    let Ok(file) = File::open(path) else { return false };
    let length = file.metadata().ok().map(|metadata| metadata.len());
    let mut head = Vec::new();
    file.take(HEADER_BYTES).read_to_end(&mut head).is_ok() && sniff(&head, length).is_ok()
}

/// Unique file name prefixes for the drawings of several files in one folder.
#[derive(Debug, Default)]
pub struct Prefixes {
    used: BTreeSet<String>,
}

impl Prefixes {
    /// The prefix for a file's drawings: its name without the extension, and a number if the prefix is taken. Names
    /// that differ only in case count as equal, as on case-insensitive file systems.
    pub fn of(&mut self, path: &Path) -> String {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let mut prefix = format!("{stem}-");
        let mut number = 1;
        while !self.used.insert(prefix.to_lowercase()) {
            number += 1;
            prefix = format!("{stem}-{number}-");
        }
        prefix
    }
}

/// An exit code with a message.
pub type Failure = (u8, String);

/// One file and its inspection.
pub struct Inspected {
    /// Its path.
    pub name: String,
    /// Its mesh.
    pub mesh: ReadMesh,
    /// Its measures and defects.
    pub inspection: Inspection,
    /// The places of its defects.
    pub findings: Findings,
    /// With `--good`: whether the mesh is good.
    pub goodness: Option<Goodness>,
    /// With `--process`: whether the file meets each rule of the process.
    pub print_ready: Option<PrintReadiness>,
}

impl Inspected {
    /// The exit code: whether the file has defects.
    pub fn code(&self) -> u8 {
        // A level that does not search for intersections leaves the verdict open; that counts as no defect.
        let measures = &self.inspection.measures;
        let has_no_known_defect = || measures.verdict().unwrap_or(!measures.self_intersections.checked);
        let is_fine = self.goodness.as_ref().map_or_else(has_no_known_defect, |goodness| goodness.good);
        let is_ready = self.print_ready.as_ref().is_none_or(|readiness| readiness.ready);
        if is_fine && is_ready { exit::PRINTABLE } else { exit::PARTIAL }
    }

    /// Draws the defects into a folder.
    ///
    /// # Errors
    /// Drawing or writing fails.
    pub fn draw(&self, folder: &Path, prefix: &str) -> Result<(), Failure> {
        let marked = Marked { soup: &self.mesh.soup, findings: &self.findings };
        let drawings = with_progress(|context| draw_inspected(marked, context));
        let written = drawings.and_then(|drawings| write_drawings(folder, prefix, &drawings));
        written.map_err(|message| (exit::INTERNAL, format!("{}: no pictures were drawn: {message}", self.name)))
    }

    /// The result as `--json` prints it.
    pub fn to_json(&self) -> Value {
        json!({
            "path": self.name, "format": self.mesh.format, "dialect": self.mesh.dialect,
            "warnings": self.mesh.warnings, "printable": self.inspection.measures.verdict(),
            "goodness": self.goodness, "inspection": self.inspection, "print_ready": self.print_ready,
        })
    }
}

/// Runs `work` with a progress bar on the terminal.
///
/// # Errors
/// The message of the error of `work`.
pub fn with_progress<T, E: ToString>(work: impl FnOnce(&Context<'_>) -> Result<T, E>) -> Result<T, String> {
    let (clock, cancel, progress) = (monotonic_clock(), AtomicBool::new(false), ProgressReporter::new(false));
    let result = work(&Context::new(&progress, &cancel, &clock, Duration::MAX));
    progress.finish();
    result.map_err(|e| e.to_string())
}

/// Parses `--good`: `RATIO,ANGLE,LENGTH`.
pub fn parse_thresholds(text: &str) -> Result<Thresholds, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|word| word.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[aspect_ratio, edge_angle, edge_length])
            if [aspect_ratio, edge_angle, edge_length].iter().all(|x| x.is_finite() && *x >= 0.0) =>
        {
            Ok(Thresholds { aspect_ratio, edge_angle, edge_length })
        }
        _ => Err("expected three numbers of at least 0, such as 10,0.1,0.01: aspect ratio, edge angle, edge length"
            .to_owned()),
    }
}

/// The result of `--good` on one line: `1` or `0`, the file, and the reasons if it is not good.
pub fn verdict_line(name: &str, goodness: &Goodness) -> String {
    if goodness.good {
        return format!("1 {name}\n");
    }
    format!("0 {name}: {}\n", reasons(goodness))
}

/// The result of `--good` with a line for each reason.
pub fn verdict_lines(name: &str, goodness: &Goodness) -> String {
    let mut text = format!("{name}: mesh is {}\n", if goodness.good { "good" } else { "NOT good" });
    for reason in &goodness.reasons {
        // Writing to a string can't fail.
        let _ = writeln!(text, "  {}", shortfall_text(reason, &goodness.thresholds));
    }
    text
}

/// Why a mesh is not good, on one line.
pub fn reasons(goodness: &Goodness) -> String {
    goodness.reasons.iter().map(|reason| shortfall_text(reason, &goodness.thresholds)).collect::<Vec<_>>().join(", ")
}

/// Thresholds that accept every shape: a mesh without defects meets them.
pub const SOUND: Thresholds = Thresholds { aspect_ratio: f64::INFINITY, edge_angle: 0.0, edge_length: 0.0 };

fn shortfall_text(reason: &Shortfall, thresholds: &Thresholds) -> String {
    let value = reason.value.map_or_else(|| "unknown".to_owned(), format_number);
    match reason.lack {
        Lack::Closed => format!("not closed (boundary edges: {value})"),
        Lack::Manifold => format!("not manifold (non-manifold edges and vertices: {value})"),
        Lack::Consistent => format!("not consistent (misoriented edges: {value})"),
        Lack::Outward if reason.value.is_some() => format!("not outward (parts turned inward: {value})"),
        Lack::Outward => "not known to be outward".to_owned(),
        Lack::NoIntersectingFaces => format!("pairs of intersecting faces: {value}"),
        Lack::IntersectionsChecked => "the search for intersecting faces did not run".to_owned(),
        Lack::NoOrphanVertices => format!("orphan vertices: {value}"),
        Lack::NoMissingVertices => format!("missing vertices: {value}"),
        Lack::NoDegenerateFaces => format!("degenerate faces: {value}"),
        Lack::FiniteFaces => format!("faces that are not finite: {value}"),
        Lack::ContiguousVertices => "vertices are not numbered 1, 2, 3 and so on".to_owned(),
        Lack::ContiguousFaces => "faces are not numbered 1, 2, 3 and so on".to_owned(),
        Lack::AspectRatio => {
            format!("largest aspect ratio {value} is not below {}", format_number(thresholds.aspect_ratio))
        }
        Lack::EdgeAngle => format!("smallest edge angle {value} is not above {}", format_number(thresholds.edge_angle)),
        Lack::EdgeLength => {
            format!("smallest edge length {value} is not above {}", format_number(thresholds.edge_length))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meshmend::inspect::Tolerance;

    #[test]
    fn tolerances_are_lengths_or_percentages_and_the_last_of_a_name_counts() {
        let read = |texts: &[&str]| {
            let given: Result<Vec<NamedTolerance>, String> = texts.iter().map(|text| parse_tolerance(text)).collect();
            given.and_then(|given| tolerances(&given))
        };
        assert_eq!(read(&[]), Ok(Tolerances::default()));
        let expected = Tolerances {
            linear: Tolerance::Absolute(0.25),
            slit: Some(Tolerance::OfDiagonal(0.005)),
            t_junction: Some(Tolerance::Absolute(3.0)),
            foldover_angle: 0.05,
            ..Tolerances::default()
        };
        assert_eq!(read(&["9", "0.25", "slit = 0.5 %", "t-junction=3", "foldover_angle=0.05"]), Ok(expected));
        for (invalid, message) in [
            ("slits=1", "expected one of"),
            ("slit=", "such as 0.01"),
            ("nan", "such as 0.01"),
            ("1e999", "such as 0.01"),
            ("foldover_angle=1%", "in radians"),
        ] {
            let error = read(&[invalid]).err().unwrap_or_default();
            assert!(error.contains(message), "{invalid}: {error}");
        }
    }

    #[test]
    fn no_two_files_share_a_prefix() {
        let mut prefixes = Prefixes::default();
        let given = ["a/x.stl", "b/X.obj", "x-2.stl", "x", "x.2.stl"].map(|path| prefixes.of(Path::new(path)));
        assert_eq!(given, ["x-", "X-2-", "x-2-2-", "x-3-", "x.2-"]);
    }
}
