//! `meshmend inspect`: what is wrong with files, one after another, and what is measured between them.

mod defects;
mod figures;
mod subject;
mod text;

use std::fmt::Write as _;
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;
use meshmend::analyze::subject;
use meshmend::format::{self, Limits, ReadFile, ReadMesh, ReadOptions};
use meshmend::inspect::{Analysis, InspectOptions, Level, SetReport, Thresholds, goodness, inspect};
use meshmend::mesh::Soup;
use meshmend::repair::{Cancelled, Context};
use serde_json::{Value, json};

use self::figures::{Style, distribution, figure, figures, point};
use self::subject::{
    Failure, Input, Inspected, MeasureArgs, Prefixes, SOUND, in_context, inputs, reasons, verdict_in_words,
    verdict_line,
};
use super::engine::{LimitArgs, read_file};
use super::exit;

/// The version of the JSON that `--json` prints.
const JSON_VERSION: u32 = 1;

/// Arguments of `meshmend inspect`.
#[derive(Debug, Args)]
pub struct InspectArgs {
    /// Models: STL, OBJ, PLY, OFF or Vertex/Face text, told by their content; a folder stands for the models in it, by name.
    #[arg(required = true, value_name = "FILE or FOLDER")]
    inputs: Vec<PathBuf>,
    /// How closely to look: `none` counts and tells attributes, `basic` also looks for defects that need no search in
    /// space, `full` for all. Without it: full, or what --attributes needs.
    #[arg(long, env = "MESHMEND_LEVEL", value_enum)]
    level: Option<Level>,
    /// Tell only whether the mesh is closed, manifold, consistent and outward.
    #[arg(short, long, env = "MESHMEND_ATTRIBUTES", conflicts_with = "good")]
    attributes: bool,
    /// Tell only whether the mesh is good, 1 or 0: nothing wrong with it, every aspect ratio (longest edge over
    /// shortest altitude) below the first number, every edge angle above the second, in radians, and every edge longer
    /// than the third. It is then the exit code, too.
    #[arg(short, long, env = "MESHMEND_GOOD", value_name = "RATIO,ANGLE,LENGTH", value_parser = subject::thresholds)]
    good: Option<Thresholds>,
    /// List every offending element with its place.
    #[arg(short = 'p', long, env = "MESHMEND_OFFENDERS")]
    offenders: bool,
    /// Of several files: count faces that intersect faces of another file. A folder without --attributes, --good and --spacing implies it.
    #[arg(short, long, env = "MESHMEND_INTERSECTIONS")]
    intersections: bool,
    /// Of several files: measure the distance from each vertex to the nearest surface of another file. Every file must be good (see --good),
    /// whatever its shapes. A folder without --attributes, --good and --intersections implies it.
    #[arg(short, long, env = "MESHMEND_SPACING")]
    spacing: bool,
    /// Where to draw what was found: defects.png, defects.glb and defects.ply, of several files each after its name, as
    /// in part-defects.png. The folder is made.
    #[arg(long, env = "MESHMEND_PICTURES", value_name = "FOLDER")]
    pictures: Option<PathBuf>,
    /// Print JSON.
    #[arg(long, env = "MESHMEND_JSON")]
    json: bool,
    #[command(flatten)]
    measures: MeasureArgs,
    #[command(flatten)]
    limits: LimitArgs,
}

impl InspectArgs {
    /// Whether a folder stands alone, so that everything is measured between its files.
    fn is_folder_alone(&self) -> bool {
        let asked = self.attributes || self.good.is_some() || self.intersections || self.spacing;
        !asked && self.inputs.iter().any(|path| path.is_dir())
    }

    fn wants_intersections(&self) -> bool {
        self.intersections || self.is_folder_alone()
    }

    fn wants_spacing(&self) -> bool {
        self.spacing || self.is_folder_alone()
    }

    fn options(&self) -> Result<InspectOptions, String> {
        // Places and pictures want something to be looked for.
        let needed = match (self.attributes, self.offenders || self.pictures.is_some()) {
            (true, false) if !self.spacing => Level::None,
            (true, true) if !self.spacing => Level::Basic,
            _ => Level::Full,
        };
        let given = self.measures.options()?;
        let places = if self.offenders { usize::MAX } else { given.places };
        Ok(InspectOptions { level: self.level.unwrap_or(needed), places, ..given })
    }
}

/// Runs `meshmend inspect`.
pub fn run(args: &InspectArgs) -> ExitCode {
    match Run::new(args).and_then(Run::all) {
        Ok(code) => ExitCode::from(code),
        Err((code, message)) => exit::fail(code, message),
    }
}

/// The files one after another.
struct Run<'a> {
    args: &'a InspectArgs,
    limits: Limits,
    options: InspectOptions,
    style: Style,
    files: Vec<Input>,
    code: u8,
    json: Vec<Value>,
    /// Kept for what is measured between files.
    kept: Vec<(String, ReadMesh)>,
    /// The files that are not good, with the reasons, where distances between files are measured.
    not_good: Vec<(String, String)>,
    printed: bool,
    /// Names for drawings, where there are several files.
    prefixes: Option<Prefixes>,
}

impl<'a> Run<'a> {
    fn new(args: &'a InspectArgs) -> Result<Self, Failure> {
        let options = args.options().map_err(|message| (exit::BAD_INPUT, message))?;
        let files = inputs(&args.inputs).map_err(|message| (exit::BAD_INPUT, message))?;
        let unicode = std::io::stdout().is_terminal() && std::env::var_os("NO_COLOR").is_none();
        Ok(Self {
            args,
            limits: args.limits.limits(),
            options,
            style: Style { unicode },
            prefixes: (files.len() > 1).then(Prefixes::default),
            files,
            code: exit::PRINTABLE,
            json: Vec::new(),
            kept: Vec::new(),
            not_good: Vec::new(),
            printed: false,
        })
    }

    fn all(mut self) -> Result<u8, Failure> {
        for input in std::mem::take(&mut self.files) {
            let name = input.path.display().to_string();
            let read = read_file(&input.path, &self.limits).and_then(|bytes| {
                format::read_shape(&bytes, &ReadOptions::within(self.limits))
                    .map_err(|error| format!("{name}: {error}"))
            });
            match read {
                Ok(file) => self.one(&input.path, name, file)?,
                Err(_) if !input.named => {}
                Err(message) => {
                    self.code = exit::BAD_INPUT;
                    self.json.push(json!({ "path": name, "error": message }));
                    exit::fail(exit::BAD_INPUT, message);
                }
            }
        }
        let set = self.set()?;
        if self.args.json {
            let not_good: Vec<Value> =
                self.not_good.iter().map(|(path, reasons)| json!({ "path": path, "reasons": reasons })).collect();
            let value = json!({ "version": JSON_VERSION, "files": self.json, "set": set, "not_good": not_good });
            self.print(&format!("{value:#}\n"))?;
        } else if let Some(set) = set {
            let names: Vec<&str> = self.kept.iter().map(|(name, _)| name.as_str()).collect();
            let text = set_text(&set, &names, self.style);
            self.print(&text)?;
        }
        Ok(self.code)
    }

    fn one(&mut self, path: &Path, name: String, mut file: ReadFile) -> Result<(), Failure> {
        let unit = file.settle_unit(self.options.unit, None);
        let mesh = file.mesh;
        let (inspection, findings) = in_context(|context| inspect(subject(&mesh, Some(&unit)), &self.options, context))
            .map_err(|e| (exit::INTERNAL, e))?;
        let goodness = self.args.good.map(|thresholds| goodness(&inspection, thresholds));
        let inspected = Inspected { name, mesh, inspection, findings, goodness };
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
            self.kept.push((inspected.name, inspected.mesh));
        }
        Ok(())
    }

    fn text(&self, file: &Inspected) -> String {
        let apart = if self.printed { "\n" } else { "" };
        let all = self.args.offenders;
        let mut places = if all { defects::section(file, true) } else { String::new() };
        if all {
            places += &self.offenders(file);
        }
        match &file.goodness {
            Some(it) if all => format!("{apart}{}{places}", verdict_in_words(&file.name, it)),
            Some(it) => verdict_line(&file.name, it),
            None if self.args.attributes => format!("{apart}{}{places}", text::attributes_only(file)),
            None if all => format!("{apart}{}{}", text::report(file, self.style, all), self.offenders(file)),
            None => format!("{apart}{}", text::report(file, self.style, all)),
        }
    }

    /// Offending elements by number; nothing where their search was stopped.
    fn offenders(&self, file: &Inspected) -> String {
        let of = |context: &Context<'_>| {
            let analysis = Analysis::new((&file.mesh.soup).into(), context)?;
            Ok::<_, Cancelled>(defects::offenders(file, &analysis, self.args.good.as_ref()))
        };
        in_context(of).unwrap_or_default()
    }

    /// What is measured of all files together, where it was asked for and there are several.
    fn set(&self) -> Result<Option<SetReport>, Failure> {
        if self.kept.len() < 2 && (self.args.intersections || self.args.spacing) {
            let note = "note: --intersections and --spacing are measured between files, and want at least two";
            drop(writeln!(std::io::stderr(), "meshmend: {note}"));
        }
        let meshes: Vec<&Soup> = self.kept.iter().map(|(_, mesh)| &mesh.soup).collect();
        let spacing = self.args.wants_spacing() && self.not_good.is_empty();
        if self.args.wants_spacing() && self.kept.len() > 1 {
            for (name, reasons) in &self.not_good {
                let note =
                    format!("note: distances between files are not measured, since {name} is not good: {reasons}");
                drop(writeln!(std::io::stderr(), "meshmend: {note}"));
            }
        }
        in_context(|context| SetReport::of(&meshes, self.args.wants_intersections(), spacing, context))
            .map_err(|e| (exit::INTERNAL, e))
    }

    fn print(&mut self, text: &str) -> Result<(), Failure> {
        self.printed = true;
        std::io::stdout().write_all(text.as_bytes()).map_err(|e| (exit::INTERNAL, e.to_string()))
    }
}

/// Pairs of files that are listed; JSON has all.
const MOST_PAIRS: usize = 20;

/// What was measured between the files of these names.
fn set_text(set: &SetReport, names: &[&str], style: Style) -> String {
    let mut text = format!("\nSet of {} files\n", names.len());
    let name = |i: u32| names.get(i as usize).copied().unwrap_or_default();
    // Writing to a string can't fail.
    if let Some(it) = &set.intersections {
        let more = if it.complete { "" } else { " or more: not all were counted" };
        let _ = writeln!(text, "  pairs of intersecting faces between files: {}{more}", it.total);
        for pair in it.between.iter().take(MOST_PAIRS) {
            let more = if pair.complete { "" } else { " or more" };
            let [a, b] = pair.meshes;
            let _ = writeln!(text, "    {} and {}: {}{more}", name(a), name(b), pair.pairs);
        }
        if it.between.len() > MOST_PAIRS {
            let _ = writeln!(text, "    and {} more pairs of files", it.between.len() - MOST_PAIRS);
        }
    }
    if let Some(it) = &set.spacing {
        match &it.all {
            Some(all) => text += &distribution("distance from each vertex to the nearest other file", all, style),
            None => text += "  distance from each vertex to the nearest other file: no two files have a face\n",
        }
        for (i, of_mesh) in (0u32..).zip(&it.of_mesh) {
            if let Some(distances) = &of_mesh.distances {
                text += &figures(&format!("from {}", name(i)), distances);
            }
            if let Some(nearest) = &of_mesh.nearest {
                let (from, to) = (point(nearest.from), point(nearest.to));
                let _ = writeln!(
                    text,
                    "    nearest: {} from {from} to {to} on {}, face {}",
                    figure(nearest.distance),
                    name(nearest.mesh),
                    nearest.face
                );
            }
            if !of_mesh.complete {
                text += "    not every vertex was measured\n";
            }
        }
    }
    text
}
