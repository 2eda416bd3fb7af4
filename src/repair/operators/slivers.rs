//! Faces that are almost without area: with a short edge, or almost on a line.

use std::collections::VecDeque;

use glam::DVec3;

use super::local_edits::{LocalEdits, Shape};
use super::operator::{Applied, Counter, Operation, Scope};
use crate::math::{Box3, unit_scale};
use crate::mesh::Surface;
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// Times that one face is looked at: each follows an edit beside it, and where there are so many they go in circles.
const MOST_TRIES: u8 = 32;
/// Looks at faces around vertices, beside so many for each face of the surface.
const WORK: u64 = 50_000_000;
const WORK_PER_FACE: u64 = 200;

/// Collapses short edges and flips caps.
#[derive(Debug, Clone, Copy)]
pub struct RemoveSlivers {
    /// Edges shorter than this and faces lower than this are removed, as a share of the diagonal of the bounding box. 0 for none.
    pub tolerance: f64,
    /// No vertex is moved farther than this, in the model's unit.
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
    /// The ends of a short edge become one of the two, so that no position is new. A face whose edges are all long enough is a cap: its longest edge is
    /// flipped, by which the surface moves no farther than the cap is high; where nothing lies beyond that edge, the cap goes.
    /// One edit leads to the next through a queue.
    ///
    /// Precondition: no face with a repeated vertex. Result: each vertex is within the tolerance of where it was; nothing that
    /// was closed is open; no face is turned over but other slivers; as many edges of more than two faces, and pinched vertices, at most.
    /// Leaves: edges that the link condition holds (Dey, Edelsbrunner, Guha and Nekhayev 1999), as on a handle or a solid no
    /// thicker than the tolerance, edges of more than two faces, and caps whose flipped edge is there already or would
    /// not make the lowest face higher.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then half done.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let scale = unit_scale(&surface.positions);
        let diagonal = Box3::of(surface.positions.iter().map(|&p| p * scale)).diagonal();
        let length = (self.tolerance * diagonal).min(self.max_deviation * scale);
        if !(length > 0.0 && length.is_finite()) {
            return Ok(Applied::default());
        }
        let mut slivers = VecDeque::new();
        for (face, f) in surface.faces.iter().zip(0u32..) {
            if is_sliver(face.map(|v| surface.positions[v as usize] * scale), length) {
                slivers.push_back(f);
            }
        }
        if slivers.is_empty() {
            return Ok(Applied::default());
        }
        let budget = WORK + WORK_PER_FACE * surface.faces.len() as u64;
        let drift = vec![0.0; surface.positions.len()];
        let mut work = Work { local: LocalEdits::new(surface), length, drift, moved: 0.0, queue: slivers };
        let Mended { collapsed, flipped, dropped, left } = work.mend_all(budget, context)?;
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
                "faces thinner than {:.3e} were left where no edit keeps the surface whole: {}",
                length / scale,
                left.len()
            )
        });
        Ok(Applied { changes, moved, left, ..Applied::default() })
    }
}

/// Whether a face has an edge or a height below a length.
fn is_sliver(corners: [DVec3; 3], length: f64) -> bool {
    let shape = Shape::of(corners);
    shape.height < length || shape.shortest() < length
}

enum Edit {
    Collapsed,
    Flipped,
    Dropped,
}

/// The edits that were made, and the faces for which there was none.
#[derive(Default)]
struct Mended {
    collapsed: u64,
    flipped: u64,
    dropped: u64,
    left: Vec<u32>,
}

struct Work<'a> {
    local: LocalEdits<'a>,
    /// The tolerance on the unit scale.
    length: f64,
    /// How far vertices that were drawn into this one stood from it, at most.
    drift: Vec<f64>,
    moved: f64,
    queue: VecDeque<u32>,
}

impl Work<'_> {
    /// Goes through the queue until it is empty.
    fn mend_all(&mut self, budget: u64, context: &Context<'_>) -> Result<Mended, Cancelled> {
        let mut tries = vec![0u8; self.local.surface.faces.len()];
        let mut mended = Mended::default();
        let mut steps = 0u32;
        while let Some(f) = self.queue.pop_front() {
            steps = steps.wrapping_add(1);
            if steps.is_multiple_of(1024) {
                context.check()?;
            }
            if !self.is_left(f) {
                continue;
            }
            let tried = &mut tries[f as usize];
            if *tried == MOST_TRIES || self.local.spent > budget {
                mended.left.push(f);
                continue;
            }
            *tried += 1;
            match self.mend(f) {
                Some(Edit::Collapsed) => mended.collapsed += 1,
                Some(Edit::Flipped) => mended.flipped += 1,
                Some(Edit::Dropped) => mended.dropped += 1,
                None => mended.left.push(f),
            }
        }
        mended.left.sort_unstable();
        mended.left.dedup();
        mended.left.retain(|&f| self.is_left(f));
        Ok(mended)
    }

    /// Whether a face is there and a sliver.
    fn is_left(&self, f: u32) -> bool {
        self.local.is_alive(f) && is_sliver(self.local.points(self.local.face(f)), self.length)
    }

    /// Tries all ways to be rid of a sliver, and queues what that touches.
    fn mend(&mut self, f: u32) -> Option<Edit> {
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

    /// Makes the ends of an edge one, the one that is moved the less.
    fn collapse(&mut self, [a, b]: [u32; 2]) -> bool {
        let length = self.local.unit[a as usize].distance(self.local.unit[b as usize]);
        let by = |gone: u32, stays: u32| (self.drift[gone as usize] + length).max(self.drift[stays as usize]);
        let mut ways = [(by(a, b), a, b), (by(b, a), b, a)];
        if ways[1].0 < ways[0].0 {
            ways.swap(0, 1);
        }
        let Some(irregular) = self.link_condition(a, b) else { return false };
        for (drift, gone, stays) in ways {
            if drift <= self.length && !irregular.contains(&gone) && self.keeps_sides(gone, stays) {
                self.local.collapse(gone, stays);
                self.drift[stays as usize] = drift;
                self.moved = self.moved.max(drift);
                self.queue.extend(self.local.star(stays));
                return true;
            }
        }
        false
    }

    /// Whether the surface stays as whole as it is when the edge is collapsed; if so, answers the ends that must stay, since
    /// they are on a boundary or an edge of more than two faces and the edge is not.
    fn link_condition(&mut self, a: u32, b: u32) -> Option<Vec<u32>> {
        let shared = self.local.around_edge(a, b);
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

    /// The vertices joined to one, ascending, each with the number of faces along that edge.
    fn neighbours(&mut self, v: u32) -> Vec<(u32, u32)> {
        let star = self.local.star(v);
        let mut all: Vec<u32> = star.iter().flat_map(|&f| self.local.face(f)).filter(|&w| w != v).collect();
        self.local.spent += all.len() as u64;
        all.sort_unstable();
        #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
        all.chunk_by(|x, y| x == y).map(|same| (same[0], same.len() as u32)).collect()
    }

    /// Whether no face with area is turned over, and none comes to lie on a line, when `gone` moves to `stays`.
    fn keeps_sides(&self, gone: u32, stays: u32) -> bool {
        let local = &self.local;
        local.star(gone).iter().map(|&f| local.face(f)).filter(|face| !face.contains(&stays)).all(|face| {
            let moved = face.map(|v| if v == gone { stays } else { v });
            let turned = local.area_vector(face).dot(local.area_vector(moved)) <= 0.0;
            let flat = Shape::of(local.points(face)).height < self.length;
            (!turned || flat) && (!local.is_flat(moved) || local.is_flat(face))
        })
    }

    /// Flips the long edge `a`, `b` of a cap.
    fn flip(&mut self, [a, b, m]: [u32; 3], cap: u32, height: f64) -> Option<Edit> {
        if *self.local.around_edge(a, b) == [cap] {
            return self.drop_at_boundary([a, b, m], cap, height);
        }
        let hinge = self.local.hinge(a, b)?;
        let [_, d] = hinge.apexes;
        if !self.local.around_edge(m, d).is_empty() {
            return None;
        }
        let beyond = if hinge.faces[0] == cap { hinge.faces[1] } else { hinge.faces[0] };
        let (other, new) = (self.local.face(beyond), hinge.flipped());
        let was = Shape::of(self.local.points(other)).height;
        let is = new.map(|face| Shape::of(self.local.points(face)).height);
        let flat = |faces: &[[u32; 3]]| faces.iter().filter(|&&face| self.local.is_flat(face)).count();
        if is[0].min(is[1]) <= height.min(was) || flat(&new) > flat(&[other, self.local.face(cap)]) {
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
            let beside = self.local.around_edge(v, w);
            self.queue.extend(beside.into_iter().filter(|f| !hinge.faces.contains(f)));
        }
        Some(Edit::Flipped)
    }

    /// Removes a cap whose long edge is on the boundary, if its middle corner is not.
    fn drop_at_boundary(&mut self, [a, b, m]: [u32; 3], cap: u32, height: f64) -> Option<Edit> {
        let whole = self.neighbours(m).iter().all(|n| n.1 == 2);
        let beside = [self.local.around_edge(a, m), self.local.around_edge(m, b)];
        if !whole || beside.iter().any(|faces| faces.len() != 2) {
            return None;
        }
        self.local.remove(cap);
        self.moved = self.moved.max(height);
        self.queue.extend(beside.into_iter().flatten().filter(|&f| f != cap));
        Some(Edit::Dropped)
    }
}

impl Operation for RemoveSlivers {
    const FIXES: &'static [Counter] = &[Counter::DegenerateFaces];
    // Where an edge on the boundary is collapsed, those behind it are open.
    const MAY_RAISE: &'static [Counter] = &[Counter::BoundaryEdges];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self { tolerance: scope.options.degenerate_tolerance, max_deviation: scope.max_deviation }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}
