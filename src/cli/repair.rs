//! `meshmend repair`, and the repair options that `meshmend submit` shares with it.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use clap::Args;
use meshmend::allocator::restart_for_large_input;
#[cfg(target_os = "linux")]
use meshmend::blender::OnDemandBlender;
#[cfg(feature = "service")]
use meshmend::printing::profile::Profile;
use meshmend::render::Drawing;
use meshmend::repair::operators::holes::HoleFilling;
use meshmend::repair::operators::orient::Nested;
use meshmend::repair::operators::stitch::StitchPosition;
use meshmend::repair::{
    AlternativeRequest, Category, Context, Merge, OfferedFile, OpenSheets, Operator, Options, OutputFormat, Overlaps,
    Preset, Remesher, RepairError, Repaired, Report, Require, Verify, WindingRuleChoice, draw, monotonic_clock, repair,
};
use meshmend::scene::Unit;
use serde::Serialize;

use super::alternatives::{alternative_lines, path_of, write_alternatives};
#[cfg(target_os = "linux")]
use super::engine::BlenderArgs;
use super::engine::{LimitArgs, ProgressReporter, read_file, remark_lines, write_file};
use super::exit;
use super::print_options::PrintOptionArgs;

/// Arguments of `meshmend repair`.
#[derive(Debug, Args)]
pub struct RepairArgs {
    /// The model: STL, OBJ, PLY, OFF, 3MF, GLB, glTF, Vertex/Face text, or a ZIP archive of one of them. The content
    /// decides the format, not the name.
    input: PathBuf,
    /// File for the result; its extension (.stl, .obj, .ply, .off, .mesh, .glb, .3mf, .zip) sets the format.
    #[arg(short, long, env = "MESHMEND_OUTPUT")]
    output: PathBuf,
    /// File for the report, as JSON.
    #[arg(long, env = "MESHMEND_REPORT", value_name = "FILE")]
    report: Option<PathBuf>,
    #[command(flatten)]
    options: RepairOptionArgs,
    /// Folder for pictures of the defects and the changes: before.png, after.png, defects.glb, defects.ply,
    /// change.png, change.glb and change.ply. A missing folder is created.
    #[arg(long, env = "MESHMEND_PICTURES", value_name = "FOLDER")]
    pictures: Option<PathBuf>,
    /// Print what each step does.
    #[arg(short, long, env = "MESHMEND_VERBOSE")]
    verbose: bool,
    #[command(flatten)]
    limits: LimitArgs,
    #[cfg(target_os = "linux")]
    #[command(flatten)]
    blender: BlenderArgs,
}

/// Runs `meshmend repair`.
pub fn run(args: &RepairArgs) -> ExitCode {
    restart_for_large_input(&args.input);
    let options = format_from_extension(&args.output).and_then(|format| args.options.options(format));
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
    let bar = ProgressReporter::new(args.verbose);
    let context = Context::new(&bar, &cancel, &clock, Duration::from_secs_f64(options.deadline_s));
    #[cfg(target_os = "linux")]
    let blender = OnDemandBlender::new(args.blender.config());
    #[cfg(target_os = "linux")]
    let remesher: Option<&dyn Remesher> = Some(&blender);
    // Tier 3 needs the sandbox, which is for Linux.
    #[cfg(not(target_os = "linux"))]
    let remesher: Option<&dyn Remesher> = None;
    let mut repaired = match repair(&bytes, &options, &limits, remesher, &context) {
        Ok(repaired) => repaired,
        Err(error @ (RepairError::Read(_) | RepairError::Options(_))) => {
            bar.finish();
            return exit::fail(exit::BAD_INPUT, format!("{}: {error}", args.input.display()));
        }
        Err(error) => {
            bar.finish();
            return exit::fail(exit::INTERNAL, error);
        }
    };
    let request = AlternativeRequest { input: &bytes, options: &options, limits: &limits, remesher, context: &context };
    let written = write(args, request, &mut repaired);
    bar.finish();
    if let Err(message) = written {
        return exit::fail(exit::INTERNAL, message);
    }
    if let Some(folder) = &args.pictures {
        let result = (repaired.report.verdict.file != OfferedFile::None).then_some(repaired.bytes.as_slice());
        match draw(&bytes, result, &options, &limits, &context) {
            Ok(drawings) => {
                if let Err(message) = write_drawings(folder, "", &drawings) {
                    return exit::fail(exit::INTERNAL, message);
                }
            }
            // The result is written already, so missing pictures are no failure.
            Err(error) => drop(writeln!(std::io::stderr(), "  note: no pictures were drawn: {error}")),
        }
    }
    print_summary(&repaired, &args.output);
    ExitCode::from(exit::of(&repaired.report))
}

/// The report as a job of the service has it: `mode` says which kind.
#[derive(Serialize)]
struct JobReport<'a> {
    mode: &'static str,
    #[serde(flatten)]
    report: &'a Report,
}

/// Writes the model, unless the repair returns none. Also writes the alternatives with `--alternatives`, and the report with `--report`.
fn write(args: &RepairArgs, request: AlternativeRequest<'_>, repaired: &mut Repaired) -> Result<(), String> {
    if repaired.report.verdict.file != OfferedFile::None {
        write_file(&args.output, &repaired.bytes)?;
    }
    if request.options.alternatives {
        write_alternatives(request, repaired, &args.output, args.pictures.as_deref())?;
    }
    let Some(path) = &args.report else { return Ok(()) };
    let report = JobReport { mode: "repair", report: &repaired.report };
    serde_json::to_vec_pretty(&report).map_err(|e| e.to_string()).and_then(|json| write_file(path, &json))
}

/// Writes drawings into a folder, named by a prefix and their own names. A missing folder is created.
///
/// # Errors
/// The path with the message of the operating system.
pub fn write_drawings(folder: &Path, prefix: &str, drawings: &[Drawing]) -> Result<(), String> {
    std::fs::create_dir_all(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    drawings
        .iter()
        .try_for_each(|drawing| write_file(&folder.join(format!("{prefix}{}", drawing.name)), &drawing.bytes))
}

/// Prints the summary on standard error; standard output stays free for data. If no model was written, the last line
/// says why.
fn print_summary(repaired: &Repaired, path: &Path) {
    let (report, output) = (&repaired.report, path.display());
    let mut lines = vec![format!("{output}: {}", report.summary)];
    lines.extend(report.print_ready.as_ref().map(|readiness| format!("  {}", readiness.in_words())));
    let flags = report.red_flags.iter().map(|flag| flag.detail.as_str());
    let assumptions =
        report.assumptions.iter().map(|assumption| (assumption.detail.as_str(), assumption.option.as_deref()));
    lines.extend(remark_lines(flags, assumptions, &report.warnings));
    let alternatives = report.alternatives.iter();
    lines.extend(alternatives.flat_map(|them| alternative_lines(them, |id| Some(path_of(path, id)))));
    if report.refusal().is_some() {
        lines.push(format!(
            "meshmend: {output} was not written: the result does not meet `--require {}`",
            report.options.require.as_str()
        ));
    } else if report.verdict.file == OfferedFile::None {
        lines.push(format!("meshmend: {output} was not written: the repair gave no model"));
    }
    let _ = writeln!(std::io::stderr(), "{}", lines.join("\n"));
}

/// Cancels the repair at the first interrupt, so that Blender ends and its scratch folder is removed. A second
/// interrupt ends the process.
fn stop_on_interrupt() -> Arc<AtomicBool> {
    let cancel = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&cancel);
    // Without a handler, an interrupt ends the process at once.
    let _ = ctrlc::set_handler(move || {
        if flag.swap(true, Ordering::Relaxed) {
            std::process::exit(exit::INTERRUPTED.into());
        }
    });
    cancel
}

/// The options of a repair, for `repair` and `submit`.
#[derive(Debug, Args)]
pub struct RepairOptionArgs {
    /// Repair plan to run. `auto` chooses a plan by the damage found.
    #[arg(long, env = "MESHMEND_PRESET", value_enum, default_value_t)]
    preset: Preset,
    /// With the preset `auto`: category of damage to plan for, instead of the category that the inspection finds.
    #[arg(long, env = "MESHMEND_CATEGORY", value_enum)]
    category: Option<Category>,
    /// Treatment of separate objects, if the formats of the file and of the result both have objects.
    #[arg(long, env = "MESHMEND_MERGE", value_enum, default_value_t)]
    merge: Merge,
    /// Result that the repair must reach to succeed.
    #[arg(long, env = "MESHMEND_REQUIRE", value_enum, default_value_t)]
    require: Require,
    /// Extent of the check of a result for intersecting faces. Both values give the same verdict; `full` takes longer.
    #[arg(long, env = "MESHMEND_VERIFY", value_enum, default_value_t)]
    verify: Verify,
    /// Unit of the file's lengths; overrides a unit that the file states. Default: the file's unit, or mm.
    #[arg(long, env = "MESHMEND_UNIT", value_enum)]
    unit: Option<Unit>,
    /// Unit to convert the model to. Options that are lengths are in this unit.
    #[arg(long, env = "MESHMEND_SCALE_TO", value_enum, value_name = "UNIT")]
    scale_to: Option<Unit>,
    /// Additional operators to run that are off by default.
    #[arg(long, env = "MESHMEND_WITH", value_enum, value_delimiter = ',', value_name = "OPERATORS")]
    with: Vec<Operator>,
    /// Operators to leave out.
    #[arg(long, env = "MESHMEND_WITHOUT", value_enum, value_delimiter = ',', value_name = "OPERATORS")]
    without: Vec<Operator>,
    /// Farthest that the repair may move surface, or create surface away from the input, in the model's unit. Patches
    /// over holes are exempt.
    #[arg(long, env = "MESHMEND_MAX_DEVIATION")]
    max_deviation: Option<f64>,
    /// Most faces that the result should have.
    #[arg(long, env = "MESHMEND_MAX_FACES")]
    max_faces: Option<u64>,
    /// Largest distance between the surface before and after faces are reduced, in the model's unit. Without
    /// --max-faces, faces are reduced as far as this distance allows.
    #[arg(long, env = "MESHMEND_MAX_ERROR")]
    max_error: Option<f64>,
    /// Highest tier that may run: 1 cleans up, 2 also repairs, 3 also uses Blender.
    #[arg(long, env = "MESHMEND_MAX_TIER", default_value_t = Options::default().max_tier)]
    max_tier: u8,
    /// Time limit in seconds; then the best result so far is written.
    #[arg(long, env = "MESHMEND_DEADLINE_S", default_value_t = Options::default().deadline_s)]
    deadline_s: f64,
    /// Largest accepted loss of faces, in percent; more raises a red flag.
    #[arg(long, env = "MESHMEND_MAX_FACE_LOSS_PCT", default_value_t = Options::default().max_face_loss_pct)]
    max_face_loss_pct: f64,
    /// Largest accepted loss of vertices, in percent; more raises a red flag.
    #[arg(long, env = "MESHMEND_MAX_VERTEX_LOSS_PCT", default_value_t = Options::default().max_vertex_loss_pct)]
    max_vertex_loss_pct: f64,
    /// Largest accepted change of the bounding box, in percent; more raises a red flag.
    #[arg(long, env = "MESHMEND_MAX_BOUNDING_BOX_CHANGE_PCT", default_value_t = Options::default().max_bounding_box_change_pct)]
    max_bounding_box_change_pct: f64,
    /// Largest accepted change of the volume, in percent; more raises a red flag.
    #[arg(long, env = "MESHMEND_MAX_VOLUME_CHANGE_PCT", default_value_t = Options::default().max_volume_change_pct)]
    max_volume_change_pct: f64,
    /// Largest accepted share of the visible surface without a counterpart in the result, in percent; more raises a
    /// red flag.
    #[arg(long, env = "MESHMEND_MAX_SURFACE_LOST_PCT", default_value_t = Options::default().max_surface_lost_pct)]
    max_surface_lost_pct: f64,
    /// Largest accepted share of the result's surface that the input does not have, in percent; more raises a red
    /// flag.
    #[arg(long, env = "MESHMEND_MAX_SURFACE_ADDED_PCT", default_value_t = Options::default().max_surface_added_pct)]
    max_surface_added_pct: f64,
    /// Distance within which boundary vertices are merged, as a share of the model's diagonal.
    #[arg(long, env = "MESHMEND_WELD_TOLERANCE", default_value_t = Options::default().weld_tolerance)]
    weld_tolerance: f64,
    /// Distance within which any vertices are merged, on a boundary or not, in the model's unit.
    #[arg(long, env = "MESHMEND_MERGE_DISTANCE")]
    merge_distance: Option<f64>,
    /// Distance within which boundary vertices are merged, as a share of the shortest boundary edge at either vertex.
    /// Default: 0.2, for vertices no farther apart than 0.1 % of the model's diagonal.
    #[arg(long, env = "MESHMEND_SEW_RATIO")]
    sew_ratio: Option<f64>,
    /// Widest crack to stitch, as a share of the model's diagonal. Default: 0.001.
    #[arg(long, env = "MESHMEND_STITCH_THRESHOLD")]
    stitch_threshold: Option<f64>,
    /// Widest crack to stitch, in the model's unit; replaces --stitch-threshold.
    #[arg(long, env = "MESHMEND_STITCH_DISTANCE")]
    stitch_distance: Option<f64>,
    /// Share of an edge's length at each end within which stitching uses the end vertex instead of splitting the
    /// edge.
    #[arg(long, env = "MESHMEND_STITCH_EPSILON", default_value_t = Options::default().stitch_epsilon)]
    stitch_epsilon: f64,
    /// Position of the vertex that results from stitching two vertices.
    #[arg(long, env = "MESHMEND_STITCH_POSITION", value_enum, default_value_t)]
    stitch_position: StitchPosition,
    /// Edges shorter and faces of less height than this share of the model's diagonal are removed.
    #[arg(long, env = "MESHMEND_DEGENERATE_TOLERANCE", default_value_t = Options::default().degenerate_tolerance)]
    degenerate_tolerance: f64,
    /// With `remove_overlapping_neighbours`: angle in degrees up to which two neighbouring faces count as lying on
    /// each other. Default: 1, for faces no farther apart than 0.01 % of the model's diagonal.
    #[arg(long, env = "MESHMEND_OVERLAP_ANGLE_DEG")]
    overlap_angle_deg: Option<f64>,
    /// Polygons twisted by more degrees than this are split into the triangles with the smallest fold.
    #[arg(long, env = "MESHMEND_TWIST_ANGLE_DEG", default_value_t = Options::default().twist_angle_deg)]
    twist_angle_deg: f64,
    /// Most boundary edges of a hole that may be closed.
    #[arg(long, env = "MESHMEND_MAX_HOLE_EDGES", default_value_t = Options::default().max_hole_edges)]
    max_hole_edges: u32,
    /// Smallest volume of a closed part, in percent of the volume of all parts. Smaller parts are removed; 0 keeps
    /// all.
    #[arg(long, env = "MESHMEND_MIN_PART_VOLUME_PCT", default_value_t = Options::default().min_part_volume_pct)]
    min_part_volume_pct: f64,
    /// Orientation of closed parts that lie inside other parts.
    #[arg(long, env = "MESHMEND_NESTED", value_enum, default_value_t)]
    nested: Nested,
    /// Treatment of parts that overlap.
    #[arg(long, env = "MESHMEND_OVERLAPS", value_enum, default_value_t)]
    overlaps: Overlaps,
    /// Rule for what is solid where faces intersect, by how many times the surface winds around it.
    #[arg(long, env = "MESHMEND_WINDING_RULE", value_enum, default_value_t)]
    winding_rule: WindingRuleChoice,
    /// Treatment of open sheets, which enclose nothing.
    #[arg(long, env = "MESHMEND_OPEN_SHEETS", value_enum, default_value_t)]
    open_sheets: OpenSheets,
    /// Thickness of thickened sheets, and of a base at its lowest point, in the model's unit. Default: 0.3 % of the
    /// diagonal.
    #[arg(long, env = "MESHMEND_THICKNESS")]
    thickness: Option<f64>,
    /// Largest extent of a hole that may be closed, as a share of the model's diagonal.
    #[arg(long, env = "MESHMEND_MAX_HOLE_SIZE", default_value_t = Options::default().max_hole_size)]
    max_hole_size: f64,
    /// Most holes to close. If there are more, the smallest are closed.
    #[arg(long, env = "MESHMEND_MAX_HOLES", default_value_t = Options::default().max_holes)]
    max_holes: u32,
    /// Method that triangulates the patch over a hole.
    #[arg(long, env = "MESHMEND_HOLE_FILLING", value_enum, default_value_t = HoleFilling::Auto)]
    hole_filling: HoleFilling,
    /// Give curved patches inner vertices, as dense as the mesh around the hole.
    #[arg(long, env = "MESHMEND_REFINE_PATCHES")]
    refine_patches: bool,
    /// Refine patches and curve them to continue the surrounding surface smoothly.
    #[arg(long, env = "MESHMEND_FAIR_PATCHES")]
    fair_patches: bool,
    /// Edge length of the voxels of a remesh, in the model's unit.
    #[arg(long, env = "MESHMEND_VOXEL_SIZE")]
    voxel_size: Option<f64>,
    /// Number of voxels along the model's diagonal in a remesh.
    #[arg(long, env = "MESHMEND_VOXEL_RESOLUTION", default_value_t = Options::default().voxel_resolution)]
    voxel_resolution: u32,
    /// Most faces that a remesh may have.
    #[arg(long, env = "MESHMEND_MAX_REMESH_FACES", default_value_t = Options::default().max_remesh_faces)]
    max_remesh_faces: u64,
    /// Also make up to two other results where the file leaves the model's intent open, such as whether a double shell
    /// is a solid. Each result takes a further repair, within --deadline-s.
    #[arg(long, env = "MESHMEND_ALTERNATIVES")]
    alternatives: bool,
    #[command(flatten)]
    print: PrintOptionArgs,
}

impl RepairOptionArgs {
    /// The checked options for a result of format `output`.
    ///
    /// # Errors
    /// The message for the first option that is out of its range.
    pub fn options(&self, output: OutputFormat) -> Result<Options, String> {
        let options = self.unchecked_options(output)?;
        options.validate().map_err(|e| e.to_string())?;
        Ok(options)
    }

    /// The checked options for a job of a service, which may have its own process profiles.
    ///
    /// # Errors
    /// The message for the first option that is out of its range.
    #[cfg(feature = "service")]
    pub fn service_options(&self, output: OutputFormat) -> Result<Options, String> {
        let options = self.unchecked_options(output)?;
        let mut checked = options.clone();
        if checked.print.process.is_some() {
            checked.print.process = Profile::built_in().first().map(|profile| profile.name.clone());
        }
        if let Some(limits) = &mut checked.print.process_limits {
            limits.based_on = None;
        }
        checked.validate().map_err(|e| e.to_string())?;
        Ok(options)
    }

    fn unchecked_options(&self, output: OutputFormat) -> Result<Options, String> {
        Ok(Options {
            preset: self.preset,
            category: self.category,
            output,
            merge: self.merge,
            require: self.require,
            verify: self.verify,
            unit: self.unit,
            scale_to: self.scale_to,
            with: self.with.clone(),
            without: self.without.clone(),
            max_deviation: self.max_deviation,
            max_faces: self.max_faces,
            max_error: self.max_error,
            max_tier: self.max_tier,
            deadline_s: self.deadline_s,
            max_face_loss_pct: self.max_face_loss_pct,
            max_vertex_loss_pct: self.max_vertex_loss_pct,
            max_bounding_box_change_pct: self.max_bounding_box_change_pct,
            max_volume_change_pct: self.max_volume_change_pct,
            max_surface_lost_pct: self.max_surface_lost_pct,
            max_surface_added_pct: self.max_surface_added_pct,
            weld_tolerance: self.weld_tolerance,
            merge_distance: self.merge_distance,
            sew_ratio: self.sew_ratio,
            stitch_threshold: self.stitch_threshold,
            stitch_distance: self.stitch_distance,
            stitch_epsilon: self.stitch_epsilon,
            stitch_position: self.stitch_position,
            degenerate_tolerance: self.degenerate_tolerance,
            overlap_angle_deg: self.overlap_angle_deg,
            twist_angle_deg: self.twist_angle_deg,
            max_hole_edges: self.max_hole_edges,
            min_part_volume_pct: self.min_part_volume_pct,
            nested: self.nested,
            overlaps: self.overlaps,
            winding_rule: self.winding_rule,
            open_sheets: self.open_sheets,
            thickness: self.thickness,
            max_hole_size: self.max_hole_size,
            max_holes: self.max_holes,
            hole_filling: self.hole_filling,
            refine_patches: self.refine_patches,
            fair_patches: self.fair_patches,
            voxel_size: self.voxel_size,
            voxel_resolution: self.voxel_resolution,
            max_remesh_faces: self.max_remesh_faces,
            pictures: true,
            alternatives: self.alternatives,
            print: self.print.options()?,
        })
    }
}

/// The output format that the extension of a file name sets.
///
/// # Errors
/// An unknown extension.
pub fn format_from_extension(output: &Path) -> Result<OutputFormat, String> {
    let extension = output.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    Ok(match extension.as_str() {
        "stl" => OutputFormat::Stl,
        "obj" => OutputFormat::Obj,
        "ply" => OutputFormat::Ply,
        "off" => OutputFormat::Off,
        "mesh" => OutputFormat::Mesh,
        "glb" => OutputFormat::Glb,
        "3mf" => OutputFormat::ThreeMf,
        "zip" => OutputFormat::Zip,
        _ => {
            let name = output.display();
            return Err(format!(
                "{name}: the output file must end in .stl, .obj, .ply, .off, .mesh, .glb, .3mf or .zip"
            ));
        }
    })
}
