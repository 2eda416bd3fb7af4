//! Triangulation of convex, concave, degenerate, self-intersecting and adversarial polygons.

use glam::DQuat;

use super::*;

fn triangulate(positions: &[DVec3]) -> (Vec<[u32; 3]>, Triangulator) {
    let corners: Vec<u32> = (0..positions.len() as u32).collect();
    let mut triangulator = Triangulator::new(5.0);
    let mut triangles = Vec::new();
    triangulator.triangulate(positions, &corners, |t| triangles.push(t.map(|k| k as u32)));
    (triangles, triangulator)
}

/// Asserts that each polygon edge is a side of one triangle, and that all other sides come in opposite pairs.
fn assert_disk(count: usize, triangles: &[[u32; 3]]) {
    assert_eq!(triangles.len(), count - 2);
    let sides: Vec<(u32, u32)> = triangles.iter().flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]).collect();
    for k in 0..count as u32 {
        let edge = (k, (k + 1) % count as u32);
        assert_eq!(sides.iter().filter(|&&side| side == edge).count(), 1, "edge {edge:?}");
    }
    for &(a, b) in &sides {
        let inner = (a + 1) % count as u32 != b;
        assert!(!inner || sides.iter().filter(|&&side| side == (b, a)).count() == 1, "side {a} {b}");
    }
}

fn double_area(positions: &[DVec3], t: [u32; 3]) -> DVec3 {
    let [a, b, c] = t.map(|v| positions[v as usize]);
    (b - a).cross(c - a)
}

/// Asserts that triangles cover a flat simple polygon once: none is reversed, and their areas add up to the polygon's.
fn assert_cover(positions: &[DVec3], triangles: &[[u32; 3]]) {
    let whole: DVec3 = (1..positions.len() - 1).map(|k| double_area(positions, [0, k as u32, k as u32 + 1])).sum();
    let up = whole.normalize();
    let areas: Vec<f64> = triangles.iter().map(|&t| double_area(positions, t).dot(up)).collect();
    assert!(areas.iter().all(|&a| a > 1e-9), "{areas:?}");
    assert!((areas.iter().sum::<f64>() - whole.length()).abs() < 1e-9 * whole.length());
}

fn turned(outline: &[[f64; 2]], k: u32) -> Vec<DVec3> {
    let turn = DQuat::from_euler(glam::EulerRot::XYZ, f64::from(k) * 0.7, f64::from(k) * 1.3, f64::from(k) * 0.4);
    outline.iter().map(|p| turn * DVec3::new(p[0], p[1], 0.0) + DVec3::new(3.0, -2.0, 7.0)).collect()
}

const COMB: [[f64; 2]; 12] = [
    [0.0, 0.0],
    [7.0, 0.0],
    [7.0, 5.0],
    [6.0, 5.0],
    [6.0, 1.0],
    [4.0, 1.0],
    [4.0, 5.0],
    [3.0, 5.0],
    [3.0, 1.0],
    [1.0, 1.0],
    [1.0, 5.0],
    [0.0, 5.0],
];

#[test]
fn a_concave_polygon_is_covered_once_in_every_orientation() {
    for k in 0..40 {
        let positions = turned(&COMB, k);
        for start in 0..COMB.len() {
            let mut around = positions.clone();
            around.rotate_left(start);
            let (triangles, triangulator) = triangulate(&around);
            assert_disk(around.len(), &triangles);
            assert_cover(&around, &triangles);
            assert_eq!(triangulator.fan_count(), 0);
        }
    }
}

#[test]
fn a_clockwise_polygon_gives_clockwise_triangles() {
    let mut positions = turned(&COMB, 0);
    positions.reverse();
    let (triangles, _) = triangulate(&positions);
    assert_disk(12, &triangles);
    assert!(triangles.iter().all(|&t| double_area(&positions, t).z < 0.0));
}

#[test]
fn collinear_corners_are_kept() {
    for k in 0..40 {
        let mut outline = Vec::new();
        for (i, a) in COMB.iter().enumerate() {
            let b = COMB[(i + 1) % COMB.len()];
            outline.extend((0..3).map(|j| {
                let t = f64::from(j) / 3.0;
                [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])]
            }));
        }
        let positions = turned(&outline, k);
        let (triangles, triangulator) = triangulate(&positions);
        assert_disk(positions.len(), &triangles);
        assert_eq!(triangulator.fan_count(), 0, "turn {k}");
        let whole: DVec3 = (1..35).map(|k| double_area(&positions, [0, k, k + 1])).sum();
        let covered: f64 = triangles.iter().map(|&t| double_area(&positions, t).length()).sum();
        assert!((covered - whole.length()).abs() < 1e-6);
    }
}

#[test]
fn a_square_with_a_straight_corner_keeps_its_area() {
    let outline = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 2.0]];
    for start in 0..4 {
        let mut positions = turned(&outline, 0);
        positions.rotate_left(start);
        let (triangles, _) = triangulate(&positions);
        assert_disk(4, &triangles);
        assert_cover(&positions, &triangles);
    }
}

#[test]
fn an_arrowhead_is_split_at_its_reflex_corner() {
    let outline = [[0.0, 0.0], [2.0, 1.0], [0.0, 2.0], [0.5, 1.0]];
    for start in 0..4 {
        let mut positions = turned(&outline, 5);
        positions.rotate_left(start);
        let (triangles, _) = triangulate(&positions);
        assert_disk(4, &triangles);
        assert_cover(&positions, &triangles);
    }
}

#[test]
fn a_polygon_without_a_normal_is_split_as_a_fan() {
    let on_a_line: Vec<DVec3> = (0..7).map(|k| DVec3::splat(f64::from(k))).collect();
    let (triangles, triangulator) = triangulate(&on_a_line);
    assert_disk(7, &triangles);
    assert_eq!((triangulator.degenerate_count(), triangulator.fan_count()), (1, 0));
    for strange in [f64::NAN, f64::INFINITY, f64::MAX] {
        let mut positions = turned(&COMB, 1);
        positions[4].x = strange;
        positions[5].x = -strange;
        let (triangles, _) = triangulate(&positions);
        assert_disk(12, &triangles);
    }
}

#[test]
fn very_small_and_very_large_polygons_are_triangulated_like_others() {
    for scale in [1e-300, 1e-120, 1e120, 1e300] {
        let positions: Vec<DVec3> = COMB.iter().map(|p| DVec3::new(p[0], p[1], 0.0) * scale).collect();
        let (triangles, triangulator) = triangulate(&positions);
        assert_disk(12, &triangles);
        assert_eq!((triangulator.degenerate_count(), triangulator.fan_count()), (0, 0), "{scale}");
    }
}

/// Pseudo-random points, the same on every machine.
fn scattered(count: u32, seed: u64) -> Vec<DVec3> {
    let mut state = seed;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / f64::from(1_u32 << 31)
    };
    (0..count).map(|_| DVec3::new(next(), next(), 0.01 * next())).collect()
}

#[test]
fn a_self_intersecting_polygon_still_gives_a_disk() {
    for seed in 0..200 {
        let positions = scattered(5 + seed % 60, u64::from(seed));
        let (triangles, _) = triangulate(&positions);
        assert_disk(positions.len(), &triangles);
    }
}

#[test]
fn adversarial_polygons_are_triangulated_in_acceptable_time() {
    for (polygons, corners) in [(60, MAX_CORNERS), (5000, MAX_CROSSING_CORNERS)] {
        let begin = std::time::Instant::now();
        let mut triangulator = Triangulator::new(5.0);
        let mut count = 0;
        for seed in 0..polygons {
            let positions = scattered(corners as u32, seed);
            let corners: Vec<u32> = (0..positions.len() as u32).collect();
            triangulator.triangulate(&positions, &corners, |_| count += 1);
        }
        assert_eq!(count, polygons as usize * (corners - 2));
        assert!(begin.elapsed().as_secs() < 20, "{:?}", begin.elapsed());
    }
}

#[test]
fn a_large_spiral_is_triangulated_without_folds_in_acceptable_time() {
    let begin = std::time::Instant::now();
    let half = MAX_CORNERS / 2;
    let arm = |k: usize, width: f64| {
        let t = k as f64 / half as f64;
        let angle = 200.0 * t;
        DVec3::new(angle.cos(), angle.sin(), 0.0) * (1.0 + 60.0 * t + width)
    };
    let mut positions: Vec<DVec3> = (0..half).map(|k| arm(k, 0.0)).collect();
    positions.extend((0..half).rev().map(|k| arm(k, 0.5)));
    let (triangles, triangulator) = triangulate(&positions);
    assert_eq!(triangulator.fan_count(), 0);
    assert_eq!(triangles.len(), 2 * half - 2);
    assert_cover(&positions, &triangles);
    assert!(begin.elapsed().as_secs() < 10, "{:?}", begin.elapsed());
}

#[test]
fn a_hole_that_a_bridge_edge_joins_to_the_outline_stays_a_hole() {
    let outline = [
        [0.0, 0.0],
        [4.0, 0.0],
        [4.0, 4.0],
        [0.0, 4.0],
        [0.0, 0.0],
        [1.0, 1.0],
        [1.0, 3.0],
        [3.0, 3.0],
        [3.0, 1.0],
        [1.0, 1.0],
    ];
    for k in 0..20 {
        let positions = turned(&outline, k);
        let (triangles, triangulator) = triangulate(&positions);
        assert_disk(10, &triangles);
        assert_eq!(triangulator.fan_count(), 0);
        let covered: f64 = triangles.iter().map(|&t| double_area(&positions, t).length()).sum();
        assert!((covered - 24.0).abs() < 1e-9, "turn {k}: {covered}");
    }
}

#[test]
fn a_convex_polygon_of_any_size_is_triangulated_in_linear_time() {
    let positions: Vec<DVec3> = (0..200_000)
        .map(|k| {
            let angle = f64::from(k) * std::f64::consts::TAU / 200_000.0;
            DVec3::new(angle.cos(), 0.0, angle.sin())
        })
        .collect();
    let (triangles, triangulator) = triangulate(&positions);
    assert_eq!(triangles.len(), 199_998);
    assert_eq!(triangulator.fan_count(), 0);
}
