//! The choices that options offer, apart from numbers.

use serde::{Deserialize, Serialize};

use crate::format::{Format, ReadFile};

/// A named plan, after the MeshPrep repair strategy guide ("Filter Scripts & When to Use Them").
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// Chosen from the model's category.
    #[default]
    Auto,
    /// Weld, drop degenerate and duplicate faces, fix normals.
    BasicCleanup,
    /// Basic cleanup, then close holes.
    FillHoles,
    /// For one part with several kinds of damage.
    FullRepair,
    /// For several parts: each is repaired apart and none is lost.
    ConservativeRepair,
    /// For non-manifold edges and vertices.
    ManifoldRepair,
    /// Basic cleanup, then Blender: for severe damage.
    BlenderRemesh,
}

impl Preset {
    /// The name used in JSON and on the command line.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::BasicCleanup => "basic-cleanup",
            Self::FillHoles => "fill-holes",
            Self::FullRepair => "full-repair",
            Self::ConservativeRepair => "conservative-repair",
            Self::ManifoldRepair => "manifold-repair",
            Self::BlenderRemesh => "blender-remesh",
        }
    }
}

/// What kind of trouble a model is in, after the MeshPrep repair strategy guide ("Category-to-Filter Mapping").
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "clap", value(rename_all = "snake_case"))]
pub enum Category {
    /// Nothing is wrong.
    Clean,
    /// Boundaries only, a few.
    Holes,
    /// Boundaries only, many.
    ManySmallHoles,
    /// Non-manifold edges or vertices.
    NonManifold,
    /// Faces intersect.
    SelfIntersecting,
    /// Many parts, most of them open or tiny.
    Fragmented,
    /// More than one part.
    MultipleComponents,
    /// Faces turned the wrong way, nothing else.
    Orientation,
    /// Degenerate or duplicate faces, nothing else.
    Degenerate,
    /// A surface that encloses nothing, such as terrain or a single wall.
    OpenSheet,
    /// Several of these at once.
    Complex,
}

impl Category {
    /// The name used in JSON.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Clean => "clean",
            Self::Holes => "holes",
            Self::ManySmallHoles => "many_small_holes",
            Self::NonManifold => "non_manifold",
            Self::SelfIntersecting => "self_intersecting",
            Self::Fragmented => "fragmented",
            Self::MultipleComponents => "multiple_components",
            Self::Orientation => "orientation",
            Self::Degenerate => "degenerate",
            Self::OpenSheet => "open_sheet",
            Self::Complex => "complex",
        }
    }
}

/// What becomes of open sheets: parts that enclose nothing, such as terrain or a single wall.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum OpenSheets {
    /// A model that is an open sheet is left; sheets that are parts of another model get a thickness behind their surface where
    /// nothing else made the model printable.
    #[default]
    Auto,
    /// They are left open.
    Leave,
    /// They get a thickness, half of it on either side, and a closed rim.
    Thicken,
    /// They are extruded down to a plane below them.
    Base,
}

/// What becomes of parts that overlap.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Overlaps {
    /// They become one solid.
    #[default]
    Union,
    /// Each is resolved by itself, and what they have in common is left to whoever prints them. The result is then not
    /// printable, and the report says so.
    Keep,
}

/// What becomes of a file's objects, where its format and that of the result have such.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Merge {
    /// Objects that intersect where they stand become one solid, and keep their colours; others stay objects. In 3MF, parts of different
    /// materials stay parts, and where they overlap one of them gives way.
    #[default]
    Auto,
    /// Each is repaired by itself and stays an object. Where objects intersect, the result is not printable as it stands.
    None,
    /// All become one, repaired as a whole.
    Objects,
}

/// What a result must be for the repair to succeed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "clap", value(rename_all = "snake_case"))]
pub enum Require {
    /// The best result is handed out, whatever its outcome.
    #[default]
    Any,
    /// The outcome is `already_printable` or `repaired`; otherwise the repair fails and hands out no model.
    Printable,
}

/// What is solid, by how many times the surface winds around it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum WindingRuleChoice {
    /// As the plan's strategies try it: `positive`, and `nonzero` where that is not good.
    #[default]
    Auto,
    /// Once or more outward: a part that is inside out is no material.
    Positive,
    /// Any number of times but none: parts that are inside out are solid too.
    Nonzero,
    /// An odd number of times: a solid within a solid is a cavity, whichever way it is turned.
    Odd,
}

/// The format of the result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
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
    #[cfg_attr(feature = "clap", value(name = "3mf"))]
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
