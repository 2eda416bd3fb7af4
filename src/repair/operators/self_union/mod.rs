//! Self-union: replaces intersecting faces by the boundary of the volume that they enclose.
//!
//! This file holds the entry points for a whole surface and for separate parts; `rounds.rs` holds the rounds of arranging,
//! rounding and snapping.

mod rounds;

use crate::arrange::{ArrangeError, Arrangement, Exact};
use crate::mesh::{ClosedSurface, Edges, Parts, Surface, is_generated};
use crate::repair::operators::operator::{Applied, Counter, Operation, Scope};
use crate::repair::operators::thicken::THICKNESS;
use crate::repair::{Cancelled, Change, ChangeKind, Context, Overlaps, WindingRuleChoice};
pub use rounds::SelfUnionRounds;
pub(super) use rounds::is_manifold_by_position;
use rounds::{MAX_PIECES_PER_FACE, Rounds, Totals, append, count, crossings, dense_faces, grid_step, index, snap};

/// Grid resolution in bits for dense clusters of intersections, which are snapped first. A thousand faces through one point
/// would otherwise be split into more pieces than there are positions.
const DENSE_GRID: i32 = 10;

/// The number of intersecting pairs above which the surface counts as tangled: each pair splits off one piece at least, and
/// mostly two.
const TANGLED_PAIRS: u64 = 500_000;

/// The result of a self-union.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Resolved {
    /// The changes with their counts.
    pub changes: Vec<Change>,
    /// The largest vertex displacement, in the model's unit.
    pub moved: f64,
    /// The number of face pairs that still intersect.
    pub pairs_left: u64,
    /// Why the surface is unchanged.
    pub error: Option<ArrangeError>,
}

/// Whether so many pairs of faces intersect that an arrangement would be too large to finish in minutes.
fn is_tangled(pairs: u64, surface: &Surface) -> bool {
    pairs > TANGLED_PAIRS.max(MAX_PIECES_PER_FACE as u64 * surface.faces.len() as u64 / 2)
}

impl SelfUnionRounds {
    /// Replaces intersecting faces by the boundary of the enclosed volume: overlapping parts are united, internal faces go.
    ///
    /// ```text
    ///    +-----+              +-----+
    ///    |  +--|--+           |     +--+
    ///    +--|--+  |    ->     +--+     |
    ///       +-----+              +-----+
    /// ```
    ///
    /// Precondition: closed and consistently wound. Result: no two faces intersect. New vertices are rounded to f32 one by
    /// one without making faces meet (`rounding.rs`). Where faces then intersect again, their vertices snap to ever
    /// coarser grids and the arrangement is computed again (after the snap rounding of Valque and Lazard).
    /// Leaves: the input surface where it is not closed, where nothing intersects or is there twice and no region is opened,
    /// or where the arrangement fails; pairs that still intersect after the coarsest grid.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply(
        &self,
        surface: &mut Surface,
        engine: &dyn Arrangement,
        context: &Context<'_>,
    ) -> Result<Resolved, Cancelled> {
        let undone = |pairs_left, error| Resolved { pairs_left, error: Some(error), ..Resolved::default() };
        let edges = Edges::new(&surface.faces);
        if let Err(open) = ClosedSurface::new(surface, &edges) {
            return Ok(undone(0, open.into()));
        }
        let searched = crossings(surface, None, context)?;
        let before = count(&searched.intersections);
        // Without intersections, one part may still enclose another because its holes were filled.
        let may_open = self.sheets.is_some() && surface.source.iter().any(|&source| is_generated(source));
        let always = self.always || (before == 0 && searched.has_faces_twice());
        if before == 0 && !may_open && !always {
            return Ok(Resolved::default());
        }
        let faces_before = surface.faces.len() as u64;
        let parts = |surface: &Surface, edges: &Edges| Parts::new(surface, edges).count as u64;
        let parts_before = parts(surface, &edges);
        let mut done = Totals::default();
        let mut work = surface.clone();
        let mut pairs = before;
        if let Some(dense) = dense_faces(&searched.intersections) {
            let step = grid_step(&work, DENSE_GRID);
            if step <= self.max_deviation {
                (done.snapped, done.moved) = snap(&mut work, &dense, step);
                if is_tangled(before, &work) {
                    pairs = count(&crossings(&work, Some(&searched), context)?.intersections);
                }
            }
        }
        if is_tangled(pairs, &work) {
            return Ok(undone(before, ArrangeError::Tangled(pairs)));
        }
        let mut rounds = Rounds::new(self, done, engine, context, searched);
        let best = match rounds.run(work) {
            Ok(best) => best,
            Err(ArrangeError::Cancelled(stop)) => return Err(stop),
            Err(error) => return Ok(undone(before, error)),
        };
        let done = rounds.totals;
        if before == 0 && done.opened == 0 && (!always || have_same_faces(surface, &best.surface)) {
            return Ok(Resolved::default());
        }
        // An incomplete result must at least be closed; intersecting faces are the lesser defect.
        if best.pairs > 0 && !is_manifold_by_position(&best.surface) {
            let error = "rounding left intersecting faces and non-manifold edges";
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
        Ok(Resolved { changes, moved: done.moved + best.perturbed, pairs_left: best.pairs, error: None })
    }

    /// Computes the self-union of each part alone. A part whose union would be empty, such as a cavity, stays as it is.
    /// Intersections between parts stay and are counted in `pairs_left`.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply_to_parts(
        &self,
        surface: &mut Surface,
        engine: &dyn Arrangement,
        context: &Context<'_>,
    ) -> Result<Resolved, Cancelled> {
        let parts = Parts::new(surface, &Edges::new(&surface.faces));
        let mut whole = Surface::default();
        let (mut all, mut cut, mut created) = (Resolved::default(), 0, 0);
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
            let done = self.apply(&mut part, engine, context)?;
            all.moved = all.moved.max(done.moved);
            if !done.changes.is_empty() {
                (cut, created) = (cut + before, created + part.faces.len() as u64);
            }
            append(&mut whole, part);
        }
        all.changes = Change::list([(ChangeKind::FacesCut, cut), (ChangeKind::FacesCreated, created)]);
        if cut > 0 {
            *surface = whole;
        }
        all.pairs_left = count(&crossings(surface, None, context)?.intersections);
        Ok(all)
    }
}

/// Whether two surfaces have faces with the same corners and the same winding.
fn have_same_faces(one: &Surface, other: &Surface) -> bool {
    let faces = |surface: &Surface| {
        let mut faces: Vec<_> = (0..surface.faces.len()).map(|f| surface.face_key(f)).collect();
        faces.sort_unstable();
        faces
    };
    one.faces.len() == other.faces.len() && faces(one) == faces(other)
}

/// Unites overlapping volumes; with `overlaps` set to keep, computes the union of each part alone.
#[derive(Debug, Clone, Copy)]
pub struct SelfUnion {
    rounds: SelfUnionRounds,
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
        let rounds = SelfUnionRounds {
            winding_rule: scope.winding_rule,
            max_deviation: scope.max_deviation,
            sheets: scope.closes_sheets.then(thickness),
            always: options.winding_rule != WindingRuleChoice::Auto,
        };
        Self { rounds, overlaps: options.overlaps }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let result = match self.overlaps {
            Overlaps::Union => self.rounds.apply(surface, &Exact, context)?,
            Overlaps::Keep => self.rounds.apply_to_parts(surface, &Exact, context)?,
        };
        let left = (result.pairs_left > 0).then(|| format!("{} pairs of faces still intersect", result.pairs_left));
        let failed = result.error.map(Into::into);
        Ok(Applied { changes: result.changes, moved: result.moved, left, failed, ..Applied::default() })
    }
}
