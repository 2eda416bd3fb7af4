//! Exact self-intersections of two offset copies of a fine torus: 200,000 faces, some 3,600 pairs. Structure and tree
//! are built in each run of `with the tree`, and the tree alone in `tree`.
//!
//! `RAYON_NUM_THREADS=1 cargo bench --bench intersections` for one thread.

use std::hint::black_box;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use criterion::{Criterion, criterion_group, criterion_main};
use glam::DVec3;
use meshmend::context::{Context, NoProgress};
use meshmend::inspect::{Analysis, intersections};
use meshmend::math::{Tree, to_unit_range};
use meshmend::mesh::Soup;

#[path = "../tests/support/meshes.rs"]
#[allow(dead_code, reason = "shared with the tests, of which each uses a part")]
mod meshes;

fn two_tori() -> Soup {
    let first = meshes::torus(2.0, 0.75, 500, 100);
    let mut second = first.clone();
    for p in &mut second.positions {
        *p += DVec3::new(0.31, 0.17, 0.6);
    }
    meshes::as_f32(meshes::join(&first, &second))
}

fn bench(criterion: &mut Criterion) {
    let soup = two_tori();
    let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::MAX);
    let analysis = || Analysis::new((&soup).into(), &context).expect("nobody cancels");
    let warm = analysis();
    let found = intersections(&warm, &context).expect("nobody cancels");
    assert!((3_000..4_500).contains(&found.counts.pairs.unwrap_or(0)), "{:?}", found.counts);

    let mut group = criterion.benchmark_group("two tori of 200,000 faces");
    group.sample_size(20);
    group.bench_function("tree", |b| {
        let unit = to_unit_range(&warm.surface.positions);
        b.iter(|| black_box(Tree::new(&unit, &warm.surface.faces)));
    });
    group.bench_function("pairs", |b| b.iter(|| intersections(black_box(&warm), &context)));
    group.bench_function("with the tree", |b| {
        b.iter_batched(analysis, |fresh| intersections(&fresh, &context), criterion::BatchSize::LargeInput);
    });
    group.finish();
}

criterion_group!(benches, bench);
criterion_main!(benches);
