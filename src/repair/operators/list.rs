use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{
    Applied, Counter, Counts, Operation, Scope, base, clean_and_patch, cut, debris, degenerate, duplicates, fins,
    foldovers, holes, join, membranes, merge, one_sided, orient, overlaps, remesh, resolve, rounding, separate, sew,
    sheets_within, simplify, slivers, small_parts, stitch, t_junctions, thicken, weld,
};
use crate::mesh::Surface;
use crate::repair::{Cancelled, Context};

/// Makes the names of the operators, each with what its own file says of it.
macro_rules! operators {
    ($(#[doc = $about:literal])* pub enum $all:ident { $($(#[doc = $doc:literal])* $name:ident = $text:literal => $operation:ty,)* }) => {
        $(#[doc = $about])*
        #[derive(
            Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, ToSchema, clap::ValueEnum,
        )]
        #[serde(rename_all = "snake_case")]
        #[value(rename_all = "snake_case")]
        pub enum $all {
            $($(#[doc = $doc])* $name,)*
        }

        impl $all {
            /// Every operator, in the order in which they usually run.
            pub const ALL: &[Self] = &[$(Self::$name),*];

            /// The name used in JSON and on the command line.
            #[must_use]
            pub fn as_str(self) -> &'static str {
                match self {
                    $(Self::$name => $text,)*
                }
            }

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

operators! {
    /// The operators by name: what a plan lists, what the options switch on and off, and what the report accounts for.
    pub enum Operator {
        /// Round coordinates to those that STL can hold.
        RoundCoordinates = "round_coordinates" => rounding::RoundCoordinates,
        /// Drop faces with the same vertex twice.
        RemoveCollapsedFaces = "remove_collapsed_faces" => degenerate::RemoveCollapsedFaces,
        /// Merge vertices closer than `merge_distance`, on the boundary or not.
        MergeVertices = "merge_vertices" => merge::MergeVertices,
        /// Merge boundary vertices that almost coincide.
        Weld = "weld" => weld::Weld,
        /// Drop faces with the same three vertices, and walls of no thickness.
        RemoveDuplicates = "remove_duplicates" => duplicates::RemoveDuplicates,
        /// Remove faces without area, whose corners lie on a line or nearly.
        RemoveCaps = "remove_caps" => degenerate::RemoveCaps,
        /// Collapse short edges and flip away faces that are almost without area.
        RemoveSlivers = "remove_slivers" => slivers::RemoveSlivers,
        /// Make the winding of neighbours agree, and turn solids outward.
        Orient = "orient" => orient::Orient,
        /// Cut boundary edges at the vertices that lie on them.
        SplitTJunctions = "split_t_junctions" => t_junctions::SplitTJunctions,
        /// Merge boundary vertices that are close for the edges around them.
        Sew = "sew" => sew::Sew,
        /// Close cracks whose sides have different vertices.
        Stitch = "stitch" => stitch::Stitch,
        /// Flip the edges at which surface is folded onto itself.
        UnfoldFoldovers = "unfold_foldovers" => foldovers::UnfoldFoldovers,
        /// Remove the smaller of neighbouring faces that lie on one another.
        RemoveOverlappingNeighbours = "remove_overlapping_neighbours" => overlaps::RemoveOverlappingNeighbours,
        /// Remove open sheets within solids that part nothing.
        RemoveSheetsWithin = "remove_sheets_within" => sheets_within::RemoveSheetsWithin,
        /// Remove walls of one sheet within solids.
        RemoveMembranes = "remove_membranes" => membranes::RemoveMembranes,
        /// Cut one-sided parts, such as a Möbius band, along the edges where no winding suits both faces.
        CutOneSided = "cut_one_sided" => one_sided::CutOneSided,
        /// Cut apart what meets in non-manifold edges and vertices.
        CutApart = "cut_apart" => cut::CutApart,
        /// Free faces that hang on an edge of two others and could not be cut apart.
        FreeFins = "free_fins" => fins::FreeFins,
        /// Join open parts where their boundaries come nearest.
        JoinParts = "join_parts" => join::JoinParts,
        /// Close holes.
        FillHoles = "fill_holes" => holes::FillHoles,
        /// Remove what is bad with growing rings around it, and close the holes, while that makes it better.
        CleanAndPatch = "clean_and_patch" => clean_and_patch::CleanAndPatch,
        /// Give open sheets a thickness.
        ThickenSheets = "thicken_sheets" => thicken::ThickenSheets,
        /// Extrude open sheets down to a plane.
        AddBase = "add_base" => base::AddBase,
        /// Unite what overlaps, so that no faces intersect.
        Resolve = "resolve" => resolve::ResolveOverlaps,
        /// Make the surface anew around what is inside.
        Remesh = "remesh" => remesh::RemeshInside,
        /// Remove open bits that enclose nothing and that no printer could make.
        RemoveDebris = "remove_debris" => debris::RemoveDebris,
        /// Keep apart by position what was cut apart by index.
        Separate = "separate" => separate::Separate,
        /// Drop closed parts smaller than `min_part_volume_pct`.
        DropSmallParts = "drop_small_parts" => small_parts::DropSmallParts,
        /// Remove faces by collapsing edges, as far as the options ask for it.
        Simplify = "simplify" => simplify::ReduceFaces,
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_operator_has_one_name_everywhere() {
        for &operator in Operator::ALL {
            assert_eq!(serde_json::to_value(operator).ok(), Some(operator.as_str().into()));
            let value = clap::ValueEnum::to_possible_value(&operator);
            assert_eq!(value.map(|value| value.get_name().to_owned()).as_deref(), Some(operator.as_str()));
        }
    }
}
