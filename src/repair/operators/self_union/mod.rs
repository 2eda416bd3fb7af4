//! Self-union: replaces intersecting faces by the boundary of the volume that they enclose.
//!
//! This file holds the entry points for a whole surface and for separate parts. `rounds.rs` holds the rounds of arranging,
//! rounding and snapping (`snap.rs`), and `residue.rs` removes or joins what they leave.

mod residue;
mod rounds;
mod snap;

use std::cmp::Ordering;
use std::hash::BuildHasher;
use std::sync::Arc;

use rustc_hash::FxBuildHasher;

use crate::arrange::{ArrangeError, Arrangement, Exact};
use crate::inspect::{Analysis, SearchedMesh};
use crate::math::threads;
use crate::mesh::{ClosedSurface, Edges, Parts, Surface, is_generated};
use crate::repair::operators::operator::{Applied, Counter, Operation, Scope};
use crate::repair::operators::thicken::THICKNESS;
use crate::repair::{Cancelled, Change, ChangeKind, Context, Overlaps, WindingRuleChoice};
pub use rounds::SelfUnionRounds;
pub(super) use rounds::is_manifold_by_position;
use rounds::{Best, MAX_PIECES_PER_FACE, Rounds, Totals, count, crossings};
use snap::{Dense, grid_step, snap};

/// Grid resolutions in bits for dense clusters of intersections, which are snapped first. The finest on which the surface
/// splits into few enough pieces is used.
const DENSE_GRIDS: [i32; 4] = [16, 14, 12, 10];

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
    /// The mesh of the last search for intersecting faces, if most of its faces are new.
    pub searched: Option<Arc<SearchedMesh>>,
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
    /// Closed pieces thinner than that rounding are removed, and a few places that still touch are joined by tiny solids.
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
        let (resolved, united) = self.united(None, with_edges(surface), engine, context)?;
        if let Some(united) = united {
            *surface = united;
        }
        Ok(resolved)
    }

    /// The result of [`Self::apply`] with `always`, and without `sheets`, but without its counts. None if the surface is not closed, the
    /// arrangement fails, or faces still intersect.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub fn boundary(
        &self,
        surface: &Surface,
        engine: &dyn Arrangement,
        context: &Context<'_>,
    ) -> Result<Option<Surface>, Cancelled> {
        let edges = Edges::new(&surface.faces);
        let Ok(closed) = ClosedSurface::new(surface, &edges) else { return Ok(None) };
        let searched = crossings(surface, None, context)?;
        let has_cause = count(&searched.intersections) > 0;
        drop(edges);
        match (Uniting { settings: self, input: None, engine, context }).unite(closed, searched) {
            Ok(United { best, .. }) if best.pairs == 0 => {
                let is_same = !has_cause && ReplacedFaces::between(surface, &best.surface).are_none();
                Ok(Some(if is_same { surface.clone() } else { best.surface }))
            }
            Err(ArrangeError::Cancelled(stop)) => Err(stop),
            Ok(_) | Err(_) => Ok(None),
        }
    }

    /// [`Self::apply`] for a surface that has faces of `input`, whose intersections are known. Returns the new surface, or none if the
    /// surface stays as it is.
    fn united(
        &self,
        input: Option<&Analysis<'_>>,
        (surface, edges): (&Surface, Arc<Edges>),
        engine: &dyn Arrangement,
        context: &Context<'_>,
    ) -> Result<(Resolved, Option<Surface>), Cancelled> {
        let undone = |pairs_left, error| (Resolved { pairs_left, error: Some(error), ..Resolved::default() }, None);
        let unchanged = || Ok((Resolved::default(), None));
        let closed = match ClosedSurface::new(surface, &edges) {
            Ok(closed) => closed,
            Err(open) => return Ok(undone(0, open.into())),
        };
        let searched = crossings(surface, input.and_then(Analysis::known_intersections), context)?;
        let before = count(&searched.intersections);
        // Without intersections, one part may still enclose another because its holes were filled.
        let may_open = self.sheets.is_some() && surface.source.iter().any(|&source| is_generated(source));
        let always = self.always || (before == 0 && searched.has_faces_twice());
        if before == 0 && !may_open && !always {
            return unchanged();
        }
        let parts = |surface: &Surface, edges: &Edges| Parts::new(surface, edges).count as u64;
        let parts_before = parts(surface, &edges);
        drop(edges);
        let United { best, totals: done, searched } =
            match (Uniting { settings: self, input, engine, context }).unite(closed, searched) {
                Ok(united) => united,
                Err(ArrangeError::Cancelled(stop)) => return Err(stop),
                Err(error) => return Ok(undone(before, error)),
            };
        let has_cause = before > 0 || done.opened > 0;
        if !has_cause && !always {
            return unchanged();
        }
        let replaced = ReplacedFaces::between(surface, &best.surface);
        if !has_cause && replaced.are_none() {
            return unchanged();
        }
        // An incomplete result must at least be closed; intersecting faces are the lesser defect.
        if best.pairs > 0 && !is_manifold_by_position(&best.surface) {
            let error = "rounding left intersecting faces and non-manifold edges";
            return Ok(undone(before, ArrangeError::Failed(error.to_owned())));
        }
        let united = best.surface;
        let changes = Change::list([
            (ChangeKind::PartsUnited, parts_before.saturating_sub(parts(&united, &Edges::new(&united.faces)))),
            (ChangeKind::IntersectingPairsResolved, before.saturating_sub(best.pairs)),
            (ChangeKind::FacesCut, replaced.cut),
            (ChangeKind::FacesRemoved, replaced.removed),
            (ChangeKind::FacesCreated, replaced.created),
            (ChangeKind::VerticesSnapped, done.snapped),
            (ChangeKind::VerticesMerged, done.merged),
            (ChangeKind::CrumbsRemoved, done.crumbs),
            (ChangeKind::ContactsJoined, done.plugs),
            (ChangeKind::FacesWithoutThicknessThickened, done.thickened),
            (ChangeKind::FacesAroundOpenRegionsThickened, done.opened),
        ]);
        let searched = Some(searched).filter(|searched| searched.is_mostly_new).map(Arc::new);
        let moved = done.moved + best.perturbed;
        Ok((Resolved { changes, moved, pairs_left: best.pairs, error: None, searched }, Some(united)))
    }

    /// Computes the self-union of each part alone. A part whose union would be empty, such as a cavity, stays as it is.
    /// Intersections between parts stay and are counted in `pairs_left`.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    fn parts_united(
        &self,
        input: &Analysis<'_>,
        surface: &Surface,
        engine: &dyn Arrangement,
        context: &Context<'_>,
    ) -> Result<(Resolved, Option<Surface>), Cancelled> {
        let parts = Parts::new(surface, &Edges::new(&surface.faces));
        let mut whole = Surface::default();
        let (mut all, mut has_changed) = (Resolved::default(), false);
        let mut local = vec![u32::MAX; surface.positions.len()];
        for faces in parts.faces() {
            let mut part = Surface::default();
            for &f in &faces {
                let face = surface.faces[f as usize].map(|v| {
                    let local = &mut local[v as usize];
                    if *local == u32::MAX {
                        #[expect(clippy::cast_possible_truncation, reason = "vertices are counted in u32")]
                        {
                            *local = part.positions.len() as u32;
                        }
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
            let (done, united) = self.united(Some(input), with_edges(&part), engine, context)?;
            all.moved = all.moved.max(done.moved);
            has_changed |= !done.changes.is_empty();
            whole.append(united.unwrap_or(part));
        }
        if has_changed {
            let ReplacedFaces { cut, removed, created } = ReplacedFaces::between(surface, &whole);
            all.changes = Change::list([
                (ChangeKind::FacesCut, cut),
                (ChangeKind::FacesRemoved, removed),
                (ChangeKind::FacesCreated, created),
            ]);
        }
        let whole = Some(whole).filter(|_| has_changed);
        let result = whole.as_ref().unwrap_or(surface);
        all.pairs_left = count(&crossings(result, input.known_intersections(), context)?.intersections);
        Ok((all, whole))
    }
}

/// The result of a union.
struct United {
    /// The best result of its rounds.
    best: Best,
    /// The counts of the rounds.
    totals: Totals,
    /// The mesh that was searched last.
    searched: SearchedMesh,
}

/// The ways to unite a surface whose faces intersect: as it is, or with its dense clusters snapped to a grid.
#[derive(Clone, Copy)]
struct Uniting<'a> {
    settings: &'a SelfUnionRounds,
    /// The input, whose intersections are known.
    input: Option<&'a Analysis<'a>>,
    engine: &'a dyn Arrangement,
    context: &'a Context<'a>,
}

impl Uniting<'_> {
    /// The best result of the way that suits the surface.
    fn unite(self, surface: ClosedSurface<'_>, searched: SearchedMesh) -> Result<United, ArrangeError> {
        let Some(dense) = Dense::of(&surface, &searched.intersections) else {
            return self.in_rounds(surface, Totals::default(), searched, false);
        };
        if dense.needs_snapping {
            return self.unite_snapped(&surface, &dense, searched);
        }
        match self.in_rounds(surface, Totals::default(), searched, true) {
            united @ (Ok(_) | Err(ArrangeError::Cancelled(_))) => united,
            Err(_) => {
                let known = self.input.and_then(Analysis::known_intersections);
                self.unite_snapped(&surface, &dense, crossings(&surface, known, self.context)?)
            }
        }
    }

    /// The best result after snapping dense clusters to the finest grid that suffices.
    fn unite_snapped(self, surface: &Surface, dense: &Dense, searched: SearchedMesh) -> Result<United, ArrangeError> {
        let (mut totals, mut work, mut found) = (Totals::default(), surface.clone(), None);
        for step in DENSE_GRIDS.map(|bits| grid_step(surface, bits)) {
            if step > self.settings.max_deviation {
                break;
            }
            work.clone_from(surface);
            (totals.snapped, totals.moved) = snap(&mut work, &dense.faces, step);
            let snapped = crossings(&work, searched.known_intersections(), self.context)?;
            let is_loose = Dense::of(&work, &snapped.intersections).is_none();
            found = Some(snapped);
            if is_loose {
                break;
            }
        }
        self.in_rounds(ClosedSurface::try_from(&work)?, totals, found.unwrap_or(searched), false)
    }

    /// Runs the rounds, unless too many faces intersect. A trial ends after the first round if that left many pairs.
    fn in_rounds(
        self,
        work: ClosedSurface<'_>,
        totals: Totals,
        searched: SearchedMesh,
        is_trial: bool,
    ) -> Result<United, ArrangeError> {
        let pairs = count(&searched.intersections);
        if is_tangled(pairs, &work) {
            return Err(ArrangeError::Tangled(pairs));
        }
        let mut rounds = Rounds::new(self.settings, totals, self.engine, self.context, searched);
        rounds.is_trial = is_trial;
        let best = rounds.run(work)?;
        Ok(United { best, totals: rounds.totals, searched: rounds.searched })
    }
}

/// A face with its source and a hash of its corners and winding.
struct Hashed {
    source: u32,
    face: u32,
    hash: u64,
}

impl Hashed {
    fn of(surface: &Surface, face: usize) -> Self {
        let hash = FxBuildHasher.hash_one(surface.face_key(face));
        #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
        {
            Self { source: surface.source[face], face: face as u32, hash }
        }
    }
}

/// The faces that a union replaced.
struct ReplacedFaces {
    /// Number of earlier faces of which only pieces remain.
    cut: u64,
    /// Number of earlier faces of which nothing remains.
    removed: u64,
    /// Number of new faces.
    created: u64,
}

impl ReplacedFaces {
    /// Compares faces with the same source by their corners and winding. A new face is a piece of the earlier faces with its source.
    fn between(before: &Surface, after: &Surface) -> Self {
        let key = |surface: &Surface, face: u32| surface.face_key(face as usize);
        let compare = |(one, a): (&Surface, &Hashed), (other, b): (&Surface, &Hashed)| {
            let by_hash = (a.source, a.hash).cmp(&(b.source, b.hash));
            by_hash.then_with(|| key(one, a.face).cmp(&key(other, b.face)))
        };
        let [earlier, later] = [before, after].map(|surface| {
            let mut faces = threads::map_cheap(surface.faces.len(), |face| Hashed::of(surface, face));
            threads::sort_by(&mut faces, &|a, b| compare((surface, a), (surface, b)).then(a.face.cmp(&b.face)));
            faces
        });
        let (mut gone, mut new) = (Vec::new(), Vec::new());
        let (mut earlier, mut later) = (earlier.iter().peekable(), later.iter().peekable());
        while let (Some(&a), Some(&b)) = (earlier.peek(), later.peek()) {
            let order = compare((before, a), (after, b));
            if order.is_le() {
                earlier.next();
            }
            if order.is_ge() {
                later.next();
            }
            match order {
                Ordering::Less => gone.push(a.source),
                Ordering::Equal => {}
                Ordering::Greater => new.push(b.source),
            }
        }
        gone.extend(earlier.map(|face| face.source));
        new.extend(later.map(|face| face.source));
        let cut = gone.iter().filter(|source| new.binary_search(source).is_ok()).count() as u64;
        Self { cut, removed: gone.len() as u64 - cut, created: new.len() as u64 }
    }

    /// Whether both surfaces have the same faces.
    fn are_none(&self) -> bool {
        self.cut + self.removed + self.created == 0
    }
}

/// Unites overlapping volumes; with `overlaps` set to keep, computes the union of each part alone.
#[derive(Clone, Copy)]
pub struct SelfUnion<'a> {
    input: &'a Analysis<'a>,
    rounds: SelfUnionRounds,
    overlaps: Overlaps,
}

impl<'a> Operation<'a> for SelfUnion<'a> {
    const FIXES: &'static [Counter] = &[Counter::NonManifoldEdges];
    const MAY_RAISE: &'static [Counter] = &[
        Counter::BoundaryEdges,
        Counter::MisorientedEdges,
        Counter::PinchedVertices,
        Counter::DegenerateFaces,
        Counter::DuplicateFaces,
    ];
    const IS_HEAVY: bool = true;

    fn with_scope(scope: &Scope<'a>, surface: &Surface) -> Self {
        let options = scope.options;
        let thickness =
            || options.thickness.unwrap_or(THICKNESS * surface.bounds().diagonal()).min(scope.max_deviation);
        let rounds = SelfUnionRounds {
            winding_rule: scope.winding_rule,
            max_deviation: scope.max_deviation,
            sheets: scope.closes_sheets.then(thickness),
            always: options.winding_rule != WindingRuleChoice::Auto,
        };
        Self { input: scope.input, rounds, overlaps: options.overlaps }
    }

    fn run_shared(
        &self,
        surface: &mut Arc<Surface>,
        edges: Arc<Edges>,
        context: &Context<'_>,
    ) -> Result<Applied, Cancelled> {
        let (applied, united) = self.united(surface, edges, context)?;
        if let Some(united) = united {
            *surface = Arc::new(united);
        }
        Ok(applied)
    }
}

/// A surface and its edges.
fn with_edges(surface: &Surface) -> (&Surface, Arc<Edges>) {
    (surface, Arc::new(Edges::new(&surface.faces)))
}

impl SelfUnion<'_> {
    /// What the operator did, and the new surface, or none if the surface stays as it is.
    fn united(
        &self,
        surface: &Surface,
        edges: Arc<Edges>,
        context: &Context<'_>,
    ) -> Result<(Applied, Option<Surface>), Cancelled> {
        let (result, united) = match self.overlaps {
            Overlaps::Union => self.rounds.united(Some(self.input), (surface, edges), &Exact, context)?,
            Overlaps::Keep => self.rounds.parts_united(self.input, surface, &Exact, context)?,
        };
        let left = (result.pairs_left > 0).then(|| format!("{} pairs of faces still intersect", result.pairs_left));
        let failed = result.error.map(Into::into);
        let Resolved { changes, moved, searched, .. } = result;
        Ok((Applied { changes, moved, left, failed, searched, ..Applied::default() }, united))
    }
}
