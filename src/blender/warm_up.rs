use std::sync::atomic::AtomicBool;
use std::time::Duration;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::{BlenderConfig, BlenderRemesher};
use crate::mesh::Soup;
use crate::repair::{Context, NoProgress, RemeshAction, RemeshRequest, Remesher, RemesherInfo, monotonic_clock};

/// Most time for it: the first start from a cold disk.
const MOST_TIME: Duration = Duration::from_secs(120);

/// What came of a warm-up.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Warmth {
    /// It ran, and took so long.
    Warm(Duration),
    /// It was found, but it does not work.
    Failed(String),
}

/// Runs a program once on a tetrahedron: what it loads is then in memory, and whether it works is known. It takes a slot like
/// any run.
#[must_use]
pub fn warm_up(info: RemesherInfo, config: BlenderConfig) -> Warmth {
    let remesher = BlenderRemesher::new(info, config);
    let positions = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
    let soup = Soup { positions, faces: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]] };
    let request = RemeshRequest {
        soup: &soup,
        action: RemeshAction::VoxelRemesh,
        voxel_size: 0.1,
        coarsest: 0.1,
        max_faces: 100_000,
        time_limit: MOST_TIME,
        percent: 0,
    };
    let (never, clock) = (AtomicBool::new(false), monotonic_clock());
    let made = remesher.remesh(&request, &Context::new(&NoProgress, &never, &clock, MOST_TIME));
    match made {
        Ok(_) => Warmth::Warm(clock()),
        Err(error) => Warmth::Failed(error.to_string()),
    }
}
