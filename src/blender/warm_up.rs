use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use glam::DVec3;

use super::{BlenderConfig, BlenderRemesher};
use crate::mesh::Soup;
use crate::repair::{
    Context, NoProgress, RemeshAction, RemeshError, RemeshRequest, Remesher, RemesherInfo, monotonic_clock,
};

/// Most time for it: the first start from a cold disk.
const MOST_TIME: Duration = Duration::from_secs(120);
/// Time between looks whether it should stop.
const PAUSE: Duration = Duration::from_millis(50);

/// What came of a warm-up.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Warmth {
    /// It ran, and took so long.
    Warm(Duration),
    /// It was found, but it does not work.
    Failed(String),
    /// It was told to stop.
    Stopped,
}

/// Runs a program once on a tetrahedron: what it loads is then in memory, and whether it works is known. It takes a slot like
/// any run, and ends when `stop` says so.
#[must_use]
pub fn warm_up(info: RemesherInfo, config: BlenderConfig, stop: &(dyn Fn() -> bool + Sync)) -> Warmth {
    let remesher = BlenderRemesher::new(info, BlenderConfig { own_process_group: true, ..config });
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
    let (cancel, done) = (AtomicBool::new(false), AtomicBool::new(false));
    let clock = monotonic_clock();
    let made = std::thread::scope(|scope| {
        scope.spawn(|| {
            while !done.load(Ordering::Relaxed) {
                if stop() {
                    cancel.store(true, Ordering::Relaxed);
                }
                std::thread::sleep(PAUSE);
            }
        });
        let made = remesher.remesh(&request, &Context::new(&NoProgress, &cancel, &clock, MOST_TIME));
        done.store(true, Ordering::Relaxed);
        made
    });
    match made {
        Ok(_) => Warmth::Warm(clock()),
        Err(RemeshError::Cancelled) => Warmth::Stopped,
        Err(error) => Warmth::Failed(error.to_string()),
    }
}
