use crate::mesh::UnionFind;

/// Edges that hang together, and the longest line that was drawn through them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Chain {
    /// The edges, by their place in the list, ascending.
    pub edges: Vec<u32>,
    /// The nodes along the line; the first is repeated at the end of a closed one.
    pub line: Vec<u32>,
}

/// Sorts a list of edges between numbered nodes into chains. Edges hang together where they share a node, and where
/// `also` names the two. O(n log n).
///
/// Where all nodes of a chain have two edges, or two of them one, the line passes every edge once. It begins in the
/// direction of its first edge.
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
    // Lines that have ends first, so that no other one begins in their middle.
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
    /// Nodes with their edges, sorted.
    incidence: &'a [(u32, u32)],
    used: Vec<bool>,
    /// At the first entry of each node in `incidence`: how many of its entries are known to be used.
    next: Vec<u32>,
}

impl Walker<'_> {
    fn begin(&self, node: u32) -> usize {
        self.incidence.partition_point(|&(n, _)| n < node)
    }

    fn degree(&self, node: u32) -> usize {
        self.incidence.partition_point(|&(n, _)| n <= node) - self.begin(node)
    }

    /// Goes along unused edges until there is none.
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
    fn a_closed_chain_is_one_line_that_ends_where_it_began() {
        let it = chains(&[[5, 1], [9, 5], [1, 9]], &[]);
        assert_eq!(it, [Chain { edges: vec![0, 1, 2], line: vec![5, 1, 9, 5] }]);
    }

    #[test]
    fn an_open_chain_is_drawn_from_end_to_end() {
        let it = chains(&[[1, 2], [0, 1], [3, 2]], &[]);
        assert_eq!(it[0].line, [0, 1, 2, 3]);
    }

    #[test]
    fn chains_apart_are_one_where_they_are_said_to_be() {
        let edges = [[0, 1], [7, 8], [8, 9]];
        assert_eq!(chains(&edges, &[]).len(), 2);
        let joined = chains(&edges, &[(0, 2)]);
        assert_eq!((joined.len(), &joined[0].line[..]), (1, &[7, 8, 9][..]));
    }

    #[test]
    fn a_star_of_many_edges_takes_no_quadratic_time() {
        let star: Vec<[u32; 2]> = (1..200_001).map(|i| [0, i]).collect();
        assert_eq!(chains(&star, &[])[0].edges.len(), 200_000);
    }
}
