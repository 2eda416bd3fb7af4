//! Intersections resolved, and kept resolved after rounding.

mod rounds;

use crate::arrange::{ArrangeError, Arrangement, Exact};
use crate::mesh::{ClosedSurface, Edges, Parts, Surface, is_made, position_key};
use crate::repair::operators::operator::{Applied, Counter, Operation, Scope};
use crate::repair::operators::thicken::THICKNESS;
use crate::repair::{Cancelled, Change, ChangeKind, Context, Overlaps, WindingRuleChoice};
pub use rounds::SelfUnionRounds;
use rounds::{
    Done, Rounds, TANGLE_A_FACE, append, count, crossings, dense_faces, grid_step, index, is_manifold_by_position, snap,
};

/// Bits of the grid to which dense clusters of intersections are moved before all else: a thousand faces through one point would
/// be cut into more pieces than there are positions for.
const DENSE_GRID: i32 = 10;

/// Pairs of faces that intersect from which on it is a tangle for sure: each pair cuts at least one piece off, and mostly two.
const TANGLED_PAIRS: u64 = 500_000;
/// What became of the intersections.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Resolved {
    /// What changed.
    pub changes: Vec<Change>,
    /// The farthest that a vertex was moved.
    pub moved: f64,
    /// Pairs of faces that still intersect.
    pub pairs_left: u64,
    /// Why nothing was done.
    pub error: Option<ArrangeError>,
}

/// Whether so many pairs of faces intersect that cutting them would make a tangle, and take minutes to find that out.
fn is_tangled(pairs: u64, surface: &Surface) -> bool {
    pairs > TANGLED_PAIRS.max(TANGLE_A_FACE as u64 * surface.faces.len() as u64 / 2)
}

impl SelfUnionRounds {
    /// Resolves faces that intersect into the boundary of what they enclose: overlapping parts are united, walls inside go.
    ///
    /// ```text
    ///    +-----+              +-----+
    ///    |  +--|--+           |     +--+
    ///    +--|--+  |    ->     +--+     |
    ///       +-----+              +-----+
    /// ```
    ///
    /// Precondition: closed and consistently wound. Result: no two faces intersect. New vertices are rounded to f32 one by one so
    /// that no faces come to meet (`rounding.rs`); where that can't be done and faces intersect again, their vertices are
    /// moved to ever coarser grids and the arrangement is made again (after the snap rounding of Valque and Lazard).
    /// Leaves: the surface as it was where it is not closed, nothing intersects and no room is open, or the arrangement fails;
    /// pairs that stay after the coarsest grid.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply(
        &self,
        surface: &mut Surface,
        by: &dyn Arrangement,
        context: &Context<'_>,
    ) -> Result<Resolved, Cancelled> {
        let undone = |pairs_left, error| Resolved { pairs_left, error: Some(error), ..Resolved::default() };
        let edges = Edges::new(&surface.faces);
        if let Err(open) = ClosedSurface::new(surface, &edges) {
            return Ok(undone(0, open.into()));
        }
        let found = crossings(surface, context)?;
        let before = count(&found);
        // Where nothing intersects, a part may still be walled in by another whose holes were closed.
        let may_open = self.sheets.is_some() && surface.source.iter().any(|&source| is_made(source));
        if before == 0 && !may_open && !self.always {
            return Ok(Resolved::default());
        }
        let faces_before = surface.faces.len() as u64;
        let parts = |surface: &Surface, edges: &Edges| Parts::new(surface, edges).count as u64;
        let parts_before = parts(surface, &edges);
        let mut done = Done::default();
        let mut work = surface.clone();
        let mut pairs = before;
        if let Some(dense) = dense_faces(&found) {
            let step = grid_step(&work, DENSE_GRID);
            if step <= self.max_deviation {
                (done.snapped, done.moved) = snap(&mut work, &dense, step);
                pairs = if is_tangled(before, &work) { count(&crossings(&work, context)?) } else { before };
            }
        }
        if is_tangled(pairs, &work) {
            let error = format!("{pairs} pairs of them do, too many to be cut apart");
            return Ok(undone(before, ArrangeError::Failed(error)));
        }
        let mut rounds = Rounds::new(self, done, by, context);
        let best = match rounds.run(work) {
            Ok(best) => best,
            Err(ArrangeError::Cancelled(stop)) => return Err(stop),
            Err(error) => return Ok(undone(before, error)),
        };
        let done = rounds.done;
        if before == 0 && done.opened == 0 && (!self.always || have_same_faces(surface, &best.surface)) {
            return Ok(Resolved::default());
        }
        // Half done it must at least be closed: faces that intersect are the lesser evil.
        if best.pairs > 0 && !is_manifold_by_position(&best.surface) {
            let error = "rounding left faces that intersect and edges of more than two faces";
            return Ok(undone(before, ArrangeError::Failed(error.to_owned())));
        }
        *surface = best.surface;
        let changes = Change::list([
            (ChangeKind::PartsUnited, parts_before.saturating_sub(parts(surface, &Edges::new(&surface.faces)))),
            (ChangeKind::IntersectingPairsResolved, before.saturating_sub(best.pairs)),
            (ChangeKind::FacesCut, faces_before),
            (ChangeKind::FacesCreated, surface.faces.len() as u64),
            (ChangeKind::VerticesSnapped, done.snapped),
            (ChangeKind::VerticesMerged, done.merged),
            (ChangeKind::FacesWithoutThicknessThickened, done.thickened),
            (ChangeKind::FacesAroundOpenRegionsThickened, done.opened),
        ]);
        Ok(Resolved { changes, moved: done.moved + best.aside, pairs_left: best.pairs, error: None })
    }

    /// Resolves each part by itself, and leaves it as it is where nothing would be left of it, as of a cavity. What parts have
    /// in common stays, and is counted in `pairs_left`.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply_to_parts(
        &self,
        surface: &mut Surface,
        by: &dyn Arrangement,
        context: &Context<'_>,
    ) -> Result<Resolved, Cancelled> {
        let parts = Parts::new(surface, &Edges::new(&surface.faces));
        let mut whole = Surface::default();
        let (mut all, mut cut, mut made) = (Resolved::default(), 0, 0);
        let mut local = vec![u32::MAX; surface.positions.len()];
        for faces in parts.faces() {
            let mut part = Surface::default();
            for &f in &faces {
                let face = surface.faces[f as usize].map(|v| {
                    let local = &mut local[v as usize];
                    if *local == u32::MAX {
                        *local = index(part.positions.len());
                        part.positions.push(surface.positions[v as usize]);
                    }
                    *local
                });
                part.faces.push(face);
                part.source.push(surface.source[f as usize]);
            }
            for &v in faces.iter().flat_map(|&f| &surface.faces[f as usize]) {
                local[v as usize] = u32::MAX;
            }
            let before = part.faces.len() as u64;
            let done = self.apply(&mut part, by, context)?;
            all.moved = all.moved.max(done.moved);
            if !done.changes.is_empty() {
                (cut, made) = (cut + before, made + part.faces.len() as u64);
            }
            append(&mut whole, part);
        }
        all.changes = Change::list([(ChangeKind::FacesCut, cut), (ChangeKind::FacesCreated, made)]);
        if cut > 0 {
            *surface = whole;
        }
        all.pairs_left = count(&crossings(surface, context)?);
        Ok(all)
    }
}

/// Whether two surfaces have faces with the same corners, turned the same way.
fn have_same_faces(one: &Surface, other: &Surface) -> bool {
    let faces = |surface: &Surface| {
        let mut faces: Vec<[[u64; 3]; 3]> = (0..surface.faces.len())
            .map(|f| {
                let mut keys = surface.corners(f).map(position_key);
                let first = (0..3).min_by_key(|&i| keys[i]).unwrap_or(0);
                keys.rotate_left(first);
                keys
            })
            .collect();
        faces.sort_unstable();
        faces
    };
    one.faces.len() == other.faces.len() && faces(one) == faces(other)
}

/// Unites what overlaps, or resolves each part alone where parts are to be kept apart.
#[derive(Debug, Clone, Copy)]
pub struct SelfUnion {
    resolve: SelfUnionRounds,
    overlaps: Overlaps,
}

impl Operation for SelfUnion {
    const FIXES: &'static [Counter] = &[Counter::NonManifoldEdges];
    const MAY_RAISE: &'static [Counter] = &[
        Counter::BoundaryEdges,
        Counter::MisorientedEdges,
        Counter::PinchedVertices,
        Counter::DegenerateFaces,
        Counter::DuplicateFaces,
    ];

    fn with_scope(scope: &Scope<'_>, surface: &Surface) -> Self {
        let options = scope.options;
        let thickness =
            || options.thickness.unwrap_or(THICKNESS * surface.bounds().diagonal()).min(scope.max_deviation);
        let resolve = SelfUnionRounds {
            winding_rule: scope.winding_rule,
            max_deviation: scope.max_deviation,
            sheets: scope.closes_sheets.then(thickness),
            always: options.winding_rule != WindingRuleChoice::Auto,
        };
        Self { resolve, overlaps: options.overlaps }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let it = match self.overlaps {
            Overlaps::Union => self.resolve.apply(surface, &Exact, context)?,
            Overlaps::Keep => self.resolve.apply_to_parts(surface, &Exact, context)?,
        };
        let left = (it.pairs_left > 0).then(|| format!("{} pairs of faces still intersect", it.pairs_left));
        let failed = it.error.map(Into::into);
        Ok(Applied { changes: it.changes, moved: it.moved, left, failed, ..Applied::default() })
    }
}
