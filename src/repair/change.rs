use std::fmt;

use serde::{Deserialize, Serialize};

/// One kind of change that an operator made, such as 12 `duplicate_faces_removed`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Change {
    /// What was changed, as a name for programs.
    #[cfg_attr(feature = "openapi", schema(value_type = String))]
    pub kind: ChangeKind,
    /// How many.
    pub count: u64,
}

impl Change {
    /// A list of the given changes without those that count nothing.
    pub(super) fn list<const N: usize>(changes: [(ChangeKind, u64); N]) -> Vec<Self> {
        let some = changes.into_iter().filter(|&(_, count)| count > 0);
        some.map(|(kind, count)| Self { kind, count }).collect()
    }
}

/// Makes the kinds of change, each with its name for programs.
macro_rules! change_kinds {
    ($($(#[doc = $doc:literal])* $name:ident = $text:literal,)*) => {
        /// What an operator counts of what it did.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
        pub enum ChangeKind {
            $($(#[doc = $doc])* #[serde(rename = $text)] $name,)*
        }

        impl ChangeKind {
            /// The name in JSON.
            #[must_use]
            pub fn as_str(self) -> &'static str {
                match self {
                    $(Self::$name => $text,)*
                }
            }
        }
    };
}

change_kinds! {
    /// Bases added.
    BasesAdded = "bases_added",
    /// Open parts turned.
    OpenPartsFlipped = "open_parts_flipped",
    /// Places patched.
    PlacesPatched = "places_patched",
    /// Faces removed.
    FacesRemoved = "faces_removed",
    /// Faces added.
    FacesAdded = "faces_added",
    /// Defects gone.
    DefectsRemoved = "defects_removed",
    /// Non manifold edges cut.
    NonManifoldEdgesSplit = "non_manifold_edges_split",
    /// Vertices copied.
    VerticesDuplicated = "vertices_duplicated",
    /// Faces without partner.
    FacesWithoutPartner = "faces_without_partner",
    /// Debris parts removed.
    DebrisPartsRemoved = "debris_parts_removed",
    /// Sheets inside solids removed.
    SheetsInsideSolidsRemoved = "sheets_inside_solids_removed",
    /// Debris faces removed.
    DebrisFacesRemoved = "debris_faces_removed",
    /// Collapsed faces removed.
    CollapsedFacesRemoved = "collapsed_faces_removed",
    /// Degenerate faces flipped.
    DegenerateFacesFlipped = "degenerate_faces_flipped",
    /// Degenerate faces removed.
    DegenerateFacesRemoved = "degenerate_faces_removed",
    /// Degenerate faces left.
    DegenerateFacesLeft = "degenerate_faces_left",
    /// Duplicate faces removed.
    DuplicateFacesRemoved = "duplicate_faces_removed",
    /// Canceling faces removed.
    CancellingFacesRemoved = "cancelling_faces_removed",
    /// Fins freed.
    FinsDetached = "fins_detached",
    /// Folds flipped.
    FoldsFlipped = "folds_flipped",
    /// Holes closed.
    HolesClosed = "holes_closed",
    /// Islands joined.
    IslandsJoined = "islands_joined",
    /// Vertices added.
    VerticesAdded = "vertices_added",
    /// Holes left.
    HolesLeft = "holes_left",
    /// Holes over limit.
    HolesOverLimit = "holes_over_limit",
    /// Open sheets left.
    OpenSheetsLeft = "open_sheets_left",
    /// Parts joined.
    PartsJoined = "parts_joined",
    /// Membranes removed.
    InternalWallsRemoved = "internal_walls_removed",
    /// Membrane faces removed.
    InternalFacesRemoved = "internal_faces_removed",
    /// Vertices merged.
    VerticesMerged = "vertices_merged",
    /// One sided parts cut.
    NonOrientablePartsCut = "non_orientable_parts_cut",
    /// Edges cut.
    EdgesCut = "edges_cut",
    /// Coincident vertices left.
    CoincidentVerticesLeft = "coincident_vertices_left",
    /// Orientation conflicts left.
    OrientationConflictsLeft = "orientation_conflicts_left",
    /// Faces turned.
    FacesFlipped = "faces_flipped",
    /// Closed parts turned.
    ClosedPartsFlipped = "closed_parts_flipped",
    /// Cavities kept.
    CavitiesKept = "cavities_kept",
    /// Solids inside solids.
    SolidsInsideSolids = "solids_inside_solids",
    /// Overlapping faces removed.
    OverlappingFacesRemoved = "overlapping_faces_removed",
    /// Dangling faces removed.
    DanglingFacesRemoved = "dangling_faces_removed",
    /// Faces made.
    FacesCreated = "faces_created",
    /// Thin places thickened.
    ThinPlacesThickened = "thin_places_thickened",
    /// Parts united.
    PartsUnited = "parts_united",
    /// Intersecting pairs resolved.
    IntersectingPairsResolved = "intersecting_pairs_resolved",
    /// Faces cut.
    FacesCut = "faces_cut",
    /// Vertices snapped.
    VerticesSnapped = "vertices_snapped",
    /// Faces without thickness thickened.
    FacesWithoutThicknessThickened = "faces_without_thickness_thickened",
    /// Faces around open rooms thickened.
    FacesAroundOpenRegionsThickened = "faces_around_open_regions_thickened",
    /// Vertices rounded to f32.
    VerticesRoundedToF32 = "vertices_rounded_to_f32",
    /// Near coincident vertices merged.
    NearCoincidentVerticesMerged = "near_coincident_vertices_merged",
    /// Doubled edges split.
    DoubledEdgesSplit = "doubled_edges_split",
    /// Coincident vertices separated.
    CoincidentVerticesPerturbed = "coincident_vertices_perturbed",
    /// Boundary vertices sewn.
    BoundaryVerticesSewn = "boundary_vertices_sewn",
    /// Sheets within removed.
    InternalSheetsRemoved = "internal_sheets_removed",
    /// Sheet faces removed.
    SheetFacesRemoved = "sheet_faces_removed",
    /// Short edges collapsed.
    ShortEdgesCollapsed = "short_edges_collapsed",
    /// Caps flipped.
    CapsFlipped = "caps_flipped",
    /// Caps removed.
    CapsRemoved = "caps_removed",
    /// Slivers left.
    SliversLeft = "slivers_left",
    /// Small parts dropped.
    SmallPartsDropped = "small_parts_dropped",
    /// Small part faces dropped.
    SmallPartFacesDropped = "small_part_faces_dropped",
    /// Crack vertices merged.
    CrackVerticesMerged = "crack_vertices_merged",
    /// Crack edges split.
    CrackEdgesSplit = "crack_edges_split",
    /// T-junctions split.
    TJunctionsSplit = "t_junctions_split",
    /// Solids left open.
    SolidsLeftOpen = "solids_left_open",
    /// Sheets thickened.
    SheetsThickened = "sheets_thickened",
    /// Rim edges closed.
    RimEdgesClosed = "rim_edges_closed",
    /// Boundary vertices merged.
    BoundaryVerticesMerged = "boundary_vertices_merged",
}

impl ChangeKind {
    /// Whether it counts what was found or left, and nothing that was changed.
    pub(super) fn is_only_counted(self) -> bool {
        matches!(
            self,
            Self::DegenerateFacesLeft
                | Self::HolesLeft
                | Self::OpenSheetsLeft
                | Self::CoincidentVerticesLeft
                | Self::OrientationConflictsLeft
                | Self::SliversLeft
                | Self::CavitiesKept
                | Self::SolidsInsideSolids
                | Self::SolidsLeftOpen
        )
    }

    /// Whether surface was given a thickness.
    pub(super) fn gives_thickness(self) -> bool {
        matches!(
            self,
            Self::SheetsThickened
                | Self::ThinPlacesThickened
                | Self::FacesWithoutThicknessThickened
                | Self::FacesAroundOpenRegionsThickened
                | Self::BasesAdded
        )
    }
}

impl fmt::Display for ChangeKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_of_change_keep_their_names_in_json() {
        let change = Change { kind: ChangeKind::TJunctionsSplit, count: 3 };
        let json = serde_json::json!({"what": "t_junctions_split", "count": 3});
        assert_eq!(serde_json::to_value(change).ok(), Some(json.clone()));
        assert_eq!(serde_json::from_value::<Change>(json).ok(), Some(change));
    }
}
