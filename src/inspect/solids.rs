//! Enclosed volumes of a mesh's parts, and nesting of the parts.

use std::ops::Range;

use glam::DVec3;

use crate::context::{Cancelled, Context};
use crate::math::{Box3, Crossing, Tree, crossing, ray_direction, threads, to_unit_range};
use crate::mesh::{Edges, Parts, Surface};

/// Number of parts up to which chunks of faces are measured in parallel.
const FEW_PARTS: usize = 64;
/// Number of rays tried from one vertex.
const ATTEMPTS: u32 = 8;
/// Budget of all rays: faces visited, a fixed allowance plus an allowance per face. Bounds the time for thousands of
/// nested shells, where every ray crosses all of them.
const BUDGET: u64 = 5_000_000;
const BUDGET_PER_FACE: u64 = 8;

/// Measures of one part or patch of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solid {
    /// Whether exactly two of the part's faces use each of its edges, once in each direction.
    pub closed: bool,
    /// Signed volume by the divergence theorem, relative to the centre of the box. Has little meaning if the part is
    /// open.
    pub volume: f64,
    /// Surface area.
    pub area: f64,
    /// Bounding box.
    pub bounds: Box3,
}

/// Measures every part of `parts`. O(n), plus sorting within `edges`. In parallel if the faces are many and the parts few.
#[must_use]
pub fn solids(surface: &Surface, edges: &Edges, parts: &Parts) -> Vec<Solid> {
    let part_of = |f: usize| {
        let part = parts.of_face[f];
        (part != Parts::NONE).then_some(part as usize)
    };
    let mut all = over_chunks(surface.faces.len(), parts.count, |f, all| {
        if let Some(part) = part_of(f) {
            surface.corners(f).into_iter().for_each(|p| all[part].bounds.extend(p));
        }
    });
    let centres: Vec<DVec3> = all.iter().map(|solid| solid.bounds.centre()).collect();
    let contents = over_chunks(surface.faces.len(), parts.count, |f, all| {
        if let Some(part) = part_of(f) {
            let solid = &mut all[part];
            let [a, b, c] = surface.corners(f).map(|p| p - centres[part]);
            solid.volume += a.dot(b.cross(c)) / 6.0;
            solid.area += (b - a).cross(c - a).length() / 2.0;
        }
    });
    let closed =
        over_chunks(edges.len(), parts.count, |edge, all| mark_open(surface, parts, edges.half_edges(edge), all));
    for (solid, (content, of_edges)) in all.iter_mut().zip(contents.iter().zip(&closed)) {
        (solid.volume, solid.area, solid.closed) = (content.volume, content.area, of_edges.closed);
    }
    all
}

/// Measures `parts` parts by a function of each item from 0 to `items`. If the parts are few, chunks of the items are measured in
/// parallel, and their measures are joined in the order of the chunks.
fn over_chunks(items: usize, parts: usize, measure: impl Fn(usize, &mut [Solid]) + Sync + Send) -> Vec<Solid> {
    let none = || vec![Solid { closed: true, volume: 0.0, area: 0.0, bounds: Box3::EMPTY }; parts];
    let of_range = |range: Range<usize>| {
        let mut all = none();
        range.for_each(|item| measure(item, &mut all));
        all
    };
    if parts > FEW_PARTS {
        return of_range(0..items);
    }
    let chunks = threads::map_chunks(items, of_range).into_iter();
    chunks.reduce(|all, chunk| all.iter().zip(&chunk).map(|(a, b)| a.joined(b)).collect()).unwrap_or_else(none)
}

impl Solid {
    /// The measures of two sets of faces and edges of one part together.
    fn joined(&self, other: &Self) -> Self {
        Self {
            closed: self.closed && other.closed,
            volume: self.volume + other.volume,
            area: self.area + other.area,
            bounds: self.bounds.joined(&other.bounds),
        }
    }
}

/// Marks parts as open that do not use this edge exactly twice, once in each direction.
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
    threads::map_cheap(surface.faces.len(), |f| surface.area_vector(f).length())
}

/// For each closed part the number of other closed parts that contain it, as [`nesting`] computes.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn nesting_depths(
    surface: &Surface,
    parts: &Parts,
    solids: &[Solid],
    requested: &[bool],
    context: &Context<'_>,
) -> Result<Vec<Option<u32>>, Cancelled> {
    Ok(depths_of(&nesting(surface, parts, solids, requested, context)?))
}

/// Number of containers of each part.
pub(super) fn depths_of(containers: &[Option<Vec<u32>>]) -> Vec<Option<u32>> {
    #[expect(clippy::cast_possible_truncation, reason = "parts are counted in u32")]
    containers.iter().map(|of_part| of_part.as_ref().map(|of_part| of_part.len() as u32)).collect()
}

/// For each requested closed part, the other closed parts that contain it, in ascending order. `None` if the part is
/// not requested, is open, or is undecided because it touches another part at all tried vertices or the budget ran
/// out.
///
/// Counts exact crossings of rays from two extreme vertices of the part with every part whose bounding box contains
/// the part's box. An odd number means inside. Both vertices must agree, so that parts that merely overlap do not
/// count as nested. Casts no rays if no box contains another, and ends rays at the boxes, so that many parts side by
/// side cost O(n log n).
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn nesting(
    surface: &Surface,
    parts: &Parts,
    solids: &[Solid],
    requested: &[bool],
    context: &Context<'_>,
) -> Result<Vec<Option<Vec<u32>>>, Cancelled> {
    let mut all: Vec<Option<Vec<u32>>> =
        solids.iter().zip(requested).map(|(s, &w)| (s.closed && w).then(Vec::new)).collect();
    if solids.iter().filter(|s| s.closed).count() < 2 || all.iter().all(Option::is_none) {
        return Ok(all);
    }
    let mut budget = BUDGET + BUDGET_PER_FACE * surface.faces.len() as u64;
    let enclosing_boxes = boxes_around(solids, &all, &mut budget, context)?;
    if enclosing_boxes.iter().all(|boxes| boxes.as_ref().is_some_and(Vec::is_empty)) {
        return Ok(all);
    }
    let unit = to_unit_range(&surface.positions);
    let extents = extents(surface, parts, solids, &unit);
    let mut holds_any = vec![false; solids.len()];
    for &part in enclosing_boxes.iter().flatten().flatten() {
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
    for (part, (of_part, boxes)) in all.iter_mut().zip(enclosing_boxes).enumerate() {
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
        let mut combined = Box3::EMPTY;
        for extent in boxes.iter().filter_map(|&b| extents[b as usize]) {
            combined = combined.joined(&extent.bounds);
        }
        // A ray from inside a box, as long as the box's diagonal, ends outside.
        let length = (combined.diagonal() * 1.001).clamp(f64::MIN_POSITIVE, 8.0);
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

/// Ray queries against the faces of parts whose boxes contain other parts.
struct Rays<'a> {
    parts: &'a Parts,
    unit: &'a [DVec3],
    /// Indices of the faces in the surface; `faces` holds their vertices.
    sources: &'a [u32],
    faces: &'a [[u32; 3]],
    tree: &'a Tree,
}

impl Rays<'_> {
    /// The candidates that a ray of the given length crosses an odd number of times, in ascending order. `None` if
    /// every tried ray touches an edge or a vertex, or the budget ran out.
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

/// For each requested part the other closed parts whose boxes contain its box, in ascending order; `None` if the
/// budget ran out.
fn boxes_around(
    solids: &[Solid],
    requested: &[Option<Vec<u32>>],
    budget: &mut u64,
    context: &Context<'_>,
) -> Result<Vec<Option<Vec<u32>>>, Cancelled> {
    let closed: Vec<u32> = (0u32..).zip(solids).filter(|(_, s)| s.closed).map(|(p, _)| p).collect();
    // A degenerate triangle between two opposite corners of a box has the same bounding box.
    let corners: Vec<DVec3> =
        closed.iter().flat_map(|&p| [solids[p as usize].bounds.min, solids[p as usize].bounds.max]).collect();
    let diagonals: Vec<[u32; 3]> = (0u32..).step_by(2).zip(&closed).map(|(i, _)| [i, i + 1, i]).collect();
    let tree = Tree::new(&corners, &diagonals);
    let mut enclosing_boxes = vec![Some(Vec::new()); solids.len()];
    for (part, boxes) in enclosing_boxes.iter_mut().enumerate().filter(|(part, _)| requested[*part].is_some()) {
        if part % 256 == 0 {
            context.check()?;
        }
        let bounds = &solids[part].bounds;
        let mut containers = Vec::new();
        tree.around(bounds.min, 0.0, |i| {
            *budget = budget.saturating_sub(1);
            let other = closed[i as usize];
            if other as usize != part && solids[other as usize].bounds.contains(bounds) {
                containers.push(other);
            }
            *budget > 0
        });
        containers.sort_unstable();
        *boxes = (*budget > 0).then_some(containers);
    }
    Ok(enclosing_boxes)
}

/// Extent of a part, on the unit scale.
#[derive(Debug, Clone, Copy)]
struct Extent {
    /// The part's lexicographically smallest and largest vertices.
    ends: [u32; 2],
    bounds: Box3,
}

/// Extent of each closed part.
fn extents(surface: &Surface, parts: &Parts, solids: &[Solid], unit: &[DVec3]) -> Vec<Option<Extent>> {
    let mut extents: Vec<Option<Extent>> = vec![None; solids.len()];
    for (face, &part) in surface.faces.iter().zip(&parts.of_face) {
        if part == Parts::NONE || !solids[part as usize].closed {
            continue;
        }
        for &v in face {
            let p = unit[v as usize];
            let extent = extents[part as usize].get_or_insert(Extent { ends: [v, v], bounds: Box3::EMPTY });
            extent.bounds.extend(p);
            if precedes(p, unit[extent.ends[0] as usize]) {
                extent.ends[0] = v;
            }
            if precedes(unit[extent.ends[1] as usize], p) {
                extent.ends[1] = v;
            }
        }
    }
    extents
}

fn precedes(a: DVec3, b: DVec3) -> bool {
    a.to_array().partial_cmp(&b.to_array()) == Some(std::cmp::Ordering::Less)
}
