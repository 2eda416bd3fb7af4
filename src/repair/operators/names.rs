//! The names by which options and reports know the operators, and the modes of some.

use serde::{Deserialize, Serialize};

/// Makes the names of the operators.
macro_rules! operators {
    ($(#[doc = $about:literal])* pub enum $all:ident { $($(#[doc = $doc:literal])* $name:ident = $text:literal,)* }) => {
        $(#[doc = $about])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
        #[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
        #[serde(rename_all = "snake_case")]
        #[cfg_attr(feature = "clap", value(rename_all = "snake_case"))]
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
        }
    };
}

operators! {
    /// The operators by name: what a plan lists, what the options switch on and off, and what the report accounts for.
    pub enum Operator {
        /// Round coordinates to those that STL can hold.
        RoundCoordinates = "round_coordinates",
        /// Drop faces with the same vertex twice.
        RemoveCollapsedFaces = "remove_collapsed_faces",
        /// Merge vertices closer than `merge_distance`, on the boundary or not.
        MergeVertices = "merge_vertices",
        /// Merge boundary vertices that almost coincide.
        Weld = "weld",
        /// Drop faces with the same three vertices, and walls of no thickness.
        RemoveDuplicates = "remove_duplicates",
        /// Remove faces without area, whose corners lie on a line or nearly.
        RemoveCaps = "remove_caps",
        /// Collapse short edges and flip away faces that are almost without area.
        RemoveSlivers = "remove_slivers",
        /// Make the winding of neighbours agree, and turn solids outward.
        Orient = "orient",
        /// Cut boundary edges at the vertices that lie on them.
        SplitTJunctions = "split_t_junctions",
        /// Merge boundary vertices that are close for the edges around them.
        Sew = "sew",
        /// Close cracks whose sides have different vertices.
        Stitch = "stitch",
        /// Flip the edges at which surface is folded onto itself.
        UnfoldFoldovers = "unfold_foldovers",
        /// Remove the smaller of neighbouring faces that lie on one another.
        RemoveOverlappingNeighbours = "remove_overlapping_neighbours",
        /// Remove open sheets within solids that part nothing.
        RemoveInternalSheets = "remove_internal_sheets",
        /// Remove walls of one sheet within solids.
        RemoveInternalFaces = "remove_internal_faces",
        /// Cut one-sided parts, such as a Möbius band, along the edges where no winding suits both faces.
        CutNonOrientable = "cut_non_orientable",
        /// Cut apart what meets in non-manifold edges and vertices.
        SplitNonManifold = "split_non_manifold",
        /// Free faces that hang on an edge of two others and could not be cut apart.
        DetachFins = "detach_fins",
        /// Join open parts where their boundaries come nearest.
        JoinParts = "join_parts",
        /// Close holes.
        FillHoles = "fill_holes",
        /// Remove what is bad with growing rings around it, and close the holes, while that makes it better.
        CleanAndPatch = "clean_and_patch",
        /// Give open sheets a thickness.
        ThickenSheets = "thicken_sheets",
        /// Extrude open sheets down to a plane.
        AddBase = "add_base",
        /// Unite what overlaps, so that no faces intersect.
        SelfUnion = "self_union",
        /// Make the surface anew around what is inside.
        Remesh = "remesh",
        /// Remove open bits that enclose nothing and that no printer could make.
        RemoveDebris = "remove_debris",
        /// Keep apart by position what was cut apart by index.
        Perturb = "perturb",
        /// Drop closed parts smaller than `min_part_volume_pct`.
        DropSmallParts = "drop_small_parts",
        /// Remove faces by collapsing edges, as far as the options ask for it.
        Simplify = "simplify",
    }
}

/// How closed parts that lie in others are wound.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "clap", value(rename_all = "snake_case"))]
pub enum Nested {
    /// As they were: what looks inward in a solid is a cavity, what looks outward a solid of its own.
    #[default]
    Keep,
    /// Each layer against the one around it: what lies in a solid is a cavity, what lies in a cavity a solid.
    Alternate,
}

/// How the triangles of a hole's patch are chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum HoleFilling {
    /// The first that intersects nothing of: least fold, planar, least area, sharp.
    #[default]
    Auto,
    /// The least fold against the faces around and within the patch (Liepa 2003).
    Smooth,
    /// Constrained Delaunay in the hole's best plane; where its picture there is not simple, the least area.
    Planar,
    /// The sharpest corner first, never by a face that would intersect another (Mesh Heal's *fill holes (sharp)*).
    Sharp,
}

/// Where two vertices that are stitched meet. A vertex that is joined to an edge stays where it is, and the edge bends to it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "clap", value(rename_all = "snake_case"))]
pub enum StitchPosition {
    /// Where one of them is, so that no position is new.
    #[default]
    Kept,
    /// Halfway between them.
    Average,
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
