//! The repair plan, the steps that were run or skipped, and the results that were judged.

use serde::{Deserialize, Serialize};

use super::findings::{OptionNotApplied, RedFlag};
use super::print_steps::{DrilledVent, WallThickening};
use crate::repair::change::Change;
use crate::repair::options::{Category, Operator, Preset};
use crate::repair::remesher::RemesherInfo;

/// An action of a plan, which runs one operator or several.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Action {
    /// Tier 1: weld vertices; remove degenerate and duplicate faces and unreferenced vertices (MeshPrep's `trimesh_basic`).
    BasicCleanup,
    /// Tier 1: orient faces consistently and outward (MeshPrep's `fix_normals`).
    FixNormals,
    /// Tier 1: close simple holes (MeshPrep's `fill_holes`).
    FillHoles,
    /// Tier 2: join the two sides of cracks and T-junctions, before a patch could fill them like holes.
    Stitch,
    /// Tier 2: repair one part with several kinds of damage (MeshPrep's `pymeshfix_repair`).
    FullRepair,
    /// Tier 2: repair each part separately (MeshPrep's `pymeshfix_repair_conservative`).
    ConservativeRepair,
    /// Tier 2: split non-manifold edges and vertices (MeshPrep's `make_manifold`).
    MakeManifold,
    /// Tier 2: remove defective regions and close the holes, as long as that reduces defects.
    CleanAndPatch,
    /// Tier 2: turn open sheets into solids.
    CloseSheets,
    /// Tier 2: unite overlapping parts so that no faces intersect.
    SelfUnion,
    /// Tier 2: move apart vertices that were split but still share a position.
    Perturb,
    /// Tier 1: reduce faces as far as `max_faces` and `max_error` ask.
    Simplify,
    /// Tier 1: remove closed parts smaller than `min_part_volume_pct`.
    DropSmallParts,
    /// Tier 2: keep the outer skin of a generated model, seal small openings and fill the inside.
    FillInterior,
    /// Tier 2: remove or attach small separate solids as `islands` asks.
    TreatIslands,
    /// Tier 2: fill or vent sealed cavities as `voids` asks.
    TreatVoids,
    /// Tier 2: thicken walls that are thinner than `min_wall`.
    ThickenWalls,
    /// Tier 2: rebuild the surface around the enclosed space.
    NativeRemesh,
    /// Tier 3: voxel remesh with Blender (MeshPrep's `blender_remesh`).
    VoxelRemesh,
    /// Tier 3: boolean union of the mesh with itself in Blender (MeshPrep's `blender_make_manifold`).
    BooleanUnion,
    /// Write the result, read it back, weld it by position and judge it.
    Validate,
}

/// A repair plan: derived from the inspection and the options, and then run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Plan {
    /// The category of the model's damage.
    pub category: Category,
    /// The chosen preset; never `auto`.
    pub preset: Preset,
    /// The reason for the preset.
    pub reason: String,
    /// The strategies in order. Each starts from the input and runs only if the results before it were not good enough.
    pub strategies: Vec<Strategy>,
}

/// The condition for a strategy to run, given that no result before it was good enough.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum When {
    /// Run if no earlier strategy gave a good enough result.
    #[default]
    NothingAcceptable,
    /// Run if an earlier result was open or had lost visible surface, which points to open sheets.
    OpenSheetsRemain,
    /// Run if no earlier result is closed.
    NothingClosed,
}

/// One strategy of a plan: a sequence of actions from the input to a result.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Strategy {
    /// The condition for the strategy to run.
    #[serde(default)]
    pub when: When,
    /// The highest tier that the strategy uses.
    pub tier: u8,
    /// The preset that the strategy comes from.
    pub preset: Preset,
    /// The actions in order.
    pub actions: Vec<PlannedAction>,
}

/// An action with the operators that the options leave it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct PlannedAction {
    /// The action.
    pub action: Action,
    /// The operators in order. Empty for tier 3, for validation and in an abridged report.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub operators: Vec<Operator>,
}

/// The status of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum StepStatus {
    /// The step ran.
    Done,
    /// The step ran without a result; the note gives the reason.
    Failed,
    /// The step ran, made a defect worse, and was undone; the note names the defect.
    Reverted,
    /// The step was not run; the note gives the reason.
    Skipped,
}

/// Why a step was skipped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum SkipReason {
    /// The deadline left no time for it.
    OutOfTime,
    /// A program that it needs is missing.
    Unavailable,
    /// It could not have led to a better result.
    Needless,
}

/// One operator, remesh or validation that was run or skipped.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Step {
    /// Index of the strategy in the plan.
    pub strategy: u32,
    /// The tier, 1 to 3; 0 for validation.
    pub tier: u8,
    /// The action that the step belongs to.
    pub action: Action,
    /// The operator. Missing for tier 3 and for validation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub operator: Option<Operator>,
    /// The status of the step.
    pub status: StepStatus,
    /// For a skipped step: the kind of reason; the note gives the reason as text.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub skip_reason: Option<SkipReason>,
    /// The duration in milliseconds; 0 if the result was reused from an earlier strategy.
    pub milliseconds: f64,
    /// The changes that the step made.
    pub changed: Vec<Change>,
    /// The farthest distance that the step moved a vertex, in the model's unit.
    #[serde(default)]
    pub moved: f64,
    /// Why the step failed or was skipped, or what it could not fix, as text.
    pub note: Option<String>,
    /// Options that the step could follow only in part.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub options_not_applied: Vec<OptionNotApplied>,
    /// Faces that the step could not fix.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unfixed: Option<UnfixedFaces>,
    /// For tier 3: the program that ran.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub program: Option<RemesherInfo>,
    /// For tier 3: the number of starts of the program; more than one after a crash.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub runs: u32,
    /// For a remesh: the edge length of the voxels, in the model's unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub voxel_size: Option<f64>,
    /// For `thicken_walls`: what was added, and the places that stay thin.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub thickening: Option<WallThickening>,
    /// For `vent_voids`: the holes that were drilled, those of the largest cavity first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub vents: Vec<DrilledVent>,
}

/// Faces that an operator could not fix, such as faces whose outer side it could not determine.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct UnfixedFaces {
    /// Number of faces of the input file.
    pub count: u64,
    /// Indices of these faces in the input file, from 0 and ascending; at most 1000. Faces created by the repair are not listed.
    pub faces: Vec<u32>,
}

fn is_zero(count: &u32) -> bool {
    *count == 0
}

impl Step {
    /// Makes a step that has not changed anything yet.
    pub(crate) fn new(strategy: u32, tier: u8, action: Action, operator: Option<Operator>) -> Self {
        Self {
            strategy,
            tier,
            action,
            operator,
            status: StepStatus::Done,
            skip_reason: None,
            milliseconds: 0.0,
            changed: Vec::new(),
            moved: 0.0,
            note: None,
            options_not_applied: Vec::new(),
            unfixed: None,
            program: None,
            runs: 0,
            voxel_size: None,
            thickening: None,
            vents: Vec::new(),
        }
    }

    /// The same step, but skipped for `reason`, which `note` gives as text.
    pub(crate) fn skipped(self, reason: SkipReason, note: String) -> Self {
        Self { status: StepStatus::Skipped, skip_reason: Some(reason), note: Some(note), ..self }
    }
}

/// A repair result that was judged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Candidate {
    /// Index of the strategy that made the result; null for the input itself.
    #[cfg_attr(feature = "openapi", schema(required))]
    pub strategy: Option<u32>,
    /// Whether the result passed every check.
    pub printable: bool,
    /// Number of remaining defects.
    pub defects: u64,
    /// Number of faces.
    pub faces: u64,
    /// The red flags of the result.
    pub red_flags: Vec<RedFlag>,
    /// Whether this result is the returned one.
    pub chosen: bool,
}

impl Plan {
    /// Makes a plan without strategies, with the reason for that.
    pub(crate) fn without_strategies(reason: &str) -> Self {
        Self {
            category: Category::Clean,
            preset: Preset::BasicCleanup,
            reason: reason.to_owned(),
            strategies: Vec::new(),
        }
    }

    /// Removes the strategies after the last that ran, and all planned actions: the steps name the actions that had an effect.
    pub(super) fn abridge(&mut self, steps: &[Step]) {
        let ran =
            steps.iter().filter(|step| step.status != StepStatus::Skipped).map(|step| step.strategy as usize + 1).max();
        self.strategies.truncate(ran.unwrap_or(0));
        self.strategies.iter_mut().for_each(|strategy| strategy.actions.clear());
    }
}

/// Keeps the first `8 * most` steps that changed something or went wrong.
pub(super) fn abridge_steps(steps: &mut Vec<Step>, most: usize) {
    steps.retain(|step| match step.status {
        StepStatus::Done => !step.changed.is_empty() || step.program.is_some() || step.unfixed.is_some(),
        StepStatus::Failed | StepStatus::Reverted => true,
        // Users should learn that Blender is missing or had no time.
        StepStatus::Skipped => step.tier == 3 && step.skip_reason != Some(SkipReason::Needless),
    });
    steps.truncate(8 * most);
    for faces in steps.iter_mut().filter_map(|step| step.unfixed.as_mut()) {
        faces.faces.truncate(most);
    }
    for thickening in steps.iter_mut().filter_map(|step| step.thickening.as_mut()) {
        thickening.left.truncate(most);
    }
    steps.iter_mut().for_each(|step| step.vents.truncate(most));
}

/// Keeps the chosen candidate and the first `most` others. The chosen candidate's red flags are already in the report.
pub(super) fn abridge_candidates(candidates: &mut Vec<Candidate>, most: usize) {
    let mut kept = 0;
    candidates.retain(|candidate| {
        kept += usize::from(!candidate.chosen);
        candidate.chosen || kept <= most
    });
    for candidate in candidates {
        candidate.red_flags.iter_mut().for_each(|flag| flag.places.clear());
        if candidate.chosen {
            candidate.red_flags.clear();
        }
    }
}
