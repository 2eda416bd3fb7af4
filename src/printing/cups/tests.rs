//! Tests of cups, which hold resin in a given orientation.

use super::*;
use crate::math::r3;
use crate::printing::shapes::*;

fn cups(surface: &Surface, up: DVec3) -> Vec<Cup> {
    let mut found = Vec::new();
    quietly(|context| {
        let regions = Regions::of_closed(surface, context);
        found = resin_cups(surface, &regions, up, context).unwrap();
    });
    found
}

/// A hemispherical bowl that opens upward, and the volume of its hollow.
fn bowl() -> (Surface, f64) {
    let arc = |r: f64, i: u32| {
        let angle = std::f64::consts::FRAC_PI_2 * f64::from(i) / 16.0;
        [r * angle.sin(), -r * angle.cos()]
    };
    let mut profile: Vec<[f64; 2]> = (0..=16).map(|i| if i == 16 { [12.0, 0.0] } else { arc(12.0, i) }).collect();
    let inner: Vec<[f64; 2]> = (0..=16).rev().map(|i| if i == 16 { [10.0, 0.0] } else { arc(10.0, i) }).collect();
    profile.extend(&inner);
    let mut hollow = inner;
    hollow.reverse();
    hollow.push([0.0, 0.0]);
    (revolved(&profile, 48), volume(&revolved(&hollow, 48)))
}

#[test]
fn a_bowl_is_a_cup_only_if_it_opens_upward() {
    let (bowl, hollow) = bowl();
    assert!(volume(&bowl) > 0.0 && hollow > 0.0);
    let up = cups(&bowl, DVec3::Z);
    assert_eq!(up.len(), 1, "{up:?}");
    assert!((up[0].volume / hollow - 1.0).abs() < 1e-12);
    assert!((hollow / (2.0 / 3.0 * std::f64::consts::PI * 1000.0) - 1.0).abs() < 0.02);
    assert_eq!([up[0].bottom_height, up[0].opening_height], [-10.0, 0.0]);
    let mouth = 24.0 * (std::f64::consts::TAU / 48.0).sin() * 100.0;
    assert!((up[0].opening_area / mouth - 1.0).abs() < 1e-9, "{} {mouth}", up[0].opening_area);
    assert_eq!(up[0].at, DVec3::new(0.0, 0.0, -10.0));
    assert!(cups(&bowl, -DVec3::Z).is_empty());
    // On its side a bowl holds nothing: every cross-section is open to the right.
    assert!(cups(&bowl, DVec3::X).is_empty());
    for seed in 0..5u32 {
        let turned = turned(&bowl, f64::from(seed), DVec3::new(5.0, -3.0, 40.0));
        let direction = turned.positions[0] - DVec3::new(5.0, -3.0, 40.0);
        let found = cups(&turned, -direction);
        assert_eq!(found.len(), 1);
        assert!((found[0].volume / hollow - 1.0).abs() < 1e-9);
    }
}

/// A block of voxels without those of the given boxes, `[low, high)` in voxels.
fn block(size: [usize; 3], holes: &[[[usize; 3]; 2]]) -> Voxels {
    let mut voxels = Voxels::filled(size);
    for [low, high] in holes {
        for i in low[0]..high[0] {
            for j in low[1]..high[1] {
                for k in low[2]..high[2] {
                    voxels.set([i, j, k], false);
                }
            }
        }
    }
    voxels
}

#[test]
fn a_u_tube_is_a_cup_up_to_its_lower_mouth() {
    // Two shafts, 5 and 8 deep, joined at the bottom; the left mouth is lower, at height 6.
    let tube = block(
        [7, 3, 9],
        &[[[1, 1, 1], [2, 2, 9]], [[5, 1, 1], [6, 2, 9]], [[2, 1, 1], [5, 2, 2]], [[0, 0, 6], [3, 3, 9]]],
    );
    let found = cups(&tube.surface(), DVec3::Z);
    assert_eq!(found.len(), 1, "{found:?}");
    assert!((found[0].volume - 13.0).abs() < 1e-12, "two shafts of 5 and 3 between them: {found:?}");
    assert_eq!(found[0].opening_height, 6.0);
    assert!((found[0].opening_area - 2.0).abs() < 1e-12);
    // Upside down it is a siphon and holds nothing.
    assert!(cups(&tube.surface(), -DVec3::Z).is_empty());
}

#[test]
fn a_floating_ball_in_a_bowl_takes_its_volume_from_the_cup() {
    let (bowl, hollow) = bowl();
    let ball = turned(&sphere(2.0, 2), 3.0, DVec3::new(0.5, 0.2, -5.0));
    let found = cups(&joined(&[bowl.clone(), ball.clone()]), DVec3::Z);
    assert_eq!(found.len(), 1);
    assert!((found[0].volume - (hollow - volume(&ball))).abs() < 1e-9);
    let above = turned(&sphere(2.0, 2), 3.0, DVec3::new(0.5, 0.2, 5.0));
    let found = cups(&joined(&[bowl, above]), DVec3::Z);
    assert!(found.len() == 1 && (found[0].volume - hollow).abs() < 1e-9);
}

#[test]
fn a_sealed_void_is_no_cup() {
    let hollow = joined(&[sphere(5.0, 2), inverted(sphere(4.0, 2))]);
    assert!(cups(&hollow, DVec3::Z).is_empty());
}

/// The cups of voxels by brute force: for each layer the parts of the air below it that the next layer opens.
fn voxel_cups(voxels: &Voxels) -> Vec<(f64, usize)> {
    let mut all = Vec::new();
    for top in 1..=voxels.size[2] {
        let before = voxels.air_parts_below(top);
        let after = voxels.air_parts_below(top + 1);
        let mut sealed: Vec<(usize, usize)> = Vec::new();
        for (part, cells) in &before.cells {
            if *part != before.outside && after.part_of(cells[0]) == after.outside {
                sealed.push((cells.len(), top));
            }
        }
        all.extend(sealed.into_iter().map(|(count, top)| (count as f64, top)));
    }
    all.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    all
}

#[test]
fn cups_of_random_voxels_agree_with_a_layer_by_layer_flood() {
    let (mut compared, mut with) = (0, 0);
    for seed in 0..100u32 {
        let mut voxels = Voxels::empty([6, 5, 6]);
        let share = 0.55 + 0.01 * f64::from(seed % 35);
        for i in 0..180u32 {
            let x = (r3(f64::from(i) * 1.37 + f64::from(seed) * 1931.7)[0] * 4096.0).fract();
            let cell = [i as usize % 6, i as usize / 6 % 5, i as usize / 30];
            voxels.set(cell, x < share);
        }
        let expected = voxel_cups(&voxels);
        let found = cups(&voxels.surface(), DVec3::Z);
        let rounded: Vec<(f64, usize)> =
            found.iter().map(|cup| ((cup.volume * 1e9).round() / 1e9, cup.opening_height.round() as usize)).collect();
        assert_eq!(rounded, expected, "seed {seed}");
        compared += 1;
        with += expected.len();
    }
    assert!(compared == 100 && with > 40, "{with}");
}
