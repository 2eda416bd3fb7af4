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
    /// Merge boundary vertices that almost coincide.
    Weld,
    /// Drop faces with the same three vertices, and walls of no thickness.
    RemoveDuplicates,
    /// Flip away faces whose corners lie on a line.
    RemoveCaps,
    /// Make the winding of neighbours agree, and turn solids outward.
    Orient,
    /// Cut apart what meets in non-manifold edges and vertices.
    CutApart,
    /// Join open parts where their boundaries come nearest.
    JoinParts,
    /// Close holes.
    FillHoles,
    /// Give open sheets a thickness.
    ThickenSheets,
    /// Extrude open sheets down to a plane.
    AddBase,
    /// Unite what overlaps, so that no faces intersect.
    Resolve,
    /// Remove open bits that enclose nothing and that no printer could make.
    RemoveDebris,
    /// Keep apart by position what was cut apart by index.
    Separate,
}

impl Operator {
    /// Every operator, in the order in which they usually run.
    pub const ALL: [Self; 14] = [
        Self::RoundCoordinates,
        Self::RemoveCollapsedFaces,
        Self::Weld,
        Self::RemoveDuplicates,
        Self::RemoveCaps,
        Self::Orient,
        Self::CutApart,
        Self::JoinParts,
        Self::FillHoles,
        Self::ThickenSheets,
        Self::AddBase,
        Self::Resolve,
        Self::RemoveDebris,
        Self::Separate,
    ];

    /// Whether a plan leaves it out unless the options ask for it with `with`.
    #[must_use]
    pub fn is_on_request(self) -> bool {
        matches!(self, Self::JoinParts)
    }

    /// The name used in JSON and on the command line.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::RoundCoordinates => "round_coordinates",
            Self::RemoveCollapsedFaces => "remove_collapsed_faces",
            Self::Weld => "weld",
            Self::RemoveDuplicates => "remove_duplicates",
            Self::RemoveCaps => "remove_caps",
            Self::Orient => "orient",
            Self::CutApart => "cut_apart",
            Self::JoinParts => "join_parts",
            Self::FillHoles => "fill_holes",
            Self::ThickenSheets => "thicken_sheets",
            Self::AddBase => "add_base",
            Self::Resolve => "resolve",
            Self::RemoveDebris => "remove_debris",
            Self::Separate => "separate",
        }
    }
}
