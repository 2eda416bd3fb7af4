//! Print measures: volume, centre of mass, overhangs and what lies on the build plate.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use glam::DVec3;
use meshmend::context::{Context, NoProgress};
use meshmend::inspect::{InspectOptions, Level, NoWallReason, PrintMeasures, ThinPlace, inspect};
use meshmend::mesh::Soup;
use meshmend::scene::{Unit, UnitSource};

use crate::meshes::{cube, cuboid, inside_out, join, push, sheet, sphere};

fn with(soup: &Soup, options: &InspectOptions) -> Option<PrintMeasures> {
    let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(1));
    inspect(soup.into(), options, &context).unwrap().0.print
}

fn print(soup: &Soup) -> PrintMeasures {
    with(soup, &InspectOptions::default()).unwrap()
}

fn block(low: DVec3, size: DVec3) -> Soup {
    cuboid(low, size, 4)
}

fn mapped(soup: &Soup, map: impl Fn(DVec3) -> DVec3) -> Soup {
    Soup { positions: soup.positions.iter().map(|&p| map(p)).collect(), faces: soup.faces.clone() }
}

fn assert_close(found: f64, expected: f64, tolerance: f64) {
    assert!((found - expected).abs() <= tolerance, "{found} is not {expected}");
}

#[test]
fn a_plate_s_thinnest_wall_is_its_thickness_between_its_two_sides() {
    let plate = block(DVec3::ZERO, DVec3::new(10.0, 8.0, 0.25));
    let measures = print(&plate);
    let wall = measures.thinnest_wall.unwrap();
    assert_eq!(wall.places[0], ThinPlace { at: wall.at, thickness: wall.thickness });
    assert!(wall.places.len() <= 100 && wall.places.is_sorted_by(|a, b| a.thickness <= b.thickness));
    assert_close(wall.thickness, 0.25, 1e-9);
    assert_close(wall.median, 0.25, 1e-9);
    assert!(wall.samples > 200);
    let heights = wall.faces.map(|face| plate.corners(face as usize).map(|p| p.z));
    assert!(heights.contains(&[0.0; 3]) && heights.contains(&[0.25; 3]), "{heights:?}");
    assert_eq!(measures.volume.map(|v| (v * 1e9).round() / 1e9), Some(20.0));
    assert_eq!((measures.size, measures.solids), ([10.0, 8.0, 0.25], 1));
}

#[test]
fn edges_of_a_cube_are_not_thin_walls_and_a_ball_is_as_thick_as_its_diameter() {
    assert_close(print(&cube(DVec3::ZERO, 2.0, 4)).thinnest_wall.unwrap().thickness, 2.0, 1e-9);
    let ball = print(&sphere(DVec3::ZERO, 1.0, 48, 24)).thinnest_wall.unwrap();
    assert!((1.9..2.0).contains(&ball.thickness), "{ball:?}");
}

#[test]
fn a_cavity_is_not_a_solid_and_changes_wall_thickness_and_centre_of_mass() {
    let hole = block(DVec3::new(0.5, 1.0, 1.0), DVec3::new(2.0, 2.0, 2.0));
    let measures = print(&join(&block(DVec3::ZERO, DVec3::splat(4.0)), &inside_out(hole)));
    assert_eq!(measures.solids, 1);
    assert_close(measures.volume.unwrap(), 64.0 - 8.0, 1e-9);
    // The moments of the whole minus those of the hole.
    assert_close(measures.centre_of_mass.unwrap()[0], (64.0 * 2.0 - 8.0 * 1.5) / 56.0, 1e-9);
    assert_close(measures.centre_of_mass.unwrap()[1], 2.0, 1e-9);
    assert_close(measures.thinnest_wall.unwrap().thickness, 0.5, 1e-9);
}

#[test]
fn overlapping_parts_are_one_wall_and_turned_parts_have_the_same() {
    // Two plates that overlap by half of their thickness.
    let plates = join(
        &block(DVec3::ZERO, DVec3::new(8.0, 8.0, 1.0)),
        &block(DVec3::new(0.0, 0.0, 0.5), DVec3::new(8.0, 8.0, 1.0)),
    );
    assert_close(print(&plates).thinnest_wall.unwrap().thickness, 1.5, 1e-9);
    let turned = inside_out(block(DVec3::ZERO, DVec3::new(8.0, 8.0, 1.0)));
    assert_close(print(&turned).thinnest_wall.unwrap().thickness, 1.0, 1e-9);
    let two = join(&cube(DVec3::ZERO, 1.0, 2), &cube(DVec3::X * 3.0, 1.0, 2));
    assert_eq!(print(&two).solids, 2);
}

#[test]
fn an_open_sheet_has_no_wall_thickness_and_a_box_with_a_hole_has_one() {
    let measures = print(&sheet(12));
    assert_eq!((measures.thinnest_wall, measures.no_wall_reason), (None, Some(NoWallReason::OpenSurface)));
    assert_eq!((measures.volume, measures.centre_of_mass, measures.solids), (None, None, 0));
    let mut box_with_hole = cube(DVec3::ZERO, 3.0, 8);
    box_with_hole.faces.drain(70..72);
    assert_close(print(&box_with_hole).thinnest_wall.unwrap().thickness, 3.0, 1e-9);
}

/// A gallows seen from the side: a post from 0 to 1, an arm from 1 to 3 at height 2 to 3, one unit deep.
fn gallows() -> Soup {
    let mut soup = Soup::default();
    let outline = [[0.0, 0.0], [1.0, 0.0], [1.0, 2.0], [3.0, 2.0], [3.0, 3.0], [1.0, 3.0], [0.0, 3.0], [0.0, 2.0]];
    let at = |i: usize, y: f64| DVec3::new(outline[i % 8][0], y, outline[i % 8][1]);
    for i in 0..8 {
        push(&mut soup, [at(i, 0.0), at(i + 1, 0.0), at(i + 1, 1.0)]);
        push(&mut soup, [at(i, 0.0), at(i + 1, 1.0), at(i, 1.0)]);
    }
    for [i, j, k, l] in [[0, 1, 2, 7], [7, 2, 5, 6], [2, 3, 4, 5]] {
        for [a, b, c] in [[i, j, k], [i, k, l]] {
            push(&mut soup, [at(a, 0.0), at(c, 0.0), at(b, 0.0)]);
            push(&mut soup, [at(a, 1.0), at(b, 1.0), at(c, 1.0)]);
        }
    }
    inside_out(soup)
}

#[test]
fn a_neck_that_a_narrow_strip_of_large_faces_forms_is_the_thinnest_wall() {
    // Two blocks seen from the side, joined by a neck 0.07 thick and 0.001 wide, and a plate that is thicker.
    let outline =
        [[0.0, -5.0], [9.999, -5.0], [9.999, 0.93], [20.0, 0.93], [20.0, 5.0], [10.0, 5.0], [10.0, 1.0], [0.0, 1.0]];
    let at = |i: usize, y: f64| DVec3::new(outline[i % 8][0], y, outline[i % 8][1]);
    let mut soup = Soup::default();
    for i in 0..8 {
        push(&mut soup, [at(i, 0.0), at(i + 1, 0.0), at(i + 1, 10.0)]);
        push(&mut soup, [at(i, 0.0), at(i + 1, 10.0), at(i, 10.0)]);
    }
    for [a, b, c] in [[0, 1, 2], [0, 2, 7], [7, 2, 6], [6, 2, 3], [6, 3, 5], [5, 3, 4]] {
        push(&mut soup, [at(a, 0.0), at(c, 0.0), at(b, 0.0)]);
        push(&mut soup, [at(a, 10.0), at(b, 10.0), at(c, 10.0)]);
    }
    let plate = block(DVec3::new(5.0, 0.0, 20.0), DVec3::new(10.0, 10.0, 0.08));
    let measures = print(&join(&inside_out(soup), &plate));
    assert_close(measures.thinnest_wall.unwrap().thickness, 0.07, 1e-9);
}

fn area_beyond(measures: &PrintMeasures, degrees: f64) -> f64 {
    measures.overhang.areas.iter().find(|area| area.degrees == degrees).unwrap().area
}

#[test]
fn an_arm_hangs_over_by_its_underside_and_the_foot_does_not() {
    let soup = gallows();
    let measures = print(&soup);
    assert_close(measures.volume.unwrap(), 5.0, 1e-12);
    for degrees in [30.0, 45.0, 60.0] {
        assert_close(area_beyond(&measures, degrees), 2.0, 1e-12);
    }
    // Upside down, the top lies on the plate and nothing overhangs. Sideways, the post's inner side does not lie on the plate.
    let options = InspectOptions { up: [0.0, 0.0, -5.0], ..InspectOptions::default() };
    assert_close(area_beyond(&with(&soup, &options).unwrap(), 45.0), 0.0, 1e-12);
    let options = InspectOptions { up: [-1.0, 0.0, 0.0], ..InspectOptions::default() };
    assert_close(area_beyond(&with(&soup, &options).unwrap(), 45.0), 2.0, 1e-12);
}

#[test]
fn a_slope_hangs_over_by_more_than_the_limits_below_its_angle() {
    // A block sheared by 45 degrees: its bottom lies on the plate, and one side overhangs at 45 degrees.
    let sheared = mapped(&cube(DVec3::ZERO, 1.0, 2), |p| p + DVec3::X * p.z);
    let options = InspectOptions { overhang_deg: 40.0, ..InspectOptions::default() };
    let result = with(&sheared, &options).unwrap();
    let degrees: Vec<f64> = result.overhang.areas.iter().map(|area| area.degrees).collect();
    assert_eq!(degrees, [30.0, 40.0, 45.0, 60.0]);
    assert_close(area_beyond(&result, 40.0), 2f64.sqrt(), 1e-12);
    assert_close(area_beyond(&result, 45.0), 0.0, 1e-12);
}

#[test]
fn the_unit_is_declared_or_assumed_and_decides_what_fits() {
    let soup = block(DVec3::ONE, DVec3::new(4.0, 10.0, 2.0));
    let measures = print(&soup);
    assert_eq!((measures.unit, measures.unit_source, measures.fit), (Unit::Millimetre, UnitSource::Assumed, None));
    let fits = |unit, build_volume| {
        let options = InspectOptions { unit, build_volume: Some(build_volume), ..InspectOptions::default() };
        let measures = with(&soup, &options).unwrap();
        let fit = measures.fit.unwrap();
        (measures.unit_source, measures.size_mm[0].round(), fit.as_is, fit.rotated)
    };
    assert_eq!(fits(None, [4.0, 10.0, 2.0]), (UnitSource::Assumed, 4.0, true, true));
    assert_eq!(fits(Some(Unit::Inch), [100.0, 300.0, 300.0]), (UnitSource::Declared, 102.0, false, true));
    assert_eq!(fits(Some(Unit::Metre), [5000.0, 5000.0, 5000.0]), (UnitSource::Declared, 4000.0, false, false));
}

#[test]
fn scale_and_right_angles_change_print_measures_as_they_must() {
    let soup = join(&block(DVec3::ZERO, DVec3::new(4.0, 3.0, 0.5)), &gallows());
    let base = print(&soup);
    let thickness = |measures: &PrintMeasures| measures.thinnest_wall.as_ref().unwrap().thickness;
    for power in [-300, -2, 7, 300] {
        let size = 2f64.powi(power);
        let measures = print(&mapped(&soup, |p| p * size));
        assert_eq!((thickness(&measures), measures.solids), (thickness(&base) * size, base.solids), "2^{power}");
        assert_eq!(measures.overhang.areas[0].percent, base.overhang.areas[0].percent);
    }
    let options = InspectOptions { up: [1.0, 0.0, 0.0], ..InspectOptions::default() };
    let turned = with(&mapped(&soup, |p| DVec3::new(p.z, p.x, p.y)), &options).unwrap();
    assert_close(area_beyond(&turned, 45.0), area_beyond(&base, 45.0), 1e-12);
    assert_close(thickness(&turned), thickness(&base), 1e-9);
}

#[test]
fn no_input_is_too_broken_and_level_none_measures_nothing_for_print() {
    let options = InspectOptions { level: Level::None, ..InspectOptions::default() };
    assert_eq!(with(&cube(DVec3::ZERO, 1.0, 1), &options), None);
    assert_eq!(with(&Soup::default(), &InspectOptions::default()), None);
    let mut flat = Soup::default();
    push(&mut flat, [DVec3::ZERO, DVec3::X, DVec3::X * 2.0]);
    assert_eq!(print(&flat).no_wall_reason, Some(NoWallReason::NoSurface));
    let mut broken = cube(DVec3::ZERO, 1.0, 1);
    push(&mut broken, [DVec3::NAN, DVec3::X, DVec3::Y]);
    assert_close(print(&broken).thinnest_wall.unwrap().thickness, 1.0, 1e-9);
    for size in [1e300, 1e-300, 8e307] {
        let measures = print(&sphere(DVec3::ZERO, size, 12, 8));
        let text = serde_json::to_string(&measures).unwrap();
        assert_eq!(serde_json::from_str::<PrintMeasures>(&text).unwrap(), measures, "{size}");
        assert!(measures.thinnest_wall.unwrap().thickness / size > 1.5);
    }
    let options = InspectOptions { up: [0.0, f64::NAN, 0.0], overhang_deg: f64::NAN, ..InspectOptions::default() };
    assert_eq!(with(&cube(DVec3::ZERO, 1.0, 1), &options).unwrap().overhang.up, [0.0, 0.0, 1.0]);
}

#[test]
fn units_are_written_as_symbols_and_also_read_as_names() {
    assert_eq!(serde_json::to_string(&Unit::Millimetre).unwrap(), "\"mm\"");
    for (said, unit) in [("\"in\"", Unit::Inch), ("\"inch\"", Unit::Inch), ("\"millimetre\"", Unit::Millimetre)] {
        assert_eq!(serde_json::from_str::<Unit>(said).unwrap(), unit);
    }
}
