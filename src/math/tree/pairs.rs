use glam::Vec3A;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};

use super::Tree;

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
                    end.left.extend([(l, l), (r, r)]);
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

    #[inline]
    fn push<T>(&self, i: u32, j: u32, end: &mut End<T>) {
        if meet(&self.a.nodes[i as usize], &self.b.nodes[j as usize]) {
            end.left.push((i, j));
        }
    }

    fn leaves<T>(&self, x: &Bvh2Node, y: &Bvh2Node, one: bool, end: &mut End<T>)
    where
        L: Fn(u32, u32, &mut u64) -> Option<T>,
    {
        let range = |n: &Bvh2Node| n.first_index as usize..(n.first_index + n.prim_count) as usize;
        let (first, second) = (&self.a.primitive_indices[range(x)], &self.b.primitive_indices[range(y)]);
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
#[path = "pairs_tests.rs"]
mod tests;
