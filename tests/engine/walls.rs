//! The thinnest wall of a model.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use glam::DVec3;
use meshmend::context::{Context, NoProgress};
use meshmend::inspect::{InspectOptions, NoWallReason, ThinnestWall, inspect};
use meshmend::mesh::Soup;

use crate::meshes::{cube, cylinder, inside_out, join, push, sphere, torus};

fn measured(soup: &Soup) -> Result<ThinnestWall, NoWallReason> {
    let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(1));
    let print = inspect(soup.into(), &InspectOptions::default(), &context).unwrap().0.print.unwrap();
    print.thinnest_wall.ok_or_else(|| print.no_wall_reason.unwrap())
}

fn thinnest(soup: &Soup) -> ThinnestWall {
    let wall = measured(soup).unwrap();
    assert!(wall.complete && wall.samples as usize >= soup.faces.len(), "{wall:?}");
    assert_eq!((wall.places[0].at, wall.places[0].thickness), (wall.at, wall.thickness));
    wall
}

fn assert_close(found: f64, expected: f64) {
    assert!((found / expected - 1.0).abs() < 0.01, "{found} is not {expected}");
}

/// A profile of radii and heights, revolved around the z axis in `n` steps; outward if it goes up on the outside.
fn lathe(profile: &[[f64; 2]], n: u32) -> Soup {
    let mut soup = Soup::default();
    let at = |i: u32, [radius, z]: [f64; 2]| {
        let angle = f64::from(i % n) / f64::from(n) * std::f64::consts::TAU;
        DVec3::new(radius * angle.cos() + 0.0, radius * angle.sin() + 0.0, z)
    };
    for i in 0..n {
        for pair in profile.windows(2) {
            let q = [at(i, pair[0]), at(i + 1, pair[0]), at(i + 1, pair[1]), at(i, pair[1])];
            for t in [[q[0], q[1], q[2]], [q[0], q[2], q[3]]] {
                if t[0] != t[1] && t[1] != t[2] && t[2] != t[0] {
                    push(&mut soup, t);
                }
            }
        }
    }
    soup
}

/// A ball of 50 mm radius with a pin at its top, as one solid.
fn ball_with_pin(radius: f64, height: f64, n: u32) -> Soup {
    let mut profile: Vec<[f64; 2]> = (0..n)
        .map(|j| (f64::from(j) / f64::from(n) - 0.5) * std::f64::consts::PI)
        .map(|angle| [50.0 * angle.cos(), 50.0 * angle.sin()])
        .collect();
    profile[0][0] = 0.0;
    let foot = (50.0f64 * 50.0 - radius * radius).sqrt();
    profile.extend([[radius, foot], [radius, foot + height], [0.0, foot + height]]);
    lathe(&profile, n)
}

/// An axis-parallel box with `n` cells along each side.
fn block(low: DVec3, size: DVec3, n: u32) -> Soup {
    mapped(cube(DVec3::ZERO, 1.0, n), |p| low + p * size)
}

fn mapped(mut soup: Soup, map: impl Fn(DVec3) -> DVec3) -> Soup {
    soup.positions.iter_mut().for_each(|p| *p = map(*p));
    soup
}

/// A prism 30 long and 10 deep whose sides form an angle, with an edge 0.02 wide at its tip.
fn wedge(degrees: f64) -> Soup {
    let slope = 2.0 * (degrees / 2.0).to_radians().tan();
    mapped(cube(DVec3::ZERO, 1.0, 16), |p| {
        DVec3::new(10.0 * p.x, (p.y - 0.5) * (0.02 + 10.0 * p.x * slope), 30.0 * p.z)
    })
}

#[test]
fn a_pin_of_0_4_mm_on_a_ball_of_80_000_faces_is_found() {
    let ball = ball_with_pin(0.2, 3.0, 200);
    assert!(ball.faces.len() > 80_000);
    let wall = thinnest(&ball);
    assert_close(wall.thickness, 0.4);
    assert!(wall.at[2] > 49.9, "{wall:?}");
    assert!(wall.median > 90.0);
}

#[test]
fn a_pin_that_overlaps_a_ball_is_found_too() {
    let parts = join(&sphere(DVec3::ZERO, 50.0, 60, 60), &cylinder(DVec3::Z * 45.0, 0.2, 9.0, 12));
    let wall = measured(&parts).unwrap();
    assert_close(wall.thickness, 0.4 * 15f64.to_radians().cos());
    assert!(wall.at[2] > 49.0, "{wall:?}");
}

#[test]
fn a_thin_fin_of_few_faces_and_little_area_is_found() {
    let body = block(DVec3::ZERO, DVec3::splat(100.0), 12);
    let fin = |thickness: f64| block(DVec3::new(120.0, 3.0, 7.0), DVec3::new(1.0, 1.5, thickness), 1);
    assert_close(thinnest(&join(&body, &fin(0.05))).thickness, 0.05);
    let sticks_out = mapped(fin(0.05), |p| p - DVec3::X * 20.5);
    assert_close(measured(&join(&body, &sticks_out)).unwrap().thickness, 0.05);
    assert_close(measured(&join(&body, &inside_out(fin(0.05)))).unwrap().thickness, 0.05);
}

/// A block of 100 by 100 by 10 with a groove of width 2 along x in its top and another along y in its bottom. The material
/// between them is 0.5 thick where they cross, which is far from the centres of the long faces, and 5.25 elsewhere.
fn grooved_block() -> Soup {
    const LENGTH: f64 = 100.0;
    const GROOVE: [f64; 2] = [9.0, 11.0];
    let [a, b] = GROOVE;
    let [low, high, floor, roof] = [0.0, 10.0, 5.25, 4.75];
    let mut soup = Soup::default();
    let mut quad = |[p, q, r, s]: [[f64; 3]; 4]| {
        let [p, q, r, s] = [p, q, r, s].map(DVec3::from);
        push(&mut soup, [p, q, r]);
        push(&mut soup, [p, r, s]);
    };
    for (from, to, z) in [(0.0, a, high), (a, b, floor), (b, LENGTH, high)] {
        quad([[0.0, from, z], [LENGTH, from, z], [LENGTH, to, z], [0.0, to, z]]);
    }
    for (from, to, z) in [(0.0, a, low), (a, b, roof), (b, LENGTH, low)] {
        quad([[from, 0.0, z], [from, LENGTH, z], [to, LENGTH, z], [to, 0.0, z]]);
    }
    quad([[0.0, a, floor], [0.0, a, high], [LENGTH, a, high], [LENGTH, a, floor]]);
    quad([[0.0, b, floor], [LENGTH, b, floor], [LENGTH, b, high], [0.0, b, high]]);
    quad([[a, 0.0, low], [a, LENGTH, low], [a, LENGTH, roof], [a, 0.0, roof]]);
    quad([[b, 0.0, low], [b, 0.0, roof], [b, LENGTH, roof], [b, LENGTH, low]]);
    let below = [
        [[0.0, low], [a, floor], [a, high], [0.0, high]],
        [[0.0, low], [LENGTH, low], [b, floor], [a, floor]],
        [[LENGTH, low], [LENGTH, high], [b, high], [b, floor]],
    ];
    for side in below {
        quad(side.map(|[y, z]| [LENGTH, y, z]));
        let [p, q, r, s] = side.map(|[y, z]| [0.0, y, z]);
        quad([p, s, r, q]);
    }
    let above = [
        [[0.0, high], [0.0, low], [a, low], [a, roof]],
        [[0.0, high], [a, roof], [b, roof], [LENGTH, high]],
        [[LENGTH, high], [b, roof], [b, low], [LENGTH, low]],
    ];
    for side in above {
        quad(side.map(|[x, z]| [x, 0.0, z]));
        let [p, q, r, s] = side.map(|[x, z]| [x, LENGTH, z]);
        quad([p, s, r, q]);
    }
    soup
}

#[test]
fn a_thin_place_far_from_the_centres_of_its_faces_is_found() {
    let wall = thinnest(&grooved_block());
    assert_close(wall.thickness, 0.5);
    assert!((wall.at[0] - 10.0).abs() <= 1.0 && (wall.at[1] - 10.0).abs() <= 1.0, "{wall:?}");
}

#[test]
fn a_tube_s_wall_is_as_thick_as_its_radii_differ() {
    let tube = lathe(&[[10.0, 0.0], [10.0, 40.0], [9.5, 40.0], [9.5, 0.0], [10.0, 0.0]], 64);
    let wall = thinnest(&tube);
    assert_close(wall.thickness, 0.5);
    assert_close(wall.median, 0.5);
}

#[test]
fn where_sides_meet_at_45_degrees_there_is_no_thin_wall_and_at_20_degrees_there_is() {
    assert!(thinnest(&wedge(45.0)).thickness > 9.0);
    assert!(thinnest(&wedge(20.0)).thickness < 0.3);
}

#[test]
fn the_edges_of_boxes_are_not_thin_walls() {
    assert_close(thinnest(&block(DVec3::ZERO, DVec3::new(3.0, 5.0, 4.0), 40)).thickness, 3.0);
    assert_close(thinnest(&block(DVec3::ZERO, DVec3::new(3.0, 5.0, 4.0), 1)).thickness, 3.0);
}

#[test]
fn each_thin_region_is_reported_once_and_thick_ones_are_not() {
    let chip = |x: f64, thickness: f64| block(DVec3::new(x, 3.0, 7.0), DVec3::new(1.0, 1.5, thickness), 6);
    let body = block(DVec3::ZERO, DVec3::splat(100.0), 12);
    let wall = thinnest(&join(&body, &join(&chip(120.0, 0.3), &chip(150.0, 0.1))));
    let thicknesses: Vec<f64> = wall.places.iter().map(|place| (place.thickness * 1e6).round() / 1e6).collect();
    assert_eq!(thicknesses, [0.1, 0.3]);
    let plate = thinnest(&block(DVec3::ZERO, DVec3::new(160.0, 160.0, 1.0), 30));
    assert!((30..=100).contains(&plate.places.len()), "{}", plate.places.len());
    for (i, a) in plate.places.iter().enumerate() {
        for b in &plate.places[..i] {
            assert!(DVec3::from(a.at).distance(DVec3::from(b.at)) > 9.9);
        }
    }
}

#[test]
fn the_thinnest_wall_is_the_same_on_any_number_of_threads() {
    let overlapping = join(&torus(3.0, 1.0, 72, 36), &sphere(DVec3::new(2.5, 0.3, 0.4), 1.2, 48, 30));
    for soup in [ball_with_pin(0.2, 3.0, 60), overlapping, wedge(20.0)] {
        let on = |threads: usize| {
            rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| measured(&soup).unwrap())
        };
        assert_eq!(on(1), on(4));
    }
}
