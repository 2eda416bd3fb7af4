//! The rounds of a self-union: arrange the faces, round new vertices to f32, and perturb coincident sheets.
//!
//! Rounding can make faces intersect again. Then their vertices snap to a coarser grid and the next round begins.

use glam::DVec3;
use rustc_hash::FxHashSet;

use crate::arrange::{ArrangeError, Arrangement, Rule, Solid, WindingRule};
use crate::inspect::{Intersections, SearchedMesh};
use crate::math::Precision;
use crate::mesh::{ClosedSurface, Edges, OPENED_SKIN_SOURCE, SKIN_SOURCE, Surface, position_key, weld_exactly};
use crate::repair::operators::degenerate::{remove_caps, remove_collapsed};
use crate::repair::operators::duplicates::remove_duplicates;
use crate::repair::operators::face_pairs::Pairing;
use crate::repair::operators::free_positions::{key, round_to_f32};
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

/// The number of intersecting faces from which a face belongs to a dense cluster.
const DENSE_PARTNERS: u32 = 32;
/// The number of dense pairs from which clusters are snapped first.
const MIN_DENSE_PAIRS: usize = 2_000;

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
    /// The number of edges whose sheets could not be separated by position.
    pub pinched: u64,
    /// The surface after the round.
    pub surface: Surface,
    /// The largest displacement by the perturbation, in the model's unit.
    pub perturbed: f64,
}

impl Best {
    /// The sort key of a result: lower is better.
    fn rank(&self) -> (bool, u64) {
        (self.pinched > 0, self.pairs + self.pinched)
    }
}

/// The counts over all rounds.
#[derive(Default)]
pub(super) struct Totals {
    /// Vertices snapped to a grid.
    pub snapped: u64,
    /// Vertices merged with neighbours.
    pub merged: u64,
    /// Zero-thickness faces that got a thickness.
    pub thickened: u64,
    /// Faces around opened regions that got a thickness.
    pub opened: u64,
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
    searched: SearchedMesh,
    best: Option<Best>,
    /// The surface with the fewest intersecting pairs, and their number: used only where no round ended without any.
    crossing: Option<(u64, Surface)>,
    /// The fewest intersecting pairs and the fewest faces so far.
    fewest: [u64; 2],
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
        Self { settings, engine, context, totals, searched, best: None, crossing: None, fewest: [u64::MAX; 2] }
    }

    /// Runs all rounds.
    ///
    /// # Errors
    /// [`ArrangeError`] where no round gives a result.
    pub fn run(&mut self, mut work: Surface) -> Result<Best, ArrangeError> {
        let max_pieces = MAX_PIECES.max(MAX_PIECES_PER_FACE * work.faces.len());
        for grid in GRIDS.into_iter().map(Some).chain([None]) {
            self.context.check()?;
            let first = self.best.is_none() && self.crossing.is_none();
            let known_positions: FxHashSet<[u64; 3]> = work.positions.iter().map(|&p| position_key(p)).collect();
            work = match self.arrange(&mut work, first) {
                Ok(solid) if solid.surface.faces.len() > max_pieces => {
                    let error =
                        format!("the faces split into {} pieces, more than the limit", solid.surface.faces.len());
                    return Err(ArrangeError::Failed(error));
                }
                Ok(solid) => solid.surface,
                Err(error @ ArrangeError::Cancelled(_)) => return Err(error),
                Err(error) if first => return Err(error),
                Err(_) => break,
            };
            self.round_new(&mut work, &known_positions)?;
            self.searched = crossings(&work, Some(&self.searched), self.context)?;
            let intersections = &self.searched.intersections;
            let pairs = count(intersections);
            let [mut takes_part, _] = intersections.takes_part.clone();
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
        }
        match (self.best.take(), self.crossing.take()) {
            (Some(best), _) => Ok(best),
            (None, Some((pairs, work))) => Ok(self.perturb(&work, pairs, &mut vec![false; work.faces.len()])?),
            (None, None) => Err(ArrangeError::Failed("each coarser grid gave more intersections or faces".to_owned())),
        }
    }

    /// Computes the arrangement. In the first round zero-thickness facets become thin solids and are arranged again.
    fn arrange(&mut self, work: &mut Surface, first: bool) -> Result<Solid, ArrangeError> {
        let sheets = self.settings.sheets.filter(|_| first);
        let rule = Rule { winding_rule: self.settings.winding_rule, reopens_patches: sheets.is_some() };
        let mut solid = arranged(self.engine, work, rule, self.context)?;
        let Some(thickness) =
            sheets.filter(|_| !(solid.zero_thickness.faces.is_empty() && solid.opened.faces.is_empty()))
        else {
            return Ok(solid);
        };
        if let Some(thick) = thickened(&solid, thickness, self.context)? {
            self.totals.thickened = solid.zero_thickness.faces.len() as u64;
            self.totals.opened = solid.opened.faces.len() as u64;
            if self.totals.opened > 0 {
                // The opened surface has none of the patches that closed the region.
                *work = std::mem::take(&mut solid.surface);
            }
            append(work, thick);
        }
        arranged(self.engine, work, self.settings.winding_rule.into(), self.context)
    }

    /// Rounds the positions that are not in `known_positions`, and merges vertices that readers would merge.
    fn round_new(&mut self, work: &mut Surface, known_positions: &FxHashSet<[u64; 3]>) -> Result<(), Cancelled> {
        let is_new = |p| !known_positions.contains(&position_key(p));
        self.totals.merged += round_without_contact(work, is_new, self.context)?.merged;
        settle(work, self.context)?;
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
    fn compare(&mut self, work: &Surface, pairs: u64, takes_part: &mut [bool]) -> Result<bool, Cancelled> {
        if pairs > 0 {
            if self.crossing.as_ref().is_none_or(|(fewest, _)| pairs < *fewest) {
                self.crossing = Some((pairs, work.clone()));
            }
            return Ok(false);
        }
        let result = self.perturb(work, pairs, takes_part)?;
        let is_separated = result.pinched == 0;
        if self.best.as_ref().is_none_or(|best| result.rank() < best.rank()) {
            self.best = Some(result);
        }
        Ok(is_separated)
    }

    /// Perturbs sheets that a reader of STL would merge, and marks the faces where that failed.
    fn perturb(&self, work: &Surface, pairs: u64, takes_part: &mut [bool]) -> Result<Best, Cancelled> {
        let mut surface = work.clone();
        let perturbed = Perturb { max_deviation: self.settings.max_deviation }.apply(&mut surface, self.context)?.moved;
        let pairs = if surface == *work {
            pairs
        } else {
            count(&crossings(&surface, Some(&self.searched), self.context)?.intersections)
        };
        let pinched = mark_pinched(&surface, work, takes_part);
        Ok(Best { pairs, pinched, surface, perturbed })
    }
}

/// The boundary of the volume that a surface encloses.
fn arranged(
    engine: &dyn Arrangement,
    surface: &Surface,
    rule: Rule,
    context: &Context<'_>,
) -> Result<Solid, ArrangeError> {
    engine.solid(ClosedSurface::try_from(surface)?, rule, context)
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
            append(&mut all, thick);
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

/// Converts a count of vertices to the index of the next vertex.
#[expect(clippy::cast_possible_truncation, reason = "vertices are counted in u32")]
pub(super) fn index(count: usize) -> u32 {
    count as u32
}

/// Appends the vertices and faces of `other`.
pub(super) fn append(surface: &mut Surface, other: Surface) {
    let first = index(surface.positions.len());
    surface.positions.extend(other.positions);
    surface.faces.extend(other.faces.iter().map(|face| face.map(|v| v + first)));
    surface.source.extend(other.source);
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

/// Marks the faces at edges that, merged by position, have more than two faces. Returns the number of such edges.
fn mark_pinched(perturbed: &Surface, work: &Surface, takes_part: &mut [bool]) -> u64 {
    let mut welded = perturbed.clone();
    weld_exactly(&mut welded);
    let edges = Edges::new(&welded.faces);
    let mut pinched: FxHashSet<[u64; 3]> = FxHashSet::default();
    let mut count = 0;
    for half_edges in edges.iter().filter(|half_edges| half_edges.len() > 2) {
        pinched.extend(
            Edges::ends(&welded.faces, half_edges[0]).iter().map(|&v| position_key(welded.positions[v as usize])),
        );
        count += 1;
    }
    if count > 0 {
        for (face, takes) in work.faces.iter().zip(takes_part) {
            *takes |= face.iter().any(|&v| pinched.contains(&position_key(work.positions[v as usize])));
        }
    }
    count
}

/// Finds the faces that intersect. Faces that `earlier` has too are not tested against each other again.
pub(super) fn crossings(
    surface: &Surface,
    earlier: Option<&SearchedMesh>,
    context: &Context<'_>,
) -> Result<SearchedMesh, Cancelled> {
    SearchedMesh::search(&surface.to_soup(), earlier, context)
}

/// The number of face pairs that intersect.
pub(super) fn count(intersections: &Intersections) -> u64 {
    intersections.counts.pairs.unwrap_or(0)
}

/// The step of a grid with `2^bits` steps up to the largest coordinate.
pub(super) fn grid_step(surface: &Surface, bits: i32) -> f64 {
    let bounds = surface.bounds();
    let largest = bounds.min.abs().max(bounds.max.abs()).max_element();
    #[expect(clippy::cast_possible_truncation, reason = "an exponent")]
    2f64.powi(largest.log2().ceil() as i32 - bits)
}

/// Snaps the vertices of the marked faces to a grid, and with them every vertex in the same cells. A coordinate in which all
/// corners of a face agree stays, so that axis-aligned surface stays flat. Returns the number of moved vertices and the
/// largest displacement.
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

/// Marks the faces of dense clusters: faces that intersect many faces which are dense too. `None` where too few pairs are
/// dense to matter.
pub(super) fn dense_faces(intersections: &Intersections) -> Option<Vec<bool>> {
    let [takes_part, _] = &intersections.takes_part;
    let mut partners = vec![0u32; takes_part.len()];
    for pair in &intersections.pairs {
        pair.faces.iter().for_each(|&f| partners[f as usize] += 1);
    }
    let is_dense = |f: u32| partners[f as usize] >= DENSE_PARTNERS;
    let mut dense = vec![false; takes_part.len()];
    let mut count = 0;
    for pair in intersections.pairs.iter().filter(|pair| pair.faces.iter().all(|&f| is_dense(f))) {
        pair.faces.iter().for_each(|&f| dense[f as usize] = true);
        count += 1;
    }
    (count >= MIN_DENSE_PAIRS).then_some(dense)
}
