//! Pairs the faces around edges with more than two faces, by angle and winding.
//!
//! The pairs say across which half-edge the surface continues, so that a non-manifold edge can be split into manifold ones.

use glam::DVec3;

use crate::math::{order_around, to_unit_range};
use crate::mesh::{Edges, Parts, Surface};
use crate::repair::{Cancelled, Context};

/// The index that stands for no half-edge.
pub(super) const NONE: u32 = u32::MAX;
/// How faces are paired around an edge with more than two faces.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Pairing {
    /// In angular order.
    Angular,
    /// In angular order, but patches with a boundary last. Those patches count as fins, and the solid below them stays whole.
    FinsLast,
}

/// The pairing of half-edges across edges.
pub(super) struct FacePairs {
    /// For each half-edge the half-edge across which the surface continues, or [`NONE`] at a boundary.
    pub mate: Vec<u32>,
    /// The number of edges with more than two faces.
    pub non_manifold_edges: u64,
    /// The number of half-edges at those edges without a mate.
    pub unpaired: u64,
}

/// Pairs the faces around each edge of `surface`.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub(super) fn pair_faces(
    surface: &Surface,
    edges: &Edges,
    pairing: Pairing,
    context: &Context<'_>,
) -> Result<FacePairs, Cancelled> {
    let faces = &surface.faces;
    let mut result = FacePairs { mate: vec![NONE; faces.len() * 3], non_manifold_edges: 0, unpaired: 0 };
    let mut unit = Vec::new();
    let mut fins: Option<Vec<bool>> = None;
    for (e, half_edges) in edges.iter().enumerate() {
        match *half_edges {
            [_] => {}
            [x, y] => {
                result.mate[x as usize] = y;
                result.mate[y as usize] = x;
            }
            _ => {
                context.check()?;
                if unit.is_empty() {
                    unit = to_unit_range(&surface.positions);
                }
                let AroundEdge { order, closes } = around_edge(faces, &unit, edges, e);
                let fins: &[bool] = match pairing {
                    Pairing::Angular => &[],
                    Pairing::FinsLast => fins.get_or_insert_with(|| open_patches(surface, edges)),
                };
                let is_fin = |h: u32| fins.get(h as usize / 3).copied().unwrap_or(false);
                let mut pairs = match_brackets(&order, &closes, |i| !is_fin(half_edges[i]));
                if 2 * pairs.len() < order.len() {
                    let is_paired = |i: usize| pairs.iter().any(|&(x, y)| x == i || y == i);
                    let rest = match_brackets(&order, &closes, |i| !is_paired(i));
                    pairs.extend(rest);
                }
                for &(i, j) in &pairs {
                    let (x, y) = (half_edges[i], half_edges[j]);
                    result.mate[x as usize] = y;
                    result.mate[y as usize] = x;
                }
                result.non_manifold_edges += 1;
                result.unpaired += (half_edges.len() - 2 * pairs.len()) as u64;
            }
        }
    }
    Ok(result)
}

/// The faces around an edge, by index into the edge's half-edges.
pub(super) struct AroundEdge {
    /// The angular order; empty where the angles cannot be compared.
    pub order: Vec<usize>,
    /// For each face, whether a counter-clockwise turn around the edge leaves a solid there, rather than entering one.
    pub closes: Vec<bool>,
}

/// Orders the faces around an edge by angle. `unit` holds positions in the range of [`to_unit_range`].
pub(super) fn around_edge(faces: &[[u32; 3]], unit: &[DVec3], edges: &Edges, edge: usize) -> AroundEdge {
    let half_edges = edges.half_edges(edge);
    let [a, b] = edges.vertices(edge).map(|v| unit[v as usize]);
    let points: Vec<_> = half_edges.iter().map(|&h| unit[Edges::opposite(faces, h) as usize]).collect();
    // Seen along the edge from the smaller vertex, a face with a forward half-edge has its solid behind it: it closes.
    let closes: Vec<bool> = half_edges.iter().map(|&h| Edges::is_forward(faces, h)).collect();
    // Solids with a common facet each keep their side: at the same angle one solid closes before the next opens.
    let order = order_around(a, b, &points, |i, j| closes[j].cmp(&closes[i])).unwrap_or_default();
    AroundEdge { order, closes }
}

/// Whether each face belongs to a patch with a boundary: a fin on a solid rather than a facet of the solid. A patch is a set
/// of faces joined across edges with two faces.
fn open_patches(surface: &Surface, edges: &Edges) -> Vec<bool> {
    let patches = Parts::patches(surface, edges);
    let open = patches.open(edges);
    patches.of_face.iter().map(|&p| p != Parts::NONE && open[p as usize]).collect()
}

/// Pairs each opening item on a circle with the matching closing item, among the items for which `takes_part` holds.
fn match_brackets(order: &[usize], closes: &[bool], takes_part: impl Fn(usize) -> bool) -> Vec<(usize, usize)> {
    let mut done = vec![false; order.len()];
    let (mut open, mut pairs) = (Vec::new(), Vec::new());
    for lap in 0..2 {
        for &i in order.iter().filter(|&&i| takes_part(i)) {
            if done[i] {
                continue;
            }
            if !closes[i] {
                if lap == 0 {
                    open.push(i);
                }
            } else if let Some(opening) = open.pop() {
                (done[i], done[opening]) = (true, true);
                pairs.push((opening, i));
            }
        }
    }
    pairs
}

/// Removes surplus items of one kind from a circle. Of two adjacent opening items the later is removed, and of two adjacent
/// closing items the earlier, so that the enclosed volume stays as large as it is.
pub(super) fn without_inner_sheets(order: &[usize], closes: &[bool]) -> Vec<usize> {
    let mut left = order.to_vec();
    let closing = left.iter().filter(|&&i| closes[i]).count();
    let opening = left.len() - closing;
    let closing_surplus = closing > opening;
    for _ in 0..closing.abs_diff(opening) {
        let next = |at: usize| left[(at + 1) % left.len()];
        let both = |at: usize| closes[left[at]] == closing_surplus && closes[next(at)] == closing_surplus;
        let Some(at) = (0..left.len()).find(|&at| both(at)) else { break };
        let inner = if closing_surplus { at } else { (at + 1) % left.len() };
        left.remove(inner);
    }
    left
}
