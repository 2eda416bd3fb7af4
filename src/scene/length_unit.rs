use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{Unit, Up};

/// What lengths are in.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
pub struct LengthUnit {
    /// The unit.
    pub used: Unit,
    /// How it is known what the input's lengths are in.
    pub source: UnitSource,
    /// What the input's lengths were in, where `scale_to` brought them into another unit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scaled_from: Option<Unit>,
    /// Which axis the input says points up. Between formats that say so the model is turned, and in others its numbers stay.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub up: Option<Up>,
    /// What to know of it, in words.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
}

/// How the unit of a file is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum UnitSource {
    /// Who sent it says so.
    Declared,
    /// The file says so.
    File,
    /// Nobody says so: millimetres, as slicers take it. STL, OBJ, PLY and OFF name no unit.
    #[default]
    Assumed,
}
