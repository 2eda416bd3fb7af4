//! The whole repair without Blender of a torus with holes, turned patches and doubled faces, by size, so that growth can
//! be seen: seconds over n log2 n should stay where they are. Then 100,000 faces with 1,000 holes on one thread.
//!
//! `cargo bench --bench mend -- [FACES]...`, such as 4000000; without sizes 10,000 to 1,000,000.

#![allow(clippy::print_stdout, reason = "a benchmark prints its figures")]

use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use meshmend::context::{Context, NoProgress, monotonic_clock};
use meshmend::format::{Format, Limits, write};
use meshmend::mesh::Soup;
use meshmend::repair::{Options, Report, repair};

#[path = "../tests/support/meshes.rs"]
#[allow(dead_code, reason = "shared with the tests, of which each uses a part")]
mod meshes;

/// Slowest steps that are printed.
const STEPS: usize = 4;

fn main() {
    let asked: Vec<u32> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    let sizes = if asked.is_empty() { vec![10_000, 100_000, 1_000_000] } else { asked };
    for faces in sizes {
        let mut soup = torus(faces);
        damage(&mut soup);
        run("damaged", &soup);
    }
    let mut soup = torus(100_000);
    let every = soup.faces.len() / 1000;
    soup.faces = soup.faces.chunks(every).flat_map(|chunk| &chunk[1..]).copied().collect();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("one thread");
    pool.install(|| run("1,000 holes, one thread", &soup));
}

/// A torus of about so many faces.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a made mesh is small")]
fn torus(faces: u32) -> Soup {
    let across = f64::from(faces / 8).sqrt() as u32;
    meshes::torus(3.0, 1.0, 4 * across, across)
}

/// Of each thousand faces one goes, ten are turned, and one is doubled.
fn damage(soup: &mut Soup) {
    for chunk in soup.faces.chunks_mut(1000) {
        chunk.iter_mut().take(10).for_each(|face| face.swap(1, 2));
    }
    let doubled: Vec<[u32; 3]> = soup.faces.iter().skip(200).step_by(1000).copied().collect();
    soup.faces =
        soup.faces.chunks(1000).flat_map(|chunk| chunk.split_last().map_or(chunk, |(_, rest)| rest)).copied().collect();
    soup.faces.extend(doubled);
}

fn run(what: &str, soup: &Soup) {
    let bytes = write(soup, Format::Stl).expect("a mesh that STL can hold");
    let (cancel, clock) = (AtomicBool::new(false), monotonic_clock());
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(3600));
    let options = Options { max_tier: 2, pictures: false, ..Options::default() };
    let start = Instant::now();
    let report = repair(&bytes, &options, &Limits::default(), None, &context).expect("a repair").report;
    let seconds = start.elapsed().as_secs_f64();
    let n = soup.faces.len() as f64;
    println!(
        "{:>8} faces, {what}: {seconds:7.3} s, {:6.2} ns / (n log2 n), {:?}",
        soup.faces.len(),
        seconds * 1e9 / (n * n.log2()),
        report.outcome
    );
    print_steps(&report, seconds);
}

fn print_steps(report: &Report, seconds: f64) {
    let mut steps: Vec<_> = report.steps.iter().collect();
    steps.sort_by(|a, b| b.milliseconds.total_cmp(&a.milliseconds));
    for step in steps.iter().take(STEPS) {
        let name = step.operator.map_or_else(|| format!("{:?}", step.action), |o| o.as_str().to_owned());
        println!("           {:8.1} ms  strategy {} {name}", step.milliseconds, step.strategy);
    }
    let inside: f64 = report.steps.iter().map(|s| s.milliseconds).sum();
    println!("           {:8.1} ms  before, after and between the steps", seconds * 1e3 - inside);
}
