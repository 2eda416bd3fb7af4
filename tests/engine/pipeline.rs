//! The repair pipeline from input bytes to output bytes: outcomes, choice of the result, reports.

use std::cell::RefCell;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use glam::DVec3;
use meshmend::analyze::subject;
use meshmend::format::{self, Format, Limits};
use meshmend::inspect::{InspectOptions, inspect};
use meshmend::mesh::{Soup, Surface};
use meshmend::repair::{
    Action, Category, Context, NoProgress, Operator, Options, Outcome, OutputFormat, Preset, RedFlagCode, RemeshAction,
    RemeshError, RemeshRequest, Remeshed, Remesher, RemesherInfo, RepairError, SkipReason, Step, StepStatus, repair,
};
use proptest::prelude::*;

use crate::meshes::{as_f32, cube, inside_out, join, push, sheet, sphere, torus};
use crate::support::{repair_bytes, repair_soup, with_context};

fn read(bytes: &[u8]) -> Soup {
    format::read(bytes, &Limits::default()).unwrap().soup
}

/// A remesher that returns the given results in order, and records its requests.
struct FakeRemesher {
    info: RemesherInfo,
    answers: RefCell<Vec<Result<Soup, RemeshError>>>,
    asked: RefCell<Vec<(RemeshAction, usize, f64)>>,
}

impl FakeRemesher {
    fn returning(answers: Vec<Result<Soup, RemeshError>>) -> Self {
        let info = RemesherInfo { kind: "fake".into(), version: "1".into(), program: "none".into() };
        Self { info, answers: RefCell::new(answers), asked: RefCell::default() }
    }
}

impl Remesher for FakeRemesher {
    fn info(&self) -> Result<&RemesherInfo, &str> {
        Ok(&self.info)
    }

    fn remesh(&self, request: &RemeshRequest<'_>, _: &Context<'_>) -> Result<Remeshed, RemeshError> {
        self.asked.borrow_mut().push((request.action, request.soup.faces.len(), request.voxel_size));
        self.answers.borrow_mut().remove(0).map(Remeshed::from)
    }
}

/// Tier 1, then Blender, without tier 2.
fn without_tier_2() -> Options {
    Options { preset: Preset::FillHoles, ..Options::default() }
}

/// Two cubes that share an edge, which tier 1 cannot repair.
fn non_manifold() -> Soup {
    join(&cube(DVec3::ZERO, 1.0, 1), &cube(DVec3::new(1.0, 1.0, 0.0), 1.0, 1))
}

#[test]
fn a_printable_file_comes_back_bit_for_bit() {
    let bytes = format::write(&torus(3.0, 1.0, 16, 8), Format::Stl).unwrap();
    let repaired = repair_bytes(&bytes, &Options::default(), None).unwrap();
    assert_eq!(repaired.report.outcome, Outcome::AlreadyPrintable);
    assert_eq!(repaired.bytes, bytes);
    assert!(repaired.report.verified_from_output_bytes && repaired.report.steps.is_empty());
    assert_eq!(repaired.report.changes.unwrap().faces_kept_pct, 100.0);
}

#[test]
fn a_file_from_which_faces_were_left_out_is_never_returned_unchanged() {
    let soup = Surface::from_soup(&cube(DVec3::ZERO, 1.0, 1)).0.to_soup();
    let options = Options { output: OutputFormat::Same, ..Options::default() };
    let whole = format::write(&soup, Format::Mesh).unwrap();
    assert_eq!(repair_bytes(&whole, &options, None).unwrap().bytes, whole);
    let more = [whole.as_slice(), b"Face 13 1 2 99\n"].concat();
    let repaired = repair_bytes(&more, &options, None).unwrap();
    assert_eq!((repaired.report.outcome, repaired.format), (Outcome::Repaired, Format::Mesh));
    assert_eq!(read(&repaired.bytes).faces.len(), 12);
    assert!(!String::from_utf8(repaired.bytes).unwrap().contains("99"));
}

#[test]
fn a_printable_file_in_another_format_keeps_its_faces_in_order() {
    let soup = as_f32(sphere(DVec3::ZERO, 1.0, 12, 6));
    let options = Options { output: OutputFormat::Off, ..Options::default() };
    let repaired = repair_soup(&soup, &options, None);
    assert_eq!((repaired.report.outcome, repaired.format), (Outcome::AlreadyPrintable, Format::Off));
    let out = read(&repaired.bytes);
    for f in 0..soup.faces.len() {
        assert_eq!(out.corners(f), soup.corners(f));
    }
}

/// A remesher that nobody may ask for anything.
struct NeverAsked;

impl Remesher for NeverAsked {
    fn info(&self) -> Result<&RemesherInfo, &str> {
        panic!("asked for its version")
    }

    fn remesh(&self, _: &RemeshRequest<'_>, _: &Context<'_>) -> Result<Remeshed, RemeshError> {
        panic!("asked for a remesh")
    }
}

#[test]
fn blender_is_not_asked_where_no_face_has_an_area() {
    let line = [0.0, 1.0, 2.0].map(|x| DVec3::new(x, x, 0.0));
    let bytes = format::write(&Soup { positions: line.to_vec(), faces: vec![[0, 1, 2]] }, Format::Obj).unwrap();
    let repaired = repair_bytes(&bytes, &Options::default(), Some(&NeverAsked)).unwrap();
    assert_eq!(repaired.report.outcome, Outcome::Unrepairable);
    assert!(repaired.report.steps.iter().all(|step| step.strategy == 0));
    assert!(!repaired.report.summary.contains("Blender"), "{}", repaired.report.summary);
}

#[test]
fn a_file_that_breaks_when_rounded_is_repaired() {
    // A slit so thin that both sides round to the same f32.
    let mut soup = Surface::from_soup(&cube(DVec3::splat(1000.0), 1.0, 2)).0.to_soup();
    for p in &mut soup.positions {
        if p.x == 1000.5 && p.y == 1000.5 {
            p.x -= 0.5 - 3e-8;
        }
    }
    let bytes = format::write(&soup, Format::Off).unwrap();
    let repaired = repair_bytes(&bytes, &Options::default(), None).unwrap();
    assert!(repaired.report.before.measures.printable());
    assert_ne!(repaired.report.outcome, Outcome::Unrepairable);
    assert!(repaired.report.after.unwrap().measures.printable());
}

#[test]
fn each_kind_of_damage_is_repaired_by_the_first_tier() {
    let ball = sphere(DVec3::ZERO, 1.0, 16, 10);
    let mut missing = ball.clone();
    missing.faces.drain(41..47);
    let mut flipped = ball.clone();
    for face in flipped.faces.iter_mut().step_by(3) {
        face.swap(0, 1);
    }
    let mut doubled = ball.clone();
    doubled.faces.extend(ball.faces[..30].to_vec());
    let mut not_a_number = ball.clone();
    push(&mut not_a_number, [DVec3::NAN, DVec3::X, DVec3::Y]);
    let hollow = join(&cube(DVec3::splat(-4.0), 8.0, 3), &inside_out(ball.clone()));
    let mut hollow_with_hole = hollow.clone();
    hollow_with_hole.faces.remove(0);
    for (name, soup, category) in [
        ("missing", missing, Category::Holes),
        ("flipped", flipped, Category::Orientation),
        ("inside out", inside_out(ball.clone()), Category::Orientation),
        ("doubled", doubled, Category::NonManifold),
        ("hollow", hollow_with_hole, Category::MultipleComponents),
    ] {
        let repaired = repair_soup(&soup, &Options::default(), None);
        assert_eq!(repaired.report.outcome, Outcome::Repaired, "{name}: {:?}", repaired.report);
        assert_eq!(repaired.report.plan.category, category, "{name}");
        assert!(repaired.report.candidates.iter().filter(|c| c.chosen).count() == 1);
    }
    let result = repair_soup(&hollow, &Options::default(), None);
    assert_eq!(result.report.outcome, Outcome::AlreadyPrintable);
}

#[test]
fn surface_that_was_fine_is_not_moved() {
    let mut soup = as_f32(torus(3.0, 1.0, 24, 12));
    soup.faces.drain(100..106);
    let repaired = repair_soup(&soup, &Options::default(), None);
    assert_eq!(repaired.report.outcome, Outcome::Repaired);
    assert_eq!(repaired.report.changes.unwrap().faces_kept_pct, 100.0);
    let out = read(&repaired.bytes);
    for f in 0..soup.faces.len() {
        assert_eq!(out.corners(f), soup.corners(f), "face {f} did not move");
    }
}

#[test]
fn an_open_sheet_is_returned_with_the_reason() {
    let bytes = format::write(&sheet(12), Format::Stl).unwrap();
    let fake = FakeRemesher::returning(vec![]);
    let repaired = repair_bytes(&bytes, &Options::default(), Some(&fake)).unwrap();
    assert_eq!((repaired.report.outcome, repaired.report.plan.category), (Outcome::Unrepairable, Category::OpenSheet));
    assert_eq!(repaired.bytes, bytes);
    assert!(repaired.report.summary.contains("open surface"), "{}", repaired.report.summary);
    assert!(fake.asked.borrow().is_empty());
}

#[test]
fn an_open_sheet_is_remeshed_when_that_is_asked_for() {
    let fake = FakeRemesher::returning(vec![Ok(cube(DVec3::ZERO, 12.0, 4))]);
    let options = Options { preset: Preset::BlenderRemesh, ..Options::default() };
    repair_soup(&sheet(12), &options, Some(&fake));
    assert_eq!(fake.asked.borrow().len(), 1);
}

#[test]
fn models_that_tier_1_cannot_repair_go_to_the_boolean_and_then_to_voxels() {
    let apart = join(&cube(DVec3::ZERO, 1.0, 3), &cube(DVec3::new(1.004, 1.004, 0.0), 1.0, 3));
    let fake = FakeRemesher::returning(vec![Err(RemeshError::Failed("no".into())), Ok(apart)]);
    let repaired = repair_soup(&non_manifold(), &without_tier_2(), Some(&fake));
    let asked: Vec<RemeshAction> = fake.asked.borrow().iter().map(|a| a.0).collect();
    assert_eq!(asked, [RemeshAction::BooleanUnion, RemeshAction::VoxelRemesh]);
    assert_eq!(repaired.report.outcome, Outcome::Repaired, "{:#?}", repaired.report);
    let failed = repaired.report.steps.iter().find(|s| s.status == StepStatus::Failed).unwrap();
    assert_eq!((failed.action, failed.note.as_deref()), (Action::BooleanUnion, Some("no")));
    let voxels = repaired.report.steps.iter().find(|s| s.action == Action::VoxelRemesh).unwrap();
    assert!(voxels.voxel_size.unwrap() > 0.0 && voxels.program.as_ref().unwrap().kind == "fake");
}

/// Two cubes with `n` cells along each side, of which one has a corner inside the other.
fn overlapping(n: u32) -> Soup {
    join(&cube(DVec3::ZERO, 1.0, n), &cube(DVec3::new(0.9, 0.8, 0.7), 1.0, n))
}

#[test]
fn a_closed_model_with_intersecting_faces_is_not_printable_and_goes_to_the_boolean() {
    let beside = |x: f64| join(&cube(DVec3::ZERO, 1.0, 2), &cube(DVec3::new(x, 0.1, 0.2), 1.0, 2));
    let fake = FakeRemesher::returning(vec![Ok(beside(1.0005))]);
    let repaired = repair_soup(&beside(0.998), &without_tier_2(), Some(&fake));
    let before = &repaired.report.before.measures;
    assert!(before.closed && before.outward && before.defects() == before.self_intersections.pairs.unwrap());
    assert_eq!(repaired.report.plan.category, Category::MultipleComponents);
    assert_eq!(fake.asked.borrow()[0].0, RemeshAction::BooleanUnion);
    assert_eq!(repaired.report.outcome, Outcome::Repaired, "{:#?}", repaired.report);
    assert!(repaired.report.after.unwrap().measures.self_intersections.proven_none());
}

#[test]
fn without_blender_an_intersecting_model_comes_back_as_it_is_with_the_reason() {
    let bytes = format::write(&overlapping(2), Format::Stl).unwrap();
    let repaired = repair_bytes(&bytes, &without_tier_2(), None).unwrap();
    assert_eq!((repaired.report.outcome, &repaired.bytes), (Outcome::Unrepairable, &bytes));
    assert!(repaired.report.summary.contains("pairs of intersecting faces"), "{}", repaired.report.summary);
}

#[test]
fn a_result_with_fewer_intersecting_faces_is_better_than_one_with_more() {
    // The union has fewer intersecting pairs and the remesh more; both keep the model's extent.
    let fake = FakeRemesher::returning(vec![Ok(overlapping(2)), Ok(overlapping(6))]);
    let repaired = repair_soup(&overlapping(4), &without_tier_2(), Some(&fake));
    let pairs: Vec<u64> = repaired.report.candidates.iter().map(|c| c.defects).collect();
    assert!(pairs[1] < pairs[0] && pairs[0] < pairs[2], "{pairs:?}");
    let chosen = repaired.report.candidates.iter().position(|c| c.chosen);
    assert_eq!((repaired.report.outcome, chosen), (Outcome::PartiallyRepaired, Some(1)));
}

#[test]
fn closing_a_hole_is_better_even_if_faces_intersect() {
    let mut soup = overlapping(2);
    // A hole of two faces in the second cube, at the corner inside the first: its patch intersects as the faces did.
    let inside = |f: &[u32; 3]| f.iter().all(|&v| soup.positions[v as usize].max_element() < 1.35 && f[0] >= 144);
    let gone: Vec<usize> = (0..soup.faces.len()).filter(|&f| inside(&soup.faces[f])).take(2).collect();
    assert_eq!(gone.len(), 2);
    let mut k = 0;
    soup.faces.retain(|_| {
        k += 1;
        !gone.contains(&(k - 1))
    });
    let repaired = repair_soup(&soup, &without_tier_2(), None);
    assert_eq!(repaired.report.outcome, Outcome::PartiallyRepaired, "{:#?}", repaired.report);
    let after = repaired.report.after.unwrap();
    assert!(after.measures.printable_but_for_intersections() && after.measures.self_intersections.pairs > Some(0));
}

#[test]
fn a_result_that_lost_most_of_the_model_is_not_chosen() {
    let corner = || cube(DVec3::ZERO, 0.5, 1);
    let fake = FakeRemesher::returning(vec![Ok(corner()), Ok(corner())]);
    let bytes = format::write(&non_manifold(), Format::Stl).unwrap();
    let repaired = repair_bytes(&bytes, &without_tier_2(), Some(&fake)).unwrap();
    assert_eq!(repaired.report.outcome, Outcome::Unrepairable);
    assert_eq!(repaired.bytes, bytes);
    let judged = repaired.report.candidates.iter().find(|c| c.strategy == Some(1)).unwrap();
    assert!(judged.printable && judged.red_flags.iter().any(|f| f.code == RedFlagCode::BoundingBoxChange));
}

#[test]
fn an_empty_result_is_never_returned() {
    let fake = FakeRemesher::returning(vec![Ok(Soup::default()), Err(RemeshError::Empty)]);
    let repaired = repair_soup(&non_manifold(), &without_tier_2(), Some(&fake));
    assert_eq!(repaired.report.outcome, Outcome::Unrepairable);
    assert!(!read(&repaired.bytes).faces.is_empty());
}

#[test]
fn without_blender_the_strategy_is_skipped_and_reported() {
    let repaired = repair_soup(&non_manifold(), &without_tier_2(), None);
    let skipped: Vec<_> = repaired.report.steps.iter().filter(|s| s.tier == 3).collect();
    assert_eq!(skipped.len(), 2);
    assert!(skipped.iter().all(|s| s.status == StepStatus::Skipped && s.note.as_ref().unwrap().contains("Blender")));
    assert!(skipped.iter().all(|s| s.skip_reason == Some(SkipReason::Unavailable)));
    assert!(repaired.report.summary.contains("Blender could not run"), "{}", repaired.report.summary);
}

#[test]
fn a_needless_step_of_blender_is_not_told_as_one_that_could_not_run() {
    let fake = FakeRemesher::returning(vec![Err(RemeshError::Empty)]);
    let mut open = non_manifold();
    open.faces.pop();
    let options = Options { without: vec![Operator::FillHoles], ..without_tier_2() };
    let repaired = repair_soup(&open, &options, Some(&fake));
    let of_blender: Vec<_> = repaired.report.steps.iter().filter(|s| s.tier == 3).collect();
    let reasons: Vec<_> = of_blender.iter().map(|s| s.skip_reason).collect();
    assert_eq!(reasons, [Some(SkipReason::Needless), None]);
    assert!(!repaired.report.summary.contains("could not run"), "{}", repaired.report.summary);
}

#[test]
fn max_tier_keeps_higher_tiers_out_of_the_plan() {
    let fake = FakeRemesher::returning(vec![]);
    let repaired = repair_soup(&non_manifold(), &Options { max_tier: 1, ..Options::default() }, Some(&fake));
    assert!(repaired.report.plan.strategies.iter().all(|r| r.tier == 1));
    assert!(fake.asked.borrow().is_empty());
}

#[test]
fn parts_that_became_one_raise_a_flag() {
    // The second part is so small that no other red flag reports its loss.
    let two = join(&cube(DVec3::ZERO, 1.0, 1), &cube(DVec3::ONE, 0.005, 1));
    let whole = cube(DVec3::ZERO, 1.0, 2);
    let fake = FakeRemesher::returning(vec![Ok(whole.clone()), Ok(whole)]);
    let repaired = repair_soup(&two, &without_tier_2(), Some(&fake));
    assert_eq!(repaired.report.outcome, Outcome::PartiallyRepaired, "{:#?}", repaired.report);
    assert_eq!(repaired.report.red_flags[0].code, RedFlagCode::PartsMerged);
}

#[test]
fn voxels_grow_until_the_face_limit_holds() {
    let fake = FakeRemesher::returning(vec![Err(RemeshError::Empty), Err(RemeshError::Empty)]);
    let options = Options { voxel_size: Some(1e-6), max_remesh_faces: 10_000, ..without_tier_2() };
    repair_soup(&non_manifold(), &options, Some(&fake));
    let size = fake.asked.borrow()[1].2;
    assert!(2.0 * 12.0 / (size * size) <= 10_000.0 && size < 0.2, "{size}");
}

#[test]
fn voxels_are_as_fine_as_thin_walls_need_and_no_finer_than_a_quarter_of_the_usual() {
    // A plate and a part that share an edge, so that tier 1 leaves it to the remesh.
    let size = |thickness: f64| {
        let mut plate = join(&cube(DVec3::ZERO, 1.0, 8), &cube(DVec3::splat(1.0), 1.0, 8));
        plate.positions.iter_mut().for_each(|p| p.z *= thickness);
        let fake = FakeRemesher::returning(vec![Err(RemeshError::Empty), Err(RemeshError::Empty)]);
        let options = Options { preset: Preset::BlenderRemesh, max_remesh_faces: 20_000_000, ..without_tier_2() };
        repair_soup(&plate, &options, Some(&fake));
        let asked = fake.asked.borrow();
        let voxels = asked.iter().find(|request| request.0 == RemeshAction::VoxelRemesh).unwrap();
        (voxels.2, 2.0 * (2.0 + thickness * thickness).sqrt() / 300.0)
    };
    let (found, usual) = size(1.0);
    assert!((found / usual - 1.0).abs() < 1e-6, "{found} {usual}");
    let (found, usual) = size(0.015);
    assert!((found - 0.005).abs() < 1e-4 && found < usual, "{found} {usual}");
    let (found, usual) = size(0.001);
    assert!((found / usual - 0.25).abs() < 1e-6, "{found} {usual}");
}

#[test]
fn a_remesh_that_exceeds_the_face_limit_is_refused_with_the_reason() {
    let fake = FakeRemesher::returning((0..2).map(|_| Err(RemeshError::Empty)).collect());
    let mut comb = Soup::default();
    for i in 0..60 {
        comb = join(&comb, &cube(DVec3::new(0.0, 0.0, f64::from(i) * 0.02), 1.0, 1));
    }
    let options = Options { preset: Preset::BlenderRemesh, max_remesh_faces: 1000, ..without_tier_2() };
    let report = repair_soup(&comb, &options, Some(&fake)).report;
    let step = report.steps.iter().find(|step| step.action == Action::VoxelRemesh).unwrap();
    assert_eq!(step.status, StepStatus::Failed);
    assert!(step.note.as_ref().unwrap().contains("max_remesh_faces"), "{step:?}");
    assert!(fake.asked.borrow().iter().all(|request| request.0 != RemeshAction::VoxelRemesh));
}

#[test]
fn a_cancelled_job_ends_with_an_error() {
    let cancel = AtomicBool::new(true);
    let clock = || Duration::ZERO;
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(600));
    let bytes = format::write(&non_manifold(), Format::Stl).unwrap();
    let repaired = repair(&bytes, &Options::default(), &Limits::default(), None, &context);
    assert!(matches!(repaired, Err(RepairError::Cancelled(_))));
}

#[test]
fn an_option_out_of_range_is_refused_before_the_file_is_read() {
    let repaired = repair_bytes(b"", &Options { max_tier: 4, ..Options::default() }, None);
    assert!(matches!(repaired, Err(RepairError::Options(_))));
}

#[test]
fn a_file_with_only_broken_faces_is_returned() {
    let mut soup = Soup::default();
    push(&mut soup, [DVec3::X, DVec3::X, DVec3::Y]);
    let bytes = format::write(&soup, Format::Stl).unwrap();
    let repaired = repair_bytes(&bytes, &Options::default(), None).unwrap();
    assert_eq!((repaired.report.outcome, repaired.bytes), (Outcome::Unrepairable, bytes));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_same_bytes_in_give_the_same_bytes_out_and_the_verdict_is_true(
        gone in proptest::collection::vec(0..180usize, 0..12),
        turned in proptest::collection::vec(0..180usize, 0..12),
        doubled in proptest::collection::vec(0..180usize, 0..6),
    ) {
        let mut soup = torus(3.0, 1.0, 12, 8);
        for f in turned {
            soup.faces[f].swap(1, 2);
        }
        for f in doubled {
            let face = soup.faces[f];
            soup.faces.push(face);
        }
        for f in gone {
            soup.faces.swap_remove(f);
        }
        let (a, b) = (repair_soup(&soup, &Options::default(), None), repair_soup(&soup, &Options::default(), None));
        prop_assert_eq!(&a, &b);
        let cancel = AtomicBool::new(false);
        let clock = || Duration::ZERO;
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(600));
        let look = |bytes: &[u8], options: &InspectOptions| {
            inspect(subject(&format::read(bytes, &Limits::NONE).unwrap(), None), options, &context).unwrap().0
        };
        let seen = look(&a.bytes, &InspectOptions::default());
        prop_assert_eq!(Some(&seen), a.report.after.as_ref());
        let input = InspectOptions { walls_of_printable_only: true, ..InspectOptions::default() };
        prop_assert_eq!(&look(&format::write(&soup, Format::Stl).unwrap(), &input), &a.report.before);
        prop_assert_eq!(seen.measures.printable(), matches!(a.report.outcome, Outcome::Repaired | Outcome::AlreadyPrintable));
    }
}

#[test]
fn a_printable_result_that_lost_visible_surface_is_flagged_as_partially_repaired() {
    // The remesher drops the third cube, which is too small for any other red flag.
    let model = join(&non_manifold(), &cube(DVec3::new(0.2, 0.2, 1.2), 0.3, 2));
    let two = || join(&cube(DVec3::ZERO, 1.0, 4), &cube(DVec3::new(1.004, 1.004, 0.0), 1.0, 4));
    let fake = FakeRemesher::returning(vec![Ok(two()), Ok(two())]);
    let repaired = repair_soup(&model, &without_tier_2(), Some(&fake));
    assert_eq!(repaired.report.outcome, Outcome::PartiallyRepaired, "{:?}", repaired.report.red_flags);
    let flag = repaired.report.red_flags.iter().find(|f| f.code == RedFlagCode::SurfaceLost).unwrap();
    assert!(flag.value > 1.0 && repaired.report.changes.unwrap().surface_lost_pct == Some(flag.value));
    assert!(!repaired.report.summary.is_empty());
}

#[test]
fn a_result_that_is_not_printable_and_lost_a_part_is_not_preferred_to_the_input() {
    // The remesher drops the two small cubes, which halves the defects and moves no side of the box.
    let small = |x: f64, y: f64| cube(DVec3::new(x, y, 0.25), 0.25, 1);
    let model = join(&non_manifold(), &join(&small(0.125, 1.5), &small(0.375, 1.75)));
    let fake = FakeRemesher::returning(vec![Ok(non_manifold()), Ok(non_manifold())]);
    let bytes = format::write(&model, Format::Stl).unwrap();
    let repaired = repair_bytes(&bytes, &without_tier_2(), Some(&fake)).unwrap();
    let judged = repaired.report.candidates.iter().find(|c| c.strategy == Some(1)).unwrap();
    assert!(!judged.printable && judged.defects < repaired.report.before.measures.defects());
    let flag = judged.red_flags.iter().find(|f| f.code == RedFlagCode::SurfaceLost).unwrap();
    assert!(
        (3.0..25.0).contains(&flag.value) && judged.red_flags.iter().all(|f| f.code != RedFlagCode::BoundingBoxChange)
    );
    assert_eq!((repaired.report.outcome, repaired.bytes), (Outcome::Unrepairable, bytes));
}

#[test]
fn the_report_says_how_far_the_result_is_from_the_input() {
    let apart = join(&cube(DVec3::ZERO, 1.0, 3), &cube(DVec3::new(1.004, 1.004, 0.0), 1.0, 3));
    let fake = FakeRemesher::returning(vec![Ok(apart)]);
    let changes = repair_soup(&non_manifold(), &without_tier_2(), Some(&fake)).report.changes.unwrap();
    let (lost, made) = (changes.lost.unwrap(), changes.added.unwrap());
    for farthest in [lost.distance.max, made.distance.max] {
        assert!((0.0035..0.006).contains(&farthest), "{farthest}");
    }
    assert!((lost.percent.max - lost.distance.max / 3.0 * 100.0).abs() < 1e-6);
    assert!(lost.complete && made.complete && lost.samples > 3500 && made.vertices > 0);
}

#[test]
fn a_strategy_reuses_a_shared_prefix_and_gives_the_result_it_would_give_alone() {
    // The open sheet makes several strategies run. One strategy of `auto` keeps the inner solid and the other drops it.
    let mut soup = join(&overlapping(2), &cube(DVec3::new(4.0, 0.0, 0.0), 1.0, 2));
    soup = join(&soup, &inside_out(cube(DVec3::new(4.5, 0.2, 0.3), 1.0, 2)));
    let mut open = sheet(8);
    open.positions.iter_mut().for_each(|p| *p += DVec3::new(20.0, 0.0, 0.0));
    soup = join(&soup, &open);
    let auto = repair_soup(&soup, &Options { max_tier: 2, ..Options::default() }, None).report;
    assert!(auto.candidates.len() > 2, "{:#?}", auto.plan);
    let facts = |steps: &[Step], strategy: u32| -> Vec<_> {
        let own = steps.iter().filter(|step| step.strategy == strategy);
        own.map(|step| (step.action, step.operator, step.status, step.changed.clone(), step.moved)).collect()
    };
    for (index, strategy) in (0..2).zip(&auto.plan.strategies) {
        let alone =
            repair_soup(&soup, &Options { max_tier: 2, preset: strategy.preset, ..Options::default() }, None).report;
        assert_eq!(facts(&auto.steps, index), facts(&alone.steps, 0), "{:?}", strategy.preset);
        let [a, b] = [&auto.candidates[index as usize], &alone.candidates[0]];
        assert_eq!((a.faces, a.defects, a.printable), (b.faces, b.defects, b.printable));
    }
    let taken = |strategy: u32, operator: Operator| {
        let mut mesh = auto.steps.iter().filter(|step| step.strategy == strategy && step.operator == Some(operator));
        mesh.all(|step| step.note.as_ref().is_some_and(|note| note.contains("reused")))
    };
    assert!(!taken(0, Operator::Sew) && taken(1, Operator::Sew) && taken(2, Operator::Sew), "{:#?}", auto.steps);
}

/// The cells of a cube of `n^3` cells, six tetrahedra each. Each tetrahedron is written as one polygon of its four corners, as programs for
/// volume meshes sometimes do.
fn tetrahedra_as_polygons(n: usize) -> Vec<u8> {
    let mut text = String::new();
    let index = |[x, y, z]: [usize; 3]| (x * (n + 1) + y) * (n + 1) + z + 1;
    let points = |count: usize| (0..count.pow(3)).map(move |i| [i / count / count, i / count % count, i % count]);
    for p in points(n + 1) {
        let [x, y, z] = p.map(|k| k as f64 / n as f64);
        text.push_str(&format!("v {x} {y} {z}\n"));
    }
    for cell in points(n) {
        for order in [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]] {
            let mut corner = cell;
            text.push_str(&format!("f {}", index(corner)));
            for k in order {
                corner[k] += 1;
                text.push_str(&format!(" {}", index(corner)));
            }
            text.push('\n');
        }
    }
    text.into_bytes()
}

fn without_remesh(bytes: &[u8]) -> Vec<Step> {
    let options = Options { max_tier: 2, without: vec![Operator::Remesh], ..Options::default() };
    with_context(|context| repair(bytes, &options, &Limits::default(), None, context)).unwrap().report.steps
}

#[test]
fn a_strategy_whose_own_operator_changes_nothing_is_not_judged_again() {
    let steps = without_remesh(&tetrahedra_as_polygons(3));
    let of_patching: Vec<&Step> = steps
        .iter()
        .skip_while(|step| step.action != Action::CleanAndPatch)
        .take_while(|step| step.action != Action::NativeRemesh)
        .collect();
    let [first, rest @ ..] = of_patching.as_slice() else { panic!("{steps:?}") };
    assert!(first.changed.is_empty(), "{first:?}");
    let rest: Vec<_> = rest.iter().filter(|step| step.strategy == first.strategy).collect();
    assert!(rest.iter().any(|step| step.action == Action::Validate), "{rest:?}");
    assert!(rest.iter().all(|step| step.milliseconds == 0.0 && step.note.is_some()), "{rest:?}");
}

#[test]
fn strategies_without_a_remesh_are_skipped_for_a_surface_that_is_shredded() {
    let steps = without_remesh(&tetrahedra_as_polygons(12));
    let validated: Vec<u32> =
        steps.iter().filter(|step| step.action == Action::Validate).map(|step| step.strategy).collect();
    assert_eq!(validated, [0]);
    let is_told = |step: &Step| step.note.as_ref().is_some_and(|note| note.contains("non-manifold nearly everywhere"));
    let skipped = steps.iter().filter(|step| step.status == StepStatus::Skipped && is_told(step));
    assert!(skipped.count() >= 4, "{steps:?}");
}
