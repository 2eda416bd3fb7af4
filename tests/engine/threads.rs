//! Repairs are deterministic: the same bytes and report on any number of threads, and on every run.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use glam::{DMat3, DVec3};
use meshmend::analyze::subject;
use meshmend::format::{Format, Limits, read, write};
use meshmend::inspect::{InspectOptions, inspect};
use meshmend::mesh::{Soup, Surface};
use meshmend::remesh::Remesh;
use meshmend::repair::{Context, NoProgress, Operator, Options, Repaired, repair};

use crate::meshes::{cube, join, sphere, torus};
use crate::support::with_context;

fn on<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
}

fn moved(mut soup: Soup, by: DVec3) -> Soup {
    let turn = DMat3::from_axis_angle(DVec3::new(0.36, 0.48, 0.8), 0.7);
    soup.positions.iter_mut().for_each(|p| *p = turn * *p + by);
    soup
}

/// Solids that overlap in general position, with more faces than one thread's share.
fn overlapping() -> Soup {
    let two = join(&torus(3.0, 1.0, 72, 36), &moved(sphere(DVec3::ZERO, 1.2, 48, 30), DVec3::new(2.5, 0.3, 0.4)));
    join(&two, &moved(cube(DVec3::ZERO, 2.0, 12), DVec3::new(-3.0, -1.0, -0.7)))
}

/// Solids that share an edge.
fn touching() -> Soup {
    join(&cube(DVec3::ZERO, 1.0, 12), &cube(DVec3::new(1.0, 1.0, 0.0), 1.0, 12))
}

/// The clock stands still, so that whole reports can be compared.
fn run_repair(soup: &Soup, options: &Options) -> Repaired {
    let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(600));
    repair(&write(soup, Format::Stl).unwrap(), options, &Limits::default(), None, &context).unwrap()
}

#[test]
fn the_pipeline_gives_the_same_result_on_any_number_of_threads() {
    let options = Options { max_tier: 2, max_error: Some(1e-3), ..Options::default() };
    for (mut soup, through) in [
        (overlapping(), [Operator::FillHoles, Operator::SelfUnion, Operator::Simplify]),
        (touching(), [Operator::FillHoles, Operator::Perturb, Operator::Simplify]),
    ] {
        // A hole, and flipped faces.
        soup.faces.drain(20..22);
        soup.faces[40..60].iter_mut().for_each(|face| face.swap(0, 1));
        let one = on(1, || run_repair(&soup, &options));
        for operator in through {
            let did = one.report.steps.iter().any(|step| step.operator == Some(operator) && !step.changed.is_empty());
            assert!(did, "{operator:?} had something to do: {:?}", one.report.steps);
        }
        for again in [on(2, || run_repair(&soup, &options)), on(2, || run_repair(&soup, &options))] {
            assert!(again.bytes == one.bytes, "the bytes differ");
            assert_eq!(again.report, one.report);
        }
    }
}

#[test]
fn a_large_file_is_inspected_alike_on_any_number_of_threads_and_none_waits_forever() {
    // More faces than any loop leaves to one thread. Threads that start together all need the same cached values.
    let bytes = write(&torus(3.0, 1.0, 380, 190), Format::Stl).unwrap();
    let inspected = || {
        let mesh = read(&bytes, &Limits::default()).unwrap();
        with_context(|context| inspect(subject(&mesh, None), &InspectOptions::default(), context)).unwrap().0
    };
    let one = on(1, inspected);
    assert_eq!((one.measures.faces, one.measures.printable()), (144_400, true));
    for threads in [16, 16] {
        assert_eq!(on(threads, inspected), one, "{threads} threads");
    }
}

#[test]
fn a_remesh_is_the_same_on_any_number_of_threads() {
    let (surface, _) = Surface::from_soup(&overlapping());
    let remeshed = || with_context(|c| Remesh { cell: Some(0.1), ..Remesh::default() }.apply(&surface, c)).unwrap();
    let one = on(1, remeshed);
    for again in [on(2, remeshed), on(2, remeshed)] {
        assert!(again.surface == one.surface, "the surfaces differ");
        assert_eq!((again.deviation, again.forced_inside), (one.deviation, one.forced_inside));
    }
}
