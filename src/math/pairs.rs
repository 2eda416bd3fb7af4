use glam::Vec3A;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};

use super::tree::{Tree, triangles_of};

/// Pairs of nodes that a round starts from, and steps that each of them may take before the round ends. A round of
/// 2^18 steps takes some tens of milliseconds, after which the caller may stop the search.
const STARTS: usize = 128;
const STEPS: u64 = 2048;

/// A pair of triangles for which `look` had an answer: two numbers, and what was found.
pub type Hit<T> = ([u32; 2], T);

/// What a search looks for, and how much work it may be.
pub struct PairSearch<L> {
    /// Asked for every pair of triangles whose boxes meet: an answer makes the pair a hit. It adds to its third
    /// argument what the answer costs beyond a step.
    pub look: L,
    /// Steps after which the search ends: pairs of boxes compared, and what `look` adds.
    pub budget: u64,
}

impl<L> PairSearch<L> {
    /// Looks at all pairs of different triangles in `tree` whose boxes meet, the smaller number first. See
    /// [`PairSearch::between`].
    ///
    /// # Errors
    /// That of `take`.
    pub fn within<T: Send, E>(&self, tree: &Tree, take: impl FnMut(Vec<Hit<T>>) -> Result<(), E>) -> Result<bool, E>
    where
        L: Fn(u32, u32, &mut u64) -> Option<T> + Sync,
    {
        let Some(bvh) = &tree.bvh else { return Ok(true) };
        self.run(bvh, bvh, true, take)
    }

    /// Looks at all pairs of a triangle in `a` and one in `b` whose boxes meet. The trees must have been built in one
    /// frame. Answers whether the budget was enough.
    ///
    /// The search runs in rounds on the current pool of threads. `take` is given the hits of each round and may end
    /// the search by an error. Rounds, and the hits in them, are the same for any number of threads.
    ///
    /// No pair that meets is lost: a box of the tree is the triangle's box, moved, scaled and rounded one coordinate at a
    /// time, then widened. Each of these steps keeps the order of numbers, rounding to the nearest too, so that what
    /// was at least as large before is so afterwards, and boxes that met meet.
    ///
    /// # Errors
    /// That of `take`.
    pub fn between<T: Send, E>(
        &self,
        a: &Tree,
        b: &Tree,
        take: impl FnMut(Vec<Hit<T>>) -> Result<(), E>,
    ) -> Result<bool, E>
    where
        L: Fn(u32, u32, &mut u64) -> Option<T> + Sync,
    {
        debug_assert!(a.frame == b.frame, "trees of one frame");
        let (Some(a), Some(b)) = (&a.bvh, &b.bvh) else { return Ok(true) };
        self.run(a, b, false, take)
    }

    fn run<T: Send, E>(
        &self,
        a: &Bvh2,
        b: &Bvh2,
        same: bool,
        mut take: impl FnMut(Vec<Hit<T>>) -> Result<(), E>,
    ) -> Result<bool, E>
    where
        L: Fn(u32, u32, &mut u64) -> Option<T> + Sync,
    {
        let walk = Walk { a, b, same, look: &self.look };
        let mut open = vec![(0u32, 0u32)];
        let mut spent = 0u64;
        while !open.is_empty() {
            if spent >= self.budget {
                return Ok(false);
            }
            let starts = open.split_off(open.len().saturating_sub(STARTS));
            let ends: Vec<End<T>> = starts.par_iter().map(|&start| walk.from(start)).collect();
            let mut hits = Vec::with_capacity(ends.iter().map(|e| e.hits.len()).sum());
            for end in ends {
                spent += end.steps;
                open.extend(end.left);
                hits.extend(end.hits);
            }
            take(hits)?;
        }
        Ok(true)
    }
}

/// What came of one start of a round.
struct End<T> {
    hits: Vec<Hit<T>>,
    /// Pairs of nodes that were not looked at for want of steps.
    left: Vec<(u32, u32)>,
    steps: u64,
}

/// A walk down two trees at once.
struct Walk<'a, L> {
    a: &'a Bvh2,
    b: &'a Bvh2,
    /// Whether both are one tree, of which each pair is wanted once.
    same: bool,
    look: &'a L,
}

impl<L> Walk<'_, L> {
    fn from<T>(&self, start: (u32, u32)) -> End<T>
    where
        L: Fn(u32, u32, &mut u64) -> Option<T>,
    {
        let mut end = End { hits: Vec::new(), left: vec![start], steps: 0 };
        while end.steps < STEPS {
            let Some((i, j)) = end.left.pop() else { break };
            end.steps += 1;
            let (x, y) = (&self.a.nodes[i as usize], &self.b.nodes[j as usize]);
            if self.same && i == j {
                if x.is_leaf() {
                    self.leaves(x, y, true, &mut end);
                } else {
                    let (l, r) = (x.first_index, x.first_index + 1);
                    end.left.extend([(l, l), (r, r)].into_iter().filter(|&(k, _)| self.has_pairs(k)));
                    self.push(l, r, &mut end);
                }
                continue;
            }
            match (x.is_leaf(), y.is_leaf()) {
                (true, true) => self.leaves(x, y, false, &mut end),
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

    /// Whether there is more than one triangle under a node.
    #[inline]
    fn has_pairs(&self, k: u32) -> bool {
        self.a.nodes[k as usize].prim_count != 1
    }

    /// Goes on with a pair of nodes if their boxes meet: at once with leaves, which most pairs are.
    #[inline]
    fn push<T>(&self, i: u32, j: u32, end: &mut End<T>)
    where
        L: Fn(u32, u32, &mut u64) -> Option<T>,
    {
        let (x, y) = (&self.a.nodes[i as usize], &self.b.nodes[j as usize]);
        if meet(x, y) {
            if x.is_leaf() && y.is_leaf() {
                self.leaves(x, y, false, end);
            } else {
                end.left.push((i, j));
            }
        }
    }

    fn leaves<T>(&self, x: &Bvh2Node, y: &Bvh2Node, one: bool, end: &mut End<T>)
    where
        L: Fn(u32, u32, &mut u64) -> Option<T>,
    {
        let (first, second) = (triangles_of(self.a, x), triangles_of(self.b, y));
        for (at, &f) in first.iter().enumerate() {
            for &g in if one { &second[at + 1..] } else { second } {
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

    fn everything(_: u32, _: u32, _: &mut u64) -> Option<()> {
        Some(())
    }

    fn pairs_within(tree: &Tree) -> Vec<[u32; 2]> {
        let mut found = Vec::new();
        let search = PairSearch { look: everything, budget: NO_LIMIT };
        let Ok(complete) = search.within::<_, Infallible>(tree, |hits| {
            found.extend(hits.into_iter().map(|(pair, ())| pair));
            Ok(())
        });
        assert!(complete);
        found.sort_unstable();
        found
    }

    /// Triangles of all sizes, some along the axes, some that only touch, far from the origin or not.
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
        fn every_pair_whose_boxes_meet_is_looked_at_once(
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
        fn every_pair_between_two_trees_whose_boxes_meet_is_looked_at_once(
            seed in proptest::collection::vec((0u32..20, 0u32..20, 0u32..20, 0u8..9), 2..120),
            share in 0usize..120,
        ) {
            let (positions, faces) = triangles(&seed, DVec3::splat(0.1));
            let (a, b) = faces.split_at(share.min(faces.len()));
            let frame = Frame::around(&positions, &faces);
            let (left, right) = (Tree::in_frame(frame, &positions, a), Tree::in_frame(frame, &positions, b));
            let mut found = Vec::new();
            let search = PairSearch { look: everything, budget: NO_LIMIT };
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

    #[test]
    fn rounds_are_the_same_for_any_number_of_threads() {
        let seed: Vec<(u32, u32, u32, u8)> =
            (0..3000u32).map(|i| (i * 7 % 101, i * 13 % 97, i * 29 % 89, (i % 8) as u8)).collect();
        let (positions, faces) = triangles(&seed, DVec3::ZERO);
        let tree = Tree::new(&positions, &faces);
        let rounds = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            let mut rounds = Vec::new();
            let search = PairSearch { look: everything, budget: NO_LIMIT };
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
    fn a_crowd_of_overlapping_triangles_ends_by_the_budget() {
        let (positions, _) = triangles(&[(0, 0, 0, 5)], DVec3::ZERO);
        let faces = vec![[0, 1, 2]; 20_000];
        let tree = Tree::new(&positions, &faces);
        let mut hits = 0;
        let search = PairSearch { look: everything, budget: 1_000_000 };
        let complete = search.within::<_, Infallible>(&tree, |round| {
            hits += round.len();
            Ok(())
        });
        assert_eq!(complete, Ok(false));
        assert!((100_000..2_000_000).contains(&hits), "{hits}");
    }

    #[test]
    fn the_caller_ends_the_search_between_two_rounds() {
        let (positions, _) = triangles(&[(0, 0, 0, 5)], DVec3::ZERO);
        let tree = Tree::new(&positions, &vec![[0, 1, 2]; 20_000]);
        let mut rounds = 0;
        let search = PairSearch { look: everything, budget: NO_LIMIT };
        let ended = search.within(&tree, |_| {
            rounds += 1;
            if rounds == 3 { Err("enough") } else { Ok(()) }
        });
        assert_eq!((ended, rounds), (Err("enough"), 3));
    }
}
