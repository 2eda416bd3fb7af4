//! Removes slivers: faces with a short edge, or whose corners are almost collinear.

use std::collections::VecDeque;

use glam::DVec3;

use super::local_edits::{LocalEdits, Shape};
use super::operator::{Applied, Counter, Operation, Scope};
use crate::math::{Box3, unit_scale};
use crate::mesh::Surface;
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// The most tries for one face. Each try follows an edit next to the face; more tries mean that the edits go in circles.
const MAX_TRIES: u8 = 32;
/// The budget of star entries visited: a constant plus a number for each face of the surface.
const WORK: u64 = 50_000_000;
const WORK_PER_FACE: u64 = 200;

/// Collapses short edges and flips caps.
#[derive(Debug, Clone, Copy)]
pub struct RemoveSlivers {
    /// The least edge length and face height, as a share of the bounding box's diagonal; 0 removes nothing.
    pub tolerance: f64,
    /// No vertex moves farther than this, in the model's unit.
    pub max_deviation: f64,
}

impl RemoveSlivers {
    /// Removes faces with an edge or a height below the tolerance, and keeps the surface closed.
    ///
    /// ```text
    ///    short edge            c                 cap               m                    m
    ///   c                     /|\                              a-------b            a-------b
    ///   |\ \ a        ->     / | \                              \     /      ->      \  |  /
    ///   | \ /b              --b---                               \   /                \ | /
    ///                                                              d                    d
    /// ```
    ///
    /// A short edge collapses to one of its ends, so that no new position arises. A face with only long edges is a cap. Its
    /// longest edge is flipped, which moves the surface by at most the cap's height. Where there is no face beyond that edge,
    /// the cap is removed; also where there are several and the cap's other edges are free. A queue holds the faces next to
    /// each edit.
    ///
    /// Precondition: no face with a repeated vertex. Result: each vertex is within the tolerance of its old position; no
    /// boundary appears; no face flips except other slivers; the number of non-manifold edges and pinched vertices does not
    /// rise. Leaves: edges that violate the link condition (Dey, Edelsbrunner, Guha and Nekhayev 1999), as on a handle or solid
    /// no thicker than the tolerance; other non-manifold edges; caps whose flipped edge exists already or would not raise the
    /// smaller of the two heights.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then half changed.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply_beside(&[], surface, context)
    }

    /// [`Self::apply`] beside faces that stay as they are, marked in `kept`; faces after its end are not marked.
    ///
    /// # Errors
    /// As for [`Self::apply`].
    pub fn apply_beside(
        &self,
        kept: &[bool],
        surface: &mut Surface,
        context: &Context<'_>,
    ) -> Result<Applied, Cancelled> {
        let scale = unit_scale(&surface.positions);
        let diagonal = Box3::of(surface.positions.iter().map(|&p| p * scale)).diagonal();
        let length = (self.tolerance * diagonal).min(self.max_deviation * scale);
        if !(length > 0.0 && length.is_finite()) {
            return Ok(Applied::default());
        }
        let mut slivers = VecDeque::new();
        let mut is_fixed = vec![false; surface.positions.len()];
        for (face, f) in surface.faces.iter().zip(0u32..) {
            if is_marked(kept, f) {
                face.iter().for_each(|&v| is_fixed[v as usize] = true);
            } else if is_sliver(face.map(|v| surface.positions[v as usize] * scale), length) {
                slivers.push_back(f);
            }
        }
        if slivers.is_empty() {
            return Ok(Applied::default());
        }
        let budget = WORK + WORK_PER_FACE * surface.faces.len() as u64;
        let drift = vec![0.0; surface.positions.len()];
        let local = LocalEdits::new(surface);
        let mut work = SliverQueue { local, length, kept, is_fixed, drift, moved: 0.0, queue: slivers };
        let EditCounts { collapsed, flipped, dropped, left } = work.run(budget, context)?;
        let moved = work.moved / scale;
        work.local.finish();
        let changes = Change::list([
            (ChangeKind::ShortEdgesCollapsed, collapsed),
            (ChangeKind::CapsFlipped, flipped),
            (ChangeKind::CapsRemoved, dropped),
            (ChangeKind::SliversLeft, left.len() as u64),
        ]);
        let left = (!left.is_empty()).then(|| {
            format!(
                "{} faces thinner than {:.3e} were kept: no edit removes them without damage to the surface",
                left.len(),
                length / scale
            )
        });
        Ok(Applied { changes, moved, left, ..Applied::default() })
    }
}

/// Whether a face is marked; those after the end of the marks are not.
fn is_marked(marks: &[bool], face: u32) -> bool {
    marks.get(face as usize) == Some(&true)
}

/// Whether a face has an edge or a height below a length.
fn is_sliver(corners: [DVec3; 3], length: f64) -> bool {
    let shape = Shape::of(corners);
    shape.height < length || shape.shortest() < length
}

/// The edit that removed a sliver.
enum Edit {
    Collapsed,
    Flipped,
    Dropped,
}

/// The number of edits of each kind, and the faces that stay.
#[derive(Default)]
struct EditCounts {
    collapsed: u64,
    flipped: u64,
    dropped: u64,
    left: Vec<u32>,
}

/// The slivers that are still to be removed, with the surface under edit.
struct SliverQueue<'a> {
    local: LocalEdits<'a>,
    /// The tolerance on the unit scale.
    length: f64,
    /// Marks the faces that stay as they are.
    kept: &'a [bool],
    /// For each vertex whether it is a corner of such a face.
    is_fixed: Vec<bool>,
    /// For each vertex the largest distance of the vertices collapsed into it.
    drift: Vec<f64>,
    moved: f64,
    queue: VecDeque<u32>,
}

impl SliverQueue<'_> {
    /// Works through the queue until it is empty.
    fn run(&mut self, budget: u64, context: &Context<'_>) -> Result<EditCounts, Cancelled> {
        let mut tries = vec![0u8; self.local.surface.faces.len()];
        let mut counts = EditCounts::default();
        let mut steps = 0u32;
        while let Some(f) = self.queue.pop_front() {
            steps = steps.wrapping_add(1);
            if steps.is_multiple_of(1024) {
                context.check()?;
            }
            if !self.is_sliver_left(f) {
                continue;
            }
            let tried = &mut tries[f as usize];
            if *tried == MAX_TRIES || self.local.spent > budget {
                counts.left.push(f);
                continue;
            }
            *tried += 1;
            match self.remove_sliver(f) {
                Some(Edit::Collapsed) => counts.collapsed += 1,
                Some(Edit::Flipped) => counts.flipped += 1,
                Some(Edit::Dropped) => counts.dropped += 1,
                None => counts.left.push(f),
            }
        }
        counts.left.sort_unstable();
        counts.left.dedup();
        counts.left.retain(|&f| self.is_sliver_left(f));
        Ok(counts)
    }

    /// Whether a face still exists, and is a sliver that may be removed.
    fn is_sliver_left(&self, f: u32) -> bool {
        self.local.is_alive(f)
            && !is_marked(self.kept, f)
            && is_sliver(self.local.points(self.local.face(f)), self.length)
    }

    /// Tries every edit that removes a sliver, and queues the affected faces.
    fn remove_sliver(&mut self, f: u32) -> Option<Edit> {
        let (face, shape) = (self.local.face(f), self.local.shape(f));
        let mut order = [0, 1, 2];
        order.sort_by(|&i, &j| shape.sides[i].total_cmp(&shape.sides[j]).then(i.cmp(&j)));
        let length = self.length;
        for i in order.into_iter().filter(|&i| shape.sides[i] < length) {
            if self.collapse([face[i], face[(i + 1) % 3]]) {
                return Some(Edit::Collapsed);
            }
        }
        if shape.height >= self.length {
            return None;
        }
        let i = shape.longest();
        self.flip([face[i], face[(i + 1) % 3], face[(i + 2) % 3]], f, shape.height)
    }

    /// Collapses an edge to the end that gives the smaller displacement.
    fn collapse(&mut self, [a, b]: [u32; 2]) -> bool {
        let length = self.local.unit[a as usize].distance(self.local.unit[b as usize]);
        let drift_after =
            |removed: u32, kept: u32| (self.drift[removed as usize] + length).max(self.drift[kept as usize]);
        let mut directions = [(drift_after(a, b), a, b), (drift_after(b, a), b, a)];
        if directions[1].0 < directions[0].0 {
            directions.swap(0, 1);
        }
        let Some(irregular) = self.link_condition(a, b) else { return false };
        for (drift, removed, kept) in directions {
            let may_go = !self.is_fixed[removed as usize] && !irregular.contains(&removed);
            if drift <= self.length && may_go && self.keeps_orientation(removed, kept) {
                self.local.collapse(removed, kept);
                self.drift[kept as usize] = drift;
                self.moved = self.moved.max(drift);
                self.queue.extend(self.local.star(kept));
                return true;
            }
        }
        false
    }

    /// Whether collapsing the edge keeps the surface's topology. Returns the ends that must stay, because they lie on a
    /// boundary or a non-manifold edge and the collapsed edge does not.
    fn link_condition(&mut self, a: u32, b: u32) -> Option<Vec<u32>> {
        let shared = self.local.faces_at_edge(a, b);
        let opposite: Vec<u32> =
            shared.iter().filter_map(|&f| self.local.face(f).into_iter().find(|&v| v != a && v != b)).collect();
        if !matches!(*opposite, [_] | [_, _]) || matches!(*opposite, [c, d] if c == d) {
            return None;
        }
        let [of_a, of_b] = [a, b].map(|v| self.neighbours(v));
        let count = |of: &[(u32, u32)], v: u32| of.binary_search_by_key(&v, |n| n.0).map_or(0, |at| of[at].1);
        let common = of_a.iter().filter(|n| count(&of_b, n.0) > 0).count();
        if common != opposite.len() {
            return None;
        }
        for &c in &opposite {
            let [x, y] = [count(&of_a, c), count(&of_b, c)];
            if x + y < 3 || x + y - 2 > x.max(y).max(2) {
                return None;
            }
        }
        if let [c, d] = *opposite {
            let joins =
                |v: u32| self.local.star(v).iter().any(|&f| [c, d].iter().all(|w| self.local.face(f).contains(w)));
            if joins(a) && joins(b) {
                return None;
            }
        }
        let irregular = |of: &[(u32, u32)]| of.iter().any(|n| n.1 != 2);
        match (irregular(&of_a), irregular(&of_b)) {
            _ if opposite.len() == 1 => Some(Vec::new()),
            (true, true) => None,
            (true, false) => Some(vec![a]),
            (false, true) => Some(vec![b]),
            (false, false) => Some(Vec::new()),
        }
    }

    /// The neighbours of a vertex, ascending, each with the number of faces at the connecting edge.
    fn neighbours(&mut self, v: u32) -> Vec<(u32, u32)> {
        let star = self.local.star(v);
        let mut all: Vec<u32> = star.iter().flat_map(|&f| self.local.face(f)).filter(|&w| w != v).collect();
        self.local.spent += all.len() as u64;
        all.sort_unstable();
        #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
        all.chunk_by(|x, y| x == y).map(|same| (same[0], same.len() as u32)).collect()
    }

    /// Whether no face with an area flips and none becomes collinear when `removed` moves to `kept`.
    fn keeps_orientation(&self, removed: u32, kept: u32) -> bool {
        let local = &self.local;
        local.star(removed).iter().map(|&f| local.face(f)).filter(|face| !face.contains(&kept)).all(|face| {
            let moved = face.map(|v| if v == removed { kept } else { v });
            let turned = local.area_vector(face).dot(local.area_vector(moved)) <= 0.0;
            let thin = Shape::of(local.points(face)).height < self.length;
            (!turned || thin) && (!local.is_collinear(moved) || local.is_collinear(face))
        })
    }

    /// Flips the long edge `a`, `b` of a cap.
    fn flip(&mut self, [a, b, m]: [u32; 3], cap: u32, height: f64) -> Option<Edit> {
        match *self.local.faces_at_edge(a, b) {
            [_] => return self.remove_boundary_cap([a, b, m], cap, height),
            [_, _] => {}
            _ => return self.remove_fin([a, b, m], cap, height),
        }
        let hinge = self.local.hinge(a, b)?;
        let [_, d] = hinge.apexes;
        let beyond = if hinge.faces[0] == cap { hinge.faces[1] } else { hinge.faces[0] };
        if is_marked(self.kept, beyond) || !self.local.faces_at_edge(m, d).is_empty() {
            return None;
        }
        let (other, new) = (self.local.face(beyond), hinge.flipped());
        let was = Shape::of(self.local.points(other)).height;
        let is = new.map(|face| Shape::of(self.local.points(face)).height);
        let thin = |faces: &[[u32; 3]]| faces.iter().filter(|&&face| self.local.is_collinear(face)).count();
        if is[0].min(is[1]) <= height.min(was) || thin(&new) > thin(&[other, self.local.face(cap)]) {
            return None;
        }
        let normal = self.local.area_vector(other);
        if was >= self.length && new.iter().any(|&face| self.local.area_vector(face).dot(normal) <= 0.0) {
            return None;
        }
        for (face, corners) in hinge.faces.into_iter().zip(new) {
            self.local.set_face(face, corners);
        }
        self.local.surface.source[cap as usize] = self.local.surface.source[beyond as usize];
        self.moved = self.moved.max(height);
        self.queue.extend(hinge.faces);
        for [v, w] in [[a, m], [m, b], [b, d], [d, a]] {
            let beside = self.local.faces_at_edge(v, w);
            self.queue.extend(beside.into_iter().filter(|f| !hinge.faces.contains(f)));
        }
        Some(Edit::Flipped)
    }

    /// Removes a cap whose long edge is on the boundary and whose middle corner is not.
    fn remove_boundary_cap(&mut self, [a, b, m]: [u32; 3], cap: u32, height: f64) -> Option<Edit> {
        let whole = self.neighbours(m).iter().all(|n| n.1 == 2);
        let beside = [self.local.faces_at_edge(a, m), self.local.faces_at_edge(m, b)];
        if !whole || beside.iter().any(|faces| faces.len() != 2) {
            return None;
        }
        self.local.remove(cap);
        self.moved = self.moved.max(height);
        self.queue.extend(beside.into_iter().flatten().filter(|&f| f != cap));
        Some(Edit::Dropped)
    }

    /// Removes a cap that stands on an edge of other faces and meets no face at its other edges.
    fn remove_fin(&mut self, [a, b, m]: [u32; 3], cap: u32, height: f64) -> Option<Edit> {
        if [[a, m], [m, b]].into_iter().any(|[v, w]| self.local.faces_at_edge(v, w).len() != 1) {
            return None;
        }
        self.local.remove(cap);
        self.moved = self.moved.max(height);
        Some(Edit::Dropped)
    }
}

impl Operation<'_> for RemoveSlivers {
    const FIXES: &'static [Counter] = &[Counter::DegenerateFaces];
    // Collapsing a boundary edge opens the edges behind it.
    const MAY_RAISE: &'static [Counter] = &[Counter::BoundaryEdges];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self { tolerance: scope.options.degenerate_tolerance, max_deviation: scope.max_deviation }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}
