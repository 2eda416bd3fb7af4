use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::abridge::ReportedOptions;
use super::operators::Failure;
use super::verdict::Judged;
use super::{
    Assumption, Change, ObjectReport, Operator, OptionNotApplied, Options, Outcome, Preset, RemesherInfo, Verdict,
};
use crate::format::Format;
use crate::inspect::Inspection;
pub use crate::inspect::{Certificate, Changes, Ledger, LostPart, PartCertificate};
use crate::scene::LengthUnit;

/// The version of [`Report`]'s structure. 2: `before` and `after` are inspections, which add `version`, `level` and
/// `defects` to the measures of version 1. 3: a plan's actions list their operators, and a step is one operator. 4:
/// adds `ledger`, `changes.surface` and the red flag `part_lost`. 5: adds `unit` and `objects`.
/// 6: adds `verdict`, `assumptions`, `options_not_applied`, `steps[].unfixed` and the red flags `surface_invented`, `objects_intersect` and `vertex_loss`.
/// 7: adds `abridged`, and `operators` of a planned action may be left out.
pub const REPORT_VERSION: u32 = 7;

/// What kind of trouble a model is in, after the MeshPrep repair strategy guide ("Category-to-Filter Mapping").
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Category {
    /// Nothing is wrong.
    Clean,
    /// Boundaries only, a few.
    Holes,
    /// Boundaries only, many.
    ManySmallHoles,
    /// Non-manifold edges or vertices.
    NonManifold,
    /// Faces intersect.
    SelfIntersecting,
    /// Many parts, most of them open or tiny.
    Fragmented,
    /// More than one part.
    MultipleComponents,
    /// Faces turned the wrong way, nothing else.
    Orientation,
    /// Degenerate or duplicate faces, nothing else.
    Degenerate,
    /// A surface that encloses nothing, such as terrain or a single wall.
    OpenSheet,
    /// Several of these at once.
    Complex,
}

/// One thing a plan does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Action {
    /// Tier 1: weld, drop degenerate, duplicate and unreferenced (the guide's `trimesh_basic`).
    BasicCleanup,
    /// Tier 1: consistent and outward normals (`fix_normals`).
    FixNormals,
    /// Tier 1: close simple holes (`fill_holes`).
    FillHoles,
    /// Tier 2: close cracks and T-junctions, so that no hole has to be filled there.
    Stitch,
    /// Tier 2: mend everything in one part (`pymeshfix_repair`).
    Mend,
    /// Tier 2: mend each part apart (`pymeshfix_repair_conservative`).
    MendConservative,
    /// Tier 2: separate non-manifold edges and vertices (`make_manifold`).
    MakeManifold,
    /// Tier 2: remove what is bad and close the holes, while that makes it better.
    CleanAndPatch,
    /// Tier 2: make solids of open sheets.
    CloseSheets,
    /// Tier 2: unite what overlaps, so that no faces intersect.
    Resolve,
    /// Tier 2: keep apart by position what was cut apart by index.
    Separate,
    /// Remove faces as far as `max_faces` and `max_error` ask for it.
    Simplify,
    /// Drop closed parts smaller than `min_part_volume_pct`.
    DropSmallParts,
    /// Tier 2: make the surface anew around what is inside.
    NativeRemesh,
    /// Tier 3: voxel remesh (`blender_remesh`).
    VoxelRemesh,
    /// Tier 3: boolean union with itself (`blender_make_manifold`).
    BooleanUnion,
    /// Write, read back, weld by position and judge.
    Validate,
}

/// The account of one repair.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Report {
    /// Version of this structure.
    pub version: u32,
    /// Whether lists are shortened to their first items, and statistics, planned operators and idle steps are left out. Counts are always
    /// of everything.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub abridged: bool,
    /// Name and version of the engine.
    pub engine: String,
    /// What became of the model.
    pub outcome: Outcome,
    /// What is claimed of the file that is handed out.
    #[serde(default)]
    pub verdict: Verdict,
    /// The outcome in words, with what to do next where it is not good.
    pub summary: String,
    /// The input file.
    pub input: FileSummary,
    /// The result, of an `unrepairable` model what came in; none only if nothing can be written.
    #[schema(required)]
    pub output: Option<FileSummary>,
    /// The options that were in force; in an abridged report those that differ from their defaults.
    #[schema(value_type = Options)]
    pub options: ReportedOptions,
    /// The unit of every length in this report and of the result.
    pub unit: LengthUnit,
    /// The input, looked at before anything was processed but the unit; all its objects in their places as one mesh.
    pub before: Inspection,
    /// The result, looked at in the same way, on its own bytes. Objects that are kept apart may meet one another, and then what is printable
    /// apart is not as one mesh; the warnings say so.
    #[schema(required)]
    pub after: Option<Inspection>,
    /// Whether `after` was found on the written bytes, read back and welded by position.
    pub verified_from_output_bytes: bool,
    /// From `before` to `after`.
    #[schema(required)]
    pub changes: Option<Changes>,
    /// What became of each part of the input; none where the input itself is handed out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ledger: Option<Ledger>,
    /// What was going to be done, and why.
    pub plan: Plan,
    /// What was done, in order.
    pub steps: Vec<Step>,
    /// Every result that was judged; the chosen one is marked.
    pub candidates: Vec<Candidate>,
    /// Signs that the repair destroyed something, on the chosen result.
    pub red_flags: Vec<RedFlag>,
    /// Decisions that the input does not prove.
    #[serde(default)]
    pub assumptions: Vec<Assumption>,
    /// Options that were set and that the result does not follow, or only in part, and why; also those that found nothing to do.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub options_not_applied: Vec<OptionNotApplied>,
    /// Where the result has objects: each that was repaired, apart from the others and in its own coordinates, in the file's order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub objects: Vec<ObjectReport>,
    /// What the deadline left no time for, in the order of a repair; empty where there was time for everything.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<LeftOut>,
    /// What a person should know.
    pub warnings: Vec<String>,
    /// Time from first byte read to last byte written, in milliseconds.
    pub milliseconds: f64,
}

/// Work that the deadline left no time for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LeftOut {
    /// The search for intersecting faces in the input: whether it is printable is not known.
    InputVerification,
    /// The input's defects by place, its statistics and print measures: `before` has the level `none`.
    InputDetails,
    /// Repair: some operators or strategies did not run, or not to their end.
    Repair,
    /// The verification of a result that was made: that result is not handed out.
    Verification,
    /// The transfer of colours and materials to the result.
    Attributes,
    /// The result's defects by place, its statistics and print measures: `after` has the level `none`.
    ResultDetails,
    /// The shares of the surface that were kept, moved, added and removed.
    SurfaceChanges,
}

/// A file that went in or came out.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct FileSummary {
    /// Its format.
    pub format: Format,
    /// The dialect in words, such as `binary STL`.
    pub dialect: String,
    /// Its size.
    pub bytes: u64,
}

/// What is to be done, as data: made from the inspection, run afterwards.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Plan {
    /// What kind of trouble the model is in.
    pub category: Category,
    /// The preset in force, never `auto`.
    pub preset: Preset,
    /// Why this preset.
    pub reason: String,
    /// The rungs in order; each starts from the input, and the next runs only if the one before was not good enough.
    pub rungs: Vec<Rung>,
}

/// When a rung runs, given that none before it was good.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum When {
    /// Always.
    #[default]
    NothingGood,
    /// When a result before it was open or had lost surface that can be seen: sheets that enclose nothing.
    SheetsLeft,
    /// When no result before it is closed.
    NothingWhole,
}

/// One try of a plan.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Rung {
    /// When it runs.
    #[serde(default)]
    pub when: When,
    /// The highest tier it uses.
    pub tier: u8,
    /// The preset it comes from.
    pub preset: Preset,
    /// Its actions in order.
    pub actions: Vec<PlannedAction>,
}

/// An action and what it comes to with the options in force.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct PlannedAction {
    /// The action.
    pub action: Action,
    /// Its operators in order; none for tier 3, for validation and in an abridged report.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub operators: Vec<Operator>,
}

/// How a step ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum StepStatus {
    /// It ran.
    Done,
    /// It ran and made nothing; the note says why.
    Failed,
    /// It ran, made something worse than it was, and was undone; the note says what.
    Undone,
    /// It was not run; the note says why.
    Skipped,
}

/// One operator, remesh or validation that was run or passed over.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Step {
    /// Index of the rung in the plan.
    pub rung: u32,
    /// The tier, 1 to 3; 0 for validation.
    pub tier: u8,
    /// What it belongs to.
    pub action: Action,
    /// The operator; none for tier 3 and for validation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub operator: Option<Operator>,
    /// How it ended.
    pub status: StepStatus,
    /// How long it took.
    pub milliseconds: f64,
    /// What it changed.
    pub changed: Vec<Change>,
    /// The farthest that it moved a vertex, in the model's unit.
    #[serde(default)]
    pub moved: f64,
    /// Why it failed or was skipped, or what it left, in words.
    pub note: Option<String>,
    /// Why the operator did nothing, for the strategies after it; not in reports, which have the note.
    #[serde(skip)]
    pub(super) failure: Option<Failure>,
    /// Options that it could follow only in part.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub options_not_applied: Vec<OptionNotApplied>,
    /// Faces that it could not fix.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unfixed: Option<UnfixedFaces>,
    /// For tier 3: the program that ran.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub program: Option<RemesherInfo>,
    /// For tier 3: how often the program was started, more than once where it crashed.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub runs: u32,
    /// For tier 3: the voxel edge in the model's unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub voxel_size: Option<f64>,
}

/// Faces that an operator could not fix, such as those of which it could not tell the outer side.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct UnfixedFaces {
    /// How many.
    pub count: u64,
    /// The faces of the input file that they come from, by index from 0 and ascending; at most 1000, and none that were made.
    pub faces: Vec<u32>,
}

fn is_zero(count: &u32) -> bool {
    *count == 0
}

impl Step {
    /// A step that nothing is known of yet but what it is to do.
    pub(super) fn new(rung: u32, tier: u8, action: Action, operator: Option<Operator>) -> Self {
        Self {
            rung,
            tier,
            action,
            operator,
            status: StepStatus::Done,
            milliseconds: 0.0,
            changed: Vec::new(),
            moved: 0.0,
            note: None,
            failure: None,
            options_not_applied: Vec::new(),
            unfixed: None,
            program: None,
            runs: 0,
            voxel_size: None,
        }
    }
}

/// A result that was judged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Candidate {
    /// Index of the rung that made it; none for the input itself.
    #[schema(required)]
    pub rung: Option<u32>,
    /// Whether it passed every check.
    pub printable: bool,
    /// How many things are still wrong with it.
    pub defects: u64,
    /// Its faces.
    pub faces: u64,
    /// Its red flags.
    pub red_flags: Vec<RedFlag>,
    /// Whether it is the one handed out.
    pub chosen: bool,
}

impl Candidate {
    /// A result, and the index of the strategy that made it.
    pub(super) fn new(rung: Option<u32>, judged: &Judged, chosen: bool) -> Self {
        Self {
            rung,
            printable: judged.measures.printable(),
            defects: judged.measures.defects(),
            faces: judged.measures.faces,
            red_flags: judged.red_flags.clone(),
            chosen,
        }
    }
}

/// A sign that a repair destroyed something, after the MeshPrep repair strategy guide (lessons 3 and 4).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RedFlag {
    /// Which sign.
    pub code: RedFlagCode,
    /// What was measured.
    pub value: f64,
    /// The threshold that it is over.
    pub threshold: f64,
    /// In words.
    pub detail: String,
    /// Points that it concerns, in the model's unit; at most five.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub places: Vec<[f64; 3]>,
}

/// The kinds of red flag.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RedFlagCode {
    /// More faces were lost than `max_face_loss_pct`.
    FaceLoss,
    /// The box changed by more than `max_box_change_pct`.
    BoxChange,
    /// The volume changed by more than `max_volume_change_pct`.
    VolumeChange,
    /// More of the visible surface was lost than `max_surface_lost_pct`.
    SurfaceLost,
    /// Surface other than hole patches is farther from the input than `max_deviation`.
    Deviation,
    /// Several parts became one.
    PartsMerged,
    /// A part of the input is neither in the result nor certified as not missed: an error of the program.
    PartLost,
    /// More of the result's surface was invented than `max_surface_added_pct`: thickened skins and patches of large holes.
    SurfaceInvented,
    /// Objects of the file intersect where they stand.
    ObjectsIntersect,
    /// More vertices were lost than `max_vertex_loss_pct`.
    VertexLoss,
}
