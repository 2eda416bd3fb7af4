//! Options of an inspection: its level, its tolerances, and the printing parameters that it measures for.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::DefectKind;
use crate::scene::Unit;

/// How thoroughly a mesh is inspected, modelled on the levels of Parasolid's `PK_check_mesh_*`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// Counts and attributes only; searches for no defects.
    None,
    /// All searches that follow shared edges and vertices; omits spatial searches, such as slits and
    /// self-intersections.
    Basic,
    /// All searches.
    #[default]
    Full,
}

impl Level {
    /// Whether this level searches for a kind of defect. [`Level::Basic`] finds only sheets whose two sides use the
    /// same vertices.
    #[must_use]
    pub fn looks_for(self, kind: DefectKind) -> bool {
        use DefectKind as K;
        match self {
            Self::None => false,
            Self::Basic => !matches!(kind, K::Slit | K::SelfIntersection | K::TJunction | K::Crack | K::InnerShell),
            Self::Full => true,
        }
    }
}

/// Options of an inspection. Every field has a default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema, utoipa::IntoParams))]
#[serde(default)]
#[cfg_attr(feature = "openapi", into_params(parameter_in = Query))]
pub struct InspectOptions {
    /// How thoroughly the mesh is inspected.
    pub level: Level,
    /// Largest number of places that the report lists for each kind of defect, from 0 to 1000.
    #[cfg_attr(feature = "openapi", schema(minimum = 0, maximum = 1000))]
    pub places: usize,
    /// Distances and angles below which a defect is recognised.
    pub tolerances: Tolerances,
    /// Unit of the file's lengths; overrides a unit that the file states. Default: the file's unit, or millimetres if it states none.
    pub unit: Option<Unit>,
    /// Build direction, pointing away from the build plate; any length above 0.
    #[cfg_attr(feature = "openapi", schema(min_items = 3, max_items = 3))]
    pub up: [f64; 3],
    /// Additional overhang angle from the vertical, in degrees from 0 to 90. The report always has 30, 45 and 60
    /// degrees.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 90.0))]
    pub overhang_deg: f64,
    /// Side lengths of the printer's build volume along x, y and z, in millimetres.
    #[cfg_attr(feature = "openapi", schema(min_items = 3, max_items = 3))]
    pub build_volume: Option<[f64; 3]>,
    /// Whether wall thickness is measured only if the mesh is printable. A repair sets this for its input, because
    /// the result is what is printed. Walls of a defective mesh need winding numbers, half of the time of a small
    /// repair.
    #[serde(skip)]
    #[cfg_attr(feature = "openapi", schema(ignore))]
    #[cfg_attr(feature = "openapi", param(ignore))]
    pub walls_of_printable_only: bool,
}

impl Default for InspectOptions {
    fn default() -> Self {
        Self {
            level: Level::Full,
            places: 20,
            tolerances: Tolerances::default(),
            unit: None,
            up: [0.0, 0.0, 1.0],
            overhang_deg: 45.0,
            build_volume: None,
            walls_of_printable_only: false,
        }
    }
}

impl InspectOptions {
    /// Checks that every option is in its range.
    ///
    /// # Errors
    /// [`OptionsError`] for the first option out of range.
    pub fn validate(&self) -> Result<(), OptionsError> {
        #[expect(clippy::cast_precision_loss, reason = "compared with a small bound")]
        let places = self.places as f64;
        OptionsError::unless_within("places", places, (0.0, 1000.0), "from 0 to 1000 places per defect kind")?;
        self.tolerances.validate().map_err(|error| OptionsError {
            option: error.name,
            value: error.value.to_string(),
            expected: "a finite number, 0 or greater",
        })?;
        let degrees = "from 0 to 90 degrees from the vertical";
        OptionsError::unless_within("overhang_deg", self.overhang_deg, (0.0, 90.0), degrees)?;
        let up: f64 = self.up.iter().map(|x| x.abs()).sum();
        OptionsError::unless_within(
            "up",
            up,
            (f64::MIN_POSITIVE, f64::MAX),
            "three finite numbers that are not all 0",
        )?;
        let smallest = self.build_volume.map_or(1.0, |sides| sides.into_iter().fold(f64::MAX, f64::min));
        OptionsError::unless_within("build_volume", smallest, (f64::MIN_POSITIVE, f64::MAX), "three lengths above 0")
    }
}

/// A distance threshold, relative to the mesh or absolute.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Tolerance {
    /// Fraction of the diagonal of the mesh's bounding box.
    OfDiagonal(f64),
    /// Length in the model's unit.
    Absolute(f64),
}

impl Tolerance {
    fn number(self) -> f64 {
        match self {
            Self::OfDiagonal(number) | Self::Absolute(number) => number,
        }
    }

    /// The tolerance as a length on a scale where the model's unit measures `1 / scale`, for a mesh with this
    /// diagonal on that scale. Returns 0 for NaN and negative values, so that only exact coincidence counts.
    fn length(self, diagonal: f64, scale: f64) -> f64 {
        let length = match self {
            Self::OfDiagonal(share) => share * diagonal,
            Self::Absolute(length) => length / scale,
        };
        if length >= 0.0 { length } else { 0.0 }
    }
}

/// Thresholds below which a defect is recognised, modelled on Parasolid's `tolerance` and `defect_tolerances`.
///
/// An omitted override takes the value of `linear`. At 0 exact predicates find exact defects only; above 0, lengths
/// are measured in f64.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Tolerances {
    /// Default for omitted overrides. 1e-7 of the diagonal by default, roughly the spacing of f32 coordinates at the
    /// model's size.
    pub linear: Tolerance,
    /// Largest angle between two faces at an edge, in radians, at which the edge counts as a fold. 0.01 by default.
    pub foldover_angle: f64,
    /// Largest distance between a folded face and the face that it lies on.
    pub foldover_height: Option<Tolerance>,
    /// Height below which a face is flat, and edge length below which a face is degenerate.
    pub degenerate: Option<Tolerance>,
    /// Largest distance between two boundary edges that form a slit.
    pub slit: Option<Tolerance>,
    /// Largest distance between a T-junction's vertex and the boundary edge that it lies on.
    pub t_junction: Option<Tolerance>,
    /// Thickness up to which two opposite surfaces count as a sheet.
    pub sheet: Option<Tolerance>,
    /// Largest width of a crack, the gap between two almost coincident boundaries. The width is also at most a fifth
    /// of the boundary edge's length. 1e-4 of the diagonal by default.
    pub crack: Tolerance,
    /// Bounding-box diagonal below which a part is too small to print. 1e-3 of the mesh's diagonal by default.
    pub tiny_part: Tolerance,
}

impl Default for Tolerances {
    fn default() -> Self {
        Self {
            linear: Tolerance::OfDiagonal(1e-7),
            foldover_angle: 0.01,
            foldover_height: None,
            degenerate: None,
            slit: None,
            t_junction: None,
            sheet: None,
            crack: Tolerance::OfDiagonal(1e-4),
            tiny_part: Tolerance::OfDiagonal(1e-3),
        }
    }
}

/// A tolerance that is negative or not finite.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("`{name}` must be a finite number, 0 or greater; got {value}.")]
pub struct ToleranceError {
    /// Name of the field of [`Tolerances`].
    pub name: &'static str,
    /// The rejected value.
    pub value: f64,
}

impl Tolerances {
    /// Checks that every tolerance is finite and at least 0.
    ///
    /// # Errors
    /// [`ToleranceError`] for the first invalid tolerance.
    pub fn validate(&self) -> Result<(), ToleranceError> {
        let all = [
            ("linear", Some(self.linear)),
            ("foldover_angle", Some(Tolerance::Absolute(self.foldover_angle))),
            ("foldover_height", self.foldover_height),
            ("degenerate", self.degenerate),
            ("slit", self.slit),
            ("t_junction", self.t_junction),
            ("sheet", self.sheet),
            ("crack", Some(self.crack)),
            ("tiny_part", Some(self.tiny_part)),
        ];
        let given = all.into_iter().filter_map(|(name, tolerance)| Some((name, tolerance?.number())));
        match given.into_iter().find(|&(_, value)| !(value.is_finite() && value >= 0.0)) {
            Some((name, value)) => Err(ToleranceError { name, value }),
            None => Ok(()),
        }
    }

    /// Converts the tolerances to lengths on a scale where the model's unit measures `1 / scale`.
    pub(super) fn lengths(&self, diagonal: f64, scale: f64) -> ToleranceLengths {
        let length = |tolerance: Tolerance| tolerance.length(diagonal, scale);
        let or_linear = |given: Option<Tolerance>| length(given.unwrap_or(self.linear));
        ToleranceLengths {
            foldover_angle: self.foldover_angle,
            foldover_height: or_linear(self.foldover_height),
            degenerate: or_linear(self.degenerate),
            slit: or_linear(self.slit),
            t_junction: or_linear(self.t_junction),
            sheet: or_linear(self.sheet),
            crack: length(self.crack),
            tiny_part: length(self.tiny_part),
        }
    }
}

/// [`Tolerances`] converted to lengths, in the coordinates of [`Analysis::unit`](super::Analysis::unit).
#[derive(Debug, Clone, Copy)]
pub(super) struct ToleranceLengths {
    /// See [`Tolerances::foldover_angle`]; in radians.
    pub foldover_angle: f64,
    /// See [`Tolerances::foldover_height`].
    pub foldover_height: f64,
    /// See [`Tolerances::degenerate`].
    pub degenerate: f64,
    /// See [`Tolerances::slit`].
    pub slit: f64,
    /// See [`Tolerances::t_junction`].
    pub t_junction: f64,
    /// See [`Tolerances::sheet`].
    pub sheet: f64,
    /// See [`Tolerances::crack`].
    pub crack: f64,
    /// See [`Tolerances::tiny_part`].
    pub tiny_part: f64,
}

/// Serializes the fields that differ from their defaults as a JSON object.
#[must_use]
pub fn changed_fields<T: Serialize>(options: &T, defaults: &T) -> Map<String, Value> {
    let [fields, defaults] = [options, defaults].map(|value| serde_json::to_value(value).unwrap_or_default());
    let Value::Object(mut fields) = fields else { return Map::new() };
    fields.retain(|name, value| defaults.get(name.as_str()) != Some(value));
    fields
}

/// An option out of its allowed range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("`{option}` must be {expected}; got {value}.")]
pub struct OptionsError {
    /// Name of the option.
    pub option: &'static str,
    /// The rejected value.
    pub value: String,
    /// Description of the allowed values.
    pub expected: &'static str,
}

impl OptionsError {
    /// Checks that a number is in the closed range from `low` to `high`. NaN is out of range.
    ///
    /// # Errors
    /// [`OptionsError`] if the number is out of range.
    pub fn unless_within(
        option: &'static str,
        value: f64,
        (low, high): (f64, f64),
        expected: &'static str,
    ) -> Result<(), Self> {
        if (low..=high).contains(&value) { Ok(()) } else { Err(Self { option, value: value.to_string(), expected }) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn omitted_overrides_take_the_linear_tolerance() {
        let given = Tolerances {
            linear: Tolerance::OfDiagonal(0.5),
            slit: Some(Tolerance::Absolute(3.0)),
            ..Tolerances::default()
        };
        let lengths = given.lengths(8.0, 2.0);
        assert_eq!((lengths.degenerate, lengths.slit), (4.0, 1.5));
    }

    #[test]
    fn invalid_tolerances_are_rejected_by_field_name() {
        assert_eq!(Tolerances::default().validate(), Ok(()));
        for bad in [f64::NAN, f64::INFINITY, -1.0] {
            let slit = Tolerances { slit: Some(Tolerance::OfDiagonal(bad)), ..Tolerances::default() };
            assert_eq!(slit.validate().unwrap_err().name, "slit");
            let angle = Tolerances { foldover_angle: bad, ..Tolerances::default() };
            assert_eq!(angle.validate().unwrap_err().name, "foldover_angle");
        }
    }

    #[test]
    fn omitted_json_fields_take_their_defaults() {
        let json = r#"{"linear": {"absolute": 0.01}, "crack": {"of_diagonal": 0.001}}"#;
        let read: Tolerances = serde_json::from_str(json).unwrap();
        assert_eq!((read.linear, read.crack), (Tolerance::Absolute(0.01), Tolerance::OfDiagonal(0.001)));
        assert_eq!(read.tiny_part, Tolerances::default().tiny_part);
        assert!(serde_json::from_str::<Tolerances>(r#"{"slits": 1}"#).is_err());
    }
}
