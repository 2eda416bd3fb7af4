//! Surface that is folded back on its neighbours.

use std::collections::VecDeque;

use super::local::{Hinge, Local, Shape};
use super::{Applied, Counter, Operation, Scope};
use crate::inspect::Tolerances;
use crate::math::{Box3, to_unit_range, unit_scale};
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
        let mut local = Local::new(surface);
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

    fn fold_at(&self, local: &mut Local<'_>, a: u32, b: u32) -> Option<(Hinge, f64)> {
        let hinge = local.hinge(a, b)?;
        let [m, d] = hinge.apexes;
        let stands_off = self.fold([a, b, m, d].map(|v| local.unit[v as usize]))?;
        Some((hinge, stands_off))
    }

    /// Flips the edge, if that leaves fewer folds.
    fn flip(&self, local: &mut Local<'_>, hinge: Hinge) -> bool {
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

    fn count(&self, local: &mut Local<'_>, edges: impl IntoIterator<Item = [u32; 2]>) -> usize {
        edges.into_iter().filter(|&[v, w]| self.fold_at(local, v, w).is_some()).count()
    }
}

/// The four edges around the two faces.
fn around(hinge: Hinge) -> [[u32; 2]; 4] {
    let ([a, b], [m, d]) = (hinge.ends, hinge.apexes);
    [[a, m], [m, b], [b, d], [d, a]]
}

impl Operation for UnfoldFoldovers {
    const FIXES: &'static [Counter] = &[Counter::NonmanifoldEdges, Counter::BoundaryEdges];
    const MAY_RAISE: &'static [Counter] = &[];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        let angle = Tolerances::default().foldover_angle;
        Self { angle, height: scope.options.degenerate_tolerance, max_deviation: scope.max_deviation }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}
