//! A repair overruns its deadline by at most 2 s and 10 %, and returns the best verified result so far.

use std::cell::Cell;
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use glam::DVec3;
use meshmend::format::{self, Format, Limits};
use meshmend::inspect::Level;
use meshmend::math::Precision;
use meshmend::mesh::{Soup, Surface};
use meshmend::repair::operators::remesh::ReduceFaces;
use meshmend::repair::{
    Action, Context, NoProgress, OmittedSection, Operator, Options, Outcome, OutputFormat, Preset, Progress,
    RemeshAction, RemeshError, RemeshRequest, Remeshed, Remesher, RemesherInfo, RepairError, Repaired, Stage,
    StepStatus, promised_overrun, repair,
};
use meshmend::simplify::Simplify;

use crate::meshes::{cube, cylinder, join, push, sphere};

const DEADLINE: Duration = Duration::from_secs(10);

/// A clock that a test sets, and that advances by `tick` each time it is read.
#[derive(Default)]
struct Clock {
    now: Mutex<Duration>,
    tick: Duration,
}

impl Clock {
    fn look(&self) -> Duration {
        let mut now = self.now.lock().unwrap();
        *now += self.tick;
        *now
    }

    fn now(&self) -> Duration {
        *self.now.lock().unwrap()
    }

    fn set(&self, now: Duration) {
        *self.now.lock().unwrap() = now;
    }
}

/// Sets a clock when a stage begins.
struct At<'a>(Stage, Duration, &'a Clock);

impl Progress for At<'_> {
    fn report(&self, stage: Stage, _: Option<u8>, _: u8) {
        if stage == self.0 {
            self.2.set(self.2.now().max(self.1));
        }
    }

    fn log(&self, _: &str) {}
}

fn run(
    soup: &Soup,
    options: &Options,
    remesher: Option<&dyn Remesher>,
    progress: &dyn Progress,
    clock: &Clock,
) -> Result<Repaired, RepairError> {
    let bytes = format::write(soup, Format::Stl).unwrap();
    let (cancel, look) = (AtomicBool::new(false), || clock.look());
    let options = Options { deadline_s: DEADLINE.as_secs_f64(), ..options.clone() };
    repair(&bytes, &options, &Limits::default(), remesher, &Context::new(progress, &cancel, &look, DEADLINE))
}

/// A ball with a hole, and another that intersects it.
fn broken() -> Soup {
    let mut soup = join(&sphere(DVec3::ZERO, 1.0, 24, 12), &sphere(DVec3::X * 0.7, 0.8, 16, 8));
    soup.faces.drain(40..60);
    soup
}

/// A cup whose rim has many edges, so that its patch consists of needles that are all near each other.
fn cup(edges: u32) -> Soup {
    let mut cup = cylinder(DVec3::ZERO, 1.0, 2.0, edges);
    let is_lid = |face: &[u32; 3]| face.iter().all(|&v| cup.positions[v as usize].z > 1.9);
    let walls: Vec<[u32; 3]> = cup.faces.iter().copied().filter(|face| !is_lid(face)).collect();
    cup.faces = walls;
    cup
}

#[test]
fn a_repair_overruns_its_deadline_by_at_most_a_tenth_and_two_seconds() {
    for model in [broken(), cup(120)] {
        for tick_ms in [1, 5, 20, 80, 250, 500] {
            let clock = Clock { tick: Duration::from_millis(tick_ms), ..Clock::default() };
            let result = run(&model, &Options::default(), None, &NoProgress, &clock);
            let took = clock.now();
            assert!(took <= DEADLINE + promised_overrun(DEADLINE), "{tick_ms} ms a reading: {took:?}");
            match result {
                Ok(repaired) => {
                    let omitted = &repaired.report.omitted;
                    assert_eq!(
                        omitted.contains(&OmittedSection::Repair),
                        repaired.report.summary.contains("deadline_s")
                    );
                    assert!(
                        !repaired.bytes.is_empty()
                            && repaired.report.after.is_some()
                            && repaired.report.verified_from_output_bytes
                    );
                    // No result is called printable without verification.
                    let unknown = omitted.contains(&OmittedSection::InputVerification);
                    assert!(!(unknown && repaired.report.outcome.is_printable()), "{tick_ms}");
                }
                Err(error) => assert!(matches!(error, RepairError::OutOfTime(_)) && tick_ms > 80, "{tick_ms}: {error}"),
            }
        }
    }
}

#[test]
fn with_time_for_everything_nothing_is_left_out() {
    let repaired = run(&broken(), &Options::default(), None, &NoProgress, &Clock::default()).unwrap();
    assert_eq!(repaired.report.omitted, []);
    assert!(!repaired.report.summary.contains("deadline_s"), "{}", repaired.report.summary);
}

#[test]
fn a_model_that_could_only_be_inspected_comes_back_unchanged() {
    let clock = Clock::default();
    let repaired = run(&broken(), &Options::default(), None, &At(Stage::Repair, DEADLINE, &clock), &clock).unwrap();
    assert_eq!(repaired.report.outcome, Outcome::Unrepairable);
    assert_eq!(repaired.bytes, format::write(&broken(), Format::Stl).unwrap());
    assert!(repaired.report.before.measures.self_intersections.checked);
    assert!(repaired.report.omitted.contains(&OmittedSection::Repair));
    assert!(repaired.report.summary.contains("deadline_s"), "{}", repaired.report.summary);
    let skipped = repaired.report.steps.iter().filter(|step| step.status == StepStatus::Skipped).count();
    assert_eq!(skipped, repaired.report.plan.strategies.len(), "each strategy says that it did not run");
}

#[test]
fn a_model_that_could_not_be_inspected_is_called_neither_printable_nor_broken() {
    let ball = sphere(DVec3::ZERO, 1.0, 32, 16);
    for output in [OutputFormat::Same, OutputFormat::Ply] {
        let clock = Clock::default();
        let options = Options { output, ..Options::default() };
        let repaired = run(&ball, &options, None, &At(Stage::Inspect, DEADLINE, &clock), &clock).unwrap();
        assert_eq!(repaired.report.outcome, Outcome::Unrepairable);
        let omitted = &repaired.report.omitted;
        assert!(
            omitted.contains(&OmittedSection::InputVerification) && omitted.contains(&OmittedSection::Repair),
            "{omitted:?}"
        );
        assert!(
            repaired.report.summary.contains("it is unknown whether the model is printable"),
            "{}",
            repaired.report.summary
        );
        assert_eq!((repaired.report.before.level, repaired.report.after.unwrap().level), (Level::None, Level::None));
        let read = format::read(&repaired.bytes, &Limits::default()).unwrap().soup;
        assert_eq!(read.faces.len(), ball.faces.len());
    }
}

#[test]
fn if_not_even_the_faces_could_be_counted_the_error_names_the_option() {
    let clock = Clock::default();
    let late = DEADLINE + promised_overrun(DEADLINE);
    let error = run(&broken(), &Options::default(), None, &At(Stage::Inspect, late, &clock), &clock).unwrap_err();
    assert!(error.to_string().contains("the deadline of 10 s"), "{error}");
}

#[test]
fn results_from_before_the_deadline_are_verified_and_returned() {
    // Verification begins after the first strategy.
    let clock = Clock::default();
    let mut open = sphere(DVec3::ZERO, 1.0, 32, 16);
    open.faces.drain(40..60);
    let repaired = run(&open, &Options::default(), None, &At(Stage::Verify, DEADLINE, &clock), &clock).unwrap();
    assert_eq!(repaired.report.outcome, Outcome::Repaired, "{}", repaired.report.summary);
    assert!(repaired.report.verified_from_output_bytes && repaired.report.after.unwrap().measures.printable());
}

#[test]
fn a_result_that_could_not_be_verified_in_time_is_not_returned() {
    let clock = Clock::default();
    let mut open = sphere(DVec3::ZERO, 1.0, 32, 16);
    open.faces.drain(40..60);
    let late = DEADLINE + Duration::from_millis(1900);
    let repaired = run(&open, &Options::default(), None, &At(Stage::Verify, late, &clock), &clock).unwrap();
    assert_eq!((repaired.report.outcome, repaired.report.candidates.len()), (Outcome::Unrepairable, 1));
    assert!(repaired.report.omitted.contains(&OmittedSection::Verification));
    assert_eq!(repaired.bytes, format::write(&open, Format::Stl).unwrap());
}

/// A remesher that takes some time on the clock.
#[test]
fn a_deadline_during_the_forecast_of_a_remesh_still_gives_the_best_result() {
    // Every union loses surface behind the hole, so that a remesh is forecast.
    let (model, options) = (broken(), Options { max_tier: 2, voxel_resolution: 64, ..Options::default() });
    let tick = Duration::from_nanos(1);
    let clock = Clock { tick, ..Clock::default() };
    let whole = run(&model, &options, None, &NoProgress, &clock).unwrap().report;
    assert!(whole.steps.iter().any(|step| step.operator == Some(Operator::Remesh)), "{:?}", whole.steps);
    let reads = clock.now().as_nanos() as u32;
    // Before that the inspection is not finished, and there may be nothing to return.
    for part in (8..32).step_by(3) {
        let clock = Clock { tick: DEADLINE / (reads * part / 32).max(1), ..Clock::default() };
        let late = run(&model, &options, None, &NoProgress, &clock);
        assert!(late.is_ok(), "the deadline passes after {part} of 32 parts: {:?}", late.err());
    }
}

struct SlowRemesher<'a> {
    info: RemesherInfo,
    answer: Soup,
    until: Duration,
    clock: &'a Clock,
    asked: Cell<Option<RemeshAction>>,
}

impl<'a> SlowRemesher<'a> {
    fn returning(answer: Soup, until: Duration, clock: &'a Clock) -> Self {
        let info = RemesherInfo { kind: "fake".into(), version: "1".into(), program: "none".into() };
        Self { info, answer, until, clock, asked: Cell::new(None) }
    }
}

impl Remesher for SlowRemesher<'_> {
    fn info(&self) -> Result<&RemesherInfo, &str> {
        Ok(&self.info)
    }

    fn remesh(&self, request: &RemeshRequest<'_>, context: &Context<'_>) -> Result<Remeshed, RemeshError> {
        assert!(self.asked.replace(Some(request.action)).is_none(), "asked once");
        assert!(request.time_limit <= context.remaining());
        self.clock.set(self.until);
        Ok(Remeshed::from(self.answer.clone()))
    }
}

/// Two cubes that share an edge, with options under which only Blender can repair them.
fn for_blender() -> (Soup, Options) {
    let cubes = join(&cube(DVec3::ZERO, 1.0, 1), &cube(DVec3::new(1.0, 1.0, 0.0), 1.0, 1));
    (cubes, Options { preset: Preset::BlenderRemesh, voxel_size: Some(0.1), ..Options::default() })
}

#[test]
fn a_finished_remesh_is_kept_where_the_time_ends_while_its_faces_are_reduced() {
    let (cubes, options) = for_blender();
    let fine = join(&cube(DVec3::ZERO, 1.0, 10), &cube(DVec3::new(1.004, 1.004, 0.0), 1.0, 10));
    let clock = Clock::default();
    let late = SlowRemesher::returning(fine.clone(), DEADLINE, &clock);
    let repaired = run(&cubes, &options, Some(&late), &NoProgress, &clock).unwrap();
    assert_eq!(repaired.report.outcome, Outcome::Repaired, "{}", repaired.report.summary);
    assert_eq!(repaired.report.after.unwrap().measures.faces, fine.faces.len() as u64);
    assert!(repaired.report.omitted.contains(&OmittedSection::Repair), "{:?}", repaired.report.omitted);
    let step = repaired.report.steps.iter().find(|step| step.action == Action::VoxelRemesh).unwrap();
    assert!(step.note.as_ref().unwrap().contains("the deadline came before"), "{step:?}");
}

#[test]
fn the_faces_of_a_remesh_are_not_reduced_without_simplify() {
    let (cubes, options) = for_blender();
    let fine = join(&cube(DVec3::ZERO, 1.0, 10), &cube(DVec3::new(1.004, 1.004, 0.0), 1.0, 10));
    let faces = |without: Vec<Operator>| {
        let clock = Clock::default();
        let fake = SlowRemesher::returning(fine.clone(), Duration::ZERO, &clock);
        let options = Options { without, ..options.clone() };
        run(&cubes, &options, Some(&fake), &NoProgress, &clock).unwrap().report.after.unwrap().measures.faces
    };
    assert!(faces(vec![]) < 100);
    assert_eq!(faces(vec![Operator::Simplify]), fine.faces.len() as u64);
}

#[test]
fn a_requested_blender_remesh_runs_with_blender() {
    let (cubes, options) = for_blender();
    let clock = Clock::default();
    let apart = join(&cube(DVec3::ZERO, 1.0, 3), &cube(DVec3::new(1.004, 1.004, 0.0), 1.0, 3));
    let fake = SlowRemesher::returning(apart, Duration::ZERO, &clock);
    let repaired = run(&cubes, &options, Some(&fake), &NoProgress, &clock).unwrap();
    assert_eq!((repaired.report.outcome, fake.asked.get()), (Outcome::Repaired, Some(RemeshAction::VoxelRemesh)));
    assert_eq!(repaired.report.steps.iter().find_map(|step| step.voxel_size), Some(0.1));
}

#[test]
fn a_simplification_that_a_deadline_ends_keeps_what_it_did() {
    let ball = sphere(DVec3::ZERO, 1.0, 96, 48);
    let simplify = Simplify {
        max_faces: Some(100),
        max_error: 1.0,
        everywhere: true,
        feature_angle_deg: 50.0,
        precision: Precision::F32,
    };
    let reduced = |looks: u32| {
        let clock = Clock { tick: Duration::from_secs(1), ..Clock::default() };
        let (cancel, look) = (AtomicBool::new(false), || clock.look());
        let context = Context::new(&NoProgress, &cancel, &look, Duration::from_secs(u64::from(looks)));
        let (mut surface, _) = Surface::from_soup(&ball);
        let done = simplify.apply(&mut surface, &context);
        surface.check().unwrap();
        done.map(|done| (done, surface))
    };
    let (done, surface) = (1..100)
        .find_map(|looks| reduced(looks).ok().filter(|result| result.0.faces_after < result.0.faces_before))
        .unwrap();
    assert!(done.is_late && surface.faces.len() > 100 && surface.faces.len() < ball.faces.len(), "{done:?}");
    assert!(done.shortfall.unwrap().contains("the deadline came"));
    let clock = Clock::default();
    let repaired = run(&surface.to_soup(), &Options::default(), None, &NoProgress, &clock).unwrap();
    assert_eq!(repaired.report.outcome, Outcome::AlreadyPrintable, "every intermediate state is valid");
}

#[test]
fn a_maximum_error_that_the_deadline_leaves_untested_is_reported() {
    let ball = sphere(DVec3::ZERO, 1.0, 32, 16);
    let max_error = Some(0.02);
    let reduce = ReduceFaces { max_faces: None, max_error, max_deviation: f64::INFINITY, precision: Precision::F32 };
    let reduced = |looks: u64| {
        let clock = Clock { tick: Duration::from_secs(1), ..Clock::default() };
        let (cancel, look) = (AtomicBool::new(false), || clock.look());
        let context = Context::new(&NoProgress, &cancel, &look, Duration::from_secs(looks));
        let (mut surface, _) = Surface::from_soup(&ball);
        reduce.apply(&mut surface, &context).ok()
    };
    let enough = reduced(1_000_000).unwrap();
    assert!(!enough.is_late && enough.limited.is_empty() && !enough.changes.is_empty(), "{enough:?}");
    let untested = (1..1000).filter_map(reduced).find(|applied| !applied.limited.is_empty()).unwrap();
    assert!(untested.is_late && untested.limited[0].0 == "max_error", "{untested:?}");
}

#[test]
fn a_face_count_that_was_not_reached_is_reported_with_the_reason() {
    let options = Options { max_faces: Some(12), ..Options::default() };
    let ball = sphere(DVec3::ZERO, 1.0, 32, 16);
    let repaired = run(&ball, &options, None, &NoProgress, &Clock::default()).unwrap();
    let faces = repaired.report.after.unwrap().measures.faces;
    assert!(faces > 12 && faces < 900, "{faces}");
    let warning = repaired.report.warnings.iter().find(|warning| warning.contains("max_faces=12")).unwrap();
    assert!(warning.contains(&faces.to_string()) && warning.contains("max_error"), "{warning}");
    let enough = Options { max_faces: Some(12), max_error: Some(10.0), ..Options::default() };
    let result = run(&cube(DVec3::ZERO, 1.0, 4), &enough, None, &NoProgress, &Clock::default()).unwrap();
    assert_eq!(result.report.after.unwrap().measures.faces, 12);
    assert!(!result.report.warnings.iter().any(|warning| warning.contains("max_faces")));
}

#[test]
fn voxels_larger_than_requested_are_reported_with_the_reason() {
    let (cubes, options) = for_blender();
    let apart = join(&cube(DVec3::ZERO, 1.0, 3), &cube(DVec3::new(1.004, 1.004, 0.0), 1.0, 3));
    let warning = |voxel_size: f64| {
        let clock = Clock::default();
        let fake = SlowRemesher::returning(apart.clone(), Duration::ZERO, &clock);
        let options = Options { voxel_size: Some(voxel_size), max_remesh_faces: 10_000, ..options.clone() };
        let report = run(&cubes, &options, Some(&fake), &NoProgress, &clock).unwrap().report;
        assert_eq!(report.outcome, Outcome::Repaired, "{}", report.summary);
        report.warnings.into_iter().find(|warning| warning.contains("voxel_size"))
    };
    assert_eq!(warning(0.1), None);
    let warning = warning(0.001).unwrap();
    assert!(warning.contains("voxel_size=0.001") && warning.contains("max_remesh_faces"), "{warning}");
}

#[test]
fn heavily_overlapping_triangles_do_not_delay_a_repair() {
    let mut heap = Soup::default();
    for i in 0..400u32 {
        let z = f64::from(i);
        push(&mut heap, [DVec3::new(0.0, 0.0, z), DVec3::new(400.0, 1.0, 300.0 - z), DVec3::new(1.0, 400.0, 150.0)]);
    }
    for tick_ms in [1, 30] {
        let clock = Clock { tick: Duration::from_millis(tick_ms), ..Clock::default() };
        run(&heap, &Options::default(), None, &NoProgress, &clock).unwrap();
        assert!(clock.now() <= DEADLINE + promised_overrun(DEADLINE), "{:?}", clock.now());
    }
}
