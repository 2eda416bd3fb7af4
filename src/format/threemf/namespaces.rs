//! The namespaces of 3MF, and which extensions can be read past.

use crate::format::errors::shown_up_to;

/// Of the core specification.
pub(super) const CORE: &str = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02";
/// Of the materials and properties extension.
pub(super) const MATERIAL: &str = "http://schemas.microsoft.com/3dmanufacturing/material/2015/02";
/// Of the drafts before the core specification; meshes and build items are said as there, colours otherwise.
const DRAFT: &str = "http://schemas.microsoft.com/3dmanufacturing/2013/01";
const PRODUCTION: &str = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06";
const SCHEMA_INSTANCE: &str = "http://www.w3.org/2001/XMLSchema-instance";
const XML: &str = "http://www.w3.org/XML/1998/namespace";

/// What a name belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Space {
    /// To no namespace.
    None,
    Core,
    Draft,
    Material,
    Production,
    /// To XML itself, as `xml:lang`.
    Xml,
    /// To XML Schema, as `xsi:type`.
    SchemaInstance,
    /// To something else, by its place in the reader's list.
    Other(u16),
}

impl Space {
    /// The namespace of this address, if it is one that is read.
    pub fn known(uri: &str) -> Option<Self> {
        Some(match uri {
            "" => Self::None,
            CORE => Self::Core,
            DRAFT => Self::Draft,
            MATERIAL => Self::Material,
            PRODUCTION => Self::Production,
            XML => Self::Xml,
            SCHEMA_INSTANCE => Self::SchemaInstance,
            _ => return None,
        })
    }

    /// Whether the core specification's elements are in it.
    pub fn is_core(self) -> bool {
        matches!(self, Self::Core | Self::Draft)
    }
}

/// Extensions that are not read, what they are about, and whether a model that requires them can do without.
const EXTENSIONS: [(&str, &str, bool); 13] = [
    ("http://schemas.microsoft.com/3dmanufacturing/slice/2015/07", "slices", true),
    ("http://schemas.microsoft.com/3dmanufacturing/trianglesets/2021/07", "triangle sets", true),
    ("http://schemas.microsoft.com/3dmanufacturing/production/alternatives/2021/04", "alternatives of objects", true),
    ("http://schemas.3mf.io/3dmanufacturing/production/alternatives/2021/04", "alternatives of objects", true),
    ("http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02", "beam lattices", false),
    ("http://schemas.microsoft.com/3dmanufacturing/beamlattice/balls/2020/07", "balls of beam lattices", false),
    ("http://schemas.microsoft.com/3dmanufacturing/securecontent/2019/04", "encrypted content", false),
    ("http://schemas.microsoft.com/3dmanufacturing/displacement/2022/07", "displacement", false),
    ("http://schemas.3mf.io/3dmanufacturing/displacement/2023/10", "displacement", false),
    ("http://schemas.3mf.io/3dmanufacturing/volumetric/2022/01", "volumetric data", false),
    ("http://schemas.3mf.io/3dmanufacturing/implicit/2023/12", "implicit functions", false),
    ("http://schemas.3mf.io/3dmanufacturing/booleanoperations/2023/07", "boolean operations", false),
    ("http://schemas.3mf.io/3dmanufacturing/toolpath/2019/05", "tool paths", false),
];

/// What an extension is about, in words; its address where that is not known.
pub(super) fn subject(uri: &str) -> String {
    let known = EXTENSIONS.iter().find(|(address, ..)| *address == uri);
    known.map_or_else(|| format!("'{}'", shown_up_to(100, uri.as_bytes())), |(_, subject, _)| (*subject).to_owned())
}

/// Whether a model is whole without what an extension says, which may be required.
pub(super) fn can_be_passed(uri: &str) -> bool {
    Space::known(uri).is_some() || EXTENSIONS.iter().any(|&(address, _, passed)| address == uri && passed)
}
