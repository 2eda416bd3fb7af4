//! The options that prepare a model for printing: the process, walls, cavities, the interior, and the size.

use serde::{Deserialize, Serialize};

use crate::inspect::OptionsError;
use crate::printing::profile::{ProcessLimits, Profile, checked_profile};

/// The options of a repair that prepare the model for a printing process.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema, utoipa::IntoParams))]
#[serde(default)]
#[cfg_attr(feature = "openapi", into_params(parameter_in = Query))]
pub struct PrintOptions {
    /// Printing process to check the result against, such as `fdm-0.4` or `sls-pa12`. `GET /v1/profiles` and `meshmend profiles` list all
    /// names. The report's `print_ready` has the result for each rule.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub process: Option<String>,
    /// Limits that replace those of the process's profile. Absent limits stay as they are.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub process_limits: Option<ProcessLimits>,
    /// Least wall thickness in millimetres. Thinner walls are thickened; all other surface stays. Default: walls keep their thickness.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(exclusive_minimum = 0.0))]
    pub min_wall: Option<f64>,
    /// Whether thin walls are thickened to the process's limit for free walls. The option needs `process`; `min_wall` overrides the limit.
    pub thicken_to_process: bool,
    /// Side on which thin walls grow.
    pub wall_growth: WallGrowth,
    /// Treatment of the space inside a model. `auto` fills the space in a double shell, which 3D model generators often produce.
    pub interior: Interior,
    /// Widest opening, in millimetres, that is sealed when the interior is filled. Default: 0.6 % to 2.4 % of the bounding box's diagonal,
    /// depending on the model, and more where a few missing faces left a wider opening.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(exclusive_minimum = 0.0))]
    pub seal_mm: Option<f64>,
    /// Treatment of small separate solids: smaller than the process allows or, without a process, than 0.01 % of the model's volume.
    pub islands: Islands,
    /// Treatment of sealed cavities.
    pub voids: Voids,
    /// Volume in mm³ above which sealed cavities are kept or vented, as `voids` says. Smaller cavities are filled. Default: `voids`
    /// applies to all cavities.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0))]
    pub keep_cavities_over_mm3: Option<f64>,
    /// Diameter of the holes that `voids=vent` drills, in millimetres. Default: the diameter of the process's escape holes, or 4 mm without a
    /// process.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(exclusive_minimum = 0.0))]
    pub vent_diameter_mm: Option<f64>,
    /// Height of the result in millimetres, along the file's up axis. The model is scaled evenly before the repair.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(exclusive_minimum = 0.0))]
    pub target_height_mm: Option<f64>,
    /// Longest side of the result's bounding box, in millimetres. The model is scaled evenly before the repair.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "openapi", schema(exclusive_minimum = 0.0))]
    pub target_longest_mm: Option<f64>,
}

/// The side on which thin walls grow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum WallGrowth {
    /// Grow walls on both sides.
    #[default]
    Both,
    /// Grow walls outward. Inner surfaces, such as those that hold another part, stay.
    Outward,
    /// Grow walls inward. Outer surfaces stay.
    Inward,
}

/// The treatment of the space inside a model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Interior {
    /// Fill the interior of a double shell that is not printable: two nested, nearly parallel skins around a void. Keep any other interior.
    #[default]
    Auto,
    /// Keep the interior as the surface encloses it.
    Keep,
    /// Fill all space that cannot be reached from outside through an opening wider than `seal_mm`.
    Fill,
}

/// The treatment of small separate solids.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Islands {
    /// Keep small solids, but remove them from a double shell and with the preset `generated`.
    #[default]
    Auto,
    /// Keep small solids.
    Keep,
    /// Remove small solids.
    Drop,
    /// Remove small solids, and attach all other separate solids to the largest solid with struts.
    Attach,
}

impl Islands {
    /// The setting of [`Islands::Keep`], by which an assumption names the way to keep small solids.
    pub(in crate::repair) const KEEP_SETTING: &str = "islands=keep";

    /// Whether small solids are removed; `auto` removes them only if the interior is filled.
    #[must_use]
    pub fn drops(self, is_interior_filled: bool) -> bool {
        match self {
            Self::Auto => is_interior_filled,
            Self::Keep => false,
            Self::Drop | Self::Attach => true,
        }
    }
}

/// The treatment of sealed cavities.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Voids {
    /// Keep cavities hollow.
    #[default]
    Keep,
    /// Make cavities solid.
    Fill,
    /// Drill holes through which powder or resin can leave each cavity.
    Vent,
}

/// Diameter of vents without a process, in millimetres.
const VENT_DIAMETER_MM: f64 = 4.0;
/// Volume of a solid that counts as an island without a process, as a share of the whole.
const ISLAND_SHARE: f64 = 1e-4;

impl PrintOptions {
    /// Whether the options ask for a size, so that the model is scaled.
    #[must_use]
    pub fn asks_for_size(&self) -> bool {
        self.target_height_mm.is_some() || self.target_longest_mm.is_some()
    }

    /// Checks that each option is within its range, and that the process exists.
    ///
    /// # Errors
    /// [`OptionsError`] for the first wrong option.
    pub fn validate(&self) -> Result<(), OptionsError> {
        let lengths = [
            ("min_wall", self.min_wall),
            ("seal_mm", self.seal_mm),
            ("vent_diameter_mm", self.vent_diameter_mm),
            ("target_height_mm", self.target_height_mm),
            ("target_longest_mm", self.target_longest_mm),
        ];
        for (option, length) in lengths {
            if let Some(length) = length {
                let expected = "a length above zero, in millimetres";
                OptionsError::unless_within(option, length, (f64::MIN_POSITIVE, f64::MAX), expected)?;
            }
        }
        if let Some(volume) = self.keep_cavities_over_mm3 {
            let expected = "a volume of zero or more, in mm³";
            OptionsError::unless_within("keep_cavities_over_mm3", volume, (0.0, f64::MAX), expected)?;
        }
        if self.target_height_mm.is_some() && self.target_longest_mm.is_some() {
            let expected = "absent if `target_height_mm` is set";
            return Err(wrong("target_longest_mm", self.target_longest_mm.unwrap_or_default().to_string(), expected));
        }
        if self.thicken_to_process && self.process.is_none() {
            return Err(wrong("thicken_to_process", "true".to_owned(), "false without `process`"));
        }
        checked_profile(self.process.as_deref(), self.process_limits.as_ref()).map(|_| ())
    }

    /// The profile of the process; `None` without a process.
    #[must_use]
    pub fn profile(&self) -> Option<Profile> {
        checked_profile(self.process.as_deref(), self.process_limits.as_ref()).ok().flatten()
    }

    /// The least wall thickness to thicken to, in millimetres; `None` if walls keep their thickness.
    #[must_use]
    pub fn wall_to_reach_mm(&self) -> Option<f64> {
        self.min_wall.or_else(|| if self.thicken_to_process { self.process_wall_mm() } else { None })
    }

    /// The least wall thickness that a printable result has, in millimetres; `None` if no option states one.
    #[must_use]
    pub fn wall_limit_mm(&self) -> Option<f64> {
        self.min_wall.or_else(|| self.process_wall_mm()).filter(|&limit| limit > 0.0)
    }

    /// The process's limit for free walls, in millimetres.
    fn process_wall_mm(&self) -> Option<f64> {
        self.profile().map(|profile| profile.free_wall_mm.limit)
    }

    /// Least volume of a separate solid, in cubic units of `millimetres` length: the limit of the process, or a share of `whole`.
    #[must_use]
    pub fn min_island_volume(&self, millimetres: f64, whole: impl FnOnce() -> f64) -> f64 {
        self.profile()
            .map_or_else(|| whole() * ISLAND_SHARE, |profile| profile.part_volume_mm3.limit / millimetres.powi(3))
    }

    /// Whether sealed cavities are filled: all of them, or those up to `keep_cavities_over_mm3`.
    #[must_use]
    pub fn fills_cavities(&self) -> bool {
        self.voids == Voids::Fill || self.keep_cavities_over_mm3.is_some()
    }

    /// Diameter of vents, in millimetres, and their number per cavity.
    #[must_use]
    pub fn vents(&self) -> (f64, u32) {
        let holes = self.profile().and_then(|profile| profile.escape_holes);
        let diameter = self.vent_diameter_mm.or(holes.as_ref().map(|holes| holes.diameter_mm));
        (diameter.unwrap_or(VENT_DIAMETER_MM), holes.map_or(1, |holes| holes.count))
    }
}

fn wrong(option: &'static str, value: String, expected: &'static str) -> OptionsError {
    OptionsError { option, value, expected }
}
