//! Where the inside of a surface is: by following rays through faces, and by pairing the faces around edges of more than two.

use glam::DVec3;

use crate::math::{Crossing, Tree, crossing, order_around, to_unit_range};
use crate::mesh::{Edges, Parts, Surface};
use crate::repair::{Cancelled, Context};

/// No half-edge.
pub(super) const NONE: u32 = u32::MAX;

/// Faces through which segments are followed, to tell inside from outside by whether they go through an odd number.
pub(super) struct RayCaster {
    /// The surface's positions in the range of [`to_unit_range`], in which segments are given.
    pub unit: Vec<DVec3>,
    faces: Vec<[u32; 3]>,
    tree: Tree,
    spent: u64,
    budget: u64,
}

impl RayCaster {
    /// Segments are followed through `faces` of `surface`. All segments together may look at `budget` of them.
    pub fn new(surface: &Surface, faces: Vec<[u32; 3]>, budget: u64) -> Self {
        let unit = to_unit_range(&surface.positions);
        Self { tree: Tree::new(&unit, &faces), unit, faces, spent: 0, budget }
    }

    /// The middle of a face, from which segments begin.
    pub fn middle(&self, face: [u32; 3]) -> DVec3 {
        let [a, b, c] = face.map(|v| self.unit[v as usize]);
        (a + b + c) / 3.0
    }

    /// How often the segment goes through the faces, but for the one of number `but`; none where it touches an edge or the
    /// budget is spent.
    pub fn crossings(&mut self, from: DVec3, to: DVec3, but: Option<u32>) -> Option<u64> {
        let mut count = 0;
        self.each_crossing(from, to, but, |_| count += 1).then_some(count)
    }

    /// Calls `visit` with every face that the segment goes through, but for the one of number `but`. Answers `false` where it
    /// touches an edge or the budget is spent, and then need not have met all.
    pub fn each_crossing(&mut self, from: DVec3, to: DVec3, but: Option<u32>, mut visit: impl FnMut(u32)) -> bool {
        let Self { unit, faces, tree, spent, budget } = self;
        let mut clear = true;
        tree.along(from, to, |i| {
            *spent += 1;
            if Some(i) != but {
                match crossing(from, to, faces[i as usize].map(|v| unit[v as usize])) {
                    Crossing::Miss => {}
                    Crossing::Touches => clear = false,
                    Crossing::Enters | Crossing::Leaves => visit(i),
                }
            }
            clear && spent < budget
        });
        clear && spent < budget
    }

    /// Whether all that segments may look at was looked at.
    pub fn is_spent(&self) -> bool {
        self.spent >= self.budget
    }
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

/// Of each half-edge the one across which the surface goes on, or [`NONE`] at a boundary.
pub(super) struct FacePairs {
    pub mate: Vec<u32>,
    /// Edges of more than two faces.
    pub cut: u64,
    /// Half-edges of those that have no partner.
    pub unpaired: u64,
}

/// Pairs the faces around each edge.
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
    let mut found = FacePairs { mate: vec![NONE; faces.len() * 3], cut: 0, unpaired: 0 };
    let mut unit = Vec::new();
    let mut fins: Option<Vec<bool>> = None;
    for (e, half_edges) in edges.iter().enumerate() {
        match *half_edges {
            [_] => {}
            [x, y] => {
                found.mate[x as usize] = y;
                found.mate[y as usize] = x;
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
                    let paired = |i: usize| pairs.iter().any(|&(x, y)| x == i || y == i);
                    let rest = match_brackets(&order, &closes, |i| !paired(i));
                    pairs.extend(rest);
                }
                for &(i, j) in &pairs {
                    let (x, y) = (half_edges[i], half_edges[j]);
                    found.mate[x as usize] = y;
                    found.mate[y as usize] = x;
                }
                found.cut += 1;
                found.unpaired += (half_edges.len() - 2 * pairs.len()) as u64;
            }
        }
    }
    Ok(found)
}

/// The faces around an edge, by their places among its half-edges.
pub(super) struct AroundEdge {
    /// In angular order; empty where that can't be told.
    pub order: Vec<usize>,
    /// Whether the way around leaves a solid at the face, rather than entering one.
    pub closes: Vec<bool>,
}

/// Orders the faces around an edge. `unit` are positions in the range of [`to_unit_range`].
pub(super) fn around_edge(faces: &[[u32; 3]], unit: &[DVec3], edges: &Edges, edge: usize) -> AroundEdge {
    let half_edges = edges.half_edges(edge);
    let [a, b] = edges.vertices(edge).map(|v| unit[v as usize]);
    let points: Vec<_> = half_edges.iter().map(|&h| unit[Edges::opposite(faces, h) as usize]).collect();
    // A face that runs along the edge from the smaller vertex has the solid behind it, seen counter-clockwise: it closes.
    let closes: Vec<bool> = half_edges.iter().map(|&h| Edges::is_forward(faces, h)).collect();
    // Solids that share a wall each keep their side of it: at the same angle one closes before the next opens.
    let order = order_around(a, b, &points, |i, j| closes[j].cmp(&closes[i])).unwrap_or_default();
    AroundEdge { order, closes }
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
