//! How long a 3MF file of a million triangles takes to read, beside lib3mf and trimesh in the same run.
//!
//! `MESHMEND_PEER_PYTHON` names a Python with what `benches/peers/requirements.txt` lists; without it only ours is measured.
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a bench tells what it measured and stops where it can't")]

use std::process::Command;
use std::time::Instant;

use glam::DVec3;
use meshmend::format::{Format, ReadOptions, read_file, write};
use meshmend::mesh::Soup;

const RUNS: usize = 5;

/// A torus with a million faces, whose coordinates have the six decimals that most programs write.
fn torus() -> Soup {
    let (n, m) = (1000_u32, 500_u32);
    let point = |i: u32, j: u32| {
        let (a, b) =
            (f64::from(i) / f64::from(n) * std::f64::consts::TAU, f64::from(j) / f64::from(m) * std::f64::consts::TAU);
        let r = 40.0 + 12.0 * b.cos();
        (DVec3::new(r * a.cos(), r * a.sin(), 12.0 * b.sin()) * 1e6).round() / 1e6
    };
    let at = |i: u32, j: u32| (i % n) * m + j % m;
    let positions = (0..n).flat_map(|i| (0..m).map(move |j| point(i, j))).collect();
    let cells = (0..n).flat_map(|i| (0..m).map(move |j| [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]));
    let faces = cells.flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    Soup { positions, faces }
}

fn main() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("torus.3mf");
    let begin = Instant::now();
    std::fs::write(&path, write(&torus(), Format::ThreeMf).unwrap()).unwrap();
    println!("write: {:.3} s, {} bytes", begin.elapsed().as_secs_f64(), std::fs::metadata(&path).unwrap().len());
    let ours = (0..RUNS)
        .map(|_| {
            let begin = Instant::now();
            let bytes = std::fs::read(&path).unwrap();
            let read = read_file(&bytes, &ReadOptions::default()).unwrap();
            assert_eq!(read.mesh.soup.faces.len(), 1_000_000);
            begin.elapsed().as_secs_f64()
        })
        .fold(f64::INFINITY, f64::min);
    println!("meshmend: {ours:.3} s");
    let Ok(python) = std::env::var("MESHMEND_PEER_PYTHON") else { return };
    let peers = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/peers/read_3mf.py");
    for peer in ["lib3mf", "trimesh"] {
        let told = Command::new(&python).arg(peers).arg(peer).arg(&path).arg(RUNS.to_string()).output().unwrap();
        assert!(told.status.success(), "{}", String::from_utf8_lossy(&told.stderr));
        let seconds: f64 = String::from_utf8_lossy(&told.stdout).trim().parse().unwrap();
        println!("{peer}: {seconds:.3} s, {:.2} times ours", seconds / ours);
    }
}
