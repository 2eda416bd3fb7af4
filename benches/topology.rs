//! Topology and attributes of a binary STL file from its bytes on, stage by stage; the throughput is in faces.
//!
//! `cargo bench --bench topology`, with `RAYON_NUM_THREADS=1` for one thread.

use std::f64::consts::TAU;
use std::hint::black_box;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use glam::DVec3;
use meshmend::context::{Context, NoProgress, monotonic_clock};
use meshmend::format::{Format, Limits, read, write};
use meshmend::inspect::{Analysis, measures};
use meshmend::mesh::{ClosedSurface, Edges, Fans, Parts, Soup, Surface};

/// A rippled torus of `2 * around * across` faces.
#[expect(clippy::cast_possible_truncation, reason = "a made mesh is small")]
fn torus(around: usize, across: usize) -> Soup {
    let angle = |step: usize, steps: usize| TAU * step as f64 / steps as f64;
    let position = |i: usize, j: usize| {
        let (u, v) = (angle(i, around), angle(j, across));
        let tube = 10.0 + 0.5 * (7.0 * u + 3.0 * v).sin();
        let ring = 30.0 + tube * v.cos();
        DVec3::new(ring * u.cos(), ring * u.sin(), tube * v.sin())
    };
    let index = |i: usize, j: usize| ((i % around) * across + j % across) as u32;
    let quads = || (0..around).flat_map(|i| (0..across).map(move |j| (i, j)));
    let faces = |(i, j)| {
        let [a, b, c, d] = [index(i, j), index(i + 1, j), index(i + 1, j + 1), index(i, j + 1)];
        [[a, b, c], [a, c, d]]
    };
    Soup { positions: quads().map(|(i, j)| position(i, j)).collect(), faces: quads().flat_map(faces).collect() }
}

fn topology(criterion: &mut Criterion) {
    for (around, across) in [(250, 200), (1000, 500)] {
        let bytes = write(&torus(around, across), Format::Stl).expect("a mesh that STL can hold");
        let limits = Limits::default();
        let soup = read(&bytes, &limits).expect("what was written is read").soup;
        let (surface, _) = Surface::from_soup(&soup);
        let edges = Edges::new(&surface.faces);
        let faces = surface.faces.len();
        let (cancel, clock) = (AtomicBool::new(false), monotonic_clock());
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::MAX);

        let mut group = criterion.benchmark_group("topology");
        group.throughput(Throughput::Elements(faces as u64)).sample_size(10);
        group.bench_function(BenchmarkId::new("read", faces), |b| b.iter(|| read(black_box(&bytes), &limits)));
        group.bench_function(BenchmarkId::new("weld", faces), |b| b.iter(|| Surface::from_soup(black_box(&soup))));
        group.bench_function(BenchmarkId::new("edges", faces), |b| b.iter(|| Edges::new(black_box(&surface.faces))));
        group.bench_function(BenchmarkId::new("parts", faces), |b| b.iter(|| Parts::new(black_box(&surface), &edges)));
        group.bench_function(BenchmarkId::new("fans", faces), |b| b.iter(|| Fans::new(black_box(&surface), &edges)));
        group.bench_function(BenchmarkId::new("closed", faces), |b| {
            b.iter(|| ClosedSurface::try_from(black_box(&surface)).is_ok());
        });
        group.bench_function(BenchmarkId::new("bytes_to_measures", faces), |b| {
            b.iter(|| {
                let file = read(black_box(&bytes), &limits).expect("what was written is read");
                let analysis = Analysis::new((&file.soup).into(), &context).expect("nobody cancels");
                measures(&analysis, &context)
            });
        });
        group.finish();
    }
}

criterion_group!(benches, topology);
criterion_main!(benches);
