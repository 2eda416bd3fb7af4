//! `meshmend inspect`: lists the defects of files one after another, and measures between files.

mod defects;
mod inspected;
mod numbers;
mod text;

use std::fmt::Write as _;
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;
use meshmend::analyze::subject;
use meshmend::format::{self, Limits, ReadFile, ReadMesh, ReadOptions};
use meshmend::inspect::{Analysis, InspectOptions, Level, SetReport, Thresholds, goodness, inspect_analysis};
use meshmend::mesh::Soup;
use meshmend::printing::profile::{Profile, checked_profile};
use meshmend::printing::readiness::{AssessedFile, assess};
use meshmend::repair::{Cancelled, Context};
use serde_json::{Value, json};

use self::inspected::{
    Failure, Input, Inspected, MeasureArgs, Prefixes, SOUND, inputs, reasons, verdict_line, verdict_lines,
    with_progress,
};
use self::numbers::{Style, distribution, format_number, format_point, statistics};
use super::engine::{LimitArgs, read_file};
use super::exit;
use super::print_options::ProcessArgs;

/// Version of the JSON that `--json` prints.
const JSON_VERSION: u32 = 1;

/// Arguments of `meshmend inspect`.
#[derive(Debug, Args)]
pub struct InspectArgs {
    /// Models: STL, OBJ, PLY, OFF or Vertex/Face text; the content decides the format, not the name. A folder stands
    /// for the models in it, sorted by name.
    #[arg(required = true, value_name = "FILE or FOLDER")]
    inputs: Vec<PathBuf>,
    /// Depth of the inspection: `none` counts elements and finds attributes, `basic` also finds defects that need no
    /// spatial search, `full` finds all. Default: full, or the level that --attributes needs.
    #[arg(long, env = "MESHMEND_LEVEL", value_enum)]
    level: Option<Level>,
    /// Print only whether the mesh is closed, manifold, consistent and outward.
    #[arg(short, long, env = "MESHMEND_ATTRIBUTES", conflicts_with = "good")]
    attributes: bool,
    /// Print only whether the mesh is good, 1 or 0, and set the exit code accordingly. A good mesh has no defects
    /// and keeps three limits. Aspect ratios (longest edge over shortest altitude) are below RATIO, edge angles above
    /// ANGLE, in radians, and edges longer than LENGTH.
    #[arg(short, long, env = "MESHMEND_GOOD", value_name = "RATIO,ANGLE,LENGTH", value_parser = inspected::parse_thresholds)]
    good: Option<Thresholds>,
    /// List every offending element with its place.
    #[arg(short = 'p', long, env = "MESHMEND_OFFENDERS")]
    offenders: bool,
    /// With several files: count faces that intersect faces of another file. Implied by a folder without
    /// --attributes, --good and --spacing.
    #[arg(short, long, env = "MESHMEND_INTERSECTIONS")]
    intersections: bool,
    /// With several files: measure the distance from each vertex to the nearest surface of another file. Every file
    /// must be good (see --good), with any shapes. Implied by a folder without --attributes, --good and
    /// --intersections.
    #[arg(short, long, env = "MESHMEND_SPACING")]
    spacing: bool,
    /// Folder for pictures of the defects: defects.png, defects.glb and defects.ply. With several files, each name
    /// starts with the file's name, as in part-defects.png. A missing folder is created.
    #[arg(long, env = "MESHMEND_PICTURES", value_name = "FOLDER")]
    pictures: Option<PathBuf>,
    /// Print JSON instead of text.
    #[arg(long, env = "MESHMEND_JSON")]
    json: bool,
    #[command(flatten)]
    process: ProcessArgs,
    #[command(flatten)]
    measures: MeasureArgs,
    #[command(flatten)]
    limits: LimitArgs,
}

impl InspectArgs {
    /// Whether a folder is given without a choice of measures; then everything is measured between its files.
    fn measures_all_between_files(&self) -> bool {
        let has_choice = self.attributes || self.good.is_some() || self.intersections || self.spacing;
        !has_choice && self.inputs.iter().any(|path| path.is_dir())
    }

    fn wants_intersections(&self) -> bool {
        self.intersections || self.measures_all_between_files()
    }

    fn wants_spacing(&self) -> bool {
        self.spacing || self.measures_all_between_files()
    }

    fn options(&self) -> Result<InspectOptions, String> {
        // Lists of offenders and pictures need a level that finds defects.
        let needed_level = match (self.attributes, self.offenders || self.pictures.is_some()) {
            (true, false) if !self.spacing => Level::None,
            (true, true) if !self.spacing => Level::Basic,
            _ => Level::Full,
        };
        let options = self.measures.options()?;
        let places = if self.offenders { usize::MAX } else { options.places };
        Ok(InspectOptions { level: self.level.unwrap_or(needed_level), places, ..options })
    }
}

/// Runs `meshmend inspect`.
pub fn run(args: &InspectArgs) -> ExitCode {
    match Run::new(args).and_then(Run::inspect_all) {
        Ok(code) => ExitCode::from(code),
        Err((code, message)) => exit::fail(code, message),
    }
}

/// One run of `inspect` over all files.
struct Run<'a> {
    args: &'a InspectArgs,
    limits: Limits,
    options: InspectOptions,
    /// The profile of the process to check against.
    profile: Option<Profile>,
    style: Style,
    files: Vec<Input>,
    code: u8,
    json: Vec<Value>,
    /// The meshes, kept for the measures between files.
    meshes: Vec<(String, ReadMesh)>,
    /// With `--spacing`: the files that are not good, with the reasons.
    not_good: Vec<(String, String)>,
    has_printed: bool,
    /// Name prefixes of the drawings; only with several files.
    prefixes: Option<Prefixes>,
}

impl<'a> Run<'a> {
    fn new(args: &'a InspectArgs) -> Result<Self, Failure> {
        let options = args.options().map_err(|message| (exit::BAD_INPUT, message))?;
        let (process, process_limits) = args.process.read().map_err(|message| (exit::BAD_INPUT, message))?;
        let profile = checked_profile(process.as_deref(), process_limits.as_ref())
            .map_err(|error| (exit::BAD_INPUT, error.to_string()))?;
        let files = inputs(&args.inputs).map_err(|message| (exit::BAD_INPUT, message))?;
        let unicode = std::io::stdout().is_terminal() && std::env::var_os("NO_COLOR").is_none();
        Ok(Self {
            args,
            limits: args.limits.limits(),
            options,
            profile,
            style: Style { unicode },
            prefixes: (files.len() > 1).then(Prefixes::default),
            files,
            code: exit::PRINTABLE,
            json: Vec::new(),
            meshes: Vec::new(),
            not_good: Vec::new(),
            has_printed: false,
        })
    }

    fn inspect_all(mut self) -> Result<u8, Failure> {
        for input in std::mem::take(&mut self.files) {
            let name = input.path.display().to_string();
            let read = read_file(&input.path, &self.limits).and_then(|bytes| {
                let file = format::read_shape(&bytes, &ReadOptions::within(self.limits));
                file.map(|file| (file, bytes.len() as u64)).map_err(|error| format!("{name}: {error}"))
            });
            match read {
                Ok((file, bytes)) => self.inspect_file(&input.path, name, file, bytes)?,
                Err(_) if !input.is_explicit => {}
                Err(message) => {
                    self.code = exit::BAD_INPUT;
                    self.json.push(json!({ "path": name, "error": message }));
                    exit::fail(exit::BAD_INPUT, message);
                }
            }
        }
        let set = self.measure_set()?;
        if self.args.json {
            let not_good: Vec<Value> =
                self.not_good.iter().map(|(path, reasons)| json!({ "path": path, "reasons": reasons })).collect();
            let value = json!({ "version": JSON_VERSION, "files": self.json, "set": set, "not_good": not_good });
            self.print(&format!("{value:#}\n"))?;
        } else if let Some(set) = set {
            let names: Vec<&str> = self.meshes.iter().map(|(name, _)| name.as_str()).collect();
            let text = set_text(&set, &names, self.style);
            self.print(&text)?;
        }
        Ok(self.code)
    }

    fn inspect_file(&mut self, path: &Path, name: String, mut file: ReadFile, bytes: u64) -> Result<(), Failure> {
        let unit = file.settle_unit(self.options.unit, None);
        let mesh = file.mesh;
        let inspect = |context: &Context<'_>| {
            let analysis = Analysis::new(subject(&mesh, Some(&unit)), context)?;
            let (inspection, findings) = inspect_analysis(&analysis, &self.options, context)?;
            let file = AssessedFile { analysis: &analysis, measures: &inspection.measures, bytes, lost_unit: false };
            let print_ready = self.profile.as_ref().map(|profile| assess(file, profile, context)).transpose()?;
            Ok::<_, Cancelled>((inspection, findings, print_ready))
        };
        let (inspection, findings, print_ready) = with_progress(inspect).map_err(|e| (exit::INTERNAL, e))?;
        let goodness = self.args.good.map(|thresholds| goodness(&inspection, thresholds));
        let inspected = Inspected { name, mesh, inspection, findings, goodness, print_ready };
        self.code = self.code.max(inspected.code());
        if self.args.json {
            self.json.push(inspected.to_json());
        } else {
            let text = self.text(&inspected);
            self.print(&text)?;
        }
        if let Some(folder) = &self.args.pictures {
            let prefix = self.prefixes.as_mut().map_or_else(String::new, |prefixes| prefixes.of(path));
            inspected.draw(folder, &prefix)?;
        }
        if self.args.wants_spacing() {
            let sound = meshmend::inspect::goodness(&inspected.inspection, SOUND);
            if !sound.good {
                self.not_good.push((inspected.name.clone(), reasons(&sound)));
            }
        }
        if self.args.wants_intersections() || self.args.wants_spacing() {
            self.meshes.push((inspected.name, inspected.mesh));
        }
        Ok(())
    }

    fn text(&self, file: &Inspected) -> String {
        let separator = if self.has_printed { "\n" } else { "" };
        let all = self.args.offenders;
        let mut places = if all { defects::section(file, true) } else { String::new() };
        if all {
            places += &self.offenders(file);
        }
        match &file.goodness {
            Some(goodness) if all => format!("{separator}{}{places}", verdict_lines(&file.name, goodness)),
            Some(goodness) => verdict_line(&file.name, goodness),
            None if self.args.attributes => format!("{separator}{}{places}", text::attributes_only(file)),
            None if all => format!("{separator}{}{}", text::report(file, self.style, all), self.offenders(file)),
            None => format!("{separator}{}", text::report(file, self.style, all)),
        }
    }

    /// Offending elements by number; empty if the analysis was stopped.
    fn offenders(&self, file: &Inspected) -> String {
        let list = |context: &Context<'_>| {
            let analysis = Analysis::new((&file.mesh.soup).into(), context)?;
            Ok::<_, Cancelled>(defects::offenders(file, &analysis, self.args.good.as_ref()))
        };
        with_progress(list).unwrap_or_default()
    }

    /// Measures between all files, if requested and if there are several.
    fn measure_set(&self) -> Result<Option<SetReport>, Failure> {
        if self.meshes.len() < 2 && (self.args.intersections || self.args.spacing) {
            let note = "note: --intersections and --spacing measure between files and need at least two";
            drop(writeln!(std::io::stderr(), "meshmend: {note}"));
        }
        let meshes: Vec<&Soup> = self.meshes.iter().map(|(_, mesh)| &mesh.soup).collect();
        let spacing = self.args.wants_spacing() && self.not_good.is_empty();
        if self.args.wants_spacing() && self.meshes.len() > 1 {
            for (name, reasons) in &self.not_good {
                let note =
                    format!("note: distances between files are not measured because {name} is not good: {reasons}");
                drop(writeln!(std::io::stderr(), "meshmend: {note}"));
            }
        }
        with_progress(|context| SetReport::of(&meshes, self.args.wants_intersections(), spacing, context))
            .map_err(|e| (exit::INTERNAL, e))
    }

    fn print(&mut self, text: &str) -> Result<(), Failure> {
        self.has_printed = true;
        std::io::stdout().write_all(text.as_bytes()).map_err(|e| (exit::INTERNAL, e.to_string()))
    }
}

/// Most pairs of files in the text; JSON lists all.
const MAX_PAIRS: usize = 20;

/// The measures between files, as text; `names` are the files' names.
fn set_text(set: &SetReport, names: &[&str], style: Style) -> String {
    let mut text = format!("\nSet of {} files\n", names.len());
    let name = |i: u32| names.get(i as usize).copied().unwrap_or_default();
    // Writing to a string can't fail.
    if let Some(intersections) = &set.intersections {
        let more = if intersections.complete { "" } else { " or more; the count was not finished" };
        let _ = writeln!(text, "  pairs of intersecting faces between files: {}{more}", intersections.total);
        for pair in intersections.between.iter().take(MAX_PAIRS) {
            let more = if pair.complete { "" } else { " or more" };
            let [a, b] = pair.meshes;
            let _ = writeln!(text, "    {} and {}: {}{more}", name(a), name(b), pair.pairs);
        }
        if intersections.between.len() > MAX_PAIRS {
            let _ = writeln!(text, "    and {} more pairs of files", intersections.between.len() - MAX_PAIRS);
        }
    }
    if let Some(spacing) = &set.spacing {
        match &spacing.all {
            Some(all) => text += &distribution("distance from each vertex to the nearest other file", all, style),
            None => {
                text += "  distance from each vertex to the nearest other file: not measurable, fewer than two files have faces\n"
            }
        }
        for (i, of_mesh) in (0u32..).zip(&spacing.of_mesh) {
            if let Some(distances) = &of_mesh.distances {
                text += &statistics(&format!("from {}", name(i)), distances);
            }
            if let Some(nearest) = &of_mesh.nearest {
                let (from, to) = (format_point(nearest.from), format_point(nearest.to));
                let _ = writeln!(
                    text,
                    "    nearest: {} from {from} to {to} on {}, face {}",
                    format_number(nearest.distance),
                    name(nearest.mesh),
                    nearest.face
                );
            }
            if !of_mesh.complete {
                text += "    some vertices were not measured\n";
            }
        }
    }
    text
}
