//! Search for boundaries that coincide or almost coincide without being joined: slits, T-junctions and cracks.
//!
//! ```text
//!   slit                 T-junction            crack
//!   o----o----o          o---------o           o----o----o
//!   o----o----o          o----o----o
//!   ends coincide        an end lies on        o-------o----o
//!                        the other edge        a gap that can be seen
//! ```
//!
//! Vertices are merged at equal positions, so exactly coincident edges are already one edge. If the file's indices do
//! not join such an edge, it is a slit of width 0 for readers that join vertices by index. A gap up to the slit
//! tolerance is a slit and a wider gap is a crack, so no two boundary edges form both.

use glam::DVec3;

use super::super::DefectKind;
use super::super::measure::unshared_edges;
use super::chains::chains;
use super::scan::{Location, ROUNDING, Scan};
use crate::context::Cancelled;
use crate::math::{Tree, collinear, index_of_middle};
use crate::mesh::Edges;

/// Budgets: boundary edges examined per query, and by all queries together: per edge plus a fixed allowance.
const MAX_PER_QUERY: u64 = 1024;
const BUDGET_PER_EDGE: u64 = 32;
const BUDGET: u64 = 2_000_000;
/// Widest crack as a fraction of the edge's length. Boundaries farther apart are the two sides of a real opening.
const GAP_SHARE: f64 = 0.2;

/// A spatial index of boundary edges with a query budget.
struct BoundaryIndex {
    tree: Tree,
    /// Number of edges that queries may still examine.
    budget: u64,
    /// Whether a query ran out of its budget.
    gave_up: bool,
}

impl BoundaryIndex {
    fn new(positions: &[DVec3], boxes: &[[u32; 3]]) -> Self {
        let budget = BUDGET + BUDGET_PER_EDGE * boxes.len() as u64;
        Self { tree: Tree::new(positions, boxes), budget, gave_up: false }
    }

    /// Calls `visit` for the edges within `reach` of a point, within the budget.
    fn around(&mut self, point: DVec3, reach: f64, mut visit: impl FnMut(u32)) {
        let most = self.budget.min(MAX_PER_QUERY);
        let (mut examined, mut gave_up) = (0, false);
        self.tree.around(point, reach, |edge| {
            gave_up = examined == most;
            if !gave_up {
                examined += 1;
                visit(edge);
            }
            !gave_up
        });
        self.budget -= examined;
        self.gave_up |= gave_up;
    }
}

/// The boundary edges of the mesh.
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
    let mut index = BoundaryIndex::new(scan.unit, &boxes);
    drop(boxes);
    let budget = index.budget;
    find_cracks(scan, &boundary, &mut index, &slit)?;
    if std::mem::take(&mut index.gave_up) {
        scan.mark_incomplete(DefectKind::Crack);
    }
    index.budget = budget;
    find_t_junctions(scan, &boundary, &mut index)?;
    if index.gave_up {
        scan.mark_incomplete(DefectKind::TJunction);
    }
    Ok(())
}

/// For a format whose readers join vertices by index: reports edges joined by position only, as slits of width 0.
fn find_unshared(scan: &mut Scan<'_, '_>) -> Result<(), Cancelled> {
    let analysis = scan.analysis;
    let edges: Vec<usize> = unshared_edges(analysis).collect();
    scan.context().check()?;
    let ends: Vec<[u32; 2]> = edges.iter().map(|&edge| analysis.edges.vertices(edge)).collect();
    for (number, chain) in chains(&ends, &[]).into_iter().enumerate() {
        scan.step(number)?;
        let adjacent_faces =
            chain.edges.iter().flat_map(|&e| analysis.edges.half_edges(edges[e as usize]).iter().map(|h| h / 3));
        let faces: Vec<u32> = adjacent_faces.collect();
        let line = scan.points(chain.line);
        let Some(&at) = line.first() else { continue };
        scan.report(DefectKind::Slit, Location { at, line: &line }, faces, Some(0.0));
    }
    Ok(())
}

/// Pairs of adjacent boundary edges.
#[derive(Default)]
struct EdgePairs {
    /// First edge, second edge, and the gap between them on the unit scale.
    pairs: Vec<(u32, u32, f64)>,
}

impl EdgePairs {
    /// Reports one defect for each set of edges connected by shared vertices or by these pairs.
    fn report(self, kind: DefectKind, scan: &mut Scan<'_, '_>, boundary: &Boundary) -> Result<(), Cancelled> {
        let mut edges: Vec<u32> = self.pairs.iter().flat_map(|&(e, other, _)| [e, other]).collect();
        edges.sort_unstable();
        edges.dedup();
        let number_of = |e: u32| edges.partition_point(|&x| x < e);
        #[expect(clippy::cast_possible_truncation, reason = "edges are counted in u32")]
        let also: Vec<(u32, u32)> =
            self.pairs.iter().map(|&(e, other, _)| (number_of(e) as u32, number_of(other) as u32)).collect();
        let mut gaps = vec![0.0f64; edges.len()];
        for &(e, _, gap) in &self.pairs {
            let widest = &mut gaps[number_of(e)];
            *widest = widest.max(gap);
        }
        let ends: Vec<[u32; 2]> = edges.iter().map(|&e| boundary.ends[e as usize]).collect();
        for (number, chain) in chains(&ends, &also).into_iter().enumerate() {
            scan.step(number)?;
            let gap = chain.edges.iter().map(|&e| gaps[e as usize]).fold(0.0, f64::max);
            let line = scan.points(chain.line);
            let faces = chain.edges.iter().map(|&e| boundary.face(edges[e as usize]));
            let location = Location { at: line[0], line: &line };
            scan.report(kind, location, faces, Some(scan.in_model_unit_above_zero(gap)));
        }
        Ok(())
    }
}

/// Finds boundary edges whose two ends coincide with the ends of another. Returns for each edge whether it is in a
/// slit.
fn find_slits(scan: &mut Scan<'_, '_>, boundary: &Boundary) -> Result<Vec<bool>, Cancelled> {
    let unit = scan.unit;
    let slit = scan.lengths.slit;
    let ends = |e: u32| boundary.ends[e as usize].map(|v| unit[v as usize]);
    // Coincident edges have coincident midpoints.
    let midpoints: Vec<DVec3> = (0..boundary.len()).map(|e| (ends(e)[0] + ends(e)[1]) * 0.5).collect();
    let boxes: Vec<[u32; 3]> = (0..boundary.len()).map(|e| [e; 3]).collect();
    let mut index = BoundaryIndex::new(&midpoints, &boxes);
    drop(boxes);
    let mut slits = EdgePairs::default();
    let mut in_slit = vec![false; midpoints.len()];
    for e in 0..boundary.len() {
        scan.step(e as usize)?;
        let [a, b] = ends(e);
        // Every nearby edge coincides with a shorter edge.
        if a.distance(b) <= 2.0 * slit {
            continue;
        }
        let mut nearest = (f64::INFINITY, e);
        index.around(midpoints[e as usize], slit, |other| {
            let [c, d] = ends(other);
            let along = a.distance(c).max(b.distance(d));
            let against = a.distance(d).max(b.distance(c));
            let gap = along.min(against);
            if other != e && (gap, other) < nearest {
                nearest = (gap, other);
            }
        });
        if nearest.0 <= slit {
            in_slit[e as usize] = true;
            slits.pairs.push((e, nearest.1, nearest.0));
        }
    }
    if index.gave_up {
        scan.mark_incomplete(DefectKind::Slit);
    }
    slits.report(DefectKind::Slit, scan, boundary)?;
    Ok(in_slit)
}

/// Finds boundary edges with another boundary edge near the midpoint. Ignores edges in slits.
fn find_cracks(
    scan: &mut Scan<'_, '_>,
    boundary: &Boundary,
    index: &mut BoundaryIndex,
    in_slit: &[bool],
) -> Result<(), Cancelled> {
    let unit = scan.unit;
    let ends = |e: u32| boundary.ends[e as usize].map(|v| unit[v as usize]);
    let mut cracks = EdgePairs::default();
    for e in (0..boundary.len()).filter(|&e| !in_slit[e as usize]) {
        scan.step(e as usize)?;
        let [a, b] = ends(e);
        let widest = scan.lengths.crack.min(GAP_SHARE * a.distance(b));
        let midpoint = (a + b) * 0.5;
        let mut nearest = (f64::INFINITY, e);
        index.around(midpoint, widest, |other| {
            let [c, d] = ends(other);
            let gap = segment_distance(midpoint, c, d);
            if other != e && (gap, other) < nearest {
                nearest = (gap, other);
            }
        });
        // Without a gap, the ends of one edge lie on the other edge; these are T-junctions.
        if nearest.0 > scan.lengths.slit && nearest.0 <= widest {
            cracks.pairs.push((e, nearest.1, nearest.0));
        }
    }
    cracks.report(DefectKind::Crack, scan, boundary)
}

/// Finds vertices of boundary edges in the interior of another boundary edge. Reports each vertex once, with the
/// nearest edge.
fn find_t_junctions(scan: &mut Scan<'_, '_>, boundary: &Boundary, index: &mut BoundaryIndex) -> Result<(), Cancelled> {
    let (unit, faces) = (scan.unit, &scan.analysis.surface.faces);
    let reach = scan.lengths.t_junction;
    let mut uses: Vec<(u32, u32)> = (0u32..).zip(&boundary.ends).flat_map(|(e, &[a, b])| [(a, e), (b, e)]).collect();
    uses.sort_unstable();
    for (number, of_vertex) in uses.chunk_by(|x, y| x.0 == y.0).enumerate() {
        scan.step(number)?;
        let v = of_vertex[0].0;
        let p = unit[v as usize];
        let mut nearest: Option<(f64, u32)> = None;
        index.around(p, reach, |e| {
            let [a, b] = boundary.ends[e as usize].map(|v| unit[v as usize]);
            let gap = segment_distance(p, a, b);
            // A vertex near an end of the edge belongs to that end.
            if gap > reach.max(ROUNDING)
                || p.distance(a).min(p.distance(b)) <= reach
                || faces[boundary.face(e) as usize].contains(&v)
            {
                return;
            }
            let lies_exactly = collinear(a, p, b) && index_of_middle([a, p, b]) == 1;
            if !lies_exactly && (gap > reach || reach == 0.0) {
                return;
            }
            let gap = if lies_exactly { 0.0 } else { gap.max(f64::MIN_POSITIVE) };
            if nearest.is_none_or(|best| (gap, e) < best) {
                nearest = Some((gap, e));
            }
        });
        if let Some((gap, e)) = nearest {
            let line = scan.points(boundary.ends[e as usize]);
            let value = if gap == 0.0 { 0.0 } else { scan.in_model_unit_above_zero(gap) };
            let faces = of_vertex.iter().map(|&(_, e)| e).chain([e]).map(|e| boundary.face(e));
            let location = Location { at: scan.points([v])[0], line: &line };
            scan.report(DefectKind::TJunction, location, faces, Some(value));
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
