//! The rounds in which faces that intersect are cut, rounded to f32 and kept apart.

use glam::DVec3;
use rustc_hash::FxHashSet;

use crate::arrange::{ArrangeError, Arrangement, Rule, Solid, WindingRule};
use crate::inspect::{Analysis, Intersections, intersections};
use crate::math::Precision;
use crate::mesh::{ClosedSurface, Edges, OPENED_SKIN_SOURCE, SKIN_SOURCE, Surface, position_key, weld_exactly};
use crate::repair::operators::degenerate::{remove_caps, remove_collapsed};
use crate::repair::operators::duplicates::remove_duplicates;
use crate::repair::operators::free_positions::{key, round_to_f32};
use crate::repair::operators::inside::Pairing;
use crate::repair::operators::operator::{Counter, Counts};
use crate::repair::operators::orient::Orient;
use crate::repair::operators::perturb::Perturb;
use crate::repair::operators::rounding::{TellApart, round_apart, tell_apart};
use crate::repair::operators::split_non_manifold::{Pinches, split_non_manifold};
use crate::repair::operators::thicken::{Skins, ThickenSheets};
use crate::repair::{Cancelled, Context};

/// Bits of the grid, over the largest coordinate, to which the vertices of faces that still intersect after rounding are
/// moved, round by round.
const GRIDS: [i32; 5] = [22, 20, 18, 16, 14];

/// Rounds end where pairs of faces that intersect, or faces, are so many times the fewest before: what is resolved then
/// comes back as more. Where very many intersect they end sooner, since each round takes long.
const GROWTH: f64 = 4.0;
const GROWTH_OF_MANY: f64 = 1.5;
const MANY: u64 = 10_000;
/// What is cut into a million pieces, and so many for each face, is a tangle rather than a surface with faults: rounding it takes
/// minutes, and nobody could use it.
const TANGLE: usize = 1_000_000;
pub(super) const TANGLE_A_FACE: usize = 5;
/// So few that come back take no time.
const FEW: u64 = 200;

/// So many others a face of a dense cluster intersects.
const DENSE: u32 = 32;
/// Clusters are looked at from so many pairs on.
const MANY_DENSE: usize = 2_000;

/// Resolves faces that intersect.
#[derive(Debug, Clone, Copy)]
pub struct SelfUnionRounds {
    /// What is inside.
    pub winding_rule: WindingRule,
    /// No vertex is moved farther than this, in the model's unit, to stay clear of others after rounding.
    pub max_deviation: f64,
    /// The thickness that sheets get, in the model's unit: walls of no thickness, and what is the skin of a room that would be
    /// filled only because holes were closed, and hide what can be seen in there. Without it such walls go, and rooms are filled.
    pub sheets: Option<f64>,
    /// Whether to decide what is inside also where no faces intersect: a solid within a solid.
    pub always: bool,
}

/// The best that the rounds have come to.
pub(super) struct Best {
    /// Pairs of faces that intersect, and edges that could not be kept apart.
    pub pairs: u64,
    pub pinched: u64,
    pub surface: Surface,
    /// How far sheets were moved to be apart.
    pub aside: f64,
}

impl Best {
    /// The smaller the better.
    fn rank(&self) -> (bool, u64) {
        (self.pinched > 0, self.pairs + self.pinched)
    }
}

/// What the rounds did.
#[derive(Default)]
pub(super) struct Done {
    pub snapped: u64,
    pub merged: u64,
    pub thickened: u64,
    pub opened: u64,
    pub moved: f64,
}

/// Arranges, rounds and keeps apart until nothing intersects, on ever coarser grids.
pub(super) struct Rounds<'a> {
    resolve: &'a SelfUnionRounds,
    by: &'a dyn Arrangement,
    context: &'a Context<'a>,
    pub done: Done,
    best: Option<Best>,
    /// What faces still intersect in, with how many pairs: kept apart only if there is nothing better in the end.
    crossing: Option<(u64, Surface)>,
    /// The fewest pairs and faces so far.
    fewest: [u64; 2],
}

impl<'a> Rounds<'a> {
    pub fn new(resolve: &'a SelfUnionRounds, done: Done, by: &'a dyn Arrangement, context: &'a Context<'a>) -> Self {
        Self { resolve, by, context, done, best: None, crossing: None, fewest: [u64::MAX; 2] }
    }

    /// Runs all rounds.
    ///
    /// # Errors
    /// [`ArrangeError`] where nothing comes of them.
    pub fn run(&mut self, mut work: Surface) -> Result<Best, ArrangeError> {
        let tangle = TANGLE.max(TANGLE_A_FACE * work.faces.len());
        for grid in GRIDS.into_iter().map(Some).chain([None]) {
            self.context.check()?;
            let first = self.best.is_none() && self.crossing.is_none();
            let known: FxHashSet<[u64; 3]> = work.positions.iter().map(|&p| position_key(p)).collect();
            work = match self.arrange(&mut work, first) {
                Ok(made) if made.surface.faces.len() > tangle => {
                    let error = format!("they cut each other into {} pieces", made.surface.faces.len());
                    return Err(ArrangeError::Failed(error));
                }
                Ok(made) => made.surface,
                Err(error @ ArrangeError::Cancelled(_)) => return Err(error),
                Err(error) if first => return Err(error),
                Err(_) => break,
            };
            self.round_new(&mut work, &known)?;
            let found = crossings(&work, self.context)?;
            let pairs = count(&found);
            if self.has_grown(pairs, &work) {
                break;
            }
            let [mut takes_part, _] = found.takes_part;
            if self.compare(&work, pairs, &mut takes_part)? {
                break;
            }
            let Some(step) = grid.map(|bits| grid_step(&work, bits)) else { break };
            // Rounding to a grid moves by at most half a step along each axis.
            if step > self.resolve.max_deviation {
                break;
            }
            let (count, far) = snap(&mut work, &takes_part, step);
            self.done.snapped += count;
            self.done.moved += far;
        }
        match (self.best.take(), self.crossing.take()) {
            (Some(best), _) => Ok(best),
            (None, Some((pairs, work))) => Ok(self.kept_apart(&work, pairs, &mut vec![false; work.faces.len()])?),
            (None, None) => Err(ArrangeError::Failed("what was cut grew with each grid".to_owned())),
        }
    }

    /// Makes the arrangement, in the first round again with thin solids for what has no thickness.
    fn arrange(&mut self, work: &mut Surface, first: bool) -> Result<Solid, ArrangeError> {
        let sheets = self.resolve.sheets.filter(|_| first);
        let rule = Rule { winding_rule: self.resolve.winding_rule, doubts_patches: sheets.is_some() };
        let mut made = arranged(self.by, work, rule, self.context)?;
        let Some(thickness) = sheets.filter(|_| !(made.flaps.faces.is_empty() && made.opened.faces.is_empty())) else {
            return Ok(made);
        };
        if let Some(thick) = thickened(&made, thickness, self.context)? {
            self.done.thickened = made.flaps.faces.len() as u64;
            self.done.opened = made.opened.faces.len() as u64;
            if self.done.opened > 0 {
                // What was opened has none of the patches that it was closed with.
                *work = std::mem::take(&mut made.surface);
            }
            append(work, thick);
        }
        arranged(self.by, work, self.resolve.winding_rule.into(), self.context)
    }

    /// Rounds the positions that are not known from before, and merges what readers would.
    fn round_new(&mut self, work: &mut Surface, known: &FxHashSet<[u64; 3]>) -> Result<(), Cancelled> {
        let is_new = |p| !known.contains(&position_key(p));
        self.done.merged += round_apart(work, is_new, self.context)?.merged;
        settle(work, self.context)?;
        let limits = TellApart { max_deviation: self.resolve.max_deviation, moves: true };
        self.done.merged += tell_apart(work, limits, is_new, self.context)?;
        Ok(())
    }

    /// Whether what is resolved comes back as more; otherwise the fewest are brought up to date.
    fn has_grown(&mut self, pairs: u64, work: &Surface) -> bool {
        let now = [pairs, work.faces.len() as u64];
        let growth = if pairs > MANY { GROWTH_OF_MANY } else { GROWTH };
        if pairs > FEW && now.iter().zip(self.fewest).any(|(&now, fewest)| now as f64 / growth > fewest as f64) {
            return true;
        }
        self.fewest = [0, 1].map(|k| self.fewest[k].min(now[k]));
        false
    }

    /// Takes a round's result where it is the best so far. Whether there can be no better one.
    fn compare(&mut self, work: &Surface, pairs: u64, takes_part: &mut [bool]) -> Result<bool, Cancelled> {
        if pairs > 0 {
            if self.crossing.as_ref().is_none_or(|(fewest, _)| pairs < *fewest) {
                self.crossing = Some((pairs, work.clone()));
            }
            return Ok(false);
        }
        let made = self.kept_apart(work, pairs, takes_part)?;
        let is_apart = made.pinched == 0;
        if self.best.as_ref().is_none_or(|best| made.rank() < best.rank()) {
            self.best = Some(made);
        }
        Ok(is_apart)
    }

    /// Moves sheets aside that a reader of STL would weld, and marks the faces where they could not be kept apart.
    fn kept_apart(&self, work: &Surface, pairs: u64, takes_part: &mut [bool]) -> Result<Best, Cancelled> {
        let mut surface = work.clone();
        let aside = Perturb { max_deviation: self.resolve.max_deviation }.apply(&mut surface, self.context)?.moved;
        let pairs = if surface == *work { pairs } else { count(&crossings(&surface, self.context)?) };
        let pinched = mark_pinched(&surface, work, takes_part);
        Ok(Best { pairs, pinched, surface, aside })
    }
}

/// The boundary of what a surface encloses.
fn arranged(by: &dyn Arrangement, surface: &Surface, rule: Rule, context: &Context<'_>) -> Result<Solid, ArrangeError> {
    by.solid(ClosedSurface::try_from(surface)?, rule, context)
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
    remove_duplicates(surface);
    remove_caps(surface, context)?;
    surface.drop_unreferenced();
    Ok(())
}

#[expect(clippy::cast_possible_truncation, reason = "vertices are counted in u32")]
pub(super) fn index(count: usize) -> u32 {
    count as u32
}

/// Puts one surface beside another.
pub(super) fn append(surface: &mut Surface, other: Surface) {
    let first = index(surface.positions.len());
    surface.positions.extend(other.positions);
    surface.faces.extend(other.faces.iter().map(|face| face.map(|v| v + first)));
    surface.source.extend(other.source);
}

/// Whether a reader of STL would find every edge between two faces that agree, and one fan at every vertex.
pub(super) fn is_manifold_by_position(surface: &Surface) -> bool {
    let mut welded = surface.clone();
    round_to_f32(&mut welded);
    weld_exactly(&mut welded);
    let counts = Counts::of(&welded);
    use Counter::{BoundaryEdges, MisorientedEdges, NonManifoldEdges, PinchedVertices};
    [BoundaryEdges, MisorientedEdges, NonManifoldEdges, PinchedVertices].iter().all(|&c| counts.get(c) == 0)
}

/// Marks faces where sheets could not be kept apart by position: those at edges that more than two faces share. Answers how many
/// such edges there are.
fn mark_pinched(apart: &Surface, work: &Surface, takes_part: &mut [bool]) -> u64 {
    let mut welded = apart.clone();
    weld_exactly(&mut welded);
    let edges = Edges::new(&welded.faces);
    let mut at: FxHashSet<[u64; 3]> = FxHashSet::default();
    let mut count = 0;
    for half_edges in edges.iter().filter(|half_edges| half_edges.len() > 2) {
        at.extend(
            Edges::ends(&welded.faces, half_edges[0]).iter().map(|&v| position_key(welded.positions[v as usize])),
        );
        count += 1;
    }
    if count > 0 {
        for (face, takes) in work.faces.iter().zip(takes_part) {
            *takes |= face.iter().any(|&v| at.contains(&position_key(work.positions[v as usize])));
        }
    }
    count
}

/// The faces that intersect.
pub(super) fn crossings(surface: &Surface, context: &Context<'_>) -> Result<Intersections, Cancelled> {
    let soup = surface.to_soup();
    intersections(&Analysis::new((&soup).into(), context)?, context)
}

/// How many pairs of faces intersect.
pub(super) fn count(found: &Intersections) -> u64 {
    found.counts.pairs.unwrap_or(0)
}

/// The step of the grid of `2^bits` steps over the largest coordinate.
pub(super) fn grid_step(surface: &Surface, bits: i32) -> f64 {
    let bounds = surface.bounds();
    let largest = bounds.min.abs().max(bounds.max.abs()).max_element();
    #[expect(clippy::cast_possible_truncation, reason = "an exponent")]
    2f64.powi(largest.log2().ceil() as i32 - bits)
}

/// Moves the vertices of faces to a grid, and with them all vertices of the same cells. A coordinate in which a whole face agrees
/// stays, so that surface along the axes stays flat. Answers how many moved, and how far at most.
pub(super) fn snap(surface: &mut Surface, takes_part: &[bool], step: f64) -> (u64, f64) {
    let (mut moved, mut far) = (0, 0.0f64);
    let mut pinned = vec![[false; 3]; surface.positions.len()];
    for (face, corners) in surface.faces.iter().zip((0..surface.faces.len()).map(|f| surface.corners(f))) {
        for k in 0..3 {
            if corners[0][k] == corners[1][k] && corners[1][k] == corners[2][k] {
                face.iter().for_each(|&v| pinned[v as usize][k] = true);
            }
        }
    }
    let on_grid = |p: DVec3, pins: [bool; 3]| {
        let q = Precision::F32.round((p / step).round() * step);
        DVec3::from_array([0, 1, 2].map(|k| if pins[k] { p[k] } else { q[k] }))
    };
    let mut cells: FxHashSet<[u32; 3]> = FxHashSet::default();
    for (face, _) in surface.faces.iter().zip(takes_part).filter(|(_, t)| **t) {
        cells.extend(face.iter().map(|&v| key(on_grid(surface.positions[v as usize], pinned[v as usize]))));
    }
    for (p, &pins) in surface.positions.iter_mut().zip(&pinned) {
        let q = on_grid(*p, pins);
        if q != *p && cells.contains(&key(q)) {
            moved += 1;
            far = far.max(p.distance(q));
            *p = q;
        }
    }
    weld_exactly(surface);
    remove_collapsed(surface);
    (moved, far)
}

/// Faces of dense clusters: those that intersect many faces which do so too. None where so few pairs are dense that it is no
/// matter.
pub(super) fn dense_faces(found: &Intersections) -> Option<Vec<bool>> {
    let [takes_part, _] = &found.takes_part;
    let mut partners = vec![0u32; takes_part.len()];
    for pair in &found.pairs {
        pair.faces.iter().for_each(|&f| partners[f as usize] += 1);
    }
    let is_dense = |f: u32| partners[f as usize] >= DENSE;
    let mut dense = vec![false; takes_part.len()];
    let mut count = 0;
    for pair in found.pairs.iter().filter(|pair| pair.faces.iter().all(|&f| is_dense(f))) {
        pair.faces.iter().for_each(|&f| dense[f as usize] = true);
        count += 1;
    }
    (count >= MANY_DENSE).then_some(dense)
}
