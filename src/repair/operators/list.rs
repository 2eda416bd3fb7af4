//! The list of all operators: what each claims, and how it is run.

use super::names::Operator;
use super::operator::{Applied, Counter, Counts, Operation, Scope};
use super::{
    base, clean_and_patch, cut_non_orientable, debris, degenerate, duplicates, foldovers, holes, internal_faces, join,
    orient, perturb, remesh, rounding, self_union, slivers, split_non_manifold, stitch, t_junctions, thicken, weld,
};
use crate::mesh::Surface;
use crate::repair::{Cancelled, Context};

/// Makes the operators what the files of their own say of them.
macro_rules! operations {
    ($($name:ident => $operation:ty,)*) => {
        impl Operator {
            /// What it claims to fix. None of these may rise by it.
            #[must_use]
            pub fn fixes(self) -> &'static [Counter] {
                match self {
                    $(Self::$name => <$operation>::FIXES,)*
                }
            }

            /// What may rise by it, since a later operator takes it up or since it is the lesser evil.
            #[must_use]
            pub fn may_raise(self) -> &'static [Counter] {
                match self {
                    $(Self::$name => <$operation>::MAY_RAISE,)*
                }
            }

            /// Whether a plan leaves it out unless the options ask for it with `with`.
            #[must_use]
            pub fn is_on_request(self) -> bool {
                match self {
                    $(Self::$name => <$operation>::IS_ON_REQUEST,)*
                }
            }

            /// Runs the operator.
            ///
            /// # Errors
            /// [`Cancelled`]; the surface may then be half done.
            pub(crate) fn run(
                self,
                scope: &Scope<'_>,
                surface: &mut Surface,
                context: &Context<'_>,
            ) -> Result<Applied, Cancelled> {
                match self {
                    $(Self::$name => <$operation>::with_scope(scope, surface).run(surface, context),)*
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
    Orient => orient::Orient,
    SplitTJunctions => t_junctions::SplitTJunctions,
    Sew => weld::Sew,
    Stitch => stitch::Stitch,
    UnfoldFoldovers => foldovers::UnfoldFoldovers,
    RemoveOverlappingNeighbours => foldovers::RemoveOverlappingNeighbours,
    RemoveInternalSheets => internal_faces::RemoveInternalSheets,
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
    Simplify => remesh::ReduceFaces,
}

impl Operator {
    /// The first counter that rose though it must not, with what it was and became.
    pub(crate) fn broken_claim(self, before: &Counts, after: &Counts) -> Option<(Counter, u64, u64)> {
        let rose = |counter: &Counter| after.get(*counter) > before.get(*counter);
        let claimed = self.fixes().iter().find(|c| rose(c));
        let found = claimed.or_else(|| Counter::ALL.iter().find(|c| rose(c) && !self.may_raise().contains(c)));
        found.map(|&counter| (counter, before.get(counter), after.get(counter)))
    }
}
