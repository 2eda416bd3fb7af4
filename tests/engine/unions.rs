//! Unions of solids through the whole pipeline: in general and in degenerate position, as soups in any order, turned at
//! random and with holes. What comes back is printable and fills the same space.

use glam::{DMat3, DVec3};
use meshmend::arrange::WindingRule;
use meshmend::format::{Format, Limits, read, write};
use meshmend::inspect::measure;
use meshmend::mesh::{Soup, Surface};
use meshmend::repair::Outcome;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

use crate::arrange::arranged;
use crate::arrange::oracle::ManifoldRust;
use crate::damage::Random;
use crate::damaged::mend;
use crate::meshes::{as_f32, cube, cylinder, join, sphere, torus};
use crate::operators::with_context;

/// The space that a surface winds around outward, by another engine than ours.
fn filled(soup: &Soup) -> f64 {
    let (surface, _) = Surface::from_soup(soup);
    let solid = arranged(&ManifoldRust, &surface, WindingRule::Positive.into()).unwrap();
    with_context(|c| measure(&solid.surface.to_soup(), c)).unwrap().volume.value
}

/// What is done to the faces.
#[derive(Debug, Clone, Copy)]
struct Harm {
    /// They stand in another order.
    shuffled: bool,
    /// Half of them are turned.
    turned: bool,
    /// So many go, no two with a vertex in common.
    holes: usize,
}

/// A soup of solids with some harm done to it; and by how much that may change the volume.
fn harmed(solids: &[Soup], harm: Harm, random: &mut Random) -> (Soup, f64) {
    let mut soup = as_f32(solids.iter().fold(Soup::default(), |all, it| join(&all, it)));
    let mut slack = 0.0;
    let mut around: Vec<DVec3> = Vec::new();
    for _ in 0..harm.holes {
        let f = random.below(soup.faces.len());
        let [a, b, c] = soup.corners(f);
        if [a, b, c].iter().any(|p| around.contains(p)) {
            continue;
        }
        around.extend([a, b, c]);
        slack += (b - a).cross(c - a).length() / 2.0 * a.distance(b).max(b.distance(c)).max(c.distance(a));
        soup.faces.remove(f);
    }
    for f in (1..soup.faces.len()).rev() {
        if harm.shuffled {
            soup.faces.swap(f, random.below(f + 1));
            soup.faces[f].rotate_left(random.below(3));
        }
        if harm.turned && random.below(2) == 0 {
            soup.faces[f].swap(0, 1);
        }
    }
    (soup, slack)
}

/// Says what is wrong with what the pipeline makes of them, if anything.
fn verdict(solids: &[Soup], harm: Harm, seed: u64) -> Result<(), String> {
    let volume = filled(&as_f32(solids.iter().fold(Soup::default(), |all, it| join(&all, it))));
    let (soup, slack) = harmed(solids, harm, &mut Random::new(seed));
    let it = mend(&write(&soup, Format::Stl).unwrap());
    let result = read(&it.bytes, &Limits::default()).unwrap().soup;
    let after = with_context(|c| measure(&result, c)).unwrap();
    // Walls within that are seen through a hole are surface of the model, so what overlaps there may be kept.
    let closed = after.closed && after.manifold && after.consistent && harm.holes > 0;
    if !after.printable() && !closed {
        return Err(format!("{}; {}", after.in_short(), it.report.summary));
    }
    let is = filled(&result);
    let most = slack + 1e-3 * volume;
    if (is - volume).abs() > most {
        Err(format!("volume {is} instead of {volume}, more than {most} off"))
    } else {
        Ok(())
    }
}

fn moved(mut soup: Soup, by: DVec3) -> Soup {
    soup.positions.iter_mut().for_each(|p| *p += by);
    soup
}

fn turned(mut soup: Soup, turn: DMat3) -> Soup {
    soup.positions.iter_mut().for_each(|p| *p = turn * *p);
    soup
}

/// Boxes, cylinders, tori and balls anywhere.
fn in_general_position(random: &mut Random, count: usize) -> Vec<Soup> {
    let one = |random: &mut Random| {
        let it = match random.below(4) {
            0 => cube(DVec3::splat(-0.5), 1.0, 2),
            1 => cylinder(DVec3::new(0.0, 0.0, -0.6), 0.5, 1.2, 14),
            2 => torus(0.6, 0.25, 16, 10),
            _ => sphere(DVec3::ZERO, 0.7, 14, 8),
        };
        let axis = (random.vector() + DVec3::splat(0.01)).normalize();
        let turn = DMat3::from_axis_angle(axis, random.vector().x * 3.0);
        moved(turned(it, turn), random.vector() * 0.8)
    };
    (0..count).map(|_| one(random)).collect()
}

/// The same with whole numbers: coplanar, with edges and vertices in common, nested and tangent.
fn in_degenerate_position(random: &mut Random, count: usize) -> Vec<Soup> {
    let one = |random: &mut Random| {
        let low = DVec3::from_array([0, 1, 2].map(|_| random.below(4) as f64));
        match random.below(4) {
            0 => cube(low, 1.0 + random.below(3) as f64, 1 + random.below(3) as u32),
            1 => cylinder(low, 1.0, 1.0 + random.below(2) as f64, 12),
            2 => moved(torus(2.0, 1.0, 16, 8), low),
            _ => sphere(low, 1.0, 12, 6),
        }
    };
    (0..count).map(|_| one(random)).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 8, failure_persistence: None, rng_seed: RngSeed::Fixed(1), ..ProptestConfig::default() })]

    #[test]
    fn solids_in_general_position_are_united(count in 2..6usize, shuffled: bool, turned: bool, seed: u64) {
        let solids = in_general_position(&mut Random::new(seed), count);
        prop_assert_eq!(verdict(&solids, Harm { shuffled, turned, holes: 0 }, seed), Ok(()), "{}", seed);
    }

    #[test]
    fn solids_in_degenerate_position_are_united(count in 2..6usize, shuffled: bool, seed: u64) {
        let solids = in_degenerate_position(&mut Random::new(seed), count);
        prop_assert_eq!(verdict(&solids, Harm { shuffled, turned: false, holes: 0 }, seed), Ok(()), "{}", seed);
    }

    // Of more solids with faces in common, turned at random, one may be taken for the wall of another.
    #[test]
    fn a_few_solids_in_degenerate_position_are_united_though_half_of_their_faces_are_turned(count in 2..4usize, seed: u64) {
        let solids = in_degenerate_position(&mut Random::new(seed), count);
        prop_assert_eq!(verdict(&solids, Harm { shuffled: true, turned: true, holes: 0 }, seed), Ok(()), "{}", seed);
    }

    #[test]
    fn solids_with_holes_are_closed_and_fill_the_same_space(count in 2..5usize, turned: bool, seed: u64) {
        let solids = in_general_position(&mut Random::new(seed), count);
        prop_assert_eq!(verdict(&solids, Harm { shuffled: true, turned, holes: 3 }, seed), Ok(()), "{}", seed);
    }
}

#[test]
fn solids_that_lie_in_others_but_for_common_edges_are_not_turned_inside_out() {
    let solids = in_degenerate_position(&mut Random::new(11), 5);
    assert_eq!(verdict(&solids, Harm { shuffled: false, turned: false, holes: 0 }, 11), Ok(()));
}

#[test]
fn solids_nearly_at_one_place_are_united_though_half_of_their_faces_go() {
    let soup = as_f32(join(&sphere(DVec3::ZERO, 1.0, 120, 60), &sphere(DVec3::new(0.13, 0.09, 0.05), 1.0, 120, 60)));
    let report = mend(&write(&soup, Format::Stl).unwrap()).report;
    assert_eq!((report.outcome, report.candidates.len()), (Outcome::Repaired, 1), "{:?}", report.red_flags);
    let changes = report.changes.unwrap();
    assert!(changes.face_loss_pct > 40.0 && changes.enclosed_faces_pct > Some(70.0), "{changes:?}");
}

#[test]
fn new_vertices_beside_zero_stand_no_nearer_to_one_another_than_the_model_is_worth() {
    let known = |soup: &Soup, p: DVec3| soup.positions.contains(&p);
    let mut new = 0;
    for (n, angle) in [(5, 0.5), (9, 1.7), (12, 2.9)] {
        // Turned and back again, so that what should be zero is some 1e-17.
        let noise = DMat3::from_rotation_x(-1.0 - angle) * DMat3::from_rotation_x(1.0) * DMat3::from_rotation_x(angle);
        let solids = [
            cylinder(DVec3::new(0.5, 0.0, 0.0), 1.0, 0.75, n),
            cylinder(DVec3::new(0.0, 0.5, 0.0), 1.25, 0.5, n + 3),
            cylinder(DVec3::new(-0.25, -0.5, -0.25), 0.75, 1.0, 7),
        ];
        let soup = as_f32(turned(solids.iter().fold(Soup::default(), |all, it| join(&all, it)), noise));
        let it = mend(&write(&soup, Format::Stl).unwrap());
        assert_eq!(it.report.outcome, Outcome::Repaired, "{}", it.report.summary);
        let made = read(&it.bytes, &Limits::default()).unwrap().soup;
        for &p in made.positions.iter().filter(|&&p| !known(&soup, p)) {
            new += 1;
            let finest = p.abs().to_array().into_iter().filter(|&x| x > 0.0).fold(f64::INFINITY, f64::min);
            assert!(finest > 1e-14, "{p:?}");
        }
    }
    assert!(new > 100, "{new} new vertices");
}
