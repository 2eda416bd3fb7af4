//! Neighbouring faces that lie on one another.

use super::{Applied, Counter, Operation, Scope};
use crate::math::{Box3, nearest_on_triangle, to_unit_range};
use crate::mesh::{Edges, Surface};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// Faces that lie on a neighbour.
#[derive(Debug, Clone, Copy)]
pub struct RemoveOverlappingNeighbours {
    /// Largest angle between two faces at the edge that they share, in degrees, at which they lie on one another.
    pub angle_deg: f64,
    /// How far the smaller one may reach from the larger, as a share of the diagonal of the bounding box; infinite where the angle
    /// alone tells.
    pub reach: f64,
}

impl Default for RemoveOverlappingNeighbours {
    fn default() -> Self {
        Self { angle_deg: 1.0, reach: 1e-4 }
    }
}

impl RemoveOverlappingNeighbours {
    /// Removes the smaller of two faces that share an edge and lie on one another, and then faces that are left without any
    /// neighbour.
    ///
    /// ```text
    ///    solid  ____                      ____
    ///          |    |___.  a fin, folded |    |
    ///          |    |---'  back on       |    |
    ///          |____|      itself        |____|
    /// ```
    ///
    /// Mesh Heal's *Delete Overlapping Neighbor Faces* takes the face with fewer vertices first; triangles all have three, so
    /// the smaller area goes, of equal ones the later. That the smaller one is within reach of the larger keeps the
    /// sharp edge of a wedge, whose faces lie apart beyond it.
    ///
    /// Precondition: none. Result: no vertex moves; holes where the faces were. Leaves: those holes, for who fills holes.
    /// On request only: it opens what was closed, and a face alone that goes is made again by filling its hole.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let unit = to_unit_range(&surface.positions);
        let diagonal = Box3::of(unit.iter().copied()).diagonal();
        let reach = if self.reach.is_finite() { self.reach * diagonal } else { f64::INFINITY };
        let least = self.angle_deg.to_radians().cos();
        let faces = &surface.faces;
        let corners = |f: u32| faces[f as usize].map(|v| unit[v as usize]);
        let area = |f: u32| {
            let [a, b, c] = corners(f);
            (b - a).cross(c - a).length()
        };
        let edges = Edges::new(faces);
        let mut keep = vec![true; faces.len()];
        let mut too_far = 0u64;
        for (e, half_edges) in edges.iter().enumerate() {
            if e.is_multiple_of(4096) {
                context.check()?;
            }
            let [a, b] = edges.vertices(e).map(|v| unit[v as usize]);
            let along = (b - a).normalize_or_zero();
            let mut away: Vec<(glam::DVec3, u32)> = Vec::new();
            // Around an edge of very many faces only the first ones are compared with one another.
            for &h in half_edges.iter().take(MOST_AROUND).filter(|_| half_edges.len() > 1) {
                let to = unit[Edges::opposite(faces, h) as usize] - a;
                if let Some(direction) = (to - along * to.dot(along)).try_normalize() {
                    away.push((direction, h / 3));
                }
            }
            for (i, &(p, f)) in away.iter().enumerate() {
                for &(q, g) in &away[i + 1..] {
                    if p.dot(q) < least || !keep[f as usize] || !keep[g as usize] {
                        continue;
                    }
                    let (small, large) = if area(g) <= area(f) { (g, f) } else { (f, g) };
                    let lies = |p: glam::DVec3| p.distance(nearest_on_triangle(p, corners(large))) <= reach;
                    let lies = corners(small).into_iter().all(lies);
                    too_far += u64::from(!lies);
                    keep[small as usize] = !lies;
                }
            }
        }
        let overlapping = keep.iter().filter(|&&k| !k).count() as u64;
        let left = (too_far > 0).then(|| {
            format!(
                "{too_far} neighbouring faces lie within the angle but farther apart than {} of the diagonal, so they were kept",
                self.reach
            )
        });
        if overlapping == 0 || overlapping == faces.len() as u64 {
            return Ok(Applied { left, ..Applied::default() });
        }
        let dangling = drop_dangling(&edges, &mut keep);
        surface.retain_faces(&keep);
        surface.drop_unreferenced();
        let changes = Change::list([
            (ChangeKind::OverlappingFacesRemoved, overlapping),
            (ChangeKind::DanglingFacesRemoved, dangling),
        ]);
        Ok(Applied { changes, left, ..Applied::default() })
    }
}

/// Faces around one edge that are compared.
const MOST_AROUND: usize = 64;

/// Takes away faces that lost all their neighbours. Answers how many.
fn drop_dangling(edges: &Edges, keep: &mut [bool]) -> u64 {
    let (mut beside, mut lost) = (vec![false; keep.len()], vec![false; keep.len()]);
    for half_edges in edges.iter().filter(|h| h.len() > 1) {
        let kept = half_edges.iter().filter(|h| keep[**h as usize / 3]).count();
        for &h in half_edges {
            beside[h as usize / 3] |= kept > 1;
            lost[h as usize / 3] |= kept < half_edges.len();
        }
    }
    let mut gone = 0;
    for f in 0..keep.len() {
        if keep[f] && lost[f] && !beside[f] {
            keep[f] = false;
            gone += 1;
        }
    }
    gone
}

impl Operation for RemoveOverlappingNeighbours {
    const FIXES: &'static [Counter] = &[Counter::NonmanifoldEdges];
    const MAY_RAISE: &'static [Counter] = &[Counter::BoundaryEdges, Counter::PinchedVertices];
    const IS_ON_REQUEST: bool = true;

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        let (usual, asked) = (Self::default(), scope.options.overlap_angle_deg);
        // An angle that was asked for is the only limit.
        let reach = if asked.is_some() { f64::INFINITY } else { usual.reach };
        Self { angle_deg: asked.unwrap_or(usual.angle_deg), reach }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}
