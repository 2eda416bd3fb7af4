//! Tier 3 with a real Blender, and with fake programs that hang, crash or write broken results.
//!
//! The real Blender is the one that `MESHMEND_BLENDER` names, or else one that is found; `make test` installs one.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, missing_docs)]

mod fake;
mod models;
mod real;

use std::sync::Mutex;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use meshmend::blender::BlenderRemesher;
use meshmend::mesh::Soup;
use meshmend::repair::{Context, Progress, RemeshAction, RemeshError, RemeshRequest, Remesher, Stage, monotonic_clock};

/// Keeps the log.
#[derive(Default)]
struct Log(Mutex<Vec<String>>);

impl Progress for Log {
    fn report(&self, _stage: Stage, _tier: Option<u8>, _percent: u8) {}
    fn log(&self, line: &str) {
        self.0.lock().unwrap().push(line.to_owned());
    }
}

impl Log {
    fn text(&self) -> String {
        self.0.lock().unwrap().join("\n")
    }
}

/// Runs one action with two minutes of time and no cancellation; the log comes with the result.
fn remesh(
    remesher: &BlenderRemesher,
    soup: &Soup,
    action: RemeshAction,
    voxel_size: f64,
    max_faces: u64,
) -> (Result<Soup, RemeshError>, String) {
    let time_limit = Duration::from_secs(120);
    let request = RemeshRequest { soup, action, voxel_size, coarsest: voxel_size, max_faces, time_limit, percent: 50 };
    let log = Log::default();
    let cancel = AtomicBool::new(false);
    let clock = monotonic_clock();
    let context = Context::new(&log, &cancel, &clock, Duration::from_secs(600));
    let result = remesher.remesh(&request, &context).map(|remeshed| remeshed.soup);
    (result, log.text())
}
