//! `CleanAndPatch` removes faces around defects and closes the holes, and changes nothing else.

use std::collections::HashSet;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use glam::DVec3;
use meshmend::format::{Format, Limits, write};
use meshmend::mesh::{Soup, Surface};
use meshmend::repair::operators::Applied;
use meshmend::repair::operators::clean_and_patch::CleanAndPatch;
use meshmend::repair::{Action, Cancelled, Context, NoProgress, Options, Outcome, repair};

use crate::damage::Random;
use crate::meshes::{as_f32, cube, join, sheet, sphere, torus};
use crate::support::{change_count, measured_as_stl, with_context};

fn surface(soup: &Soup) -> Surface {
    Surface::from_soup(&as_f32(soup.clone())).0
}

fn cleaned(before: &Surface, clean: CleanAndPatch) -> (Surface, Applied) {
    let mut after = before.clone();
    let applied = with_context(|c| clean.apply(&mut after, c)).unwrap();
    (after, applied)
}

/// Moves the vertices near `at` by up to `by` along each axis.
fn crumple(surface: &mut Surface, at: DVec3, radius: f64, by: f64, seed: u64) {
    let mut random = Random::new(seed);
    for p in surface.positions.iter_mut().filter(|p| p.distance(at) < radius) {
        *p = (*p + random.vector() * by).as_vec3().as_dvec3();
    }
}

fn ball() -> Surface {
    surface(&sphere(DVec3::ZERO, 1.0, 48, 24))
}

fn pairs(surface: &Surface) -> u64 {
    measured_as_stl(surface).self_intersections.pairs.unwrap()
}

/// The faces as bits of their corner positions.
fn faces(surface: &Surface) -> HashSet<[[u64; 3]; 3]> {
    (0..surface.faces.len()).map(|f| surface.corners(f).map(|p| p.to_array().map(f64::to_bits))).collect()
}

#[test]
fn a_crumpled_place_becomes_solid_and_what_is_around_it_stays_as_it_is() {
    let mut before = ball();
    let whole = measured_as_stl(&before);
    crumple(&mut before, DVec3::X, 0.3, 0.2, 1);
    assert!(pairs(&before) > 10, "{}", pairs(&before));
    let (after, applied) = cleaned(&before, CleanAndPatch::default());
    let found = measured_as_stl(&after);
    assert!(found.closed && found.manifold && found.consistent, "{found:?}");
    assert!(found.self_intersections.proven_none(), "{applied:?}");
    assert!(
        (found.volume.value / whole.volume.value - 1.0).abs() < 0.02,
        "{} {}",
        found.volume.value,
        whole.volume.value
    );
    let now = faces(&after);
    for f in 0..before.faces.len() {
        let corners = before.corners(f);
        if corners.iter().all(|p| p.distance(DVec3::X) > 0.75) {
            assert!(now.contains(&corners.map(|p| p.to_array().map(f64::to_bits))), "face {f} is gone");
        }
    }
    assert!(change_count(&applied.changes, "regions_patched") > 0 && applied.moved > 0.0 && applied.moved < 0.5);
}

#[test]
fn a_place_whose_patch_strays_too_far_is_put_back_and_the_other_is_patched() {
    let mut before = ball();
    crumple(&mut before, DVec3::X, 0.3, 0.12, 1);
    crumple(&mut before, -DVec3::X, 0.3, 0.12, 5);
    // A spike through the second crumpled place, so deep that any patch would deviate too far.
    let tip = before.positions.iter().position(|p| p.distance(-DVec3::X) < 0.1).unwrap();
    before.positions[tip] = DVec3::new(-1.5, 0.0, 0.0);
    let (after, applied) = cleaned(&before, CleanAndPatch { max_deviation: 0.25, ..CleanAndPatch::default() });
    let near = |surface: &Surface, at: DVec3| -> HashSet<_> {
        let near = |f: &usize| surface.corners(*f).iter().all(|p| p.distance(at) < 0.9);
        (0..surface.faces.len())
            .filter(near)
            .map(|f| surface.corners(f).map(|p| p.to_array().map(f64::to_bits)))
            .collect()
    };
    let spike = |surface: &Surface| surface.positions.contains(&DVec3::new(-1.5, 0.0, 0.0));
    assert!(spike(&after), "the spike is still there");
    assert_ne!(near(&before, DVec3::X), near(&after, DVec3::X));
    let found = measured_as_stl(&after);
    assert!(found.closed && found.manifold && pairs(&after) < pairs(&before), "{applied:?}");
}

#[test]
fn if_no_hole_can_be_closed_everything_is_restored() {
    let mut before = ball();
    crumple(&mut before, DVec3::X, 0.3, 0.12, 1);
    let (after, applied) = cleaned(&before, CleanAndPatch { max_hole_edges: 3, ..CleanAndPatch::default() });
    assert_eq!(after, before);
    assert!(applied.changes.is_empty() && applied.left.unwrap().contains("were restored"));
}

#[test]
fn no_more_is_removed_than_the_limits_allow() {
    let mut before = ball();
    crumple(&mut before, DVec3::X, 0.3, 0.12, 1);
    for clean in [
        CleanAndPatch { max_region_pct: 0.1, ..CleanAndPatch::default() },
        CleanAndPatch { max_face_loss_pct: 0.1, ..CleanAndPatch::default() },
        CleanAndPatch { max_deviation: 0.0, ..CleanAndPatch::default() },
    ] {
        let (after, applied) = cleaned(&before, clean);
        assert_eq!(after, before, "{clean:?}");
        assert!(applied.left.is_some(), "{clean:?}");
    }
    // A part whose faces are all bad is never removed.
    let mut small = surface(&join(&sphere(DVec3::ZERO, 1.0, 48, 24), &sphere(DVec3::X * 4.0, 0.2, 6, 4)));
    crumple(&mut small, DVec3::X * 4.0, 0.5, 0.4, 3);
    let (after, _) = cleaned(&small, CleanAndPatch { max_face_loss_pct: 100.0, ..CleanAndPatch::default() });
    assert_eq!(measured_as_stl(&after).parts, 2);
}

#[test]
fn a_surface_without_defects_and_an_open_sheet_are_left_as_they_are() {
    for soup in [torus(3.0, 1.0, 24, 12), cube(DVec3::ZERO, 1.0, 2), sheet(12)] {
        let before = surface(&soup);
        let (after, applied) = cleaned(&before, CleanAndPatch::default());
        assert_eq!((after, applied.changes.len()), (before, 0));
    }
}

#[test]
fn parts_that_overlap_are_left_to_be_united() {
    let before = surface(&join(&cube(DVec3::ZERO, 1.0, 4), &cube(DVec3::splat(0.6), 1.0, 4)));
    assert!(pairs(&before) > 0);
    assert_eq!(cleaned(&before, CleanAndPatch::default()).0, before);
}

#[test]
fn a_cancelled_run_leaves_the_surface_as_it_was() {
    let mut before = ball();
    crumple(&mut before, DVec3::X, 0.3, 0.12, 1);
    let (cancel, clock) = (AtomicBool::new(true), || Duration::ZERO);
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(1));
    let mut after = before.clone();
    assert_eq!(CleanAndPatch::default().apply(&mut after, &context), Err(Cancelled));
    assert_eq!(after, before);
}

#[test]
fn auto_plans_clean_and_patch_after_the_other_strategies() {
    let mut broken = ball();
    crumple(&mut broken, DVec3::X, 0.3, 0.12, 1);
    let bytes = write(&broken.to_soup(), Format::Stl).unwrap();
    let options = Options { max_tier: 2, pictures: false, voxel_resolution: 50, ..Options::default() };
    let report = with_context(|c| repair(&bytes, &options, &Limits::default(), None, c)).unwrap().report;
    let has =
        |strategy: &meshmend::repair::Strategy| strategy.actions.iter().any(|a| a.action == Action::CleanAndPatch);
    assert_eq!(report.plan.strategies.iter().position(has), Some(4));
    assert_eq!(report.plan.strategies.iter().filter(|strategy| has(strategy)).count(), 1);
    assert_eq!(report.outcome, Outcome::Repaired, "{}", report.summary);
}
