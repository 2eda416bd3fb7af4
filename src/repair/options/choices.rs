//! The values of the options that offer a choice, with their names in JSON and on the command line.

use serde::{Deserialize, Serialize};

use crate::format::{Format, ReadFile};

/// A named repair plan, after the MeshPrep repair strategy guide ("Filter Scripts & When to Use Them").
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// Choose the preset by the category of damage.
    #[default]
    Auto,
    /// Weld vertices, remove degenerate and duplicate faces, and fix normals.
    BasicCleanup,
    /// Basic cleanup, then close holes.
    FillHoles,
    /// Repair one part with several kinds of damage.
    FullRepair,
    /// Repair each of several parts separately, so that no part is lost.
    ConservativeRepair,
    /// Repair non-manifold edges and vertices.
    ManifoldRepair,
    /// Basic cleanup, then a remesh with Blender: for severe damage.
    BlenderRemesh,
    /// Repair a model from a 3D model generator: keep the outer skin, seal pinholes, and fill the inside.
    Generated,
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
            Self::Generated => "generated",
        }
    }
}

/// The category of a model's damage, after the MeshPrep repair strategy guide ("Category-to-Filter Mapping").
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "clap", value(rename_all = "snake_case"))]
pub enum Category {
    /// No defect.
    Clean,
    /// Only holes, and few of them.
    Holes,
    /// Only holes, and many of them.
    ManySmallHoles,
    /// Non-manifold edges or vertices.
    NonManifold,
    /// Intersecting faces.
    SelfIntersecting,
    /// Many parts, most of them open or tiny.
    Fragmented,
    /// More than one part.
    MultipleComponents,
    /// Only faces with the wrong orientation.
    Orientation,
    /// Only degenerate or duplicate faces.
    Degenerate,
    /// Open surface that encloses nothing, such as terrain or a single wall.
    OpenSheet,
    /// Several categories at once.
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

/// The treatment of open sheets: parts that enclose nothing, such as terrain or a single wall.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum OpenSheets {
    /// Leave a model that is one open sheet. Thicken sheets that are parts of another model, behind their surface, if nothing else
    /// makes the model printable.
    #[default]
    Auto,
    /// Leave sheets open.
    Leave,
    /// Give sheets a thickness, half of it on each side, and close the rim.
    Thicken,
    /// Extrude sheets down to a plane below them.
    Base,
}

/// The treatment of parts that overlap.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Overlaps {
    /// Unite overlapping parts into one solid.
    #[default]
    Union,
    /// Repair each part separately and keep the overlaps, for example if the slicer is to unite them. The report then calls the result
    /// not printable.
    Keep,
}

/// The treatment of a file's objects, if the formats of the file and of the result both have objects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Merge {
    /// Unite objects that intersect in their placed positions into one solid that keeps their colours. Other objects stay separate. In
    /// 3MF, parts of different materials stay separate too; where they overlap, the later part keeps the shared space.
    #[default]
    Auto,
    /// Repair each object separately and keep it. If objects intersect, the result is not printable as it is placed.
    None,
    /// Combine all objects into one and repair it as a whole.
    Objects,
}

/// The result that a repair must reach to succeed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "clap", value(rename_all = "snake_case"))]
pub enum Require {
    /// Return the best result, whatever its outcome.
    #[default]
    Any,
    /// Require the outcome `already_printable` or `repaired`. Otherwise the repair fails and returns no model.
    Printable,
    /// Require, in addition, that the result meets every rule of the process. The value needs the option `process`.
    PrintReady,
}

impl Require {
    /// The name used in JSON and on the command line.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Any => "any",
            Self::Printable => "printable",
            Self::PrintReady => "print_ready",
        }
    }
}

/// The extent of the check of a result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Verify {
    /// Test new and moved faces for intersections with all faces near them. Faces at exactly the positions of input faces
    /// were tested against each other in the input.
    #[default]
    Changed,
    /// Test all faces of the result for intersections.
    Full,
}

/// The winding rule: the space that counts as solid, by how often the surface winds around it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum WindingRuleChoice {
    /// Try both `positive` and `nonzero`, as the plan's strategies order them.
    #[default]
    Auto,
    /// Solid where the surface winds once or more outward. A part that is inside out is not solid.
    Positive,
    /// Solid where the winding number is not zero. Parts that are inside out are solid too.
    Nonzero,
    /// Solid where the winding number is odd. A solid inside a solid is a cavity, whatever its orientation.
    Odd,
}

/// The format of the result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum OutputFormat {
    /// STL if STL can store all that the input holds. The input's own format if the input has objects, colours or a unit.
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
    /// Text with lines `Vertex i x y z` and `Face j v1 v2 v3`.
    Mesh,
    /// GLB (binary glTF 2.0), in metres.
    Glb,
    /// OBJ with its materials and textures in a ZIP archive.
    Zip,
    /// 3MF.
    #[serde(rename = "3mf")]
    #[cfg_attr(feature = "clap", value(name = "3mf"))]
    ThreeMf,
    /// The input's own format.
    Same,
}

impl OutputFormat {
    /// The file format of the result for an input.
    #[must_use]
    pub fn resolve(self, input: &ReadFile) -> Format {
        match self {
            Self::Auto if input.scene.is_none() => Format::Stl,
            // An OBJ file alone has no materials.
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

/// How closed parts inside other parts are wound.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "clap", value(rename_all = "snake_case"))]
pub enum Nested {
    /// Keep their winding: an inward part in a solid is a cavity, an outward part is a separate solid.
    #[default]
    Keep,
    /// Alternate by depth: a part in a solid becomes a cavity, and a part in a cavity becomes a solid.
    Alternate,
}

/// How the triangles that fill a hole are chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum HoleFilling {
    /// Try smooth, planar, least area and sharp in this order; take the first patch that intersects nothing.
    #[default]
    Auto,
    /// Minimise the largest dihedral angle to the surrounding faces and within the patch (Liepa 2003).
    Smooth,
    /// Constrained Delaunay triangulation in the best-fitting plane; least area where the projection crosses itself.
    Planar,
    /// Close the sharpest corner first, never with a face that intersects another (Mesh Heal's *fill holes (sharp)*).
    Sharp,
}

/// Where two stitched vertices meet. A vertex stitched to an edge keeps its position, and the edge bends to the vertex.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "clap", value(rename_all = "snake_case"))]
pub enum StitchPosition {
    /// At the position of one of the two, so that no new position arises.
    #[default]
    Kept,
    /// Halfway between the two.
    Average,
}
