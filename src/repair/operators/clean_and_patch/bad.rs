use crate::inspect::{Analysis, intersections};
use crate::mesh::{Edges, Parts, Surface};
use crate::repair::{Cancelled, Context};

/// What is bad about a surface: open and non-manifold edges by index, and pairs of faces that intersect.
pub(super) struct Bad {
    pub edges: Edges,
    pub parts: Parts,
    /// By face of the surface, the smaller first.
    pub pairs: Vec<[u32; 2]>,
    /// Whether all pairs are listed.
    pub complete: bool,
    /// Of each face whether its corners are on a line.
    pub flat: Vec<bool>,
}

impl Bad {
    pub fn of(surface: &Surface, context: &Context<'_>) -> Result<Self, Cancelled> {
        let edges = Edges::new(&surface.faces);
        let parts = Parts::new(surface, &edges);
        let soup = surface.to_soup();
        let analysis = Analysis::new((&soup).into(), context)?;
        let found = intersections(&analysis, context)?;
        let listed = found.pairs.len() as u64;
        let mut flat = vec![false; surface.faces.len()];
        for (&source, &is_flat) in analysis.surface.source.iter().zip(analysis.flat()) {
            flat[source as usize] = is_flat;
        }
        Ok(Self {
            edges,
            parts,
            pairs: found.pairs.into_iter().map(|pair| pair.faces).collect(),
            complete: found.counts.complete && found.counts.pairs == Some(listed),
            flat,
        })
    }

    /// How much is bad.
    pub fn total(&self) -> u64 {
        self.pairs.len() as u64 + self.edges.iter().filter(|h| h.len() != 2).count() as u64
    }

    /// The pairs within one part; where parts overlap nothing is bad about either.
    pub fn pairs_within_parts(&self) -> impl Iterator<Item = [u32; 2]> {
        let part = |f: u32| self.parts.of_face[f as usize];
        self.pairs.iter().copied().filter(move |&[f, g]| part(f) == part(g))
    }

    /// Of each face whether it is bad.
    pub fn faces(&self, surface: &Surface) -> Vec<bool> {
        let mut at = vec![false; surface.positions.len()];
        for (e, _) in self.edges.iter().enumerate().filter(|(_, h)| h.len() != 2) {
            for v in self.edges.vertices(e) {
                at[v as usize] = true;
            }
        }
        let mut bad: Vec<bool> = surface.faces.iter().map(|face| face.iter().any(|&v| at[v as usize])).collect();
        for f in self.pairs_within_parts().flatten() {
            bad[f as usize] = true;
        }
        bad
    }
}
