//! Tier 3: runs Blender as a separate process, with its own script, scratch folder and deadline.
//!
//! [`BlenderRemesher::find`] looks for a program, either Blender or a Python with `bpy`. [`BlenderRemesher`] implements
//! [`Remesher`]. One run has these steps:
//!
//! ```text
//! soup -> frame (centred, scaled) -> estimate -> exchange file -> slot -> process + script.py -> exchange file -> frame -> soup
//! ```
//!
//! Whatever the program does, a run ends by its deadline and leaves no process behind. The program sees no environment and no user
//! profile except its scratch folder. Its result is read as untrusted input.
//!
//! Memory limits how many programs run at once on the machine. Each holds a slot, a locked file, and waits if none is free; the wait
//! counts towards the job's time. After a crash in a voxel remesh, the program runs once more with larger voxels. A crashed boolean is not
//! repeated, since the plan continues with a remesh; nor is a run that timed out. The last stage that a stopped run finished is its
//! result.

mod exchange;
mod find;
mod frame;
mod memory;
mod process;
mod run;

use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::Duration;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::mesh::Soup;
use crate::repair::{
    Context, NoProgress, RemeshAction, RemeshError, RemeshRequest, Remeshed, Remesher, RemesherInfo, monotonic_clock,
};
pub use find::{BlenderConfig, BlenderMissing, Rejected, installation};
use run::{Program, Work};

/// A [`Remesher`] that runs Blender as a separate process.
#[derive(Debug)]
pub struct BlenderRemesher(Program);

impl BlenderRemesher {
    /// Finds a program and asks for its version, which can take seconds. Call it once per process, and pass the result to
    /// [`BlenderRemesher::new`] elsewhere.
    ///
    /// # Errors
    /// [`BlenderMissing`], with each program that was tried.
    pub fn find(config: BlenderConfig) -> Result<Self, BlenderMissing> {
        Ok(Self::new(find::find(&config)?, config))
    }

    /// A remesher with a program that was found before; it is not checked again.
    #[must_use]
    pub fn new(info: RemesherInfo, config: BlenderConfig) -> Self {
        Self(Program { info, config, runs: AtomicU32::new(0) })
    }
}

impl Remesher for BlenderRemesher {
    fn info(&self) -> Result<&RemesherInfo, &str> {
        Ok(&self.0.info)
    }

    fn runs(&self) -> u32 {
        self.0.runs.load(Ordering::Relaxed)
    }

    fn remesh(&self, request: &RemeshRequest<'_>, context: &Context<'_>) -> Result<Remeshed, RemeshError> {
        Work::new(&self.0, request, context)?.remesh()
    }
}

/// A [`BlenderRemesher`] that looks for Blender at its first use. Asking a program for its version takes longer than most repairs,
/// and most repairs do not need Blender.
#[derive(Debug)]
pub struct OnDemandBlender {
    config: BlenderConfig,
    found: OnceLock<Result<BlenderRemesher, String>>,
}

impl OnDemandBlender {
    /// A remesher that has not looked for Blender yet.
    #[must_use]
    pub fn new(config: BlenderConfig) -> Self {
        Self { config, found: OnceLock::new() }
    }

    fn found(&self) -> Result<&BlenderRemesher, &str> {
        let found = self.found.get_or_init(|| BlenderRemesher::find(self.config.clone()).map_err(|e| e.to_string()));
        found.as_ref().map_err(String::as_str)
    }
}

impl Remesher for OnDemandBlender {
    fn info(&self) -> Result<&RemesherInfo, &str> {
        self.found()?.info()
    }

    fn runs(&self) -> u32 {
        self.found.get().and_then(|found| found.as_ref().ok()).map_or(0, Remesher::runs)
    }

    fn remesh(&self, request: &RemeshRequest<'_>, context: &Context<'_>) -> Result<Remeshed, RemeshError> {
        match self.found() {
            Ok(blender) => blender.remesh(request, context),
            Err(reason) => Err(RemeshError::Start { program: "Blender".to_owned(), reason: reason.to_owned() }),
        }
    }
}

/// The time limit of a warm-up: a first start from a cold disk.
const WARM_UP_TIME: Duration = Duration::from_secs(120);

/// The result of a warm-up.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum WarmUpResult {
    /// Blender ran, and took this long.
    Warm(Duration),
    /// Blender was found, but the run failed; the text is the reason.
    Failed(String),
}

/// Runs a program once on a tetrahedron, which loads it into memory and shows whether it works. Takes a slot like any run.
#[must_use]
pub fn warm_up(info: RemesherInfo, config: BlenderConfig) -> WarmUpResult {
    let remesher = BlenderRemesher::new(info, config);
    let positions = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
    let soup = Soup { positions, faces: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]] };
    let request = RemeshRequest {
        soup: &soup,
        action: RemeshAction::VoxelRemesh,
        voxel_size: 0.1,
        coarsest: 0.1,
        max_faces: 100_000,
        time_limit: WARM_UP_TIME,
        percent: 0,
    };
    let (never, clock) = (AtomicBool::new(false), monotonic_clock());
    let result = remesher.remesh(&request, &Context::new(&NoProgress, &never, &clock, WARM_UP_TIME));
    match result {
        Ok(_) => WarmUpResult::Warm(clock()),
        Err(error) => WarmUpResult::Failed(error.to_string()),
    }
}
