//! glTF 2.0 (Khronos, ISO/IEC 12113:2022). GLB is read and written. JSON is read with buffers that are embedded or sidecar files.
//!
//! Each mesh becomes an object of the scene, in its own coordinates. Each node with a mesh becomes an item, so a mesh with several nodes
//! stays one object. The node hierarchy is flattened: an item's transform includes those of its ancestors.
//!
//! glTF is in metres with y up, and positions are read unchanged. When a scene is written, node matrices convert its unit and its up axis.
//! A scene without unit or up axis is written as if it were in metres with y up.
//!
//! Skinned meshes and morph targets are read in their rest pose. A skinned mesh is in the coordinates of the scene.

mod accessor;
mod container;
mod document;
mod extras;
mod file;
mod materials;
mod paint;
mod pose;
mod primitive;
mod write;

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use glam::DAffine3;
use rustc_hash::FxHashMap;

pub(super) use write::write;

use super::content::ReadScene;
use super::errors::{ReadError, ReadErrorKind};
use super::formats::{Format, GLB_SIGNATURE};
use super::limits::ReadOptions;
use super::sidecar::Sidecars;
use super::text::UTF8_MARK;
use crate::mesh::Soup;
use crate::scene::{Item, Object, PAINTLESS, PaintedMesh, Scene, Unit, Up};
use container::Integer;
use document::{Asset, Document, Mesh, Primitive};
use extras::Extras;
use file::{BufferSources, File, entry, malformed};
use paint::Painter;
use pose::{Nodes, PosedPositions, RestPose};
use primitive::{PrimitiveData, Topology, UsedVertices};

/// Extensions that do not change the shape of a model.
const IGNORABLE_EXTENSIONS: [&str; 14] = [
    "KHR_animation_pointer",
    "KHR_lights_punctual",
    "KHR_mesh_quantization",
    "KHR_draco_mesh_compression",
    "KHR_texture_transform",
    "KHR_texture_basisu",
    "KHR_xmp",
    "KHR_xmp_json_ld",
    "EXT_lights_image_based",
    "EXT_texture_avif",
    "EXT_texture_webp",
    "EXT_mesh_manifold",
    "MSFT_texture_dds",
    "EXT_structural_metadata",
];

/// Reads GLB, or glTF JSON with buffers that are embedded or sidecar files.
pub(super) fn read(bytes: &[u8], options: &ReadOptions, sidecars: &Sidecars<'_>) -> Result<ReadScene, ReadError> {
    let mut warnings = Vec::new();
    let (document, binary, dialect) = if bytes.starts_with(GLB_SIGNATURE) {
        let container = container::read_chunks(bytes, &mut warnings)?;
        let (offset, text) = container.json;
        let mark_length = mark_length(text);
        (container::parse(&text[mark_length..], Some(offset + mark_length))?, container.binary, "GLB")
    } else {
        (container::parse(&bytes[mark_length(bytes)..], None)?, None, "glTF")
    };
    check_version(&document)?;
    check_extensions(&document, &mut warnings)?;
    let file = File::new(document, &BufferSources { binary, sidecars }, options.limits, bytes.len(), &mut warnings)?;
    let scene = SceneReader::new(&file)?.scene(&mut warnings)?;
    Ok(ReadScene { scene, format: Format::Glb, dialect: dialect.to_owned(), warnings })
}

/// The length in bytes of a byte order mark, which some exporters write before the JSON.
fn mark_length(text: &[u8]) -> usize {
    if text.starts_with(UTF8_MARK) { UTF8_MARK.len() } else { 0 }
}

fn check_version(document: &Document<'_>) -> Result<(), ReadError> {
    let Asset { version, min_version, .. } = &document.asset;
    let newer = min_version.as_deref().filter(|least| *least != "2.0");
    if version.starts_with("2.") && newer.is_none() {
        return Ok(());
    }
    let shown = super::errors::excerpt(newer.unwrap_or(version).as_bytes());
    let detail = format!(
        "the file is glTF version {shown}, but only version 2.0 is supported; convert the model to GLB version 2.0 and send that file"
    );
    Err(ReadError::for_file(ReadErrorKind::UnsupportedFormat, detail))
}

/// Rejects unsupported required extensions, and warns about unsupported optional ones.
fn check_extensions(document: &Document<'_>, warnings: &mut Vec<String>) -> Result<(), ReadError> {
    let is_unsupported =
        |name: &&String| !IGNORABLE_EXTENSIONS.contains(&name.as_str()) && !name.starts_with("KHR_materials_");
    let shown = |name: &String| super::errors::excerpt(name.as_bytes());
    let compressed = |name: &&String| name.ends_with("_meshopt_compression");
    if let Some(name) = document.extensions_required.iter().find(is_unsupported) {
        let advice = if compressed(&name) {
            "export the model without compression"
        } else {
            "export the model without this extension"
        };
        let detail = format!("the file requires the glTF extension {}, which is not supported; {advice}", shown(name));
        return Err(ReadError::for_file(ReadErrorKind::UnsupportedFormat, detail));
    }
    let used: Vec<String> = document.extensions_used.iter().filter(is_unsupported).take(5).map(shown).collect();
    if !used.is_empty() {
        warnings.push(format!("the content of unsupported glTF extensions was ignored: {}", used.join(", ")));
    }
    Ok(())
}

/// A mesh with a skin and morph weights. Nodes that show a mesh in different poses give different objects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct PosedMesh {
    mesh: Integer,
    skin: Option<Integer>,
    /// The node that sets the morph weights; `None` if the mesh sets them.
    weights_of: Option<usize>,
}

/// Builds the scene of a file.
struct SceneReader<'f, 'a> {
    file: &'f File<'a>,
    nodes: Nodes,
    /// The nodes of the scene that show a mesh, in order.
    posed_meshes: Vec<(usize, PosedMesh)>,
    /// Whether any of these meshes is skinned or has morph targets.
    is_animated: bool,
}

impl<'f, 'a> SceneReader<'f, 'a> {
    fn new(file: &'f File<'a>) -> Result<Self, ReadError> {
        let document = &file.document;
        let nodes = pose::walk_nodes(document)?;
        // A skin affects only meshes with joint attributes.
        let is_skinned =
            |mesh: &Mesh<'_>| mesh.primitives.iter().any(|primitive| primitive.attributes.joints_0.is_some());
        let has_targets = |mesh: &Mesh<'_>| mesh.primitives.iter().any(|primitive| !primitive.targets.is_empty());
        let mesh_traits: Vec<(bool, bool)> =
            document.meshes.iter().map(|mesh| (is_skinned(mesh), has_targets(mesh))).collect();
        let (mut posed_meshes, mut is_animated) = (Vec::new(), false);
        for &number in &nodes.order {
            let node = &document.nodes[number];
            let Some(mesh) = node.mesh else { continue };
            let &(is_skinned, has_targets) = entry(&mesh_traits, mesh, "mesh")?;
            let usual = &document.meshes[mesh.index()].weights;
            let own_weights = has_targets && node.weights.as_deref().is_some_and(|weights| *weights != **usual);
            let skin = node.skin.filter(|_| is_skinned);
            is_animated |= has_targets || skin.is_some();
            posed_meshes.push((number, PosedMesh { mesh, skin, weights_of: own_weights.then_some(number) }));
        }
        Ok(Self { file, nodes, posed_meshes, is_animated })
    }

    /// Builds all objects and items.
    fn scene(&self, warnings: &mut Vec<String>) -> Result<Scene, ReadError> {
        let document = &self.file.document;
        let mut meshes = MeshBuilder::new(self.file);
        let mut numbers: BTreeMap<PosedMesh, Option<u32>> =
            self.posed_meshes.iter().map(|&(_, posed)| (posed, None)).collect();
        let mut objects = Vec::new();
        for (posed, number) in &mut numbers {
            let mesh = entry(&document.meshes, posed.mesh, "mesh")?;
            let built = meshes.build(mesh, &self.pose(*posed)?)?;
            if built.soup.faces.is_empty() {
                continue;
            }
            *number = u32::try_from(objects.len()).ok();
            let extras = Extras::read(mesh.extras);
            let object = Object::of_mesh(mesh.name.as_deref().map(str::to_owned), built);
            let (part_number, kind) = (extras.part_number.clone(), extras.kind());
            objects.push(Object { part_number, kind, notes: extras.notes(), ..object });
        }
        let mut items = Vec::new();
        let mut zero_scaled = 0_u64;
        for (node, posed) in &self.posed_meshes {
            let Some(object) = numbers.get(posed).copied().flatten() else { continue };
            // A skinned mesh is placed by its joints; its node's transform does not apply.
            let world = if posed.skin.is_some() { DAffine3::IDENTITY } else { self.nodes.worlds[*node] };
            if world.matrix3 == glam::DMat3::ZERO {
                zero_scaled += 1;
                continue;
            }
            items.push(self.item(*node, object, world, objects[object as usize].name.as_deref()));
        }
        if items.is_empty() {
            return Err(self.no_faces(&meshes));
        }
        if zero_scaled > 0 {
            warnings.push(format!("nodes with a scale of zero were dropped: {zero_scaled}"));
        }
        self.add_warnings(&meshes, warnings);
        let notes = extras::notes_of(&document.asset);
        let (palettes, textures) = meshes.painter.finish();
        Ok(Scene { unit: Some(Unit::Metre), up: Some(Up::Y), objects, items, palettes, textures, notes })
    }

    /// The rest pose of a mesh.
    fn pose(&self, posed: PosedMesh) -> Result<RestPose, ReadError> {
        let document = &self.file.document;
        let mesh = entry(&document.meshes, posed.mesh, "mesh")?;
        let own = posed.weights_of.and_then(|node| document.nodes[node].weights.as_deref());
        let weights = own.unwrap_or(&mesh.weights).to_vec();
        let joints = match posed.skin {
            Some(skin) => pose::joint_transforms(self.file, entry(&document.skins, skin, "skin")?, &self.nodes.worlds)?,
            None => Vec::new(),
        };
        if posed.skin.is_some() && joints.is_empty() {
            return Err(malformed("a skin has no joints"));
        }
        Ok(RestPose { weights, joints })
    }

    fn item(&self, node: usize, object: u32, transform: DAffine3, name: Option<&str>) -> Item {
        let node = &self.file.document.nodes[node];
        let extras = Extras::read(node.extras);
        // A node often has the same name as its mesh.
        let own_name = node.name.as_deref().filter(|own| Some(*own) != name).map(str::to_owned);
        let part_number = extras.part_number.clone();
        Item { object, transform, name: own_name, part_number, notes: extras.notes() }
    }

    /// Adds warnings about dropped content.
    fn add_warnings(&self, meshes: &MeshBuilder<'_, '_>, warnings: &mut Vec<String>) {
        let painter = &meshes.painter;
        if meshes.omitted > 0 {
            warnings.push(format!("points, lines and primitives without positions were dropped: {}", meshes.omitted));
        }
        if self.is_animated {
            warnings.push("the model has animated parts (a skin or morph targets); its rest pose was read".to_owned());
        }
        if painter.textures.omitted > 0 {
            warnings.push(format!(
                "textures that are not PNG or JPEG inside the file were dropped: {}; to keep them, export a GLB file with PNG or JPEG textures",
                painter.textures.omitted
            ));
        }
        if painter.dropped_vertex_colors > 0 {
            warnings.push(format!(
                "primitives with both a texture and vertex colours kept only the texture: {}",
                painter.dropped_vertex_colors
            ));
        }
        if painter.has_other_textures {
            warnings.push(
                "textures for roughness, normals, occlusion or emission were dropped; colour textures were kept"
                    .to_owned(),
            );
        }
    }

    fn no_faces(&self, meshes: &MeshBuilder<'_, '_>) -> ReadError {
        let detail = if meshes.omitted > 0 {
            "the glTF file holds points or lines and no triangles; reconstruct a surface first"
        } else if self.file.document.meshes.is_empty() {
            "the glTF file holds no mesh; export the model again"
        } else {
            "the glTF file's scene shows no triangles; add the model to the scene and export it again"
        };
        ReadError::for_file(ReadErrorKind::NoFaces, detail)
    }
}

/// Builds the meshes of the scene, and counts their faces and vertices.
struct MeshBuilder<'f, 'a> {
    file: &'f File<'a>,
    painter: Painter<'f, 'a>,
    faces: u64,
    vertices: u64,
    /// Primitives without triangles or without positions.
    omitted: u64,
}

/// A primitive whose faces have been read.
struct PrimitiveFaces<'f, 'a> {
    source: PrimitiveData<'f, 'a>,
    faces: Vec<[u32; 3]>,
    /// Index of its first face in the mesh.
    first_face: usize,
    /// Number of its vertices, used or not.
    vertices: usize,
}

/// The accessors that identify the vertices of a primitive; primitives with equal ones share vertices.
type VertexAccessors = [Option<Integer>; 5];

impl<'f, 'a> MeshBuilder<'f, 'a> {
    fn new(file: &'f File<'a>) -> Self {
        Self { file, painter: Painter::new(file), faces: 0, vertices: 0, omitted: 0 }
    }

    /// Builds one mesh from all primitives. Primitives with the same vertex accessors share their vertices. If a primitive uses few of its
    /// vertices, unused ones are dropped.
    fn build(&mut self, mesh: &'f Mesh<'a>, pose: &RestPose) -> Result<PaintedMesh, ReadError> {
        let mut parts = Vec::new();
        for primitive in mesh.primitives.iter() {
            match self.part(primitive)? {
                Some(part) => parts.push(part),
                None => self.omitted += 1,
            }
        }
        let mut built = PaintedMesh::default();
        for part in &mut parts {
            part.first_face = built.soup.faces.len();
            built.soup.faces.extend_from_slice(&part.faces);
            self.painter.paint(&part.source, &part.faces, part.vertices, &mut built.paint)?;
        }
        if built.paint.iter().all(|&paint| paint == PAINTLESS) {
            built.paint = Vec::new();
        }
        for group in group_by_vertices(&parts) {
            self.place(&parts, &group, pose, &mut built.soup)?;
        }
        Ok(built)
    }

    /// Reads a primitive's faces; `None` if it has no triangles or no positions.
    fn part(&mut self, primitive: &'f Primitive) -> Result<Option<PrimitiveFaces<'f, 'a>>, ReadError> {
        let Some(mode) = Topology::of(primitive.mode.map_or(4, |mode| mode.0))? else { return Ok(None) };
        let source = PrimitiveData::new(self.file, primitive, self.faces, self.vertices)?;
        let Some(positions) = source.positions()? else { return Ok(None) };
        let indices = source.indices()?;
        // Draco always decodes to a triangle list, whatever the primitive's mode.
        let mode = if primitive.extensions.draco.is_some() { Topology::List } else { mode };
        let faces = primitive::faces(mode, indices.as_ref(), positions.count, self.faces, &self.file.limits)?;
        self.faces += faces.len() as u64;
        Ok(Some(PrimitiveFaces { source, faces, first_face: 0, vertices: positions.count }))
    }

    /// Adds the vertices that a group of primitives shares, and renumbers the corners of their faces.
    fn place(
        &mut self,
        parts: &[PrimitiveFaces<'f, 'a>],
        group: &[usize],
        pose: &RestPose,
        soup: &mut Soup,
    ) -> Result<(), ReadError> {
        let first = &parts[group[0]];
        let corners = || group.iter().flat_map(|&part| parts[part].faces.iter().flatten().copied());
        let used = UsedVertices::of(corners, first.vertices);
        self.vertices += used.len() as u64;
        self.file.limits.check_vertices(self.vertices)?;
        let Some(positions) = first.source.positions()? else { return Ok(()) };
        let posed = PosedPositions::new(&first.source, &positions, pose)?;
        #[expect(clippy::cast_possible_truncation, reason = "the vertices were counted")]
        let base = soup.positions.len() as u32;
        soup.positions.reserve(used.len());
        for vertex in used.iter() {
            soup.positions.push(posed.at(vertex as usize)?);
        }
        for &part in group {
            let PrimitiveFaces { first_face, faces, .. } = &parts[part];
            let faces = &mut soup.faces[*first_face..][..faces.len()];
            faces.as_flattened_mut().iter_mut().for_each(|vertex| *vertex = base + used.rank(*vertex));
        }
        Ok(())
    }
}

/// Groups primitives that share vertices, in the order of each group's first primitive.
fn group_by_vertices(parts: &[PrimitiveFaces<'_, '_>]) -> Vec<Vec<usize>> {
    let mut groups: Vec<Vec<usize>> = Vec::new();
    let mut known: FxHashMap<VertexAccessors, usize> = FxHashMap::default();
    for (number, part) in parts.iter().enumerate() {
        let primitive = part.source.primitive;
        let attributes = &primitive.attributes;
        let shared =
            [attributes.position, attributes.joints_0, attributes.weights_0, attributes.joints_1, attributes.weights_1];
        let alone = primitive.extensions.draco.is_some() || !primitive.targets.is_empty();
        let next = groups.len();
        let group = if alone { next } else { *known.entry(shared).or_insert(next) };
        match groups.get_mut(group) {
            Some(group) => group.push(number),
            None => groups.push(vec![number]),
        }
    }
    groups
}
