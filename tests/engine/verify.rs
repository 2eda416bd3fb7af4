//! The check of changed faces alone agrees with the check of all faces.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use glam::DVec3;
use meshmend::format::{Format, Limits, write};
use meshmend::inspect::{Analysis, Intersections, intersections};
use meshmend::mesh::Soup;
use meshmend::repair::{Context, NoProgress, Options, Verify, repair};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use serde_json::Value;

use crate::damage::{DAMAGES, Random, SOLIDS};
use crate::meshes::{cube, join, push, sphere};
use crate::support::with_context;

/// The intersections of `mesh`, of which those among faces of `earlier` are taken over.
fn taken_over(mesh: &Soup, earlier: &Soup) -> Intersections {
    with_context(|context| {
        let earlier = Analysis::new(earlier.into(), context).unwrap();
        earlier.intersections(context).unwrap();
        let mut analysis = Analysis::new(mesh.into(), context).unwrap();
        analysis.reuse_intersections(earlier.known_intersections());
        intersections(&analysis, context).unwrap()
    })
}

fn searched(mesh: &Soup) -> Intersections {
    with_context(|context| intersections(&Analysis::new(mesh.into(), context).unwrap(), context).unwrap())
}

/// Triangles on a coarse grid: many touch, cross, lie in one plane, share corners, are flat or repeat.
fn triangles(count: std::ops::Range<usize>) -> impl Strategy<Value = Vec<[DVec3; 3]>> {
    let corner = proptest::array::uniform3(0u8..5).prop_map(|c| DVec3::from(c.map(f64::from)));
    proptest::collection::vec(proptest::array::uniform3(corner), count)
}

fn soup_of(triangles: impl IntoIterator<Item = [DVec3; 3]>) -> Soup {
    let mut soup = Soup::default();
    triangles.into_iter().for_each(|triangle| push(&mut soup, triangle));
    soup
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn taken_over_pairs_and_searched_pairs_are_all_pairs(
        before in triangles(0..40),
        stays in proptest::collection::vec(0u8..4, 40),
        added in triangles(0..8),
        first in 0usize..40,
    ) {
        // Of the earlier triangles some are gone, some are turned over, and all come in another order.
        let mut after: Vec<[DVec3; 3]> = added;
        for (&[a, b, c], stays) in before.iter().zip(stays) {
            match stays {
                0 => {}
                1 => after.push([c, b, a]),
                _ => after.push([b, c, a]),
            }
        }
        let turn = first % after.len().max(1);
        after.rotate_left(turn);
        let (earlier, mesh) = (soup_of(before), soup_of(after));
        let (reused, all) = (taken_over(&mesh, &earlier), searched(&mesh));
        prop_assert_eq!(&reused.pairs, &all.pairs);
        prop_assert_eq!(reused.counts, all.counts);
        prop_assert_eq!(reused.takes_part, all.takes_part);
    }
}

/// The result and the report, without the options, of a repair by a clock that stands still.
fn repaired(bytes: &[u8], verify: Verify) -> (Vec<u8>, Value) {
    let options = Options { max_tier: 2, verify, ..Options::default() };
    let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(600));
    let repaired = repair(bytes, &options, &Limits::default(), None, &context).unwrap();
    let mut report = serde_json::to_value(&repaired.report).unwrap();
    report.as_object_mut().unwrap().remove("options");
    (repaired.bytes, report)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, rng_seed: RngSeed::Fixed(3), ..ProptestConfig::default() })]

    #[test]
    fn a_repair_is_the_same_whether_all_faces_are_verified_or_the_changed_ones(
        solid in 0..SOLIDS.len(), kinds in 1usize..1 << DAMAGES.len(), amount in 1usize..6, seed: u64,
    ) {
        let mut damaged = (SOLIDS[solid].1)();
        let mut random = Random::new(seed);
        for (i, (_, damage)) in DAMAGES.iter().enumerate() {
            if kinds >> i & 1 == 1 {
                damage(&mut damaged, amount, &mut random);
            }
        }
        let bytes = write(&damaged.soup, Format::Stl).unwrap();
        let [changed, full] = [Verify::Changed, Verify::Full].map(|verify| repaired(&bytes, verify));
        prop_assert_eq!(changed.0, full.0);
        prop_assert_eq!(changed.1, full.1);
    }
}

#[test]
fn faces_that_are_kept_and_intersect_are_still_found() {
    let ball = sphere(DVec3::ZERO, 1.0, 24, 12);
    let mut open = join(&ball, &cube(DVec3::splat(-0.3), 2.0, 4));
    let pairs = searched(&open).counts.pairs;
    assert!(pairs.is_some_and(|pairs| pairs > 10), "{pairs:?}");
    let earlier = open.clone();
    open.faces.pop();
    assert_eq!(taken_over(&open, &earlier).counts, searched(&open).counts);
}
