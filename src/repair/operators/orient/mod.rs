//! Consistent and outward winding.

mod agree;
mod layers;
mod outside;

use crate::inspect::{doubled_areas, nesting, solids};
use crate::mesh::{Edges, Parts, Surface};
use crate::repair::operators::operator::{Applied, Operation, Scope};
use crate::repair::operators::topology::Counter;
use crate::repair::{Cancelled, Change, ChangeKind, Context};

pub use super::names::Nested;
pub(super) use agree::{agree, turn_faces};
use layers::{Layers, Nest, keep_what_is_surrounded, keep_what_was_balanced};
use outside::{Looks, Outside};

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
            (ChangeKind::FacesTurned, turned),
            (ChangeKind::ClosedPartsTurned, closed_turned),
            (ChangeKind::OpenPartsTurned, open_turned),
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
