use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A unit of length.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, ToSchema, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum Unit {
    /// 0.001 mm.
    #[serde(rename = "um", alias = "micrometre")]
    #[value(name = "um", alias = "micrometre")]
    Micrometre,
    /// What slicers take numbers for.
    #[default]
    #[serde(rename = "mm", alias = "millimetre")]
    #[value(name = "mm", alias = "millimetre")]
    Millimetre,
    /// 10 mm.
    #[serde(rename = "cm", alias = "centimetre")]
    #[value(name = "cm", alias = "centimetre")]
    Centimetre,
    /// 1000 mm.
    #[serde(rename = "m", alias = "metre")]
    #[value(name = "m", alias = "metre")]
    Metre,
    /// 25.4 mm.
    #[serde(rename = "in", alias = "inch")]
    #[value(name = "in", alias = "inch")]
    Inch,
    /// 304.8 mm.
    #[serde(rename = "ft", alias = "foot")]
    #[value(name = "ft", alias = "foot")]
    Foot,
}

impl Unit {
    /// How many millimetres it is.
    #[must_use]
    pub fn millimetres(self) -> f64 {
        match self {
            Self::Micrometre => 0.001,
            Self::Millimetre => 1.0,
            Self::Centimetre => 10.0,
            Self::Metre => 1000.0,
            Self::Inch => 25.4,
            Self::Foot => 304.8,
        }
    }
}

/// How a model's unit is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum UnitSource {
    /// The caller said so.
    Declared,
    /// The file says so.
    File,
    /// Nobody said: millimetres, as slicers take it. STL, OBJ, PLY and OFF name no unit.
    Assumed,
}
