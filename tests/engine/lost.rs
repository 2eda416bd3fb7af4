//! The percentage of visible surface that a result lost.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use glam::DVec3;
use meshmend::context::{Context, NoProgress};
use meshmend::inspect::{Analysis, CompareOptions, compare};
use meshmend::mesh::Soup;

use crate::meshes::{cube, join, sphere};

fn lost(input: &Soup, output: &Soup) -> f64 {
    lost_if_any(input, output).unwrap()
}

fn lost_if_any(input: &Soup, output: &Soup) -> Option<f64> {
    let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(1));
    let [input, output] = [input, output].map(|soup| Analysis::new(soup.into(), &context).unwrap());
    compare(&input, &output, CompareOptions::BRIEF, &context).unwrap().changes.surface_lost_pct
}

fn without(soup: &Soup, gone: impl Fn([DVec3; 3]) -> bool) -> Soup {
    let mut left = soup.clone();
    left.faces.retain(|face| !gone(face.map(|v| soup.positions[v as usize])));
    left
}

#[test]
fn a_missing_wall_is_lost_by_its_share_of_the_area() {
    let whole = cube(DVec3::ZERO, 1.0, 8);
    let open = without(&whole, |corners| corners.iter().all(|p| p.x == 1.0));
    let share = lost(&whole, &open);
    // Near the wall's rim, the adjacent sides are within the distance that counts as present.
    assert!((13.0..17.0).contains(&share), "{share}");
    assert_eq!(lost(&whole, &whole), 0.0);
}

#[test]
fn a_removed_part_is_lost_unless_it_was_invisible() {
    let outer = cube(DVec3::ZERO, 4.0, 4);
    let beside = join(&outer, &cube(DVec3::new(6.0, 0.0, 0.0), 4.0, 4));
    assert!((lost(&beside, &outer) - 50.0).abs() < 2.0);
    let inside = join(&outer, &sphere(DVec3::splat(2.0), 1.0, 12, 8));
    assert_eq!(lost(&inside, &outer), 0.0);
}

#[test]
fn a_result_moved_by_less_than_a_voxel_lost_nothing() {
    let mut moved = sphere(DVec3::ZERO, 1.0, 40, 20);
    let before = moved.clone();
    let diagonal = 2.0 * 3f64.sqrt();
    for p in &mut moved.positions {
        *p *= 1.0 + diagonal / 300.0;
    }
    assert_eq!(lost(&before, &moved), 0.0);
    assert!(lost(&before, &sphere(DVec3::ZERO, 0.9, 40, 20)) > 99.0);
}

#[test]
fn faces_that_are_not_finite_or_have_no_area_change_nothing() {
    let whole = cube(DVec3::ZERO, 1.0, 2);
    let mut dirty = whole.clone();
    let first = u32::try_from(dirty.positions.len()).unwrap();
    dirty.positions.push(DVec3::NAN);
    dirty.faces.extend([[0, 1, first], [2, 2, 3]]);
    assert_eq!(lost(&dirty, &whole), 0.0);
    let nothing = Soup { positions: vec![DVec3::ZERO], faces: vec![[0, 0, 0]] };
    assert_eq!(lost_if_any(&nothing, &whole), None);
}
