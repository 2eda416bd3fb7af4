//! Collapses one edge at a time, if topology, shape, error, volume and clearance allow it.

use glam::DVec3;

use super::deviation::{Patch, Witnesses, deviation, line_deviation};
use super::dynamic_mesh::{DynamicMesh, LINE, NONE, OPEN, PartVolumes};
use super::max_distance::Reach;
use super::queue::Choice;
use super::validity::{Clearance, Shape, shape};
use crate::mesh::{Edges, Parts};

/// Maximum faces around the two ends of a collapsing edge. The limit avoids quadratic time at vertices with very many
/// faces.
const MAX_FACES: u32 = 512;
/// Distances below this count as rounding, in the scaled coordinates of the exact predicates.
const ROUNDING_DISTANCE: f64 = 4e-15;
/// Maximum ratio of the error bound to `max_error`, which limits the measured error. While the number of faces halves,
/// about three collapses change each face and the error doubles. The sum is therefore about seven times the last error.
pub(super) const MAX_BOUND_RATIO: f64 = 8.0;
/// Smallest share of its volume to which a closed part may shrink. It may grow by the inverse.
const MIN_VOLUME_SHARE: f64 = 0.5;
/// Maximum boxes and triangles that the complete test of one new face may visit. A face that replaces very many is left to
/// the test of the whole surface.
const MAX_STEPS: u64 = 8_000;
/// Share of the maximum error up to which measured points are trusted without that test.
const MIN_TESTED_SHARE: f64 = 0.5;

/// The result of an attempted collapse.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Attempt {
    /// The edge collapsed.
    Done,
    /// The collapse would create slender faces; it is tried again after cheaper ones.
    Later,
    /// The collapse was refused.
    Refused(Refusal),
}

/// Why a collapse was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Refusal {
    /// The topology would change: a handle, a part or a line would vanish.
    Topology,
    /// A face would flip or become a needle.
    Shape,
    /// The error would exceed its bound.
    Error,
    /// Faces would intersect.
    Clearance,
}

impl Refusal {
    /// All reasons, in words that follow a number of collapses.
    pub const ALL: [(Self, &'static str); 4] = [
        (Self::Topology, "collapses would change holes, parts or sharp edges"),
        (Self::Shape, "collapses would flip faces or create needles"),
        (Self::Error, "collapses would exceed the maximum error"),
        (Self::Clearance, "collapses would make faces intersect"),
    ];
}

/// The distance of a face from the original surface, in the scaled coordinates of the exact predicates.
#[derive(Debug, Clone, Copy)]
struct FaceError {
    error: f64,
    bound: f64,
    /// Whether the error was measured at the witnesses.
    measured: bool,
}

/// Collapses edges one by one, or refuses to.
pub(super) struct Collapser {
    /// The current faces.
    pub mesh: DynamicMesh,
    /// The parts of the original surface, and their volumes.
    pub part_volumes: PartVolumes,
    /// The search for intersecting faces.
    pub clearance: Clearance,
    witnesses: Witnesses,
    /// Maximum error, in the scaled coordinates of the exact predicates.
    pub max_error: f64,
    /// Whether to measure every point of the new faces, and not only a few: see [`super::Simplify::everywhere`].
    pub everywhere: bool,
    /// The largest error bound so far.
    pub bound: f64,
    epoch: u32,
    vertex_mark: Vec<u32>,
    face_mark: Vec<u32>,
    /// Corners of the removed vertex.
    removed: Vec<u32>,
    kept: Vec<u32>,
    /// Faces that change but stay, with their new corners.
    changed: Vec<(u32, [u32; 3])>,
    vanishing: Vec<[DVec3; 3]>,
    vanishing_faces: Vec<u32>,
    shapes: Vec<([DVec3; 3], [DVec3; 3])>,
    old: Patch,
    new: Patch,
}

impl Collapser {
    /// Prepares the search structures for a mesh.
    pub fn new(mesh: DynamicMesh, part_volumes: PartVolumes, max_error: f64, everywhere: bool) -> Self {
        Self {
            clearance: Clearance::new(&mesh),
            witnesses: Witnesses::new(mesh.at.clone(), mesh.faces.clone()),
            part_volumes,
            max_error,
            everywhere,
            bound: 0.0,
            epoch: 0,
            vertex_mark: vec![0; mesh.at.len()],
            face_mark: vec![0; mesh.faces.len()],
            mesh,
            removed: Vec::new(),
            kept: Vec::new(),
            changed: Vec::new(),
            vanishing: Vec::new(),
            vanishing_faces: Vec::new(),
            shapes: Vec::new(),
            old: Patch::default(),
            new: Patch::default(),
        }
    }

    /// Collapses an edge if every condition holds. `deferred` means that the edge was already postponed once.
    pub fn attempt(&mut self, choice: Choice, deferred: bool) -> Attempt {
        let Choice { removed, kept, at, .. } = choice;
        if self.mesh.degree[removed as usize] + self.mesh.degree[kept as usize] > MAX_FACES {
            return Attempt::Refused(Refusal::Topology);
        }
        self.mesh.star(removed, &mut self.removed);
        self.mesh.star(kept, &mut self.kept);
        let moved = at != self.mesh.at[kept as usize];
        let Some(line) = self.keeps_topology(removed, kept) else { return Attempt::Refused(Refusal::Topology) };
        self.list_changes(removed, kept, at, moved);
        match shape(&self.vanishing, &self.shapes) {
            Shape::Bad => return Attempt::Refused(Refusal::Shape),
            Shape::Poor if !deferred => return Attempt::Later,
            _ => {}
        }
        let Some(error) = self.error_of(choice, moved, line) else { return Attempt::Refused(Refusal::Error) };
        let Some(volume) = self.keeps_volume(kept, at) else { return Attempt::Refused(Refusal::Shape) };
        let old_position = std::mem::replace(&mut self.mesh.at[kept as usize], at);
        let new: Vec<[u32; 3]> = self.changed.iter().map(|(_, face)| *face).collect();
        let (marks, epoch) = (&self.face_mark, self.epoch);
        if !self.clearance.is_clear(&self.mesh, &new, |f| marks[f as usize] == epoch) {
            self.mesh.at[kept as usize] = old_position;
            return Attempt::Refused(Refusal::Clearance);
        }
        if !error.measured {
            self.gather(removed, kept, moved);
            self.witnesses.assign(&self.new.faces, at);
        }
        let old = self.changed.iter().map(|(f, _)| *f).chain(self.vanishing_faces.iter().copied());
        self.witnesses.transfer(old, |i| self.changed[i as usize].0);
        self.apply(removed, kept, error);
        if let Some((part, volume)) = volume {
            self.part_volumes.volumes[part] = Some(volume);
        }
        self.bound = self.bound.max(error.bound);
        Attempt::Done
    }

    /// Checks the link condition (Dey et al. 1999): the common neighbours of both ends must be those of their common
    /// faces, and no edge between common neighbours may have faces of both ends. Returns where the line through the
    /// removed vertex continues, with the marks of that edge; none inside if the vertex is on no line. Marks the faces
    /// of the removed vertex.
    fn keeps_topology(&mut self, removed: u32, kept: u32) -> Option<Option<(u32, u8)>> {
        if self.epoch > u32::MAX - 4 {
            self.epoch = 0;
            self.vertex_mark.fill(0);
            self.face_mark.fill(0);
        }
        self.epoch += 2;
        let (epoch, mesh) = (self.epoch, &self.mesh);
        let vertex = |corner: u32| mesh.faces[corner as usize / 3][corner as usize % 3];
        let others = |corner: u32| [vertex(Edges::next(corner)), vertex(Edges::previous(corner))];
        let mut shared = 0;
        for &corner in &self.removed {
            self.face_mark[corner as usize / 3] = epoch;
            let around = others(corner);
            shared += usize::from(around.contains(&kept));
            around.iter().for_each(|&v| self.vertex_mark[v as usize] = epoch);
        }
        let mut common = 0;
        for v in self.kept.iter().flat_map(|&corner| others(corner)) {
            if v != removed && self.vertex_mark[v as usize] == epoch {
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
        if across(&self.removed) && across(&self.kept) {
            return None;
        }
        let mut line = None;
        for &corner in &self.removed {
            for (edge, v) in
                [(corner, vertex(Edges::next(corner))), (Edges::previous(corner), vertex(Edges::previous(corner)))]
            {
                let marks = mesh.marks(edge);
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

    /// Lists the changing faces, and the patches before and after the collapse.
    fn list_changes(&mut self, removed: u32, kept: u32, at: DVec3, moved: bool) {
        let Self { mesh, changed, vanishing, vanishing_faces, shapes, old, new, face_mark, epoch, .. } = self;
        changed.clear();
        vanishing.clear();
        vanishing_faces.clear();
        shapes.clear();
        old.clear();
        new.clear();
        let position = |v: u32| if v == kept { at } else { mesh.at[v as usize] };
        let of_kept: &[u32] = if moved { &self.kept } else { &[] };
        for &corner in self.removed.iter().chain(of_kept) {
            let f = corner as usize / 3;
            let face = mesh.faces[f];
            if face.contains(&removed) && face[corner as usize % 3] == kept {
                continue;
            }
            let before = mesh.corners(f);
            old.faces.push(before);
            face_mark[f] = *epoch;
            if face.contains(&kept) && face.contains(&removed) {
                vanishing.push(before);
                vanishing_faces.push(u32::try_from(f).unwrap_or(NONE));
                continue;
            }
            let then = face.map(|v| if v == removed { kept } else { v });
            let after = then.map(position);
            changed.push((u32::try_from(f).unwrap_or(NONE), then));
            shapes.push((before, after));
            new.faces.push(after);
        }
        old.centres.push(mesh.at[removed as usize]);
        if moved {
            old.centres.push(mesh.at[kept as usize]);
            new.centres.push(at);
        }
        let vertex = |corner: u32| mesh.faces[corner as usize / 3][corner as usize % 3];
        let target = if moved { NONE } else { kept };
        for (&corner, centre) in self.removed.iter().map(|c| (c, removed)).chain(of_kept.iter().map(|c| (c, kept))) {
            let open = (mesh.marks(Edges::previous(corner)) & OPEN != 0).then(|| Edges::previous(corner));
            for v in [Some(Edges::next(corner)), open].into_iter().flatten().map(vertex) {
                if v == removed {
                    continue;
                }
                let end = mesh.at[v as usize];
                old.spokes.push(([mesh.at[centre as usize], end], [v, centre]));
                if v != kept {
                    new.spokes.push(([at, end], [v, target]));
                }
            }
        }
    }

    /// The error of the changing faces: the previous error plus the step, or the measured error. None if the error is
    /// too large.
    fn error_of(&mut self, choice: Choice, moved: bool, line: Option<(u32, u8)>) -> Option<FaceError> {
        let Choice { removed, kept, at, .. } = choice;
        let mesh = &self.mesh;
        let [p, q] = [removed, kept].map(|v| mesh.at[v as usize]);
        // Moving each face with its corner also maps one patch to the other.
        let step = deviation(&self.old, &self.new, at).unwrap_or_else(|| at.distance(p).max(at.distance(q)));
        let step = match line {
            Some((beyond, marks)) => {
                let aside = line_deviation(p, [mesh.at[beyond as usize], at]);
                // An open line has surface on one side only, so moving the line also moves the end of the surface.
                if marks & OPEN != 0 { step + aside } else { step.max(aside) }
            }
            None => step,
        };
        let step = if step < ROUNDING_DISTANCE { 0.0 } else { step };
        let of_kept: &[u32] = if moved { &self.kept } else { &[] };
        let faces = || self.removed.iter().chain(of_kept).map(|&corner| corner as usize / 3);
        let bound = f64::from(faces().map(|f| mesh.bound[f]).fold(0.0, f32::max)) + step;
        let error = f64::from(faces().map(|f| mesh.error[f]).fold(0.0, f32::max)) + step;
        if bound > MAX_BOUND_RATIO * self.max_error {
            return None;
        }
        if error <= self.max_error {
            return Some(FaceError { error, bound, measured: false });
        }
        self.gather(removed, kept, moved);
        let error = self.measured(at, moved)?;
        Some(FaceError { error, bound, measured: true })
    }

    /// Gathers the witnesses of all changing faces.
    fn gather(&mut self, removed: u32, kept: u32, moved: bool) {
        let faces = self.changed.iter().map(|(f, _)| *f).chain(self.vanishing_faces.iter().copied());
        self.witnesses.gather(faces, &[removed, kept][..1 + usize::from(moved)]);
    }

    /// The measured distance of the new faces from the original surface: at the original vertices, at the centroids and
    /// edge midpoints of the new faces, and at the new position. None if the distance exceeds the maximum error.
    fn measured(&mut self, at: DVec3, moved: bool) -> Option<f64> {
        let mut most = self.witnesses.farthest(&self.new.faces);
        if most > self.max_error {
            return None;
        }
        let test_points = |&[a, b, c]: &[DVec3; 3]| [a.midpoint(b), b.midpoint(c), c.midpoint(a), (a + b + c) / 3.0];
        let original = self.witnesses.original();
        for p in self.new.faces.iter().flat_map(test_points).chain(moved.then_some(at)) {
            most = most.max(original.distance(p, self.max_error)?);
        }
        let is_beyond =
            |face: &[DVec3; 3]| matches!(original.reach(*face, self.max_error, MAX_STEPS, || false), Reach::Beyond(_));
        let is_tested = self.everywhere && most > MIN_TESTED_SHARE * self.max_error;
        (!is_tested || !self.new.faces.iter().any(is_beyond)).then_some(most)
    }

    /// The new volume of the vertex's closed part, with the part's index. None if the volume falls below half of the
    /// original volume or exceeds twice that volume.
    #[expect(clippy::option_option, reason = "no volume to check differs from a failed check")]
    fn keeps_volume(&self, kept: u32, at: DVec3) -> Option<Option<(usize, [f64; 2])>> {
        let part = self.part_volumes.of_vertex[kept as usize];
        let volume = if part == Parts::NONE { None } else { self.part_volumes.volumes[part as usize] };
        let Some([now, start]) = volume else { return Some(None) };
        // Both patches have the same rim, so any origin gives the same difference.
        let sum =
            |faces: &[[DVec3; 3]]| faces.iter().map(|f| f.map(|p| p - at)).map(|[a, b, c]| a.dot(b.cross(c))).sum();
        let (removed, added): (f64, f64) = (sum(&self.old.faces), sum(&self.new.faces));
        let then = now + added - removed;
        let share = then / start;
        // A part without volume has no volume to lose.
        let is_allowed = start == 0.0 || (MIN_VOLUME_SHARE..=1.0 / MIN_VOLUME_SHARE).contains(&share);
        is_allowed.then_some(Some((part as usize, [then, start])))
    }

    /// Applies the listed changes.
    fn apply(&mut self, removed: u32, kept: u32, error: FaceError) {
        let mesh = &mut self.mesh;
        let vertex = |mesh: &DynamicMesh, corner: u32| mesh.faces[corner as usize / 3][corner as usize % 3];
        // The removed vertex's edges become edges of the kept vertex, with their marks.
        for i in 0..self.removed.len() {
            let corner = self.removed[i];
            let (next, last) = (Edges::next(corner), Edges::previous(corner));
            let (tip, edge) = if vertex(mesh, next) == kept {
                (vertex(mesh, last), next)
            } else if vertex(mesh, last) == kept {
                (vertex(mesh, next), next)
            } else {
                continue;
            };
            // Corners are in the order removed, kept, tip or removed, tip, kept. In both cases the edge between kept
            // and tip starts at `next`.
            let marks = mesh.marks(edge);
            for &other in &self.removed {
                if vertex(mesh, Edges::next(other)) == tip {
                    mesh.mark(other, marks);
                }
                if vertex(mesh, Edges::previous(other)) == tip {
                    mesh.mark(Edges::previous(other), marks);
                }
            }
        }
        for i in 0..self.removed.len() {
            let f = self.removed[i] as usize / 3;
            if mesh.faces[f].contains(&kept) {
                for v in mesh.faces[f] {
                    mesh.degree[v as usize] -= 1;
                }
                mesh.faces[f] = [NONE; 3];
                mesh.alive -= 1;
            }
        }
        #[expect(clippy::cast_possible_truncation, reason = "rounded up")]
        let up = |x: f64| if x > 0.0 { (x as f32).next_up() } else { 0.0 };
        for (f, face) in &self.changed {
            mesh.faces[*f as usize] = *face;
            mesh.error[*f as usize] = up(error.error);
            mesh.bound[*f as usize] = up(error.bound);
            mesh.flat[*f as usize] = false;
        }
        let stays = |corner: &u32| mesh.faces[*corner as usize / 3][0] != NONE;
        let corners: Vec<u32> = self.kept.iter().chain(&self.removed).copied().filter(stays).collect();
        mesh.set_star(kept, &corners);
        mesh.set_star(removed, &[]);
        let quadric = mesh.quadric[removed as usize];
        mesh.quadric[kept as usize].add(&quadric);
        for v in [removed, kept] {
            mesh.version[v as usize] = mesh.version[v as usize].wrapping_add(1);
        }
        for (f, _) in &self.changed {
            self.clearance.grow(mesh, *f);
        }
        self.clearance.refresh(mesh);
    }
}
