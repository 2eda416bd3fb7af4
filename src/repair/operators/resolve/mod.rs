//! Intersections resolved, and kept resolved after rounding.

mod checks;
mod snap;

use rustc_hash::FxHashSet;

use self::checks::{count, crossings, is_manifold_by_position, mark_pinched};
use self::snap::{dense_faces, grid_step, snap};
use super::cut::{Pairing, Pinches, cut_apart};
use super::degenerate::{remove_caps, remove_collapsed};
use super::duplicates;
use super::orient::Orient;
use super::rounding::{TellApart, round_apart, tell_apart};
use super::separate::Separate;
use super::thicken::{Skins, THICKNESS, ThickenSheets};
use super::{Applied, Counter, Operation, Scope};
use crate::arrange::{ArrangeError, Arrangement, Exact, Inside, Rule, Solid};
use crate::math::Precision;
use crate::mesh::{ClosedSurface, Edges, OPENED_SKIN_SOURCE, Parts, SKIN_SOURCE, Surface, is_made, position_key};
use crate::repair::{Cancelled, Change, ChangeKind, Context, InsideRule, Overlaps};

/// Bits of the grid, over the largest coordinate, to which the vertices of faces that still intersect after rounding are
/// moved, round by round.
const GRIDS: [i32; 5] = [22, 20, 18, 16, 14];

/// Bits of the grid to which dense clusters of intersections are moved before all else: a thousand faces through one point would
/// be cut into more pieces than there are positions for.
const DENSE_GRID: i32 = 10;

/// Rounds end where pairs of faces that intersect, or faces, are so many times the fewest before: what is resolved then
/// comes back as more. Where very many intersect they end sooner, since each round takes long.
const GROWTH: f64 = 4.0;
const GROWTH_OF_MANY: f64 = 1.5;
const MANY: u64 = 10_000;
/// What is cut into a million pieces, and so many for each face, is a tangle rather than a surface with faults: rounding it takes
/// minutes, and nobody could use it.
const TANGLE: usize = 1_000_000;
const TANGLE_A_FACE: usize = 5;
/// Pairs of faces that intersect from which on it is a tangle for sure: each pair cuts at least one piece off, and mostly two.
const TANGLED_PAIRS: u64 = 500_000;
/// So few that come back take no time.
const FEW: u64 = 200;

/// Resolves faces that intersect.
#[derive(Debug, Clone, Copy)]
pub struct Resolve {
    /// What is inside.
    pub inside: Inside,
    /// No vertex is moved farther than this, in the model's unit, to stay clear of others after rounding.
    pub max_deviation: f64,
    /// The thickness that sheets get, in the model's unit: walls of no thickness, and what is the skin of a room that would be
    /// filled only because holes were closed, and hide what can be seen in there. Without it such walls go, and rooms are filled.
    pub sheets: Option<f64>,
    /// Whether to decide what is inside also where no faces intersect: a solid within a solid.
    pub always: bool,
}

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

/// The boundary of what a surface encloses.
fn arranged(by: &dyn Arrangement, surface: &Surface, rule: Rule, context: &Context<'_>) -> Result<Solid, ArrangeError> {
    by.solid(ClosedSurface::try_from(surface)?, rule, context)
}

/// The best that the rounds have come to.
struct Best {
    /// Pairs of faces that intersect, and edges that could not be kept apart.
    pairs: u64,
    pinched: u64,
    surface: Surface,
    /// How far sheets were moved to be apart.
    aside: f64,
}

impl Best {
    /// The smaller the better.
    fn rank(&self) -> (bool, u64) {
        (self.pinched > 0, self.pairs + self.pinched)
    }
}

/// What the rounds did.
#[derive(Default)]
struct Done {
    snapped: u64,
    merged: u64,
    thickened: u64,
    opened: u64,
    moved: f64,
}

impl Resolve {
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
        let best = match self.in_rounds(work, &mut done, by, context) {
            Ok(best) => best,
            Err(ArrangeError::Cancelled(stop)) => return Err(stop),
            Err(error) => return Ok(undone(before, error)),
        };
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
            (ChangeKind::FacesMade, surface.faces.len() as u64),
            (ChangeKind::VerticesSnapped, done.snapped),
            (ChangeKind::VerticesMerged, done.merged),
            (ChangeKind::FacesWithoutThicknessThickened, done.thickened),
            (ChangeKind::FacesAroundOpenRoomsThickened, done.opened),
        ]);
        Ok(Resolved { changes, moved: done.moved + best.aside, pairs_left: best.pairs, error: None })
    }

    /// Arranges, rounds and keeps apart until nothing intersects, on ever coarser grids.
    fn in_rounds(
        &self,
        mut work: Surface,
        done: &mut Done,
        by: &dyn Arrangement,
        context: &Context<'_>,
    ) -> Result<Best, ArrangeError> {
        let tangle = TANGLE.max(TANGLE_A_FACE * work.faces.len());
        let mut best: Option<Best> = None;
        // What faces still intersect in, with how many pairs: kept apart only if there is nothing better in the end.
        let mut crossing: Option<(u64, Surface)> = None;
        let mut fewest = [u64::MAX; 2];
        for grid in GRIDS.into_iter().map(Some).chain([None]) {
            context.check()?;
            let first = best.is_none() && crossing.is_none();
            let known: FxHashSet<[u64; 3]> = work.positions.iter().map(|&p| position_key(p)).collect();
            let rule = Rule { inside: self.inside, doubts_patches: first && self.sheets.is_some() };
            let mut made = arranged(by, &work, rule, context);
            if let (Some(thickness), true, Ok(with_sheets)) = (self.sheets, first, &mut made)
                && !(with_sheets.flaps.faces.is_empty() && with_sheets.opened.faces.is_empty())
            {
                if let Some(thick) = thickened(with_sheets, thickness, context)? {
                    done.thickened = with_sheets.flaps.faces.len() as u64;
                    done.opened = with_sheets.opened.faces.len() as u64;
                    if done.opened > 0 {
                        // What was opened has none of the patches that it was closed with.
                        work = std::mem::take(&mut with_sheets.surface);
                    }
                    append(&mut work, thick);
                }
                made = arranged(by, &work, self.inside.into(), context);
            }
            work = match made {
                Ok(made) if made.surface.faces.len() > tangle => {
                    let error = format!("they cut each other into {} pieces", made.surface.faces.len());
                    return Err(ArrangeError::Failed(error));
                }
                Ok(made) => made.surface,
                Err(error @ ArrangeError::Cancelled(_)) => return Err(error),
                Err(error) if first => return Err(error),
                Err(_) => break,
            };
            let is_new = |p| !known.contains(&position_key(p));
            done.merged += round_apart(&mut work, is_new, context)?.merged;
            settle(&mut work, context)?;
            done.merged +=
                tell_apart(&mut work, TellApart { max_deviation: self.max_deviation, moves: true }, is_new, context)?;
            let found = crossings(&work, context)?;
            let pairs = count(&found);
            let grown = [pairs, work.faces.len() as u64];
            let growth = if pairs > MANY { GROWTH_OF_MANY } else { GROWTH };
            if pairs > FEW && grown.iter().zip(fewest).any(|(&now, fewest)| now as f64 / growth > fewest as f64) {
                break;
            }
            fewest = [0, 1].map(|k| fewest[k].min(grown[k]));
            let [mut takes_part, _] = found.takes_part;
            if pairs > 0 {
                if crossing.as_ref().is_none_or(|(fewest, _)| pairs < *fewest) {
                    crossing = Some((pairs, work.clone()));
                }
            } else {
                let made = self.kept_apart(&work, pairs, &mut takes_part, context)?;
                let is_apart = made.pinched == 0;
                if best.as_ref().is_none_or(|best| made.rank() < best.rank()) {
                    best = Some(made);
                }
                if is_apart {
                    break;
                }
            }
            let Some(step) = grid.map(|bits| grid_step(&work, bits)) else { break };
            // Rounding to a grid moves by at most half a step along each axis.
            if step > self.max_deviation {
                break;
            }
            let (count, far) = snap(&mut work, &takes_part, step);
            done.snapped += count;
            done.moved += far;
        }
        match (best, crossing) {
            (Some(best), _) => Ok(best),
            (None, Some((pairs, work))) => {
                Ok(self.kept_apart(&work, pairs, &mut vec![false; work.faces.len()], context)?)
            }
            (None, None) => Err(ArrangeError::Failed("what was cut grew with each grid".to_owned())),
        }
    }

    /// Moves sheets aside that a reader of STL would weld, and marks the faces where they could not be kept apart.
    fn kept_apart(
        &self,
        work: &Surface,
        pairs: u64,
        takes_part: &mut [bool],
        context: &Context<'_>,
    ) -> Result<Best, Cancelled> {
        let mut surface = work.clone();
        let aside = Separate { max_deviation: self.max_deviation }.apply(&mut surface, context)?.moved;
        let pairs = if surface == *work { pairs } else { count(&crossings(&surface, context)?) };
        let pinched = mark_pinched(&surface, work, takes_part);
        Ok(Best { pairs, pinched, surface, aside })
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
        all.changes = Change::list([(ChangeKind::FacesCut, cut), (ChangeKind::FacesMade, made)]);
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

#[expect(clippy::cast_possible_truncation, reason = "vertices are counted in u32")]
fn index(count: usize) -> u32 {
    count as u32
}

/// Puts one surface beside another.
fn append(surface: &mut Surface, other: Surface) {
    let first = index(surface.positions.len());
    surface.positions.extend(other.positions);
    surface.faces.extend(other.faces.iter().map(|face| face.map(|v| v + first)));
    surface.source.extend(other.source);
}

/// What has no thickness in an arrangement, as thin solids: around walls that are their middle, and behind the skin of what was
/// opened. None where there is nothing of the kind.
fn thickened(solid: &Solid, thickness: f64, context: &Context<'_>) -> Result<Option<Surface>, Cancelled> {
    let mut all = Surface::default();
    for (sheets, skins) in [(&solid.flaps, Skins::BothSides), (&solid.opened, Skins::Behind)] {
        let mut thick = sheets.clone();
        // What is one wall may be cut from faces that look either way.
        if skins == Skins::BothSides {
            Orient::default().apply(&mut thick, context)?;
        }
        cut_apart(&mut thick, Pairing::Angular, Pinches::Cut, context)?;
        let thicken = ThickenSheets {
            thickness: Some(thickness),
            skins,
            spares_solids: false,
            max_deviation: f64::INFINITY,
            precision: Precision::F32,
        };
        if !thicken.apply(&mut thick, context)?.changes.is_empty() {
            if skins == Skins::Behind {
                let made = thick.source.iter_mut().filter(|source| **source == SKIN_SOURCE);
                made.for_each(|source| *source = OPENED_SKIN_SOURCE);
            }
            append(&mut all, thick);
        }
    }
    Ok((!all.faces.is_empty()).then_some(all))
}

/// Cleans what rounding made of the smallest faces.
fn settle(surface: &mut Surface, context: &Context<'_>) -> Result<(), Cancelled> {
    remove_collapsed(surface);
    duplicates::remove_duplicates(surface);
    remove_caps(surface, context)?;
    surface.drop_unreferenced();
    Ok(())
}

/// Unites what overlaps, or resolves each part alone where parts are to be kept apart.
#[derive(Debug, Clone, Copy)]
pub struct ResolveOverlaps {
    resolve: Resolve,
    overlaps: Overlaps,
}

impl Operation for ResolveOverlaps {
    const FIXES: &'static [Counter] = &[Counter::NonmanifoldEdges];
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
        let resolve = Resolve {
            inside: scope.inside,
            max_deviation: scope.max_deviation,
            sheets: scope.closes_sheets.then(thickness),
            always: options.inside != InsideRule::Auto,
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
