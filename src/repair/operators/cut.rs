//! Cutting a surface apart where it is not a surface.

use glam::DVec3;

use super::{Applied, Counter, Operation, Scope};
use crate::math::{order_around, to_unit_range};
use crate::mesh::{Edges, Parts, Surface, UnionFind};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// No half-edge.
pub(super) const NONE: u32 = u32::MAX;

/// Which fans of a vertex become vertices of their own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pinches {
    /// All of them.
    Cut,
    /// Fans with a boundary stay together where no edge of more than two faces ends, so that whoever closes the holes
    /// may join them.
    KeepAtBoundaries,
}

/// How faces are paired around an edge of more than two.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Pairing {
    /// In angular order.
    Angular,
    /// In angular order, but patches with a boundary last: they are taken for fins, and the solid that they stand on
    /// stays whole.
    FinsLast,
}

/// Gives each sheet that meets others in an edge or a vertex vertices of its own.
///
/// Around an edge of more than two faces, faces are paired in angular order so that each pair bounds the solid between
/// them, as brackets are matched: where the way around enters a solid it opens, where it leaves it closes.
///
/// ```text
///    solid 1 |                       solid 1 |
///    --------+--------      ->       --------+  +--------
///            | solid 2                          | solid 2
/// ```
///
/// Precondition: faces are consistently wound and outward as far as that goes. Result: copies stand at the same
/// positions, no face goes, no vertex moves; edges have one or two faces, but where both ends of an edge are in one fan.
/// Leaves: those edges, and faces without a partner, whose edges become boundary. See [`super::separate`] for keeping the
/// sheets apart in formats without indices.
///
/// Guéziec et al. 2001, "Cutting and Stitching: Converting Sets of Polygons to Manifold Surfaces".
///
/// # Errors
/// [`Cancelled`] when the work should stop; the surface is then unchanged.
pub fn cut_apart(
    surface: &mut Surface,
    pairing: Pairing,
    pinches: Pinches,
    context: &Context<'_>,
) -> Result<Vec<Change>, Cancelled> {
    let edges = Edges::new(&surface.faces);
    let Mates { of, cut, unpaired } = mates(surface, &edges, pairing, context)?;
    let faces = &surface.faces;
    let mut sets = UnionFind::new(faces.len() * 3);
    for (h, &mate) in (0u32..).zip(&of).filter(|&(h, &mate)| mate != NONE && mate > h) {
        if Edges::ends(faces, h) == Edges::ends(faces, mate) {
            sets.unite(h, mate);
            sets.unite(Edges::next(h), Edges::next(mate));
        } else {
            sets.unite(h, Edges::next(mate));
            sets.unite(Edges::next(h), mate);
        }
    }
    if pinches == Pinches::KeepAtBoundaries {
        join_boundary_fans(surface, &edges, &of, &mut sets);
    }
    let (mut first_fan, mut of_fan) = (vec![NONE; surface.positions.len()], vec![NONE; faces.len() * 3]);
    let mut copies = 0;
    for corner in 0..of_fan.len() {
        let (face, i) = (corner / 3, corner % 3);
        #[expect(clippy::cast_possible_truncation, reason = "corners are counted in u32")]
        let root = sets.root(corner as u32) as usize;
        if root == corner {
            let v = surface.faces[face][i];
            if first_fan[v as usize] == NONE {
                first_fan[v as usize] = v;
                of_fan[root] = v;
            } else {
                #[expect(clippy::cast_possible_truncation, reason = "no more vertices than corners")]
                {
                    of_fan[root] = surface.positions.len() as u32;
                }
                surface.positions.push(surface.positions[v as usize]);
                copies += 1;
            }
        }
        surface.faces[face][i] = of_fan[root];
    }
    Ok(Change::list([
        (ChangeKind::NonManifoldEdgesCut, cut),
        (ChangeKind::VerticesCopied, copies),
        (ChangeKind::FacesWithoutPartner, unpaired),
    ]))
}

/// Of each half-edge the one across which the surface goes on, or [`NONE`] at a boundary.
pub(super) struct Mates {
    pub of: Vec<u32>,
    /// Edges of more than two faces.
    pub cut: u64,
    /// Half-edges of those that have no partner.
    pub unpaired: u64,
}

pub(super) fn mates(
    surface: &Surface,
    edges: &Edges,
    pairing: Pairing,
    context: &Context<'_>,
) -> Result<Mates, Cancelled> {
    let faces = &surface.faces;
    let mut mates = Mates { of: vec![NONE; faces.len() * 3], cut: 0, unpaired: 0 };
    let mut unit = Vec::new();
    let mut fins: Option<Vec<bool>> = None;
    for (e, half_edges) in edges.iter().enumerate() {
        match *half_edges {
            [_] => {}
            [x, y] => {
                mates.of[x as usize] = y;
                mates.of[y as usize] = x;
            }
            _ => {
                context.check()?;
                if unit.is_empty() {
                    unit = to_unit_range(&surface.positions);
                }
                let Turn { order, closes } = turn(faces, &unit, edges, e);
                let fins: &[bool] = match pairing {
                    Pairing::Angular => &[],
                    Pairing::FinsLast => fins.get_or_insert_with(|| open_patches(surface, edges)),
                };
                let is_fin = |h: u32| fins.get(h as usize / 3).copied().unwrap_or(false);
                let mut pairs = match_brackets(&order, &closes, |i| !is_fin(half_edges[i]));
                if 2 * pairs.len() < order.len() {
                    let paired = |i: usize| pairs.iter().any(|&(x, y)| x == i || y == i);
                    let rest = match_brackets(&order, &closes, |i| !paired(i));
                    pairs.extend(rest);
                }
                for &(i, j) in &pairs {
                    let (x, y) = (half_edges[i], half_edges[j]);
                    mates.of[x as usize] = y;
                    mates.of[y as usize] = x;
                }
                mates.cut += 1;
                mates.unpaired += (half_edges.len() - 2 * pairs.len()) as u64;
            }
        }
    }
    Ok(mates)
}

/// The faces around an edge, by their places among its half-edges.
pub(super) struct Turn {
    /// In angular order; empty where that can't be told.
    pub order: Vec<usize>,
    /// Whether the way around leaves a solid at the face, rather than entering one.
    pub closes: Vec<bool>,
}

/// Turns around an edge. `unit` are positions in the range of [`to_unit_range`].
pub(super) fn turn(faces: &[[u32; 3]], unit: &[DVec3], edges: &Edges, edge: usize) -> Turn {
    let half_edges = edges.half_edges(edge);
    let [a, b] = edges.vertices(edge).map(|v| unit[v as usize]);
    let points: Vec<_> = half_edges.iter().map(|&h| unit[Edges::opposite(faces, h) as usize]).collect();
    // A face that runs along the edge from the smaller vertex has the solid behind it, seen counter-clockwise: it closes.
    let closes: Vec<bool> = half_edges.iter().map(|&h| Edges::is_forward(faces, h)).collect();
    // Solids that share a wall each keep their side of it: at the same angle one closes before the next opens.
    let order = order_around(a, b, &points, |i, j| closes[j].cmp(&closes[i])).unwrap_or_default();
    Turn { order, closes }
}

/// Whether each face is in a patch (faces joined across edges of two faces) that has a boundary: a fin on a solid, rather
/// than a wall of it.
fn open_patches(surface: &Surface, edges: &Edges) -> Vec<bool> {
    let patches = Parts::patches(surface, edges);
    let open = patches.open(edges);
    patches.of_face.iter().map(|&p| p != Parts::NONE && open[p as usize]).collect()
}

/// Pairs each opening item with the closing one that matches it around a circle, among those that take part.
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

/// The items of a circle that are left when those too many of one kind are taken out: of two neighbours that both open, the
/// later one, and of two that both close, the earlier one, so that what is enclosed stays as large as it is.
pub(super) fn without_inner_sheets(order: &[usize], closes: &[bool]) -> Vec<usize> {
    let mut left = order.to_vec();
    let closing = left.iter().filter(|&&i| closes[i]).count();
    let opening = left.len() - closing;
    let many = closing > opening;
    for _ in 0..closing.abs_diff(opening) {
        let next = |at: usize| left[(at + 1) % left.len()];
        let Some(at) = (0..left.len()).find(|&at| closes[left[at]] == many && closes[next(at)] == many) else { break };
        let inner = if many { at } else { (at + 1) % left.len() };
        left.remove(inner);
    }
    left
}

/// Joins the fans with a boundary at each vertex where no edge of more than two faces ends.
fn join_boundary_fans(surface: &Surface, edges: &Edges, mates: &[u32], sets: &mut UnionFind) {
    let mut joins = vec![true; surface.positions.len()];
    for (e, _) in edges.iter().enumerate().filter(|(_, h)| h.len() > 2) {
        for v in edges.vertices(e) {
            joins[v as usize] = false;
        }
    }
    let mut first = vec![NONE; surface.positions.len()];
    for half_edges in edges.iter() {
        for &h in half_edges.iter().filter(|&&h| mates[h as usize] == NONE) {
            for corner in [h, Edges::next(h)] {
                let v = surface.faces[corner as usize / 3][corner as usize % 3] as usize;
                if !joins[v] {
                    continue;
                }
                if first[v] == NONE {
                    first[v] = corner;
                }
                sets.unite(first[v], corner);
            }
        }
    }
}

/// Cuts apart what meets in non-manifold edges and vertices.
#[derive(Debug, Clone, Copy)]
pub struct CutApart {
    pairing: Pairing,
}

impl Operation for CutApart {
    const FIXES: &'static [Counter] = &[Counter::NonmanifoldEdges, Counter::PinchedVertices];
    const MAY_RAISE: &'static [Counter] = &[Counter::BoundaryEdges, Counter::DuplicateFaces];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self { pairing: scope.pairing }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        Ok(cut_apart(surface, self.pairing, Pinches::KeepAtBoundaries, context)?.into())
    }
}
