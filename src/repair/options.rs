//! The options of a repair.

mod choices;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

pub use self::choices::{Category, Merge, OpenSheets, OutputFormat, Overlaps, Preset, Require, WindingRuleChoice};
pub use super::operators::Operator;
pub use super::operators::holes::HoleFilling;
pub use super::operators::orient::Nested;
pub use super::operators::stitch::StitchPosition;
use crate::format::ReadOptions;
use crate::inspect::{OptionsError, changed_fields};
use crate::scene::Unit;

/// How a model is to be repaired. Every field has a default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema, utoipa::IntoParams))]
#[serde(default)]
#[cfg_attr(feature = "openapi", into_params(parameter_in = Query))]
pub struct Options {
    /// The plan to run, or `auto`.
    pub preset: Preset,
    /// With the preset `auto`: the category of damage that the plan is chosen for, instead of the one that the inspection finds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub category: Option<Category>,
    /// Format of the result.
    pub output: OutputFormat,
    /// What becomes of the objects of a file whose format has such.
    pub merge: Merge,
    /// What the result must be for the repair to succeed.
    pub require: Require,
    /// The unit of the file's lengths, whatever it says itself. Without it, and where the file says none, millimetres are assumed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit: Option<Unit>,
    /// The unit that lengths are brought into; without it they stay as they are. Lengths among these options are in it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale_to: Option<Unit>,
    /// Operators that run although they are left out by default.
    #[cfg_attr(feature = "openapi", param(explode = false))]
    #[serde(deserialize_with = "operators_by_name")]
    pub with: Vec<Operator>,
    /// Operators that do not run.
    #[cfg_attr(feature = "openapi", param(explode = false))]
    #[serde(deserialize_with = "operators_by_name")]
    pub without: Vec<Operator>,
    /// The farthest that surface may be moved from where it was or made, hole patches apart, in the model's unit. What can't be
    /// fixed within it is left and reported.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0))]
    pub max_deviation: Option<f64>,
    /// Most faces that the result should have: faces are removed by collapsing edges until there are no more, or `max_error`, or
    /// without it 0.5 % of the bounding box's diagonal, allows no further.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 4, maximum = 4294967295u64))]
    pub max_faces: Option<u64>,
    /// The farthest that the surface may be, both ways, from where it was before faces were removed, in the model's unit. Without
    /// `max_faces`, all faces go that may go within it: with a tiny error those that plane surface does not need.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0))]
    pub max_error: Option<f64>,
    /// Highest tier that may run, 1 to 3: 1 cleans, 2 mends, 3 is Blender.
    #[cfg_attr(feature = "openapi", schema(minimum = 1, maximum = 3))]
    pub max_tier: u8,
    /// Seconds the repair may take from its start. It ends within 2 s and 10 % of that, with the best result that was verified by then, or
    /// fails where there was not even time to inspect the input; `omitted` in the report says what there was no time for.
    #[cfg_attr(feature = "openapi", schema(minimum = 1.0, maximum = 3600.0))]
    pub deadline_s: f64,
    /// Red flag: share of the faces lost, in percent.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 100.0))]
    pub max_face_loss_pct: f64,
    /// Red flag: share of the vertices lost, in percent. A vertex is lost where no face at it is left, whole or cut.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 100.0))]
    pub max_vertex_loss_pct: f64,
    /// Red flag: change of the bounding box's diagonal, in percent.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 1000.0))]
    pub max_bounding_box_change_pct: f64,
    /// Red flag: change of the volume, in percent; judged only where the input's volume is reliable.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 1000.0))]
    pub max_volume_change_pct: f64,
    /// Red flag: share of the surface seen from outside that has no counterpart in the result, in percent.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 100.0))]
    pub max_surface_lost_pct: f64,
    /// Red flag: share of the result's surface that the input does not have, in percent: thickened skins, and patches of holes that are
    /// larger than 2 % of the surface each.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 100.0))]
    pub max_surface_added_pct: f64,
    /// Boundary vertices closer than this share of the bounding box's diagonal are merged; 0 merges equal positions only.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 0.01))]
    pub weld_tolerance: f64,
    /// Vertices closer than this are merged, on the boundary or not, in the model's unit. Without it, only equal positions are, and
    /// boundary vertices within `weld_tolerance`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0))]
    pub merge_distance: Option<f64>,
    /// Boundary vertices closer than this share of the shortest boundary edge at either are merged; 0 merges none so. Without it 0.2,
    /// and vertices no farther apart than 0.1 % of the bounding box's diagonal.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 0.5))]
    pub sew_ratio: Option<f64>,
    /// Widest crack that is stitched, as a share of the bounding box's diagonal; 0 stitches none. Without it 0.001. A gap wider than
    /// half of the edges beside it is a hole.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 1.0))]
    pub stitch_threshold: Option<f64>,
    /// Widest crack that is stitched, in the model's unit, instead of `stitch_threshold`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0))]
    pub stitch_distance: Option<f64>,
    /// Share of an edge at either end within which stitching takes the end instead of cutting the edge; from 0.5 on, always.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 1.0))]
    pub stitch_epsilon: f64,
    /// Where two vertices that are stitched meet.
    pub stitch_position: StitchPosition,
    /// Edges shorter and faces lower than this share of the bounding box's diagonal are removed, and surface that is folded onto itself
    /// as closely is unfolded; 0 leaves them.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 0.001))]
    pub degenerate_tolerance: f64,
    /// Where `with` asks for `remove_overlapping_neighbours`: the angle between two neighbouring faces, in degrees, up to
    /// which they lie on one another. Without it 1 degree, and faces no farther apart than 0.01 % of the bounding box's diagonal.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 45.0))]
    pub overlap_angle_deg: Option<f64>,
    /// A polygon of the file whose corners rise from its plane by more than this angle, in degrees, is cut into
    /// triangles with the least fold, others as if they were flat: other programs do so with all, and show the same surface then.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 180.0))]
    pub twist_angle_deg: f64,
    /// Most edges around a hole that is closed.
    #[cfg_attr(feature = "openapi", schema(minimum = 3, maximum = 10000000))]
    pub max_hole_edges: u32,
    /// Closed parts with a smaller share of the volume of all parts are dropped, in percent; 0 keeps them.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 100.0))]
    pub min_part_volume_pct: f64,
    /// How closed parts that lie in others are wound: as they were, or each layer against the one around it.
    pub nested: Nested,
    /// What becomes of parts that overlap.
    pub overlaps: Overlaps,
    /// What is solid where faces intersect.
    pub winding_rule: WindingRuleChoice,
    /// What becomes of open sheets.
    pub open_sheets: OpenSheets,
    /// Thickness of thickened sheets and of a base at its lowest point, in the model's unit. Without it, 0.3 % of the bounding
    /// box's diagonal.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(exclusive_minimum = 0.0))]
    pub thickness: Option<f64>,
    /// Largest extent of a hole that is closed, as a share of the bounding box's diagonal; 1 closes holes of any size.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 1.0))]
    pub max_hole_size: f64,
    /// Most holes that are closed; of more, the smallest are.
    #[cfg_attr(feature = "openapi", schema(minimum = 0, maximum = 4294967295u64))]
    pub max_holes: u32,
    /// How the triangles of a hole's patch are chosen.
    pub hole_filling: HoleFilling,
    /// Whether patches that are not plane get inner vertices, as close together as those around.
    pub refine_patches: bool,
    /// Whether patches are refined and then bent so that they go on smoothly from the surface around.
    pub fair_patches: bool,
    /// The edge of a remesh's voxels, natively or by Blender, in the model's unit. Without it the size follows from `voxel_resolution`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(exclusive_minimum = 0.0))]
    pub voxel_size: Option<f64>,
    /// Voxels along the bounding box's diagonal for a remesh.
    #[cfg_attr(feature = "openapi", schema(minimum = 16, maximum = 2000))]
    pub voxel_resolution: u32,
    /// Most faces a remesh may have; the voxel size is made larger until the estimate is below.
    #[cfg_attr(feature = "openapi", schema(minimum = 1000, maximum = 20000000))]
    pub max_remesh_faces: u64,
    /// Whether what was found and what was changed can be had as pictures: `before.png`, `after.png`, `defects.glb`, `defects.ply`,
    /// `change.png`, `change.glb` and `change.ply`. They are drawn when somebody asks for one of them first.
    pub pictures: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            preset: Preset::Auto,
            category: None,
            output: OutputFormat::Auto,
            merge: Merge::Auto,
            require: Require::Any,
            unit: None,
            scale_to: None,
            with: Vec::new(),
            without: Vec::new(),
            max_deviation: None,
            max_faces: None,
            max_error: None,
            max_tier: 3,
            deadline_s: 300.0,
            max_face_loss_pct: 40.0,
            max_vertex_loss_pct: 40.0,
            max_bounding_box_change_pct: 30.0,
            max_volume_change_pct: 30.0,
            max_surface_lost_pct: 1.0,
            max_surface_added_pct: 10.0,
            weld_tolerance: 1e-6,
            merge_distance: None,
            sew_ratio: None,
            stitch_threshold: None,
            stitch_distance: None,
            stitch_epsilon: 0.2,
            stitch_position: StitchPosition::Kept,
            degenerate_tolerance: 1e-7,
            overlap_angle_deg: None,
            twist_angle_deg: ReadOptions::default().twist_angle_deg,
            max_hole_edges: 1_000_000,
            min_part_volume_pct: 0.0,
            nested: Nested::Keep,
            overlaps: Overlaps::Union,
            winding_rule: WindingRuleChoice::Auto,
            open_sheets: OpenSheets::Auto,
            thickness: None,
            max_hole_size: 1.0,
            max_holes: 1_000_000,
            hole_filling: HoleFilling::Auto,
            refine_patches: false,
            fair_patches: false,
            voxel_size: None,
            voxel_resolution: 300,
            max_remesh_faces: 1_000_000,
            pictures: true,
        }
    }
}

impl Options {
    /// The options that differ from their defaults, as JSON.
    #[must_use]
    pub fn to_changed_fields(&self) -> Map<String, Value> {
        changed_fields(self, &Self::default())
    }

    /// Whether faces are to be removed that nothing is wrong with.
    #[must_use]
    pub fn asks_for_fewer_faces(&self) -> bool {
        self.max_faces.is_some() || self.max_error.is_some()
    }

    /// Whether that is so for a model of so many faces.
    #[must_use]
    pub fn asks_for_fewer_faces_than(&self, faces: u64) -> bool {
        self.max_faces.map_or(self.max_error.is_some(), |most| faces > most)
    }

    /// Checks every range.
    ///
    /// # Errors
    /// The first option that is out of its range.
    pub fn validate(&self) -> Result<(), OptionsError> {
        let number =
            |option, value, low, high, expected| OptionsError::unless_within(option, value, (low, high), expected);
        number("max_tier", f64::from(self.max_tier), 1.0, 3.0, "1, 2 or 3")?;
        number("deadline_s", self.deadline_s, 1.0, 3600.0, "between 1 and 3600 seconds")?;
        number("max_face_loss_pct", self.max_face_loss_pct, 0.0, 100.0, "between 0 and 100 percent")?;
        number("max_vertex_loss_pct", self.max_vertex_loss_pct, 0.0, 100.0, "between 0 and 100 percent")?;
        number(
            "max_bounding_box_change_pct",
            self.max_bounding_box_change_pct,
            0.0,
            1000.0,
            "between 0 and 1000 percent",
        )?;
        number("max_volume_change_pct", self.max_volume_change_pct, 0.0, 1000.0, "between 0 and 1000 percent")?;
        number("max_surface_lost_pct", self.max_surface_lost_pct, 0.0, 100.0, "between 0 and 100 percent")?;
        number("max_surface_added_pct", self.max_surface_added_pct, 0.0, 100.0, "between 0 and 100 percent")?;
        number("weld_tolerance", self.weld_tolerance, 0.0, 0.01, "between 0 and 0.01 of the bounding box's diagonal")?;
        let sew_ratio = self.sew_ratio.unwrap_or_default();
        number("sew_ratio", sew_ratio, 0.0, 0.5, "between 0 and 0.5 of the shortest boundary edge")?;
        let threshold = self.stitch_threshold.unwrap_or_default();
        number("stitch_threshold", threshold, 0.0, 1.0, "between 0 and 1 of the bounding box's diagonal")?;
        number("stitch_epsilon", self.stitch_epsilon, 0.0, 1.0, "between 0 and 1 of an edge")?;
        let length = "a length of zero or more, in the model's unit";
        number("stitch_distance", self.stitch_distance.unwrap_or_default(), 0.0, f64::MAX, length)?;
        number("merge_distance", self.merge_distance.unwrap_or_default(), 0.0, f64::MAX, length)?;
        number("min_part_volume_pct", self.min_part_volume_pct, 0.0, 100.0, "between 0 and 100 percent")?;
        let share = "between 0 and 0.001 of the bounding box's diagonal";
        number("degenerate_tolerance", self.degenerate_tolerance, 0.0, 0.001, share)?;
        number("overlap_angle_deg", self.overlap_angle_deg.unwrap_or_default(), 0.0, 45.0, "between 0 and 45 degrees")?;
        number("twist_angle_deg", self.twist_angle_deg, 0.0, 180.0, "between 0 and 180 degrees")?;
        number("max_hole_edges", f64::from(self.max_hole_edges), 3.0, 10_000_000.0, "between 3 and 10000000 edges")?;
        number("max_hole_size", self.max_hole_size, 0.0, 1.0, "between 0 and 1 of the bounding box's diagonal")?;
        if let Some(most) = self.max_deviation {
            number("max_deviation", most, 0.0, f64::MAX, "a length of zero or more, in the model's unit")?;
        }
        if let Some(most) = self.max_faces {
            let most = f64::from(u32::try_from(most).unwrap_or(u32::MAX));
            number("max_faces", most, 4.0, f64::from(u32::MAX), "4 faces or more")?;
        }
        if let Some(most) = self.max_error {
            number("max_error", most, 0.0, f64::MAX, "a length of zero or more, in the model's unit")?;
        }
        if let Some(thickness) = self.thickness {
            number("thickness", thickness, f64::MIN_POSITIVE, f64::MAX, "a length above zero, in the model's unit")?;
        }
        if let Some(size) = self.voxel_size {
            number("voxel_size", size, f64::MIN_POSITIVE, f64::MAX, "a length above zero, in the model's unit")?;
        }
        number("voxel_resolution", f64::from(self.voxel_resolution), 16.0, 2000.0, "between 16 and 2000 voxels")?;
        #[expect(clippy::cast_precision_loss, reason = "compared with a small bound")]
        let faces = self.max_remesh_faces as f64;
        number("max_remesh_faces", faces, 1000.0, 20_000_000.0, "between 1000 and 20000000 faces")
    }
}

/// Names of operators: an array, or one string with commas, as a query says it.
fn operators_by_name<'de, D: serde::Deserializer<'de>>(from: D) -> Result<Vec<Operator>, D::Error> {
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
