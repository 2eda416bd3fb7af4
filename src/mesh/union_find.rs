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
}
