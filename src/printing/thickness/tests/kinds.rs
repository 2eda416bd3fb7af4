//! The kinds of known features.

use super::shapes::*;
use super::*;

/// The kinds of a surface's features, without sharp edges.
fn kinds(surface: &Surface, below: f64, side: Space) -> Vec<FeatureKind> {
    let found = with_context(|context| thin_features(surface, below, side, context)).unwrap();
    for region in &found.regions {
        assert!(region.is_decided && region.least < below && region.mean >= region.least, "{region:?}");
        assert!(region.faces.windows(2).all(|w| w[0] < w[1]));
    }
    found.regions.iter().map(|region| region.kind).collect()
}

/// The kind is the same for a shape that is turned, scaled, and has its faces split.
fn assert_kinds(surface: &Surface, below: f64, side: Space, expected: &[FeatureKind]) {
    let mut random = Random(3);
    assert_eq!(kinds(surface, below, side), expected, "as built");
    for _ in 0..3 {
        let other = split(turned(surface.clone(), &mut random), 40, &mut random);
        let mut found = kinds(&scaled(other, 8.0), below * 8.0, side);
        found.sort_unstable();
        let mut expected = expected.to_vec();
        expected.sort_unstable();
        assert_eq!(found, expected, "turned and split");
    }
}

use FeatureKind::*;
use Space::{Air, Material};

#[test]
fn a_plate_is_a_free_wall() {
    assert_kinds(&cuboid([20.0, 30.0, 0.5]), 1.0, Material, &[FreeWall]);
}

#[test]
fn the_floor_of_a_box_is_a_supported_wall() {
    let grid = [0.0, 3.0, 17.0, 20.0];
    let tray = blocks(&grid, &grid, &[0.0, 0.6, 8.0], |i, j, k| k == 0 || i != 1 || j != 1);
    assert_kinds(&tray, 1.0, Material, &[SupportedWall]);
}

#[test]
fn a_fin_on_a_block_is_a_free_wall() {
    let fin = blocks(&[0.0, 5.0, 5.5, 10.0], &[0.0, 12.0], &[0.0, 4.0, 12.0], |i, _, k| k == 0 || i == 1);
    assert_kinds(&fin, 1.0, Material, &[FreeWall]);
    let low = blocks(&[0.0, 5.0, 5.5, 10.0], &[0.0, 60.0], &[0.0, 4.0, 7.0], |i, _, k| k == 0 || i == 1);
    assert_kinds(&low, 1.0, Material, &[FreeWall]);
}

#[test]
fn a_rib_between_two_blocks_is_a_supported_wall() {
    let rib = blocks(&[0.0, 5.0, 5.5, 10.0], &[0.0, 4.0, 16.0, 20.0], &[0.0, 8.0], |i, j, _| j != 1 || i == 1);
    assert_kinds(&rib, 1.0, Material, &[SupportedWall]);
}

#[test]
fn a_pin_is_held_once_and_a_wire_twice() {
    let grid = [0.0, 3.0, 3.6, 7.0];
    let post = blocks(&grid, &grid, &[0.0, 3.0, 9.0], |i, j, k| k == 0 || (i == 1 && j == 1));
    assert_kinds(&post, 1.0, Material, &[Pin]);
    let bar = blocks(&grid, &grid, &[0.0, 3.0, 9.0, 12.0], |i, j, k| k != 1 || (i == 1 && j == 1));
    assert_kinds(&bar, 1.0, Material, &[Wire]);
    for n in [8, 16, 24] {
        let round = revolved(&[[0.0, 0.0], [5.0, 0.0], [5.0, 3.0], [0.3, 3.0], [0.3, 9.0], [0.0, 9.0]], n);
        assert_kinds(&round, 1.0, Material, &[Pin]);
        assert_kinds(&prism(n, 0.4, 12.0), 1.0, Material, &[Pin]);
    }
}

#[test]
fn a_thin_ring_is_a_wire() {
    assert_kinds(&torus(6.0, 0.4, 48, 12), 1.0, Material, &[Wire]);
    assert_kinds(&torus(2.0, 0.4, 32, 16), 1.0, Material, &[Wire]);
}

#[test]
fn the_wall_of_a_tube_is_supported() {
    let tube = revolved(&[[4.4, 0.0], [5.0, 0.0], [5.0, 20.0], [4.4, 20.0]], 48);
    assert_kinds(&tube, 1.0, Material, &[SupportedWall]);
}

#[test]
fn slots_holes_and_clearances_are_told_apart() {
    let comb = blocks(&[0.0, 3.0, 3.4, 6.0], &[0.0, 9.0], &[0.0, 2.0, 8.0], |i, _, k| k == 0 || i != 1);
    assert_kinds(&comb, 1.0, Air, &[Slot]);
    let grid = [0.0, 3.0, 3.6, 7.0];
    let hole = blocks(&grid, &grid, &[0.0, 5.0], |i, j, _| i != 1 || j != 1);
    assert_kinds(&hole, 1.0, Air, &[ThroughHole]);
    let pocket = blocks(&grid, &grid, &[0.0, 3.0, 8.0], |i, j, k| k == 0 || i != 1 || j != 1);
    assert_kinds(&pocket, 1.0, Air, &[BlindHole]);
    let bore = revolved(&[[0.4, 0.0], [5.0, 0.0], [5.0, 6.0], [0.4, 6.0]], 24);
    assert_kinds(&bore, 1.0, Air, &[ThroughHole]);
    let plates = joined(cuboid([9.0, 9.0, 2.0]), &moved(cuboid([9.0, 9.0, 2.0]), DVec3::Z * 2.25));
    assert_kinds(&plates, 1.0, Air, &[Clearance]);
}

#[test]
fn the_area_and_mean_of_a_plate_are_those_of_its_two_sides() {
    let found = with_context(|c| thin_features(&cuboid([20.0, 30.0, 0.5]), 1.0, Material, c)).unwrap();
    let region = &found.regions[0];
    assert!((region.area / 1200.0 - 1.0).abs() < 1e-9 && (region.mean - 0.5).abs() < 1e-9, "{region:?}");
}

#[test]
fn a_blade_is_a_sharp_edge() {
    let cone = revolved(&[[0.0, 0.0], [2.0, 0.0], [0.0, 12.0]], 32);
    assert_kinds(&cone, 1.0, Material, &[SharpEdge]);
}
