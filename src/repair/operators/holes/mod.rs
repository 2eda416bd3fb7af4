//! Fills holes: closes boundary loops with patches of triangles.
//!
//! `group.rs` finds the loops that bound one hole, `triangulate.rs` computes triangulations, `choose.rs` chooses among them,
//! `patch.rs` refines patches, and `clearance.rs` finds their intersections.

mod choose;
mod clearance;
mod group;
mod patch;
mod triangulate;

use std::sync::Arc;

use crate::inspect::{Solid, solids};
use crate::math::Box3;
use crate::mesh::{Edges, Parts, Surface, UnionFind, boundary_loops};
use crate::repair::operators::operator::{Applied, Counter, Operation, Scope, as_shared};
use crate::repair::operators::sheets::encloses;
use crate::repair::{Cancelled, Change, ChangeKind, Context};
pub use choose::FillHoles;
use choose::{Filler, PatchCandidate, face_normal};
use clearance::Clearance;
pub(super) use group::newell;
use group::{Hole, group_loops};

pub use crate::repair::options::HoleFilling;

/// The result of filling holes.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Filled {
    /// The changes with their counts.
    pub changes: Vec<Change>,
    /// The number of loops that are still open, in parts that do not count as sheets.
    pub holes_left: u64,
    /// The number of these that exceed a limit on edges, size or number.
    pub over_limit: u64,
    /// The number of boundary edges in no loop, because of inconsistent winding or a non-manifold edge.
    pub unwalked_edges: u64,
    /// The number of parts that count as open sheets and stay open.
    pub open_sheets: u64,
    /// The number of patches that intersect a face, because every other triangulation is worse.
    pub intersecting: u64,
    /// The number of patches that were not checked for intersections, because the search reached its limit.
    pub unchecked: u64,
}

impl Filled {
    /// The note on what was left; `None` where nothing was.
    pub(super) fn unfixed_note(&self) -> Option<String> {
        let mut notes = Vec::new();
        let mut add_note = |count: u64, text: &str| {
            if count > 0 {
                notes.push(format!("{count} {text}"));
            }
        };
        add_note(self.over_limit, "holes exceed `max_hole_edges`, `max_hole_size` or `max_holes` and stay open");
        add_note(self.holes_left - self.over_limit, "holes could not be filled");
        add_note(self.unwalked_edges, "boundary edges form no closed loop");
        add_note(self.open_sheets, "parts are open sheets that enclose no volume; they stay open");
        add_note(self.intersecting, "patches intersect other faces, and so did every other triangulation tried");
        add_note(self.unchecked, "patches were not checked for intersections: the search reached its limit");
        (!notes.is_empty()).then(|| notes.join("; "))
    }
}

impl FillHoles {
    /// Closes boundary loops with triangles over their own vertices.
    ///
    /// Candidates are tried from smooth to robust. The first without a fault is taken, or else the one with the fewest. A fault
    /// is a face without area, or a pair of intersecting faces, decided exactly against the surface, the patch itself and
    /// earlier patches. The candidates are:
    ///
    /// 1. the triangulation with the smallest maximum dihedral angle (Liepa 2003),
    /// 2. the constrained Delaunay triangulation in the hole's plane, which comes first for a planar hole,
    /// 3. the triangulation of least area,
    /// 4. growth from the sharpest corners.
    ///
    /// For more than 128 edges they are 2, 4, and pieces split by short chords. A diagonal is never an existing edge, so no
    /// edge gets a third face.
    ///
    /// A loop inside another, close to its plane and in the opposite direction, bounds an island: both get one common patch.
    /// A body is a set of parts joined by islands. Its loops are filled all or none: [`encloses`] distinguishes a solid with
    /// holes from an open sheet. Where one loop cannot be filled, the others still are if their patches are small relative to
    /// the body.
    ///
    /// ```text
    ///    ___________          ___________
    ///   |   /   \   |        |   / | \   |
    ///   |  |     |  |   ->   |  |  |/ |  |
    ///   |   \___/   |        |   \_|_/   |
    /// ```
    ///
    /// Precondition: consistent winding; boundary walks that meet a conflict end and are left. Result: no vertex moves and no
    /// face goes. Where every triangulation needs an existing edge, a cone over a new vertex fills the hole. Leaves: loops
    /// over the limits, loops of open sheets, and corners that a sharp patch could not reach.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Filled, Cancelled> {
        let edges = Edges::new(&surface.faces);
        as_shared(surface, |surface| self.apply_shared(surface, &edges, context))
    }

    /// [`FillHoles::apply`] to a surface with these `edges`.
    fn apply_shared(
        &self,
        surface: &mut Arc<Surface>,
        edges: &Edges,
        context: &Context<'_>,
    ) -> Result<Filled, Cancelled> {
        if edges.iter().all(|h| h.len() != 1) {
            return Ok(Filled::default());
        }
        let parts = Parts::new(surface, edges);
        let loops = boundary_loops(surface, edges);
        let mut filled = Filled { unwalked_edges: loops.left, ..Filled::default() };
        let of_edge = |a, b| face_normal(&surface.positions, &surface.faces, edges, a, b);
        let holes = group_loops(&surface.positions, loops, &parts, of_edge);
        context.check()?;
        let is_within_limits = self.within_limits(surface, &holes);
        let (bodies, by_body) = merge_into_bodies(&parts, &holes);
        let solids = solids(surface, edges, &bodies);
        let filled_holes =
            holes.iter().zip(&is_within_limits).filter(|(_, is_filled)| **is_filled).map(|(hole, _)| hole);
        let clearance = Clearance::new(&surface.positions, &surface.faces, filled_holes);
        let mut filler = Filler::new(self, surface, edges, clearance, context);
        let (mut closed, mut joined) = (0u64, 0u64);
        for of_body in by_body.chunk_by(|a, b| a.0 == b.0) {
            let solid = &solids[of_body[0].0 as usize];
            let of_body: Vec<(&Hole, bool)> = of_body.iter().map(|&(_, i)| (&holes[i], is_within_limits[i])).collect();
            let Some(body) = close_body(solid, &of_body, &mut filler)? else {
                filled.open_sheets += 1;
                continue;
            };
            filled.holes_left += body.left + body.over_limit;
            filled.over_limit += body.over_limit;
            filled.intersecting += body.intersecting;
            filled.unchecked += body.unchecked;
            closed += body.closed;
            joined += body.islands;
        }
        let patches = filler.clearance.patches().to_vec();
        let positions = filler.positions;
        filled.changes = Change::list([
            (ChangeKind::HolesClosed, closed),
            (ChangeKind::IslandsJoined, joined),
            (ChangeKind::FacesAdded, patches.len() as u64),
            (ChangeKind::VerticesAdded, (positions.len() - surface.positions.len()) as u64),
            (ChangeKind::HolesLeft, filled.holes_left),
            (ChangeKind::HolesOverLimit, filled.over_limit),
            (ChangeKind::OpenSheetsLeft, filled.open_sheets),
        ]);
        if !patches.is_empty() {
            let surface = Arc::make_mut(surface);
            surface.positions = positions;
            patches.into_iter().for_each(|face| surface.push_patch(face));
        }
        Ok(filled)
    }

    /// For each hole whether it is within the limits on edges, size and number.
    fn within_limits(&self, surface: &Surface, holes: &[Hole]) -> Vec<bool> {
        let diagonal = Box3::of_faces(&surface.positions, &surface.faces).diagonal();
        let small = |h: &Hole| self.max_size >= 1.0 || h.extent <= self.max_size * diagonal;
        let mut is_within_limits: Vec<bool> =
            holes.iter().map(|h| h.edges() <= self.max_edges as usize && small(h)).collect();
        let mut order: Vec<usize> = (0..holes.len()).filter(|&i| is_within_limits[i]).collect();
        if order.len() > self.max_holes as usize {
            order.sort_by(|&i, &j| holes[i].extent.total_cmp(&holes[j].extent).then(i.cmp(&j)));
            for &i in &order[self.max_holes as usize..] {
                is_within_limits[i] = false;
            }
        }
        is_within_limits
    }
}

/// Merges parts with a common hole into bodies; returns the bodies and the holes sorted by body.
fn merge_into_bodies(parts: &Parts, holes: &[Hole]) -> (Parts, Vec<(u32, usize)>) {
    let mut sets = UnionFind::new(parts.count);
    for hole in holes {
        for &part in &hole.parts[1..] {
            sets.unite(hole.parts[0], part);
        }
    }
    let roots = sets.into_roots();
    let of_face = parts.of_face.iter().map(|&p| if p == Parts::NONE { p } else { roots[p as usize] }).collect();
    let mut by_body: Vec<(u32, usize)> =
        holes.iter().enumerate().map(|(i, hole)| (roots[hole.parts[0] as usize], i)).collect();
    by_body.sort_unstable();
    (Parts { of_face, count: parts.count }, by_body)
}

/// Closes the holes of one body; each hole comes with whether it is within the limits. None if the body is an open sheet, whose holes
/// stay open.
fn close_body(
    solid: &Solid,
    holes: &[(&Hole, bool)],
    filler: &mut Filler<'_>,
) -> Result<Option<BodyPatches>, Cancelled> {
    if let [(hole, _)] = holes
        && filler.bounds_single_face(hole)
    {
        return Ok(None);
    }
    let start = (filler.clearance.patches().len(), filler.positions.len());
    let mut body = BodyPatches::default();
    let mut work: Vec<Hole> = Vec::new();
    for &(hole, is_within_limits) in holes.iter().rev() {
        if is_within_limits {
            work.push(hole.clone());
        } else {
            body.over_limit += hole.loops.len() as u64;
        }
    }
    body.close(work, filler)?;
    let (patch_area, volume) = with_patches(solid, filler, start.0);
    if encloses(solid.area, patch_area, (body.left + body.over_limit == 0).then_some(volume)) {
        return Ok(Some(body));
    }
    body.undo(start, filler);
    Ok(None)
}

/// The outcome for the holes of one body.
#[derive(Default)]
struct BodyPatches {
    /// Loops that were closed.
    closed: u64,
    /// The loops of islands among these.
    islands: u64,
    /// Loops that could not be closed, or only in part.
    left: u64,
    /// Loops over a limit.
    over_limit: u64,
    /// Patches that intersect a face.
    intersecting: u64,
    /// Patches that were not checked for intersections.
    unchecked: u64,
    /// Edges that the patches added.
    edges: Vec<(u32, u32)>,
}

impl BodyPatches {
    /// Fills holes, the last of `work` first.
    fn close(&mut self, mut work: Vec<Hole>, filler: &mut Filler<'_>) -> Result<(), Cancelled> {
        while let Some(hole) = work.pop() {
            filler.context.check()?;
            let Some(candidate) = filler.choose(&hole)? else {
                if hole.loops.len() > 1 {
                    // Islands that cannot be joined become separate holes.
                    work.extend(hole.split_loops());
                } else {
                    self.left += 1;
                }
                continue;
            };
            self.closed += hole.loops.len() as u64;
            self.islands += hole.loops.len() as u64 - 1;
            self.left += u64::from(candidate.open > 0);
            self.intersecting += u64::from(candidate.faults.is_some_and(|f| f.crossings > 0));
            self.unchecked += u64::from(candidate.faults.is_none());
            self.add(&candidate, filler);
        }
        Ok(())
    }

    /// Adds a patch to the surface.
    fn add(&mut self, candidate: &PatchCandidate, filler: &mut Filler<'_>) {
        for &[a, b, c] in &candidate.faces {
            for (u, v) in [(a, b), (b, c), (c, a)] {
                let edge = (u.min(v), u.max(v));
                if filler.edges.find(u, v).is_none() && filler.new_edges.insert(edge) {
                    self.edges.push(edge);
                }
            }
        }
        filler.clearance.add(&candidate.faces);
    }

    /// Removes all patches from face number `faces` and position number `positions` on.
    fn undo(self, (faces, positions): (usize, usize), filler: &mut Filler<'_>) {
        filler.clearance.truncate_patches(faces);
        filler.clearance.drop_vertices(positions);
        filler.positions.truncate(positions);
        for edge in self.edges {
            filler.new_edges.remove(&edge);
        }
    }
}

/// The area of the patches from face number `start` on, and the body's volume with these patches.
fn with_patches(body: &Solid, filler: &Filler<'_>, start: usize) -> (f64, f64) {
    let about = body.bounds.centre();
    let (mut patch_area, mut volume) = (0.0, body.volume);
    for t in &filler.clearance.patches()[start..] {
        let [a, b, c] = t.map(|v| filler.positions[v as usize] - about);
        patch_area += (b - a).cross(c - a).length() / 2.0;
        volume += a.dot(b.cross(c)) / 6.0;
    }
    (patch_area, volume)
}

impl Operation<'_> for FillHoles {
    const FIXES: &'static [Counter] = &[Counter::BoundaryEdges];
    // A crack whose border is collinear is closed with faces without area.
    const MAY_RAISE: &'static [Counter] = &[Counter::DegenerateFaces];
    const ACTS_ON: &'static [Counter] = &[Counter::BoundaryEdges];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        let options = scope.options;
        Self {
            max_edges: options.max_hole_edges,
            max_size: options.max_hole_size,
            max_holes: options.max_holes,
            filling: options.hole_filling,
            refine: options.refine_patches,
            fair: options.fair_patches,
            precision: scope.format.precision(),
        }
    }

    fn run_shared(
        &self,
        surface: &mut Arc<Surface>,
        edges: Arc<Edges>,
        context: &Context<'_>,
    ) -> Result<Applied, Cancelled> {
        let filled = self.apply_shared(surface, &edges, context)?;
        Ok(Applied { left: filled.unfixed_note(), changes: filled.changes, ..Applied::default() })
    }
}
