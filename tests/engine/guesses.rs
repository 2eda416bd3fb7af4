//! Assumptions of a repair: added surface is measured, reported and limited, and no solid becomes a shell.

use glam::DVec3;
use meshmend::inspect::{Analysis, CompareOptions, compare};
use meshmend::math::Precision;
use meshmend::mesh::{Soup, Surface};
use meshmend::repair::operators::thicken::{Skins, ThickenSheets};
use meshmend::repair::{Assumption, AssumptionKind, OpenSheets, Options, Outcome, RedFlagCode, Repaired};

use crate::meshes::{as_f32, cube, cylinder, join, push, sphere};
use crate::support::{assert_outcome, repair_soup, with_context};

fn run(soup: &Soup, options: &Options) -> Repaired {
    repair_soup(soup, options, None)
}

fn assumed(repaired: &Repaired, kind: AssumptionKind) -> Option<&Assumption> {
    repaired.report.assumptions.iter().find(|assumption| assumption.kind == kind)
}

fn flags(repaired: &Repaired) -> Vec<RedFlagCode> {
    repaired.report.red_flags.iter().map(|flag| flag.code).collect()
}

fn volume(repaired: &Repaired) -> f64 {
    repaired.report.after.as_ref().unwrap().measures.volume.value
}

/// The soup without the faces above a height.
fn cut_off(mut soup: Soup, height: f64) -> Soup {
    let low = |soup: &Soup, f: usize| soup.corners(f).iter().any(|p| p.z < height);
    let keep: Vec<bool> = (0..soup.faces.len()).map(|f| low(&soup, f)).collect();
    let mut keep = keep.into_iter();
    soup.faces.retain(|_| keep.next().unwrap());
    soup
}

/// A cube with sides of 2, and an open square with sides of 4 apart from it.
fn block_and_wall() -> Soup {
    let mut wall = Soup::default();
    let at = |y: f64, z: f64| DVec3::new(5.0, y, z);
    push(&mut wall, [at(0.0, 0.0), at(4.0, 0.0), at(4.0, 4.0)]);
    push(&mut wall, [at(0.0, 0.0), at(4.0, 4.0), at(0.0, 4.0)]);
    as_f32(join(&cube(DVec3::ZERO, 2.0, 2), &wall))
}

#[test]
fn a_hole_of_many_edges_is_closed_and_the_solid_stays_solid() {
    assert!(Options::default().max_hole_edges >= 1_000_000);
    let solid = as_f32(cylinder(DVec3::ZERO, 5.0, 20.0, 600));
    let cup = cut_off(solid, 20.0);
    let repaired = run(&cup, &Options::default());
    assert_eq!(repaired.report.outcome, Outcome::Repaired, "{}", repaired.report.summary);
    let full = std::f64::consts::PI * 25.0 * 20.0;
    assert!((volume(&repaired) / full - 1.0).abs() < 1e-3, "{} of {full}", volume(&repaired));
}

#[test]
fn a_solid_with_a_hole_left_open_on_request_does_not_become_a_shell() {
    let ball = cut_off(as_f32(sphere(DVec3::ZERO, 10.0, 48, 24)), 8.0);
    let options = Options { max_hole_size: 0.05, ..Options::default() };
    let repaired = run(&ball, &options);
    assert!(!repaired.report.outcome.is_printable(), "{}", repaired.report.summary);
    assert!(repaired.report.summary.contains("max_hole_size"), "{}", repaired.report.summary);
    let after = &repaired.report.after.as_ref().unwrap().measures;
    assert!(!after.closed, "{after:?}");
    assert!(assumed(&repaired, AssumptionKind::SheetsThickened).is_none());
}

#[test]
fn a_shell_of_a_solid_with_an_open_hole_is_made_on_request() {
    let ball = cut_off(as_f32(sphere(DVec3::ZERO, 10.0, 48, 24)), 8.0);
    let options =
        Options { max_hole_size: 0.05, open_sheets: OpenSheets::Thicken, thickness: Some(0.5), ..Options::default() };
    let repaired = run(&ball, &options);
    assert_outcome(&repaired, Outcome::Repaired);
    assert!((assumed(&repaired, AssumptionKind::SheetsThickened).unwrap().amount.unwrap() - 0.5).abs() < 1e-9);
}

#[test]
fn a_comparison_calls_a_shell_unfaithful_to_the_open_solid() {
    let ball = cut_off(as_f32(sphere(DVec3::ZERO, 10.0, 48, 24)), 9.0);
    let (mut shell, _) = Surface::from_soup(&ball);
    let thicken = ThickenSheets {
        thickness: Some(0.06),
        skins: Skins::Behind,
        spares_solids: false,
        max_deviation: f64::INFINITY,
        precision: Precision::F32,
    };
    with_context(|c| thicken.apply(&mut shell, c)).unwrap();
    let faithful = |after: &Soup| {
        with_context(|c| {
            let (before, after) = (Analysis::new((&ball).into(), c)?, Analysis::new(after.into(), c)?);
            compare(&before, &after, CompareOptions::default(), c)
        })
        .unwrap()
        .faithful
    };
    assert!(!faithful(&shell.to_soup()));
    assert!(faithful(&ball));
}

#[test]
fn thickening_spares_parts_that_are_almost_closed_and_thickens_sheets_beside_them() {
    let cup = cut_off(as_f32(cylinder(DVec3::new(20.0, 0.0, 0.0), 5.0, 20.0, 64)), 20.0);
    let mut wall = Soup::default();
    push(&mut wall, [DVec3::ZERO, DVec3::X, DVec3::Y]);
    let (mut surface, _) = Surface::from_soup(&join(&cup, &wall));
    let thicken = ThickenSheets {
        thickness: Some(0.1),
        skins: Skins::Behind,
        spares_solids: true,
        max_deviation: f64::INFINITY,
        precision: Precision::F32,
    };
    let applied = with_context(|c| thicken.apply(&mut surface, c)).unwrap();
    let count = |what: &str| {
        applied.changes.iter().find(|change| change.kind.as_str() == what).map_or(0, |change| change.count)
    };
    assert_eq!((count("sheets_thickened"), count("solids_left_open")), (1, 1));
}

#[test]
fn a_thickened_wall_that_is_much_of_the_result_is_reported_and_flagged() {
    let repaired = run(&block_and_wall(), &Options::default());
    assert_eq!(repaired.report.outcome, Outcome::PartiallyRepaired, "{}", repaired.report.summary);
    assert_eq!(flags(&repaired), [RedFlagCode::SurfaceInvented]);
    assert!(repaired.report.after.as_ref().unwrap().measures.printable());
    let assumption = assumed(&repaired, AssumptionKind::SheetsThickened).unwrap();
    let share = assumption.share_pct.unwrap();
    assert!(assumption.count == 1 && (25.0..35.0).contains(&share), "{assumption:?}");
    assert_eq!(assumption.option.as_deref(), Some("open_sheets=leave"));
    assert!(!assumption.places.is_empty());
    let flag = &repaired.report.red_flags[0];
    assert!((flag.value - share).abs() < 1e-6 && flag.threshold == 10.0, "{flag:?}");
}

#[test]
fn a_thickness_that_was_asked_for_is_an_assumption_and_no_flag() {
    for options in [
        Options { open_sheets: OpenSheets::Thicken, ..Options::default() },
        Options { max_surface_added_pct: 100.0, ..Options::default() },
    ] {
        let repaired = run(&block_and_wall(), &options);
        assert_outcome(&repaired, Outcome::Repaired);
        assert!(assumed(&repaired, AssumptionKind::SheetsThickened).is_some());
    }
}

#[test]
fn a_large_closed_hole_is_reported_with_its_place_and_a_small_one_is_not() {
    let without_lid = cut_off(as_f32(cube(DVec3::ZERO, 2.0, 4)), 2.0);
    let repaired = run(&without_lid, &Options::default());
    assert_eq!(
        (repaired.report.outcome, flags(&repaired)),
        (Outcome::PartiallyRepaired, vec![RedFlagCode::SurfaceInvented])
    );
    let assumption = assumed(&repaired, AssumptionKind::LargeHolesClosed).unwrap();
    assert!(assumption.count == 1 && (assumption.amount.unwrap() - 4.0).abs() < 1e-6, "{assumption:?}");
    assert!((assumption.share_pct.unwrap() - 100.0 / 6.0).abs() < 1e-3);
    assert!((assumption.places[0][2] - 2.0).abs() < 1e-6);
    // The option that the assumption names turns the assumption off.
    let (name, value) = assumption.option.as_deref().unwrap().split_once('=').unwrap();
    assert_eq!(name, "max_hole_size");
    let options = Options { max_hole_size: value.parse().unwrap(), ..Options::default() };
    assert!(!run(&without_lid, &options).report.outcome.is_printable());

    let mut small = as_f32(cube(DVec3::ZERO, 2.0, 10));
    small.faces.remove(0);
    let repaired = run(&small, &Options::default());
    assert_eq!(repaired.report.outcome, Outcome::Repaired);
    assert!(assumed(&repaired, AssumptionKind::LargeHolesClosed).is_none());
}

#[test]
fn an_assumed_unit_is_reported_and_a_declared_one_is_not() {
    let solid = as_f32(cube(DVec3::ZERO, 2.0, 2));
    assert!(assumed(&run(&solid, &Options::default()), AssumptionKind::Unit).is_some());
    let declared = Options { unit: Some(meshmend::scene::Unit::Inch), ..Options::default() };
    assert!(assumed(&run(&solid, &declared), AssumptionKind::Unit).is_none());
}

#[test]
fn a_narrow_face_that_stands_on_a_solid_gets_no_back_and_its_removal_is_reported() {
    let mut soup = cube(DVec3::ZERO, 2.0, 8);
    let [a, b, c] = soup.corners(0);
    let outward = (b - a).cross(c - a).normalize() * 0.02;
    push(&mut soup, [a, b, (a + b) / 2.0 + outward]);
    let repaired = run(&as_f32(soup), &Options::default());
    assert_outcome(&repaired, Outcome::Repaired);
    assert!((volume(&repaired) - 8.0).abs() < 1e-9, "{}", volume(&repaired));
    let assumption = assumed(&repaired, AssumptionKind::PiecesDropped).unwrap();
    assert_eq!((assumption.count, assumption.option.as_deref()), (1, Some("without=remove_debris")));
}
