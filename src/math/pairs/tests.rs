use std::convert::Infallible;

use glam::DVec3;
use proptest::prelude::*;

use super::*;
use crate::math::{Box3, Frame};

const NO_LIMIT: u64 = u64::MAX;

fn accept_all(_: u32, _: u32, _: &mut u64) -> Option<()> {
    Some(())
}

fn pairs_within(tree: &Tree) -> Vec<[u32; 2]> {
    let mut found = Vec::new();
    let search = PairSearch { look: accept_all, budget: NO_LIMIT, hubs: None };
    let Ok(complete) = search.within::<_, Infallible>(tree, |hits| {
        found.extend(hits.into_iter().map(|(pair, ())| pair));
        Ok(())
    });
    assert!(complete);
    found.sort_unstable();
    found
}

/// Triangles of all sizes, some axis-aligned, some only touching, near the origin or far from it.
fn triangles(seed: &[(u32, u32, u32, u8)], offset: DVec3) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let mut positions = Vec::new();
    for &(x, y, z, size) in seed {
        let at = DVec3::new(f64::from(x), f64::from(y), f64::from(z)) / 7.0 + offset;
        let reach = f64::from(size) / 7.0;
        positions.extend([at, at + DVec3::X * reach, at + DVec3::new(0.0, reach, reach * f64::from(size % 2))]);
    }
    let faces = (0..seed.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    (positions, faces)
}

fn boxes(positions: &[DVec3], faces: &[[u32; 3]]) -> Vec<Box3> {
    faces.iter().map(|f| Box3::of(f.map(|v| positions[v as usize]))).collect()
}

fn overlap(a: &Box3, b: &Box3) -> bool {
    a.min.cmple(b.max).all() && b.min.cmple(a.max).all()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn every_pair_whose_boxes_meet_is_visited_once(
        seed in proptest::collection::vec((0u32..20, 0u32..20, 0u32..20, 0u8..9), 0..120),
        offset in proptest::sample::select(vec![0.0, 1e3, -1e9, 1e15]),
    ) {
        let (positions, faces) = triangles(&seed, DVec3::new(offset, -offset, offset / 3.0));
        let found = pairs_within(&Tree::new(&positions, &faces));
        prop_assert!(found.windows(2).all(|w| w[0] < w[1]), "a pair came twice");
        let boxes = boxes(&positions, &faces);
        for g in 0..faces.len() {
            for f in 0..g {
                if overlap(&boxes[f], &boxes[g]) {
                    prop_assert!(found.binary_search(&[f as u32, g as u32]).is_ok(), "{f} {g}");
                }
            }
        }
    }

    #[test]
    fn every_pair_between_two_trees_whose_boxes_meet_is_visited_once(
        seed in proptest::collection::vec((0u32..20, 0u32..20, 0u32..20, 0u8..9), 2..120),
        share in 0usize..120,
    ) {
        let (positions, faces) = triangles(&seed, DVec3::splat(0.1));
        let (a, b) = faces.split_at(share.min(faces.len()));
        let frame = Frame::around(&positions, &faces);
        let (left, right) = (Tree::in_frame(frame, &positions, a), Tree::in_frame(frame, &positions, b));
        let mut found = Vec::new();
        let search = PairSearch { look: accept_all, budget: NO_LIMIT, hubs: None };
        let Ok(complete) = search.between::<_, Infallible>(&left, &right, |hits| {
            found.extend(hits.into_iter().map(|(pair, ())| pair));
            Ok(())
        });
        prop_assert!(complete);
        found.sort_unstable();
        prop_assert!(found.windows(2).all(|w| w[0] < w[1]), "a pair came twice");
        let (left, right) = (boxes(&positions, a), boxes(&positions, b));
        for (f, x) in left.iter().enumerate() {
            for (g, y) in right.iter().enumerate() {
                if overlap(x, y) {
                    prop_assert!(found.binary_search(&[f as u32, g as u32]).is_ok(), "{f} {g}");
                }
            }
        }
    }
}

proptest! {
    #[test]
    fn a_search_of_changed_triangles_visits_exactly_the_pairs_with_one(
        seed in proptest::collection::vec((0u32..9, 0u32..9, 0u32..9, 0u8..9), 0..80),
        changed in proptest::collection::vec(proptest::bool::weighted(0.2), 80),
    ) {
        let (positions, faces) = triangles(&seed, DVec3::ZERO);
        let tree = Tree::new(&positions, &faces);
        let mut expected = pairs_within(&tree);
        expected.retain(|pair| pair.iter().any(|&t| changed[t as usize]));
        let mut found = Vec::new();
        let search = PairSearch { look: accept_all, budget: NO_LIMIT, hubs: None };
        let Ok(complete) = search.within_changed::<_, Infallible>(&tree, &changed[..faces.len()], |hits| {
            found.extend(hits.into_iter().map(|(pair, ())| pair));
            Ok(())
        });
        prop_assert!(complete);
        found.sort_unstable();
        prop_assert_eq!(&found, &expected);
        let near = ChangedTriangles::new(&positions, &faces, &changed[..faces.len()]);
        prop_assert!(near.numbers.is_sorted());
        let is_near = |t: u32| near.numbers.binary_search(&t).is_ok();
        prop_assert!((0u32..).zip(&changed[..faces.len()]).all(|(t, &changed)| !changed || is_near(t)));
        let mut found_near = Vec::new();
        let Ok(complete) = near.search::<_, Infallible>(accept_all, NO_LIMIT, |hits| {
            found_near.extend(hits.into_iter().map(|(pair, ())| pair));
            Ok(())
        });
        prop_assert!(complete);
        let boxes = boxes(&positions, &faces);
        let meeting = expected.iter().filter(|pair| overlap(&boxes[pair[0] as usize], &boxes[pair[1] as usize]));
        for pair in meeting {
            prop_assert!(pair.iter().all(|&t| is_near(t)) && found_near.contains(pair), "{pair:?}");
        }
    }
}

#[test]
fn rounds_are_the_same_for_any_number_of_threads() {
    let seed: Vec<(u32, u32, u32, u8)> =
        (0..3000u32).map(|i| (i * 7 % 101, i * 13 % 97, i * 29 % 89, (i % 8) as u8)).collect();
    let (positions, faces) = triangles(&seed, DVec3::ZERO);
    let tree = Tree::new(&positions, &faces);
    let rounds = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        let mut rounds = Vec::new();
        let search = PairSearch { look: accept_all, budget: NO_LIMIT, hubs: None };
        let Ok(_) = pool.install(|| {
            search.within::<_, Infallible>(&tree, |hits| {
                rounds.push(hits);
                Ok(())
            })
        });
        rounds
    };
    let one = rounds(1);
    assert!(one.len() > 3, "{} rounds", one.len());
    assert_eq!(one, rounds(3));
}

#[test]
fn the_budget_ends_a_search_among_many_overlapping_triangles() {
    let (positions, _) = triangles(&[(0, 0, 0, 5)], DVec3::ZERO);
    let faces = vec![[0, 1, 2]; 20_000];
    let tree = Tree::new(&positions, &faces);
    let mut hits = 0;
    let search = PairSearch { look: accept_all, budget: 1_000_000, hubs: None };
    let complete = search.within::<_, Infallible>(&tree, |round| {
        hits += round.len();
        Ok(())
    });
    assert_eq!(complete, Ok(false));
    assert!((100_000..2_000_000).contains(&hits), "{hits}");
}

#[test]
fn the_caller_can_end_the_search_between_two_rounds() {
    let (positions, _) = triangles(&[(0, 0, 0, 5)], DVec3::ZERO);
    let tree = Tree::new(&positions, &vec![[0, 1, 2]; 20_000]);
    let mut rounds = 0;
    let search = PairSearch { look: accept_all, budget: NO_LIMIT, hubs: None };
    let ended = search.within(&tree, |_| {
        rounds += 1;
        if rounds == 3 { Err("enough") } else { Ok(()) }
    });
    assert_eq!((ended, rounds), (Err("enough"), 3));
}
