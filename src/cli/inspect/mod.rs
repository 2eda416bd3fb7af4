mod bars;
mod defects;
mod files;
mod good;
mod offenders;
mod options;
mod pictures;
mod print;
mod set;
mod text;

use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use clap::Args;
use meshmend::analyze::subject;
use meshmend::format::{self, Limits, ReadFile, ReadMesh, ReadOptions};
use meshmend::inspect::{
    Analysis, Findings, Goodness, InspectOptions, Inspection, Level, SetReport, Thresholds, goodness, inspect,
};
use meshmend::mesh::Soup;
use meshmend::render::{Marked, draw_inspected};
use meshmend::repair::{Cancelled, Context, monotonic_clock};
use serde_json::{Value, json};

use super::engine::{Bar, LimitArgs, read_file};
use super::exit;
use super::repair::write_drawings;
use bars::Style;
use files::{Input, inputs};
use options::MeasureArgs;
use pictures::Prefixes;

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
    #[arg(short, long, env = "MESHMEND_GOOD", value_name = "RATIO,ANGLE,LENGTH", value_parser = good::thresholds)]
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

/// One file looked at.
struct Look {
    name: String,
    mesh: ReadMesh,
    inspection: Inspection,
    findings: Findings,
    goodness: Option<Goodness>,
}

impl Look {
    fn code(&self) -> u8 {
        // What the level does not look for is not held against the mesh.
        let measures = &self.inspection.measures;
        let looks_fine = || measures.verdict().unwrap_or(!measures.self_intersections.checked);
        let fine = self.goodness.as_ref().map_or_else(looks_fine, |it| it.good);
        if fine { exit::PRINTABLE } else { exit::PARTIAL }
    }

    /// Draws what was found.
    fn draw(&self, folder: &Path, prefix: &str) -> Result<(), Failure> {
        let marked = Marked { soup: &self.mesh.soup, findings: &self.findings };
        let drawings = in_context(|context| draw_inspected(marked, context));
        let written = drawings.and_then(|drawings| write_drawings(folder, prefix, &drawings));
        written.map_err(|message| (exit::INTERNAL, format!("{}: no pictures: {message}", self.name)))
    }

    fn to_json(&self) -> Value {
        json!({
            "path": self.name, "format": self.mesh.format, "dialect": self.mesh.dialect,
            "warnings": self.mesh.warnings, "printable": self.inspection.measures.verdict(),
            "goodness": self.goodness, "inspection": self.inspection,
        })
    }
}

/// Runs `meshmend inspect`.
pub fn run(args: &InspectArgs) -> ExitCode {
    match Run::new(args).and_then(Run::all) {
        Ok(code) => ExitCode::from(code),
        Err((code, message)) => exit::fail(code, message),
    }
}

type Failure = (u8, String);

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
            let text = set::text(&set, &names, self.style);
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
        let look = Look { name, mesh, inspection, findings, goodness };
        self.code = self.code.max(look.code());
        if self.args.json {
            self.json.push(look.to_json());
        } else {
            let text = self.text(&look);
            self.print(&text)?;
        }
        if let Some(folder) = &self.args.pictures {
            let prefix = self.prefixes.as_mut().map_or_else(String::new, |prefixes| prefixes.of(path));
            look.draw(folder, &prefix)?;
        }
        if self.args.wants_spacing() {
            let sound = meshmend::inspect::goodness(&look.inspection, good::SOUND);
            if !sound.good {
                self.not_good.push((look.name.clone(), good::reasons(&sound)));
            }
        }
        if self.args.wants_intersections() || self.args.wants_spacing() {
            self.kept.push((look.name, look.mesh));
        }
        Ok(())
    }

    fn text(&self, look: &Look) -> String {
        let apart = if self.printed { "\n" } else { "" };
        let all = self.args.offenders;
        let mut places = if all { defects::section(look, true) } else { String::new() };
        if all {
            places += &self.offenders(look);
        }
        match &look.goodness {
            Some(it) if all => format!("{apart}{}{places}", good::in_words(&look.name, it)),
            Some(it) => good::line(&look.name, it),
            None if self.args.attributes => format!("{apart}{}{places}", text::attributes_only(look)),
            None if all => format!("{apart}{}{}", text::report(look, self.style, all), self.offenders(look)),
            None => format!("{apart}{}", text::report(look, self.style, all)),
        }
    }

    /// Offending elements by number; nothing where their search was stopped.
    fn offenders(&self, look: &Look) -> String {
        let of = |context: &Context<'_>| {
            let analysis = Analysis::new((&look.mesh.soup).into(), context)?;
            Ok::<_, Cancelled>(offenders::section(look, &analysis, self.args.good.as_ref()))
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

/// Works with a bar on the terminal.
fn in_context<T, E: ToString>(work: impl FnOnce(&Context<'_>) -> Result<T, E>) -> Result<T, String> {
    let (clock, cancel, bar) = (monotonic_clock(), AtomicBool::new(false), Bar::new(false));
    let done = work(&Context::new(&bar, &cancel, &clock, Duration::MAX));
    bar.finish();
    done.map_err(|e| e.to_string())
}
