//! What is looked for in a mesh, how closely, and with which tolerances.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::DefectKind;
use crate::scene::Unit;

/// How closely a mesh is looked at, after Parasolid's `PK_check_mesh_*` (seed 002).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// Counts and attributes only; no defect is looked for.
    None,
    /// Without what needs a search in space: slits, self-intersections and other neighbours that do not share an edge.
    Basic,
    /// Everything.
    #[default]
    Full,
}

impl Level {
    /// Whether a kind of defect is looked for. Sheets are at level basic as far as their two sides have the same faces.
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

/// What to look for, and how. Every field has a default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema, utoipa::IntoParams))]
#[serde(default)]
#[cfg_attr(feature = "openapi", into_params(parameter_in = Query))]
pub struct InspectOptions {
    /// How closely.
    pub level: Level,
    /// Places of each kind of defect that the report lists.
    #[cfg_attr(feature = "openapi", schema(minimum = 0, maximum = 1000))]
    pub places: usize,
    /// How closely things must agree to count as the same.
    pub tolerances: Tolerances,
    /// The unit of the file's lengths, whatever it says itself. Without it, and where the file says none, millimetres are assumed.
    pub unit: Option<Unit>,
    /// The direction in which the model is built, of any length but zero.
    #[cfg_attr(feature = "openapi", schema(min_items = 3, max_items = 3))]
    pub up: [f64; 3],
    /// An angle from the vertical, in degrees from 0 to 90, for which the area of overhangs is told beside 30, 45 and 60.
    #[cfg_attr(feature = "openapi", schema(minimum = 0.0, maximum = 90.0))]
    pub overhang_deg: f64,
    /// Sides of the printer's build volume, in millimetres.
    #[cfg_attr(feature = "openapi", schema(min_items = 3, max_items = 3))]
    pub build_volume: Option<[f64; 3]>,
    /// Whether walls are measured of a printable mesh only. A repair asks for that of its input: what is printed is the result, and
    /// walls of a mesh with faults take winding numbers, which is half of the time of a small repair.
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
    /// Checks every range.
    ///
    /// # Errors
    /// The first option that is out of its range.
    pub fn validate(&self) -> Result<(), OptionsError> {
        #[expect(clippy::cast_precision_loss, reason = "compared with a small bound")]
        let places = self.places as f64;
        OptionsError::unless_within("places", places, (0.0, 1000.0), "between 0 and 1000 places of each kind")?;
        self.tolerances.validate().map_err(|error| OptionsError {
            option: error.name,
            value: error.value.to_string(),
            expected: "a finite number that is not negative",
        })?;
        let degrees = "between 0 and 90 degrees from the vertical";
        OptionsError::unless_within("overhang_deg", self.overhang_deg, (0.0, 90.0), degrees)?;
        let up: f64 = self.up.iter().map(|x| x.abs()).sum();
        OptionsError::unless_within("up", up, (f64::MIN_POSITIVE, f64::MAX), "a direction that is not zero")?;
        let smallest = self.build_volume.map_or(1.0, |sides| sides.into_iter().fold(f64::MAX, f64::min));
        OptionsError::unless_within("build_volume", smallest, (f64::MIN_POSITIVE, f64::MAX), "three lengths above zero")
    }
}

/// A length below which something counts as nothing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Tolerance {
    /// A share of the diagonal of the box around the mesh.
    OfDiagonal(f64),
    /// A length in the model's unit.
    Absolute(f64),
}

impl Tolerance {
    fn number(self) -> f64 {
        match self {
            Self::OfDiagonal(number) | Self::Absolute(number) => number,
        }
    }

    /// The length in a unit of which the model's unit has `scale`, in a mesh of this diagonal in that unit. What is no
    /// length is 0: only what is exactly nothing counts then.
    fn length(self, diagonal: f64, scale: f64) -> f64 {
        let length = match self {
            Self::OfDiagonal(share) => share * diagonal,
            Self::Absolute(length) => length / scale,
        };
        if length >= 0.0 { length } else { 0.0 }
    }
}

/// How closely things must agree to count as the same, after Parasolid's `tolerance` and `defect_tolerances` (seed 002).
///
/// An override that is not given is the linear tolerance. A tolerance of 0 finds only what is so exactly, decided by
/// exact predicates; above 0 lengths are measured in f64.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Tolerances {
    /// What no override is given for. By default 1e-7 of the diagonal, about the distance of neighbouring 32-bit numbers
    /// at the size of the model.
    pub linear: Tolerance,
    /// Largest angle between the two faces of an edge, in radians, at which the edge is a fold. By default 0.01.
    pub foldover_angle: f64,
    /// How far faces may stand off from those that they are folded on.
    pub foldover_height: Option<Tolerance>,
    /// Smallest height of a face that is not flat, and smallest edge of one that is not degenerate.
    pub degenerate: Option<Tolerance>,
    /// Distance of boundary edges that are at the same place.
    pub slit: Option<Tolerance>,
    /// Distance of a vertex from the boundary edge that it lies on.
    pub t_junction: Option<Tolerance>,
    /// Thickness of surface that has none.
    pub sheet: Option<Tolerance>,
    /// Widest gap between boundaries that nearly coincide; never more than a fifth of an edge's length is taken for one.
    /// By default 1e-4 of the diagonal.
    pub crack: Tolerance,
    /// Diagonal of the largest part that is too small to print. By default 1e-3 of the whole diagonal.
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

/// A tolerance that is no length or angle.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("the tolerance '{name}' is {value}, but a finite number that is not negative was expected")]
pub struct ToleranceError {
    /// Its field in [`Tolerances`].
    pub name: &'static str,
    /// What was given.
    pub value: f64,
}

impl Tolerances {
    /// Whether every tolerance is a finite number that is not negative.
    ///
    /// # Errors
    /// [`ToleranceError`] for the first that is not.
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

    /// The tolerances as lengths in a unit of which the model's unit has `scale`.
    pub(super) fn lengths(&self, diagonal: f64, scale: f64) -> Lengths {
        let length = |tolerance: Tolerance| tolerance.length(diagonal, scale);
        let or_linear = |given: Option<Tolerance>| length(given.unwrap_or(self.linear));
        Lengths {
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

/// [`Tolerances`] as lengths, in the unit of [`Analysis::unit`](super::Analysis::unit).
#[derive(Debug, Clone, Copy)]
pub(super) struct Lengths {
    pub foldover_angle: f64,
    pub foldover_height: f64,
    pub degenerate: f64,
    pub slit: f64,
    pub t_junction: f64,
    pub sheet: f64,
    pub crack: f64,
    pub tiny_part: f64,
}

/// The fields of options that differ from their defaults, as JSON.
#[must_use]
pub fn changed_fields<T: Serialize>(options: &T, defaults: &T) -> Map<String, Value> {
    let [fields, defaults] = [options, defaults].map(|it| serde_json::to_value(it).unwrap_or_default());
    let Value::Object(mut fields) = fields else { return Map::new() };
    fields.retain(|name, value| defaults.get(name.as_str()) != Some(value));
    fields
}

/// An option outside what it may be.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("`{option}` must be {expected}; got {value}.")]
pub struct OptionsError {
    /// The option's name.
    pub option: &'static str,
    /// What was given.
    pub value: String,
    /// What is allowed, in words.
    pub expected: &'static str,
}

impl OptionsError {
    /// Checks that a number lies in its range; one that is none does not.
    ///
    /// # Errors
    /// The error, when it does not.
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
    fn an_override_that_is_not_given_is_the_linear_tolerance() {
        let given = Tolerances {
            linear: Tolerance::OfDiagonal(0.5),
            slit: Some(Tolerance::Absolute(3.0)),
            ..Tolerances::default()
        };
        let lengths = given.lengths(8.0, 2.0);
        assert_eq!((lengths.degenerate, lengths.slit), (4.0, 1.5));
    }

    #[test]
    fn tolerances_that_are_no_numbers_are_refused_by_name() {
        assert_eq!(Tolerances::default().validate(), Ok(()));
        for bad in [f64::NAN, f64::INFINITY, -1.0] {
            let slit = Tolerances { slit: Some(Tolerance::OfDiagonal(bad)), ..Tolerances::default() };
            assert_eq!(slit.validate().unwrap_err().name, "slit");
            let angle = Tolerances { foldover_angle: bad, ..Tolerances::default() };
            assert_eq!(angle.validate().unwrap_err().name, "foldover_angle");
        }
    }

    #[test]
    fn json_names_what_is_given_and_leaves_the_rest_to_the_defaults() {
        let json = r#"{"linear": {"absolute": 0.01}, "crack": {"of_diagonal": 0.001}}"#;
        let read: Tolerances = serde_json::from_str(json).unwrap();
        assert_eq!((read.linear, read.crack), (Tolerance::Absolute(0.01), Tolerance::OfDiagonal(0.001)));
        assert_eq!(read.tiny_part, Tolerances::default().tiny_part);
        assert!(serde_json::from_str::<Tolerances>(r#"{"slits": 1}"#).is_err());
    }
}
