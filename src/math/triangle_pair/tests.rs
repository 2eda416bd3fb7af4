//! Tests of pairs of triangles, against exact arithmetic.

use glam::DVec3;
use proptest::prelude::*;

use super::*;
use crate::math::collinear;

/// An independent implementation: clips one triangle by the plane and the edges of the other in integers.
mod exact {
    use super::Contact;

    /// `[x, y, z, w]` stands for the point `(x, y, z) / w` with `w > 0`.
    type Point = [i128; 4];
    type Vector = [i128; 3];

    fn gcd(a: i128, b: i128) -> i128 {
        if b == 0 { a.abs() } else { gcd(b, a % b) }
    }

    fn minus(a: Vector, b: Vector) -> Vector {
        [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
    }

    fn cross(a: Vector, b: Vector) -> Vector {
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    }

    /// `w` times the height of a point over the plane through `at` with a normal.
    fn height(normal: Vector, at: Vector, p: Point) -> i128 {
        (0..3).map(|k| normal[k] * (p[k] - at[k] * p[3])).sum()
    }

    fn clip(polygon: &[Point], height: impl Fn(Point) -> i128) -> Vec<Point> {
        let mut part = Vec::new();
        for (k, &a) in polygon.iter().enumerate() {
            let b = polygon[(k + 1) % polygon.len()];
            let (at_a, at_b) = (height(a), height(b));
            if at_a >= 0 {
                part.push(a);
            }
            if at_a.signum() * at_b.signum() < 0 {
                // The heights are scaled by each point's own denominator, as this formula needs them.
                let (s, t) = (at_a.abs(), at_b.abs());
                let p = [0, 1, 2, 3].map(|k| a[k] * t + b[k] * s);
                let divisor = p.into_iter().fold(0, gcd);
                part.push(p.map(|x| x / divisor));
            }
        }
        part.sort_unstable();
        part.dedup();
        part
    }

    /// Whether a point of the triangle's plane lies in its interior.
    fn within(t: [Vector; 3], normal: Vector, p: Point) -> bool {
        (0..3).all(|k| height(cross(normal, minus(t[(k + 1) % 3], t[k])), t[k], p) > 0)
    }

    pub fn contact(p: [Vector; 3], q: [Vector; 3]) -> Contact {
        let normal = |t: [Vector; 3]| cross(minus(t[1], t[0]), minus(t[2], t[0]));
        let (np, nq) = (normal(p), normal(q));
        let mut common: Vec<Point> = p.iter().map(|v| [v[0], v[1], v[2], 1]).collect();
        let coplanar = common.iter().all(|&v| height(nq, q[0], v) == 0);
        common = clip(&common, |v| height(nq, q[0], v));
        common = clip(&common, |v| -height(nq, q[0], v));
        for k in 0..3 {
            common = in_order(common, np);
            common = clip(&common, |v| height(cross(nq, minus(q[(k + 1) % 3], q[k])), q[k], v));
        }
        let shared: Vec<Vector> = p.into_iter().filter(|v| q.contains(v)).collect();
        let beyond = common.iter().any(|&v| match shared[..] {
            [] => true,
            [a] => v != [a[0], a[1], a[2], 1],
            [a, b, ..] => height_off_line(a, b, v),
        });
        let spread = common.iter().skip(2).any(|&v| {
            let [a, b] = [common[0], common[1]];
            let on = |x: Point, w: i128| [x[0] * w, x[1] * w, x[2] * w];
            let u = minus(on(b, a[3]), on(a, b[3]));
            let w = minus(on(v, a[3]), on(a, v[3]));
            cross(u, w) != [0; 3]
        });
        match common.len() {
            _ if shared.len() == 3 => Contact::Same,
            0 => Contact::Disjoint,
            _ if !beyond => Contact::Neighbours,
            _ if coplanar && spread => Contact::Coplanar,
            _ if coplanar => Contact::Touching,
            _ => {
                let middle = middle(&common);
                if within(p, np, middle) && within(q, nq, middle) { Contact::Crossing } else { Contact::Touching }
            }
        }
    }

    /// Whether a point is off the segment between `a` and `b`, being in both triangles.
    fn height_off_line(a: Vector, b: Vector, v: Point) -> bool {
        let scaled = |x: Vector| [x[0] * v[3], x[1] * v[3], x[2] * v[3]];
        cross(minus(scaled(b), scaled(a)), minus([v[0], v[1], v[2]], scaled(a))) != [0; 3]
    }

    /// A middle of at most two points.
    fn middle(points: &[Point]) -> Point {
        let (a, b) = (points[0], points[points.len() - 1]);
        [a[0] * b[3] + b[0] * a[3], a[1] * b[3] + b[1] * a[3], a[2] * b[3] + b[2] * a[3], 2 * a[3] * b[3]]
    }

    /// The corners of a convex polygon around it; clipping sorts them.
    fn in_order(mut points: Vec<Point>, normal: Vector) -> Vec<Point> {
        if points.len() > 3 {
            let first = points[0];
            let from_first = |x: Point| {
                minus(
                    [x[0] * first[3], x[1] * first[3], x[2] * first[3]],
                    [first[0] * x[3], first[1] * x[3], first[2] * x[3]],
                )
            };
            points[1..].sort_by(|&x, &y| {
                let turn = cross(from_first(x), from_first(y));
                0.cmp(&(0..3).map(|k| turn[k] * normal[k]).sum::<i128>())
            });
        }
        points
    }
}

/// Two triangles with area whose corners are among a few points of a small grid, so that they share vertices and meet
/// in every way. The flatter the grid, the more pairs are coplanar.
fn pair() -> impl Strategy<Value = [[i128; 3]; 6]> {
    let points = (0i128..=2).prop_flat_map(|depth| proptest::array::uniform8((-2i128..=2, -2i128..=2, -depth..=depth)));
    let corners = (points, proptest::array::uniform6(0usize..8));
    let corners = corners.prop_map(|(points, picks)| picks.map(|k| <[i128; 3]>::from(points[k])));
    corners.prop_filter("a triangle without area", |c| !flat(&c[..3]) && !flat(&c[3..]))
}

fn numbered(corners: &[[i128; 3]; 6], place: impl Fn([i128; 3]) -> DVec3) -> (Vec<DVec3>, [u32; 6]) {
    let mut different: Vec<[i128; 3]> = Vec::new();
    let numbers = corners.map(|c| {
        let found = different.iter().position(|&d| d == c);
        found.unwrap_or_else(|| {
            different.push(c);
            different.len() - 1
        }) as u32
    });
    (different.into_iter().map(place).collect(), numbers)
}

fn as_given([x, y, z]: [i128; 3]) -> DVec3 {
    DVec3::new(x as f64, y as f64, z as f64)
}

fn flat(t: &[[i128; 3]]) -> bool {
    collinear(as_given(t[0]), as_given(t[1]), as_given(t[2]))
}

/// All orders of three.
const ORDERS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3000))]

    #[test]
    fn contacts_agree_with_whole_number_clipping_in_every_order(corners in pair()) {
        let (p, q) = ([corners[0], corners[1], corners[2]], [corners[3], corners[4], corners[5]]);
        let expected = exact::contact(p, q);
        prop_assert_eq!(exact::contact(q, p), expected);
        let (positions, n) = numbered(&corners, as_given);
        for i in ORDERS {
            for j in ORDERS {
                let (a, b) = (i.map(|k| n[k]), j.map(|k| n[3 + k]));
                prop_assert_eq!(contact(&positions, a, b, &mut 0), expected);
                prop_assert_eq!(contact(&positions, b, a, &mut 0), expected);
            }
        }
    }

    #[test]
    fn rotating_mirroring_scaling_and_shearing_change_no_contact(corners in pair(), axes in 0usize..6, signs in 0u32..8,
                                                      exponent in -40i32..=0, shear in -3i32..=3) {
        let (p, q) = ([corners[0], corners[1], corners[2]], [corners[3], corners[4], corners[5]]);
        let expected = exact::contact(p, q);
        let (positions, n) = numbered(&corners, |c| {
            let mut v = as_given(ORDERS[axes].map(|k| if signs >> k & 1 == 1 { -c[k] } else { c[k] }));
            // A sheared lattice point is still exact, and no plane is axis-aligned any longer.
            v.x += f64::from(shear) * (v.y + 1.0 / 1024.0) + v.z * 7.0;
            v.y += f64::from(shear) * v.z;
            v * f64::from(exponent).exp2()
        });
        let found = contact(&positions, [n[0], n[1], n[2]], [n[3], n[4], n[5]], &mut 0);
        prop_assert_eq!(found, expected);
    }

    #[test]
    fn the_common_point_is_in_both_triangles(corners in pair()) {
        let (p, q) = ([corners[0], corners[1], corners[2]], [corners[3], corners[4], corners[5]]);
        let found = exact::contact(p, q);
        if !matches!(found, Contact::Touching | Contact::Crossing | Contact::Coplanar) {
            return Ok(());
        }
        let (p, q) = (p.map(as_given), q.map(as_given));
        let normal = (q[1] - q[0]).cross(q[2] - q[0]);
        let coplanar = p.iter().all(|&x| normal.dot(x - q[0]) == 0.0);
        let at = common_point(&p, &q, coplanar);
        prop_assert!(crate::math::within(at, p, 1e-9) && crate::math::within(at, q, 1e-9), "{at}");
    }
}

#[test]
fn the_generated_pairs_cover_every_kind_of_contact() {
    use proptest::strategy::ValueTree;
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let mut counts = [0; 6];
    for _ in 0..2000 {
        let c = pair().new_tree(&mut runner).expect("a pair").current();
        counts[exact::contact([c[0], c[1], c[2]], [c[3], c[4], c[5]]) as usize] += 1;
    }
    assert!(counts.iter().all(|&n| n > 20), "{counts:?}");
}

#[test]
fn a_vertex_one_bit_below_a_face_crosses_it_and_on_it_touches() {
    let x = 1.0 / 3.0;
    let mut positions = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::new(x, x, 0.0), DVec3::new(x, 0.2, 1.0)];
    positions.push(DVec3::new(0.2, x, 1.0));
    let mut slow = 0;
    assert_eq!(contact(&positions, [0, 1, 2], [3, 4, 5], &mut slow), Contact::Touching);
    positions[3].z = -f64::EPSILON;
    assert_eq!(contact(&positions, [0, 1, 2], [3, 4, 5], &mut slow), Contact::Crossing);
    positions[3].z = f64::EPSILON;
    assert_eq!(contact(&positions, [0, 1, 2], [3, 4, 5], &mut slow), Contact::Disjoint);
}

#[test]
fn determinants_that_floating_point_cannot_decide_are_counted() {
    let tilt = |x: f64, y: f64| DVec3::new(x, y, 0.1 * x + 0.7 * y);
    let positions: Vec<DVec3> =
        [(0.0, 0.0), (0.3, 0.1), (0.1, 0.3), (0.2, 0.9), (0.7, 0.7), (0.9, 0.1)].map(|(x, y)| tilt(x, y)).to_vec();
    let mut slow = 0;
    assert_eq!(contact(&positions, [0, 1, 2], [3, 4, 5], &mut slow), Contact::Disjoint);
    assert!(slow > 0);
}
