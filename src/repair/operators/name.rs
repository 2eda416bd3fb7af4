use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The operators by name: what a plan lists, what the options switch on and off, and what the report accounts for.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, ToSchema, clap::ValueEnum,
)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Operator {
    /// Round coordinates to those that STL can hold.
    RoundCoordinates,
    /// Drop faces with the same vertex twice.
    RemoveCollapsedFaces,
    /// Merge vertices closer than `merge_distance`, on the boundary or not.
    MergeVertices,
    /// Merge boundary vertices that almost coincide.
    Weld,
    /// Drop faces with the same three vertices, and walls of no thickness.
    RemoveDuplicates,
    /// Remove faces without area, whose corners lie on a line or nearly.
    RemoveCaps,
    /// Collapse short edges and flip away faces that are almost without area.
    RemoveSlivers,
    /// Make the winding of neighbours agree, and turn solids outward.
    Orient,
    /// Cut boundary edges at the vertices that lie on them.
    SplitTJunctions,
    /// Merge boundary vertices that are close for the edges around them.
    Sew,
    /// Close cracks whose sides have different vertices.
    Stitch,
    /// Flip the edges at which surface is folded onto itself.
    UnfoldFoldovers,
    /// Remove the smaller of neighbouring faces that lie on one another.
    RemoveOverlappingNeighbours,
    /// Remove open sheets within solids that part nothing.
    RemoveSheetsWithin,
    /// Remove walls of one sheet within solids.
    RemoveMembranes,
    /// Cut one-sided parts, such as a Möbius band, along the edges where no winding suits both faces.
    CutOneSided,
    /// Cut apart what meets in non-manifold edges and vertices.
    CutApart,
    /// Free faces that hang on an edge of two others and could not be cut apart.
    FreeFins,
    /// Join open parts where their boundaries come nearest.
    JoinParts,
    /// Close holes.
    FillHoles,
    /// Remove what is bad with growing rings around it, and close the holes, while that makes it better.
    CleanAndPatch,
    /// Give open sheets a thickness.
    ThickenSheets,
    /// Extrude open sheets down to a plane.
    AddBase,
    /// Unite what overlaps, so that no faces intersect.
    Resolve,
    /// Make the surface anew around what is inside.
    Remesh,
    /// Remove open bits that enclose nothing and that no printer could make.
    RemoveDebris,
    /// Keep apart by position what was cut apart by index.
    Separate,
    /// Drop closed parts smaller than `min_part_volume_pct`.
    DropSmallParts,
    /// Remove faces by collapsing edges, as far as the options ask for it.
    Simplify,
}

impl Operator {
    /// Every operator, in the order in which they usually run.
    pub const ALL: &[Self] = &[
        Self::RoundCoordinates,
        Self::RemoveCollapsedFaces,
        Self::MergeVertices,
        Self::Weld,
        Self::RemoveDuplicates,
        Self::RemoveCaps,
        Self::RemoveSlivers,
        Self::Orient,
        Self::SplitTJunctions,
        Self::Sew,
        Self::Stitch,
        Self::UnfoldFoldovers,
        Self::RemoveOverlappingNeighbours,
        Self::RemoveSheetsWithin,
        Self::RemoveMembranes,
        Self::CutOneSided,
        Self::CutApart,
        Self::FreeFins,
        Self::JoinParts,
        Self::FillHoles,
        Self::CleanAndPatch,
        Self::ThickenSheets,
        Self::AddBase,
        Self::Resolve,
        Self::Remesh,
        Self::RemoveDebris,
        Self::Separate,
        Self::DropSmallParts,
        Self::Simplify,
    ];

    /// Whether a plan leaves it out unless the options ask for it with `with`.
    #[must_use]
    pub fn is_on_request(self) -> bool {
        matches!(self, Self::RemoveOverlappingNeighbours | Self::JoinParts)
    }

    /// The name used in JSON and on the command line.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::RoundCoordinates => "round_coordinates",
            Self::RemoveCollapsedFaces => "remove_collapsed_faces",
            Self::MergeVertices => "merge_vertices",
            Self::Weld => "weld",
            Self::RemoveDuplicates => "remove_duplicates",
            Self::RemoveCaps => "remove_caps",
            Self::RemoveSlivers => "remove_slivers",
            Self::Orient => "orient",
            Self::SplitTJunctions => "split_t_junctions",
            Self::Sew => "sew",
            Self::Stitch => "stitch",
            Self::UnfoldFoldovers => "unfold_foldovers",
            Self::RemoveOverlappingNeighbours => "remove_overlapping_neighbours",
            Self::RemoveSheetsWithin => "remove_sheets_within",
            Self::RemoveMembranes => "remove_membranes",
            Self::CutOneSided => "cut_one_sided",
            Self::CutApart => "cut_apart",
            Self::FreeFins => "free_fins",
            Self::JoinParts => "join_parts",
            Self::FillHoles => "fill_holes",
            Self::CleanAndPatch => "clean_and_patch",
            Self::ThickenSheets => "thicken_sheets",
            Self::AddBase => "add_base",
            Self::Resolve => "resolve",
            Self::Remesh => "remesh",
            Self::RemoveDebris => "remove_debris",
            Self::Separate => "separate",
            Self::DropSmallParts => "drop_small_parts",
            Self::Simplify => "simplify",
        }
    }
}
