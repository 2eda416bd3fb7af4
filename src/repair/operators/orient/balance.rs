use super::Layers;
use crate::inspect::Solid;
use crate::mesh::{Edges, Parts, Surface, UnionFind};

/// Keeps the winding of open patches that meet in edges of several faces, where those were crossed as often one way as the
/// other and the patches together look outward. Solids that touch or overlap in common edges fall into patches there, of which
/// each may lie within another solid and so seem to look inward; but as they were they wound around their solids. Where
/// the edges were not all crossed so, what leaves more of them uneven is taken back.
pub(super) fn keep_what_was_balanced(
    surface: &Surface,
    edges: &Edges,
    patches: &Parts,
    solids: &[Solid],
    layers: &mut Layers,
) {
    let of_half_edge = |h: u32| patches.of_face[h as usize / 3];
    let several = || edges.iter().filter(|half_edges| half_edges.len() > 2);
    let mut groups = UnionFind::new(patches.count);
    for half_edges in several() {
        let mut at = half_edges.iter().map(|&h| of_half_edge(h)).filter(|&p| p != Parts::NONE);
        if let Some(first) = at.next() {
            at.for_each(|patch| groups.unite(first, patch));
        }
    }
    let group = groups.into_roots();
    // Of each group, how many edges are uneven as they were and after turning, ...
    let mut uneven = vec![[0u64; 2]; patches.count];
    for half_edges in several() {
        let Some(patch) = half_edges.iter().map(|&h| of_half_edge(h)).find(|&p| p != Parts::NONE) else { continue };
        for (turning, uneven) in uneven[group[patch as usize] as usize].iter_mut().enumerate() {
            let turned =
                |h: u32| turning == 1 && of_half_edge(h) != Parts::NONE && layers.turn[of_half_edge(h) as usize];
            let forward = half_edges.iter().filter(|&&h| Edges::is_forward(&surface.faces, h) != turned(h)).count();
            *uneven += u64::from(2 * forward != half_edges.len());
        }
    }
    // ... and what it encloses as it was.
    let mut volume = vec![0.0; patches.count];
    let about = surface.bounds().centre();
    for (f, &patch) in patches.of_face.iter().enumerate().filter(|&(_, &patch)| patch != Parts::NONE) {
        let [a, b, c] = surface.corners(f).map(|p| p - about);
        volume[group[patch as usize] as usize] += a.dot(b.cross(c)) / 6.0;
    }
    let mut shared = vec![0u32; patches.count];
    group.iter().for_each(|&g| shared[g as usize] += 1);
    for patch in (0..patches.count).filter(|&patch| !solids[patch].closed) {
        let group = group[patch] as usize;
        let [before, after] = uneven[group];
        let solid = shared[group] > 1 && before == 0 && volume[group] > 0.0;
        layers.turn[patch] &= !solid && after <= before;
    }
}
