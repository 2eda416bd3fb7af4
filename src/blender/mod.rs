//! Tier 3: Blender as a process of its own, with its script, its scratch folder and its deadline.
//!
//! [`BlenderRemesher::find`] looks for a program, either Blender or a Python with `bpy`; [`BlenderRemesher`] then
//! implements [`Remesher`]. One run is one straight line:
//!
//! ```text
//! soup -> frame (centred, scaled) -> estimate -> exchange file -> slot -> process + script.py -> exchange file -> frame -> soup
//! ```
//!
//! What is promised of a run, whatever the program does: it ends by its deadline, nothing of it lives on, it sees no
//! environment and no user profile but its scratch folder, and its result is read as hostile input.
//!
//! Never more run at once on the machine than memory allows: each holds a slot, a locked file, and waits for one
//! where none is free. The time that it waits is its job's. A program that crashes in a voxel remesh is started again
//! once with larger voxels; a boolean is not, since the plan goes on to the remesh; nothing is started again that ran out of
//! time. What a run had finished when it was stopped is its result.

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

/// [`Remesher`] by a Blender that runs as a process of its own.
#[derive(Debug)]
pub struct BlenderRemesher(Program);

impl BlenderRemesher {
    /// Finds a program and asks it for its version, which takes up to some seconds: once a process is enough, and
    /// [`BlenderRemesher::new`] takes over what was found elsewhere.
    ///
    /// # Errors
    /// [`BlenderMissing`], with each program that was tried.
    pub fn find(config: BlenderConfig) -> Result<Self, BlenderMissing> {
        Ok(Self::new(find::find(&config)?, config))
    }

    /// A remesher by a program that was found before; it is not asked again.
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

/// [`BlenderRemesher`] that looks for Blender when it is first needed: asking a program for its version takes longer
/// than most repairs, and most repairs don't need it.
#[derive(Debug)]
pub struct OnDemandBlender {
    config: BlenderConfig,
    found: OnceLock<Result<BlenderRemesher, String>>,
}

impl OnDemandBlender {
    /// Looks for nothing yet.
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

/// Most time for a warm-up: the first start from a cold disk.
const WARM_UP_TIME: Duration = Duration::from_secs(120);

/// What came of a warm-up.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum WarmUpResult {
    /// It ran, and took so long.
    Warm(Duration),
    /// It was found, but it does not work.
    Failed(String),
}

/// Runs a program once on a tetrahedron: what it loads is then in memory, and whether it works is known. It takes a slot like
/// any run.
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
    let made = remesher.remesh(&request, &Context::new(&NoProgress, &never, &clock, WARM_UP_TIME));
    match made {
        Ok(_) => WarmUpResult::Warm(clock()),
        Err(error) => WarmUpResult::Failed(error.to_string()),
    }
}
