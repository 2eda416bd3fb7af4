//! Open parts joined by bands.

use glam::DVec3;

use super::border::open_parts;
use super::operator::{Applied, Counter, Operation, Scope};
use crate::mesh::{Edges, Surface};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// Most boundary edges that are compared with one another; of more, every so many is.
const MOST_EDGES: usize = 4096;
/// Most open parts that are joined.
const MOST_PARTS: u64 = 1024;
/// Most edges that are looked at again because the nearest one has a band already.
const BUDGET: usize = 100_000_000;

/// Joins open parts where their boundaries come nearest, until they are one.
#[derive(Debug, Clone, Copy)]
pub struct JoinParts {
    /// The farthest that a band may be from the parts that it joins, in the model's unit.
    pub max_deviation: f64,
}

/// A boundary edge: its ends as its face runs, and its part.
struct Border {
    ends: [u32; 2],
    part: u32,
    used: bool,
}

impl JoinParts {
    /// Joins one open part after the other to those joined already, by a band of two triangles between the two boundary edges
    /// that are nearest and run against one another, so that holes are closed around both.
    ///
    /// ```text
    ///    part  |         | part          part  |_________| part
    ///          |         |        ->           |_____/___|
    ///          |         |                     |         |
    /// ```
    ///
    /// This invents surface that the model does not describe, so it runs on request only, and the report warns.
    ///
    /// Precondition: consistent winding. Result: open parts are one, no vertex moves, no face goes. Leaves: closed parts,
    /// which have nothing to be joined by, gaps wider than twice `max_deviation`, and everything where over 1024 parts are open. Of more than 4096 boundary edges only every
    /// so many is looked at, so that the bands may not be the nearest ones.
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
        if open.count > MOST_PARTS {
            let left = format!("{} open parts are more than can be joined", open.count);
            return Ok(Applied { left: Some(left), ..Applied::default() });
        }
        let mut borders = borders(surface, &open.faces, &open.part);
        let at = |v: u32| surface.positions[v as usize];
        let cost = |x: &Border, y: &Border| {
            let ([a, b], [c, d]) = (x.ends, y.ends);
            let shared = a == c || a == d || b == c || b == d;
            if shared { f64::INFINITY } else { at(a).distance(at(d)).max(at(b).distance(at(c))) }
        };
        // Prim's algorithm over edges, where the edges of one part are no distance from one another.
        let mut nearest: Vec<(f64, usize)> = vec![(f64::INFINITY, 0); borders.len()];
        let mut inside = vec![false; usize::try_from(open.count).unwrap_or(0)];
        let (mut joins, mut too_far, mut next, mut budget) = (Vec::new(), 0u64, 0, BUDGET);
        loop {
            let part = borders[next].part;
            inside[part as usize] = true;
            for i in (0..borders.len()).filter(|&i| borders[i].part == part) {
                context.check()?;
                for j in (0..borders.len()).filter(|&j| !inside[borders[j].part as usize]) {
                    let c = cost(&borders[i], &borders[j]);
                    if c < nearest[j].0 && !borders[i].used {
                        nearest[j] = (c, i);
                    }
                }
            }
            let Some(found) = nearest_outside(&borders, &inside, &mut nearest, &mut budget, cost) else { break };
            let (gap, from) = nearest[found];
            next = found;
            if gap.is_finite() && gap / 2.0 <= self.max_deviation {
                borders[found].used = true;
                borders[from].used = true;
                joins.push((from, found));
            } else {
                too_far += 1;
            }
        }
        for &(x, y) in &joins {
            let ([u, v], [p, q]) = (borders[x].ends, borders[y].ends);
            let length = |a: u32, b: u32| DVec3::distance(surface.positions[a as usize], surface.positions[b as usize]);
            let band = if length(v, q) <= length(u, p) { [[v, u, q], [v, q, p]] } else { [[v, u, p], [u, q, p]] };
            band.into_iter().for_each(|face| surface.push_patch(face));
        }
        let left = (too_far > 0).then(|| format!("{too_far} open parts are too far from all others to be joined"));
        let changes = Change::list([
            (ChangeKind::PartsJoined, joins.len() as u64),
            (ChangeKind::FacesAdded, 2 * joins.len() as u64),
        ]);
        Ok(Applied { changes, left, ..Applied::default() })
    }
}

/// The boundary edges of the open parts, or as many of them as can be compared, with at least one of each part.
fn borders(surface: &Surface, faces: &[u32], part: &[u32]) -> Vec<Border> {
    let of_open: Vec<[u32; 3]> = faces.iter().map(|&f| surface.faces[f as usize]).collect();
    let edges = Edges::new(&of_open);
    let mut all: Vec<Border> = edges
        .iter()
        .filter(|h| h.len() == 1)
        .map(|h| Border { ends: Edges::ends(&of_open, h[0]), part: part[h[0] as usize / 3], used: false })
        .collect();
    all.sort_by_key(|border| border.part);
    let stride = all.len().div_ceil(MOST_EDGES);
    let mut last = None;
    let keep = |(i, border): &(usize, Border)| {
        let first = last.replace(border.part) != Some(border.part);
        first || i.is_multiple_of(stride)
    };
    all.into_iter().enumerate().filter(keep).map(|(_, border)| border).collect()
}

/// The edge outside with the nearest one inside, none where all are inside. What was nearest to it may be used by now; then it
/// is found anew.
fn nearest_outside(
    borders: &[Border],
    inside: &[bool],
    nearest: &mut [(f64, usize)],
    budget: &mut usize,
    cost: impl Fn(&Border, &Border) -> f64,
) -> Option<usize> {
    loop {
        let outside = (0..borders.len()).filter(|&j| !inside[borders[j].part as usize]);
        let found = outside.min_by(|&i, &j| nearest[i].0.total_cmp(&nearest[j].0))?;
        let (gap, from) = nearest[found];
        if gap.is_infinite() || !borders[from].used || *budget == 0 {
            if borders[from].used {
                nearest[found].0 = f64::INFINITY;
            }
            return Some(found);
        }
        *budget = budget.saturating_sub(borders.len());
        nearest[found] = (0..borders.len())
            .filter(|&i| inside[borders[i].part as usize] && !borders[i].used)
            .map(|i| (cost(&borders[i], &borders[found]), i))
            .fold((f64::INFINITY, 0), |best, it| if it.0 < best.0 { it } else { best });
    }
}

impl Operation for JoinParts {
    const FIXES: &'static [Counter] = &[Counter::BoundaryEdges];
    // A band between parts that touch.
    const MAY_RAISE: &'static [Counter] =
        &[Counter::DegenerateFaces, Counter::NonManifoldEdges, Counter::PinchedVertices];
    const IS_ON_REQUEST: bool = true;

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self { max_deviation: scope.max_deviation }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}
