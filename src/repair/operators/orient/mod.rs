//! Consistent and outward winding.

mod outward;

use glam::DVec3;

use crate::inspect::{doubled_areas, nesting, solids};
use crate::mesh::{Edges, Parts, Surface};
use crate::repair::operators::operator::{Applied, Counter, Operation, Scope};
use crate::repair::{Cancelled, Change, ChangeKind, Context};
use outward::{Layers, Looks, Nest, Outside, keep_what_is_surrounded, keep_what_was_balanced};

pub use super::names::Nested;

const NONE: u32 = u32::MAX;
/// Weight of one edge in conflict; how well its faces agree in direction adds up to [`FLAT`] and so only decides ties.
const EDGE: i64 = 1 << 20;
const FLAT: f64 = 255.0;
/// Faces that may be turned one by one in a patch with conflicts, for each of its faces.
const TURNS_A_FACE: usize = 64;

/// Turns faces so that neighbours agree and solids look outward.
///
/// ```text
///    +->---+          +->---+       +--<------+          +-->------+
///    |     v          |     v       |  +->-+  |          |  +-<-+  |
///    ^     ^    ->    ^     v       v  ^   v  ^    ->    ^  v   ^  v
///    +-<---+          +-<---+       |  +-<-+  |          |  +->-+  |
///                                   +-->------+          +--<------+
/// ```
///
/// 1. Within each patch (faces joined across edges of two faces) the winding is carried from face to face; the side
///    that holds more area as it was stays, and the rest is turned.
/// 2. A closed patch is decided by the sign of its volume and the closed patches that it lies in: at even depth it is
///    turned outward. At odd depth it is a cavity where it looks inward, and else a solid of its own that overlaps the
///    one around it; which of the two is kept or made is [`Nested`]. The cavity of a solid that was inside out as a whole
///    is turned with it.
/// 3. An open patch, and a closed one whose depth can't be told, is turned when most of the area of its largest faces sees
///    the outside, by exact rays, at its back. A sheet alone stays as it is, and so does what lies in a solid, unless layers
///    are to alternate; and so do open patches that meet in edges of several faces, where those were crossed as often one way
///    as the other and would not be any more.
///
/// Precondition: none. Result: every edge of two faces is crossed once in each direction, unless the patch is
/// one-sided like a Möbius band. No vertex moves and no face goes. Leaves: edges of more than two faces as they are,
/// and the conflicts of one-sided patches, of which there are never more than before and which are counted as
/// `orientation_conflicts_left` (see [`super::cut_non_orientable`]).
///
/// After *recalc normals* of Mesh Heal, with votes by area as Takayama et al. 2014, "A Simple Method for Correcting Facet
/// Orientations in Polygon Meshes Based on Ray Casting", have them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Orient {
    /// How parts that lie in others are wound. Default: as they were.
    pub nested: Nested,
}

impl Orient {
    /// Runs the operator.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; whole stages that are done stay done.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let edges = Edges::new(&surface.faces);
        let areas = doubled_areas(surface);
        let agreement = agree(surface, &edges, &areas, context)?;
        let turned = turn_faces(surface, &agreement.turn);
        let edges = if turned > 0 { Edges::new(&surface.faces) } else { edges };
        let patches = Parts::patches(surface, &edges);
        let solids = solids(surface, &edges, &patches);
        let all = vec![true; solids.len()];
        let containers = nesting(surface, &patches, &solids, &all, context)?;
        let nest = Nest { solids: &solids, containers: &containers };
        let mut layers = Layers::new(nest, self.nested);
        let asked: Vec<bool> = solids.iter().zip(&containers).map(|(s, c)| !s.closed || c.is_none()).collect();
        let (mut untold, mut sheets) = (0u64, 0u64);
        let mut is_untold = vec![false; solids.len()];
        if asked.contains(&true) {
            let closed: Vec<bool> = solids.iter().map(|s| s.closed).collect();
            let outside = Outside { surface, patches: &patches, asked: &asked, closed: &closed, areas: &areas };
            let mut rays = outside.rays();
            let looks = outside.looks(self.nested, &mut rays, context)?;
            for (patch, looks) in looks.into_iter().enumerate().filter(|&(patch, _)| asked[patch]) {
                layers.turn[patch] = looks == Looks::Inward;
                if looks == Looks::Untold {
                    is_untold[patch] = true;
                    *(if closed[patch] { &mut untold } else { &mut sheets }) += 1;
                }
            }
            if self.nested == Nested::Keep && layers.turn.contains(&true) {
                keep_what_is_surrounded(&outside, &mut rays, nest, &mut layers, context)?;
                keep_what_was_balanced(surface, &edges, &patches, &solids, &mut layers);
            }
        }
        let turn = layers.turn;
        let turned_of =
            |closed: bool| turn.iter().zip(&solids).filter(|(t, s)| **t && s.closed == closed).count() as u64;
        let (closed_turned, open_turned) = (turned_of(true), turned_of(false));
        let of_patch = |&p: &u32| p != Parts::NONE && turn[p as usize];
        let turn: Vec<bool> = patches.of_face.iter().map(of_patch).collect();
        turn_faces(surface, &turn);
        let mut unfixed: Vec<u32> = (0u32..)
            .zip(&patches.of_face)
            .filter(|&(_, &patch)| patch != Parts::NONE && is_untold[patch as usize])
            .map(|(f, _)| f)
            .collect();
        if agreement.conflicts > 0 {
            unfixed.extend(in_conflict(surface, &edges));
        }
        let changes = Change::list([
            (ChangeKind::FacesFlipped, turned),
            (ChangeKind::ClosedPartsFlipped, closed_turned),
            (ChangeKind::OpenPartsFlipped, open_turned),
            (ChangeKind::CavitiesKept, layers.cavities_kept),
            (ChangeKind::SolidsInsideSolids, layers.solids_inside_solids),
            (ChangeKind::OrientationConflictsLeft, agreement.conflicts),
        ]);
        let left = in_words(&[
            (agreement.one_sided, "one-sided", "no winding suits all neighbours"),
            (untold, "closed", "inside or outside of others could not be told, so the winding is kept"),
            (sheets, "open", "neither side is the outer one, so the winding of most of the area is kept"),
        ]);
        Ok(Applied { changes, left, unfixed, ..Applied::default() })
    }
}

/// The faces at edges of two faces that run along them in the same direction.
fn in_conflict(surface: &Surface, edges: &Edges) -> Vec<u32> {
    let faces = &surface.faces;
    let at_edge = |half_edges: &[u32]| match *half_edges {
        [x, y] if Edges::is_forward(faces, x) == Edges::is_forward(faces, y) => [Some(x / 3), Some(y / 3)],
        _ => [None, None],
    };
    edges.iter().flat_map(at_edge).flatten().collect()
}

/// What was left, where anything was: how many parts of which kind, and why.
fn in_words(kinds: &[(u64, &str, &str)]) -> Option<String> {
    let told: Vec<String> = kinds
        .iter()
        .filter(|(count, ..)| *count > 0)
        .map(|(count, kind, why)| format!("{count} {kind} {}: {why}", if *count == 1 { "part" } else { "parts" }))
        .collect();
    (!told.is_empty()).then(|| told.join("; "))
}

impl Operation for Orient {
    const FIXES: &'static [Counter] = &[Counter::MisorientedEdges];
    const MAY_RAISE: &'static [Counter] = &[];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self { nested: scope.options.nested }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}

/// Which faces to turn so that neighbours agree.
pub(super) struct Agreement {
    pub turn: Vec<bool>,
    /// Edges of two faces that still disagree: those along which one-sided patches would have to be cut.
    pub conflicts: u64,
    /// Patches with such edges.
    pub one_sided: u64,
}

/// Which faces to turn so that each patch (faces joined across edges of two faces) agrees with the larger area.
///
/// A one-sided patch can't agree everywhere. Of two ways to turn its faces, by carrying the winding from face to face
/// and by leaving all as they are, each first bettered by turning single faces, the one with fewer edges in conflict is
/// taken, and of equals the one whose conflicts lie on the sharper folds. So there are never more than before.
pub(super) fn agree(
    surface: &Surface,
    edges: &Edges,
    areas: &[f64],
    context: &Context<'_>,
) -> Result<Agreement, Cancelled> {
    let across = Across::new(surface, edges);
    let faces = surface.faces.len();
    let mut agreement = Agreement { turn: vec![false; faces], conflicts: 0, one_sided: 0 };
    let turn = &mut agreement.turn;
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
        let (mut at, mut agrees) = (0, true);
        while at < patch.len() {
            let f = patch[at];
            at += 1;
            for (g, same) in across.of(f) {
                if !seen[g] {
                    seen[g] = true;
                    turn[g] = turn[f] ^ same;
                    patch.push(g);
                } else {
                    agrees &= turn[g] == turn[f] ^ same;
                }
            }
        }
        if !agrees {
            let carried = across.better(surface, &patch, turn, context)?;
            let found: Vec<bool> = patch.iter().map(|&f| std::mem::take(&mut turn[f])).collect();
            let kept = across.better(surface, &patch, turn, context)?;
            if carried <= kept {
                for (&f, found) in patch.iter().zip(found) {
                    turn[f] = found;
                }
            }
            #[expect(clippy::cast_sign_loss, reason = "a sum of weights")]
            {
                agreement.conflicts += (carried.min(kept) / EDGE) as u64;
            }
            agreement.one_sided += 1;
        }
        let area = |turned: bool| patch.iter().filter(|&&f| turn[f] == turned).map(|&f| areas[f]).sum::<f64>();
        if area(true) > area(false) {
            for &f in &patch {
                turn[f] = !turn[f];
            }
        }
    }
    Ok(agreement)
}

/// For each half-edge the face across an edge of two faces and whether the two run the same way, packed as
/// `2 * face + same`.
struct Across(Vec<u32>);

impl Across {
    fn new(surface: &Surface, edges: &Edges) -> Self {
        let faces = &surface.faces;
        let mut across = vec![NONE; faces.len() * 3];
        for half_edges in edges.iter() {
            if let &[x, y] = half_edges {
                let same = u32::from(Edges::is_forward(faces, x) == Edges::is_forward(faces, y));
                across[x as usize] = (y / 3) << 1 | same;
                across[y as usize] = (x / 3) << 1 | same;
            }
        }
        Self(across)
    }

    /// The neighbours of a face, and whether it must be turned against each.
    fn of(&self, f: usize) -> impl Iterator<Item = (usize, bool)> {
        self.0[3 * f..3 * f + 3].iter().filter(|&&p| p != NONE).map(|&p| ((p >> 1) as usize, p & 1 == 1))
    }

    /// Turns single faces of a patch as long as that lowers the weight of its edges in conflict, which is answered.
    fn better(
        &self,
        surface: &Surface,
        patch: &[usize],
        turn: &mut [bool],
        context: &Context<'_>,
    ) -> Result<i64, Cancelled> {
        let normal = |f: usize| DVec3::normalize_or_zero(surface.area_vector(f));
        #[expect(clippy::cast_possible_truncation, reason = "between 0 and 255")]
        let weight = |f: usize, g: usize, same: bool| {
            let cosine = normal(f).dot(normal(g)) * if same { -1.0 } else { 1.0 };
            EDGE + ((1.0 + cosine).clamp(0.0, 2.0) * 0.5 * FLAT) as i64
        };
        let disagree = |turn: &[bool], f: usize, g: usize, same: bool| turn[g] != turn[f] ^ same;
        let in_conflict = |turn: &[bool], f: usize| self.of(f).any(|(g, same)| disagree(turn, f, g, same));
        let mut next: Vec<usize> = patch.iter().rev().copied().filter(|&f| in_conflict(turn, f)).collect();
        let mut turns = 0;
        while let Some(f) = next.pop().filter(|_| turns < TURNS_A_FACE * patch.len()) {
            let gain: i64 = self
                .of(f)
                .map(|(g, same)| if disagree(turn, f, g, same) { weight(f, g, same) } else { -weight(f, g, same) })
                .sum();
            if gain > 0 {
                turn[f] = !turn[f];
                turns += 1;
                if turns % 4096 == 0 {
                    context.check()?;
                }
                next.extend(self.of(f).map(|(g, _)| g));
            }
        }
        let left = |f: usize| -> i64 {
            self.of(f)
                .filter(|&(g, same)| f < g && disagree(turn, f, g, same))
                .map(|(g, same)| weight(f, g, same))
                .sum()
        };
        Ok(patch.iter().map(|&f| left(f)).sum())
    }
}

/// Turns the faces that are marked. Answers how many.
pub(super) fn turn_faces(surface: &mut Surface, turn: &[bool]) -> u64 {
    let mut turned = 0;
    for (face, _) in surface.faces.iter_mut().zip(turn).filter(|(_, t)| **t) {
        face.swap(1, 2);
        turned += 1;
    }
    turned
}
