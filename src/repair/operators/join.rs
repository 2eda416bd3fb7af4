//! Joins open parts with bands of two triangles.

use glam::DVec3;

use super::border::open_parts;
use super::operator::{Applied, Counter, Operation, Scope};
use crate::mesh::{Edges, Surface};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// The most boundary edges that are compared pairwise; with more, only every n-th edge is compared.
const MAX_EDGES: usize = 4096;
/// The most open parts that can be joined.
const MAX_PARTS: u64 = 1024;
/// The most edges that are compared again because the nearest edge already has a band.
const EDGE_BUDGET: usize = 100_000_000;

/// Joins open parts where their boundaries are closest, until one open part remains.
#[derive(Debug, Clone, Copy)]
pub struct JoinParts {
    /// The farthest that a band may be from the two parts that it joins, in the model's unit.
    pub max_deviation: f64,
}

/// A boundary edge: its ends in the face's direction, its part, and whether it has a band.
struct BoundaryEdge {
    ends: [u32; 2],
    part: u32,
    used: bool,
}

impl JoinParts {
    /// Joins the open parts one by one. A band of two triangles connects the two nearest boundary edges that run in
    /// opposite directions, so that the hole fills that follow run around both parts.
    ///
    /// ```text
    ///    part  |         | part          part  |_________| part
    ///          |         |        ->           |_____/___|
    ///          |         |                     |         |
    /// ```
    ///
    /// The bands invent surface that the model does not describe. So the operator runs on request only, and the report warns.
    ///
    /// Precondition: consistent winding. Result: the open parts are one part; no vertex moves and no face is removed.
    /// Leaves: closed parts, which have no boundary; gaps wider than twice `max_deviation`; every part where more than 1024
    /// parts are open. With more than 4096 boundary edges only every n-th is compared, so the bands may not be the shortest.
    ///
    /// After the option `joincomp` of Attene 2010, "A lightweight approach to repairing digitized polygon meshes".
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let open = open_parts(surface);
        if open.count < 2 {
            return Ok(Applied::default());
        }
        if open.count > MAX_PARTS {
            let left = format!("{} open parts are too many to join; the limit is {MAX_PARTS}", open.count);
            return Ok(Applied { left: Some(left), ..Applied::default() });
        }
        let mut boundary = boundary(surface, &open.faces, &open.part);
        let at = |v: u32| surface.positions[v as usize];
        let cost = |x: &BoundaryEdge, y: &BoundaryEdge| {
            let ([a, b], [c, d]) = (x.ends, y.ends);
            let shared = a == c || a == d || b == c || b == d;
            if shared { f64::INFINITY } else { at(a).distance(at(d)).max(at(b).distance(at(c))) }
        };
        // Prim's algorithm over edges, where edges of one part have distance zero.
        let mut nearest: Vec<(f64, usize)> = vec![(f64::INFINITY, 0); boundary.len()];
        let mut joined = vec![false; usize::try_from(open.count).unwrap_or(0)];
        let (mut joins, mut too_far, mut next, mut budget) = (Vec::new(), 0u64, 0, EDGE_BUDGET);
        loop {
            let part = boundary[next].part;
            joined[part as usize] = true;
            for i in (0..boundary.len()).filter(|&i| boundary[i].part == part) {
                context.check()?;
                for j in (0..boundary.len()).filter(|&j| !joined[boundary[j].part as usize]) {
                    let c = cost(&boundary[i], &boundary[j]);
                    if c < nearest[j].0 && !boundary[i].used {
                        nearest[j] = (c, i);
                    }
                }
            }
            let Some(nearest_edge) = nearest_outside(&boundary, &joined, &mut nearest, &mut budget, cost) else {
                break;
            };
            let (gap, from) = nearest[nearest_edge];
            next = nearest_edge;
            if gap.is_finite() && gap / 2.0 <= self.max_deviation {
                boundary[nearest_edge].used = true;
                boundary[from].used = true;
                joins.push((from, nearest_edge));
            } else {
                too_far += 1;
            }
        }
        for &(x, y) in &joins {
            let ([u, v], [p, q]) = (boundary[x].ends, boundary[y].ends);
            let length = |a: u32, b: u32| DVec3::distance(surface.positions[a as usize], surface.positions[b as usize]);
            let band = if length(v, q) <= length(u, p) { [[v, u, q], [v, q, p]] } else { [[v, u, p], [u, q, p]] };
            band.into_iter().for_each(|face| surface.push_patch(face));
        }
        let left =
            (too_far > 0).then(|| format!("{too_far} open parts are too far from every other part to be joined"));
        let changes = Change::list([
            (ChangeKind::PartsJoined, joins.len() as u64),
            (ChangeKind::FacesAdded, 2 * joins.len() as u64),
        ]);
        Ok(Applied { changes, left, ..Applied::default() })
    }
}

/// The boundary edges of the open parts, thinned to the comparison limit, with at least one edge of each part.
fn boundary(surface: &Surface, faces: &[u32], part: &[u32]) -> Vec<BoundaryEdge> {
    let of_open: Vec<[u32; 3]> = faces.iter().map(|&f| surface.faces[f as usize]).collect();
    let edges = Edges::new(&of_open);
    let mut all: Vec<BoundaryEdge> = edges
        .iter()
        .filter(|h| h.len() == 1)
        .map(|h| BoundaryEdge { ends: Edges::ends(&of_open, h[0]), part: part[h[0] as usize / 3], used: false })
        .collect();
    all.sort_by_key(|edge| edge.part);
    let stride = all.len().div_ceil(MAX_EDGES);
    let mut last = None;
    let keep = |(i, edge): &(usize, BoundaryEdge)| {
        let first = last.replace(edge.part) != Some(edge.part);
        first || i.is_multiple_of(stride)
    };
    all.into_iter().enumerate().filter(keep).map(|(_, edge)| edge).collect()
}

/// The unjoined edge that is nearest to the joined parts; `None` where every part is joined. Where its nearest joined edge
/// has a band by now, the distance is computed again.
fn nearest_outside(
    boundary: &[BoundaryEdge],
    joined: &[bool],
    nearest: &mut [(f64, usize)],
    budget: &mut usize,
    cost: impl Fn(&BoundaryEdge, &BoundaryEdge) -> f64,
) -> Option<usize> {
    loop {
        let outside = (0..boundary.len()).filter(|&j| !joined[boundary[j].part as usize]);
        let candidate = outside.min_by(|&i, &j| nearest[i].0.total_cmp(&nearest[j].0))?;
        let (gap, from) = nearest[candidate];
        if gap.is_infinite() || !boundary[from].used || *budget == 0 {
            if boundary[from].used {
                nearest[candidate].0 = f64::INFINITY;
            }
            return Some(candidate);
        }
        *budget = budget.saturating_sub(boundary.len());
        nearest[candidate] = (0..boundary.len())
            .filter(|&i| joined[boundary[i].part as usize] && !boundary[i].used)
            .map(|i| (cost(&boundary[i], &boundary[candidate]), i))
            .fold((f64::INFINITY, 0), |best, other| if other.0 < best.0 { other } else { best });
    }
}

impl Operation<'_> for JoinParts {
    const FIXES: &'static [Counter] = &[Counter::BoundaryEdges];
    // A band between parts that touch may be degenerate or non-manifold.
    const MAY_RAISE: &'static [Counter] =
        &[Counter::DegenerateFaces, Counter::NonManifoldEdges, Counter::PinchedVertices];
    const IS_ON_REQUEST: bool = true;
    const ACTS_ON: &'static [Counter] = &[Counter::BoundaryEdges];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self { max_deviation: scope.max_deviation }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}
