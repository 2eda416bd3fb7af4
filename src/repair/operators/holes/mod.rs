//! Closing boundary loops.

mod choose;
mod clearance;
mod fair;
mod group;
mod least_weight;
mod planar;
mod refine;
mod sharp;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{Applied, Counter, Operation, Scope};
use crate::inspect::solids;
use crate::math::{Box3, Precision};
use crate::mesh::{Edges, Fans, Parts, Surface, UnionFind, boundary_loops};
use crate::repair::sheets::encloses;
use crate::repair::{Cancelled, Change, ChangeKind, Context};
use choose::{Chosen, Filler, face_normal};
use group::{Hole, group};

/// How the triangles of a hole's patch are chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, ToSchema, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum HoleFilling {
    /// The first that intersects nothing of: least fold, planar, least area, sharp.
    #[default]
    Auto,
    /// The least fold against the faces around and within the patch (Liepa 2003).
    Smooth,
    /// Constrained Delaunay in the hole's best plane; where its picture there is not simple, the least area.
    Planar,
    /// The sharpest corner first, never by a face that would intersect another (Mesh Heal's *fill holes (sharp)*).
    Sharp,
}

/// Which holes are closed, and how.
#[derive(Debug, Clone, Copy)]
pub struct FillHoles {
    /// Most edges around a hole, those around islands in it counted; a million by default.
    pub max_edges: u32,
    /// Largest extent of a hole, as a share of the model's diagonal; 1, which is any, by default.
    pub max_size: f64,
    /// Most holes; of more the smallest are closed. A million by default.
    pub max_holes: u32,
    /// How patches are chosen.
    pub filling: HoleFilling,
    /// Whether patches that are not plane get inner vertices, as close as those around.
    pub refine: bool,
    /// Whether patches are refined and go on smoothly from the surface.
    pub fair: bool,
    /// Whether new positions are rounded to f32.
    pub precision: Precision,
}

impl Default for FillHoles {
    fn default() -> Self {
        Self {
            max_edges: 1_000_000,
            max_size: 1.0,
            max_holes: 1_000_000,
            filling: HoleFilling::Auto,
            refine: false,
            fair: false,
            precision: Precision::F64,
        }
    }
}

/// What filling did and left.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Filled {
    /// By operator.
    pub changes: Vec<Change>,
    /// Loops that are still open in parts that were not taken for sheets.
    pub holes_left: u64,
    /// Of these, over a limit in edges, size or number.
    pub over_limit: u64,
    /// Boundary edges in no loop, since the winding around them disagrees or they meet in a non-manifold edge.
    pub unwalked_edges: u64,
    /// Parts that were taken for open sheets and left open.
    pub open_sheets: u64,
    /// Patches that intersect something, every other way being worse.
    pub intersecting: u64,
    /// Patches that were not looked at, since the search took all the steps that it may.
    pub unchecked: u64,
}

impl Filled {
    /// What is left, if anything.
    pub(super) fn in_words(&self) -> Option<String> {
        let mut words = Vec::new();
        let mut say = |count: u64, what: &str| {
            if count > 0 {
                words.push(format!("{count} {what}"));
            }
        };
        say(self.over_limit, "holes are over the limits in edges, size or number and were left open");
        say(self.holes_left - self.over_limit, "holes could not be closed");
        say(self.unwalked_edges, "open edges form no loop");
        say(self.open_sheets, "parts are open sheets that enclose nothing; they were left open");
        say(self.intersecting, "patches intersect other faces, as every other way that was tried does");
        say(self.unchecked, "patches were not checked against other faces, which would have taken too long");
        (!words.is_empty()).then(|| words.join("; "))
    }
}

impl FillHoles {
    /// Closes boundary loops with triangles over their own vertices.
    ///
    /// Candidates are made in order of beauty and the first without a fault is taken, or that with the fewest: a fault is
    /// a pair of faces that intersect, decided exactly against the surface, the patch itself and the patches before
    /// it, or a face without area. The candidates are the triangulation of least worst fold (Liepa 2003), the constrained
    /// Delaunay triangulation in the hole's plane, the one of least area, and growth from the sharpest corners; over 128
    /// edges the second, the fourth, and pieces cut by short chords. A hole that lies in a plane gets its plane patch
    /// first, without overlap and without faces on a line. A diagonal is never an edge that is there already, so
    /// that no edge gets a third face. A loop within another, near its plane and running against it, bounds an island:
    /// both get one patch, and the island is joined. All loops of a body (parts that islands join) are closed or none:
    /// see [`encloses`] for what tells a solid with holes from an open sheet. Where a loop cannot be closed the others of
    /// its body still are, if their patches are small beside it: what is open shrinks, and the rest can be told.
    ///
    /// ```text
    ///    ___________          ___________
    ///   |   /   \   |        |   / | \   |
    ///   |  |     |  |   ->   |  |  |/ |  |
    ///   |   \___/   |        |   \_|_/   |
    /// ```
    ///
    /// Precondition: consistent winding, or walks along the boundary end and are left. Result: no vertex moves and no
    /// face goes. Where every triangulation needs an edge that exists, a cone over a new vertex closes the hole. Leaves:
    /// loops over the limits, those of open sheets, what a sharp patch could not reach.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Filled, Cancelled> {
        let edges = Edges::new(&surface.faces);
        if edges.iter().all(|h| h.len() != 1) {
            return Ok(Filled::default());
        }
        let fans = Fans::new(surface, &edges);
        let parts = Parts::new(surface, &edges);
        let loops = boundary_loops(surface, &edges, &fans);
        let mut filled = Filled { unwalked_edges: loops.left, ..Filled::default() };
        let of_edge = |a, b| face_normal(&surface.positions, &surface.faces, &edges, a, b);
        let holes = group(&surface.positions, loops, &parts, of_edge);
        context.check()?;
        let within = self.within_limits(surface, &holes);
        let (bodies, by_body) = bodies(&parts, &holes);
        let solids = solids(surface, &edges, &bodies);
        let mut filler = Filler::new(self, surface.positions.clone(), &surface.faces, &edges, context);
        let (mut closed, mut joined) = (0u64, 0u64);
        for of_body in by_body.chunk_by(|a, b| a.0 == b.0) {
            let solid = &solids[of_body[0].0 as usize];
            let start = (filler.clearance.patches().len(), filler.positions.len());
            let (mut left, mut over, mut intersecting, mut unchecked, mut islands) = (0u64, 0u64, 0u64, 0u64, 0u64);
            let mut own_edges: Vec<(u32, u32)> = Vec::new();
            let mut work: Vec<Hole> = Vec::new();
            for &(_, i) in of_body.iter().rev() {
                if within[i] {
                    work.push(holes[i].clone());
                } else {
                    over += holes[i].loops.len() as u64;
                }
            }
            let mut done = 0u64;
            while let Some(hole) = work.pop() {
                context.check()?;
                let Some(chosen) = filler.choose(&hole)? else {
                    if hole.loops.len() > 1 {
                        // Islands that cannot be joined are holes of their own.
                        work.extend(hole.apart());
                    } else {
                        left += 1;
                    }
                    continue;
                };
                done += hole.loops.len() as u64;
                islands += hole.loops.len() as u64 - 1;
                left += u64::from(chosen.open > 0);
                intersecting += u64::from(chosen.faults.is_some_and(|f| f.crossings > 0));
                unchecked += u64::from(chosen.faults.is_none());
                put(&mut filler, &chosen, &mut own_edges);
            }
            let about = solid.bounds.centre();
            let (mut patch_area, mut volume) = (0.0, solid.volume);
            for t in &filler.clearance.patches()[start.0..] {
                let [a, b, c] = t.map(|v| filler.positions[v as usize] - about);
                patch_area += (b - a).cross(c - a).length() / 2.0;
                volume += a.dot(b.cross(c)) / 6.0;
            }
            if encloses(solid.area, patch_area, (left + over == 0).then_some(volume)) {
                filled.holes_left += left + over;
                filled.over_limit += over;
                filled.intersecting += intersecting;
                filled.unchecked += unchecked;
                closed += done;
                joined += islands;
            } else {
                filler.clearance.take_out(start.0);
                filler.clearance.drop_vertices(start.1);
                filler.positions.truncate(start.1);
                for edge in own_edges {
                    filler.new_edges.remove(&edge);
                }
                filled.open_sheets += 1;
            }
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
        surface.positions = positions;
        for face in patches {
            surface.push_patch(face);
        }
        Ok(filled)
    }

    /// For each hole whether it is within the limits.
    fn within_limits(&self, surface: &Surface, holes: &[Hole]) -> Vec<bool> {
        let diagonal = Box3::of(surface.faces.iter().flatten().map(|&v| surface.positions[v as usize])).diagonal();
        let small = |h: &Hole| self.max_size >= 1.0 || h.extent <= self.max_size * diagonal;
        let mut within: Vec<bool> = holes.iter().map(|h| h.edges() <= self.max_edges as usize && small(h)).collect();
        let mut order: Vec<usize> = (0..holes.len()).filter(|&i| within[i]).collect();
        if order.len() > self.max_holes as usize {
            order.sort_by(|&i, &j| holes[i].extent.total_cmp(&holes[j].extent).then(i.cmp(&j)));
            for &i in &order[self.max_holes as usize..] {
                within[i] = false;
            }
        }
        within
    }
}

/// The parts, those that one hole joins as one, and the holes by body.
fn bodies(parts: &Parts, holes: &[Hole]) -> (Parts, Vec<(u32, usize)>) {
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

/// Takes a patch over.
fn put(filler: &mut Filler<'_>, chosen: &Chosen, own_edges: &mut Vec<(u32, u32)>) {
    for &[a, b, c] in &chosen.faces {
        for (u, v) in [(a, b), (b, c), (c, a)] {
            let edge = (u.min(v), u.max(v));
            if filler.edges.find(u, v).is_none() && filler.new_edges.insert(edge) {
                own_edges.push(edge);
            }
        }
    }
    filler.clearance.put(&chosen.faces);
}

impl Operation for FillHoles {
    const FIXES: &'static [Counter] = &[Counter::BoundaryEdges];
    // A crack whose border lies on a line is closed by faces without area.
    const MAY_RAISE: &'static [Counter] = &[Counter::DegenerateFaces];

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

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let filled = self.apply(surface, context)?;
        Ok(Applied { left: filled.in_words(), changes: filled.changes, ..Applied::default() })
    }
}
