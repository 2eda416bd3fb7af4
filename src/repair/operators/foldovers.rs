//! Removes neighbouring faces that overlap: surface that folds back onto its neighbours.

use std::collections::VecDeque;
use std::sync::Arc;

use super::local_edits::{Hinge, LocalEdits, Shape};
use super::operator::{Applied, Counter, Operation, Scope};
use crate::inspect::Tolerances;
use crate::math::{Box3, SharpFold, nearest_on_triangle, threads, to_unit_range, unit_scale};
use crate::mesh::{Edges, Surface};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// The budget of star entries visited: a constant plus a number for each face of the surface.
const WORK: u64 = 50_000_000;
const WORK_PER_FACE: u64 = 200;

/// Flips the edges along which the surface folds back onto itself.
#[derive(Debug, Clone, Copy)]
pub struct UnfoldFoldovers {
    /// The largest angle between the two faces of an edge that counts as a fold, in radians; 0.01 in the inspection.
    pub angle: f64,
    /// The largest distance between the overlapping faces, as a share of the bounding box's diagonal.
    pub height: f64,
    /// The largest distance that the surface may move, in the model's unit.
    pub max_deviation: f64,
}

impl UnfoldFoldovers {
    /// Removes foldovers: regions between folds that lie upside down on their neighbours.
    ///
    /// ```text
    ///      d               d        seen from above: face (a, b, m) lies upside down on face (a, b, d), because m was
    ///     / \             /|\       dragged across the edge. After flipping the edge to connect m and d, both faces
    ///    / m \     ->    / m \      face up, and the surface below the edge continues from a, m, b.
    ///   a-----b         a     b
    /// ```
    ///
    /// An edge is flipped where three conditions hold: fewer folds remain among the five edges involved; both faces get the
    /// orientation of the larger face; and neither becomes degenerate. So each flip lowers the number of folds, and a flat solid, whose rim
    /// consists of proper folds, keeps its rim.
    ///
    /// Precondition: neighbours have consistent winding. Result: no vertex moves and no boundary appears; the surface stays
    /// within the height. Leaves: folds whose flipped edge exists already or would run outside the two faces, as where a vertex
    /// was dragged across another vertex; `self_union` removes those.
    ///
    /// After the foldovers of Parasolid (`PK_MESH_defect_foldover_c`).
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then half changed.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.run(surface, context)
    }
}

/// The limits within which an edge counts as a fold, on the unit scale.
struct FoldLimits {
    angle: f64,
    height: f64,
}

impl FoldLimits {
    /// The distance of the lower of the two faces at edge `a`, `b` from the other face, where the edge is a fold.
    fn fold(&self, [a, b, m, d]: [glam::DVec3; 4]) -> Option<f64> {
        let fold = SharpFold::of([a, b], [m, d])?;
        let clearance = fold.height(fold.angle);
        let low = [[a, b, m], [a, b, d]].into_iter().any(|face| Shape::of(face).height < self.height);
        (fold.angle <= self.angle && clearance <= self.height && !low).then_some(clearance)
    }

    /// The edge from `a` to `b` and the distance of its faces, where the edge is a fold.
    fn fold_at_edge(&self, local: &mut LocalEdits<'_>, a: u32, b: u32) -> Option<(Hinge, f64)> {
        let hinge = local.hinge(a, b)?;
        let [m, d] = hinge.apexes;
        let clearance = self.fold([a, b, m, d].map(|v| local.unit[v as usize]))?;
        Some((hinge, clearance))
    }

    /// Flips the edge if that leaves fewer folds.
    fn flip(&self, local: &mut LocalEdits<'_>, hinge: Hinge) -> bool {
        let ([m, d], new) = (hinge.apexes, hinge.flipped());
        if !local.faces_at_edge(m, d).is_empty() {
            return false;
        }
        let old = hinge.faces.map(|f| local.face(f));
        let areas = old.map(|face| local.area_vector(face));
        let normal = if areas[0].length_squared() > areas[1].length_squared() { areas[0] } else { areas[1] };
        let fits = |face: &[u32; 3]| {
            local.area_vector(*face).dot(normal) > 0.0 && Shape::of(local.points(*face)).height >= self.height
        };
        if !new.iter().all(fits) {
            return false;
        }
        let before = 1 + self.count(local, surrounding_edges(hinge));
        for (face, corners) in hinge.faces.into_iter().zip(new) {
            local.set_face(face, corners);
        }
        let crossing = [[m, d]];
        if self.count(local, surrounding_edges(hinge).into_iter().chain(crossing)) < before {
            return true;
        }
        for (face, corners) in hinge.faces.into_iter().zip(old) {
            local.set_face(face, corners);
        }
        false
    }

    /// The number of folds among `edges`.
    fn count(&self, local: &mut LocalEdits<'_>, edges: impl IntoIterator<Item = [u32; 2]>) -> usize {
        edges.into_iter().filter(|&[v, w]| self.fold_at_edge(local, v, w).is_some()).count()
    }
}

/// The four outer edges of the two faces.
fn surrounding_edges(hinge: Hinge) -> [[u32; 2]; 4] {
    let ([a, b], [m, d]) = (hinge.ends, hinge.apexes);
    [[a, m], [m, b], [b, d], [d, a]]
}

impl Operation<'_> for UnfoldFoldovers {
    const FIXES: &'static [Counter] = &[Counter::NonManifoldEdges, Counter::BoundaryEdges];
    const MAY_RAISE: &'static [Counter] = &[];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        let angle = Tolerances::default().foldover_angle;
        Self { angle, height: scope.options.degenerate_tolerance, max_deviation: scope.max_deviation }
    }

    fn run_shared(
        &self,
        surface: &mut Arc<Surface>,
        edges: Arc<Edges>,
        context: &Context<'_>,
    ) -> Result<Applied, Cancelled> {
        let unit = to_unit_range(&surface.positions);
        let scale = unit_scale(&surface.positions);
        let height = (self.height * Box3::of(unit.iter().copied()).diagonal()).min(self.max_deviation * scale);
        if !(height > 0.0 && height.is_finite()) {
            return Ok(Applied::default());
        }
        let limits = FoldLimits { angle: self.angle, height };
        let fold_at = |e: usize| {
            let &[x, y] = edges.half_edges(e) else { return None };
            let ([a, b], apex) = (edges.vertices(e), [x, y].map(|h| Edges::opposite(&surface.faces, h)));
            let at = [a, b, apex[0], apex[1]].map(|v| unit[v as usize]);
            (apex[0] != apex[1] && limits.fold(at).is_some()).then_some([a, b])
        };
        context.check()?;
        let mut queue = VecDeque::from(threads::filter_map(edges.len(), fold_at));
        if queue.is_empty() {
            return Ok(Applied::default());
        }
        let surface = Arc::make_mut(surface);
        let budget = WORK + WORK_PER_FACE * surface.faces.len() as u64;
        let mut local = LocalEdits::new(surface);
        let (mut flipped, mut moved, mut steps) = (0u64, 0.0f64, 0u32);
        while let Some([a, b]) = queue.pop_front() {
            steps = steps.wrapping_add(1);
            if steps.is_multiple_of(1024) {
                context.check()?;
            }
            if local.spent > budget {
                break;
            }
            let Some((hinge, clearance)) = limits.fold_at_edge(&mut local, a, b) else { continue };
            if limits.flip(&mut local, hinge) {
                flipped += 1;
                moved = moved.max(clearance);
                queue.extend(surrounding_edges(hinge));
            }
        }
        let left = (local.spent > budget).then(|| "some folds were skipped: too many of them are connected".to_owned());
        local.finish();
        let changes = Change::list([(ChangeKind::FoldsFlipped, flipped)]);
        Ok(Applied { changes, moved: moved / scale, left, ..Applied::default() })
    }
}

/// The most faces at one edge that are compared pairwise.
const MAX_FACES_AT_EDGE: usize = 64;

/// Removes the smaller of two neighbouring faces that overlap.
#[derive(Debug, Clone, Copy)]
pub struct RemoveOverlappingNeighbours {
    /// The largest angle between two faces at their common edge that counts as an overlap, in degrees.
    pub angle_deg: f64,
    /// The largest distance of the smaller face's corners from the larger face, as a share of the bounding box's diagonal;
    /// infinite to use the angle alone.
    pub reach: f64,
}

impl Default for RemoveOverlappingNeighbours {
    fn default() -> Self {
        Self { angle_deg: 1.0, reach: 1e-4 }
    }
}

impl RemoveOverlappingNeighbours {
    /// Removes the smaller of two overlapping faces with a common edge, then the faces that are left without neighbours.
    ///
    /// ```text
    ///    solid  ____                      ____
    ///          |    |___.  a fin, folded |    |
    ///          |    |---'  back on       |    |
    ///          |____|      itself        |____|
    /// ```
    ///
    /// Mesh Heal's *Delete Overlapping Neighbor Faces* removes the face with fewer vertices. Triangles all have three, so the
    /// smaller area goes here, and of equal areas the later face. The distance limit keeps the sharp edge of a wedge, whose
    /// faces diverge.
    ///
    /// Precondition: none. Result: no vertex moves; holes appear where the faces were. Leaves: those holes, for
    /// `fill_holes`. The operator runs on request only: it opens closed surface, and filling the hole of a single face
    /// restores that face.
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
            let mut directions: Vec<(glam::DVec3, u32)> = Vec::new();
            // At an edge with very many faces only the first faces are compared.
            for &h in half_edges.iter().take(MAX_FACES_AT_EDGE).filter(|_| half_edges.len() > 1) {
                let to = unit[Edges::opposite(faces, h) as usize] - a;
                if let Some(direction) = (to - along * to.dot(along)).try_normalize() {
                    directions.push((direction, h / 3));
                }
            }
            for (i, &(p, f)) in directions.iter().enumerate() {
                for &(q, g) in &directions[i + 1..] {
                    if p.dot(q) < least || !keep[f as usize] || !keep[g as usize] {
                        continue;
                    }
                    let (small, large) = if area(g) <= area(f) { (g, f) } else { (f, g) };
                    let is_near = |p: glam::DVec3| p.distance(nearest_on_triangle(p, corners(large))) <= reach;
                    let is_near = corners(small).into_iter().all(is_near);
                    too_far += u64::from(!is_near);
                    keep[small as usize] = !is_near;
                }
            }
        }
        let overlapping = keep.iter().filter(|&&k| !k).count() as u64;
        let left = (too_far > 0).then(|| {
            format!(
                "{too_far} neighbouring faces were kept: they are within the angle but farther apart than {} of the diagonal",
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

/// Removes faces that lost all their neighbours. Returns their number.
fn drop_dangling(edges: &Edges, keep: &mut [bool]) -> u64 {
    let (mut has_neighbour, mut lost_neighbour) = (vec![false; keep.len()], vec![false; keep.len()]);
    for half_edges in edges.iter().filter(|h| h.len() > 1) {
        let kept = half_edges.iter().filter(|h| keep[**h as usize / 3]).count();
        for &h in half_edges {
            has_neighbour[h as usize / 3] |= kept > 1;
            lost_neighbour[h as usize / 3] |= kept < half_edges.len();
        }
    }
    let mut removed = 0;
    for f in 0..keep.len() {
        if keep[f] && lost_neighbour[f] && !has_neighbour[f] {
            keep[f] = false;
            removed += 1;
        }
    }
    removed
}

impl Operation<'_> for RemoveOverlappingNeighbours {
    const FIXES: &'static [Counter] = &[Counter::NonManifoldEdges];
    const MAY_RAISE: &'static [Counter] = &[Counter::BoundaryEdges, Counter::PinchedVertices];
    const IS_ON_REQUEST: bool = true;

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        let (default, requested) = (Self::default(), scope.options.overlap_angle_deg);
        // A requested angle is the only limit.
        let reach = if requested.is_some() { f64::INFINITY } else { default.reach };
        Self { angle_deg: requested.unwrap_or(default.angle_deg), reach }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}
