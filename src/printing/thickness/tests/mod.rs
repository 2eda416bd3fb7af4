//! Tests of the wall thickness: shapes with known walls, and a search over all pairs of faces as the oracle.

mod brute;
mod earlier;
mod field;
mod kinds;
mod shapes;

use crate::mesh::Surface;
use glam::DVec3;

use super::*;
use shapes::*;

fn search(surface: &Surface, below: f64, side: Space) -> OpposedPairs {
    let found = with_context(|context| opposed_pairs(surface, below, side, context)).unwrap();
    assert!(found.is_complete, "{:?}", found.undecided_faces);
    found
}

fn least(surface: &Surface, below: f64, side: Space) -> Option<f64> {
    search(surface, below, side).walls.iter().map(|pair| pair.thickness).min_by(f64::total_cmp)
}

#[test]
fn a_plate_of_exactly_the_limit_is_not_thin_and_an_ulp_less_is() {
    for w in [0.8, 1.0, 0.3] {
        let plate = cuboid([20.0, 30.0, w]);
        assert_eq!(least(&plate, w, Space::Material), None);
        assert_eq!(least(&plate, w.next_up(), Space::Material), Some(w));
    }
}

#[test]
fn every_face_of_a_thin_plate_but_its_rim_has_a_witness() {
    let mut random = Random(1);
    for i in 0..20 {
        let w = random.between(0.2, 0.9);
        let plate = split(cuboid([20.0, 30.0, w]), 60, &mut random);
        let plate = scaled(turned(plate, &mut random), [1.0, 1024.0, 1.0 / 4096.0][i % 3]);
        let scale = [1.0, 1024.0, 1.0 / 4096.0][i % 3];
        let found = search(&plate, scale, Space::Material);
        for pair in &found.walls {
            assert!((pair.thickness / (w * scale) - 1.0).abs() < 1e-9);
            assert!((pair.points[0].distance(pair.points[1]) - pair.distance).abs() < 1e-9 * scale);
        }
        let is_thin = |f: u32| found.walls.iter().any(|pair| pair.faces[0] == f);
        for f in 0..plate.faces.len() {
            // The two large sides came from the faces 8 to 11 of the box.
            assert_eq!(is_thin(f as u32), plate.source[f] >= 8, "{f}");
        }
        assert!(found.tips.is_empty());
    }
}

#[test]
fn a_prism_is_as_thick_as_its_flats_are_apart() {
    for n in [4, 6, 8, 10, 12, 16, 20, 24, 50, 64] {
        let pin = prism(n, 0.5, 9.0);
        let found = least(&pin, 1.01, Space::Material).unwrap();
        assert!((found - 1.0).abs() < 1e-6, "{n} {found}");
        assert_eq!(least(&pin, 1.0 - 1e-6, Space::Material), None, "{n}");
    }
}

#[test]
fn a_tube_and_a_torus_are_as_thick_as_their_walls() {
    for n in [24, 60, 96] {
        let outer = 5.0 / (std::f64::consts::PI / n as f64).cos();
        let tube = revolved(&[[4.4, 0.0], [outer, 0.0], [outer, 10.0], [4.4, 10.0]], n);
        let found = least(&tube, 1.0, Space::Material).unwrap();
        let wall = 5.0 - 4.4 * (std::f64::consts::PI / n as f64).cos();
        assert!((found - wall).abs() < 1e-9, "{n} {found} {wall}");
    }
    for n in [24, 48, 100] {
        let ring = torus(6.0, 0.5, n, 24);
        let found = least(&ring, 1.2, Space::Material).unwrap();
        assert!((found - 1.0).abs() < 0.02, "{n} {found}");
        assert_eq!(least(&ring, 0.97, Space::Material), None);
    }
}

#[test]
fn a_wedge_is_a_tip_below_37_degrees_and_nothing_above() {
    for (degrees, is_tip) in [(5.0, true), (20.0, true), (36.8, true), (37.0, false), (60.0, false), (90.0, false)] {
        let (sin, cos) = f64::to_radians(degrees).sin_cos();
        let top = DVec3::new(10.0 * cos, 0.0, 10.0 * sin);
        let far = DVec3::Y * 8.0;
        let [a, b, c] = [DVec3::ZERO, DVec3::X * 10.0, top];
        let [d, e, f] = [a, b, c].map(|p| p + far);
        let wedge = welded(&[[a, b, c], [d, f, e], [a, d, e], [a, e, b], [b, e, f], [b, f, c], [c, f, d], [c, d, a]]);
        let mut random = Random(7);
        for wedge in [wedge.clone(), turned(split(wedge, 100, &mut random), &mut random)] {
            let found = search(&wedge, 1.0, Space::Material);
            assert_eq!(!found.tips.is_empty(), is_tip, "{degrees}");
            assert!(found.walls.is_empty(), "{degrees} {:?}", found.walls);
        }
    }
}

#[test]
fn edges_and_corners_of_a_thick_box_are_no_walls() {
    let mut random = Random(5);
    let cube = split(cuboid([9.0, 9.0, 9.0]), 300, &mut random);
    assert_eq!(search(&turned(cube, &mut random), 8.99, Space::Material).walls, []);
}

#[test]
fn a_truncated_wedge_is_as_thick_as_its_end() {
    for degrees in [4.0f64, 10.0, 20.0] {
        let rise = 10.0 * f64::to_radians(degrees / 2.0).tan();
        let outline = [[0.0, -0.3], [10.0, -0.3 - rise], [10.0, 0.3 + rise], [0.0, 0.3]];
        let at = |[x, z]: [f64; 2], y: f64| DVec3::new(x, y, z);
        let mut triangles = Vec::new();
        for (i, a) in outline.into_iter().enumerate() {
            let b = outline[(i + 1) % 4];
            triangles.push([at(a, 0.0), at(b, 0.0), at(b, 8.0)].map(|p| p));
            triangles.push([at(a, 0.0), at(b, 8.0), at(a, 8.0)]);
        }
        for y in [0.0, 8.0] {
            let [a, b, c, d] = outline.map(|p| at(p, y));
            triangles.extend(if y == 0.0 { [[a, c, b], [a, d, c]] } else { [[a, b, c], [a, c, d]] });
        }
        let fin = welded(&triangles);
        let volume: f64 = (0..fin.faces.len())
            .map(|f| {
                let [a, b, c] = fin.corners(f);
                a.dot(b.cross(c))
            })
            .sum();
        let fin = if volume < 0.0 { flipped(fin) } else { fin };
        let found = least(&fin, 1.0, Space::Material).unwrap();
        assert!((found / 0.6 - 1.0).abs() < 0.02, "{degrees} {found}");
    }
}

#[test]
fn a_neck_between_two_blocks_is_found_at_its_edges() {
    // Two blocks that overlap only near one edge: the neck is the diagonal between two concave edges.
    let s = blocks(&[0.0, 5.0, 5.3, 10.0], &[0.0, 4.0], &[0.0, 5.0, 5.4, 10.0], |i, _, k| {
        (i <= 1 && k <= 1) || (i >= 1 && k >= 1)
    });
    let found = least(&s, 1.0, Space::Material);
    assert!((found.unwrap() - 0.5).abs() < 1e-9, "{found:?}");
}

#[test]
fn a_groove_opposite_a_wall_is_measured_at_its_bottom() {
    // A plate 3 thick with a 90 degree groove that leaves 0.5.
    let outline = [[-9.0, 0.0], [9.0, 0.0], [9.0, 3.0], [2.5, 3.0], [0.0, 0.5], [-2.5, 3.0], [-9.0, 3.0]];
    let at = |[x, z]: [f64; 2], y: f64| DVec3::new(x, y, z);
    let mut triangles = Vec::new();
    for (i, a) in outline.into_iter().enumerate() {
        let b = outline[(i + 1) % outline.len()];
        triangles.push([at(a, 0.0), at(b, 8.0), at(b, 0.0)]);
        triangles.push([at(a, 0.0), at(a, 8.0), at(b, 8.0)]);
    }
    for y in [0.0, 8.0] {
        let p = outline.map(|p| at(p, y));
        for [i, j, k] in [[4, 6, 0], [4, 5, 6], [4, 0, 1], [4, 1, 2], [4, 2, 3]] {
            triangles.push(if y == 0.0 { [p[i], p[j], p[k]] } else { [p[i], p[k], p[j]] });
        }
    }
    let s = welded(&triangles);
    let volume: f64 = (0..s.faces.len())
        .map(|f| {
            let [a, b, c] = s.corners(f);
            a.dot(b.cross(c))
        })
        .sum();
    let s = if volume < 0.0 { flipped(s) } else { s };
    assert!(crate::mesh::ClosedSurface::try_from(&s).is_ok());
    let found = least(&s, 1.0, Space::Material);
    assert!((found.unwrap() - 0.5).abs() < 1e-9, "{found:?}");
}

#[test]
fn two_plates_have_the_gap_between_them_and_a_slot_its_width() {
    let plates = joined(cuboid([9.0, 9.0, 2.0]), &moved(cuboid([9.0, 9.0, 2.0]), DVec3::Z * 2.25));
    assert!((least(&plates, 0.5, Space::Air).unwrap() - 0.25).abs() < 1e-12);
    assert_eq!(least(&plates, 1.9, Space::Material), None);
    assert_eq!(least(&plates, 0.25, Space::Air), None);
    let comb = blocks(&[0.0, 3.0, 3.4, 6.0], &[0.0, 5.0], &[0.0, 2.0, 6.0], |i, _, k| k == 0 || i != 1);
    assert!((least(&comb, 0.5, Space::Air).unwrap() - 0.4).abs() < 1e-12);
    assert_eq!(least(&comb, 1.9, Space::Material), None);
}

#[test]
fn one_thin_spot_of_a_hollow_sphere_is_found() {
    let ball = |r: f64| {
        let outline: Vec<[f64; 2]> = (0..=40)
            .map(|i| {
                let a = std::f64::consts::PI * (i as f64 / 40.0 - 0.5);
                [if i % 40 == 0 { 0.0 } else { r * a.cos() }, r * a.sin()]
            })
            .collect();
        revolved(&outline, 80)
    };
    let shell = joined(ball(10.0), &moved(flipped(ball(8.0)), DVec3::new(0.9, 0.8, 0.7)));
    let e = (0.81f64 + 0.64 + 0.49).sqrt();
    let found = least(&shell, 1.0, Space::Material).unwrap();
    assert!((found / (2.0 - e) - 1.0).abs() < 0.02, "{found} {}", 2.0 - e);
}

#[test]
fn without_a_limit_the_wall_of_every_face_is_found() {
    let plate = cuboid([4.0, 3.0, 2.0]);
    for below in [f64::INFINITY, 1e300] {
        let found = search(&plate, below, Space::Material);
        assert_eq!(found.walls.iter().map(|pair| pair.thickness).fold(9.0, f64::min), 2.0);
        assert_eq!(found.walls.len(), 12);
    }
    for below in [0.0, -1.0] {
        assert!(search(&plate, below, Space::Material).walls.is_empty());
    }
}

#[test]
fn degenerate_and_empty_surfaces_have_no_walls() {
    let empty = Surface::default();
    assert!(search(&empty, 1.0, Space::Material).walls.is_empty());
    let flat = surface(vec![DVec3::ZERO, DVec3::X, DVec3::X * 2.0], vec![[0, 1, 2], [0, 2, 1], [0, 0, 1]]);
    assert!(search(&flat, 1.0, Space::Air).walls.is_empty());
    let found = with_context(|context| thin_features(&flat, 1.0, Space::Material, context)).unwrap();
    assert!(found.regions.is_empty());
    with_context(|context| thickness_field(&flat, Space::Material, context)).unwrap();
    with_context(|context| thickness_field(&empty, Space::Material, context)).unwrap();
    with_context(|context| least_thickness(&empty, Space::Material, context)).unwrap();
}
