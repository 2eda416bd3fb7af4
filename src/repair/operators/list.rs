use super::{
    Applied, Counter, Counts, Operation, Scope, base, clean_and_patch, cut, debris, degenerate, duplicates, fins,
    foldovers, holes, join, membranes, merge, one_sided, orient, overlaps, remesh, resolve, rounding, separate, sew,
    sheets_within, simplify, slivers, small_parts, stitch, t_junctions, thicken, weld,
};
use crate::mesh::Surface;
pub use crate::repair::options::Operator;
use crate::repair::{Cancelled, Context};

/// Tells for each operator what its own file says of it.
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
            pub(in crate::repair) fn run(
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
    MergeVertices => merge::MergeVertices,
    Weld => weld::Weld,
    RemoveDuplicates => duplicates::RemoveDuplicates,
    RemoveCaps => degenerate::RemoveCaps,
    RemoveSlivers => slivers::RemoveSlivers,
    Orient => orient::Orient,
    SplitTJunctions => t_junctions::SplitTJunctions,
    Sew => sew::Sew,
    Stitch => stitch::Stitch,
    UnfoldFoldovers => foldovers::UnfoldFoldovers,
    RemoveOverlappingNeighbours => overlaps::RemoveOverlappingNeighbours,
    RemoveSheetsWithin => sheets_within::RemoveSheetsWithin,
    RemoveMembranes => membranes::RemoveMembranes,
    CutOneSided => one_sided::CutOneSided,
    CutApart => cut::CutApart,
    FreeFins => fins::FreeFins,
    JoinParts => join::JoinParts,
    FillHoles => holes::FillHoles,
    CleanAndPatch => clean_and_patch::CleanAndPatch,
    ThickenSheets => thicken::ThickenSheets,
    AddBase => base::AddBase,
    Resolve => resolve::ResolveOverlaps,
    Remesh => remesh::RemeshInside,
    RemoveDebris => debris::RemoveDebris,
    Separate => separate::Separate,
    DropSmallParts => small_parts::DropSmallParts,
    Simplify => simplify::ReduceFaces,
}

impl Operator {
    /// The first counter that rose though it must not, with what it was and became.
    pub(in crate::repair) fn broken_claim(self, before: &Counts, after: &Counts) -> Option<(Counter, u64, u64)> {
        let rose = |counter: &Counter| after.get(*counter) > before.get(*counter);
        let claimed = self.fixes().iter().find(|c| rose(c));
        let found = claimed.or_else(|| Counter::ALL.iter().find(|c| rose(c) && !self.may_raise().contains(c)));
        found.map(|&counter| (counter, before.get(counter), after.get(counter)))
    }
}
