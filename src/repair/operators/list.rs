//! The table of all operators: connects each name with the code that implements the operator.
//!
//! Other operator files do not import this file, so operators cannot depend on one another through the table.

use std::sync::Arc;

use super::operator::{Applied, Counter, Counts, Operation, Scope};
use super::{
    base, clean_and_patch, cut_non_orientable, debris, degenerate, duplicates, fill_interior, foldovers, holes,
    internal_faces, islands, join, orient, perturb, remesh, rounding, self_union, slivers, split_non_manifold, stitch,
    t_junctions, thicken, thicken_walls, voids, weld,
};
use crate::mesh::{Edges, Surface};
use crate::repair::{Cancelled, Context, Operator};

/// Forwards [`Operator`]'s methods to the implementing types.
macro_rules! operations {
    ($($name:ident => $operation:ty,)*) => {
        impl Operator {
            /// The counters that the operator claims to lower. The operator must not raise any of them.
            #[must_use]
            pub fn fixes(self) -> &'static [Counter] {
                match self {
                    $(Self::$name => <$operation>::FIXES,)*
                }
            }

            /// The counters that the operator may raise: a later operator lowers them, or they are the lesser defect.
            #[must_use]
            pub fn may_raise(self) -> &'static [Counter] {
                match self {
                    $(Self::$name => <$operation>::MAY_RAISE,)*
                }
            }

            /// The counters of which one must be above 0 for the operator to change anything; empty if counters don't tell.
            #[must_use]
            pub fn acts_on(self) -> &'static [Counter] {
                match self {
                    $(Self::$name => <$operation>::ACTS_ON,)*
                }
            }

            /// Whether plans omit the operator unless the option `with` names it.
            #[must_use]
            pub fn is_on_request(self) -> bool {
                match self {
                    $(Self::$name => <$operation>::IS_ON_REQUEST,)*
                }
            }

            /// Whether the operator changes a sound model because an option asks for the change.
            pub(crate) fn changes_sound_model(self) -> bool {
                match self {
                    $(Self::$name => <$operation>::CHANGES_SOUND_MODEL,)*
                }
            }

            /// Whether the operator takes so much memory that the edges of the surface are better not kept meanwhile.
            pub(crate) fn is_heavy(self) -> bool {
                match self {
                    $(Self::$name => <$operation>::IS_HEAVY,)*
                }
            }

            /// Runs the operator on `surface`, which has these `edges`.
            ///
            /// # Errors
            /// [`Cancelled`] when the work should stop; the surface may then be half changed.
            pub(crate) fn run(
                self,
                scope: &Scope<'_>,
                surface: &mut Arc<Surface>,
                edges: Arc<Edges>,
                context: &Context<'_>,
            ) -> Result<Applied, Cancelled> {
                match self {
                    $(Self::$name => <$operation>::with_scope(scope, surface).run_shared(surface, edges, context),)*
                }
            }
        }
    };
}

operations! {
    RoundCoordinates => rounding::RoundCoordinates,
    RemoveCollapsedFaces => degenerate::RemoveCollapsedFaces,
    MergeVertices => weld::MergeVertices,
    Weld => weld::Weld,
    RemoveDuplicates => duplicates::RemoveDuplicates,
    RemoveCaps => degenerate::RemoveCaps,
    RemoveSlivers => slivers::RemoveSlivers,
    Orient => orient::OrientInRepair<'_>,
    SplitTJunctions => t_junctions::SplitTJunctions,
    Sew => weld::Sew,
    Stitch => stitch::Stitch,
    UnfoldFoldovers => foldovers::UnfoldFoldovers,
    RemoveOverlappingNeighbours => foldovers::RemoveOverlappingNeighbours,
    RemoveInternalSheets => internal_faces::RemoveInternalSheets<'_>,
    RemoveInternalFaces => internal_faces::RemoveInternalFaces,
    CutNonOrientable => cut_non_orientable::CutNonOrientable,
    SplitNonManifold => split_non_manifold::SplitNonManifold,
    DetachFins => split_non_manifold::DetachFins,
    JoinParts => join::JoinParts,
    FillHoles => holes::FillHoles,
    CleanAndPatch => clean_and_patch::CleanAndPatch,
    ThickenSheets => thicken::ThickenSheets,
    AddBase => base::AddBase,
    SelfUnion => self_union::SelfUnion,
    Remesh => remesh::RemeshInside,
    RemoveDebris => debris::RemoveDebris,
    Perturb => perturb::Perturb,
    DropSmallParts => debris::DropSmallParts,
    TreatIslands => islands::TreatIslands,
    FillInterior => fill_interior::FillInterior,
    ThickenWalls => thicken_walls::ThickenWalls,
    FillVoids => voids::FillVoids,
    VentVoids => voids::VentVoids,
    Simplify => remesh::ReduceFaces,
}

impl Operator {
    /// Whether the counts of a surface show that the operator would change nothing.
    pub(crate) fn is_needless(self, counts: &Counts) -> bool {
        let acts_on = self.acts_on();
        !acts_on.is_empty() && acts_on.iter().all(|&counter| counts.get(counter) == 0)
    }

    /// The first counter that rose against the operator's claims, with its value before and after.
    pub(crate) fn broken_claim(self, before: &Counts, after: &Counts) -> Option<(Counter, u64, u64)> {
        let rose = |counter: &Counter| after.get(*counter) > before.get(*counter);
        let fixed_rose = self.fixes().iter().find(|c| rose(c));
        let broken = fixed_rose.or_else(|| Counter::ALL.iter().find(|c| rose(c) && !self.may_raise().contains(c)));
        broken.map(|&counter| (counter, before.get(counter), after.get(counter)))
    }
}
