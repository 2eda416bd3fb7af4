//! The kinds of change that operators count, with their names in JSON.

use std::fmt;

use serde::{Deserialize, Serialize};

/// One kind of change that an operator made, such as 12 `duplicate_faces_removed`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Change {
    /// The kind of change, as a stable name.
    #[cfg_attr(feature = "openapi", schema(value_type = String))]
    pub kind: ChangeKind,
    /// The number of changes of this kind.
    pub count: u64,
}

impl Change {
    /// Makes a list of the given changes without those whose count is zero.
    pub(super) fn list<const N: usize>(changes: [(ChangeKind, u64); N]) -> Vec<Self> {
        let some = changes.into_iter().filter(|&(_, count)| count > 0);
        some.map(|(kind, count)| Self { kind, count }).collect()
    }
}

/// Defines the kinds of change, each with its name in JSON.
macro_rules! change_kinds {
    ($($(#[doc = $doc:literal])* $name:ident = $text:literal,)*) => {
        /// A kind of change that an operator counts.
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
    /// Open parts flipped.
    OpenPartsFlipped = "open_parts_flipped",
    /// Defective places removed and patched.
    RegionsPatched = "regions_patched",
    /// Faces removed.
    FacesRemoved = "faces_removed",
    /// Faces added.
    FacesAdded = "faces_added",
    /// Defects removed.
    DefectsRemoved = "defects_removed",
    /// Non-manifold edges split.
    NonManifoldEdgesSplit = "non_manifold_edges_split",
    /// Vertices duplicated to split edges or vertices.
    VerticesDuplicated = "vertices_duplicated",
    /// Faces at a non-manifold edge that were paired with no other face.
    FacesWithoutPartner = "faces_without_partner",
    /// Tiny open parts (debris) removed.
    DebrisPartsRemoved = "debris_parts_removed",
    /// Open sheets inside solids removed.
    SheetsInsideSolidsRemoved = "sheets_inside_solids_removed",
    /// Faces of debris removed.
    DebrisFacesRemoved = "debris_faces_removed",
    /// Faces with two equal corners removed.
    CollapsedFacesRemoved = "collapsed_faces_removed",
    /// Degenerate faces flipped.
    DegenerateFacesFlipped = "degenerate_faces_flipped",
    /// Degenerate faces removed.
    DegenerateFacesRemoved = "degenerate_faces_removed",
    /// Degenerate faces that could not be removed.
    DegenerateFacesLeft = "degenerate_faces_left",
    /// Duplicate faces removed.
    DuplicateFacesRemoved = "duplicate_faces_removed",
    /// Pairs of opposite duplicate faces removed, counted in faces.
    CancellingFacesRemoved = "cancelling_faces_removed",
    /// Fins detached from the surface.
    FinsDetached = "fins_detached",
    /// Folds flipped.
    FoldsFlipped = "folds_flipped",
    /// Holes closed.
    HolesClosed = "holes_closed",
    /// Islands joined.
    IslandsJoined = "islands_joined",
    /// Vertices added.
    VerticesAdded = "vertices_added",
    /// Holes that could not be closed.
    HolesLeft = "holes_left",
    /// Holes left open because they exceed the options' limits.
    HolesOverLimit = "holes_over_limit",
    /// Open sheets left open.
    OpenSheetsLeft = "open_sheets_left",
    /// Parts joined.
    PartsJoined = "parts_joined",
    /// Internal walls removed, as groups of connected internal faces.
    InternalPatchesRemoved = "internal_patches_removed",
    /// Internal faces removed.
    InternalFacesRemoved = "internal_faces_removed",
    /// Vertices merged.
    VerticesMerged = "vertices_merged",
    /// Non-orientable parts cut.
    NonOrientablePartsCut = "non_orientable_parts_cut",
    /// Edges cut to make parts orientable.
    EdgesCut = "edges_cut",
    /// Vertices that still share a position.
    CoincidentVerticesLeft = "coincident_vertices_left",
    /// Edges whose faces still disagree on their orientation.
    OrientationConflictsLeft = "orientation_conflicts_left",
    /// Faces flipped.
    FacesFlipped = "faces_flipped",
    /// Closed parts flipped.
    ClosedPartsFlipped = "closed_parts_flipped",
    /// Cavities kept.
    CavitiesKept = "cavities_kept",
    /// Solids found inside other solids.
    SolidsInsideSolids = "solids_inside_solids",
    /// Overlapping faces removed.
    OverlappingFacesRemoved = "overlapping_faces_removed",
    /// Dangling faces removed.
    DanglingFacesRemoved = "dangling_faces_removed",
    /// Faces created by a cut or a remesh.
    FacesCreated = "faces_created",
    /// Places without thickness that were thickened.
    ThinPlacesThickened = "thin_places_thickened",
    /// Parts united.
    PartsUnited = "parts_united",
    /// Pairs of intersecting faces resolved.
    IntersectingPairsResolved = "intersecting_pairs_resolved",
    /// Closed pieces removed after a union because they were thinner than the rounding of their vertices.
    CrumbsRemoved = "crumbs_removed",
    /// Places joined where the surface of a union touched or intersected itself and no vertex could move.
    ContactsJoined = "contacts_joined",
    /// Faces cut along intersections.
    FacesCut = "faces_cut",
    /// Vertices snapped to another element.
    VerticesSnapped = "vertices_snapped",
    /// Zero-thickness facets thickened.
    FacesWithoutThicknessThickened = "faces_without_thickness_thickened",
    /// Faces around open regions thickened.
    FacesAroundOpenRegionsThickened = "faces_around_open_regions_thickened",
    /// Vertices rounded to f32.
    VerticesRoundedToF32 = "vertices_rounded_to_f32",
    /// Nearly coincident vertices merged.
    NearCoincidentVerticesMerged = "near_coincident_vertices_merged",
    /// Doubled edges split.
    DoubledEdgesSplit = "doubled_edges_split",
    /// Coincident vertices moved apart.
    CoincidentVerticesPerturbed = "coincident_vertices_perturbed",
    /// Boundary vertices merged by sewing.
    BoundaryVerticesSewn = "boundary_vertices_sewn",
    /// Internal sheets removed.
    InternalSheetsRemoved = "internal_sheets_removed",
    /// Faces of internal sheets removed.
    SheetFacesRemoved = "sheet_faces_removed",
    /// Short edges collapsed.
    ShortEdgesCollapsed = "short_edges_collapsed",
    /// Caps (faces with an angle near 180 degrees) whose longest edge was flipped.
    CapsFlipped = "caps_flipped",
    /// Caps removed.
    CapsRemoved = "caps_removed",
    /// Slivers that could not be removed.
    SliversLeft = "slivers_left",
    /// Closed parts below the volume limit removed.
    SmallPartsDropped = "small_parts_dropped",
    /// Faces of these small parts removed.
    SmallPartFacesDropped = "small_part_faces_dropped",
    /// Vertices along cracks merged.
    CrackVerticesMerged = "crack_vertices_merged",
    /// Edges along cracks split.
    CrackEdgesSplit = "crack_edges_split",
    /// Edges split at T-junctions.
    TJunctionsSplit = "t_junctions_split",
    /// Nearly closed solids left open.
    SolidsLeftOpen = "solids_left_open",
    /// Open sheets thickened.
    SheetsThickened = "sheets_thickened",
    /// Rim edges closed.
    RimEdgesClosed = "rim_edges_closed",
    /// Small openings sealed to fill the interior.
    OpeningsSealed = "openings_sealed",
    /// Pieces inside a filled interior removed.
    InnerPiecesDropped = "inner_pieces_dropped",
    /// Small separate solids removed.
    IslandsDropped = "islands_dropped",
    /// Small separate solids attached with struts.
    IslandsAttached = "islands_attached",
    /// Sealed cavities filled.
    VoidsFilled = "voids_filled",
    /// Sealed cavities opened with bores.
    VoidsVented = "voids_vented",
    /// Bores drilled.
    VentsDrilled = "vents_drilled",
    /// Sealed cavities that could not be vented.
    VoidsLeft = "voids_left",
    /// Thin regions of walls thickened.
    WallsThickened = "walls_thickened",
    /// Through holes narrower than the least gap that thicker walls closed.
    ThroughHolesClosed = "through_holes_closed",
    /// Gaps narrower than the least gap that were filled, since thicker walls closed them on all sides.
    NarrowGapsFilled = "narrow_gaps_filled",
    /// Thin regions of walls that stayed thin.
    ThinWallsLeft = "thin_walls_left",
    /// Boundary vertices merged within the weld tolerance.
    BoundaryVerticesMerged = "boundary_vertices_merged",
}

impl ChangeKind {
    /// Whether the kind counts elements that were found or left, without any change.
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
                | Self::VoidsLeft
                | Self::ThinWallsLeft
        )
    }

    /// Whether the kind counts surface that was thickened.
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
        let json = serde_json::json!({"kind": "t_junctions_split", "count": 3});
        assert_eq!(serde_json::to_value(change).ok(), Some(json.clone()));
        assert_eq!(serde_json::from_value::<Change>(json).ok(), Some(change));
    }
}
