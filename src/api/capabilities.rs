use axum::Json;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

use super::state::ApiState;
use crate::analyze::AnalyzeOptions;
use crate::format::{Format, Limits};
use crate::inspect::Level;
use crate::jobs::Mode;
use crate::repair::{Options, Preset, RemesherInfo};
use crate::sandbox::SandboxStatus;

/// What this service can do right now.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct Capabilities {
    /// Name and version of the engine.
    pub engine: String,
    /// Formats that can be sent.
    pub input_formats: Vec<Format>,
    /// Formats that can be asked for.
    pub output_formats: Vec<Format>,
    /// What a job can do.
    pub modes: Vec<Mode>,
    /// Presets of a repair.
    pub presets: Vec<Preset>,
    /// Levels of an analysis.
    pub levels: Vec<Level>,
    /// The tiers and whether they work.
    pub tiers: Vec<TierStatus>,
    /// Limits on an upload.
    pub limits: UploadLimits,
    /// What holds each job's processes; absent where jobs run in other processes than this one (`meshmend work`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sandbox: Option<SandboxStatus>,
    /// Every option of a repair with its default.
    pub default_options: Options,
    /// Every option of an analysis with its default.
    pub default_analyze_options: AnalyzeOptions,
}

/// One tier.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct TierStatus {
    /// Its number, 1 to 3.
    pub tier: u8,
    /// What it is.
    pub name: &'static str,
    /// Whether it works.
    pub available: bool,
    /// Why it does not, or what a person should know.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub detail: Option<String>,
    /// The program behind it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub program: Option<RemesherInfo>,
}

/// Limits on an upload.
#[derive(Debug, Clone, Copy, Serialize, ToSchema)]
pub struct UploadLimits {
    /// Largest upload in bytes: one file, or all files of a job together.
    pub max_bytes: u64,
    /// Most files of an analysis.
    pub max_files: usize,
    /// Most triangles of a file.
    pub max_file_faces: u64,
    /// Most vertices of a file.
    pub max_file_vertices: u64,
}

impl Capabilities {
    /// `remesher` is tier 3, or why there is none.
    #[must_use]
    pub fn new(
        limits: Limits,
        max_files: usize,
        remesher: Result<RemesherInfo, String>,
        sandbox: Option<SandboxStatus>,
    ) -> Self {
        let formats = Format::ALL.to_vec();
        let (program, missing) = match remesher {
            Ok(info) => (Some(info), None),
            Err(reason) => (None, Some(reason)),
        };
        let tier = |tier, name, available| TierStatus { tier, name, available, detail: None, program: None };
        Self {
            engine: crate::ENGINE.to_owned(),
            input_formats: formats.clone(),
            output_formats: formats,
            modes: Mode::ALL.to_vec(),
            presets: vec![
                Preset::Auto,
                Preset::BasicCleanup,
                Preset::FillHoles,
                Preset::FullRepair,
                Preset::ConservativeRepair,
                Preset::ManifoldRepair,
                Preset::BlenderRemesh,
            ],
            levels: vec![Level::None, Level::Basic, Level::Full],
            tiers: vec![
                tier(1, "clean", true),
                tier(2, "mend", true),
                TierStatus { detail: missing, available: program.is_some(), program, ..tier(3, "Blender", false) },
            ],
            limits: UploadLimits {
                max_bytes: limits.max_bytes,
                max_files,
                max_file_faces: limits.max_faces,
                max_file_vertices: limits.max_vertices,
            },
            sandbox,
            default_options: Options::default(),
            default_analyze_options: AnalyzeOptions::default(),
        }
    }
}

/// What this service can do.
///
/// Formats, modes, presets, levels, limits, every option with its default, the tiers that work right now with Blender's version, and
/// the sandbox that jobs run in.
#[utoipa::path(
    get, path = "/v1/capabilities", tag = "service",
    responses((status = 200, description = "What can be asked for", body = Capabilities))
)]
pub(super) async fn get_capabilities(State(state): State<ApiState>) -> Json<Capabilities> {
    Json(state.capabilities.as_ref().clone())
}
