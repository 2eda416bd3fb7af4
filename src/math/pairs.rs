//! Searches for pairs of triangles whose boxes meet, in one tree or between two. The search runs in parallel rounds
//! with the same result for any number of threads, and stops at a budget.

use glam::{DVec3, Vec3A};
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;

use super::boxes::Box3;
use super::hubs::{HubSet, Hubs};
use super::threads;
use super::tree::{Tree, triangles_of};

/// Node pairs that a round starts from, and the steps of each before the round ends. A round of 2^18 steps takes some
/// tens of milliseconds; after each round the caller may stop the search.
const MAX_STARTS: usize = 128;
const STEPS_PER_START: u64 = 2048;

/// A pair of triangles, and the value that `look` returned for the pair.
pub type Hit<T> = ([u32; 2], T);

/// A search for pairs of triangles: the test of each pair, and the limit of work.
pub struct PairSearch<'a, L> {
    /// Called for every pair of triangles whose boxes meet; `Some` makes the pair a hit. Adds the cost of the test
    /// beyond one step to its third argument.
    pub look: L,
    /// Steps after which the search ends: pairs of boxes compared, plus the cost that `look` adds.
    pub budget: u64,
    /// The hubs of the tree's triangles. For triangles with a hub in common, `look` is called only if they leave it in
    /// directions that may meet: `look` must return nothing for triangles with no other point in common. `None` calls it
    /// for all. For a search between two trees, `None`.
    pub hubs: Option<&'a Hubs>,
}

/// Triangles of which some have changed, for a search of the pairs with a changed one. The tree holds only triangles that can be in
/// such a pair, so it is small where few have changed.
pub struct ChangedTriangles {
    /// The changed triangles and those whose boxes meet the box of a changed one, in ascending order.
    numbers: Vec<u32>,
    /// Whether each of them has changed.
    changed: Vec<bool>,
    tree: Tree,
    hubs: Option<Hubs>,
}

impl ChangedTriangles {
    /// Prepares the search; `changed` marks triangles. All positions that faces use must be finite.
    #[must_use]
    pub fn new(positions: &[DVec3], faces: &[[u32; 3]], changed: &[bool]) -> Self {
        let marked: Vec<[u32; 3]> =
            faces.iter().zip(changed).filter(|(_, changed)| **changed).map(|(face, _)| *face).collect();
        let of_marked = Tree::new(positions, &marked);
        let is_near = |face: usize| {
            let bounds = Box3::of(faces[face].map(|v| positions[v as usize]));
            changed[face] || of_marked.any_overlapping(&bounds, |_| true)
        };
        #[expect(clippy::cast_possible_truncation, reason = "triangles are counted in u32")]
        let numbers = threads::filter_map(faces.len(), |f| is_near(f).then_some(f as u32));
        let near: Vec<[u32; 3]> = numbers.iter().map(|&f| faces[f as usize]).collect();
        let changed = numbers.iter().map(|&f| changed[f as usize]).collect();
        Self { tree: Tree::new(positions, &near), hubs: Hubs::find(positions, &near), numbers, changed }
    }

    /// [`PairSearch::within_changed`] with these triangles, `look` and `budget`. Triangles keep their numbers.
    ///
    /// # Errors
    /// Returns the error of `take`.
    pub fn search<T: Send, E>(
        &self,
        look: impl Fn(u32, u32, &mut u64) -> Option<T> + Sync,
        budget: u64,
        mut take: impl FnMut(Vec<Hit<T>>) -> Result<(), E>,
    ) -> Result<bool, E> {
        let number = |at: u32| self.numbers[at as usize];
        let look = |f: u32, g: u32, steps: &mut u64| look(number(f), number(g), steps);
        let search = PairSearch { look, budget, hubs: self.hubs.as_ref() };
        search.within_changed(&self.tree, &self.changed, |hits| {
            take(hits.into_iter().map(|(pair, value)| (pair.map(number), value)).collect())
        })
    }
}

impl<L> PairSearch<'_, L> {
    /// Calls `look` for all pairs of different triangles in `tree` whose boxes meet, the smaller index first. See
    /// [`PairSearch::between`].
    ///
    /// # Errors
    /// Returns the error of `take`.
    pub fn within<T: Send, E>(&self, tree: &Tree, take: impl FnMut(Vec<Hit<T>>) -> Result<(), E>) -> Result<bool, E>
    where
        L: Fn(u32, u32, &mut u64) -> Option<T> + Sync,
    {
        self.within_all_or_changed(tree, None, take)
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
        self.within_all_or_changed(tree, Some(changed), take)
    }

    fn within_all_or_changed<T: Send, E>(
        &self,
        tree: &Tree,
        changed: Option<&[bool]>,
        mut take: impl FnMut(Vec<Hit<T>>) -> Result<(), E>,
    ) -> Result<bool, E>
    where
        L: Fn(u32, u32, &mut u64) -> Option<T> + Sync,
    {
        let Some(bvh) = &tree.bvh else { return Ok(true) };
        let mut left = self.budget;
        let hubs = match self.hubs {
            None => None,
            Some(hubs) if !self.at_hubs(hubs, changed, &mut left, &mut take)? => return Ok(false),
            Some(hubs) => Some((&hubs.of_triangle, hubs.of_nodes(tree))),
        };
        let only = changed.map(|changed| (changed, marked_nodes(tree, changed)));
        let walk = Walk {
            a: bvh,
            b: bvh,
            same: true,
            look: &self.look,
            only: only.as_ref().map(|(triangles, nodes)| PerNode { triangles, nodes }),
            hubs: hubs.as_ref().map(|(triangles, nodes)| PerNode { triangles, nodes }),
        };
        walk.run(&mut left, take)
    }

    /// Calls `look` for the pairs of triangles with a hub in common. Returns whether the budget was enough.
    fn at_hubs<T: Send, E>(
        &self,
        hubs: &Hubs,
        changed: Option<&[bool]>,
        left: &mut u64,
        mut take: impl FnMut(Vec<Hit<T>>) -> Result<(), E>,
    ) -> Result<bool, E>
    where
        L: Fn(u32, u32, &mut u64) -> Option<T> + Sync,
    {
        for hub in &hubs.list {
            let look = |i: u32, j: u32, steps: &mut u64| {
                let pair = [i, j].map(|at| hub.triangles[at as usize]);
                let is_wanted = hubs.is_first_common(hub, pair);
                let found = if is_wanted { (self.look)(pair[0], pair[1], steps) } else { None };
                found.map(|found| (pair, found))
            };
            let Some(bvh) = &hub.directions.bvh else { continue };
            let changed: Option<Vec<bool>> =
                changed.map(|changed| hub.triangles.iter().map(|&triangle| changed[triangle as usize]).collect());
            let only = changed.as_ref().map(|changed| (changed, marked_nodes(&hub.directions, changed)));
            let only = only.as_ref().map(|(triangles, nodes)| PerNode { triangles: triangles.as_slice(), nodes });
            let walk = Walk { a: bvh, b: bvh, same: true, look: &look, only, hubs: None };
            if !walk.run(left, |hits| take(hits.into_iter().map(|(_, hit)| hit).collect()))? {
                return Ok(false);
            }
        }
        Ok(true)
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
        let walk = Walk { a, b, same: false, look: &self.look, only: None, hubs: None };
        let mut left = self.budget;
        walk.run(&mut left, take)
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
    only: Option<PerNode<'a, bool>>,
    /// For a search within one tree: the hubs of each triangle. Pairs with a hub in common are left out.
    hubs: Option<PerNode<'a, HubSet>>,
}

/// A value for each triangle, and one for each node that sums up the triangles of its subtree.
#[derive(Clone, Copy)]
struct PerNode<'a, V> {
    triangles: &'a [V],
    nodes: &'a [V],
}

/// For each node, whether its subtree has a marked triangle.
fn marked_nodes(tree: &Tree, marked: &[bool]) -> Vec<bool> {
    let has_marked = |triangles: &[u32]| triangles.iter().any(|&triangle| marked[triangle as usize]);
    tree.summaries(false, |_, triangles| has_marked(triangles), |_, [left, right]| left || right)
}

impl<L> Walk<'_, L> {
    /// Visits all pairs in rounds until none is left, or until the steps are used up. Takes the steps from `steps`, and
    /// returns whether they were enough.
    fn run<T: Send, E>(&self, steps: &mut u64, mut take: impl FnMut(Vec<Hit<T>>) -> Result<(), E>) -> Result<bool, E>
    where
        L: Fn(u32, u32, &mut u64) -> Option<T> + Sync,
    {
        let mut open = vec![(0u32, 0u32)];
        while !open.is_empty() {
            if *steps == 0 {
                return Ok(false);
            }
            let starts = open.split_off(open.len().saturating_sub(MAX_STARTS));
            let results: Vec<StartResult<T>> = threads::map(starts.len(), 2, |i| self.from(starts[i]));
            let mut hits = Vec::with_capacity(results.iter().map(|e| e.hits.len()).sum());
            for end in results {
                *steps = steps.saturating_sub(end.steps);
                open.extend(end.left);
                hits.extend(end.hits);
            }
            take(hits)?;
        }
        Ok(true)
    }

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

    /// Whether a node's subtree has more than one triangle, one of those that a pair must have, and no common hub.
    #[inline]
    fn has_pairs(&self, k: u32) -> bool {
        self.a.nodes[k as usize].prim_count != 1
            && self.only.is_none_or(|only| only.nodes[k as usize])
            && self.hubs.is_none_or(|hubs| !hubs.nodes[k as usize].meets(hubs.nodes[k as usize]))
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
        if meet(x, y) && self.hubs.is_none_or(|hubs| !hubs.nodes[i as usize].meets(hubs.nodes[j as usize])) {
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
                if self.hubs.is_some_and(|hubs| hubs.triangles[f as usize].meets(hubs.triangles[g as usize])) {
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
mod tests;
