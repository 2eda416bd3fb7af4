//! The JSON of glTF as Rust types, limited to the members that are read. Members have the names and meanings of the specification.
//!
//! These types replace the crate `gltf-json` because they bound memory: unknown members are skipped, and lists have a maximum length.
//! Counts and indices have 32 bits, which is enough for any file that GLB can hold.

use serde::Deserialize;
use serde_json::value::RawValue;

use super::container::{Integer, List, Text};

/// The root of the JSON document (glTF 2.0, 5.17).
#[derive(Deserialize)]
#[serde(rename_all = "camelCase", bound(deserialize = "'de: 'a"))]
pub(super) struct Document<'a> {
    pub asset: Asset<'a>,
    #[serde(default)]
    pub extensions_used: List<String>,
    #[serde(default)]
    pub extensions_required: List<String>,
    pub scene: Option<Integer>,
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

/// The document's metadata.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase", bound(deserialize = "'de: 'a"))]
pub(super) struct Asset<'a> {
    pub version: Text<'a>,
    pub min_version: Option<Text<'a>>,
    pub copyright: Option<Text<'a>>,
    #[serde(borrow)]
    pub extras: Option<&'a RawValue>,
}

/// A scene: its root nodes.
#[derive(Deserialize)]
pub(super) struct SceneNodes {
    #[serde(default)]
    pub nodes: List<Integer>,
}

/// A node: a mesh or a group, with its transform.
#[derive(Deserialize)]
#[serde(bound(deserialize = "'de: 'a"))]
pub(super) struct Node<'a> {
    pub name: Option<Text<'a>>,
    #[serde(default)]
    pub children: List<Integer>,
    pub mesh: Option<Integer>,
    pub skin: Option<Integer>,
    pub matrix: Option<Box<[f64; 16]>>,
    pub translation: Option<Box<[f64; 3]>>,
    pub rotation: Option<Box<[f64; 4]>>,
    pub scale: Option<Box<[f64; 3]>>,
    pub weights: Option<List<f64>>,
    #[serde(borrow)]
    pub extras: Option<&'a RawValue>,
}

/// A mesh: a list of primitives.
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

/// A primitive: faces with one material.
#[derive(Deserialize)]
pub(super) struct Primitive {
    pub attributes: Attributes,
    pub indices: Option<Integer>,
    pub material: Option<Integer>,
    pub mode: Option<Integer>,
    #[serde(default)]
    pub targets: List<Target>,
    #[serde(default)]
    pub extensions: PrimitiveExtensions,
}

/// Accessor indices of the vertex attributes, or attribute ids within the Draco extension.
#[derive(Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub(super) struct Attributes {
    pub position: Option<Integer>,
    pub color_0: Option<Integer>,
    pub texcoord_0: Option<Integer>,
    pub texcoord_1: Option<Integer>,
    pub texcoord_2: Option<Integer>,
    pub texcoord_3: Option<Integer>,
    pub joints_0: Option<Integer>,
    pub joints_1: Option<Integer>,
    pub weights_0: Option<Integer>,
    pub weights_1: Option<Integer>,
}

/// A morph target.
#[derive(Deserialize)]
pub(super) struct Target {
    #[serde(rename = "POSITION")]
    pub position: Option<Integer>,
}

/// The extensions of a primitive that are read.
#[derive(Deserialize, Default)]
pub(super) struct PrimitiveExtensions {
    #[serde(rename = "KHR_draco_mesh_compression")]
    pub draco: Option<Box<Draco>>,
}

/// The extension `KHR_draco_mesh_compression`.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Draco {
    pub buffer_view: Integer,
    pub attributes: Attributes,
}

/// A skin: joints and their inverse bind matrices.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Skin {
    pub inverse_bind_matrices: Option<Integer>,
    pub joints: List<Integer>,
}

/// An accessor as the document declares it.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct AccessorEntry {
    pub buffer_view: Option<Integer>,
    #[serde(default)]
    pub byte_offset: Integer,
    pub component_type: Integer,
    #[serde(default)]
    pub normalized: bool,
    pub count: Integer,
    #[serde(rename = "type")]
    pub shape: Shape,
    pub sparse: Option<Box<Sparse>>,
}

/// The element type of an accessor.
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

/// Elements of an accessor that replace others.
#[derive(Deserialize)]
pub(super) struct Sparse {
    pub count: Integer,
    pub indices: SparseIndices,
    pub values: SparseValues,
}

/// Indices of the replaced elements.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseIndices {
    pub buffer_view: Integer,
    #[serde(default)]
    pub byte_offset: Integer,
    pub component_type: Integer,
}

/// Values of the replaced elements.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseValues {
    pub buffer_view: Integer,
    #[serde(default)]
    pub byte_offset: Integer,
}

/// A range of a buffer.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct BufferView {
    pub buffer: Integer,
    #[serde(default)]
    pub byte_offset: Integer,
    pub byte_length: Integer,
    pub byte_stride: Option<Integer>,
    #[serde(default)]
    pub extensions: Box<ViewExtensions>,
}

/// The extensions of a buffer view that are read.
#[derive(Deserialize, Default)]
pub(super) struct ViewExtensions {
    #[serde(rename = "EXT_meshopt_compression", alias = "KHR_meshopt_compression")]
    pub meshopt: Option<Meshopt>,
}

/// Marks a buffer view as compressed with meshopt. Its members are not read.
#[derive(Deserialize)]
pub(super) struct Meshopt {}

/// A buffer.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase", bound(deserialize = "'de: 'a"))]
pub(super) struct Buffer<'a> {
    pub uri: Option<Text<'a>>,
    pub byte_length: Integer,
}

/// A material.
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

/// The colour of a material, in the metallic-roughness or the older specular-glossiness model.
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

/// The extensions of a material that are read.
#[derive(Deserialize, Default)]
pub(super) struct MaterialExtensions {
    #[serde(rename = "KHR_materials_pbrSpecularGlossiness")]
    pub specular_glossiness: Option<Surface>,
}

/// A member of which only the presence matters.
#[derive(Deserialize)]
pub(super) struct Present {}

/// How a material uses alpha.
#[derive(Deserialize, Default, PartialEq, Eq, Clone, Copy)]
#[serde(rename_all = "UPPERCASE")]
pub(super) enum AlphaMode {
    #[default]
    Opaque,
    Mask,
    Blend,
}

/// A material's reference to a texture.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct TextureUse {
    pub index: Integer,
    #[serde(default)]
    pub tex_coord: Integer,
    #[serde(default)]
    pub extensions: TextureUseExtensions,
}

/// The extensions of a texture reference that are read.
#[derive(Deserialize, Default)]
pub(super) struct TextureUseExtensions {
    #[serde(rename = "KHR_texture_transform")]
    pub transform: Option<TextureTransform>,
}

/// The extension `KHR_texture_transform`.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct TextureTransform {
    #[serde(default)]
    pub offset: [f64; 2],
    #[serde(default)]
    pub rotation: f64,
    pub scale: Option<[f64; 2]>,
    pub tex_coord: Option<Integer>,
}

/// A texture: an image with a sampler.
#[derive(Deserialize)]
pub(super) struct Texture {
    pub sampler: Option<Integer>,
    pub source: Option<Integer>,
}

/// An image, as a URI or in a buffer view.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase", bound(deserialize = "'de: 'a"))]
pub(super) struct Image<'a> {
    pub uri: Option<Text<'a>>,
    pub buffer_view: Option<Integer>,
}

/// A sampler.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Sampler {
    pub mag_filter: Option<Integer>,
    pub wrap_s: Option<Integer>,
    pub wrap_t: Option<Integer>,
}

/// Values of a sampler (glTF 2.0, 5.26).
pub(super) const NEAREST: u32 = 9728;
pub(super) const LINEAR: u32 = 9729;
pub(super) const LINEAR_MIPMAP_LINEAR: u32 = 9987;
pub(super) const REPEAT: u32 = 10497;
pub(super) const CLAMP_TO_EDGE: u32 = 33071;
pub(super) const MIRRORED_REPEAT: u32 = 33648;
