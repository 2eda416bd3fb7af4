//! The rounds of a self-union: arrange the faces, round new vertices to f32, and perturb coincident sheets.
//!
//! Rounding can make faces intersect again. Then their vertices snap to a coarser grid and the next round begins.

use rustc_hash::FxHashSet;

use super::residue::{MAX_PLUG_REACH, Pinched, plugs, remove_crumbs};
use super::snap::{grid_step, snap};
use crate::arrange::{ArrangeError, Arrangement, MeetingFaces, Rule, Solid, WindingRule};
use crate::inspect::{IntersectingPair, Intersections, KnownIntersections, Meeting, SearchedMesh};
use crate::math::Precision;
use crate::mesh::{ClosedSurface, OPENED_SKIN_SOURCE, SKIN_SOURCE, Surface, position_key, weld_exactly};
use crate::repair::operators::degenerate::{remove_caps, remove_collapsed};
use crate::repair::operators::duplicates::remove_duplicates;
use crate::repair::operators::face_pairs::Pairing;
use crate::repair::operators::free_positions::round_to_f32;
use crate::repair::operators::operator::{Counter, Counts};
use crate::repair::operators::orient::Orient;
use crate::repair::operators::perturb::Perturb;
use crate::repair::operators::rounding::{DistinguishLimits, distinguish_vertices, round_without_contact};
use crate::repair::operators::split_non_manifold::{Pinches, split_non_manifold};
use crate::repair::operators::thicken::{Skins, ThickenSheets};
use crate::repair::{Cancelled, Context};

/// Grid resolutions in bits below the largest coordinate. Vertices of faces that still intersect after rounding snap to the
/// next grid in each round.
///
/// f32 has 24 bits, so the first grid leaves 6 bits of room to round new vertices between its positions. Finer grids leave
/// too little: rounding then makes faces intersect again, round after round. Two rounds on one grid often suffice (Valque
/// and Lazard 2025 use up to five), and a coarser grid gives more room. On a model of 128 mm, half a step of the last grid
/// is 16 micrometres.
const GRIDS: [i32; 6] = [18, 16, 16, 14, 14, 12];

/// Grid resolutions of the solids that join places, the most places, and in how many rounds that is tried.
const PLUG_GRIDS: [i32; 2] = [18, 16];
const MAX_PLUGS: u64 = 64;
const MAX_ATTEMPTS_TO_PLUG: usize = 3;

/// Rounds stop when intersecting pairs exceed the fewest so far by this factor: resolved intersections then come back in
/// greater number. With very many pairs the factor is lower, since each round takes long.
const PAIR_GROWTH: f64 = 4.0;
const GROWTH_OF_MANY: f64 = 1.5;
/// Rounds also stop when the faces exceed the fewest so far by this factor: the surface is then shredded.
const FACE_GROWTH: f64 = 1.5;
const MANY_PAIRS: u64 = 10_000;
/// The most pieces in all and for each input face. A surface that splits into more is too tangled to be useful, and
/// rounding it takes minutes.
const MAX_PIECES: usize = 1_000_000;
pub(super) const MAX_PIECES_PER_FACE: usize = 5;
/// Up to so many intersecting pairs a round takes no noticeable time.
const FEW_PAIRS: u64 = 200;

/// The settings of a self-union.
#[derive(Debug, Clone, Copy)]
pub struct SelfUnionRounds {
    /// The winding rule that defines the inside.
    pub winding_rule: WindingRule,
    /// No vertex moves farther than this, in the model's unit, to stay clear of others after rounding.
    pub max_deviation: f64,
    /// The thickness for zero-thickness facets and for the skins of regions that filled holes would otherwise fill, in the
    /// model's unit. Such skins keep the region's visible contents visible. `None` removes the facets and fills the regions.
    pub sheets: Option<f64>,
    /// Whether to apply the winding rule even where no faces intersect, as for a solid within a solid.
    pub always: bool,
}

/// The result of the best round so far.
pub(super) struct Best {
    /// The number of face pairs that intersect.
    pub pairs: u64,
    /// The edges and vertices whose sheets could not be separated by position.
    pub pinched: Pinched,
    /// The surface after the round.
    pub surface: Surface,
    /// The largest displacement by the perturbation, in the model's unit.
    pub perturbed: f64,
}

impl Best {
    /// The sort key of a result: lower is better.
    fn rank(&self) -> (bool, u64) {
        (self.pinched.count() > 0, self.pairs + self.pinched.count())
    }

    /// Whether nothing intersects and everything is separated.
    fn is_clean(&self) -> bool {
        self.rank() == (false, 0)
    }
}

/// The counts over all rounds.
#[derive(Default)]
pub(super) struct Totals {
    /// Vertices snapped to a grid.
    pub snapped: u64,
    /// Vertices merged with neighbours.
    pub merged: u64,
    /// Closed pieces removed because they were thinner than rounding moves a vertex.
    pub crumbs: u64,
    /// Zero-thickness faces that got a thickness.
    pub thickened: u64,
    /// Faces around opened regions that got a thickness.
    pub opened: u64,
    /// Places where sheets touched or intersected that are joined now.
    pub plugs: u64,
    /// The sum over rounds of the largest displacement, in the model's unit.
    pub moved: f64,
}

/// Arranges, rounds and perturbs until nothing intersects, on ever coarser grids.
pub(super) struct Rounds<'a> {
    settings: &'a SelfUnionRounds,
    engine: &'a dyn Arrangement,
    context: &'a Context<'a>,
    /// The counts over all rounds so far.
    pub totals: Totals,
    /// The surface that was last searched for intersecting faces.
    pub searched: SearchedMesh,
    best: Option<Best>,
    /// The surface with the fewest intersecting pairs, and their number: used only where no round ended without any.
    crossing: Option<(u64, Surface)>,
    /// The fewest intersecting pairs and the fewest faces so far.
    fewest: [u64; 2],
    /// In how many rounds places were to be joined.
    attempts_to_plug: usize,
    /// Whether to fail where the first round leaves many pairs, because another way will be tried.
    pub is_trial: bool,
}

impl<'a> Rounds<'a> {
    /// Prepares the rounds; `totals` holds the counts of earlier snapping, and `searched` the surface before the rounds.
    pub fn new(
        settings: &'a SelfUnionRounds,
        totals: Totals,
        engine: &'a dyn Arrangement,
        context: &'a Context<'a>,
        searched: SearchedMesh,
    ) -> Self {
        Self {
            settings,
            engine,
            context,
            totals,
            searched,
            best: None,
            crossing: None,
            fewest: [u64::MAX; 2],
            attempts_to_plug: 0,
            is_trial: false,
        }
    }

    /// Runs all rounds.
    ///
    /// # Errors
    /// [`ArrangeError`] where no round gives a result.
    pub fn run(&mut self, input: ClosedSurface<'_>) -> Result<Best, ArrangeError> {
        let max_pieces = MAX_PIECES.max(MAX_PIECES_PER_FACE * input.faces.len());
        self.context.check()?;
        let mut solid = self.arrange_input(input)?;
        let mut known_positions = positions_of(&input);
        for grid in GRIDS.into_iter().map(Some).chain([None]) {
            if solid.surface.faces.len() > max_pieces {
                let error = format!("the faces split into {} pieces, more than the limit", solid.surface.faces.len());
                return Err(ArrangeError::Failed(error));
            }
            let mut work = solid.surface;
            self.round_new(&mut work, &known_positions)?;
            self.searched = crossings(&work, self.searched.known_intersections(), self.context)?;
            let intersections = &self.searched.intersections;
            let pairs = count(intersections);
            let [mut takes_part, _] = intersections.takes_part.clone();
            if self.is_trial && pairs > FEW_PAIRS {
                return Err(ArrangeError::Tangled(pairs));
            }
            if self.has_grown(pairs, &work) {
                break;
            }
            if self.compare(&work, pairs, &mut takes_part)? {
                break;
            }
            let Some(step) = grid.map(|bits| grid_step(&work, bits)) else { break };
            // Snapping to a grid moves a vertex by at most half a step along each axis.
            if step > self.settings.max_deviation {
                break;
            }
            let (count, far) = snap(&mut work, &takes_part, step);
            self.totals.snapped += count;
            self.totals.moved += far;
            self.context.check()?;
            known_positions = positions_of(&work);
            solid = match arranged(self.engine, &work, self.settings.winding_rule.into(), self.context) {
                Ok(solid) => solid,
                Err(error @ ArrangeError::Cancelled(_)) => return Err(error),
                Err(_) => break,
            };
        }
        match (self.best.take(), self.crossing.take()) {
            (Some(best), _) => Ok(best),
            (None, Some((pairs, work))) => {
                let left = self.perturb(&work, pairs, &mut vec![false; work.faces.len()])?;
                Ok(self.plug(&left)?.unwrap_or(left))
            }
            (None, None) => Err(ArrangeError::Failed("each coarser grid gave more intersections or faces".to_owned())),
        }
    }

    /// Computes the arrangement of the input. Zero-thickness facets become thin solids and are arranged again.
    fn arrange_input(&mut self, input: ClosedSurface<'_>) -> Result<Solid, ArrangeError> {
        let (sheets, winding_rule) = (self.settings.sheets, self.settings.winding_rule);
        let rule = Rule { winding_rule, reopens_patches: sheets.is_some() };
        let met =
            |pair: &IntersectingPair| MeetingFaces { faces: pair.faces, overlap: pair.meeting == Meeting::Coplanar };
        let known: Option<Vec<MeetingFaces>> =
            self.searched.meeting_pairs().map(|pairs| pairs.iter().map(met).collect());
        let mut solid = self.engine.solid(input, known.as_deref(), rule, self.context)?;
        let Some(thickness) =
            sheets.filter(|_| !(solid.zero_thickness.faces.is_empty() && solid.opened.faces.is_empty()))
        else {
            return Ok(solid);
        };
        let Some(thick) = thickened(&solid, thickness, self.context)? else {
            return self.engine.solid(input, known.as_deref(), winding_rule.into(), self.context);
        };
        self.totals.thickened = solid.zero_thickness.faces.len() as u64;
        self.totals.opened = solid.opened.faces.len() as u64;
        // The opened surface has none of the patches that closed the region.
        let mut work = if self.totals.opened > 0 { std::mem::take(&mut solid.surface) } else { input.get().clone() };
        work.append(thick);
        arranged(self.engine, &work, winding_rule.into(), self.context)
    }

    /// Rounds the positions that are not in `known_positions`, and merges vertices that readers would merge.
    fn round_new(&mut self, work: &mut Surface, known_positions: &FxHashSet<[u64; 3]>) -> Result<(), Cancelled> {
        let is_new = |p| !known_positions.contains(&position_key(p));
        self.totals.merged += round_without_contact(work, is_new, self.context)?.merged;
        settle(work, self.context)?;
        split_non_manifold(work, Pairing::Angular, Pinches::Cut, self.context)?;
        self.totals.crumbs += remove_crumbs(work, is_new);
        let limits = DistinguishLimits { max_deviation: self.settings.max_deviation, moves: true };
        self.totals.merged += distinguish_vertices(work, limits, is_new, self.context)?;
        Ok(())
    }

    /// Whether the intersections or faces have grown too much; otherwise updates the fewest so far.
    fn has_grown(&mut self, pairs: u64, work: &Surface) -> bool {
        let now = [pairs, work.faces.len() as u64];
        let growth = [if pairs > MANY_PAIRS { GROWTH_OF_MANY } else { PAIR_GROWTH }, FACE_GROWTH];
        if pairs > FEW_PAIRS && (0..2).any(|k| now[k] as f64 / growth[k] > self.fewest[k] as f64) {
            return true;
        }
        self.fewest = [0, 1].map(|k| self.fewest[k].min(now[k]));
        false
    }

    /// Keeps a round's result where it is the best so far. Returns whether no better result is possible.
    fn compare(&mut self, work: &Surface, pairs: u64, takes_part: &mut [bool]) -> Result<bool, ArrangeError> {
        if pairs > 0 {
            if self.crossing.as_ref().is_none_or(|(fewest, _)| pairs < *fewest) {
                self.crossing = Some((pairs, work.clone()));
            }
            return Ok(false);
        }
        let mut result = self.perturb(work, pairs, takes_part)?;
        if let Some(plugged) = self.plug(&result)? {
            result = plugged;
        }
        let is_separated = result.pinched.count() == 0;
        if self.best.as_ref().is_none_or(|best| result.rank() < best.rank()) {
            self.best = Some(result);
        }
        Ok(is_separated)
    }

    /// Joins the sheets that touch or intersect in a few places by tiny solids. `None` where that leaves a defect.
    fn plug(&mut self, result: &Best) -> Result<Option<Best>, ArrangeError> {
        let places = result.pinched.count() + result.pairs;
        if places == 0 || places > MAX_PLUGS || self.attempts_to_plug >= MAX_ATTEMPTS_TO_PLUG {
            return Ok(None);
        }
        self.attempts_to_plug += 1;
        let pairs = match result.pairs {
            0 => Vec::new(),
            _ => crossings(&result.surface, self.searched.known_intersections(), self.context)?.intersections.pairs,
        };
        for bits in PLUG_GRIDS {
            let step = grid_step(&result.surface, bits);
            if MAX_PLUG_REACH * step > self.settings.max_deviation {
                break;
            }
            let mut work = result.surface.clone();
            work.append(plugs(&result.surface, &result.pinched, &pairs, step));
            weld_exactly(&mut work);
            let known_positions = positions_of(&work);
            work = match arranged(self.engine, &work, WindingRule::Positive.into(), self.context) {
                Ok(solid) => solid.surface,
                Err(error @ ArrangeError::Cancelled(_)) => return Err(error),
                Err(_) => break,
            };
            self.round_new(&mut work, &known_positions)?;
            let left = count(&crossings(&work, self.searched.known_intersections(), self.context)?.intersections);
            let plugged = self.perturb(&work, left, &mut vec![false; work.faces.len()])?;
            if plugged.is_clean() {
                self.totals.plugs += places;
                self.totals.moved += MAX_PLUG_REACH * step;
                return Ok(Some(plugged));
            }
        }
        Ok(None)
    }

    /// Perturbs sheets that a reader of STL would merge, and marks the faces where that failed.
    fn perturb(&self, work: &Surface, pairs: u64, takes_part: &mut [bool]) -> Result<Best, Cancelled> {
        let mut surface = work.clone();
        let perturbed = Perturb { max_deviation: self.settings.max_deviation }.apply(&mut surface, self.context)?.moved;
        let pairs = if surface == *work {
            pairs
        } else {
            count(&crossings(&surface, self.searched.known_intersections(), self.context)?.intersections)
        };
        let pinched = Pinched::of(&surface);
        pinched.mark(work, takes_part);
        Ok(Best { pairs, pinched, surface, perturbed })
    }
}

/// The keys of a surface's positions.
fn positions_of(surface: &Surface) -> FxHashSet<[u64; 3]> {
    surface.positions.iter().map(|&p| position_key(p)).collect()
}

/// The boundary of the volume that a surface encloses.
fn arranged(
    engine: &dyn Arrangement,
    surface: &Surface,
    rule: Rule,
    context: &Context<'_>,
) -> Result<Solid, ArrangeError> {
    engine.solid(ClosedSurface::try_from(surface)?, None, rule, context)
}

/// The zero-thickness faces of an arrangement as thin solids: on both sides of facets, and behind the skins of opened regions.
/// `None` where there are no such faces.
fn thickened(solid: &Solid, thickness: f64, context: &Context<'_>) -> Result<Option<Surface>, Cancelled> {
    let mut all = Surface::default();
    for (sheets, skins) in [(&solid.zero_thickness, Skins::BothSides), (&solid.opened, Skins::Behind)] {
        let mut thick = sheets.clone();
        // One facet may consist of faces with opposite windings.
        if skins == Skins::BothSides {
            Orient::default().apply(&mut thick, context)?;
        }
        split_non_manifold(&mut thick, Pairing::Angular, Pinches::Cut, context)?;
        let thicken = ThickenSheets {
            thickness: Some(thickness),
            skins,
            spares_solids: false,
            max_deviation: f64::INFINITY,
            precision: Precision::F32,
        };
        if !thicken.apply(&mut thick, context)?.changes.is_empty() {
            if skins == Skins::Behind {
                let skins = thick.source.iter_mut().filter(|source| **source == SKIN_SOURCE);
                skins.for_each(|source| *source = OPENED_SKIN_SOURCE);
            }
            all.append(thick);
        }
    }
    Ok((!all.faces.is_empty()).then_some(all))
}

/// Removes the degenerate and duplicate faces that rounding leaves.
fn settle(surface: &mut Surface, context: &Context<'_>) -> Result<(), Cancelled> {
    remove_collapsed(surface);
    remove_duplicates(surface);
    remove_caps(surface, context)?;
    surface.drop_unreferenced();
    Ok(())
}

/// Whether a reader that merges vertices by f32 position finds a closed, oriented manifold.
pub(in crate::repair::operators) fn is_manifold_by_position(surface: &Surface) -> bool {
    let mut welded = surface.clone();
    round_to_f32(&mut welded);
    weld_exactly(&mut welded);
    let counts = Counts::of(&welded);
    use Counter::{BoundaryEdges, MisorientedEdges, NonManifoldEdges, PinchedVertices};
    [BoundaryEdges, MisorientedEdges, NonManifoldEdges, PinchedVertices].iter().all(|&c| counts.get(c) == 0)
}

/// Finds the faces that intersect. Faces that an earlier mesh has too are not tested against each other again.
pub(super) fn crossings(
    surface: &Surface,
    earlier: Option<KnownIntersections<'_>>,
    context: &Context<'_>,
) -> Result<SearchedMesh, Cancelled> {
    SearchedMesh::search(surface.to_soup(), earlier, context)
}

/// The number of face pairs that intersect.
pub(super) fn count(intersections: &Intersections) -> u64 {
    intersections.counts.pairs.unwrap_or(0)
}
