//! Edges of a bumpy torus collapsed to a tenth of its faces, and those of a cube to twelve, by size: seconds over n log2 n
//! should stay where they are. All of it runs on one thread.
//!
//! `cargo bench --bench simplify -- [FACES]...`; without sizes 10,000 to 1,000,000.

#![allow(clippy::print_stdout, reason = "a benchmark prints its figures")]

use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use glam::DVec3;
use meshmend::context::{Context, NoProgress, monotonic_clock};
use meshmend::math::Precision;
use meshmend::mesh::{Soup, Surface};
use meshmend::simplify::Simplify;

#[path = "../tests/support/meshes.rs"]
#[allow(dead_code, reason = "shared with the tests, of which each uses a part")]
mod meshes;

fn main() {
    let asked: Vec<u32> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    let sizes = if asked.is_empty() { vec![10_000, 100_000, 1_000_000] } else { asked };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("one thread");
    for faces in sizes {
        let (torus, cube) = (bumpy_torus(faces), meshes::as_f32(cube(faces)));
        let tenth = Some(torus.faces.len() as u64 / 10);
        pool.install(|| run("torus", &torus, tenth, f64::INFINITY));
        pool.install(|| run("cube", &cube, None, 1e-6));
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a made mesh is small")]
fn bumpy_torus(faces: u32) -> Soup {
    let across = f64::from(faces / 8).sqrt() as u32;
    let mut soup = meshes::torus(3.0, 1.0, 4 * across, across);
    for p in &mut soup.positions {
        *p *= 1.0 + 0.01 * (p.x * 9.0).sin() * (p.y * 7.0).sin() * (p.z * 8.0).cos();
    }
    meshes::as_f32(soup)
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a made mesh is small")]
fn cube(faces: u32) -> Soup {
    meshes::cube(DVec3::ZERO, 1.0, f64::from(faces / 12).sqrt() as u32)
}

fn run(what: &str, soup: &Soup, max_faces: Option<u64>, max_error: f64) {
    let (mut surface, _) = Surface::from_soup(soup);
    let (cancel, clock) = (AtomicBool::new(false), monotonic_clock());
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(3600));
    let simplify =
        Simplify { max_faces, max_error, everywhere: true, feature_angle_deg: 50.0, precision: Precision::F32 };
    let start = Instant::now();
    let done = simplify.apply(&mut surface, &context).expect("nobody cancels");
    let seconds = start.elapsed().as_secs_f64();
    let n = soup.faces.len() as f64;
    println!(
        "{:>8} faces of a {what} to {:>6}: {seconds:7.3} s, {:6.2} ns / (n log2 n), error {:.2e}, bound {:.2e}",
        done.faces_before,
        done.faces_after,
        seconds * 1e9 / (n * n.log2()),
        done.error,
        done.bound
    );
}
