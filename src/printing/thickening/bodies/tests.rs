//! The search for balls can be stopped, and finds them where they are needed.

use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use super::*;
use crate::context::NoProgress;
use crate::math::Precision;
use crate::printing::shapes::{Voxels, cuboid, quietly, surface};
use crate::printing::thickening::{Growth, Thickening};

fn limits(surface: &Surface, min_wall: f64) -> Limits<'_> {
    Limits::new(surface, Thickening { min_wall, growth: Growth::Both, min_gap: 0.0, precision: Precision::F32 })
}

#[test]
fn the_search_in_a_face_far_larger_than_its_wall_can_be_stopped() {
    // Sampling these faces would take 600 million balls.
    let plate = cuboid(DVec3::ZERO, DVec3::new(1000.0, 1000.0, 0.1));
    let min_wall = 0.2;
    let (cancel, checks) = (AtomicBool::new(false), AtomicU64::new(0));
    let clock = || Duration::from_secs(checks.fetch_add(1, Ordering::Relaxed));
    let unlimited = Context::new(&NoProgress, &cancel, &clock, Duration::MAX);
    let thin = Thin::of(&plate, min_wall, &unlimited).expect("no deadline");
    assert!(!thin.is_empty());
    let now = checks.load(Ordering::Relaxed);
    let limited = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(now + 8));
    let search = Search { spacing: 0.04, margin: 0.08, tip_cover: 0.03, tolerance: 0.0, is_first: true };
    assert!(Fillers::new(&plate, &limits(&plate, min_wall), search).of(&thin, &limited).is_err());
    assert!(checks.load(Ordering::Relaxed) < now + 64, "the search goes on after its end");
}

#[test]
fn a_lip_that_is_less_high_than_thick_gets_balls() {
    let mut cells = Voxels::empty([8, 8, 6]);
    let fill = |cells: &mut Voxels, x: Range<usize>, z: Range<usize>| {
        x.for_each(|x| (0..8).for_each(|y| z.clone().for_each(|z| cells.set([x, y, z], true))));
    };
    fill(&mut cells, 0..8, 0..5);
    fill(&mut cells, 3..5, 5..6);
    let lip = cells.surface();
    let min_wall = 4.0;
    quietly(|context| {
        let thin = Thin::of(&lip, min_wall, context).expect("no deadline");
        let search = Search { spacing: 0.8, margin: 0.08, tip_cover: 0.09, tolerance: 0.0, is_first: false };
        let balls = Fillers::new(&lip, &limits(&lip, min_wall), search)
            .of(&thin, context)
            .expect("no deadline")
            .expect("few balls");
        let covers = |point: DVec3| balls.iter().any(|ball| ball.centre.distance(point) < ball.radius);
        assert!((1..8).all(|y| covers(DVec3::new(4.0, f64::from(y), 5.5))), "{balls:?}");
    });
}

#[test]
fn a_later_search_puts_balls_where_the_wall_beside_a_thin_place_is_hardly_thicker() {
    // A plate of 9, and one of 10 beside it from x = 12 on.
    let mut cells = Voxels::empty([40, 12, 10]);
    for (x, y, z) in (0..40).flat_map(|x| (0..12).flat_map(move |y| (0..10).map(move |z| (x, y, z)))) {
        cells.set([x, y, z], z < 9 || x >= 12);
    }
    let plate = cells.surface();
    let min_wall = 9.5;
    quietly(|context| {
        let thin = Thin::of(&plate, min_wall, context).expect("no deadline");
        let ends = |tolerance| {
            let search = Search { spacing: 1.9, margin: 0.08, tip_cover: 0.09, tolerance, is_first: false };
            let balls =
                Fillers::new(&plate, &limits(&plate, min_wall), search).of(&thin, context).expect("no deadline");
            balls.expect("few balls").iter().map(|ball| ball.centre.x).fold(0.0, f64::max)
        };
        let (exactly, beyond) = (ends(0.0), ends(0.1));
        assert!(exactly < 13.0, "{exactly}");
        assert!((14.0..18.0).contains(&beyond), "{beyond}");
    });
}

#[test]
fn a_neck_between_two_concave_edges_gets_balls_all_along() {
    // Two blocks that overlap in a corner of 1 by 1.
    let outline = [[0.0, 0.0], [6.0, 0.0], [6.0, 5.0], [11.0, 5.0], [11.0, 11.0], [5.0, 11.0], [5.0, 6.0], [0.0, 6.0]];
    let positions = [0.0, 12.0].iter().flat_map(|y| outline.map(|[x, z]| DVec3::new(x, *y, z))).collect();
    let caps = [[0, 1, 2], [0, 2, 6], [0, 6, 7], [2, 3, 4], [2, 4, 5], [2, 5, 6]];
    let sides = (0..8).flat_map(|k| [[k, k + 8, (k + 1) % 8], [(k + 1) % 8, k + 8, (k + 1) % 8 + 8]]);
    let faces = caps.iter().flat_map(|&[a, b, c]| [[a, b, c], [a + 8, c + 8, b + 8]]).chain(sides).collect();
    let blocks = surface(positions, faces);
    let min_wall = 2.0;
    quietly(|context| {
        let thin = Thin::of(&blocks, min_wall, context).expect("no deadline");
        let search = Search { spacing: 0.4, margin: 0.08, tip_cover: 0.09, tolerance: 0.0, is_first: false };
        let balls = Fillers::new(&blocks, &limits(&blocks, min_wall), search).of(&thin, context).expect("no deadline");
        let balls = balls.expect("few balls");
        let covers = |point: DVec3| balls.iter().any(|ball| ball.centre.distance(point) < 0.5 * ball.radius);
        assert!((1..12).all(|y| covers(DVec3::new(5.5, f64::from(y), 5.5))), "{balls:?}");
    });
}
