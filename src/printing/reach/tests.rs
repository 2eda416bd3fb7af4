//! Tests of what a ball reaches from outside.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use super::*;
use crate::context::NoProgress;

/// A box from -5 to 5 as one skin, with a square hole of width `hole` in the middle of its top.
fn box_with_hole(hole: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let (a, h) = (5.0, hole / 2.0);
    let square = |r: f64, z: f64| [[-r, -r], [r, -r], [r, r], [-r, r]].map(|[x, y]| DVec3::new(x, y, z));
    let positions = [square(a, -a), square(a, a), square(h, a)].concat();
    let mut faces = vec![[0, 2, 1], [0, 3, 2]];
    for i in 0..4 {
        let j = (i + 1) % 4;
        faces.extend([[i, j, 4 + j], [i, 4 + j, 4 + i], [4 + i, 4 + j, 8 + j], [4 + i, 8 + j, 8 + i]]);
    }
    (positions, faces)
}

fn reach((positions, faces): &(Vec<DVec3>, Vec<[u32; 3]>), diameter: f64) -> Reach {
    let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::MAX);
    let tree = Tree::new(positions, faces);
    let options = ReachOptions { diameter, cells_per_diameter: 4, refinements: 3, max_nodes: 1 << 22 };
    Reach::new(positions, faces, &tree, options, &context).unwrap().unwrap()
}

#[test]
fn a_ball_enters_a_box_through_a_hole_that_is_wider() {
    let model = box_with_hole(2.0);
    for (diameter, inside) in [(1.0, true), (1.8, true), (2.15, false), (3.0, false)] {
        let reach = reach(&model, diameter);
        assert_eq!(reach.at(DVec3::ZERO) == Reached::Outside, inside, "{diameter}");
        assert_eq!(matches!(reach.at(DVec3::ZERO), Reached::Hidden(_)), !inside, "{diameter}");
        assert_eq!(reach.at(DVec3::splat(40.0)), Reached::Outside);
        assert_eq!(reach.at(DVec3::new(0.0, 0.0, -5.0)), Reached::Blocked);
    }
}

#[test]
fn the_centres_in_a_hidden_region_fill_the_box_less_the_radius() {
    let reach = reach(&box_with_hole(0.5), 2.0);
    let [region] = reach.hidden_regions() else { panic!("{:?}", reach.hidden_regions()) };
    // Centres lie in a cube of side 8; the volume is counted from below.
    assert!(region.volume <= 512.0 && region.volume > 300.0, "{}", region.volume);
    assert!(region.at.abs().max_element() < 4.0);
    assert_eq!(reach.doubtful_volume(), 0.0);
}

#[test]
fn an_octree_over_its_limit_gives_nothing() {
    let (positions, faces) = box_with_hole(1.0);
    let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::MAX);
    let tree = Tree::new(&positions, &faces);
    let options = ReachOptions { diameter: 0.5, cells_per_diameter: 4, refinements: 3, max_nodes: 1000 };
    assert!(Reach::new(&positions, &faces, &tree, options, &context).unwrap().is_none());
    let none = Tree::new(&[], &[]);
    assert!(Reach::new(&[], &[], &none, options, &context).unwrap().is_none());
}
