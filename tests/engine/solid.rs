//! Repair to a solid: overlaps, internal parts, zero-thickness walls, and the remesh as the last resort.

use glam::DVec3;
use meshmend::format::{Format, Limits, read, write};
use meshmend::mesh::Soup;
use meshmend::repair::{Action, Operator, Options, Outcome, OutputFormat, Overlaps, StepStatus, WindingRuleChoice};

use crate::meshes::{cube, join, push};
use crate::support::{repair_bytes, repair_soup};

fn native() -> Options {
    Options { max_tier: 2, ..Options::default() }
}

fn overlapping() -> Soup {
    join(&cube(DVec3::ZERO, 1.0, 2), &cube(DVec3::new(0.5, 0.25, 0.125), 1.0, 2))
}

/// The common volume of the two cubes of `overlapping`.
const COMMON: f64 = 0.5 * 0.75 * 0.875;

#[test]
fn parts_that_overlap_become_one_solid() {
    let repaired = repair_soup(&overlapping(), &native(), None);
    assert_eq!(repaired.report.outcome, Outcome::Repaired);
    let after = &repaired.report.after.unwrap().measures;
    assert_eq!((after.parts, after.printable()), (1, true));
    assert!((after.volume.value - (2.0 - COMMON)).abs() < 1e-5);
}

#[test]
fn parts_with_coordinates_that_f32_can_not_hold_are_united_by_their_own_vertices() {
    let mut soup = join(&cube(DVec3::ZERO, 1.0, 1), &cube(DVec3::splat(0.53), 1.1, 1));
    soup.positions.iter_mut().for_each(|position| *position *= 1e50);
    let options = Options { output: OutputFormat::Off, ..native() };
    let repaired = repair_bytes(&write(&soup, Format::Off).unwrap(), &options, None).unwrap();
    assert_eq!(repaired.report.outcome, Outcome::Repaired);
    let after = &repaired.report.after.unwrap().measures;
    assert_eq!((after.parts, after.printable()), (1, true));
    let result = read(&repaired.bytes, &Limits::default()).unwrap().soup;
    assert_eq!(result.positions.len(), 20, "14 of the corners, and 6 points where edges intersect faces");
    let kept = result.positions.iter().filter(|position| soup.positions.contains(position)).count();
    assert_eq!(kept, 14);
}

#[test]
fn new_vertices_with_a_zero_coordinate_are_rounded_though_others_exceed_f32() {
    let mut soup = join(&cube(DVec3::ZERO, 1.0, 1), &cube(DVec3::new(0.53, 0.53, 0.0), 1.1, 1));
    soup.positions.iter_mut().for_each(|position| *position *= 1e50);
    let options = Options { output: OutputFormat::Off, ..native() };
    let repaired = repair_bytes(&write(&soup, Format::Off).unwrap(), &options, None).unwrap();
    let after = &repaired.report.after.unwrap().measures;
    assert_eq!((repaired.report.outcome, after.parts, after.printable()), (Outcome::Repaired, 1, true));
    let volume = 1.0 + 1.1 * 1.1 * 1.1 - 0.47 * 0.47;
    assert!((after.volume.value / 1e150 - volume).abs() < 1e-9, "{}", after.volume.value);
}

#[test]
fn parts_to_keep_come_back_unchanged_and_the_report_says_that_they_overlap() {
    let repaired = repair_soup(&overlapping(), &Options { overlaps: Overlaps::Keep, ..native() }, None);
    assert!(
        !matches!(repaired.report.outcome, Outcome::Repaired | Outcome::AlreadyPrintable),
        "{:?}",
        repaired.report.outcome
    );
    let after = &repaired.report.after.unwrap_or(repaired.report.before).measures;
    assert_eq!((after.parts, after.faces), (2, 96));
    assert!(after.self_intersections.pairs > Some(0));
}

#[test]
fn with_the_odd_rule_what_two_parts_have_in_common_is_empty() {
    let repaired = repair_soup(
        &overlapping(),
        &Options { winding_rule: WindingRuleChoice::Odd, max_volume_change_pct: 100.0, ..native() },
        None,
    );
    let after = &repaired.report.after.unwrap().measures;
    assert!((after.volume.value - (2.0 - 2.0 * COMMON)).abs() < 1e-4, "{}", after.volume.value);
}

/// A cube with a zero-thickness fin: two coincident sheets of opposite orientation and different triangulation.
fn with_a_fin() -> Soup {
    let mut soup = cube(DVec3::ZERO, 1.0, 1);
    let [a, b] = [DVec3::new(1.0, 0.25, 0.25), DVec3::new(1.0, 0.75, 0.25)];
    let [c, d] = [DVec3::new(2.0, 0.75, 0.25), DVec3::new(2.0, 0.25, 0.25)];
    for triangle in [[a, d, c], [a, c, b], [a, b, d], [b, c, d]] {
        push(&mut soup, triangle);
    }
    soup
}

#[test]
fn a_visible_zero_thickness_wall_is_thickened() {
    let repaired = repair_soup(&with_a_fin(), &native(), None);
    assert_eq!(repaired.report.outcome, Outcome::Repaired, "{:?}", repaired.report.red_flags);
    let after = &repaired.report.after.unwrap().measures;
    assert!(after.printable());
    assert!(after.bounding_box.unwrap().max[0] > 1.99, "{:?}", after.bounding_box);
    assert!(after.volume.value > 1.0 && after.volume.value < 1.01, "{}", after.volume.value);
}

#[test]
fn if_nothing_may_be_resolved_the_model_is_remeshed() {
    let options = Options { without: vec![Operator::SelfUnion], voxel_resolution: 60, ..native() };
    let repaired = repair_soup(&overlapping(), &options, None);
    assert_eq!(repaired.report.outcome, Outcome::Repaired, "{:?}", repaired.report.red_flags);
    let remesh = repaired.report.steps.iter().find(|step| step.operator == Some(Operator::Remesh)).unwrap();
    assert_eq!((remesh.action, remesh.status), (Action::NativeRemesh, StepStatus::Done));
    let after = &repaired.report.after.unwrap().measures;
    assert!((after.volume.value - (2.0 - COMMON)).abs() < 0.01, "{}", after.volume.value);
    assert!(after.faces < 400, "flat faces come back as few: {}", after.faces);
    let lost = repaired.report.changes.unwrap().lost.unwrap();
    assert!(lost.percent.max < 0.5, "{lost:?}");
}
