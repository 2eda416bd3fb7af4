//! The thickness field and the least thickness of known shapes.

use super::shapes::*;
use super::*;

fn field(surface: &Surface) -> ThicknessField {
    let field = with_context(|context| thickness_field(surface, Space::Material, context)).unwrap();
    assert!(field.is_complete);
    field
}

#[test]
fn every_face_and_vertex_of_a_tube_has_the_thickness_of_its_wall() {
    let tube = revolved(&[[4.4, 0.0], [5.0, 0.0], [5.0, 6.0], [4.4, 6.0]], 64);
    let mut random = Random(2);
    let field = field(&turned(tube.clone(), &mut random));
    for (f, &value) in field.at_faces.iter().enumerate() {
        let is_side = tube.area_vector(f).z == 0.0;
        let expected = if is_side { 0.6 } else { 6.0 };
        assert!((value / expected - 1.0).abs() < 0.02, "{f} {value}");
    }
    for &value in &field.at_vertices {
        assert!((value / 0.6 - 1.0).abs() < 0.02, "{value}");
    }
}

#[test]
fn edges_of_a_cube_have_the_thickness_of_the_cube() {
    let mut random = Random(6);
    let cube = split(cuboid([5.0, 5.0, 5.0]), 200, &mut random);
    let field = field(&cube);
    assert!(field.at_faces.iter().chain(&field.at_vertices).all(|value| (value / 5.0 - 1.0).abs() < 1e-3));
}

#[test]
fn a_wedge_wider_than_37_degrees_has_no_thickness() {
    let pyramid = revolved(&[[0.0, 0.0], [4.0, 0.0], [0.0, 2.0]], 3);
    assert!(field(&pyramid).at_faces.iter().all(|value| value.is_infinite()));
}

#[test]
fn a_cone_is_as_thick_as_its_inscribed_balls() {
    let cone = revolved(&[[0.0, 0.0], [0.5, 0.0], [2.0, 12.0], [0.0, 12.0]], 64);
    let mut random = Random(9);
    let cone = split(cone, 300, &mut random);
    let field = field(&cone);
    let half = (1.5f64 / 12.0).atan();
    for (f, &value) in field.at_faces.iter().enumerate() {
        let centre = cone.corners(f).into_iter().sum::<DVec3>() / 3.0;
        let (radius, normal) = (centre.truncate().length(), cone.area_vector(f).normalize());
        // The ball that touches the cone where its radius is r has the diameter 2 r / cos(half).
        let expected = 2.0 * radius / half.cos();
        if normal.z.abs() < 0.5 && centre.z > 1.0 && centre.z < 11.0 {
            assert!((f64::from(value) / expected - 1.0).abs() < 0.02, "{f} {value} {expected}");
        }
    }
}

#[test]
fn the_least_thickness_is_that_of_the_thinnest_wall() {
    let mut random = Random(4);
    let tray = |w: f64| {
        let grid = [0.0, 3.0, 17.0, 20.0];
        blocks(&grid, &grid, &[0.0, w, 8.0], |i, j, k| k == 0 || i != 1 || j != 1)
    };
    for w in [0.5, 2.0, 2.9, 5.0] {
        let shape = split(turned(tray(w), &mut random), 100, &mut random);
        let least = with_context(|context| least_thickness(&shape, Space::Material, context)).unwrap();
        let pair = least.pair.unwrap();
        assert!(least.is_complete && (pair.thickness - w.min(3.0)).abs() < 1e-9, "{w} {pair:?}");
    }
    let none = revolved(&[[0.0, 0.0], [4.0, 0.0], [0.0, 2.0]], 3);
    let least = with_context(|context| least_thickness(&none, Space::Material, context)).unwrap();
    assert_eq!((least.pair, least.is_complete), (None, true));
}

/// A shape and its least wall.
fn known(random: &mut Random) -> (Surface, f64) {
    let w = random.between(0.3, 1.4);
    let n = 24 + random.below(60);
    let (a, b) = (random.between(6.0, 15.0), random.between(4.0, 9.0));
    match random.below(9) {
        0 => (cuboid([a, b, w]), w),
        1 => {
            let r = random.between(2.0, 6.0);
            (revolved(&[[r, 0.0], [r + w, 0.0], [r + w, a], [r, a]], n), w)
        }
        2 => (prism(2 * (n / 2), w / 2.0, a), w),
        3 => {
            // A truncated cone.
            let rise = a * random.between(0.02, 0.2);
            (revolved(&[[0.0, 0.0], [w / 2.0, 0.0], [w / 2.0 + rise, a], [0.0, a]], 2 * (n / 2)), w)
        }
        4 => {
            let grid = [0.0, 3.0, a + 3.0, a + 6.0];
            (blocks(&grid, &[0.0, 3.0, b + 3.0, b + 6.0], &[0.0, w, 8.0], |i, j, k| k == 0 || i != 1 || j != 1), w)
        }
        5 => (blocks(&[0.0, 5.0, 5.0 + w, 10.0], &[0.0, a], &[0.0, 4.0, 4.0 + b], |i, _, k| k == 0 || i == 1), w),
        6 => (torus(a, w / 2.0, 60, 2 * (n / 2)), w),
        7 => {
            // The letter E as strokes, as wide as the plate's wall.
            let y = [0.0, w, 3.0, 3.0 + w, 6.0, 6.0 + w];
            (blocks(&[0.0, w, 4.0], &y, &[0.0, 2.0], |i, j, _| i == 0 || j % 2 == 0), w)
        }
        _ => {
            // A hollow ball, not centred.
            let ball = |r: f64| {
                let at = |i: usize| std::f64::consts::PI * (i as f64 / 36.0 - 0.5);
                revolved(
                    &(0..=36)
                        .map(|i| [if i % 36 == 0 { 0.0 } else { r * at(i).cos() }, r * at(i).sin()])
                        .collect::<Vec<_>>(),
                    72,
                )
            };
            let (shift, r) = (DVec3::new(0.3, 0.2, 0.4), 6.0);
            (joined(ball(r + w + shift.length()), &moved(flipped(ball(r)), shift)), w)
        }
    }
}

#[test]
fn known_walls_of_random_shapes_are_found_within_two_percent() {
    let mut random = Random(2027);
    for i in 0..24 {
        let (shape, w) = known(&mut random);
        let splits = if shape.faces.len() < 2000 { 30 } else { 0 };
        let shape = split(shape, splits, &mut random);
        let scale = [1.0, 64.0, 1.0 / 1024.0][i % 3];
        let shape = scaled(turned(shape, &mut random), scale);
        let least = with_context(|context| least_thickness(&shape, Space::Material, context)).unwrap();
        let found = least.pair.unwrap().thickness / scale;
        assert!(least.is_complete && (found / w - 1.0).abs() < 0.02, "shape {i}: {found} for {w}");
        let (below, above) = (w * scale * 0.975, w * scale * 1.025);
        let run = |limit: f64| with_context(|c| opposed_pairs(&shape, limit, Space::Material, c)).unwrap().walls;
        assert!(run(below).is_empty() && !run(above).is_empty(), "shape {i}");
    }
}
