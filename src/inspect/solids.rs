//! What the parts of a mesh enclose, and which lies in which.

use glam::DVec3;

use crate::context::{Cancelled, Context};
use crate::math::{Box3, Crossing, Tree, crossing, ray_direction, to_unit_range};
use crate::mesh::{Edges, Parts, Surface};

/// Rays tried from one vertex before another is taken.
const ATTEMPTS: u32 = 8;
/// Faces that all rays together may look at, and as many again for each face, so that thousands of nested shells, of
/// which each ray meets them all, do not take for ever.
const BUDGET: u64 = 5_000_000;
const BUDGET_A_FACE: u64 = 8;

/// What one part or patch of a surface is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solid {
    /// Whether each of its edges is used by exactly two of its faces, once in each direction.
    pub closed: bool,
    /// Signed volume by the divergence theorem, about the middle of its box; it means little where it is not closed.
    pub volume: f64,
    /// Area.
    pub area: f64,
    /// Box.
    pub bounds: Box3,
}

/// Measures every part of `parts`. Linear but for the sort within `edges`.
#[must_use]
pub fn solids(surface: &Surface, edges: &Edges, parts: &Parts) -> Vec<Solid> {
    let mut all = vec![Solid { closed: true, volume: 0.0, area: 0.0, bounds: Box3::EMPTY }; parts.count];
    let each = |f: usize| {
        let part = parts.of_face[f];
        (part != Parts::NONE).then_some(part as usize)
    };
    for f in 0..surface.faces.len() {
        if let Some(part) = each(f) {
            for p in surface.corners(f) {
                all[part].bounds.extend(p);
            }
        }
    }
    for f in 0..surface.faces.len() {
        if let Some(part) = each(f) {
            let it = &mut all[part];
            let about = it.bounds.centre();
            let [a, b, c] = surface.corners(f).map(|p| p - about);
            it.volume += a.dot(b.cross(c)) / 6.0;
            it.area += (b - a).cross(c - a).length() / 2.0;
        }
    }
    for half_edges in edges.iter() {
        mark_open(surface, parts, half_edges, &mut all);
    }
    all
}

/// Marks the parts open that do not use this edge twice, once in each direction.
fn mark_open(surface: &Surface, parts: &Parts, half_edges: &[u32], all: &mut [Solid]) {
    let part = |h: u32| parts.of_face[h as usize / 3];
    if let &[a, b] = half_edges
        && part(a) == part(b)
    {
        if Edges::is_forward(&surface.faces, a) == Edges::is_forward(&surface.faces, b) {
            all[part(a) as usize].closed = false;
        }
        return;
    }
    let mut uses: Vec<(u32, bool)> =
        half_edges.iter().map(|&h| (part(h), Edges::is_forward(&surface.faces, h))).collect();
    uses.sort_unstable();
    for of_part in uses.chunk_by(|x, y| x.0 == y.0) {
        if of_part.len() != 2 || of_part[0].1 == of_part[1].1 {
            all[of_part[0].0 as usize].closed = false;
        }
    }
}

/// Twice the area of each face.
#[must_use]
pub fn doubled_areas(surface: &Surface) -> Vec<f64> {
    (0..surface.faces.len()).map(|f| DVec3::length(surface.area_vector(f))).collect()
}

/// How many other closed parts each closed part lies in, as [`nesting`] tells of it.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn nesting_depths(
    surface: &Surface,
    parts: &Parts,
    solids: &[Solid],
    wanted: &[bool],
    context: &Context<'_>,
) -> Result<Vec<Option<u32>>, Cancelled> {
    Ok(depths_of(&nesting(surface, parts, solids, wanted, context)?))
}

/// The count of each part's containers.
pub(super) fn depths_of(containers: &[Option<Vec<u32>>]) -> Vec<Option<u32>> {
    #[expect(clippy::cast_possible_truncation, reason = "parts are counted in u32")]
    containers.iter().map(|of_part| of_part.as_ref().map(|of_part| of_part.len() as u32)).collect()
}

/// The other closed parts that each closed part lies in, in order, where `wanted` asks for it; none where it is not asked
/// for, not closed, or can't be told (it touches another part at all tried vertices, or the budget is spent).
///
/// Counts exact crossings of a ray from two extreme vertices of the part with every part whose box holds its box:
/// an odd number means inside. Both vertices must agree, so that parts that merely overlap are not taken for nested.
/// Where no box holds another no ray is cast, and rays end where the boxes do, so that many parts side by side cost
/// n log n.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn nesting(
    surface: &Surface,
    parts: &Parts,
    solids: &[Solid],
    wanted: &[bool],
    context: &Context<'_>,
) -> Result<Vec<Option<Vec<u32>>>, Cancelled> {
    let mut all: Vec<Option<Vec<u32>>> =
        solids.iter().zip(wanted).map(|(s, &w)| (s.closed && w).then(Vec::new)).collect();
    if solids.iter().filter(|s| s.closed).count() < 2 || all.iter().all(Option::is_none) {
        return Ok(all);
    }
    let mut budget = BUDGET + BUDGET_A_FACE * surface.faces.len() as u64;
    let around = boxes_around(solids, &all, &mut budget, context)?;
    if around.iter().all(|boxes| boxes.as_ref().is_some_and(Vec::is_empty)) {
        return Ok(all);
    }
    let unit = to_unit_range(&surface.positions);
    let extents = extents(surface, parts, solids, &unit);
    let mut holds_any = vec![false; solids.len()];
    for &part in around.iter().flatten().flatten() {
        holds_any[part as usize] = true;
    }
    let sources: Vec<u32> = (0u32..)
        .zip(&parts.of_face)
        .filter(|&(_, &p)| p != Parts::NONE && holds_any[p as usize])
        .map(|(f, _)| f)
        .collect();
    let faces: Vec<[u32; 3]> = sources.iter().map(|&f| surface.faces[f as usize]).collect();
    let tree = Tree::new(&unit, &faces);
    let rays = Rays { parts, unit: &unit, sources: &sources, faces: &faces, tree: &tree };
    for (part, (of_part, boxes)) in all.iter_mut().zip(around).enumerate() {
        if part % 256 == 0 {
            context.check()?;
        }
        let (true, Some(Extent { ends, .. })) = (of_part.is_some(), extents[part]) else { continue };
        let Some(boxes) = boxes.filter(|_| budget > 0) else {
            *of_part = None;
            continue;
        };
        if boxes.is_empty() {
            continue;
        }
        let mut whole = Box3::EMPTY;
        for it in boxes.iter().filter_map(|&b| extents[b as usize]) {
            whole.extend(it.bounds.min);
            whole.extend(it.bounds.max);
        }
        // From within a box a ray of its diagonal's length ends outside.
        let length = (whole.diagonal() * 1.001).clamp(f64::MIN_POSITIVE, 8.0);
        let mut containers: Option<Vec<u32>> = None;
        for v in ends {
            let Some(odd) = rays.crossed_oddly(unit[v as usize], length, &boxes, &mut budget) else { continue };
            containers = Some(match containers {
                None => odd,
                Some(first) => first.into_iter().filter(|p| odd.binary_search(p).is_ok()).collect(),
            });
        }
        *of_part = containers;
    }
    Ok(all)
}

/// Rays through the faces of the parts whose boxes hold others.
struct Rays<'a> {
    parts: &'a Parts,
    unit: &'a [DVec3],
    /// The faces by number in the surface, and their vertices.
    sources: &'a [u32],
    faces: &'a [[u32; 3]],
    tree: &'a Tree,
}

impl Rays<'_> {
    /// Those of `candidates` that a ray of some length crosses an odd number of times, in order; none where every ray that was tried
    /// touches an edge or a vertex, or the budget was spent before.
    fn crossed_oddly(&self, from: DVec3, length: f64, candidates: &[u32], budget: &mut u64) -> Option<Vec<u32>> {
        let mut hits = Vec::new();
        let is_clear = (0..ATTEMPTS).any(|attempt| {
            hits.clear();
            let to = from + ray_direction(attempt) * length;
            let mut clear = true;
            self.tree.along(from, to, |i| {
                *budget = budget.saturating_sub(1);
                let other = self.parts.of_face[self.sources[i as usize] as usize];
                if candidates.binary_search(&other).is_ok() {
                    match crossing(from, to, self.faces[i as usize].map(|v| self.unit[v as usize])) {
                        Crossing::Miss => {}
                        Crossing::Enters | Crossing::Leaves => hits.push(other),
                        Crossing::Touches => clear = false,
                    }
                }
                clear && *budget > 0
            });
            clear && *budget > 0
        });
        if !is_clear {
            return None;
        }
        hits.sort_unstable();
        Some(hits.chunk_by(|a, b| a == b).filter(|c| c.len() % 2 == 1).map(|c| c[0]).collect())
    }
}

/// For each part that is asked for the other closed parts whose boxes hold its box, in order; none where the budget was
/// spent before.
fn boxes_around(
    solids: &[Solid],
    asked: &[Option<Vec<u32>>],
    budget: &mut u64,
    context: &Context<'_>,
) -> Result<Vec<Option<Vec<u32>>>, Cancelled> {
    let closed: Vec<u32> = (0u32..).zip(solids).filter(|(_, s)| s.closed).map(|(p, _)| p).collect();
    // A triangle between two opposite corners of a box has the same box.
    let corners: Vec<DVec3> =
        closed.iter().flat_map(|&p| [solids[p as usize].bounds.min, solids[p as usize].bounds.max]).collect();
    let diagonals: Vec<[u32; 3]> = (0u32..).step_by(2).zip(&closed).map(|(i, _)| [i, i + 1, i]).collect();
    let tree = Tree::new(&corners, &diagonals);
    let mut around = vec![Some(Vec::new()); solids.len()];
    for (part, boxes) in around.iter_mut().enumerate().filter(|(part, _)| asked[*part].is_some()) {
        if part % 256 == 0 {
            context.check()?;
        }
        let bounds = &solids[part].bounds;
        let mut found = Vec::new();
        tree.around(bounds.min, 0.0, |i| {
            *budget = budget.saturating_sub(1);
            let other = closed[i as usize];
            if other as usize != part && solids[other as usize].bounds.contains(bounds) {
                found.push(other);
            }
            *budget > 0
        });
        found.sort_unstable();
        *boxes = (*budget > 0).then_some(found);
    }
    Ok(around)
}

/// Where a part is, on the unit scale.
#[derive(Debug, Clone, Copy)]
struct Extent {
    /// Its lowest and its highest vertex.
    ends: [u32; 2],
    bounds: Box3,
}

/// The extent of each closed part.
fn extents(surface: &Surface, parts: &Parts, solids: &[Solid], unit: &[DVec3]) -> Vec<Option<Extent>> {
    let mut extents: Vec<Option<Extent>> = vec![None; solids.len()];
    for (face, &part) in surface.faces.iter().zip(&parts.of_face) {
        if part == Parts::NONE || !solids[part as usize].closed {
            continue;
        }
        for &v in face {
            let p = unit[v as usize];
            let it = extents[part as usize].get_or_insert(Extent { ends: [v, v], bounds: Box3::EMPTY });
            it.bounds.extend(p);
            if before(p, unit[it.ends[0] as usize]) {
                it.ends[0] = v;
            }
            if before(unit[it.ends[1] as usize], p) {
                it.ends[1] = v;
            }
        }
    }
    extents
}

fn before(a: DVec3, b: DVec3) -> bool {
    a.to_array().partial_cmp(&b.to_array()) == Some(std::cmp::Ordering::Less)
}
