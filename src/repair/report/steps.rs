//! What was planned, what was done, and the results that were judged.

use serde::{Deserialize, Serialize};

use super::findings::{OptionNotApplied, RedFlag};
use crate::repair::change::Change;
use crate::repair::options::{Category, Operator, Preset};
use crate::repair::remesher::RemesherInfo;

/// One thing a plan does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
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
    FullRepair,
    /// Tier 2: mend each part apart (`pymeshfix_repair_conservative`).
    ConservativeRepair,
    /// Tier 2: separate non-manifold edges and vertices (`make_manifold`).
    MakeManifold,
    /// Tier 2: remove what is bad and close the holes, while that makes it better.
    CleanAndPatch,
    /// Tier 2: make solids of open sheets.
    CloseSheets,
    /// Tier 2: unite what overlaps, so that no faces intersect.
    SelfUnion,
    /// Tier 2: keep apart by position what was cut apart by index.
    Perturb,
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

/// What is to be done, as data: made from the inspection, run afterwards.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Plan {
    /// What kind of trouble the model is in.
    pub category: Category,
    /// The preset in force, never `auto`.
    pub preset: Preset,
    /// Why this preset.
    pub reason: String,
    /// The strategies in order; each starts from the input, and the next runs only if the one before was not good enough.
    pub strategies: Vec<Strategy>,
}

/// When a strategy runs, given that none before it was good.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum When {
    /// Always.
    #[default]
    NothingAcceptable,
    /// When a result before it was open or had lost surface that can be seen: sheets that enclose nothing.
    OpenSheetsRemain,
    /// When no result before it is closed.
    NothingClosed,
}

/// One try of a plan.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Strategy {
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
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct PlannedAction {
    /// The action.
    pub action: Action,
    /// Its operators in order; none for tier 3, for validation and in an abridged report.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub operators: Vec<Operator>,
}

/// How a step ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum StepStatus {
    /// It ran.
    Done,
    /// It ran and made nothing; the note says why.
    Failed,
    /// It ran, made something worse than it was, and was undone; the note says what.
    Reverted,
    /// It was not run; the note says why.
    Skipped,
}

/// One operator, remesh or validation that was run or passed over.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Step {
    /// Index of the strategy in the plan.
    pub strategy: u32,
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
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
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
    pub(crate) fn new(strategy: u32, tier: u8, action: Action, operator: Option<Operator>) -> Self {
        Self {
            strategy,
            tier,
            action,
            operator,
            status: StepStatus::Done,
            milliseconds: 0.0,
            changed: Vec::new(),
            moved: 0.0,
            note: None,
            options_not_applied: Vec::new(),
            unfixed: None,
            program: None,
            runs: 0,
            voxel_size: None,
        }
    }
}

/// A result that was judged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Candidate {
    /// Index of the strategy that made it; none for the input itself.
    #[cfg_attr(feature = "openapi", schema(required))]
    pub strategy: Option<u32>,
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

impl Plan {
    /// A plan without a strategy, and why there is none.
    pub(crate) fn nothing(reason: &str) -> Self {
        Self {
            category: Category::Clean,
            preset: Preset::BasicCleanup,
            reason: reason.to_owned(),
            strategies: Vec::new(),
        }
    }

    /// Leaves out the strategies after the last that ran, and the planned actions of each: the steps name those that did something.
    pub(super) fn abridge(&mut self, steps: &[Step]) {
        let ran =
            steps.iter().filter(|step| step.status != StepStatus::Skipped).map(|step| step.strategy as usize + 1).max();
        self.strategies.truncate(ran.unwrap_or(0));
        self.strategies.iter_mut().for_each(|strategy| strategy.actions.clear());
    }
}

/// Keeps steps that changed something or went wrong, and of them the first `8 * most`.
pub(super) fn abridge_steps(steps: &mut Vec<Step>, most: usize) {
    steps.retain(|step| match step.status {
        StepStatus::Done => !step.changed.is_empty() || step.program.is_some() || step.unfixed.is_some(),
        StepStatus::Failed | StepStatus::Reverted => true,
        // That there is no Blender is worth knowing.
        StepStatus::Skipped => step.tier == 3,
    });
    steps.truncate(8 * most);
    for faces in steps.iter_mut().filter_map(|step| step.unfixed.as_mut()) {
        faces.faces.truncate(most);
    }
}

/// Keeps the chosen candidate and the first `most`; the flags of the chosen one are those of the report.
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
