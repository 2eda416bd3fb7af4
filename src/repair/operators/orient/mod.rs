//! Makes winding consistent within patches and outward for solids.
//!
//! This file makes neighbours agree; `outward.rs` decides which side of a patch is the outer one.

mod outward;

use std::sync::Arc;

use glam::DVec3;

use crate::inspect::{Analysis, doubled_areas, nesting, solids};
use crate::math::threads;
use crate::mesh::{Edges, Parts, Surface};
use crate::repair::operators::operator::{Applied, Counter, Operation, Scope, as_shared};
use crate::repair::{Cancelled, Change, ChangeKind, Context};
use outward::{Facing, Layers, Nesting, PatchFacing, keep_balanced_patches, keep_surrounded_patches};

pub use crate::repair::options::Nested;

/// The value that stands for no neighbour.
const NONE: u32 = u32::MAX;
/// The weight of one edge in conflict. The flatness at the edge adds at most [`MAX_FLATNESS`], so it only breaks ties.
const CONFLICT_WEIGHT: i64 = 1 << 20;
const MAX_FLATNESS: f64 = 255.0;
/// The most flips of single faces in a patch with conflicts, for each of its faces.
const MAX_FLIPS_PER_FACE: usize = 64;

/// Flips faces so that neighbours agree and solids face outward.
///
/// ```text
///    +->---+          +->---+       +--<------+          +-->------+
///    |     v          |     v       |  +->-+  |          |  +-<-+  |
///    ^     ^    ->    ^     v       v  ^   v  ^    ->    ^  v   ^  v
///    +-<---+          +-<---+       |  +-<-+  |          |  +->-+  |
///                                   +-->------+          +--<------+
/// ```
///
/// 1. Within each patch (faces joined across edges with two faces) the winding spreads from face to face. The winding with
///    the larger area stays, and the other faces are flipped.
/// 2. A closed patch is decided by the sign of its volume and by the closed patches around it. At even depth it is flipped
///    outward. At odd depth an inward patch is a cavity, and an outward patch is a separate solid that overlaps the solid
///    around it; [`Nested`] chooses which of the two is kept or made. If a whole solid was inverted, its cavity flips
///    with it.
/// 3. An open patch, or a closed one of unknown depth, is decided by exact rays from its largest faces. The patch is flipped
///    if most of their area has the outside behind it. A single sheet stays as it is. So does a patch inside a solid, unless layers
///    alternate. So do open patches that meet in non-manifold edges, where flipping would unbalance the edges' directions.
///
/// Precondition: none. Result: every edge with two faces is traversed once in each direction, unless the patch is
/// non-orientable like a Möbius band. No vertex moves and no face goes. Leaves: non-manifold edges; the conflicts of
/// non-orientable patches, which never increase and are counted as `orientation_conflicts_left` (see
/// [`super::cut_non_orientable`]).
///
/// After *recalc normals* of Mesh Heal. The votes by area follow Takayama et al. 2014, "A Simple Method for Correcting Facet
/// Orientations in Polygon Meshes Based on Ray Casting".
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Orient {
    /// How closed parts inside other parts are wound. Default: kept.
    pub nested: Nested,
}

impl Orient {
    /// Runs the operator on `surface`.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; finished stages stay.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply_knowing(None, surface, context)
    }

    /// [`Orient::apply`], faster if the surface has the triangles of a `known` mesh.
    ///
    /// # Errors
    /// As [`Orient::apply`].
    pub(crate) fn apply_knowing(
        &self,
        known: Option<&Analysis<'_>>,
        surface: &mut Surface,
        context: &Context<'_>,
    ) -> Result<Applied, Cancelled> {
        let edges = Arc::new(Edges::new(&surface.faces));
        as_shared(surface, |surface| self.apply_shared(surface, edges, known, context))
    }

    /// [`Orient::apply_knowing`] to a surface with these `edges`.
    fn apply_shared(
        &self,
        surface: &mut Arc<Surface>,
        edges: Arc<Edges>,
        known: Option<&Analysis<'_>>,
        context: &Context<'_>,
    ) -> Result<Applied, Cancelled> {
        let areas = doubled_areas(surface);
        let winding = consistent_winding(surface, &edges, &areas, context)?;
        let flipped = flip_marked(surface, &winding.flip);
        let edges = if flipped > 0 { Arc::new(Edges::new(&surface.faces)) } else { edges };
        let patches = Parts::patches(surface, &edges);
        let solids = solids(surface, &edges, &patches);
        let all = vec![true; solids.len()];
        let containers = nesting(surface, &patches, &solids, &all, context)?;
        let nesting_of_patches = Nesting { solids: &solids, containers: &containers };
        let mut layers = Layers::new(nesting_of_patches, self.nested);
        let selected: Vec<bool> = solids.iter().zip(&containers).map(|(s, c)| !s.closed || c.is_none()).collect();
        let (mut undecided, mut sheets) = (0u64, 0u64);
        let mut is_undecided = vec![false; solids.len()];
        if selected.contains(&true) {
            let closed: Vec<bool> = solids.iter().map(|s| s.closed).collect();
            let votes =
                PatchFacing { surface, patches: &patches, selected: &selected, closed: &closed, areas: &areas, known };
            let mut rays = votes.rays();
            let facings = votes.facings(self.nested, &mut rays, context)?;
            for (patch, facing) in facings.into_iter().enumerate().filter(|&(patch, _)| selected[patch]) {
                layers.flip[patch] = facing == Facing::Inward;
                if facing == Facing::Undecided {
                    is_undecided[patch] = true;
                    *(if closed[patch] { &mut undecided } else { &mut sheets }) += 1;
                }
            }
            if self.nested == Nested::Keep && layers.flip.contains(&true) {
                keep_surrounded_patches(&votes, &mut rays, nesting_of_patches, &mut layers, context)?;
                keep_balanced_patches(surface, &edges, &patches, &solids, &mut layers);
            }
        }
        let flip = layers.flip;
        let count = |closed: bool| flip.iter().zip(&solids).filter(|(f, s)| **f && s.closed == closed).count() as u64;
        let (closed_flipped, open_flipped) = (count(true), count(false));
        let of_patch = |&p: &u32| p != Parts::NONE && flip[p as usize];
        let flip: Vec<bool> = patches.of_face.iter().map(of_patch).collect();
        flip_marked(surface, &flip);
        let mut unfixed: Vec<u32> = (0u32..)
            .zip(&patches.of_face)
            .filter(|&(_, &patch)| patch != Parts::NONE && is_undecided[patch as usize])
            .map(|(f, _)| f)
            .collect();
        if winding.conflicts > 0 {
            unfixed.extend(faces_in_conflict(surface, &edges));
        }
        let changes = Change::list([
            (ChangeKind::FacesFlipped, flipped),
            (ChangeKind::ClosedPartsFlipped, closed_flipped),
            (ChangeKind::OpenPartsFlipped, open_flipped),
            (ChangeKind::CavitiesKept, layers.cavities_kept),
            (ChangeKind::SolidsInsideSolids, layers.solids_inside_solids),
            (ChangeKind::OrientationConflictsLeft, winding.conflicts),
        ]);
        let left = unfixed_note(&[
            (winding.non_orientable, "non-orientable", "no winding suits all neighbouring faces"),
            (undecided, "closed", "inside or outside other parts is undecided, so the winding was kept"),
            (sheets, "open", "neither side is the outer side, so the winding of most of the area was kept"),
        ]);
        Ok(Applied { changes, left, unfixed, ..Applied::default() })
    }
}

/// The faces at edges whose two faces traverse them in the same direction.
fn faces_in_conflict(surface: &Surface, edges: &Edges) -> Vec<u32> {
    let in_conflict = edges.iter().filter(|half_edges| is_in_conflict(surface, half_edges));
    in_conflict.flatten().map(|half_edge| half_edge / 3).collect()
}

/// Whether an edge has two faces, which traverse it in the same direction.
fn is_in_conflict(surface: &Surface, half_edges: &[u32]) -> bool {
    let is_forward = |half_edge: u32| Edges::is_forward(&surface.faces, half_edge);
    matches!(*half_edges, [x, y] if is_forward(x) == is_forward(y))
}

/// The note on unfixed parts: their number, their kind and the reason. `None` where every part was fixed.
fn unfixed_note(kinds: &[(u64, &str, &str)]) -> Option<String> {
    let notes: Vec<String> = kinds
        .iter()
        .filter(|(count, ..)| *count > 0)
        .map(|(count, kind, reason)| format!("{count} {kind} {}: {reason}", if *count == 1 { "part" } else { "parts" }))
        .collect();
    (!notes.is_empty()).then(|| notes.join("; "))
}

/// [`Orient`] in a repair, where most of the surface is still that of the input.
pub(super) struct OrientInRepair<'a> {
    orient: Orient,
    input: &'a Analysis<'a>,
}

impl<'a> Operation<'a> for OrientInRepair<'a> {
    const FIXES: &'static [Counter] = &[Counter::MisorientedEdges];
    const MAY_RAISE: &'static [Counter] = &[];

    fn with_scope(scope: &Scope<'a>, _surface: &Surface) -> Self {
        Self { orient: Orient { nested: scope.options.nested }, input: scope.input }
    }

    fn run_shared(
        &self,
        surface: &mut Arc<Surface>,
        edges: Arc<Edges>,
        context: &Context<'_>,
    ) -> Result<Applied, Cancelled> {
        self.orient.apply_shared(surface, edges, Some(self.input), context)
    }
}

/// Which faces to flip so that neighbours agree.
pub(super) struct ConsistentWinding {
    /// For each face whether to flip it.
    pub flip: Vec<bool>,
    /// Edges with two faces that still disagree: a non-orientable patch must be split along them.
    pub conflicts: u64,
    /// Patches with such edges.
    pub non_orientable: u64,
}

/// Decides which faces to flip so that each patch (faces joined across edges with two faces) agrees with its larger area.
///
/// A non-orientable patch cannot agree everywhere. Two starting points are tried: the winding spread from face to face, and
/// the input. Flipping single faces improves each. The result with fewer conflicts wins, and of equals the one with its
/// conflicts on sharper folds. So conflicts never increase.
pub(super) fn consistent_winding(
    surface: &Surface,
    edges: &Edges,
    areas: &[f64],
    context: &Context<'_>,
) -> Result<ConsistentWinding, Cancelled> {
    let faces = surface.faces.len();
    let mut winding = ConsistentWinding { flip: vec![false; faces], conflicts: 0, non_orientable: 0 };
    if threads::count(edges.len(), |edge| is_in_conflict(surface, edges.half_edges(edge))) == 0 {
        return Ok(winding);
    }
    let neighbours = FaceNeighbours::new(surface, edges);
    let flip = &mut winding.flip;
    let mut seen = vec![false; faces];
    let mut patch = Vec::new();
    for first in 0..faces {
        if first % 4096 == 0 {
            context.check()?;
        }
        if seen[first] {
            continue;
        }
        seen[first] = true;
        patch.clear();
        patch.push(first);
        let (mut at, mut is_consistent) = (0, true);
        while at < patch.len() {
            let f = patch[at];
            at += 1;
            for (g, same) in neighbours.of(f) {
                if !seen[g] {
                    seen[g] = true;
                    flip[g] = flip[f] ^ same;
                    patch.push(g);
                } else {
                    is_consistent &= flip[g] == flip[f] ^ same;
                }
            }
        }
        if !is_consistent {
            let spread = neighbours.improve(surface, &patch, flip, context)?;
            let spread_flips: Vec<bool> = patch.iter().map(|&f| std::mem::take(&mut flip[f])).collect();
            let kept = neighbours.improve(surface, &patch, flip, context)?;
            if spread <= kept {
                for (&f, spread_flip) in patch.iter().zip(spread_flips) {
                    flip[f] = spread_flip;
                }
            }
            #[expect(clippy::cast_sign_loss, reason = "a sum of weights")]
            {
                winding.conflicts += (spread.min(kept) / CONFLICT_WEIGHT) as u64;
            }
            winding.non_orientable += 1;
        }
        let area = |flipped: bool| patch.iter().filter(|&&f| flip[f] == flipped).map(|&f| areas[f]).sum::<f64>();
        if area(true) > area(false) {
            for &f in &patch {
                flip[f] = !flip[f];
            }
        }
    }
    Ok(winding)
}

/// For each half-edge of an edge with two faces the other face, packed as `2 * face + same`. `same` is 1 where both faces
/// traverse the edge in the same direction.
struct FaceNeighbours(Vec<u32>);

impl FaceNeighbours {
    fn new(surface: &Surface, edges: &Edges) -> Self {
        let mut neighbours = vec![NONE; surface.faces.len() * 3];
        for half_edges in edges.iter() {
            if let &[x, y] = half_edges {
                let same = u32::from(is_in_conflict(surface, half_edges));
                neighbours[x as usize] = (y / 3) << 1 | same;
                neighbours[y as usize] = (x / 3) << 1 | same;
            }
        }
        Self(neighbours)
    }

    /// The neighbours of a face, and whether each must be flipped relative to the face.
    fn of(&self, f: usize) -> impl Iterator<Item = (usize, bool)> {
        self.0[3 * f..3 * f + 3].iter().filter(|&&p| p != NONE).map(|&p| ((p >> 1) as usize, p & 1 == 1))
    }

    /// Flips single faces of a patch while that lowers the weight of its edges in conflict. Returns the remaining weight.
    fn improve(
        &self,
        surface: &Surface,
        patch: &[usize],
        flip: &mut [bool],
        context: &Context<'_>,
    ) -> Result<i64, Cancelled> {
        let normal = |f: usize| DVec3::normalize_or_zero(surface.area_vector(f));
        #[expect(clippy::cast_possible_truncation, reason = "between 0 and 255")]
        let weight = |f: usize, g: usize, same: bool| {
            let cosine = normal(f).dot(normal(g)) * if same { -1.0 } else { 1.0 };
            CONFLICT_WEIGHT + ((1.0 + cosine).clamp(0.0, 2.0) * 0.5 * MAX_FLATNESS) as i64
        };
        let disagree = |flip: &[bool], f: usize, g: usize, same: bool| flip[g] != flip[f] ^ same;
        let faces_in_conflict = |flip: &[bool], f: usize| self.of(f).any(|(g, same)| disagree(flip, f, g, same));
        let mut next: Vec<usize> = patch.iter().rev().copied().filter(|&f| faces_in_conflict(flip, f)).collect();
        let mut flips = 0;
        while let Some(f) = next.pop().filter(|_| flips < MAX_FLIPS_PER_FACE * patch.len()) {
            let gain: i64 = self
                .of(f)
                .map(|(g, same)| if disagree(flip, f, g, same) { weight(f, g, same) } else { -weight(f, g, same) })
                .sum();
            if gain > 0 {
                flip[f] = !flip[f];
                flips += 1;
                if flips % 4096 == 0 {
                    context.check()?;
                }
                next.extend(self.of(f).map(|(g, _)| g));
            }
        }
        let left = |f: usize| -> i64 {
            self.of(f)
                .filter(|&(g, same)| f < g && disagree(flip, f, g, same))
                .map(|(g, same)| weight(f, g, same))
                .sum()
        };
        Ok(patch.iter().map(|&f| left(f)).sum())
    }
}

/// [`flip_faces`] of a surface that others may share, which is copied only if a face is marked.
fn flip_marked(surface: &mut Arc<Surface>, flip: &[bool]) -> u64 {
    if flip.contains(&true) { flip_faces(Arc::make_mut(surface), flip) } else { 0 }
}

/// Flips the marked faces. Returns their number.
pub(super) fn flip_faces(surface: &mut Surface, flip: &[bool]) -> u64 {
    let mut flipped = 0;
    for (face, _) in surface.faces.iter_mut().zip(flip).filter(|(_, t)| **t) {
        face.swap(1, 2);
        flipped += 1;
    }
    flipped
}
