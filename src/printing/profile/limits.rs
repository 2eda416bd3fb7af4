//! The limits that a request or a tenant sets in place of a profile's.

use serde::{Deserialize, Serialize};

/// Limits that replace those of a profile. Absent limits stay as the profile has them.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default, deny_unknown_fields)]
pub struct ProcessLimits {
    /// Name of the profile that the limits change. Default: the profile that the option `process` names.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub based_on: Option<String>,
    /// Title for people.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub title: Option<String>,
    /// See `supported_wall_mm` of a profile.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0))]
    pub supported_wall_mm: Option<f64>,
    /// See `free_wall_mm` of a profile.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0))]
    pub free_wall_mm: Option<f64>,
    /// See `wire_mm` of a profile.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0))]
    pub wire_mm: Option<f64>,
    /// See `pin_mm` of a profile.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0))]
    pub pin_mm: Option<f64>,
    /// See `hole_mm` of a profile.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0))]
    pub hole_mm: Option<f64>,
    /// See `gap_mm` of a profile.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0))]
    pub gap_mm: Option<f64>,
    /// See `clearance_mm` of a profile.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0))]
    pub clearance_mm: Option<f64>,
    /// See `embossed_mm` of a profile.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0))]
    pub embossed_mm: Option<f64>,
    /// See `engraved_mm` of a profile.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0))]
    pub engraved_mm: Option<f64>,
    /// See `part_volume_mm3` of a profile.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0))]
    pub part_volume_mm3: Option<f64>,
    /// Least diameter of an escape hole. 0 lets cavities stay closed.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0))]
    pub escape_hole_mm: Option<f64>,
    /// Least number of escape holes per cavity. 0 lets cavities stay closed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub escape_hole_count: Option<u32>,
    /// Density of the printed material in g/cm³, from which weights follow. 0 leaves it unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0))]
    pub material_density_g_cm3: Option<f64>,
    /// Side lengths of the build volume along x, y and z.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(min_items = 3, max_items = 3))]
    pub build_volume_mm: Option<[f64; 3]>,
    /// Most faces that the print service accepts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_faces: Option<u64>,
    /// Largest file that the print service accepts, in bytes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_bytes: Option<u64>,
}

impl ProcessLimits {
    /// The name of the first limit that is negative or not finite; `None` if all are valid.
    #[must_use]
    pub fn first_invalid(&self) -> Option<&'static str> {
        let lengths = [
            ("supported_wall_mm", self.supported_wall_mm),
            ("free_wall_mm", self.free_wall_mm),
            ("wire_mm", self.wire_mm),
            ("pin_mm", self.pin_mm),
            ("hole_mm", self.hole_mm),
            ("gap_mm", self.gap_mm),
            ("clearance_mm", self.clearance_mm),
            ("embossed_mm", self.embossed_mm),
            ("engraved_mm", self.engraved_mm),
            ("part_volume_mm3", self.part_volume_mm3),
            ("escape_hole_mm", self.escape_hole_mm),
            ("material_density_g_cm3", self.material_density_g_cm3),
        ];
        let sides = self.build_volume_mm.iter().flatten().map(|&side| ("build_volume_mm", Some(side)));
        let mut all = lengths.into_iter().chain(sides);
        let is_invalid =
            |(_, value): &(&str, Option<f64>)| value.is_some_and(|value| !(value.is_finite() && value >= 0.0));
        all.find(is_invalid).map(|(limit, _)| limit)
    }

    /// These limits, with the gaps filled from `other`.
    #[must_use]
    pub fn or(self, other: Self) -> Self {
        Self {
            based_on: self.based_on.or(other.based_on),
            title: self.title.or(other.title),
            supported_wall_mm: self.supported_wall_mm.or(other.supported_wall_mm),
            free_wall_mm: self.free_wall_mm.or(other.free_wall_mm),
            wire_mm: self.wire_mm.or(other.wire_mm),
            pin_mm: self.pin_mm.or(other.pin_mm),
            hole_mm: self.hole_mm.or(other.hole_mm),
            gap_mm: self.gap_mm.or(other.gap_mm),
            clearance_mm: self.clearance_mm.or(other.clearance_mm),
            embossed_mm: self.embossed_mm.or(other.embossed_mm),
            engraved_mm: self.engraved_mm.or(other.engraved_mm),
            part_volume_mm3: self.part_volume_mm3.or(other.part_volume_mm3),
            escape_hole_mm: self.escape_hole_mm.or(other.escape_hole_mm),
            escape_hole_count: self.escape_hole_count.or(other.escape_hole_count),
            material_density_g_cm3: self.material_density_g_cm3.or(other.material_density_g_cm3),
            build_volume_mm: self.build_volume_mm.or(other.build_volume_mm),
            max_faces: self.max_faces.or(other.max_faces),
            max_bytes: self.max_bytes.or(other.max_bytes),
        }
    }
}
