//! Searches for pairs of triangles whose boxes meet, in one tree or between two. The search runs in parallel rounds
//! with the same result for any number of threads, and stops at a budget.

use glam::Vec3A;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;

use super::threads;
use super::tree::{Tree, triangles_of};

/// Node pairs that a round starts from, and the steps of each before the round ends. A round of 2^18 steps takes some
/// tens of milliseconds; after each round the caller may stop the search.
const MAX_STARTS: usize = 128;
const STEPS_PER_START: u64 = 2048;

/// A pair of triangles, and the value that `look` returned for the pair.
pub type Hit<T> = ([u32; 2], T);

/// A search for pairs of triangles: the test of each pair, and the limit of work.
pub struct PairSearch<L> {
    /// Called for every pair of triangles whose boxes meet; `Some` makes the pair a hit. Adds the cost of the test
    /// beyond one step to its third argument.
    pub look: L,
    /// Steps after which the search ends: pairs of boxes compared, plus the cost that `look` adds.
    pub budget: u64,
}

impl<L> PairSearch<L> {
    /// Calls `look` for all pairs of different triangles in `tree` whose boxes meet, the smaller index first. See
    /// [`PairSearch::between`].
    ///
    /// # Errors
    /// Returns the error of `take`.
    pub fn within<T: Send, E>(&self, tree: &Tree, take: impl FnMut(Vec<Hit<T>>) -> Result<(), E>) -> Result<bool, E>
    where
        L: Fn(u32, u32, &mut u64) -> Option<T> + Sync,
    {
        let Some(bvh) = &tree.bvh else { return Ok(true) };
        self.search(&Walk { a: bvh, b: bvh, same: true, look: &self.look, only: None }, take)
    }

    /// Calls `look` like [`PairSearch::within`], but only for pairs of which at least one triangle is marked in `changed`.
    ///
    /// # Errors
    /// Returns the error of `take`.
    pub fn within_changed<T: Send, E>(
        &self,
        tree: &Tree,
        changed: &[bool],
        take: impl FnMut(Vec<Hit<T>>) -> Result<(), E>,
    ) -> Result<bool, E>
    where
        L: Fn(u32, u32, &mut u64) -> Option<T> + Sync,
    {
        let Some(bvh) = &tree.bvh else { return Ok(true) };
        let has_changed = |triangles: &[u32]| triangles.iter().any(|&triangle| changed[triangle as usize]);
        let nodes = tree.summaries(false, |_, triangles| has_changed(triangles), |_, [left, right]| left || right);
        let only = Some(Changed { triangles: changed, nodes: &nodes });
        self.search(&Walk { a: bvh, b: bvh, same: true, look: &self.look, only }, take)
    }

    /// Calls `look` for all pairs of a triangle in `a` and one in `b` whose boxes meet. Both trees must have been built
    /// in the same frame. Returns whether the budget was enough.
    ///
    /// The search runs in rounds on the current thread pool. After each round, `take` receives the round's hits and may
    /// end the search with an error. Rounds and their hits are the same for any number of threads.
    ///
    /// No meeting pair is missed: a box in the tree is the triangle's box, translated, scaled and rounded per
    /// coordinate, then widened. Each step is monotonic, including rounding to nearest, so boxes that met before the
    /// steps still meet after them.
    ///
    /// # Errors
    /// Returns the error of `take`.
    pub fn between<T: Send, E>(
        &self,
        a: &Tree,
        b: &Tree,
        take: impl FnMut(Vec<Hit<T>>) -> Result<(), E>,
    ) -> Result<bool, E>
    where
        L: Fn(u32, u32, &mut u64) -> Option<T> + Sync,
    {
        debug_assert!(a.frame == b.frame, "the trees must have the same frame");
        let (Some(a), Some(b)) = (&a.bvh, &b.bvh) else { return Ok(true) };
        self.search(&Walk { a, b, same: false, look: &self.look, only: None }, take)
    }

    fn search<T: Send, E>(
        &self,
        walk: &Walk<'_, L>,
        mut take: impl FnMut(Vec<Hit<T>>) -> Result<(), E>,
    ) -> Result<bool, E>
    where
        L: Fn(u32, u32, &mut u64) -> Option<T> + Sync,
    {
        let mut open = vec![(0u32, 0u32)];
        let mut spent = 0u64;
        while !open.is_empty() {
            if spent >= self.budget {
                return Ok(false);
            }
            let starts = open.split_off(open.len().saturating_sub(MAX_STARTS));
            let results: Vec<StartResult<T>> = threads::map(starts.len(), 2, |i| walk.from(starts[i]));
            let mut hits = Vec::with_capacity(results.iter().map(|e| e.hits.len()).sum());
            for end in results {
                spent += end.steps;
                open.extend(end.left);
                hits.extend(end.hits);
            }
            take(hits)?;
        }
        Ok(true)
    }
}

/// Result of one start of a round.
struct StartResult<T> {
    hits: Vec<Hit<T>>,
    /// Node pairs that were not visited because the steps ran out.
    left: Vec<(u32, u32)>,
    steps: u64,
}

/// A simultaneous traversal of two trees.
struct Walk<'a, L> {
    a: &'a Bvh2,
    b: &'a Bvh2,
    /// Whether both trees are the same tree, in which each pair is visited once.
    same: bool,
    look: &'a L,
    /// For a search within one tree: the triangles of which a pair must have at least one; `None` for all.
    only: Option<Changed<'a>>,
}

/// The triangles of which a pair must have at least one.
#[derive(Clone, Copy)]
struct Changed<'a> {
    triangles: &'a [bool],
    /// For each node, whether its subtree has such a triangle.
    nodes: &'a [bool],
}

impl<L> Walk<'_, L> {
    fn from<T>(&self, start: (u32, u32)) -> StartResult<T>
    where
        L: Fn(u32, u32, &mut u64) -> Option<T>,
    {
        let mut end = StartResult { hits: Vec::new(), left: vec![start], steps: 0 };
        while end.steps < STEPS_PER_START {
            let Some((i, j)) = end.left.pop() else { break };
            end.steps += 1;
            let (x, y) = (&self.a.nodes[i as usize], &self.b.nodes[j as usize]);
            if self.same && i == j {
                if x.is_leaf() {
                    self.test_leaves(x, y, true, &mut end);
                } else {
                    let (l, r) = (x.first_index, x.first_index + 1);
                    end.left.extend([(l, l), (r, r)].into_iter().filter(|&(k, _)| self.has_pairs(k)));
                    self.push(l, r, &mut end);
                }
                continue;
            }
            match (x.is_leaf(), y.is_leaf()) {
                (true, true) => self.test_leaves(x, y, false, &mut end),
                (true, false) => {
                    self.push(i, y.first_index, &mut end);
                    self.push(i, y.first_index + 1, &mut end);
                }
                (false, true) => {
                    self.push(x.first_index, j, &mut end);
                    self.push(x.first_index + 1, j, &mut end);
                }
                (false, false) => {
                    for k in [x.first_index, x.first_index + 1] {
                        self.push(k, y.first_index, &mut end);
                        self.push(k, y.first_index + 1, &mut end);
                    }
                }
            }
        }
        end
    }

    /// Whether a node's subtree has more than one triangle, and one of those that a pair must have.
    #[inline]
    fn has_pairs(&self, k: u32) -> bool {
        self.a.nodes[k as usize].prim_count != 1 && self.only.is_none_or(|only| only.nodes[k as usize])
    }

    /// Continues with a pair of nodes if their boxes meet. Pairs of leaves, the most frequent case, are tested at once.
    #[inline]
    fn push<T>(&self, i: u32, j: u32, end: &mut StartResult<T>)
    where
        L: Fn(u32, u32, &mut u64) -> Option<T>,
    {
        if self.only.is_some_and(|only| !only.nodes[i as usize] && !only.nodes[j as usize]) {
            return;
        }
        let (x, y) = (&self.a.nodes[i as usize], &self.b.nodes[j as usize]);
        if meet(x, y) {
            if x.is_leaf() && y.is_leaf() {
                self.test_leaves(x, y, false, end);
            } else {
                end.left.push((i, j));
            }
        }
    }

    fn test_leaves<T>(&self, x: &Bvh2Node, y: &Bvh2Node, one: bool, end: &mut StartResult<T>)
    where
        L: Fn(u32, u32, &mut u64) -> Option<T>,
    {
        let (first, second) = (triangles_of(self.a, x), triangles_of(self.b, y));
        for (at, &f) in first.iter().enumerate() {
            for &g in if one { &second[at + 1..] } else { second } {
                if self.only.is_some_and(|only| !only.triangles[f as usize] && !only.triangles[g as usize]) {
                    continue;
                }
                let pair = if self.same && g < f { [g, f] } else { [f, g] };
                end.steps += 1;
                if let Some(found) = (self.look)(pair[0], pair[1], &mut end.steps) {
                    end.hits.push((pair, found));
                }
            }
        }
    }
}

#[inline]
fn meet(x: &Bvh2Node, y: &Bvh2Node) -> bool {
    let (x, y) = (x.aabb(), y.aabb());
    let below = |low: Vec3A, high: Vec3A| low.cmple(high).all();
    below(x.min, y.max) && below(y.min, x.max)
}

#[cfg(test)]
mod tests {
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
        let search = PairSearch { look: accept_all, budget: NO_LIMIT };
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
            let search = PairSearch { look: accept_all, budget: NO_LIMIT };
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
            let search = PairSearch { look: accept_all, budget: NO_LIMIT };
            let Ok(complete) = search.within_changed::<_, Infallible>(&tree, &changed[..faces.len()], |hits| {
                found.extend(hits.into_iter().map(|(pair, ())| pair));
                Ok(())
            });
            prop_assert!(complete);
            found.sort_unstable();
            prop_assert_eq!(found, expected);
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
            let search = PairSearch { look: accept_all, budget: NO_LIMIT };
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
        let search = PairSearch { look: accept_all, budget: 1_000_000 };
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
        let search = PairSearch { look: accept_all, budget: NO_LIMIT };
        let ended = search.within(&tree, |_| {
            rounds += 1;
            if rounds == 3 { Err("enough") } else { Ok(()) }
        });
        assert_eq!((ended, rounds), (Err("enough"), 3));
    }
}
