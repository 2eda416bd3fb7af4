//! The whole pipeline on any bytes.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use meshmend::context::{Context, NoProgress};
use meshmend::format::{Limits, read};
use meshmend::inspect::measure;
use meshmend::repair::operators::holes::HoleFilling;
use meshmend::repair::operators::orient::Nested;
use meshmend::repair::{
    OpenSheets, Operator, Options, Outcome, OutputFormat, Preset, RepairError, Repaired, Report, repair as run,
};

use super::choices::Choices;

const LIMITS: Limits = Limits { max_bytes: 1 << 20, max_faces: 4000, max_vertices: 12_000 };
/// The time of a run; what it takes longer is to judge what there is.
const LONGEST: Duration = Duration::from_secs(5);

/// Repairs the bytes without Blender, with options that follow from the bytes, so that any model is a seed.
///
/// # Panics
/// Where the pipeline panics; answers something else the second time; says that a file is printable that is not; or
/// tells what can't be told as JSON.
pub fn repair(bytes: &[u8]) {
    let mut choices = Choices::from(bytes);
    let options = options(&mut choices);
    let ticks = if choices.below(4) == 0 { choices.below(1000) as u64 } else { u64::MAX };
    let (first, in_time) = within(ticks, bytes, &options);
    if in_time {
        let (second, in_time) = within(ticks, bytes, &options);
        assert!(first == second || !in_time, "the second run answers something else: {first:?}\n\n{second:?}");
    }
    match first {
        Ok(repaired) => hold_to_its_word(&repaired),
        Err(RepairError::Read(_) | RepairError::Write(_)) => {}
        Err(error) => panic!("{error}"),
    }
}

/// Repairs, and says whether there was enough time for it, so that another run must answer the same. The clock ticks
/// whenever it is looked at, so that the given time is over at the same place in each run.
fn within(ticks: u64, bytes: &[u8], options: &Options) -> (Result<Repaired, RepairError>, bool) {
    let (cancel, looks, begin) = (AtomicBool::new(false), AtomicU64::new(0), Instant::now());
    let late = AtomicBool::new(false);
    let clock = || {
        if late.fetch_or(begin.elapsed() > LONGEST, Ordering::Relaxed) {
            return Duration::from_secs(u64::MAX);
        }
        Duration::from_nanos(looks.fetch_add(1, Ordering::Relaxed))
    };
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_nanos(ticks));
    let answer = run(bytes, options, &LIMITS, None, &context);
    (answer, !late.into_inner())
}

fn hold_to_its_word(repaired: &Repaired) {
    let report = &repaired.report;
    let told = serde_json::to_string(report).expect("a report is JSON");
    let heard: Report = serde_json::from_str(&told).expect("and can be read again");
    assert_eq!(&heard, report);
    assert_eq!(report.output.is_some(), !repaired.bytes.is_empty());
    if repaired.bytes.is_empty() {
        return;
    }
    let soup = read(&repaired.bytes, &Limits::default()).expect("a result can be read").soup;
    let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::MAX);
    let found = measure(&soup, &context).expect("nobody cancels");
    let told = &report.after.as_ref().expect("where there is a result, it was looked at").measures;
    assert_eq!(told.printable(), found.printable(), "{told:?}\n\n{found:?}");
    if matches!(report.outcome, Outcome::AlreadyPrintable | Outcome::Repaired) {
        assert!(found.printable(), "{:?}: {found:?}", report.outcome);
    }
}

/// The default in half of all cases, otherwise any.
fn options(from: &mut Choices) -> Options {
    let defaults = Options { max_tier: 2, pictures: false, ..Options::default() };
    if from.below(2) == 0 {
        return defaults;
    }
    use OutputFormat::{Mesh, Obj, Off, Ply, Same, Stl};
    let length = [1e-6, 1e-3, 0.1, 10.0];
    Options {
        preset: *from.one(&[
            Preset::Auto,
            Preset::Auto,
            Preset::Auto,
            Preset::BasicCleanup,
            Preset::FillHoles,
            Preset::FullRepair,
            Preset::ConservativeRepair,
            Preset::ManifoldRepair,
        ]),
        output: *from.one(&[Stl, Obj, Ply, Off, Mesh, Same]),
        with: Operator::ALL.iter().copied().filter(|o| o.is_on_request() && from.below(4) == 0).collect(),
        without: Operator::ALL.iter().copied().filter(|_| from.below(20) == 0).collect(),
        max_deviation: (from.below(4) == 0).then(|| *from.one(&length)),
        max_faces: (from.below(4) == 0).then(|| 4 + from.below(300) as u64),
        max_error: (from.below(4) == 0).then(|| *from.one(&length)),
        weld_tolerance: *from.one(&[0.0, 1e-6, 0.01]),
        sew_ratio: *from.one(&[None, Some(0.0), Some(0.2), Some(0.5)]),
        stitch_threshold: *from.one(&[None, Some(0.0), Some(1e-3), Some(0.01), Some(0.5)]),
        degenerate_tolerance: *from.one(&[0.0, 1e-7, 1e-3]),
        nested: *from.one(&[Nested::Keep, Nested::Alternate]),
        open_sheets: *from.one(&[OpenSheets::Auto, OpenSheets::Leave, OpenSheets::Thicken, OpenSheets::Base]),
        thickness: (from.below(4) == 0).then(|| *from.one(&length)),
        max_hole_size: *from.one(&[1.0, 1.0, 0.1]),
        max_holes: *from.one(&[1_000_000, 1]),
        hole_filling: *from.one(&[HoleFilling::Auto, HoleFilling::Smooth, HoleFilling::Planar, HoleFilling::Sharp]),
        refine_patches: from.below(4) == 0,
        fair_patches: from.below(4) == 0,
        voxel_resolution: 64,
        ..defaults
    }
}
