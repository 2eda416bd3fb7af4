//! The JSON of glTF as types: what is read of it, and nothing else.
//!
//! Types of our own over serde, not the crate `gltf-json`: unknown members are passed over without being kept, and every list has a
//! bound, so that the memory for a document follows from its length. Numbers that count or name something fit 32 bits, as all do in a
//! file that GLB can hold.
//!
//! What glTF has no words for stands under the name of the program in `extras`, where the format lets programs keep what is theirs.

use std::fmt;

use serde::de::{Deserializer, MapAccess, Visitor};
use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;

use super::container::{List, Text, Whole};
use crate::scene::{Note, ObjectKind};

#[derive(Deserialize)]
#[serde(rename_all = "camelCase", bound(deserialize = "'de: 'a"))]
pub(super) struct Document<'a> {
    pub asset: Asset<'a>,
    #[serde(default)]
    pub extensions_used: List<String>,
    #[serde(default)]
    pub extensions_required: List<String>,
    pub scene: Option<Whole>,
    #[serde(default)]
    pub scenes: List<SceneNodes>,
    #[serde(default)]
    pub nodes: List<Node<'a>>,
    #[serde(default)]
    pub meshes: List<Mesh<'a>>,
    #[serde(default)]
    pub skins: List<Skin>,
    #[serde(default)]
    pub accessors: List<AccessorEntry>,
    #[serde(default)]
    pub buffer_views: List<BufferView>,
    #[serde(default)]
    pub buffers: List<Buffer<'a>>,
    #[serde(default)]
    pub materials: List<Material<'a>>,
    #[serde(default)]
    pub textures: List<Texture>,
    #[serde(default)]
    pub images: List<Image<'a>>,
    #[serde(default)]
    pub samplers: List<Sampler>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase", bound(deserialize = "'de: 'a"))]
pub(super) struct Asset<'a> {
    pub version: Text<'a>,
    pub min_version: Option<Text<'a>>,
    pub copyright: Option<Text<'a>>,
    #[serde(borrow)]
    pub extras: Option<&'a RawValue>,
}

#[derive(Deserialize)]
pub(super) struct SceneNodes {
    #[serde(default)]
    pub nodes: List<Whole>,
}

#[derive(Deserialize)]
#[serde(bound(deserialize = "'de: 'a"))]
pub(super) struct Node<'a> {
    pub name: Option<Text<'a>>,
    #[serde(default)]
    pub children: List<Whole>,
    pub mesh: Option<Whole>,
    pub skin: Option<Whole>,
    pub matrix: Option<Box<[f64; 16]>>,
    pub translation: Option<Box<[f64; 3]>>,
    pub rotation: Option<Box<[f64; 4]>>,
    pub scale: Option<Box<[f64; 3]>>,
    pub weights: Option<List<f64>>,
    #[serde(borrow)]
    pub extras: Option<&'a RawValue>,
}

#[derive(Deserialize)]
#[serde(bound(deserialize = "'de: 'a"))]
pub(super) struct Mesh<'a> {
    pub name: Option<Text<'a>>,
    pub primitives: List<Primitive>,
    #[serde(default)]
    pub weights: List<f64>,
    #[serde(borrow)]
    pub extras: Option<&'a RawValue>,
}

#[derive(Deserialize)]
pub(super) struct Primitive {
    pub attributes: Attributes,
    pub indices: Option<Whole>,
    pub material: Option<Whole>,
    pub mode: Option<Whole>,
    #[serde(default)]
    pub targets: List<Target>,
    #[serde(default)]
    pub extensions: PrimitiveExtensions,
}

/// Accessors by what they are for, or within Draco's extension its own numbers.
#[derive(Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub(super) struct Attributes {
    pub position: Option<Whole>,
    pub color_0: Option<Whole>,
    pub texcoord_0: Option<Whole>,
    pub texcoord_1: Option<Whole>,
    pub texcoord_2: Option<Whole>,
    pub texcoord_3: Option<Whole>,
    pub joints_0: Option<Whole>,
    pub joints_1: Option<Whole>,
    pub weights_0: Option<Whole>,
    pub weights_1: Option<Whole>,
}

#[derive(Deserialize)]
pub(super) struct Target {
    #[serde(rename = "POSITION")]
    pub position: Option<Whole>,
}

#[derive(Deserialize, Default)]
pub(super) struct PrimitiveExtensions {
    #[serde(rename = "KHR_draco_mesh_compression")]
    pub draco: Option<Box<Draco>>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Draco {
    pub buffer_view: Whole,
    pub attributes: Attributes,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Skin {
    pub inverse_bind_matrices: Option<Whole>,
    pub joints: List<Whole>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct AccessorEntry {
    pub buffer_view: Option<Whole>,
    #[serde(default)]
    pub byte_offset: Whole,
    pub component_type: Whole,
    #[serde(default)]
    pub normalized: bool,
    pub count: Whole,
    #[serde(rename = "type")]
    pub shape: Shape,
    pub sparse: Option<Box<Sparse>>,
}

/// How many numbers an element of an accessor has.
#[derive(Deserialize, Clone, Copy, PartialEq, Eq, Debug)]
#[serde(rename_all = "UPPERCASE")]
pub(super) enum Shape {
    Scalar,
    Vec2,
    Vec3,
    Vec4,
    Mat2,
    Mat3,
    Mat4,
}

#[derive(Deserialize)]
pub(super) struct Sparse {
    pub count: Whole,
    pub indices: SparseIndices,
    pub values: SparseValues,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseIndices {
    pub buffer_view: Whole,
    #[serde(default)]
    pub byte_offset: Whole,
    pub component_type: Whole,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseValues {
    pub buffer_view: Whole,
    #[serde(default)]
    pub byte_offset: Whole,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct BufferView {
    pub buffer: Whole,
    #[serde(default)]
    pub byte_offset: Whole,
    pub byte_length: Whole,
    pub byte_stride: Option<Whole>,
    #[serde(default)]
    pub extensions: Box<ViewExtensions>,
}

#[derive(Deserialize, Default)]
pub(super) struct ViewExtensions {
    #[serde(rename = "EXT_meshopt_compression", alias = "KHR_meshopt_compression")]
    pub meshopt: Option<Meshopt>,
}

/// That a view is compressed; what is said of how is not read.
#[derive(Deserialize)]
pub(super) struct Meshopt {}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase", bound(deserialize = "'de: 'a"))]
pub(super) struct Buffer<'a> {
    pub uri: Option<Text<'a>>,
    pub byte_length: Whole,
}

#[derive(Deserialize, Default)]
#[serde(rename_all = "camelCase", bound(deserialize = "'de: 'a"))]
pub(super) struct Material<'a> {
    pub name: Option<Text<'a>>,
    #[serde(default)]
    pub pbr_metallic_roughness: Surface,
    #[serde(default)]
    pub alpha_mode: AlphaMode,
    pub normal_texture: Option<Present>,
    pub occlusion_texture: Option<Present>,
    pub emissive_texture: Option<Present>,
    #[serde(default)]
    pub extensions: Box<MaterialExtensions>,
}

#[derive(Deserialize, Default)]
#[serde(rename_all = "camelCase")]
pub(super) struct Surface {
    #[serde(alias = "diffuseFactor")]
    pub base_color_factor: Option<Box<[f64; 4]>>,
    #[serde(alias = "diffuseTexture")]
    pub base_color_texture: Option<Box<TextureUse>>,
    #[serde(alias = "specularGlossinessTexture")]
    pub metallic_roughness_texture: Option<Present>,
}

#[derive(Deserialize, Default)]
pub(super) struct MaterialExtensions {
    #[serde(rename = "KHR_materials_pbrSpecularGlossiness")]
    pub specular_glossiness: Option<Surface>,
}

/// Something of which only the being there is of interest.
#[derive(Deserialize)]
pub(super) struct Present {}

#[derive(Deserialize, Default, PartialEq, Eq, Clone, Copy)]
#[serde(rename_all = "UPPERCASE")]
pub(super) enum AlphaMode {
    #[default]
    Opaque,
    Mask,
    Blend,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct TextureUse {
    pub index: Whole,
    #[serde(default)]
    pub tex_coord: Whole,
    #[serde(default)]
    pub extensions: TextureUseExtensions,
}

#[derive(Deserialize, Default)]
pub(super) struct TextureUseExtensions {
    #[serde(rename = "KHR_texture_transform")]
    pub transform: Option<TextureTransform>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct TextureTransform {
    #[serde(default)]
    pub offset: [f64; 2],
    #[serde(default)]
    pub rotation: f64,
    pub scale: Option<[f64; 2]>,
    pub tex_coord: Option<Whole>,
}

#[derive(Deserialize)]
pub(super) struct Texture {
    pub sampler: Option<Whole>,
    pub source: Option<Whole>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase", bound(deserialize = "'de: 'a"))]
pub(super) struct Image<'a> {
    pub uri: Option<Text<'a>>,
    pub buffer_view: Option<Whole>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Sampler {
    pub mag_filter: Option<Whole>,
    pub wrap_s: Option<Whole>,
    pub wrap_t: Option<Whole>,
}

/// Values of a sampler (glTF 2.0, 5.26).
pub(super) const NEAREST: u32 = 9728;
pub(super) const LINEAR: u32 = 9729;
pub(super) const LINEAR_MIPMAP_LINEAR: u32 = 9987;
pub(super) const REPEAT: u32 = 10497;
pub(super) const CLAMP_TO_EDGE: u32 = 33071;
pub(super) const MIRRORED_REPEAT: u32 = 33648;

const OWN: &str = "meshmend";

/// What is kept of a scene, an object or an item.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Extras {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part_number: Option<String>,
    /// One of [`KINDS`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kind: Option<String>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    notes: Vec<Written>,
}

/// A note as it is written.
#[derive(Debug, Serialize, Deserialize)]
struct Written {
    name: String,
    value: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    namespace: Option<String>,
    #[serde(default, rename = "type", skip_serializing_if = "Option::is_none")]
    kind: Option<String>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    preserve: bool,
}

const KINDS: [(ObjectKind, &str); 5] = [
    (ObjectKind::Model, "model"),
    (ObjectKind::SolidSupport, "solidsupport"),
    (ObjectKind::Support, "support"),
    (ObjectKind::Surface, "surface"),
    (ObjectKind::Other, "other"),
];

impl Extras {
    /// Of what is kept in `extras`, the program's own; nothing where others wrote them.
    pub fn read(extras: Option<&RawValue>) -> Self {
        #[derive(Deserialize)]
        struct Holder {
            meshmend: Extras,
        }
        // Most have none, and need not be read for that.
        let own = extras.filter(|extras| extras.get().contains(OWN));
        own.and_then(|extras| serde_json::from_str::<Holder>(extras.get()).ok())
            .map_or_else(Self::default, |it| it.meshmend)
    }

    /// What is to be written; nothing where there is nothing to tell.
    pub fn written(part_number: Option<&String>, kind: ObjectKind, notes: &[Note]) -> Option<serde_json::Value> {
        let kind = (kind != ObjectKind::Model).then(|| KINDS.iter().find(|(known, _)| *known == kind)).flatten();
        let notes: Vec<Written> = notes.iter().cloned().map(Written::from).collect();
        let it = Self { part_number: part_number.cloned(), kind: kind.map(|(_, name)| (*name).to_owned()), notes };
        let empty = it.part_number.is_none() && it.kind.is_none() && it.notes.is_empty();
        (!empty).then(|| serde_json::json!({ OWN: it }))
    }

    pub fn kind(&self) -> ObjectKind {
        let found = KINDS.iter().find(|(_, name)| self.kind.as_deref() == Some(name));
        found.map_or(ObjectKind::Model, |(kind, _)| *kind)
    }

    pub fn notes(self) -> Vec<Note> {
        self.notes.into_iter().map(Note::from).collect()
    }
}

/// The note that glTF has a word for.
pub(super) const COPYRIGHT: &str = "Copyright";

/// The notes on a whole file: who has the right to it, what the program wrote, and what others wrote as texts.
pub(super) fn notes_of(asset: &Asset<'_>) -> Vec<Note> {
    let copyright = asset.copyright.as_deref().map(|value| plain(COPYRIGHT, value.to_owned()));
    let texts = asset.extras.and_then(|extras| serde_json::from_str::<Texts>(extras.get()).ok());
    let own = Extras::read(asset.extras).notes();
    copyright.into_iter().chain(own).chain(texts.into_iter().flat_map(|texts| texts.0)).collect()
}

fn plain(name: &str, value: String) -> Note {
    Note { name: name.to_owned(), namespace: None, value, kind: None, preserve: false }
}

/// The members of an object that are texts.
struct Texts(Vec<Note>);

impl<'de> Deserialize<'de> for Texts {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Members;
        impl<'de> Visitor<'de> for Members {
            type Value = Texts;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut members: A) -> Result<Texts, A::Error> {
                let mut notes = Vec::new();
                while let Some((name, value)) = members.next_entry::<String, &RawValue>()? {
                    if let Ok(value) = serde_json::from_str::<String>(value.get()) {
                        notes.push(plain(&name, value));
                    }
                }
                Ok(Texts(notes))
            }
        }
        deserializer.deserialize_map(Members)
    }
}

impl From<Note> for Written {
    fn from(Note { name, namespace, value, kind, preserve }: Note) -> Self {
        Self { name, value, namespace, kind, preserve }
    }
}

impl From<Written> for Note {
    fn from(Written { name, value, namespace, kind, preserve }: Written) -> Self {
        Self { name, namespace, value, kind, preserve }
    }
}
