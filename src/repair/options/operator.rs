//! The operators by name.
//!
//! The names are apart from the operators, so that options and reports need no operator's code.

use serde::{Deserialize, Serialize};

/// Defines the enum of operators together with their list and their JSON names.
macro_rules! operators {
    ($(#[doc = $about:literal])* pub enum $type:ident { $($(#[doc = $doc:literal])* $variant:ident = $text:literal,)* }) => {
        $(#[doc = $about])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
        #[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
        #[serde(rename_all = "snake_case")]
        #[cfg_attr(feature = "clap", value(rename_all = "snake_case"))]
        pub enum $type {
            $($(#[doc = $doc])* $variant,)*
        }

        impl $type {
            /// Every operator, in the order in which they usually run.
            pub const ALL: &[Self] = &[$(Self::$variant),*];

            /// The variant used in JSON and on the command line.
            #[must_use]
            pub fn as_str(self) -> &'static str {
                match self {
                    $(Self::$variant => $text,)*
                }
            }
        }
    };
}

operators! {
    /// A repair operator, by the name that plans, options and reports use.
    pub enum Operator {
        /// Round coordinates to values that the output format can hold.
        RoundCoordinates = "round_coordinates",
        /// Remove faces that use the same vertex twice.
        RemoveCollapsedFaces = "remove_collapsed_faces",
        /// Merge vertices closer than `merge_distance`, on the boundary or inside the surface.
        MergeVertices = "merge_vertices",
        /// Merge boundary vertices that almost coincide.
        Weld = "weld",
        /// Remove faces with the same three vertices, and zero-thickness facets.
        RemoveDuplicates = "remove_duplicates",
        /// Remove faces with no area: their corners are collinear or nearly collinear.
        RemoveCaps = "remove_caps",
        /// Collapse short edges and flip the long edges of nearly degenerate faces.
        RemoveSlivers = "remove_slivers",
        /// Make the winding of neighbouring faces agree, and turn solids outward.
        Orient = "orient",
        /// Split boundary edges at the vertices that lie on them.
        SplitTJunctions = "split_t_junctions",
        /// Merge boundary vertices that are close relative to the length of their edges.
        Sew = "sew",
        /// Join the two sides of a crack, which have different vertices, along its whole length.
        Stitch = "stitch",
        /// Flip the edges along which the surface folds back onto itself.
        UnfoldFoldovers = "unfold_foldovers",
        /// Remove the smaller of two neighbouring faces that overlap.
        RemoveOverlappingNeighbours = "remove_overlapping_neighbours",
        /// Remove open sheets inside solids that separate no two volumes.
        RemoveInternalSheets = "remove_internal_sheets",
        /// Remove single-layer internal faces from solids.
        RemoveInternalFaces = "remove_internal_faces",
        /// Split non-orientable parts, such as a Möbius band, along the edges where no winding suits both faces.
        CutNonOrientable = "cut_non_orientable",
        /// Split the surface at non-manifold edges and vertices.
        SplitNonManifold = "split_non_manifold",
        /// Detach faces that share an edge with two other faces and could not be split off.
        DetachFins = "detach_fins",
        /// Join open parts where their boundaries are closest.
        JoinParts = "join_parts",
        /// Fill holes.
        FillHoles = "fill_holes",
        /// Remove defective faces with growing rings of neighbours and fill the holes, while the surface improves.
        CleanAndPatch = "clean_and_patch",
        /// Give open sheets a thickness.
        ThickenSheets = "thicken_sheets",
        /// Extrude open sheets down to a plane.
        AddBase = "add_base",
        /// Unite overlapping volumes, so that no faces intersect.
        SelfUnion = "self_union",
        /// Rebuild the surface around the enclosed volume.
        Remesh = "remesh",
        /// Remove open fragments that enclose no volume and are too small to print.
        RemoveDebris = "remove_debris",
        /// Perturb vertices that share a position after a split, so that position-based formats keep the split.
        Perturb = "perturb",
        /// Remove closed parts smaller than `min_part_volume_pct`.
        DropSmallParts = "drop_small_parts",
        /// Keep the outer skin of a model, seal small openings, and fill the space inside.
        FillInterior = "fill_interior",
        /// Remove small separate solids, or attach them, as `islands` asks.
        TreatIslands = "treat_islands",
        /// Fill sealed cavities.
        FillVoids = "fill_voids",
        /// Drill holes into sealed cavities.
        VentVoids = "vent_voids",
        /// Thicken walls that are thinner than `min_wall`.
        ThickenWalls = "thicken_walls",
        /// Remove faces by collapsing edges, as far as the options ask.
        Simplify = "simplify",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_operator_has_the_same_name_in_json_and_on_the_command_line() {
        for &operator in Operator::ALL {
            assert_eq!(serde_json::to_value(operator).ok(), Some(operator.as_str().into()));
            #[cfg(feature = "clap")]
            {
                let value = clap::ValueEnum::to_possible_value(&operator);
                assert_eq!(value.map(|value| value.get_name().to_owned()).as_deref(), Some(operator.as_str()));
            }
        }
    }
}
