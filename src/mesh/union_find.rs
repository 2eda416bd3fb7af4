/// Disjoint sets over `0..n` (Tarjan 1975), the smallest member being each set's root, so that the answer does not
/// depend on the order of unions.
#[derive(Debug, Clone)]
pub struct UnionFind {
    parent: Vec<u32>,
}

impl UnionFind {
    /// `n` sets of one member each.
    #[must_use]
    pub fn new(n: usize) -> Self {
        #[expect(clippy::cast_possible_truncation, reason = "meshes are counted in u32")]
        Self { parent: (0..n as u32).collect() }
    }

    /// The smallest member of the set that holds `x`.
    pub fn root(&mut self, mut x: u32) -> u32 {
        while self.parent[x as usize] != x {
            let up = self.parent[self.parent[x as usize] as usize];
            self.parent[x as usize] = up;
            x = up;
        }
        x
    }

    /// Makes one set of the sets of `a` and `b`.
    pub fn unite(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        if a != b {
            self.parent[a.max(b) as usize] = a.min(b);
        }
    }

    /// For each member the smallest member of its set.
    #[must_use]
    pub fn into_roots(mut self) -> Vec<u32> {
        // A parent is never larger than its child, so that it has its root already.
        for x in 0..self.parent.len() {
            self.parent[x] = self.parent[self.parent[x] as usize];
        }
        self.parent
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_member_of_a_set_has_its_smallest_as_root() {
        let mut sets = UnionFind::new(7);
        for (a, b) in [(6, 5), (5, 2), (4, 3), (3, 1), (6, 4)] {
            sets.unite(a, b);
        }
        let one_by_one: Vec<u32> = (0..7).map(|x| sets.root(x)).collect();
        assert_eq!(one_by_one, [0, 1, 1, 1, 1, 1, 1]);
        let mut fresh = UnionFind::new(7);
        for (a, b) in [(6, 5), (5, 2), (4, 3), (3, 1)] {
            fresh.unite(a, b);
        }
        assert_eq!(fresh.into_roots(), [0, 1, 2, 1, 1, 2, 2]);
    }
}
