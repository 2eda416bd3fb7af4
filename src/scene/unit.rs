//! Units of length, the origin of a file's unit, and the up axis.

use std::fmt;

use glam::{DAffine3, DMat3, DVec3};
use serde::{Deserialize, Serialize};

/// Usual range of the longest side of a printed model, in millimetres. The unit of a model outside the range is in doubt.
pub const PLAUSIBLE_SIZE_MM: [f64; 2] = [5.0, 2000.0];

/// Unit of length, after the 3MF core specification.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum Unit {
    /// 0.001 mm.
    #[serde(rename = "um", alias = "micrometre")]
    #[cfg_attr(feature = "clap", value(name = "um", alias = "micrometre"))]
    Micrometre,
    /// 1 mm, the unit that slicers assume.
    #[default]
    #[serde(rename = "mm", alias = "millimetre")]
    #[cfg_attr(feature = "clap", value(name = "mm", alias = "millimetre"))]
    Millimetre,
    /// 10 mm.
    #[serde(rename = "cm", alias = "centimetre")]
    #[cfg_attr(feature = "clap", value(name = "cm", alias = "centimetre"))]
    Centimetre,
    /// 25.4 mm.
    #[serde(rename = "in", alias = "inch")]
    #[cfg_attr(feature = "clap", value(name = "in", alias = "inch"))]
    Inch,
    /// 304.8 mm.
    #[serde(rename = "ft", alias = "foot")]
    #[cfg_attr(feature = "clap", value(name = "ft", alias = "foot"))]
    Foot,
    /// 1000 mm.
    #[serde(rename = "m", alias = "metre")]
    #[cfg_attr(feature = "clap", value(name = "m", alias = "metre"))]
    Metre,
}

impl Unit {
    /// All units, from smallest to largest.
    pub const ALL: [Self; 6] =
        [Self::Micrometre, Self::Millimetre, Self::Centimetre, Self::Inch, Self::Foot, Self::Metre];

    /// Symbol of the unit, as in options and reports.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Micrometre => "um",
            Self::Millimetre => "mm",
            Self::Centimetre => "cm",
            Self::Inch => "in",
            Self::Foot => "ft",
            Self::Metre => "m",
        }
    }

    /// Length in micrometres, a whole number for every unit.
    fn micrometres(self) -> f64 {
        match self {
            Self::Micrometre => 1.0,
            Self::Millimetre => 1e3,
            Self::Centimetre => 1e4,
            Self::Inch => 25_400.0,
            Self::Foot => 304_800.0,
            Self::Metre => 1e6,
        }
    }

    /// Length in millimetres.
    #[must_use]
    pub fn millimetres(self) -> f64 {
        self.to(Self::Millimetre)
    }

    /// Factor that converts lengths from this unit to another.
    #[must_use]
    pub fn to(self, other: Self) -> f64 {
        self.micrometres() / other.micrometres()
    }
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// Unit of the reported lengths, and how it is known.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct LengthUnit {
    /// Unit of all lengths.
    pub used: Unit,
    /// Origin of the input's unit.
    pub source: UnitSource,
    /// Unit of the input, if `scale_to` converted lengths to another unit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scaled_from: Option<Unit>,
    /// Up axis that the input declares. Export to a format with another up axis rotates the model; export to a format
    /// without an up axis keeps the coordinates.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub up: Option<Up>,
    /// Remark about the unit, for people.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
}

/// Origin of a file's unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum UnitSource {
    /// The request declares the unit.
    Declared,
    /// The file declares the unit.
    File,
    /// Neither the request nor the file declares a unit, so millimetres are assumed, as in slicers. STL, OBJ, PLY and
    /// OFF store no unit.
    #[default]
    Assumed,
}

/// Up axis: z in 3MF, y in glTF. Other formats declare none.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "lowercase")]
pub enum Up {
    /// The second axis, y.
    Y,
    /// The third axis, z.
    Z,
}

impl Up {
    /// Applies `transform`, then rotates by 90 degrees from this up axis to `other`: (x, y, z) -> (x, -z, y) from y
    /// to z. Exact.
    #[must_use]
    pub fn rotated_to(self, other: Self, transform: DAffine3) -> DAffine3 {
        // Adding zero turns -0.0 into 0.0.
        let turn = |v: DVec3| match (self, other) {
            (Self::Y, Self::Z) => DVec3::new(v.x, -v.z, v.y) + DVec3::ZERO,
            (Self::Z, Self::Y) => DVec3::new(v.x, v.z, -v.y) + DVec3::ZERO,
            _ => v,
        };
        let DAffine3 { matrix3: m, translation } = transform;
        DAffine3 {
            matrix3: DMat3::from_cols(turn(m.x_axis), turn(m.y_axis), turn(m.z_axis)),
            translation: turn(translation),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_convert_to_another_unit() {
        assert_eq!(Unit::Inch.to(Unit::Millimetre), 25.4);
        assert_eq!(Unit::Metre.to(Unit::Millimetre), 1000.0);
        assert_eq!(Unit::Foot.to(Unit::Inch), 12.0);
    }

    #[test]
    fn a_unit_has_one_name_everywhere() {
        for unit in Unit::ALL {
            assert_eq!(serde_json::to_value(unit).expect("JSON"), unit.as_str());
            #[cfg(feature = "clap")]
            assert_eq!(<Unit as clap::ValueEnum>::from_str(unit.as_str(), false), Ok(unit));
        }
    }

    #[test]
    fn rotating_the_up_axis_and_back_is_the_identity() {
        let transform = DAffine3::from_cols_array(&[0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, -1.2]);
        assert_eq!(Up::Z.rotated_to(Up::Y, Up::Y.rotated_to(Up::Z, transform)), transform);
        assert_eq!(Up::Y.rotated_to(Up::Z, DAffine3::IDENTITY).transform_point3(DVec3::Y), DVec3::Z);
        assert_eq!(Up::Z.rotated_to(Up::Z, transform), transform);
    }
}
