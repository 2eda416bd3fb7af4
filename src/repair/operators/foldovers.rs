//! Neighbouring faces that lie on one another: surface that is folded back on its neighbours.

use std::collections::VecDeque;

use super::local_edits::{Hinge, LocalEdits, Shape};
use super::operator::{Applied, Counter, Operation, Scope};
use crate::inspect::Tolerances;
use crate::math::{Box3, nearest_on_triangle, to_unit_range, unit_scale};
use crate::mesh::{Edges, Surface};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// Looks at faces around vertices, beside so many for each face of the surface.
const WORK: u64 = 50_000_000;
const WORK_PER_FACE: u64 = 200;

/// Flips the edges at which surface is folded onto itself.
#[derive(Debug, Clone, Copy)]
pub struct UnfoldFoldovers {
    /// Largest angle between the two faces of an edge, in radians, at which the edge is a fold; as the inspection has it, 0.01.
    pub angle: f64,
    /// How far faces may stand off from those that they are folded on, as a share of the diagonal of the bounding box.
    pub height: f64,
    /// The same in the model's unit: the surface moves no farther.
    pub max_deviation: f64,
}

impl UnfoldFoldovers {
    /// Removes foldovers: regions between folds that lie on their neighbours with the other side up.
    ///
    /// ```text
    ///      d               d        seen from above: the face of a, b and m lies on that of a, b and d with its back up, for
    ///     / \             /|\       m was dragged across the edge. With the edge flipped to join m and d, both
    ///    / m \     ->    / m \      faces have their front up, and what was below the edge goes on from a, m, b.
    ///   a-----b         a     b
    /// ```
    ///
    /// An edge is flipped where that leaves fewer folds among the five edges around, makes both faces look as the larger one
    /// did, and makes none that is flat. So folds get fewer with each flip, and a flat solid, whose rim is a fold by right, keeps it.
    ///
    /// Precondition: neighbours wind the same way. Result: no vertex moves, nothing opens; the surface stays within the
    /// height. Leaves: folds whose flipped edge is there already or would leave the faces, as where a vertex was dragged across another, for who resolves intersections.
    ///
    /// After foldovers as Parasolid defines them (`PK_MESH_defect_foldover_c`, seed 002).
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then half done.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let unit = to_unit_range(&surface.positions);
        let scale = unit_scale(&surface.positions);
        let height = (self.height * Box3::of(unit.iter().copied()).diagonal()).min(self.max_deviation * scale);
        if !(height > 0.0 && height.is_finite()) {
            return Ok(Applied::default());
        }
        let limits = Limits { angle: self.angle, height };
        let mut queue = VecDeque::new();
        let edges = Edges::new(&surface.faces);
        for (e, half_edges) in edges.iter().enumerate() {
            if e.is_multiple_of(4096) {
                context.check()?;
            }
            let &[x, y] = half_edges else { continue };
            let ([a, b], apex) = (edges.vertices(e), [x, y].map(|h| Edges::opposite(&surface.faces, h)));
            let at = [a, b, apex[0], apex[1]].map(|v| unit[v as usize]);
            if apex[0] != apex[1] && limits.fold(at).is_some() {
                queue.push_back([a, b]);
            }
        }
        if queue.is_empty() {
            return Ok(Applied::default());
        }
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
            let Some((hinge, stands_off)) = limits.fold_at(&mut local, a, b) else { continue };
            if limits.flip(&mut local, hinge) {
                flipped += 1;
                moved = moved.max(stands_off);
                queue.extend(around(hinge));
            }
        }
        let left =
            (local.spent > budget).then(|| "so many folds hang together that they were not all tried".to_owned());
        local.finish();
        let changes = Change::list([(ChangeKind::FoldsFlipped, flipped)]);
        Ok(Applied { changes, moved: moved / scale, left, ..Applied::default() })
    }
}

/// What makes an edge a fold, on the unit scale.
struct Limits {
    angle: f64,
    height: f64,
}

impl Limits {
    /// How far the lower of two faces that meet at `a`, `b` stands off from the other, where the edge is a fold.
    fn fold(&self, [a, b, m, d]: [glam::DVec3; 4]) -> Option<f64> {
        let along = (b - a).normalize_or_zero();
        let [p, q] = [m - a, d - a].map(|to| to - along * to.dot(along));
        if p.dot(q) <= 0.0 {
            return None;
        }
        let angle = p.cross(q).length().atan2(p.dot(q));
        let stands_off = p.length().min(q.length()) * angle.sin();
        let low = [[a, b, m], [a, b, d]].into_iter().any(|face| Shape::of(face).height < self.height);
        (angle <= self.angle && stands_off <= self.height && !low).then_some(stands_off)
    }

    fn fold_at(&self, local: &mut LocalEdits<'_>, a: u32, b: u32) -> Option<(Hinge, f64)> {
        let hinge = local.hinge(a, b)?;
        let [m, d] = hinge.apexes;
        let stands_off = self.fold([a, b, m, d].map(|v| local.unit[v as usize]))?;
        Some((hinge, stands_off))
    }

    /// Flips the edge, if that leaves fewer folds.
    fn flip(&self, local: &mut LocalEdits<'_>, hinge: Hinge) -> bool {
        let ([m, d], new) = (hinge.apexes, hinge.flipped());
        if !local.around_edge(m, d).is_empty() {
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
        let before = 1 + self.count(local, around(hinge));
        for (face, corners) in hinge.faces.into_iter().zip(new) {
            local.set_face(face, corners);
        }
        let crossing = [[m, d]];
        if self.count(local, around(hinge).into_iter().chain(crossing)) < before {
            return true;
        }
        for (face, corners) in hinge.faces.into_iter().zip(old) {
            local.set_face(face, corners);
        }
        false
    }

    fn count(&self, local: &mut LocalEdits<'_>, edges: impl IntoIterator<Item = [u32; 2]>) -> usize {
        edges.into_iter().filter(|&[v, w]| self.fold_at(local, v, w).is_some()).count()
    }
}

/// The four edges around the two faces.
fn around(hinge: Hinge) -> [[u32; 2]; 4] {
    let ([a, b], [m, d]) = (hinge.ends, hinge.apexes);
    [[a, m], [m, b], [b, d], [d, a]]
}

impl Operation for UnfoldFoldovers {
    const FIXES: &'static [Counter] = &[Counter::NonManifoldEdges, Counter::BoundaryEdges];
    const MAY_RAISE: &'static [Counter] = &[];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        let angle = Tolerances::default().foldover_angle;
        Self { angle, height: scope.options.degenerate_tolerance, max_deviation: scope.max_deviation }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}

/// Faces around one edge that are compared.
const MOST_AROUND: usize = 64;

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
    const FIXES: &'static [Counter] = &[Counter::NonManifoldEdges];
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
