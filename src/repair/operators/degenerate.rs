//! Removes faces without area.

use std::collections::HashSet;

use glam::DVec3;

use super::operator::{Applied, Counter, Operation, Scope};
use super::slivers::RemoveSlivers;
use crate::math::{area_vanishes, collinear, index_of_middle, threads, to_unit_range};
use crate::mesh::{Edges, Surface};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// The face height, as a share of the bounding box's diagonal, below which f64 finds no area. The relative error of the cross
/// product of two sides is a few units of 2^-52.
const MIN_HEIGHT: f64 = 1e-14;

/// The most passes over the mesh. Each pass removes one layer of stacked caps; no real model has more layers.
const MAX_PASSES: usize = 64;

/// Removes faces with a repeated vertex. Their half-edges cancel, so no boundary appears.
pub fn remove_collapsed(surface: &mut Surface) -> Vec<Change> {
    let keep: Vec<bool> = surface.faces.iter().map(|&[a, b, c]| a != b && b != c && c != a).collect();
    Change::list([(ChangeKind::CollapsedFacesRemoved, surface.retain_faces(&keep))])
}

/// Removes faces without area: exactly collinear ones with [`remove_caps`]. If f64 finds no area for further faces, it removes
/// all faces that thin with [`RemoveSlivers`]. No vertex moves farther than `max_deviation`, in the model's unit.
///
/// # Errors
/// [`Cancelled`] when the work should stop; the surface may then be half changed.
pub fn remove_without_area(
    surface: &mut Surface,
    max_deviation: f64,
    context: &Context<'_>,
) -> Result<Applied, Cancelled> {
    let mut applied = Applied::from(remove_caps(surface, context)?);
    let unit = to_unit_range(&surface.positions);
    let vanishes = |face: usize| {
        let [a, b, c] = surface.faces[face].map(|v| unit[v as usize]);
        area_vanishes(a, b, c) && !collinear(a, b, c)
    };
    if threads::count(surface.faces.len(), vanishes) > 0 {
        let thin = RemoveSlivers { tolerance: MIN_HEIGHT, max_deviation }.apply(surface, context)?;
        applied.changes.extend(thin.changes);
        (applied.moved, applied.left) = (thin.moved, thin.left);
    }
    Ok(applied)
}

/// Removes faces whose three distinct corners are collinear, without opening the surface or moving a vertex.
///
/// The middle corner `m` lies on the long edge. An edge flip splits the face beyond that edge at `m`. Since `m` lies on the
/// edge, the surface keeps its shape. Where there is no face beyond the edge, the cap is removed; also where there are
/// several and the cap's short edges are free.
///
/// ```text
///        m                     m
///    a-------b             a-------b
///     \     /       ->      \  |  /
///      \   /                 \ | /
///        d                     d
/// ```
///
/// Where the face beyond is a cap on the same edge, the flip gives two caps with shorter long edges; later passes remove them.
///
/// Precondition: no face with a repeated vertex. Result: the number of faces without area never rises. Leaves, counted as
/// degenerate: other faces whose long edge has more than two faces, and faces where the edge from `m` to `d` exists already and
/// would get a third face.
///
/// # Errors
/// [`Cancelled`] when the work should stop; finished flips stay.
pub fn remove_caps(surface: &mut Surface, context: &Context<'_>) -> Result<Vec<Change>, Cancelled> {
    let unit = to_unit_range(&surface.positions);
    let (mut flipped, mut dropped) = (0u64, 0u64);
    #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
    let cap = |f: usize| is_collinear(&unit, surface.faces[f]).then_some(f as u32);
    let mut caps = threads::filter_map(surface.faces.len(), cap);
    let mut keep = vec![true; surface.faces.len()];
    for _ in 0..MAX_PASSES {
        context.check()?;
        if caps.is_empty() {
            break;
        }
        let mut pass = Pass::new(surface, &unit, &keep, &caps);
        let before = (flipped, dropped);
        for &cap in &caps {
            let face = surface.faces[cap as usize];
            let middle = index_of_middle(face.map(|v| unit[v as usize]));
            let [m, a, b] = [face[middle], face[(middle + 1) % 3], face[(middle + 2) % 3]];
            let Some(long) = pass.edges.find(a, b) else { continue };
            match *pass.edges.half_edges(long) {
                [x, y] => flipped += u64::from(pass.flip(surface, cap, [x, y], [m, a, b])),
                ref at_long if (at_long.len() == 1 || pass.is_fin([m, a, b])) && pass.touched.insert(cap) => {
                    keep[cap as usize] = false;
                    dropped += 1;
                }
                _ => {}
            }
        }
        if (flipped, dropped) == before {
            break;
        }
        caps.extend(pass.touched);
        caps.retain(|&f| keep[f as usize] && is_collinear(&unit, surface.faces[f as usize]));
        caps.sort_unstable();
        caps.dedup();
    }
    surface.retain_faces(&keep);
    Ok(Change::list([
        (ChangeKind::DegenerateFacesFlipped, flipped),
        (ChangeKind::DegenerateFacesRemoved, dropped),
        (ChangeKind::DegenerateFacesLeft, caps.len() as u64),
    ]))
}

/// Whether the corners are exactly collinear.
fn is_collinear(unit: &[DVec3], face: [u32; 3]) -> bool {
    let [a, b, c] = face.map(|v| unit[v as usize]);
    collinear(a, b, c)
}

/// One pass over the caps, in which each face is changed at most once.
struct Pass<'a> {
    unit: &'a [DVec3],
    /// The faces at the caps' corners: only their edges matter, and they are few.
    near: Vec<u32>,
    /// The edges of these faces.
    edges: Edges,
    touched: HashSet<u32>,
    /// Edges that flips created, smaller vertex first.
    new_edges: HashSet<(u32, u32)>,
}

impl<'a> Pass<'a> {
    fn new(surface: &Surface, unit: &'a [DVec3], keep: &[bool], caps: &[u32]) -> Self {
        let mut at_cap = vec![false; surface.positions.len()];
        caps.iter().for_each(|&cap| surface.faces[cap as usize].iter().for_each(|&v| at_cap[v as usize] = true));
        let is_near = |&(f, face): &(u32, &[u32; 3])| keep[f as usize] && face.iter().any(|&v| at_cap[v as usize]);
        let (near, faces): (Vec<u32>, Vec<[u32; 3]>) = (0u32..).zip(&surface.faces).filter(is_near).unzip();
        Self { unit, near, edges: Edges::new(&faces), touched: HashSet::new(), new_edges: HashSet::new() }
    }

    /// Whether only the cap itself has the two short edges of a cap with the middle corner `m`.
    fn is_fin(&self, [m, a, b]: [u32; 3]) -> bool {
        let is_free = |v: u32| self.edges.find(m, v).is_some_and(|edge| self.edges.half_edges(edge).len() == 1);
        is_free(a) && is_free(b)
    }

    /// Flips the long edge `a`, `b` of a cap with the middle corner `m`, where possible; `pair` holds the edge's half-edges.
    fn flip(&mut self, surface: &mut Surface, cap: u32, pair: [u32; 2], [m, a, b]: [u32; 3]) -> bool {
        let [f, g] = pair.map(|h| self.near[h as usize / 3]);
        let beyond = if f == cap { g } else { f };
        let other = surface.faces[beyond as usize];
        let Some(d) = other.into_iter().find(|&v| v != a && v != b) else { return false };
        let new_edge = (m.min(d), m.max(d));
        if d == m
            || self.touched.contains(&cap)
            || self.touched.contains(&beyond)
            || (is_collinear(self.unit, other) && other[index_of_middle(other.map(|v| self.unit[v as usize]))] != d)
            || self.edges.find(m, d).is_some()
            || !self.new_edges.insert(new_edge)
        {
            return false;
        }
        self.touched.extend([cap, beyond]);
        let with_m_for = |gone: u32| other.map(|v| if v == gone { m } else { v });
        surface.faces[beyond as usize] = with_m_for(a);
        surface.faces[cap as usize] = with_m_for(b);
        surface.source[cap as usize] = surface.source[beyond as usize];
        true
    }
}

/// Removes faces that use the same vertex twice.
#[derive(Debug, Clone, Copy)]
pub struct RemoveCollapsedFaces;

impl Operation<'_> for RemoveCollapsedFaces {
    const FIXES: &'static [Counter] = &[Counter::DegenerateFaces];
    const MAY_RAISE: &'static [Counter] = &[];
    const ACTS_ON: &'static [Counter] = &[Counter::DegenerateFaces];

    fn with_scope(_scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self
    }

    fn run(&self, surface: &mut Surface, _context: &Context<'_>) -> Result<Applied, Cancelled> {
        Ok(remove_collapsed(surface).into())
    }
}

/// Removes faces without area, whose corners are collinear or nearly collinear.
#[derive(Debug, Clone, Copy)]
pub struct RemoveCaps {
    max_deviation: f64,
}

impl Operation<'_> for RemoveCaps {
    const FIXES: &'static [Counter] = &[Counter::DegenerateFaces];
    // Removing a cap on the boundary replaces one boundary edge by two.
    const MAY_RAISE: &'static [Counter] = &[Counter::BoundaryEdges];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self { max_deviation: scope.max_deviation }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        remove_without_area(surface, self.max_deviation, context)
    }
}
