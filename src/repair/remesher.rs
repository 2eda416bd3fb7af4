//! The trait through which tier 3 runs a program such as Blender, with its request, result and errors.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::context::Context;
use crate::mesh::Soup;

/// The work that tier 3 can do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum RemeshAction {
    /// Rebuild the surface on a voxel grid (MeshPrep's `blender_remesh`).
    VoxelRemesh,
    /// Unite overlapping parts by an exact boolean of the mesh with itself (MeshPrep's `blender_make_manifold`).
    BooleanUnion,
}

/// A program that tier 3 runs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct RemesherInfo {
    /// `blender` or `bpy`.
    pub kind: String,
    /// The program's version, such as `3.4.1`.
    pub version: String,
    /// The path or name of the program.
    pub program: String,
}

/// One request to tier 3.
#[derive(Debug, Clone, Copy)]
pub struct RemeshRequest<'a> {
    /// The mesh, finite and with indices in range.
    pub soup: &'a Soup,
    /// The work to do.
    pub action: RemeshAction,
    /// Edge length of the voxels in the mesh's unit; the boolean ignores it.
    pub voxel_size: f64,
    /// Largest voxel edge to fall back to if memory is short or the program crashed with `voxel_size`.
    pub coarsest: f64,
    /// Most faces to accept in the result.
    pub max_faces: u64,
    /// Time limit, in addition to the context's deadline.
    pub time_limit: Duration,
    /// Progress of the whole repair in percent, to report while the request waits.
    pub percent: u8,
}

/// The result of tier 3, not verified: the pipeline judges it like any other candidate.
#[derive(Debug, Clone)]
pub struct Remeshed {
    /// The new mesh, in the input's unit and position.
    pub soup: Soup,
    /// The voxel edge that was used, if it differs from the request.
    pub voxel_size: Option<f64>,
    /// How the work differed from the request, as text.
    pub note: Option<String>,
}

impl From<Soup> for Remeshed {
    fn from(soup: Soup) -> Self {
        Self { soup, voxel_size: None, note: None }
    }
}

/// Why tier 3 has no result.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RemeshError {
    /// The program could not be started.
    #[error("could not start {program}: {reason}")]
    Start {
        /// The program.
        program: String,
        /// The error of the operating system.
        reason: String,
    },
    /// The program exceeded its time limit.
    #[error("stopped at its time limit of {seconds:.1} s", seconds = .0.as_secs_f64())]
    TimedOut(Duration),
    /// All processes that the machine's memory allows were busy until the time limit.
    #[error(
        "all {at_once} Blender processes that this machine allows were busy for {seconds:.1} s, the time limit",
        seconds = .waited.as_secs_f64()
    )]
    NoneFree {
        /// Number of processes that may run at once.
        at_once: u32,
        /// Time spent waiting.
        waited: Duration,
    },
    /// The job was canceled.
    #[error("canceled")]
    Cancelled,
    /// The program ended with an error; the job's log has its output.
    #[error("{0}")]
    Failed(String),
    /// The result has more faces than allowed.
    #[error("the result has {faces} faces, more than the allowed {most}; choose a larger `voxel_size`")]
    TooManyFaces {
        /// Faces of the result.
        faces: u64,
        /// Faces allowed.
        most: u64,
    },
    /// The result has no face.
    #[error("the result is empty")]
    Empty,
}

/// A program that remeshes surface for tier 3. The pipeline calls it only through this trait and does not depend on Blender.
pub trait Remesher {
    /// The program and its version. The first call may take a few seconds because it searches for the program.
    ///
    /// # Errors
    /// The reason why tier 3 is not available, as text.
    fn info(&self) -> Result<&RemesherInfo, &str>;

    /// The number of times the program was started, for the report.
    fn runs(&self) -> u32 {
        0
    }

    /// Runs one action in a separate process. The program's output goes to the context's log.
    ///
    /// # Errors
    /// [`RemeshError`] if the program could not produce a result. By then the process and all its children have ended.
    fn remesh(&self, request: &RemeshRequest<'_>, context: &Context<'_>) -> Result<Remeshed, RemeshError>;
}
