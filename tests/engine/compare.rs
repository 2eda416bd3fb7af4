//! Comparison of meshes: distances, common volume, buried surface, and spacing of a set.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use glam::DVec3;
use meshmend::context::{Context, NoProgress};
use meshmend::inspect::{Analysis, CompareOptions, Comparison, Spacing, compare, spacing};
use meshmend::mesh::Soup;

use crate::meshes::{cube, inside_out, join, push, sphere, torus};

const FAST: CompareOptions = CompareOptions { samples: 3000, vertices: 3000, inside: 3000 };

fn with_analyses<T>(soups: &[&Soup], look: impl FnOnce(&[&Analysis<'_>], &Context<'_>) -> T) -> T {
    let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(1));
    let analyses: Vec<_> = soups.iter().map(|&soup| Analysis::new(soup.into(), &context).unwrap()).collect();
    look(&analyses.iter().collect::<Vec<_>>(), &context)
}

fn compared(before: &Soup, after: &Soup) -> Comparison {
    with_analyses(&[before, after], |analyses, context| compare(analyses[0], analyses[1], FAST, context).unwrap())
}

fn spaced(soups: &[&Soup]) -> Vec<Spacing> {
    with_analyses(soups, |analyses, context| spacing(analyses, context).unwrap())
}

fn mapped(soup: &Soup, map: impl Fn(DVec3) -> DVec3) -> Soup {
    Soup { positions: soup.positions.iter().map(|&p| map(p)).collect(), faces: soup.faces.clone() }
}

fn assert_close(found: f64, expected: f64, tolerance: f64) {
    assert!((found - expected).abs() <= tolerance, "{found} is not {expected}");
}

fn deviations(comparison: &Comparison) -> [meshmend::inspect::Deviation; 3] {
    [comparison.changes.lost.unwrap(), comparison.deviation.unwrap(), comparison.changes.added.unwrap()]
}

#[test]
fn a_mesh_has_zero_distance_from_itself_and_is_kept_completely() {
    let ball = sphere(DVec3::ONE, 2.0, 24, 12);
    let comparison = compared(&ball, &ball);
    assert!(comparison.faithful);
    assert_eq!((comparison.changes.faces_kept_pct, comparison.changes.surface_lost_pct), (100.0, Some(0.0)));
    for deviation in deviations(&comparison) {
        assert_eq!((deviation.distance.max, deviation.distance.rms, deviation.complete), (0.0, 0.0, true));
    }
    let inside = comparison.inside.unwrap();
    assert_eq!((inside.agree_pct, inside.overlap_pct, inside.points), (100.0, Some(100.0), 3000));
    // A ball in its bounding box.
    assert_close(inside.inside_before as f64 / 3000.0, std::f64::consts::PI / 6.0, 0.02);
}

#[test]
fn a_shifted_cube_differs_by_the_shift_perpendicular_to_its_faces() {
    let before = cube(DVec3::ZERO, 1.0, 3);
    let after = mapped(&before, |p| p + DVec3::X * 0.1);
    let comparison = compared(&before, &after);
    for deviation in deviations(&comparison) {
        assert_close(deviation.distance.max, 0.1, 1e-12);
        assert_close(deviation.percent.max, 10.0 / 3f64.sqrt(), 1e-9);
        // One side is 0.1 away. So is the opposite side, except near its rim, where the other four sides are nearer. A tenth of
        // those four sides is away too, by half as much on average.
        let rim = (1.0 - 0.8f64.powi(3)) / 6.0;
        assert_close(deviation.distance.mean, (0.1 + rim + 4.0 * 0.1 * 0.05) / 6.0, 3e-4);
        assert_close(deviation.distance.p50, 0.0, 1e-12);
        assert_close(deviation.distance.p95, 0.1, 1e-12);
    }
    assert_close(comparison.changes.bounding_box_change_pct.unwrap(), 10.0 / 3f64.sqrt(), 1e-9);
    assert_close(comparison.changes.volume_change_pct.unwrap(), 0.0, 1e-9);
    let inside = comparison.inside.unwrap();
    assert_close(inside.agree_pct, (1.0 - 0.2 / 1.1) * 100.0, 1.0);
    assert_close(inside.overlap_pct.unwrap(), 0.9 / 1.1 * 100.0, 1.0);
    assert!(!comparison.faithful);
}

#[test]
fn a_finer_sphere_differs_by_the_sagitta_of_the_coarse_one_s_facets() {
    let (coarse, fine) = (sphere(DVec3::ZERO, 1.0, 32, 16), sphere(DVec3::ZERO, 1.0, 128, 64));
    let comparison = compared(&coarse, &fine);
    // The sagitta of 1/32 of a circle is 0.0048; facets bend both ways.
    for deviation in deviations(&comparison) {
        assert!((0.0048..0.0105).contains(&deviation.distance.max), "{deviation:?}");
        assert!((0.001..0.006).contains(&deviation.distance.mean), "{deviation:?}");
    }
    assert!(comparison.faithful && comparison.inside.unwrap().agree_pct > 98.0);
    assert!(comparison.changes.volume_change_pct.unwrap() > 1.0);
}

#[test]
fn invisible_surface_is_not_lost_but_it_deviates() {
    let outer = cube(DVec3::ZERO, 4.0, 4);
    let both = join(&outer, &cube(DVec3::splat(1.0), 2.0, 4));
    let comparison = compared(&both, &outer);
    assert_eq!(comparison.changes.surface_lost_pct, Some(0.0));
    assert_eq!(comparison.changes.lost.unwrap().distance.max, 0.0);
    assert_close(comparison.visible_pct.unwrap(), 80.0, 0.5);
    assert_close(comparison.deviation.unwrap().distance.max, 1.0, 1e-9);
    assert_eq!((comparison.changes.parts, comparison.changes.faces), (-1, -192));
}

#[test]
fn a_mesh_turned_inside_out_has_the_same_inside() {
    let ring = torus(3.0, 1.0, 32, 16);
    assert_eq!(compared(&ring, &inside_out(ring.clone())).inside.unwrap().agree_pct, 100.0);
}

#[test]
fn powers_of_two_and_right_angles_change_no_figure_in_percent() {
    let before = cube(DVec3::new(0.3, 0.1, -0.7), 1.0, 3);
    let after = sphere(DVec3::new(0.8, 0.6, -0.2), 0.6, 24, 12);
    let base = compared(&before, &after);
    for power in [-900, -300, -3, 5, 300, 900] {
        let size = 2f64.powi(power);
        let comparison = compared(&mapped(&before, |p| p * size), &mapped(&after, |p| p * size));
        for (scaled, whole) in deviations(&comparison).iter().zip(deviations(&base)) {
            assert_eq!((scaled.percent, scaled.distance.max), (whole.percent, whole.distance.max * size), "2^{power}");
        }
        assert_eq!(
            (comparison.inside, comparison.visible_pct, comparison.faithful),
            (base.inside, base.visible_pct, base.faithful)
        );
    }
    let turn = |p: DVec3| DVec3::new(-p.y, p.x, p.z);
    let moved = compared(&mapped(&before, turn), &mapped(&after, turn));
    for (turned, whole) in deviations(&moved).iter().zip(deviations(&base)) {
        assert_close(turned.percent.max, whole.percent.max, 1e-9);
        assert_close(turned.percent.mean, whole.percent.mean, 1e-9);
    }
}

#[test]
fn comparing_huge_tiny_empty_or_broken_meshes_gives_no_nan() {
    let ball = |size: f64| sphere(DVec3::ZERO, size, 12, 8);
    let mut broken = ball(1.0);
    push(&mut broken, [DVec3::NAN, DVec3::INFINITY, DVec3::X]);
    let mut point = Soup::default();
    push(&mut point, [DVec3::ONE; 3]);
    let all = [ball(1.0), ball(1e300), ball(1e-300), ball(1.7e308), Soup::default(), broken, point];
    for before in &all {
        for after in &all {
            let comparison = compared(before, after);
            let text = serde_json::to_string(&comparison).unwrap();
            assert_eq!(serde_json::from_str::<Comparison>(&text).unwrap(), comparison);
        }
    }
    let scaled = compared(&ball(1e300), &ball(2e300));
    assert_close(scaled.deviation.unwrap().distance.max / 1e300, 1.0, 0.1);
    // From a ball the size of an atom to an astronomically large one, and back.
    let scaled = compared(&ball(1.0), &ball(1e200));
    assert_close(scaled.deviation.unwrap().distance.max / 1e200, 0.95, 0.06);
    assert_close(scaled.changes.added.unwrap().distance.max / 1e200, 1.0, 1e-6);
}

#[test]
fn a_fan_of_needles_takes_no_longer_than_its_budget() {
    let mut fan = Soup::default();
    let tip = |i: u32| DVec3::new(1.0, 1e-4 * f64::from(i), 1e-5 * f64::from(i * i % 977));
    for i in 0..60_000 {
        push(&mut fan, [DVec3::ZERO, tip(i), tip(i + 1)]);
    }
    let moved = mapped(&fan, |p| p * 1.01 + DVec3::Z * 0.03);
    let start = std::time::Instant::now();
    let comparison = compared(&fan, &moved);
    assert!(start.elapsed() < Duration::from_secs(60), "{:?}", start.elapsed());
    assert!(comparison.deviation.unwrap().samples > 50);
}

#[test]
fn any_number_of_threads_gives_the_same_values() {
    let (before, after) = (torus(3.0, 1.0, 40, 20), torus(3.01, 1.0, 36, 20));
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| (compared(&before, &after), spaced(&[&before, &after])))
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn spacing_is_from_each_vertex_to_the_nearest_of_the_other_meshes() {
    let (left, middle) = (cube(DVec3::ZERO, 1.0, 1), cube(DVec3::new(1.5, 0.0, 0.0), 1.0, 1));
    let right = cube(DVec3::new(2.75, 0.0, 0.0), 1.0, 1);
    let found = spaced(&[&left, &middle, &right]);
    let mut distances: Vec<f64> = found[0].distances.clone();
    distances.sort_by(f64::total_cmp);
    assert_eq!(distances, [0.5, 0.5, 0.5, 0.5, 1.5, 1.5, 1.5, 1.5]);
    let gap = found[1].least.unwrap();
    assert_eq!((gap.distance, gap.mesh, gap.from[0], gap.to[0]), (0.25, 2, 2.5, 2.75));
    assert!(found.iter().all(|spacing| spacing.complete && spacing.distances.len() == 8));
    assert!(spaced(&[&left])[0].distances.is_empty() && spaced(&[&left, &Soup::default()])[0].least.is_none());
    let huge = spaced(&[&mapped(&left, |p| p * 1e300), &mapped(&middle, |p| p * 1e300)]);
    assert_close(huge[0].least.unwrap().distance / 1e300, 0.5, 1e-12);
}

#[test]
fn removed_faces_inside_the_result_are_buried() {
    let inner = cube(DVec3::splat(1.0), 1.0, 4);
    let buried = |before: &Soup, after: &Soup| compared(before, after).changes.enclosed_faces_pct;
    let outer = cube(DVec3::ZERO, 3.0, 2);
    assert_eq!(buried(&join(&outer, &inner), &outer), Some(100.0));
    // Surface lost on the outside, or with coarser faces, is not buried.
    assert_eq!(buried(&join(&outer, &cube(DVec3::splat(5.0), 1.0, 4)), &outer), Some(0.0));
    assert_eq!(buried(&cube(DVec3::ZERO, 3.0, 5), &outer), Some(0.0));
    assert_eq!(buried(&outer, &outer), None);
}
