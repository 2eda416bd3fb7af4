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
//! What coincides exactly in all vertices is one edge already, since vertices are merged at equal positions. A gap up to
//! the slit tolerance makes a slit, a wider one a crack; so no two boundary edges are both.

use glam::DVec3;

use super::super::DefectKind;
use super::chains::chains;
use super::scan::Scan;
use crate::context::Cancelled;
use crate::math::{Tree, collinear, midmost};
use crate::mesh::Edges;

/// Boundary edges that one query may look at, and all queries together for each edge and at least.
const MOST_A_QUERY: u32 = 1024;
const MOST_A_EDGE: u64 = 64;
const MOST_AT_LEAST: u64 = 2_000_000;
/// The widest gap beside an edge, as a share of its length: what is farther apart are two sides of something.
const GAP_SHARE: f64 = 0.2;
/// What rounding alone can make of a distance of 0 on the unit scale, with room to spare.
const ROUNDING: f64 = 1e-13;

/// The boundary edges with a tree over them.
struct Boundary {
    half_edges: Vec<u32>,
    ends: Vec<[u32; 2]>,
    tree: Tree,
    /// Looks that are left.
    budget: u64,
    /// Whether a search was given up.
    spent: bool,
}

impl Boundary {
    /// Calls `visit` with the boundary edges near a point, as far as the budget goes.
    fn around(&mut self, point: DVec3, reach: f64, mut visit: impl FnMut(u32, [u32; 2])) {
        let (mut left, ends) = (self.budget.min(u64::from(MOST_A_QUERY)), &self.ends);
        let before = left;
        let mut spent = left == 0;
        if !spent {
            self.tree.around(point, reach, |e| {
                if left == 0 {
                    spent = true;
                    return false;
                }
                left -= 1;
                visit(e, ends[e as usize]);
                true
            });
        }
        self.budget -= before - left;
        self.spent |= spent;
    }
}

/// Finds slits, cracks and T-junctions. O(n log n) in the number of boundary edges, within the budget.
pub(super) fn find(scan: &mut Scan<'_, '_>) -> Result<(), Cancelled> {
    let analysis = scan.analysis;
    let faces = &analysis.surface.faces;
    let mut half_edges: Vec<u32> = analysis.edges.iter().filter(|h| h.len() == 1).map(|h| h[0]).collect();
    if half_edges.len() < 2 {
        return Ok(());
    }
    half_edges.sort_unstable();
    let ends: Vec<[u32; 2]> = half_edges.iter().map(|&h| Edges::ends(faces, h)).collect();
    let as_faces: Vec<[u32; 3]> = ends.iter().map(|&[a, b]| [a, b, b]).collect();
    let tree = Tree::new(scan.unit, &as_faces);
    let budget = MOST_AT_LEAST + MOST_A_EDGE * half_edges.len() as u64;
    let mut boundary = Boundary { half_edges, ends, tree, budget, spent: false };
    find_pairs(scan, &mut boundary)?;
    if std::mem::take(&mut boundary.spent) {
        scan.incomplete(DefectKind::Slit);
        scan.incomplete(DefectKind::Crack);
    }
    boundary.budget = budget;
    find_t_junctions(scan, &mut boundary)?;
    if boundary.spent {
        scan.incomplete(DefectKind::TJunction);
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
    /// Tells one defect for each set of edges that hang together or lie along one another.
    fn tell(self, kind: DefectKind, scan: &mut Scan<'_, '_>, boundary: &Boundary) -> Result<(), Cancelled> {
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
            let faces = chain.edges.iter().map(|&e| boundary.half_edges[edges[e as usize] as usize] / 3);
            scan.put(kind, line[0], faces, &line, Some(scan.told_above_zero(gap)));
        }
        Ok(())
    }
}

fn find_pairs(scan: &mut Scan<'_, '_>, boundary: &mut Boundary) -> Result<(), Cancelled> {
    let unit = scan.unit;
    let at = |v: u32| unit[v as usize];
    let (slit, crack) = (scan.lengths.slit, scan.lengths.crack);
    let (mut slits, mut cracks) = (Beside::default(), Beside::default());
    for e in 0..boundary.ends.len() {
        scan.step(e)?;
        let [a, b] = boundary.ends[e];
        let length = at(a).distance(at(b));
        // All that is near a shorter edge coincides with it.
        if length <= 2.0 * slit {
            continue;
        }
        #[expect(clippy::cast_possible_truncation, reason = "edges are counted in u32")]
        let this = e as u32;
        let middle = (at(a) + at(b)) * 0.5;
        let widest = crack.min(GAP_SHARE * length);
        let mut same: Option<(f64, u32)> = None;
        let mut nearest = (f64::INFINITY, this);
        boundary.around(middle, widest.max(slit), |other, [c, d]| {
            if other == this {
                return;
            }
            let along = at(a).distance(at(c)).max(at(b).distance(at(d)));
            let against = at(a).distance(at(d)).max(at(b).distance(at(c)));
            let apart = along.min(against);
            if apart <= slit {
                same =
                    Some(same.map_or((apart, other), |best| if (apart, other) < best { (apart, other) } else { best }));
            }
            let gap = segment_distance(middle, at(c), at(d));
            if (gap, other) < nearest {
                nearest = (gap, other);
            }
        });
        if let Some((gap, other)) = same {
            slits.pairs.push((this, other, gap));
        } else if nearest.0 > slit && nearest.0 <= widest {
            cracks.pairs.push((this, nearest.1, nearest.0));
        }
    }
    slits.tell(DefectKind::Slit, scan, boundary)?;
    cracks.tell(DefectKind::Crack, scan, boundary)
}

/// Finds ends of boundary edges that lie on another boundary edge between its ends, each once, with the nearest.
fn find_t_junctions(scan: &mut Scan<'_, '_>, boundary: &mut Boundary) -> Result<(), Cancelled> {
    let (unit, faces) = (scan.unit, &scan.analysis.surface.faces);
    let at = |v: u32| unit[v as usize];
    let reach = scan.lengths.t_junction;
    let mut uses: Vec<(u32, u32)> = (0u32..).zip(&boundary.ends).flat_map(|(e, &[a, b])| [(a, e), (b, e)]).collect();
    uses.sort_unstable();
    for (number, of_vertex) in uses.chunk_by(|x, y| x.0 == y.0).enumerate() {
        scan.step(number)?;
        let v = of_vertex[0].0;
        let p = at(v);
        let mut nearest: Option<(f64, u32)> = None;
        let half_edges = std::mem::take(&mut boundary.half_edges);
        boundary.around(p, reach, |e, [a, b]| {
            let (a, b) = (at(a), at(b));
            let gap = segment_distance(p, a, b);
            // Near an end it is the end that it should be joined to.
            if gap > reach.max(ROUNDING) || p.distance(a).min(p.distance(b)) <= reach {
                return;
            }
            if faces[half_edges[e as usize] as usize / 3].contains(&v) {
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
        boundary.half_edges = half_edges;
        if let Some((gap, e)) = nearest {
            let line = scan.points(boundary.ends[e as usize]);
            let value = if gap == 0.0 { 0.0 } else { scan.told_above_zero(gap) };
            let of = |e: u32| boundary.half_edges[e as usize] / 3;
            let faces = of_vertex.iter().map(|&(_, e)| of(e)).chain([of(e)]);
            let place = scan.points([v])[0];
            scan.put(DefectKind::TJunction, place, faces, &line, Some(value));
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
