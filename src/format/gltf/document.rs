//! The JSON of glTF as types: what is read of it, and nothing else.
//!
//! Types of our own over serde, not the crate `gltf-json`: unknown members are passed over without being kept, and every list has a
//! bound, so that the memory for a document follows from its length. Numbers that count or name something fit 32 bits, as all do in a
//! file that GLB can hold.

use serde::Deserialize;
use serde_json::value::RawValue;

use super::json::{List, Text, Whole};

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
