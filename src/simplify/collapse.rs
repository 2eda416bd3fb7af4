use glam::DVec3;

use super::complex::{Bodies, Complex, LINE, NONE, OPEN};
use super::deviation::{Patch, Reference, Witnesses, deviation, line_deviation};
use super::queue::Choice;
use super::validity::{Clearance, Shape, shape};
use crate::mesh::{Edges, Parts};

/// Most faces around the two ends of an edge that collapses, so that a vertex of very many faces does not make it quadratic.
const MOST_FACES: u32 = 512;
/// Distances below this, in the range of exact predicates, are rounding.
const ROUNDING: f64 = 4e-15;
/// By how many times the bound may be larger than what is measured: each face has been changed by three collapses while their
/// number halves, and each time the error doubles, which adds up to some seven times the last.
const BOUND: f64 = 8.0;
/// A closed part may shrink to this share of its volume.
const LEAST_VOLUME: f64 = 0.5;

/// What became of an edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Attempt {
    Done,
    /// It would make slender faces: to be tried again when cheaper ones are done.
    Later,
    Refused(Why),
}

/// Why an edge stays.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Why {
    /// The surface would not be the same any more: a handle, a part or a line would vanish.
    Topology,
    /// A face would turn over or become a needle.
    Shape,
    /// The error would be too large.
    Error,
    /// Faces would intersect.
    Clearance,
}

impl Why {
    pub const ALL: [(Self, &'static str); 4] = [
        (Self::Topology, "to keep holes, parts and lines"),
        (Self::Shape, "since faces would turn over or become needles"),
        (Self::Error, "since the error would be too large"),
        (Self::Clearance, "since faces would intersect"),
    ];
}

/// How far a face is from the surface at the start, in the range of exact predicates.
#[derive(Debug, Clone, Copy)]
struct Errors {
    error: f64,
    bound: f64,
    /// Whether the witnesses were asked.
    measured: bool,
}

/// Collapses edges one by one, or refuses.
pub(super) struct Collapser<'a> {
    pub it: Complex,
    pub bodies: Bodies,
    pub clearance: Clearance,
    witnesses: Witnesses,
    /// In the range of exact predicates.
    pub max_error: f64,
    /// One over the scale of that range.
    pub unscale: f64,
    pub toward: Option<Reference<'a>>,
    /// The largest bound so far.
    pub bound: f64,
    epoch: u32,
    vertex_mark: Vec<u32>,
    face_mark: Vec<u32>,
    /// The corners of both ends.
    gone: Vec<u32>,
    kept: Vec<u32>,
    /// Faces that change and stay, with their corners then.
    changed: Vec<(u32, [u32; 3])>,
    vanishing: Vec<[DVec3; 3]>,
    vanishing_faces: Vec<u32>,
    shapes: Vec<([DVec3; 3], [DVec3; 3])>,
    old: Patch,
    new: Patch,
}

impl<'a> Collapser<'a> {
    pub fn new(it: Complex, bodies: Bodies, max_error: f64, unscale: f64, toward: Option<Reference<'a>>) -> Self {
        Self {
            clearance: Clearance::new(&it),
            witnesses: Witnesses::new(it.at.clone(), it.faces.clone()),
            bodies,
            max_error,
            unscale,
            toward,
            bound: 0.0,
            epoch: 0,
            vertex_mark: vec![0; it.at.len()],
            face_mark: vec![0; it.faces.len()],
            it,
            gone: Vec::new(),
            kept: Vec::new(),
            changed: Vec::new(),
            vanishing: Vec::new(),
            vanishing_faces: Vec::new(),
            shapes: Vec::new(),
            old: Patch::default(),
            new: Patch::default(),
        }
    }

    /// Collapses an edge, if all that must hold does afterwards. `patient` says that it has waited for others already.
    pub fn attempt(&mut self, choice: Choice, patient: bool) -> Attempt {
        let Choice { gone, kept, at, .. } = choice;
        if self.it.degree[gone as usize] + self.it.degree[kept as usize] > MOST_FACES {
            return Attempt::Refused(Why::Topology);
        }
        self.it.star(gone, &mut self.gone);
        self.it.star(kept, &mut self.kept);
        let moved = at != self.it.at[kept as usize];
        let Some(line) = self.keeps_topology(gone, kept) else { return Attempt::Refused(Why::Topology) };
        self.list_changes(gone, kept, at, moved);
        match shape(&self.vanishing, &self.shapes) {
            Shape::Bad => return Attempt::Refused(Why::Shape),
            Shape::Poor if !patient => return Attempt::Later,
            _ => {}
        }
        let Some(error) = self.error_of(choice, moved, line) else { return Attempt::Refused(Why::Error) };
        let Some(volume) = self.keeps_volume(kept, at) else { return Attempt::Refused(Why::Shape) };
        let was = std::mem::replace(&mut self.it.at[kept as usize], at);
        let new: Vec<[u32; 3]> = self.changed.iter().map(|(_, face)| *face).collect();
        let (marks, epoch) = (&self.face_mark, self.epoch);
        if !self.clearance.is_clear(&self.it, &new, |f| marks[f as usize] == epoch) {
            self.it.at[kept as usize] = was;
            return Attempt::Refused(Why::Clearance);
        }
        if !error.measured {
            self.gather(gone, kept, moved);
            self.witnesses.assign(&self.new.faces, at);
        }
        let old = self.changed.iter().map(|(f, _)| *f).chain(self.vanishing_faces.iter().copied());
        self.witnesses.settle(old, |i| self.changed[i as usize].0);
        self.apply(gone, kept, error);
        if let Some((part, volume)) = volume {
            self.bodies.volumes[part] = Some(volume);
        }
        self.bound = self.bound.max(error.bound);
        Attempt::Done
    }

    /// Whether the link condition holds (Dey et al. 1999): the neighbours that both ends have are those of their common
    /// faces, and no edge has both ends' faces across it. Answers where a line goes on beyond the vertex that goes, with
    /// the marks of its edges, or none where it is on no line. Marks the faces of the vertex that goes.
    fn keeps_topology(&mut self, gone: u32, kept: u32) -> Option<Option<(u32, u8)>> {
        if self.epoch > u32::MAX - 4 {
            self.epoch = 0;
            self.vertex_mark.fill(0);
            self.face_mark.fill(0);
        }
        self.epoch += 2;
        let (epoch, it) = (self.epoch, &self.it);
        let vertex = |corner: u32| it.faces[corner as usize / 3][corner as usize % 3];
        let others = |corner: u32| [vertex(Edges::next(corner)), vertex(Edges::previous(corner))];
        let mut shared = 0;
        for &corner in &self.gone {
            self.face_mark[corner as usize / 3] = epoch;
            let around = others(corner);
            shared += usize::from(around.contains(&kept));
            around.iter().for_each(|&v| self.vertex_mark[v as usize] = epoch);
        }
        let mut common = 0;
        for v in self.kept.iter().flat_map(|&corner| others(corner)) {
            if v != gone && self.vertex_mark[v as usize] == epoch {
                self.vertex_mark[v as usize] = epoch + 1;
                common += 1;
            }
        }
        if shared == 0 || common != shared {
            return None;
        }
        let across = |corners: &[u32]| {
            corners.iter().any(|&corner| others(corner).iter().all(|&v| self.vertex_mark[v as usize] == epoch + 1))
        };
        if across(&self.gone) && across(&self.kept) {
            return None;
        }
        let mut line = None;
        for &corner in &self.gone {
            for (edge, v) in
                [(corner, vertex(Edges::next(corner))), (Edges::previous(corner), vertex(Edges::previous(corner)))]
            {
                let marks = it.marks(edge);
                if marks & LINE == 0 || v == kept {
                    continue;
                }
                let is_common = self.vertex_mark[v as usize] == epoch + 1;
                if is_common || line.is_some_and(|(u, _)| u != v) {
                    return None;
                }
                line = Some((v, marks));
            }
        }
        Some(line)
    }

    /// Lists what changes, and the patches before and after.
    fn list_changes(&mut self, gone: u32, kept: u32, at: DVec3, moved: bool) {
        let Self { it, changed, vanishing, vanishing_faces, shapes, old, new, face_mark, epoch, .. } = self;
        changed.clear();
        vanishing.clear();
        vanishing_faces.clear();
        shapes.clear();
        old.clear();
        new.clear();
        let place = |v: u32| if v == kept { at } else { it.at[v as usize] };
        let of_kept: &[u32] = if moved { &self.kept } else { &[] };
        for &corner in self.gone.iter().chain(of_kept) {
            let f = corner as usize / 3;
            let face = it.faces[f];
            if face.contains(&gone) && face[corner as usize % 3] == kept {
                continue;
            }
            let before = it.corners(f);
            old.faces.push(before);
            face_mark[f] = *epoch;
            if face.contains(&kept) && face.contains(&gone) {
                vanishing.push(before);
                vanishing_faces.push(u32::try_from(f).unwrap_or(NONE));
                continue;
            }
            let then = face.map(|v| if v == gone { kept } else { v });
            let after = then.map(place);
            changed.push((u32::try_from(f).unwrap_or(NONE), then));
            shapes.push((before, after));
            new.faces.push(after);
        }
        old.middles.push(it.at[gone as usize]);
        if moved {
            old.middles.push(it.at[kept as usize]);
            new.middles.push(at);
        }
        let vertex = |corner: u32| it.faces[corner as usize / 3][corner as usize % 3];
        let target = if moved { NONE } else { kept };
        for (&corner, centre) in self.gone.iter().map(|c| (c, gone)).chain(of_kept.iter().map(|c| (c, kept))) {
            let open = (it.marks(Edges::previous(corner)) & OPEN != 0).then(|| Edges::previous(corner));
            for v in [Some(Edges::next(corner)), open].into_iter().flatten().map(vertex) {
                if v == gone {
                    continue;
                }
                let end = it.at[v as usize];
                old.spokes.push(([it.at[centre as usize], end], [v, centre]));
                if v != kept {
                    new.spokes.push(([at, end], [v, target]));
                }
            }
        }
    }

    /// The error of the faces that change, unless it is too large: what it was and what is added, or what is measured.
    fn error_of(&mut self, choice: Choice, moved: bool, line: Option<(u32, u8)>) -> Option<Errors> {
        let Choice { gone, kept, at, .. } = choice;
        let it = &self.it;
        let [p, q] = [gone, kept].map(|v| it.at[v as usize]);
        // Each face moved along with its corner is a map from one to the other too.
        let step = deviation(&self.old, &self.new, at).unwrap_or_else(|| at.distance(p).max(at.distance(q)));
        let step = match line {
            Some((beyond, marks)) => {
                let aside = line_deviation(p, [it.at[beyond as usize], at]);
                // Beside an open line there is surface on one side only, which then ends elsewhere.
                if marks & OPEN != 0 { step + aside } else { step.max(aside) }
            }
            None => step,
        };
        let step = if step < ROUNDING { 0.0 } else { step };
        let of_kept: &[u32] = if moved { &self.kept } else { &[] };
        let faces = || self.gone.iter().chain(of_kept).map(|&corner| corner as usize / 3);
        let bound = f64::from(faces().map(|f| it.bound[f]).fold(0.0, f32::max)) + step;
        let error = f64::from(faces().map(|f| it.error[f]).fold(0.0, f32::max)) + step;
        if bound > BOUND * self.max_error || !self.stays_near_reference() {
            return None;
        }
        if error <= self.max_error {
            return Some(Errors { error, bound, measured: false });
        }
        self.gather(gone, kept, moved);
        let error = self.measured(at, moved)?;
        Some(Errors { error, bound, measured: true })
    }

    /// Gathers the witnesses of all that changes.
    fn gather(&mut self, gone: u32, kept: u32, moved: bool) {
        let faces = self.changed.iter().map(|(f, _)| *f).chain(self.vanishing_faces.iter().copied());
        self.witnesses.gather(faces, &[gone, kept][..1 + usize::from(moved)]);
    }

    /// How far the new faces are from the surface at the start where that is asked: at its vertices, and at the middles of the new
    /// faces and of their edges, and at the new position. None where that is too far.
    fn measured(&mut self, at: DVec3, moved: bool) -> Option<f64> {
        let mut most = self.witnesses.farthest(&self.new.faces);
        if most > self.max_error {
            return None;
        }
        let middles = |&[a, b, c]: &[DVec3; 3]| [a.midpoint(b), b.midpoint(c), c.midpoint(a), (a + b + c) / 3.0];
        for p in self.new.faces.iter().flat_map(middles).chain(moved.then_some(at)) {
            most = most.max(self.witnesses.distance(p, self.max_error)?);
        }
        Some(most)
    }

    /// Whether the new faces are as near to the reference as was asked, or as the faces before them were.
    fn stays_near_reference(&self) -> bool {
        let Some(reference) = &self.toward else { return true };
        let distance = |faces: &[[DVec3; 3]], bound: f64| {
            let mut most = 0.0f64;
            for &[a, b, c] in faces {
                for p in [a.midpoint(b), b.midpoint(c), c.midpoint(a), (a + b + c) / 3.0] {
                    match reference.distance(p * self.unscale, bound) {
                        Some(d) => most = most.max(d),
                        None => return None,
                    }
                }
            }
            Some(most)
        };
        let most = self.max_error * self.unscale;
        distance(&self.new.faces, most).is_some()
            || distance(&self.old.faces, f64::INFINITY)
                .is_some_and(|was| was > most && distance(&self.new.faces, was).is_some())
    }

    /// The volume that the closed part of a vertex has then, unless that is less than half of what it was or more than
    /// twice as much; with its part.
    #[expect(clippy::option_option, reason = "nothing to keep is not the same as not kept")]
    fn keeps_volume(&self, kept: u32, at: DVec3) -> Option<Option<(usize, [f64; 2])>> {
        let part = self.bodies.of_vertex[kept as usize];
        let volume = if part == Parts::NONE { None } else { self.bodies.volumes[part as usize] };
        let Some([now, start]) = volume else { return Some(None) };
        // Both patches have one rim, so that any origin gives the difference.
        let sum =
            |faces: &[[DVec3; 3]]| faces.iter().map(|f| f.map(|p| p - at)).map(|[a, b, c]| a.dot(b.cross(c))).sum();
        let (removed, added): (f64, f64) = (sum(&self.old.faces), sum(&self.new.faces));
        let then = now + added - removed;
        let share = then / start;
        // A part that encloses nothing has no volume to lose.
        let fine = start == 0.0 || (LEAST_VOLUME..=1.0 / LEAST_VOLUME).contains(&share);
        fine.then_some(Some((part as usize, [then, start])))
    }

    /// Makes the change that was listed.
    fn apply(&mut self, gone: u32, kept: u32, error: Errors) {
        let it = &mut self.it;
        let vertex = |it: &Complex, corner: u32| it.faces[corner as usize / 3][corner as usize % 3];
        // The edge from the vertex that goes becomes that from the one that stays, with its marks.
        for i in 0..self.gone.len() {
            let corner = self.gone[i];
            let (next, last) = (Edges::next(corner), Edges::previous(corner));
            let (tip, edge) = if vertex(it, next) == kept {
                (vertex(it, last), next)
            } else if vertex(it, last) == kept {
                (vertex(it, next), next)
            } else {
                continue;
            };
            // Corners run gone, kept, tip or gone, tip, kept: either way the edge between kept and tip starts at `next`.
            let marks = it.marks(edge);
            for &other in &self.gone {
                if vertex(it, Edges::next(other)) == tip {
                    it.mark(other, marks);
                }
                if vertex(it, Edges::previous(other)) == tip {
                    it.mark(Edges::previous(other), marks);
                }
            }
        }
        for i in 0..self.gone.len() {
            let f = self.gone[i] as usize / 3;
            if it.faces[f].contains(&kept) {
                for v in it.faces[f] {
                    it.degree[v as usize] -= 1;
                }
                it.faces[f] = [NONE; 3];
                it.alive -= 1;
            }
        }
        #[expect(clippy::cast_possible_truncation, reason = "rounded up")]
        let up = |x: f64| if x > 0.0 { (x as f32).next_up() } else { 0.0 };
        for (f, face) in &self.changed {
            it.faces[*f as usize] = *face;
            it.error[*f as usize] = up(error.error);
            it.bound[*f as usize] = up(error.bound);
            it.flat[*f as usize] = false;
        }
        let stays = |corner: &u32| it.faces[*corner as usize / 3][0] != NONE;
        let corners: Vec<u32> = self.kept.iter().chain(&self.gone).copied().filter(stays).collect();
        it.set_star(kept, &corners);
        it.set_star(gone, &[]);
        let quadric = it.quadric[gone as usize];
        it.quadric[kept as usize].add(&quadric);
        for v in [gone, kept] {
            it.version[v as usize] = it.version[v as usize].wrapping_add(1);
        }
        for (f, _) in &self.changed {
            self.clearance.grow(it, *f);
        }
        self.clearance.refresh(it);
    }
}
