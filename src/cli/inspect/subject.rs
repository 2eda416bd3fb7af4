//! What is to be inspected, and one inspected file: its exit code, its pictures, its JSON, and whether its mesh is good.

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
use meshmend::render::{Marked, draw_inspected};
use meshmend::repair::{Context, monotonic_clock};
use meshmend::scene::Unit;
use serde_json::{Map, Value, json};

use super::figures::figure;
use crate::cli::engine::Bar;
use crate::cli::exit;
use crate::cli::repair::write_drawings;

/// What is known of the model and the printer, and how closely things must agree.
#[derive(Debug, Args)]
pub struct MeasureArgs {
    /// The model's unit. Without it: mm.
    #[arg(long, env = "MESHMEND_UNIT", value_enum)]
    unit: Option<Unit>,
    /// The direction in which the model is built, of any length.
    #[arg(long, env = "MESHMEND_UP", value_name = "X,Y,Z", value_parser = three_numbers, default_value = "0,0,1", allow_hyphen_values = true)]
    up: [f64; 3],
    /// An angle from the vertical for which the area of overhangs is told, beside 30, 45 and 60 degrees.
    #[arg(long, env = "MESHMEND_OVERHANG", value_name = "DEGREES", default_value_t = InspectOptions::default().overhang_deg, allow_negative_numbers = true)]
    overhang: f64,
    /// Sides of the printer's build volume, in mm: tell whether the model fits.
    #[arg(long, env = "MESHMEND_BUILD_VOLUME", value_name = "X,Y,Z", value_parser = three_numbers, allow_hyphen_values = true)]
    build_volume: Option<[f64; 3]>,
    /// What is so small that it counts as nothing: a length in the model's unit, or with % a share of the diagonal of its
    /// box; 0 finds only what is exactly so. Several are parted by commas, or by giving the flag again: `0.01,slit=0.1%`.
    /// The names are linear (what is meant without a name), foldover_height, degenerate, slit, t_junction, sheet, which
    /// are as linear where they are not given; crack, tiny_part; and foldover_angle, in radians.
    #[arg(long, env = "MESHMEND_TOLERANCE", value_name = "[NAME=]VALUE", value_parser = tolerance, value_delimiter = ',', allow_negative_numbers = true)]
    tolerance: Vec<Named>,
}

impl MeasureArgs {
    /// The options, checked.
    ///
    /// # Errors
    /// What is wrong with the first that can't be used, and what is wanted.
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

/// A tolerance as it was given: its name, and its value in the form that [`Tolerances`] has in JSON.
#[derive(Debug, Clone, PartialEq)]
struct Named {
    name: String,
    value: Value,
}

fn tolerance(text: &str) -> Result<Named, String> {
    let (name, value) = text.split_once('=').unwrap_or(("linear", text));
    let name = name.trim().replace('-', "_");
    let value = value.trim();
    let (number, share) = value.strip_suffix('%').map_or((value, false), |number| (number.trim_end(), true));
    let number = number.parse().ok().filter(|number: &f64| number.is_finite());
    let value = match (number, name.as_str(), share) {
        (Some(radians), "foldover_angle", false) => json!(radians),
        (_, "foldover_angle", _) => return Err("an angle in radians is wanted, such as foldover_angle=0.01".to_owned()),
        (Some(percent), _, true) => json!({ "of_diagonal": percent / 100.0 }),
        (Some(length), _, false) => json!({ "absolute": length }),
        (None, ..) => {
            return Err("a length in the model's unit or a share of its diagonal is wanted, such as 0.01, 0.001% or \
                        slit=0.01"
                .to_owned());
        }
    };
    Ok(Named { name, value })
}

fn tolerances(given: &[Named]) -> Result<Tolerances, String> {
    let fields: Map<String, Value> = given.iter().map(|it| (it.name.clone(), it.value.clone())).collect();
    serde_json::from_value(Value::Object(fields)).map_err(|error| format!("--tolerance: {error}"))
}

fn three_numbers(text: &str) -> Result<[f64; 3], String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|word| word.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x, y, z]) => Ok([x, y, z]),
        _ => Err("three numbers are wanted, such as 0,0,1".to_owned()),
    }
}

/// Bytes that are enough to tell a format.
const HEAD: u64 = 4096;

/// A file to look at.
pub struct Input {
    pub path: PathBuf,
    /// Whether somebody meant it: it was given, or its name ends as a model's does. Other files of a folder only look
    /// like models and may turn out to be none.
    pub named: bool,
}

/// The files that were given, folders replaced by the models in them, in order of their names.
pub fn inputs(given: &[PathBuf]) -> Result<Vec<Input>, String> {
    let mut all = Vec::new();
    for path in given {
        if path.is_dir() {
            let found = models_in(path).map_err(|e| format!("{}: {e}", path.display()))?;
            if found.is_empty() {
                return Err(format!("{}: there is no model in this folder", path.display()));
            }
            all.extend(found);
        } else {
            all.push(Input { path: path.clone(), named: true });
        }
    }
    Ok(all)
}

fn models_in(folder: &Path) -> std::io::Result<Vec<Input>> {
    let mut paths = std::fs::read_dir(folder)?.map(|entry| Ok(entry?.path())).collect::<std::io::Result<Vec<_>>>()?;
    paths.retain(|path| path.is_file());
    paths.sort();
    let inputs = paths.into_iter().map(|path| Input { named: has_ending(&path), path });
    Ok(inputs.filter(|input| input.named || looks_like_a_model(&input.path)).collect())
}

fn has_ending(path: &Path) -> bool {
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    Format::ALL.iter().any(|format| ending.eq_ignore_ascii_case(format.extension()))
}

fn looks_like_a_model(path: &Path) -> bool {
    let Ok(file) = File::open(path) else { return false };
    let length = file.metadata().ok().map(|it| it.len());
    let mut head = Vec::new();
    file.take(HEAD).read_to_end(&mut head).is_ok() && sniff(&head, length).is_ok()
}

/// Names for the drawings of several files in one folder.
#[derive(Debug, Default)]
pub struct Prefixes {
    used: BTreeSet<String>,
}

impl Prefixes {
    /// What the names of a file's drawings begin with: its name without ending, and a number where that is taken. Names
    /// that differ in case only count as equal, as they do on some disks.
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

/// One file and what was found in it.
pub struct Inspected {
    pub name: String,
    pub mesh: ReadMesh,
    pub inspection: Inspection,
    pub findings: Findings,
    pub goodness: Option<Goodness>,
}

impl Inspected {
    /// The exit code that says whether something is wrong.
    pub fn code(&self) -> u8 {
        // What the level does not look for is not held against the mesh.
        let measures = &self.inspection.measures;
        let looks_fine = || measures.verdict().unwrap_or(!measures.self_intersections.checked);
        let fine = self.goodness.as_ref().map_or_else(looks_fine, |it| it.good);
        if fine { exit::PRINTABLE } else { exit::PARTIAL }
    }

    /// Draws what was found.
    pub fn draw(&self, folder: &Path, prefix: &str) -> Result<(), Failure> {
        let marked = Marked { soup: &self.mesh.soup, findings: &self.findings };
        let drawings = in_context(|context| draw_inspected(marked, context));
        let written = drawings.and_then(|drawings| write_drawings(folder, prefix, &drawings));
        written.map_err(|message| (exit::INTERNAL, format!("{}: no pictures: {message}", self.name)))
    }

    pub fn to_json(&self) -> Value {
        json!({
            "path": self.name, "format": self.mesh.format, "dialect": self.mesh.dialect,
            "warnings": self.mesh.warnings, "printable": self.inspection.measures.verdict(),
            "goodness": self.goodness, "inspection": self.inspection,
        })
    }
}

/// Works with a bar on the terminal.
pub fn in_context<T, E: ToString>(work: impl FnOnce(&Context<'_>) -> Result<T, E>) -> Result<T, String> {
    let (clock, cancel, bar) = (monotonic_clock(), AtomicBool::new(false), Bar::new(false));
    let done = work(&Context::new(&bar, &cancel, &clock, Duration::MAX));
    bar.finish();
    done.map_err(|e| e.to_string())
}

/// Reads `ratio,angle,length`.
pub fn thresholds(text: &str) -> Result<Thresholds, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|word| word.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[aspect_ratio, edge_angle, edge_length])
            if [aspect_ratio, edge_angle, edge_length].iter().all(|x| x.is_finite() && *x >= 0.0) =>
        {
            Ok(Thresholds { aspect_ratio, edge_angle, edge_length })
        }
        _ => Err("three numbers are wanted, such as 10,0.1,0.01: aspect ratio, edge angle, edge length".to_owned()),
    }
}

/// `1` or `0`, then which file it was, and why not.
pub fn verdict_line(name: &str, it: &Goodness) -> String {
    if it.good {
        return format!("1 {name}\n");
    }
    format!("0 {name}: {}\n", reasons(it))
}

/// The verdict with a line for each reason.
pub fn verdict_in_words(name: &str, it: &Goodness) -> String {
    let mut text = format!("{name}: mesh is {}\n", if it.good { "good" } else { "NOT good" });
    for reason in &it.reasons {
        // Writing to a string can't fail.
        let _ = writeln!(text, "  {}", shortfall(reason, &it.thresholds));
    }
    text
}

/// Why a mesh is not good, in a line.
pub fn reasons(it: &Goodness) -> String {
    it.reasons.iter().map(|reason| shortfall(reason, &it.thresholds)).collect::<Vec<_>>().join(", ")
}

/// What every mesh meets that has nothing wrong with it.
pub const SOUND: Thresholds = Thresholds { aspect_ratio: f64::INFINITY, edge_angle: 0.0, edge_length: 0.0 };

fn shortfall(reason: &Shortfall, than: &Thresholds) -> String {
    let value = reason.value.map_or_else(|| "unknown".to_owned(), figure);
    match reason.lack {
        Lack::Closed => format!("not closed (boundary edges: {value})"),
        Lack::Manifold => format!("not manifold (non-manifold edges and vertices: {value})"),
        Lack::Consistent => format!("not consistent (misoriented edges: {value})"),
        Lack::Outward if reason.value.is_some() => format!("not outward (parts turned inward: {value})"),
        Lack::Outward => "not known to be outward".to_owned(),
        Lack::NoIntersectingFaces => format!("pairs of intersecting faces: {value}"),
        Lack::IntersectionsChecked => "intersecting faces were not looked for".to_owned(),
        Lack::NoOrphanVertices => format!("orphan vertices: {value}"),
        Lack::NoMissingVertices => format!("missing vertices: {value}"),
        Lack::NoDegenerateFaces => format!("degenerate faces: {value}"),
        Lack::FiniteFaces => format!("faces that are not finite: {value}"),
        Lack::ContiguousVertices => "vertices are not numbered 1, 2, 3 and so on".to_owned(),
        Lack::ContiguousFaces => "faces are not numbered 1, 2, 3 and so on".to_owned(),
        Lack::AspectRatio => format!("largest aspect ratio {value} is not below {}", figure(than.aspect_ratio)),
        Lack::EdgeAngle => format!("smallest edge angle {value} is not above {}", figure(than.edge_angle)),
        Lack::EdgeLength => format!("smallest edge length {value} is not above {}", figure(than.edge_length)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meshmend::inspect::Tolerance;

    #[test]
    fn tolerances_are_lengths_or_shares_of_the_diagonal_and_the_last_of_a_name_holds() {
        let read = |texts: &[&str]| {
            let given: Result<Vec<Named>, String> = texts.iter().map(|text| tolerance(text)).collect();
            given.and_then(|given| tolerances(&given))
        };
        assert_eq!(read(&[]), Ok(Tolerances::default()));
        let some = Tolerances {
            linear: Tolerance::Absolute(0.25),
            slit: Some(Tolerance::OfDiagonal(0.005)),
            t_junction: Some(Tolerance::Absolute(3.0)),
            foldover_angle: 0.05,
            ..Tolerances::default()
        };
        assert_eq!(read(&["9", "0.25", "slit = 0.5 %", "t-junction=3", "foldover_angle=0.05"]), Ok(some));
        for (wrong, said) in [
            ("slits=1", "expected one of"),
            ("slit=", "such as 0.01"),
            ("nan", "such as 0.01"),
            ("1e999", "such as 0.01"),
            ("foldover_angle=1%", "in radians"),
        ] {
            let error = read(&[wrong]).err().unwrap_or_default();
            assert!(error.contains(said), "{wrong}: {error}");
        }
    }

    #[test]
    fn no_two_files_share_a_prefix() {
        let mut prefixes = Prefixes::default();
        let given = ["a/x.stl", "b/X.obj", "x-2.stl", "x", "x.2.stl"].map(|path| prefixes.of(Path::new(path)));
        assert_eq!(given, ["x-", "X-2-", "x-2-2-", "x-3-", "x.2-"]);
    }
}
