use std::f64::consts::{FRAC_PI_2, SQRT_2};
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use super::*;
use crate::context::NoProgress;
use crate::inspect::{Answer, measures, shells};
use crate::mesh::Soup;

fn of(positions: &[DVec3], faces: &[[u32; 3]]) -> Statistics {
    let soup = Soup { positions: positions.to_vec(), faces: faces.to_vec() };
    let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::MAX);
    let analysis = Analysis::new((&soup).into(), &context).unwrap();
    let (_, turning) = shells(&analysis, &context).unwrap();
    let attributes = Attributes::new(&measures(&analysis, &context).unwrap(), &turning);
    statistics(&analysis, &attributes, &turning, &context).unwrap()
}

const CORNER: [DVec3; 4] = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
const TETRAHEDRON: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];

/// A unit box of 12 faces, turned outward.
fn unit_box() -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let positions = (0..8).map(|i| DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2))).collect();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    (positions, quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect())
}

fn turned(faces: &[[u32; 3]]) -> Vec<[u32; 3]> {
    faces.iter().map(|&[a, b, c]| [a, c, b]).collect()
}

#[track_caller]
fn assert_near(found: f64, expected: f64) {
    assert!((found - expected).abs() <= 1e-12 * expected.abs().max(1.0), "{found} is not {expected}");
}

#[test]
fn a_corner_of_a_cube_has_the_figures_that_a_hand_finds() {
    let it = of(&CORNER, &TETRAHEDRON);
    let (area, ratio, length) = (it.face_area.unwrap(), it.face_aspect_ratio.unwrap(), it.edge_length.unwrap());
    assert_eq!((area.count, area.min, area.median), (4, 0.5, 0.5));
    assert_near(area.max, 3f64.sqrt() / 2.0);
    assert_near(area.mean, (1.5 + 3f64.sqrt() / 2.0) / 4.0);
    // Three right triangles with an altitude of 1 / sqrt(2) on an edge of sqrt(2), and an equilateral one.
    assert_near(ratio.max, 2.0);
    assert_near(ratio.min, 2.0 / 3f64.sqrt());
    assert_eq!((length.count, length.min, length.max), (6, 1.0, SQRT_2));
    assert_near(length.median, f64::midpoint(1.0, SQRT_2));
    assert_near(length.variance, ((SQRT_2 - 1.0) / 2.0).powi(2));
    let angle = it.edge_angle.distribution.unwrap();
    assert_eq!((angle.count, it.edge_angle.side), (6, Some(Side::Exterior)));
    assert_near(angle.max, TAU - (1.0 / 3f64.sqrt()).acos());
    assert_near(angle.min, 1.5 * PI);
}

#[test]
fn angles_of_a_box_are_exterior_where_it_is_outward_and_interior_where_it_is_inward() {
    let (positions, faces) = unit_box();
    let it = of(&positions, &faces).edge_angle;
    let angles = it.distribution.unwrap();
    assert_eq!((it.side, it.not_measurable), (Some(Side::Exterior), None));
    assert_eq!((angles.count, angles.min, angles.max), (18, PI, PI + FRAC_PI_2));
    // Flat edges are in the middle bin of 17.
    assert_eq!((angles.histogram.counts[8], angles.histogram.counts[12]), (6, 12));
    let it = of(&positions, &turned(&faces)).edge_angle;
    let angles = it.distribution.unwrap();
    assert_eq!((it.side, angles.min, angles.max), (Some(Side::Interior), FRAC_PI_2, PI));
    assert_eq!((angles.histogram.counts[8], angles.histogram.counts[4]), (6, 12));
}

#[test]
fn boundary_edges_have_no_angle_and_an_open_mesh_has_no_side() {
    let (positions, faces) = unit_box();
    let it = of(&positions, &faces[..10]).edge_angle;
    // Of the 17 edges that are left, four bound the hole.
    assert_eq!(it.distribution.unwrap().count, 13);
    assert_eq!(it.side, None);
}

#[test]
fn angles_need_a_manifold_and_consistent_mesh_and_say_so() {
    let positions = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z, DVec3::NEG_Y];
    let it = of(&positions, &[[0, 1, 2], [1, 0, 3], [0, 1, 4]]).edge_angle;
    assert_eq!((it.distribution, it.not_measurable), (None, Some(Unmeasurable::NotManifold)));
    let it = of(&positions, &[[0, 1, 2], [0, 1, 3]]).edge_angle;
    assert_eq!((it.distribution, it.not_measurable), (None, Some(Unmeasurable::NotConsistent)));
    let it = of(&positions, &[[0, 1, 2]]).edge_angle;
    assert_eq!((it.distribution, it.not_measurable), (None, Some(Unmeasurable::NoElement)));
}

#[test]
fn a_dent_is_below_flat_and_a_ridge_above_by_the_least_bit() {
    let fold = |height: f64| {
        let positions = [DVec3::ZERO, DVec3::X, DVec3::new(0.5, 1.0, 0.0), DVec3::new(0.5, -1.0, height)];
        of(&positions, &[[0, 1, 2], [1, 0, 3]]).edge_angle.distribution.unwrap().min
    };
    assert_eq!(fold(0.0), PI);
    assert!(fold(1e-9) < PI && fold(-1e-9) > PI);
    assert_near(fold(1.0), PI - PI / 4.0);
    assert_near(fold(-1.0), PI + PI / 4.0);
}

#[test]
fn faces_that_lie_on_each_other_have_the_angle_zero() {
    let positions = [DVec3::ZERO, DVec3::X, DVec3::new(0.5, 1.0, 0.0), DVec3::new(0.4, 0.9, 0.0)];
    assert_eq!(of(&positions, &[[0, 1, 2], [1, 0, 3]]).edge_angle.distribution.unwrap().min, 0.0);
}

#[test]
fn degenerate_faces_have_no_aspect_ratio_no_area_and_no_angle() {
    // Three points of a line that no f64 holds exactly but for its multiples, and one a bit off it.
    let d = DVec3::new(0.1, 0.3, 0.7);
    let off = DVec3::new(d.x * 4.0, d.y * 4.0, f64::from_bits((d.z * 4.0).to_bits() + 1));
    let positions = [d, d * 2.0, d * 4.0, DVec3::X, off];
    let it = of(&positions, &[[0, 1, 2], [1, 0, 3], [0, 0, 3]]);
    assert_eq!((it.faces_without_aspect_ratio, it.face_aspect_ratio.unwrap().count), (2, 1));
    let area = it.face_area.unwrap();
    assert_eq!((area.count, area.min, area.median), (3, 0.0, 0.0));
    assert_eq!(it.edge_angle.edges_without_angle, 1);
    let it = of(&positions, &[[0, 1, 4]]);
    assert_eq!(it.faces_without_aspect_ratio, 0);
    assert!(it.face_aspect_ratio.unwrap().min > 1e12);
}

#[test]
fn a_scale_by_a_power_of_two_scales_every_figure_exactly_and_leaves_angles() {
    let (positions, faces) = unit_box();
    let odd: Vec<DVec3> = positions.iter().map(|p| DVec3::new(p.x * 0.7, p.y + p.x * 0.1, p.z * 1.3)).collect();
    let given = of(&odd, &faces);
    for scale in [2f64.powi(40), 2f64.powi(-40)] {
        let scaled: Vec<DVec3> = odd.iter().map(|p| *p * scale).collect();
        let it = of(&scaled, &faces);
        assert_eq!(it.face_area, given.face_area.clone().map(|area| area.in_unit(scale, 2)));
        assert_eq!(it.edge_length, given.edge_length.clone().map(|length| length.in_unit(scale, 1)));
        assert_eq!((&it.face_aspect_ratio, &it.edge_angle), (&given.face_aspect_ratio, &given.edge_angle));
    }
}

#[test]
fn coordinates_of_any_size_give_finite_figures_and_the_same_shapes() {
    let (positions, faces) = unit_box();
    for scale in [1e300, 1e-300, f64::MAX, f64::MIN_POSITIVE] {
        let scaled: Vec<DVec3> = positions.iter().map(|p| *p * scale).collect();
        let it = of(&scaled, &faces);
        let (area, length) = (it.face_area.unwrap(), it.edge_length.unwrap());
        assert!([area.min, area.max, area.mean, area.variance, length.variance].iter().all(|x| x.is_finite()));
        assert_near(length.min / scale, 1.0);
        assert_near(it.face_aspect_ratio.unwrap().max, 2.0);
        assert_eq!(it.edge_angle.distribution.unwrap().max, 1.5 * PI);
    }
}

#[test]
fn a_needle_beside_a_large_face_keeps_its_shape() {
    let tiny = 1e-80;
    let positions = [DVec3::ZERO, DVec3::X * tiny, DVec3::Y * tiny, DVec3::X, DVec3::Y, DVec3::Z];
    let it = of(&positions, &[[0, 1, 2], [3, 4, 5]]);
    let (ratio, length) = (it.face_aspect_ratio.unwrap(), it.edge_length.unwrap());
    assert_near(ratio.max, 2.0);
    assert_near(length.min / tiny, 1.0);
    assert_near(it.face_area.unwrap().min / tiny / tiny, 0.5);
}

#[test]
fn attributes_that_others_assume_are_not_measurable_without_them() {
    let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::MAX);
    let of = |faces: &[[u32; 3]]| {
        let mut positions = CORNER.to_vec();
        positions.extend([DVec3::NEG_Y, DVec3::NEG_X, DVec3::NEG_Z]);
        let soup = Soup { positions, faces: faces.to_vec() };
        let analysis = Analysis::new((&soup).into(), &context).unwrap();
        let (_, turning) = shells(&analysis, &context).unwrap();
        let it = Attributes::new(&measures(&analysis, &context).unwrap(), &turning);
        [it.closed, it.manifold, it.consistent, it.outward]
    };
    use Answer::{No, NotMeasurable, Yes};
    assert_eq!(of(&TETRAHEDRON), [Yes, Yes, Yes, Yes]);
    assert_eq!(of(&turned(&TETRAHEDRON)), [Yes, Yes, Yes, No]);
    assert_eq!(of(&TETRAHEDRON[..3]), [No, Yes, Yes, NotMeasurable]);
    let mut one_flipped = TETRAHEDRON;
    one_flipped[0].swap(0, 1);
    assert_eq!(of(&one_flipped), [Yes, Yes, No, NotMeasurable]);
    // Two tetrahedra on one edge: closed, for its edges have two faces or more, and no manifold.
    let two = [TETRAHEDRON.to_vec(), vec![[0, 3, 4], [0, 4, 5], [3, 5, 4], [0, 5, 3]]].concat();
    assert_eq!(of(&two), [Yes, No, NotMeasurable, NotMeasurable]);
}
