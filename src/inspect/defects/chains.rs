//! Grouping of edges into connected chains with a polyline.

use crate::mesh::UnionFind;

/// A connected set of edges, and the longest polyline along these edges.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Chain {
    /// Indices into the list of edges, ascending.
    pub edges: Vec<u32>,
    /// Nodes along the polyline. A closed polyline repeats its first node at the end.
    pub line: Vec<u32>,
}

/// Groups edges between numbered nodes into chains. Edges are connected if they share a node or `also` lists the pair
/// of edges. O(n log n).
///
/// If every node of a chain has two edges, or all but two end nodes do, the polyline covers every edge once. The
/// polyline starts in the direction of its first edge.
pub(super) fn chains(edges: &[[u32; 2]], also: &[(u32, u32)]) -> Vec<Chain> {
    let mut incidence: Vec<(u32, u32)> = (0u32..).zip(edges).flat_map(|(e, &[a, b])| [(a, e), (b, e)]).collect();
    incidence.sort_unstable();
    let mut sets = UnionFind::new(edges.len());
    for pair in incidence.windows(2).filter(|pair| pair[0].0 == pair[1].0) {
        sets.unite(pair[0].1, pair[1].1);
    }
    for &(a, b) in also {
        sets.unite(a, b);
    }
    let mut number = vec![u32::MAX; edges.len()];
    let mut all: Vec<Chain> = Vec::new();
    for e in 0..edges.len() {
        #[expect(clippy::cast_possible_truncation, reason = "edges are counted in u32")]
        let root = sets.root(e as u32) as usize;
        if number[root] == u32::MAX {
            #[expect(clippy::cast_possible_truncation, reason = "no more than edges")]
            {
                number[root] = all.len() as u32;
            }
            all.push(Chain { edges: Vec::new(), line: Vec::new() });
        }
        number[e] = number[root];
        #[expect(clippy::cast_possible_truncation, reason = "edges are counted in u32")]
        all[number[e] as usize].edges.push(e as u32);
    }
    let mut walker = Walker { edges, incidence: &incidence, used: vec![false; edges.len()], next: Vec::new() };
    walker.next = vec![0; incidence.len()];
    // Polylines with ends come first, so that no closed one starts in their middle.
    for only_ends in [true, false] {
        for (e, &[a, b]) in edges.iter().enumerate() {
            for from in [a, b] {
                if walker.used[e] || (only_ends && walker.degree(from).is_multiple_of(2)) {
                    continue;
                }
                let line = walker.walk(from, e);
                let chain = &mut all[number[e] as usize];
                if line.len() > chain.line.len() {
                    chain.line = line;
                }
            }
        }
    }
    all
}

struct Walker<'a> {
    edges: &'a [[u32; 2]],
    /// Pairs of a node and one of its edges, sorted.
    incidence: &'a [(u32, u32)],
    used: Vec<bool>,
    /// At the index of each node's first entry in `incidence`: the number of leading entries known to be used.
    next: Vec<u32>,
}

impl Walker<'_> {
    fn begin(&self, node: u32) -> usize {
        self.incidence.partition_point(|&(n, _)| n < node)
    }

    fn degree(&self, node: u32) -> usize {
        self.incidence.partition_point(|&(n, _)| n <= node) - self.begin(node)
    }

    /// Follows unused edges until none is left.
    fn walk(&mut self, from: u32, first: usize) -> Vec<u32> {
        let mut line = vec![from];
        let (mut at, mut edge) = (from, first);
        loop {
            self.used[edge] = true;
            let [a, b] = self.edges[edge];
            at = if a == at { b } else { a };
            line.push(at);
            let Some(next) = self.unused_at(at) else { return line };
            edge = next;
        }
    }

    fn unused_at(&mut self, node: u32) -> Option<usize> {
        let begin = self.begin(node);
        loop {
            let &(n, e) = self.incidence.get(begin + self.next[begin] as usize)?;
            if n != node {
                return None;
            }
            if !self.used[e as usize] {
                return Some(e as usize);
            }
            self.next[begin] += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_of_a_closed_chain_ends_at_its_first_node() {
        let chains = chains(&[[5, 1], [9, 5], [1, 9]], &[]);
        assert_eq!(chains, [Chain { edges: vec![0, 1, 2], line: vec![5, 1, 9, 5] }]);
    }

    #[test]
    fn an_open_chain_is_drawn_from_end_to_end() {
        let chains = chains(&[[1, 2], [0, 1], [3, 2]], &[]);
        assert_eq!(chains[0].line, [0, 1, 2, 3]);
    }

    #[test]
    fn additional_pairs_join_separate_chains() {
        let edges = [[0, 1], [7, 8], [8, 9]];
        assert_eq!(chains(&edges, &[]).len(), 2);
        let joined = chains(&edges, &[(0, 2)]);
        assert_eq!((joined.len(), &joined[0].line[..]), (1, &[7, 8, 9][..]));
    }

    #[test]
    fn a_star_of_many_edges_is_not_quadratic() {
        let star: Vec<[u32; 2]> = (1..200_001).map(|i| [0, i]).collect();
        assert_eq!(chains(&star, &[])[0].edges.len(), 200_000);
    }
}
