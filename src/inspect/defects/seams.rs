//! Boundaries that lie on or near one another, though nothing joins them.
//!
//! ```text
//!   slit                 T-junction            crack
//!   o----o----o          o---------o           o----o----o
//!   o----o----o          o----o----o
//!   ends coincide        an end lies on        o-------o----o
//!                        the other edge        a gap that can be seen
//! ```
//!
//! What coincides exactly in all vertices is one edge already, since vertices are merged at equal positions; where the file's own
//! indices do not join it, it is a slit of no gap to readers that take vertices by index. A gap up to
//! the slit tolerance makes a slit, a wider one a crack; so no two boundary edges are both.

use glam::DVec3;

use super::super::DefectKind;
use super::super::measure::unshared_edges;
use super::chains::chains;
use super::scan::{Location, ROUNDING, Scan};
use crate::context::Cancelled;
use crate::math::{Tree, collinear, midmost};
use crate::mesh::Edges;

/// Boundary edges that one query may look at, and all queries together for each edge and at least.
const MOST_A_QUERY: u64 = 1024;
const MOST_A_BOX: u64 = 32;
const MOST_AT_LEAST: u64 = 2_000_000;
/// The widest gap beside an edge, as a share of its length: what is farther apart are two sides of something.
const GAP_SHARE: f64 = 0.2;

/// A tree that is asked within a budget.
struct Near {
    tree: Tree,
    /// Looks that are left.
    budget: u64,
    /// Whether a search was given up.
    gave_up: bool,
}

impl Near {
    fn new(positions: &[DVec3], boxes: &[[u32; 3]]) -> Self {
        let budget = MOST_AT_LEAST + MOST_A_BOX * boxes.len() as u64;
        Self { tree: Tree::new(positions, boxes), budget, gave_up: false }
    }

    /// Calls `visit` with what is near a point, as far as the budget goes.
    fn around(&mut self, point: DVec3, reach: f64, mut visit: impl FnMut(u32)) {
        let most = self.budget.min(MOST_A_QUERY);
        let (mut looks, mut gave_up) = (0, false);
        self.tree.around(point, reach, |found| {
            gave_up = looks == most;
            if !gave_up {
                looks += 1;
                visit(found);
            }
            !gave_up
        });
        self.budget -= looks;
        self.gave_up |= gave_up;
    }
}

/// The boundary edges.
struct Boundary {
    half_edges: Vec<u32>,
    ends: Vec<[u32; 2]>,
}

impl Boundary {
    fn face(&self, edge: u32) -> u32 {
        self.half_edges[edge as usize] / 3
    }

    fn len(&self) -> u32 {
        u32::try_from(self.ends.len()).unwrap_or(u32::MAX)
    }
}

/// Finds slits, cracks and T-junctions. O(n log n) in the number of boundary edges, within the budget.
pub(super) fn find(scan: &mut Scan<'_, '_>) -> Result<(), Cancelled> {
    let analysis = scan.analysis;
    find_unshared(scan)?;
    let faces = &analysis.surface.faces;
    let mut half_edges: Vec<u32> = analysis.edges.iter().filter(|h| h.len() == 1).map(|h| h[0]).collect();
    if half_edges.len() < 2 {
        return Ok(());
    }
    half_edges.sort_unstable();
    let ends: Vec<[u32; 2]> = half_edges.iter().map(|&h| Edges::ends(faces, h)).collect();
    let boundary = Boundary { half_edges, ends };
    let slit = find_slits(scan, &boundary)?;
    let boxes: Vec<[u32; 3]> = boundary.ends.iter().map(|&[a, b]| [a, b, b]).collect();
    let mut near = Near::new(scan.unit, &boxes);
    drop(boxes);
    let budget = near.budget;
    find_cracks(scan, &boundary, &mut near, &slit)?;
    if std::mem::take(&mut near.gave_up) {
        scan.incomplete(DefectKind::Crack);
    }
    near.budget = budget;
    find_t_junctions(scan, &boundary, &mut near)?;
    if near.gave_up {
        scan.incomplete(DefectKind::TJunction);
    }
    Ok(())
}

/// Reports edges that only position joins as slits without a gap, in a format whose readers take vertices by index.
fn find_unshared(scan: &mut Scan<'_, '_>) -> Result<(), Cancelled> {
    let analysis = scan.analysis;
    let edges: Vec<usize> = unshared_edges(analysis).collect();
    scan.context().check()?;
    let ends: Vec<[u32; 2]> = edges.iter().map(|&edge| analysis.edges.vertices(edge)).collect();
    for (number, chain) in chains(&ends, &[]).into_iter().enumerate() {
        scan.step(number)?;
        let beside =
            chain.edges.iter().flat_map(|&e| analysis.edges.half_edges(edges[e as usize]).iter().map(|h| h / 3));
        let faces: Vec<u32> = beside.collect();
        let line = scan.points(chain.line);
        let Some(&at) = line.first() else { continue };
        scan.put(DefectKind::Slit, Location { at, line: &line }, faces, Some(0.0));
    }
    Ok(())
}

/// Boundary edges that lie along others.
#[derive(Default)]
struct Beside {
    /// The edge, the other one, and the gap on the unit scale.
    pairs: Vec<(u32, u32, f64)>,
}

impl Beside {
    /// Reports one defect for each set of edges that hang together or lie along one another.
    fn report(self, kind: DefectKind, scan: &mut Scan<'_, '_>, boundary: &Boundary) -> Result<(), Cancelled> {
        let mut edges: Vec<u32> = self.pairs.iter().flat_map(|&(e, other, _)| [e, other]).collect();
        edges.sort_unstable();
        edges.dedup();
        let place = |e: u32| edges.partition_point(|&x| x < e);
        #[expect(clippy::cast_possible_truncation, reason = "edges are counted in u32")]
        let also: Vec<(u32, u32)> =
            self.pairs.iter().map(|&(e, other, _)| (place(e) as u32, place(other) as u32)).collect();
        let mut gaps = vec![0.0f64; edges.len()];
        for &(e, _, gap) in &self.pairs {
            let widest = &mut gaps[place(e)];
            *widest = widest.max(gap);
        }
        let ends: Vec<[u32; 2]> = edges.iter().map(|&e| boundary.ends[e as usize]).collect();
        for (number, chain) in chains(&ends, &also).into_iter().enumerate() {
            scan.step(number)?;
            let gap = chain.edges.iter().map(|&e| gaps[e as usize]).fold(0.0, f64::max);
            let line = scan.points(chain.line);
            let faces = chain.edges.iter().map(|&e| boundary.face(edges[e as usize]));
            let location = Location { at: line[0], line: &line };
            scan.put(kind, location, faces, Some(scan.in_model_unit_above_zero(gap)));
        }
        Ok(())
    }
}

/// Finds boundary edges with both ends at those of another. Answers which edges are in slits.
fn find_slits(scan: &mut Scan<'_, '_>, boundary: &Boundary) -> Result<Vec<bool>, Cancelled> {
    let unit = scan.unit;
    let slit = scan.lengths.slit;
    let ends = |e: u32| boundary.ends[e as usize].map(|v| unit[v as usize]);
    // Edges that coincide have their middles in one place.
    let middles: Vec<DVec3> = (0..boundary.len()).map(|e| (ends(e)[0] + ends(e)[1]) * 0.5).collect();
    let boxes: Vec<[u32; 3]> = (0..boundary.len()).map(|e| [e; 3]).collect();
    let mut near = Near::new(&middles, &boxes);
    drop(boxes);
    let mut slits = Beside::default();
    let mut found = vec![false; middles.len()];
    for e in 0..boundary.len() {
        scan.step(e as usize)?;
        let [a, b] = ends(e);
        // All that is near a shorter edge coincides with it.
        if a.distance(b) <= 2.0 * slit {
            continue;
        }
        let mut nearest = (f64::INFINITY, e);
        near.around(middles[e as usize], slit, |other| {
            let [c, d] = ends(other);
            let along = a.distance(c).max(b.distance(d));
            let against = a.distance(d).max(b.distance(c));
            let gap = along.min(against);
            if other != e && (gap, other) < nearest {
                nearest = (gap, other);
            }
        });
        if nearest.0 <= slit {
            found[e as usize] = true;
            slits.pairs.push((e, nearest.1, nearest.0));
        }
    }
    if near.gave_up {
        scan.incomplete(DefectKind::Slit);
    }
    slits.report(DefectKind::Slit, scan, boundary)?;
    Ok(found)
}

/// Finds boundary edges whose middle has another boundary edge near it, but for those in slits.
fn find_cracks(
    scan: &mut Scan<'_, '_>,
    boundary: &Boundary,
    near: &mut Near,
    in_slit: &[bool],
) -> Result<(), Cancelled> {
    let unit = scan.unit;
    let ends = |e: u32| boundary.ends[e as usize].map(|v| unit[v as usize]);
    let mut cracks = Beside::default();
    for e in (0..boundary.len()).filter(|&e| !in_slit[e as usize]) {
        scan.step(e as usize)?;
        let [a, b] = ends(e);
        let widest = scan.lengths.crack.min(GAP_SHARE * a.distance(b));
        let middle = (a + b) * 0.5;
        let mut nearest = (f64::INFINITY, e);
        near.around(middle, widest, |other| {
            let [c, d] = ends(other);
            let gap = segment_distance(middle, c, d);
            if other != e && (gap, other) < nearest {
                nearest = (gap, other);
            }
        });
        // Without a gap the ends of one edge lie within the other, which makes T-junctions.
        if nearest.0 > scan.lengths.slit && nearest.0 <= widest {
            cracks.pairs.push((e, nearest.1, nearest.0));
        }
    }
    cracks.report(DefectKind::Crack, scan, boundary)
}

/// Finds ends of boundary edges that lie on another boundary edge between its ends, each once, with the nearest.
fn find_t_junctions(scan: &mut Scan<'_, '_>, boundary: &Boundary, near: &mut Near) -> Result<(), Cancelled> {
    let (unit, faces) = (scan.unit, &scan.analysis.surface.faces);
    let reach = scan.lengths.t_junction;
    let mut uses: Vec<(u32, u32)> = (0u32..).zip(&boundary.ends).flat_map(|(e, &[a, b])| [(a, e), (b, e)]).collect();
    uses.sort_unstable();
    for (number, of_vertex) in uses.chunk_by(|x, y| x.0 == y.0).enumerate() {
        scan.step(number)?;
        let v = of_vertex[0].0;
        let p = unit[v as usize];
        let mut nearest: Option<(f64, u32)> = None;
        near.around(p, reach, |e| {
            let [a, b] = boundary.ends[e as usize].map(|v| unit[v as usize]);
            let gap = segment_distance(p, a, b);
            // Near an end it is the end that it should be joined to.
            if gap > reach.max(ROUNDING)
                || p.distance(a).min(p.distance(b)) <= reach
                || faces[boundary.face(e) as usize].contains(&v)
            {
                return;
            }
            let exactly = collinear(a, p, b) && midmost([a, p, b]) == 1;
            if !exactly && (gap > reach || reach == 0.0) {
                return;
            }
            let gap = if exactly { 0.0 } else { gap.max(f64::MIN_POSITIVE) };
            if nearest.is_none_or(|best| (gap, e) < best) {
                nearest = Some((gap, e));
            }
        });
        if let Some((gap, e)) = nearest {
            let line = scan.points(boundary.ends[e as usize]);
            let value = if gap == 0.0 { 0.0 } else { scan.in_model_unit_above_zero(gap) };
            let faces = of_vertex.iter().map(|&(_, e)| e).chain([e]).map(|e| boundary.face(e));
            let location = Location { at: scan.points([v])[0], line: &line };
            scan.put(DefectKind::TJunction, location, faces, Some(value));
        }
    }
    Ok(())
}

/// Distance of a point from a segment.
fn segment_distance(p: DVec3, a: DVec3, b: DVec3) -> f64 {
    let along = b - a;
    let length = along.length_squared();
    let share = if length > 0.0 { ((p - a).dot(along) / length).clamp(0.0, 1.0) } else { 0.0 };
    p.distance(a + along * share)
}
