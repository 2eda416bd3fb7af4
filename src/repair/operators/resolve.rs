//! Intersections resolved, and kept resolved after rounding.

use glam::DVec3;
use rustc_hash::FxHashSet;

use super::cut::{Pairing, Pinches, cut_apart};
use super::degenerate::{remove_caps, remove_collapsed};
use super::orient::Orient;
use super::places::key;
use super::quantise::{quantise, rounded};
use super::rounding::round_apart;
use super::separate::Separate;
use super::thicken::{Skins, ThickenSheets};
use super::{Counter, Counts};

use crate::arrange::{ArrangeError, Arrangement, Inside, Solid};
use crate::inspect::{Analysis, intersections};
use crate::math::Box3;
use crate::mesh::{Edges, Parts, Surface, weld_exactly};
use crate::repair::{Cancelled, Change, Context};

/// Bits of the grid, over the largest coordinate, to which the vertices of faces that still intersect after rounding are
/// moved, round by round.
const GRIDS: [i32; 5] = [22, 20, 18, 16, 14];

/// Rounds end where pairs of faces that intersect, or faces, are so many times the fewest before: what is resolved then
/// comes back as more.
const GROWTH: u64 = 4;

/// Resolves faces that intersect.
#[derive(Debug, Clone, Copy)]
pub struct Resolve {
    /// What is inside.
    pub inside: Inside,
    /// No vertex is moved farther than this, in the model's unit, to stay clear of others after rounding.
    pub most: f64,
    /// The thickness that walls of none get, in the model's unit; none: they go.
    pub flaps: Option<f64>,
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
    /// moved to ever coarser grids and the arrangement is made again (after the snap rounding of Valque and Lazard). Leaves: the surface as it was where it is not closed,
    /// nothing intersects, or the arrangement fails; pairs that stay after the coarsest grid.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply(
        &self,
        surface: &mut Surface,
        by: &dyn Arrangement,
        context: &Context<'_>,
    ) -> Result<Resolved, Cancelled> {
        if !is_balanced(surface) {
            return Ok(Resolved { error: Some(ArrangeError::NotClosed), ..Resolved::default() });
        }
        let (before, _) = crossing_faces(surface, context)?;
        if before == 0 {
            return Ok(Resolved::default());
        }
        let faces_before = surface.faces.len() as u64;
        let parts_before = Parts::new(surface, &Edges::new(&surface.faces)).count as u64;
        let mut work = surface.clone();
        let mut best: Option<((bool, u64), u64, Surface, f64)> = None;
        let (mut snapped, mut merged, mut thickened, mut moved) = (0, 0, 0, 0.0f64);
        let mut fewest = [u64::MAX; 2];
        for grid in GRIDS.into_iter().map(Some).chain([None]) {
            context.check()?;
            let known: FxHashSet<[u64; 3]> = work.positions.iter().map(bits).collect();
            let mut made = by.solid(&work, self.inside, context);
            if let (Some(thickness), Ok(Solid { flaps, .. })) = (self.flaps, &made)
                && best.is_none()
                && add_thick(&mut work, flaps, thickness, context)?
            {
                thickened = flaps.faces.len() as u64;
                made = by.solid(&work, self.inside, context);
            }
            let made = match made {
                Ok(made) => made.surface,
                Err(ArrangeError::Cancelled(stop)) => return Err(stop),
                Err(error) if best.is_none() => {
                    return Ok(Resolved { pairs_left: before, error: Some(error), ..Resolved::default() });
                }
                Err(_) => break,
            };
            work = made;
            merged += round_apart(&mut work, |p| !known.contains(&bits(&p)), context)?.merged;
            settle(&mut work, context)?;
            let (pairs, mut takes_part) = crossing_faces(&work, context)?;
            let grown = [pairs, work.faces.len() as u64];
            if grown.iter().zip(fewest).any(|(&now, fewest)| now / GROWTH > fewest) {
                break;
            }
            fewest = [0, 1].map(|k| fewest[k].min(grown[k]));
            let mut apart = work.clone();
            let aside = Separate { most: self.most }.apply(&mut apart, context)?.moved;
            let pairs_apart = if apart == work { pairs } else { crossing_faces(&apart, context)?.0 };
            let pinched = mark_pinched(&apart, &work, &mut takes_part);
            let rank = (pinched > 0, pairs_apart + pinched);
            if best.as_ref().is_none_or(|(least, ..)| rank < *least) {
                best = Some((rank, pairs_apart, apart, aside));
            }
            let Some(bits) = grid.filter(|_| pairs > 0 || pinched > 0) else { break };
            let step = grid_step(&work, bits);
            // Rounding to a grid moves by at most half a step along each axis.
            if step > self.most {
                break;
            }
            let (count, far) = snap(&mut work, &takes_part, step);
            snapped += count;
            moved += far;
        }
        let Some((_, pairs_left, result, aside)) = best else { return Ok(Resolved::default()) };
        moved += aside;
        // Half done it must at least be closed: faces that intersect are the lesser evil.
        if pairs_left > 0 && !is_manifold_by_position(&result) {
            let error =
                ArrangeError::Failed("rounding left faces that intersect and edges of more than two faces".to_owned());
            return Ok(Resolved { pairs_left: before, error: Some(error), ..Resolved::default() });
        }
        *surface = result;
        let parts = |surface: &Surface| Parts::new(surface, &Edges::new(&surface.faces)).count as u64;
        let united = parts_before.saturating_sub(parts(surface));
        let changes = Change::list([
            ("parts_united", united),
            ("intersecting_pairs_resolved", before.saturating_sub(pairs_left)),
            ("faces_cut", faces_before),
            ("faces_made", surface.faces.len() as u64),
            ("vertices_snapped", snapped),
            ("vertices_merged", merged),
            ("faces_without_thickness_thickened", thickened),
        ]);
        Ok(Resolved { changes, moved, pairs_left, error: None })
    }
}

impl Resolve {
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
        all.changes = Change::list([("faces_cut", cut), ("faces_made", made)]);
        if cut > 0 {
            *surface = whole;
        }
        all.pairs_left = crossing_faces(surface, context)?.0;
        Ok(all)
    }
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

/// Adds walls of no thickness to a surface as thin solids, those around which they are the middle. Whether there were any.
fn add_thick(surface: &mut Surface, flaps: &Surface, thickness: f64, context: &Context<'_>) -> Result<bool, Cancelled> {
    let mut thick = flaps.clone();
    let thicken =
        ThickenSheets { thickness: Some(thickness), skins: Skins::BothSides, most: f64::INFINITY, to_f32: true };
    // What is one wall may be cut from faces that look either way.
    Orient::default().apply(&mut thick, context)?;
    cut_apart(&mut thick, Pairing::Angular, Pinches::Cut, context)?;
    let applied = thicken.apply(&mut thick, context)?;
    if applied.changes.is_empty() {
        return Ok(false);
    }
    append(surface, thick);
    Ok(true)
}

/// A position, to be compared.
fn bits(p: &DVec3) -> [u64; 3] {
    p.to_array().map(f64::to_bits)
}

/// Cleans what rounding made of the smallest faces.
fn settle(surface: &mut Surface, context: &Context<'_>) -> Result<(), Cancelled> {
    remove_collapsed(surface);
    super::duplicates::remove_duplicates(surface);
    remove_caps(surface, context)?;
    surface.drop_unreferenced();
    Ok(())
}

/// Whether each edge is used as often in one direction as in the other, which every arrangement asks for.
fn is_balanced(surface: &Surface) -> bool {
    let forward = |h: &&u32| Edges::is_forward(&surface.faces, **h);
    Edges::new(&surface.faces)
        .iter()
        .all(|half_edges| 2 * half_edges.iter().filter(forward).count() == half_edges.len())
}

/// Whether a reader of STL would find every edge between two faces that agree, and one fan at every vertex.
fn is_manifold_by_position(surface: &Surface) -> bool {
    let mut welded = surface.clone();
    quantise(&mut welded);
    weld_exactly(&mut welded);
    let counts = Counts::of(&welded);
    use Counter::{BoundaryEdges, MisorientedEdges, NonmanifoldEdges, PinchedVertices};
    [BoundaryEdges, MisorientedEdges, NonmanifoldEdges, PinchedVertices].iter().all(|&c| counts.get(c) == 0)
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
        at.extend(Edges::ends(&welded.faces, half_edges[0]).iter().map(|&v| bits(&welded.positions[v as usize])));
        count += 1;
    }
    if count > 0 {
        for (face, takes) in work.faces.iter().zip(takes_part) {
            *takes |= face.iter().any(|&v| at.contains(&bits(&work.positions[v as usize])));
        }
    }
    count
}

/// How many pairs of faces intersect, and which faces take part.
fn crossing_faces(surface: &Surface, context: &Context<'_>) -> Result<(u64, Vec<bool>), Cancelled> {
    let soup = surface.to_soup();
    let analysis = Analysis::new((&soup).into(), context)?;
    let found = intersections(&analysis, context)?;
    let [takes_part, _] = found.takes_part;
    Ok((found.counts.pairs.unwrap_or(0), takes_part))
}

/// The step of the grid of `2^bits` steps over the largest coordinate.
fn grid_step(surface: &Surface, bits: i32) -> f64 {
    let bounds = Box3::of(surface.positions.iter().copied());
    let largest = bounds.min.abs().max(bounds.max.abs()).max_element();
    #[expect(clippy::cast_possible_truncation, reason = "an exponent")]
    2f64.powi(largest.log2().ceil() as i32 - bits)
}

/// Moves the vertices of faces to a grid, and with them all vertices of the same cells. A coordinate in which a whole face agrees
/// stays, so that surface along the axes stays flat. Answers how many moved, and how far at most.
fn snap(surface: &mut Surface, takes_part: &[bool], step: f64) -> (u64, f64) {
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
        let q = rounded((p / step).round() * step);
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
