use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A unit of length.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, ToSchema, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum Unit {
    /// 0.001 mm.
    Micrometre,
    /// What slicers take numbers for.
    #[default]
    Millimetre,
    /// 10 mm.
    Centimetre,
    /// 1000 mm.
    Metre,
    /// 25.4 mm.
    Inch,
    /// 304.8 mm.
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
