//! The options of a repair: their fields, defaults and ranges.
//!
//! The fields' docs are the options' reference: OpenAPI, `docs/options.md` and the command line's help show them.

mod choices;
mod operator;
mod print;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

pub use self::choices::{
    Category, HoleFilling, Merge, Nested, OpenSheets, OutputFormat, Overlaps, Preset, Require, StitchPosition, Verify,
    WindingRuleChoice,
};
pub use self::operator::Operator;
pub use self::print::{Interior, Islands, PrintOptions, Voids, WallGrowth};
use crate::format::ReadOptions;
use crate::inspect::{OptionsError, changed_fields};
use crate::scene::Unit;

/// The options of a repair. Every field has a default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema, utoipa::IntoParams))]
#[serde(default)]
#[cfg_attr(feature = "openapi", into_params(parameter_in = Query))]
pub struct Options {
    /// Repair plan to run. `auto` chooses a plan by the damage found; a named preset is tried first.
    pub preset: Preset,
    /// Category of damage to plan for, instead of the category that the inspection finds. The option has an effect only with `preset=auto`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub category: Option<Category>,
    /// File format of the result. `auto` writes STL unless the input has objects, colours or a unit, which STL cannot store.
    pub output: OutputFormat,
    /// Treatment of separate objects in 3MF and GLB files. `auto` unites objects that intersect and keeps the others separate.
    pub merge: Merge,
    /// Result that the repair must reach to succeed. With `printable`, a result that is not printable fails, and no model is returned.
    pub require: Require,
    /// Extent of the check of a result for intersecting faces. Both values give the same verdict; `full` takes longer, and does not rely on
    /// the inspection of the input.
    pub verify: Verify,
    /// Unit of the file's lengths; overrides a unit that the file states. Default: the file's unit, or millimetres if it states none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit: Option<Unit>,
    /// Unit to convert the model to. Default: no conversion. Options that are lengths are in this unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale_to: Option<Unit>,
    /// Additional operators to run that are off by default, such as `remove_overlapping_neighbours`.
    #[cfg_attr(feature = "openapi", param(explode = false))]
    #[serde(deserialize_with = "operators_by_name")]
    pub with: Vec<Operator>,
    /// Operators to leave out. Use it to switch off a repair step that you do not want.
    #[cfg_attr(feature = "openapi", param(explode = false))]
    #[serde(deserialize_with = "operators_by_name")]
    pub without: Vec<Operator>,
    /// Farthest that the repair may move surface, or create surface away from the input, in the model's unit. Patches over holes are
    /// exempt. Defects that cannot be fixed within this distance remain and are reported. Default: no limit.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0))]
    pub max_deviation: Option<f64>,
    /// Most faces that the result should have. Edges are collapsed until the result has no more faces, or until the error limit is
    /// reached: `max_error`, or without it 0.5 % of the bounding box's diagonal. Default: faces are not reduced.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 4, maximum = 4294967295u64))]
    pub max_faces: Option<u64>,
    /// Largest distance, in both directions, between the surface before and after faces are reduced, in the model's unit. Without
    /// `max_faces`, faces are reduced as far as this distance allows; a tiny value removes only faces that flat areas do not need.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0))]
    pub max_error: Option<f64>,
    /// Highest repair tier that may run: 1 cleans up and closes simple holes, 2 also repairs cracks, non-manifold edges and
    /// intersecting faces, 3 also uses Blender. Lower it for faster repairs that change less.
    #[cfg_attr(feature = "openapi", schema(minimum = 1, maximum = 3))]
    pub max_tier: u8,
    /// Time limit in seconds, from the start of the repair. The repair may overrun the limit by at most 2 s plus 10 %. The best
    /// result verified until then is returned; if there was no time to inspect the input, the repair fails. `omitted` in the report lists
    /// the skipped work.
    #[cfg_attr(feature = "openapi", schema(minimum = 1.0, maximum = 3600.0))]
    pub deadline_s: f64,
    /// Largest accepted loss of faces, in percent. A larger loss raises the red flag `face_loss`. A result with a red flag is at most
    /// `partially_repaired`.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 100.0))]
    pub max_face_loss_pct: f64,
    /// Largest accepted loss of vertices, in percent. A larger loss raises the red flag `vertex_loss`. A vertex is lost if no part of a
    /// face at this vertex is left.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 100.0))]
    pub max_vertex_loss_pct: f64,
    /// Largest accepted move of a side of the bounding box, in percent of the box's diagonal. A larger move raises the red flag
    /// `bounding_box_change`.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 1000.0))]
    pub max_bounding_box_change_pct: f64,
    /// Largest accepted change of the volume, in percent. A larger change raises the red flag `volume_change`. The repair checks it only if the
    /// input's volume is reliable.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 1000.0))]
    pub max_volume_change_pct: f64,
    /// Largest accepted share, in percent, of the surface visible from outside that has no counterpart in the result. More raises the
    /// red flag `surface_lost`.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 100.0))]
    pub max_surface_lost_pct: f64,
    /// Largest accepted share, in percent, of the result's surface that the input does not have: thickened sheets, and patches
    /// of holes that each exceed 2 % of the surface. More raises the red flag `surface_invented`.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 100.0))]
    pub max_surface_added_pct: f64,
    /// Distance within which boundary vertices are merged, as a share of the bounding box's diagonal. 0 merges only equal positions.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 0.01))]
    pub weld_tolerance: f64,
    /// Distance within which any vertices are merged, on a boundary or not, in the model's unit. Default: only equal positions are
    /// merged, and boundary vertices within `weld_tolerance`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0))]
    pub merge_distance: Option<f64>,
    /// Distance within which boundary vertices are merged, as a share of the shortest boundary edge at either vertex. 0 turns this merge
    /// off. Default: 0.2, for vertices no farther apart than 0.1 % of the bounding box's diagonal.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 0.5))]
    pub sew_ratio: Option<f64>,
    /// Widest crack to stitch, as a share of the bounding box's diagonal. 0 stitches none. Default: 0.001. A gap wider than half the
    /// length of its edges counts as a hole, not as a crack.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 1.0))]
    pub stitch_threshold: Option<f64>,
    /// Widest crack to stitch, in the model's unit; replaces `stitch_threshold`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0))]
    pub stitch_distance: Option<f64>,
    /// Share of an edge's length at each end within which stitching uses the end vertex instead of splitting the edge. With 0.5 or more,
    /// stitching never splits an edge.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 1.0))]
    pub stitch_epsilon: f64,
    /// Position of the vertex that results from stitching two vertices.
    pub stitch_position: StitchPosition,
    /// Size below which edges and faces are degenerate, as a share of the bounding box's diagonal. Shorter edges and faces of less height
    /// are removed, and surface folded onto itself this closely is unfolded. 0 leaves them.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 0.001))]
    pub degenerate_tolerance: f64,
    /// Angle in degrees up to which two neighbouring faces count as lying on each other. The option needs
    /// `with=remove_overlapping_neighbours`. Default: 1, for faces no farther apart than 0.01 % of the bounding box's diagonal.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 45.0))]
    pub overlap_angle_deg: Option<f64>,
    /// Angle in degrees by which a polygon's corners may leave its plane. A more twisted polygon is split into the triangles with the
    /// smallest fold, others as if flat. With 180 all polygons are split as if flat, which matches most other programs.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 180.0))]
    pub twist_angle_deg: f64,
    /// Most boundary edges of a hole that may be closed. Holes with more edges stay open.
    #[cfg_attr(feature = "openapi", schema(minimum = 3, maximum = 10000000))]
    pub max_hole_edges: u32,
    /// Smallest volume of a closed part, in percent of the volume of all parts. Smaller parts are removed. 0 keeps all parts.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 100.0))]
    pub min_part_volume_pct: f64,
    /// Orientation of closed parts that lie inside other parts: as in the input, or each layer opposite to the layer around it.
    pub nested: Nested,
    /// Treatment of parts that overlap: unite them into one solid, or keep each part separate.
    pub overlaps: Overlaps,
    /// Rule for what counts as solid where faces intersect.
    pub winding_rule: WindingRuleChoice,
    /// Treatment of open sheets: surface that encloses nothing, such as terrain or a single wall.
    pub open_sheets: OpenSheets,
    /// Thickness of thickened sheets, and of a base at its lowest point, in the model's unit. Default: 0.3 % of the bounding box's
    /// diagonal.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(exclusive_minimum = 0.0))]
    pub thickness: Option<f64>,
    /// Largest extent of a hole that may be closed, as a share of the bounding box's diagonal. 1 closes holes of any size.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 1.0))]
    pub max_hole_size: f64,
    /// Most holes to close. If there are more, the smallest holes are closed.
    #[cfg_attr(feature = "openapi", schema(minimum = 0, maximum = 4294967295u64))]
    pub max_holes: u32,
    /// Method that triangulates the patch over a hole.
    pub hole_filling: HoleFilling,
    /// Whether curved patches get inner vertices, as dense as the mesh around the hole.
    pub refine_patches: bool,
    /// Whether patches are refined and then curved to continue the surrounding surface smoothly.
    pub fair_patches: bool,
    /// Edge length of the voxels of a remesh, native or with Blender, in the model's unit. Default: it follows from `voxel_resolution`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(exclusive_minimum = 0.0))]
    pub voxel_size: Option<f64>,
    /// Number of voxels along the bounding box's diagonal in a remesh. More voxels keep finer detail and take more time and memory.
    #[cfg_attr(feature = "openapi", schema(minimum = 16, maximum = 2000))]
    pub voxel_resolution: u32,
    /// Most faces that a remesh may have. Voxels are enlarged until the estimated number of faces is below this limit.
    #[cfg_attr(feature = "openapi", schema(minimum = 1000, maximum = 20000000))]
    pub max_remesh_faces: u64,
    /// Whether pictures of the defects and of the changes are offered: `before.png`, `after.png`, `defects.glb`, `defects.ply`,
    /// `change.png`, `change.glb` and `change.ply`. The first request for one of them draws all.
    pub pictures: bool,
    /// Whether to also offer other results where the file leaves the model's intent open. Example: a double shell may be meant as a solid or
    /// as hollow. Each result is a further repair within `deadline_s`. A job offers up to three results; the parameter `choice` of a download
    /// selects one.
    pub alternatives: bool,
    /// Options that prepare the model for a printing process.
    #[serde(flatten)]
    #[cfg_attr(feature = "openapi", param(ignore))]
    pub print: PrintOptions,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            preset: Preset::Auto,
            category: None,
            output: OutputFormat::Auto,
            merge: Merge::Auto,
            require: Require::Any,
            verify: Verify::Changed,
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
            alternatives: false,
            print: PrintOptions::default(),
        }
    }
}

impl Options {
    /// The options that differ from their defaults, as JSON.
    #[must_use]
    pub fn to_changed_fields(&self) -> Map<String, Value> {
        changed_fields(self, &Self::default())
    }

    /// Whether the options ask for fewer faces: `max_faces` or `max_error` is set.
    #[must_use]
    pub fn asks_for_fewer_faces(&self) -> bool {
        self.max_faces.is_some() || self.max_error.is_some()
    }

    /// Whether the options ask for fewer faces than a model with `faces` faces has.
    #[must_use]
    pub fn asks_for_fewer_faces_than(&self, faces: u64) -> bool {
        self.max_faces.map_or(self.max_error.is_some(), |most| faces > most)
    }

    /// Checks that each option is within its range.
    ///
    /// # Errors
    /// [`OptionsError`] for the first option that is out of its range.
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
        number("stitch_epsilon", self.stitch_epsilon, 0.0, 1.0, "between 0 and 1 of an edge's length")?;
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
        number("max_remesh_faces", faces, 1000.0, 20_000_000.0, "between 1000 and 20000000 faces")?;
        if self.require == Require::PrintReady && self.print.process.is_none() {
            let (value, expected) = ("print_ready".to_owned(), "`any` or `printable` without `process`");
            return Err(OptionsError { option: "require", value, expected });
        }
        self.print.validate()
    }
}

/// Reads operators by name from an array, or from one comma-separated string as in a URL query.
fn operators_by_name<'de, D: serde::Deserializer<'de>>(from: D) -> Result<Vec<Operator>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Names {
        Several(Vec<String>),
        One(String),
    }
    let names = match Names::deserialize(from)? {
        Names::Several(names) => names,
        Names::One(names) => {
            names.split(',').map(|name| name.trim().to_owned()).filter(|name| !name.is_empty()).collect()
        }
    };
    let all_names = || Operator::ALL.iter().map(|o| o.as_str()).collect::<Vec<_>>().join(", ");
    let operator_named =
        |name: &String| {
            Operator::ALL.iter().copied().find(|o| o.as_str() == name).ok_or_else(|| {
                serde::de::Error::custom(format!("unknown operator `{name}`; use one of {}", all_names()))
            })
        };
    names.iter().map(operator_named).collect()
}
