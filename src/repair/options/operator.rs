use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Makes the operators, each with its name for programs.
macro_rules! operators {
    ($(#[doc = $about:literal])* pub enum $all:ident { $($(#[doc = $doc:literal])* $name:ident = $text:literal,)* }) => {
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
        RemoveSheetsWithin = "remove_sheets_within",
        /// Remove walls of one sheet within solids.
        RemoveMembranes = "remove_membranes",
        /// Cut one-sided parts, such as a Möbius band, along the edges where no winding suits both faces.
        CutOneSided = "cut_one_sided",
        /// Cut apart what meets in non-manifold edges and vertices.
        CutApart = "cut_apart",
        /// Free faces that hang on an edge of two others and could not be cut apart.
        FreeFins = "free_fins",
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
        Resolve = "resolve",
        /// Make the surface anew around what is inside.
        Remesh = "remesh",
        /// Remove open bits that enclose nothing and that no printer could make.
        RemoveDebris = "remove_debris",
        /// Keep apart by position what was cut apart by index.
        Separate = "separate",
        /// Drop closed parts smaller than `min_part_volume_pct`.
        DropSmallParts = "drop_small_parts",
        /// Remove faces by collapsing edges, as far as the options ask for it.
        Simplify = "simplify",
    }
}

/// Names of operators: an array, or one string with commas, as a query says it.
pub(super) fn operators_by_name<'de, D: serde::Deserializer<'de>>(from: D) -> Result<Vec<Operator>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Names {
        Many(Vec<String>),
        One(String),
    }
    let names = match Names::deserialize(from)? {
        Names::Many(names) => names,
        Names::One(names) => {
            names.split(',').map(|name| name.trim().to_owned()).filter(|name| !name.is_empty()).collect()
        }
    };
    let known = || Operator::ALL.iter().map(|o| o.as_str()).collect::<Vec<_>>().join(", ");
    let of = |name: &String| Operator::ALL.iter().copied().find(|o| o.as_str() == name);
    let find = |name| {
        of(name).ok_or_else(|| serde::de::Error::custom(format!("there is no operator '{name}'; they are {}", known())))
    };
    names.iter().map(find).collect()
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
