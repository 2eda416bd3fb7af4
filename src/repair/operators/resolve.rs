//! Intersections resolved, and kept resolved after rounding.

use super::degenerate::{remove_caps, remove_collapsed};
use super::quantise::{quantise, rounded};
use super::separate::Separate;
use super::{Counter, Counts};
use crate::arrange::{ArrangeError, Arrangement, Inside};
use crate::inspect::{Analysis, intersections};
use crate::math::Box3;
use crate::mesh::{Edges, Parts, Surface, weld_exactly};
use crate::repair::{Cancelled, Change, Context};

/// Bits of the grid, over the largest coordinate, to which the vertices of faces that still intersect after rounding are
/// moved, round by round.
const GRIDS: [i32; 4] = [22, 20, 17, 14];

/// Resolves faces that intersect.
#[derive(Debug, Clone, Copy)]
pub struct Resolve {
    /// What is inside.
    pub inside: Inside,
    /// No vertex is moved farther than this, in the model's unit, to stay clear of others after rounding.
    pub most: f64,
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
    /// Precondition: closed and consistently wound. Result: no two faces intersect when the positions are rounded to f32 and
    /// welded; where rounding makes faces intersect again, their vertices are moved to ever coarser grids and the arrangement
    /// is made again (after the snap rounding of Valque and Lazard). Leaves: the surface as it was where it is not closed,
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
        let mut best: Option<(u64, Surface)> = None;
        let (mut snapped, mut moved) = (0, 0.0f64);
        for grid in GRIDS.into_iter().map(Some).chain([None]) {
            context.check()?;
            let made = match by.solid(&work, self.inside, context) {
                Ok(made) => made,
                Err(ArrangeError::Cancelled(stop)) => return Err(stop),
                Err(error) if best.is_none() => {
                    return Ok(Resolved { pairs_left: before, error: Some(error), ..Resolved::default() });
                }
                Err(_) => break,
            };
            work = made;
            moved = moved.max(settle(&mut work, self.most, context)?);
            let (pairs, takes_part) = crossing_faces(&work, context)?;
            if best.as_ref().is_none_or(|(least, _)| pairs < *least) {
                best = Some((pairs, work.clone()));
            }
            let Some(bits) = grid.filter(|_| pairs > 0) else { break };
            let step = grid_step(&work, bits);
            // Rounding to a grid moves by at most half a step along each axis.
            if step > self.most {
                break;
            }
            let (count, far) = snap(&mut work, &takes_part, step);
            snapped += count;
            moved += far;
        }
        let Some((pairs_left, result)) = best else { return Ok(Resolved::default()) };
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
        ]);
        Ok(Resolved { changes, moved, pairs_left, error: None })
    }
}

/// Rounds to f32 and cleans what rounding made of the smallest faces; then keeps sheets apart. Answers how far vertices moved for that.
fn settle(surface: &mut Surface, most: f64, context: &Context<'_>) -> Result<f64, Cancelled> {
    quantise(surface);
    remove_collapsed(surface);
    super::duplicates::remove_duplicates(surface);
    remove_caps(surface, context)?;
    surface.drop_unreferenced();
    Ok(Separate { most }.apply(surface, context)?.moved)
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

/// Moves the vertices of faces to a grid. Answers how many moved, and how far at most.
fn snap(surface: &mut Surface, takes_part: &[bool], step: f64) -> (u64, f64) {
    let (mut moved, mut far) = (0, 0.0f64);
    let mut done = vec![false; surface.positions.len()];
    for (face, _) in surface.faces.iter().zip(takes_part).filter(|(_, t)| **t) {
        for &v in face {
            let p = &mut surface.positions[v as usize];
            if !std::mem::replace(&mut done[v as usize], true) {
                let q = rounded((*p / step).round() * step);
                moved += u64::from(q != *p);
                far = far.max(p.distance(q));
                *p = q;
            }
        }
    }
    weld_exactly(surface);
    remove_collapsed(surface);
    (moved, far)
}
