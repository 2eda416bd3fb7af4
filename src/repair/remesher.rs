use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::context::Context;
use crate::mesh::Soup;

/// What tier 3 can do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum RemeshAction {
    /// Rebuild the surface on a voxel grid (the guide's `blender_remesh`).
    VoxelRemesh,
    /// Unite what overlaps by an exact boolean of the mesh with itself (the guide's `blender_make_manifold`).
    BooleanUnion,
}

/// A program that tier 3 runs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct RemesherInfo {
    /// `blender` or `bpy`.
    pub kind: String,
    /// Its version, such as `3.4.1`.
    pub version: String,
    /// The program that is started.
    pub program: String,
}

/// One piece of work for tier 3.
#[derive(Debug, Clone, Copy)]
pub struct RemeshRequest<'a> {
    /// The mesh, finite and with indices in range.
    pub soup: &'a Soup,
    /// What to do.
    pub action: RemeshAction,
    /// Voxel edge in the mesh's unit; not used by the boolean.
    pub voxel_size: f64,
    /// Largest voxel edge that may be used instead, where the memory does not allow that one or the program crashed with it.
    pub coarsest: f64,
    /// Most faces to accept back.
    pub max_faces: u64,
    /// Most time to take, besides the context's deadline.
    pub time_limit: Duration,
    /// How far the whole repair is, in percent, for the progress while it waits.
    pub percent: u8,
}

/// What tier 3 made. Not verified: the pipeline judges it like any other candidate.
#[derive(Debug, Clone)]
pub struct Remeshed {
    /// The new mesh, in the input's unit and place.
    pub soup: Soup,
    /// The voxel edge that it was made with, where that is not the one that was asked for.
    pub voxel_size: Option<f64>,
    /// What went otherwise than asked, in words.
    pub note: Option<String>,
}

impl From<Soup> for Remeshed {
    fn from(soup: Soup) -> Self {
        Self { soup, voxel_size: None, note: None }
    }
}

/// Why tier 3 made nothing.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RemeshError {
    /// The program could not be started.
    #[error("could not start {program}: {reason}")]
    Start {
        /// The program.
        program: String,
        /// The operating system's word.
        reason: String,
    },
    /// It ran longer than it may.
    #[error("stopped after {seconds:.1} s, the time it had", seconds = .0.as_secs_f64())]
    TimedOut(Duration),
    /// As many ran on the machine as memory allows, until the time was over.
    #[error("none of the {at_once} that may run at once on this machine was free within {seconds:.1} s, the time it had", seconds = .waited.as_secs_f64())]
    NoneFree {
        /// How many may run at once.
        at_once: u32,
        /// How long it waited.
        waited: Duration,
    },
    /// The job was canceled.
    #[error("canceled")]
    Cancelled,
    /// It ended with an error; the job's log has its output.
    #[error("{0}")]
    Failed(String),
    /// The result has more faces than were asked for.
    #[error("the result has {faces} faces, more than the {most} allowed; choose a larger voxel_size")]
    TooManyFaces {
        /// Faces made.
        faces: u64,
        /// Faces allowed.
        most: u64,
    },
    /// There was no face in the result.
    #[error("the result is empty")]
    Empty,
}

/// The last tier's way to a solid. The pipeline calls it through this trait and knows nothing of Blender.
pub trait Remesher {
    /// The program behind it, or why there is none. The first call may take a few seconds, since it may look for it.
    ///
    /// # Errors
    /// Why tier 3 is missing, in words.
    fn info(&self) -> Result<&RemesherInfo, &str>;

    /// How often it has started its program, for the report.
    fn runs(&self) -> u32 {
        0
    }

    /// Runs one action in a process of its own. What the program prints goes to the context's log.
    ///
    /// # Errors
    /// [`RemeshError`], after the process and all its children have ended.
    fn remesh(&self, request: &RemeshRequest<'_>, context: &Context<'_>) -> Result<Remeshed, RemeshError>;
}
