use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::format::{Format, ReadFile};

/// The format of the result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, ToSchema, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum OutputFormat {
    /// STL where that says all that the file holds, the input's own format where it does not: with objects, colours or a unit.
    #[default]
    Auto,
    /// Binary STL.
    Stl,
    /// Wavefront OBJ.
    Obj,
    /// Binary little-endian PLY.
    Ply,
    /// OFF.
    Off,
    /// Lines `Vertex i x y z` and `Face j v1 v2 v3`.
    Mesh,
    /// GLB (binary glTF 2.0), in metres.
    Glb,
    /// OBJ with its materials and pictures in a ZIP archive.
    Zip,
    /// 3MF.
    #[serde(rename = "3mf")]
    #[value(name = "3mf")]
    ThreeMf,
    /// The input's own format.
    Same,
}

impl OutputFormat {
    /// The concrete format for an input.
    #[must_use]
    pub fn resolve(self, input: &ReadFile) -> Format {
        match self {
            Self::Auto if input.scene.is_none() => Format::Stl,
            // Alone it has no materials.
            Self::Auto if input.mesh.format == Format::Obj => Format::Zip,
            Self::Stl => Format::Stl,
            Self::Obj => Format::Obj,
            Self::Ply => Format::Ply,
            Self::Off => Format::Off,
            Self::Mesh => Format::Mesh,
            Self::Glb => Format::Glb,
            Self::Zip => Format::Zip,
            Self::ThreeMf => Format::ThreeMf,
            Self::Auto | Self::Same => input.mesh.format,
        }
    }
}
