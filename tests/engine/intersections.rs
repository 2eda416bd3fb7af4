//! Detection of intersecting faces on whole meshes.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use glam::DVec3;
use meshmend::context::{Context, NoProgress};
use meshmend::inspect::{
    Analysis, DefectKind, InspectOptions, IntersectingPair, Intersections, Level, Meeting, inspect, intersections,
    intersections_between, measure,
};
use meshmend::mesh::Soup;
use proptest::prelude::*;

use crate::meshes::{cube, join, push, sphere, torus};
use crate::support::with_context;

fn intersections_of(soup: &Soup) -> Intersections {
    with_context(|context| intersections(&Analysis::new(soup.into(), context).unwrap(), context).unwrap())
}

fn pairs(soup: &Soup) -> Vec<IntersectingPair> {
    intersections_of(soup).pairs
}

/// Whether an edge of one triangle crosses the interior of the other, in integer arithmetic; none if they only touch.
fn pierced(p: [[i128; 3]; 3], q: [[i128; 3]; 3]) -> Option<bool> {
    let minus = |a: [i128; 3], b: [i128; 3]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    let volume = |a, b, c, d| {
        let (u, v, w) = (minus(b, a), minus(c, a), minus(d, a));
        (u[0] * (v[1] * w[2] - v[2] * w[1]) + u[1] * (v[2] * w[0] - v[0] * w[2]) + u[2] * (v[0] * w[1] - v[1] * w[0]))
            .signum()
    };
    let mut answer = false;
    for (t, s) in [(p, q), (q, p)] {
        for k in 0..3 {
            let (from, to) = (s[k], s[(k + 1) % 3]);
            let ends = [volume(t[0], t[1], t[2], from), volume(t[0], t[1], t[2], to)];
            let around = [0, 1, 2].map(|i| volume(from, to, t[i], t[(i + 1) % 3]));
            if ends.contains(&0) || around.contains(&0) {
                return None;
            }
            answer |= ends[0] != ends[1] && around.iter().all(|&a| a == around[0]);
        }
    }
    Some(answer)
}

/// Triangles with corners on a grid, none of which touch without crossing.
fn crossing_triangles() -> impl Strategy<Value = Vec<[[i128; 3]; 3]>> {
    let corner = || proptest::array::uniform3(-60i128..60);
    proptest::collection::vec(proptest::array::uniform3(corner()), 2..40)
}

fn soup_of(triangles: &[[[i128; 3]; 3]], place: impl Fn(DVec3) -> DVec3) -> Soup {
    let mut soup = Soup::default();
    for t in triangles {
        push(&mut soup, t.map(|[x, y, z]| place(DVec3::new(x as f64, y as f64, z as f64))));
    }
    soup
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn crossing_pairs_are_those_of_whole_numbers_in_any_order_turn_and_scale(
        triangles in crossing_triangles(), turn in 0usize..3, mirrored: bool, exponent in -900i32..900, first in 0usize..40
    ) {
        let mut expected = Vec::new();
        for g in 0..triangles.len() {
            for f in 0..g {
                match pierced(triangles[f], triangles[g]) {
                    None => return Ok(()),
                    Some(true) => expected.push([f as u32, g as u32]),
                    Some(false) => {}
                }
            }
        }
        expected.sort_unstable();
        let scale = f64::from(exponent).exp2();
        let place = |p: DVec3| {
            let p = p.to_array();
            let q = DVec3::new(p[turn], p[(turn + 1) % 3], p[(turn + 2) % 3]);
            (if mirrored { DVec3::new(-q.y, q.x, q.z) } else { q }) * scale
        };
        let all = intersections_of(&soup_of(&triangles, place));
        prop_assert_eq!(all.pairs.iter().map(|p| p.faces).collect::<Vec<_>>(), expected.clone());
        prop_assert_eq!(all.counts.crossing, expected.len() as u64);
        prop_assert_eq!(all.counts.pairs, Some(expected.len() as u64));

        // The same triangles in rotated order, each with rotated corners.
        let n = triangles.len();
        let moved: Vec<_> = (0..n).map(|k| { let [a, b, c] = triangles[(k + first) % n]; [b, c, a] }).collect();
        let mut back: Vec<[u32; 2]> = pairs(&soup_of(&moved, place)).iter().map(|p| {
            let mut faces = p.faces.map(|f| (f as usize + first) as u32 % n as u32);
            faces.sort_unstable();
            faces
        }).collect();
        back.sort_unstable();
        prop_assert_eq!(back, expected);
    }
}

#[test]
fn solids_without_self_intersections_have_no_pairs() {
    for soup in [cube(DVec3::ZERO, 1.0, 7), sphere(DVec3::ONE, 1.0, 40, 20), torus(2.0, 0.75, 60, 24)] {
        let file = intersections_of(&soup);
        assert!(file.counts.proven_none(), "{:?}", file.counts);
        assert!(with_context(|context| measure(&soup, context).unwrap()).printable());
    }
}

#[test]
fn a_corner_of_a_cube_in_another_is_between_parts_and_crosses() {
    let soup = join(&cube(DVec3::ZERO, 4.0, 1), &cube(DVec3::new(3.0, 2.9, 2.7), 4.0, 1));
    let file = intersections_of(&soup);
    let counts = file.counts;
    assert!(counts.crossing > 0 && counts.touching == 0 && counts.coplanar == 0, "{counts:?}");
    assert_eq!((counts.between_parts, counts.within_one_part), (counts.crossing, 0));
    assert!(file.pairs.iter().all(|p| p.faces[0] < 12 && p.faces[1] >= 12 && !p.within_one_part));
    let taking_part = file.takes_part[0].iter().filter(|&&t| t).count() as u64;
    assert_eq!(counts.faces, taking_part);
}

#[test]
fn a_box_on_another_box_touches_it_and_is_coplanar_with_it() {
    // The bottom of the small cube lies on the top of the large one, away from its diagonal.
    let soup = join(&cube(DVec3::ZERO, 8.0, 1), &cube(DVec3::new(5.0, 1.0, 8.0), 1.0, 1));
    let counts = intersections_of(&soup).counts;
    // Coplanar: the two triangles of the bottom. Touching: on each of the other four sides, one triangle with two corners
    // there and one triangle with one.
    assert_eq!((counts.coplanar, counts.touching, counts.crossing), (2, 8, 0), "{counts:?}");
}

#[test]
fn a_face_folded_back_on_its_neighbour_is_a_pair_within_one_part() {
    let mut soup = Soup::default();
    let [a, b] = [DVec3::ZERO, DVec3::X * 4.0];
    push(&mut soup, [a, b, DVec3::new(1.0, 3.0, 0.0)]);
    push(&mut soup, [b, a, DVec3::new(2.0, 2.0, 0.0)]);
    let pair = IntersectingPair { faces: [0, 1], meeting: Meeting::Coplanar, within_one_part: true };
    assert_eq!(pairs(&soup), [pair]);
    // Folded half as far, they share only their edge.
    soup.positions[5] = DVec3::new(2.0, 0.0, 2.0);
    assert_eq!(pairs(&soup), []);
}

#[test]
fn faces_without_area_and_duplicates_are_not_pairs() {
    let mut soup = Soup::default();
    let [a, b, c] = [DVec3::ZERO, DVec3::X * 4.0, DVec3::Y * 4.0];
    push(&mut soup, [a, b, c]);
    push(&mut soup, [a, b, c]);
    push(&mut soup, [c, b, a]);
    push(&mut soup, [DVec3::new(1.0, 1.0, -1.0), DVec3::new(1.0, 1.0, 1.0), DVec3::new(1.0, 1.0, 3.0)]);
    assert_eq!(pairs(&soup), []);
}

#[test]
fn faces_are_named_by_their_index_in_the_file() {
    let mut soup = Soup::default();
    push(&mut soup, [DVec3::NAN, DVec3::X, DVec3::Y]);
    push(&mut soup, [DVec3::ZERO, DVec3::X * 4.0, DVec3::Y * 4.0]);
    push(&mut soup, [DVec3::new(1.0, 1.0, -1.0), DVec3::new(1.0, 1.0, 1.0), DVec3::new(1.0, 3.0, 1.0)]);
    assert_eq!(pairs(&soup)[0].faces, [1, 2]);
}

#[test]
fn the_full_level_lists_pairs_with_their_places_and_the_basic_level_does_not_look() {
    let soup = join(&cube(DVec3::ZERO, 4.0, 1), &cube(DVec3::new(3.0, 2.9, 2.7), 4.0, 1));
    let at = |level| {
        with_context(|context| {
            inspect((&soup).into(), &InspectOptions { level, places: 3, ..InspectOptions::default() }, context).unwrap()
        })
    };
    let (full, findings) = at(Level::Full);
    let count = findings.count(DefectKind::SelfIntersection);
    assert_eq!(full.measures.self_intersections.pairs, Some(count));
    let group = full.defects.iter().find(|g| g.kind == DefectKind::SelfIntersection).unwrap();
    assert_eq!((group.count, group.places.len()), (count, 3));
    for defect in findings.places(DefectKind::SelfIntersection) {
        // The range that both boxes share.
        let inside = defect.at.iter().zip([3.0, 2.9, 2.7]).all(|(&x, low)| x > low - 1e-9 && x < 4.0 + 1e-9);
        assert!(inside && defect.faces.len() == 2 && defect.meeting == Some(Meeting::Crossing), "{defect:?}");
    }
    let marked = findings.marks.iter().filter(|&&m| m & DefectKind::SelfIntersection.bit() != 0).count() as u64;
    assert_eq!(marked, full.measures.self_intersections.faces);
    let (basic, findings) = at(Level::Basic);
    assert!(!basic.measures.self_intersections.checked && !basic.measures.printable());
    assert_eq!(findings.count(DefectKind::SelfIntersection), 0);
}

#[test]
fn intersections_are_the_same_on_any_number_of_threads() {
    let first = torus(2.0, 0.75, 90, 40);
    let mut second = first.clone();
    second.positions.iter_mut().for_each(|p| *p += DVec3::new(0.31, 0.17, 0.6));
    let soup = join(&first, &second);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| intersections_of(&soup))
    };
    let one = with(1);
    assert!(one.pairs.len() > 500);
    assert_eq!(one, with(3));
}

#[test]
fn a_search_stops_when_its_time_is_over() {
    // A fan of sheets around one axis: every face intersects every other.
    let mut soup = Soup::default();
    for i in 0..4000 {
        let angle = f64::from(i) * 1e-3;
        push(&mut soup, [DVec3::Z * -1.0, DVec3::Z * (1.0 + angle), DVec3::new(angle.cos(), angle.sin(), 0.5)]);
    }
    let asked = AtomicU64::new(0);
    let (cancel, clock) = (AtomicBool::new(false), || Duration::from_secs(asked.fetch_add(1, Ordering::Relaxed)));
    let patient = Context::new(&NoProgress, &cancel, &clock, Duration::MAX);
    let analysis = Analysis::new((&soup).into(), &patient).unwrap();
    let all = intersections(&analysis, &patient).unwrap();
    assert!(all.counts.pairs > Some(1_000_000));
    asked.store(0, Ordering::Relaxed);
    let hurried = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(6));
    assert!(intersections(&analysis, &hurried).is_err());
    assert!(asked.load(Ordering::Relaxed) < 8, "the context was checked {asked:?} times after cancellation");
}

#[test]
fn two_meshes_meet_where_they_touch_and_share_nothing_by_number() {
    let between = |a: &Soup, b: &Soup| {
        with_context(|context| {
            let [a, b] = [a, b].map(|soup| Analysis::new(soup.into(), context).unwrap());
            let there = intersections_between(&a, &b, context).unwrap();
            let back = intersections_between(&b, &a, context).unwrap();
            assert_eq!((there.counts, &there.takes_part[0]), (back.counts, &back.takes_part[1]));
            there
        })
    };
    let at = |x: f64, size: f64| cube(DVec3::new(x, x, x), size, 1);
    assert_eq!(between(&at(0.0, 1.0), &at(2.0, 1.0)).pairs, []);
    // Two corners coincide: each face at the one touches each face at the other.
    let corner = between(&at(0.0, 1.0), &at(1.0, 1.0));
    assert_eq!(corner.counts.touching, corner.counts.faces * corner.counts.faces / 4);
    assert!(corner.counts.touching >= 9 && corner.counts.crossing == 0 && corner.counts.coplanar == 0);
    // The same box: each face coincides with itself.
    let same = between(&at(0.0, 1.0), &at(0.0, 1.0));
    assert!((0..12).all(|f| same.pairs.iter().any(|p| p.faces == [f, f] && p.meeting == Meeting::Coplanar)));
    // A tiny box far inside a huge one intersects nothing; a tiny box across its wall does.
    assert_eq!(between(&at(-1e200, 2e200), &at(1.0, 1e-3)).pairs, []);
    assert!(between(&at(-1e200, 2e200), &at(1e200 - 1e190, 2e190)).counts.crossing > 0);
}
