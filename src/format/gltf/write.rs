//! Writing a scene as GLB. The same scene always gives the same bytes, and reading and writing a file again reproduces it.
//!
//! Each placed object with faces becomes a mesh, and each of its instances a node with a matrix. Objects made of components become nodes
//! for their parts. Positions are rounded to f32. Faces with the same appearance form one primitive. A vertex between faces of different
//! colours or texture coordinates is written once for each.

use glam::{DAffine3, DVec3};
use rustc_hash::FxHashMap;
use serde_json::{Value, json};

use super::super::errors::WriteError;
use super::super::paint::{linear_vertex, media_type};
use super::container::{MAX_ENTRIES, assemble};
use super::extras::{COPYRIGHT, Extras};
use super::materials::{Appearance, MaterialTable};
use crate::scene::{Object, ObjectKind, PAINTLESS, Paint, PaintedMesh, Scene, Shape, Unit, Up};

/// Values of glTF enumerations (glTF 2.0, 5.1 and 5.11).
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;
const FLOAT: u32 = 5126;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// Writes a scene as GLB.
///
/// # Errors
/// [`WriteError`] if a coordinate exceeds f32, or if there are too many instances or bytes.
pub(crate) fn write(scene: &Scene) -> Result<Vec<u8>, WriteError> {
    let instances = instances(scene)?;
    let mut is_placed = vec![false; scene.objects.len()];
    instances.iter().for_each(|instance| is_placed[instance.object] = true);
    let mut writer =
        Writer { table: MaterialTable::new(scene), bytes: Vec::new(), views: Vec::new(), accessors: Vec::new() };
    let mut numbers: FxHashMap<usize, usize> = FxHashMap::default();
    let mut meshes = Vec::new();
    for (number, object) in scene.objects.iter().enumerate().filter(|(number, _)| is_placed[*number]) {
        if let Some(mesh) = object.mesh() {
            numbers.insert(number, meshes.len());
            meshes.push(writer.mesh(object, mesh)?);
        }
    }
    let metres = scene.unit.map_or(1.0, |unit| unit.to(Unit::Metre));
    let nodes = instances
        .iter()
        .map(|instance| instance.node(scene, metres, numbers[&instance.object]))
        .collect::<Result<Vec<_>, _>>()?;
    let too_large = WriteError::TooManyFaces { faces: scene.placed_faces(), max: u64::from(u32::MAX / 12) };
    writer.finish(scene, &nodes, &meshes).ok_or(too_large)
}

/// An instance of an object with triangles.
struct ObjectInstance {
    /// Index of the object.
    object: usize,
    /// Index of the item.
    item: usize,
    /// Whether the item refers to the object directly, not through components.
    is_item: bool,
    transform: DAffine3,
}

/// All instances of objects with triangles. Objects without faces, and instances scaled to zero, are dropped.
fn instances(scene: &Scene) -> Result<Vec<ObjectInstance>, WriteError> {
    // Count the instances first, because nested components can multiply to any number.
    let mut counts: Vec<u64> = Vec::with_capacity(scene.objects.len());
    for object in &scene.objects {
        let count = match &object.shape {
            Shape::Mesh(mesh) => u64::from(!mesh.soup.faces.is_empty()),
            Shape::Components(parts) => {
                let of = |object: u32| counts.get(object as usize).copied().unwrap_or(0);
                parts.iter().fold(0, |sum: u64, part| sum.saturating_add(of(part.object)))
            }
        };
        counts.push(count);
    }
    let count = |object: u32| counts.get(object as usize).copied().unwrap_or(0);
    let parts = scene.items.iter().fold(0, |sum: u64, item| sum.saturating_add(count(item.object)));
    if parts > MAX_ENTRIES as u64 {
        return Err(WriteError::TooManyParts { parts, max: MAX_ENTRIES as u64 });
    }
    let mut instances = Vec::new();
    let mut stack = Vec::new();
    for (number, item) in scene.items.iter().enumerate().filter(|(_, item)| count(item.object) > 0) {
        stack.push((item.object as usize, item.transform));
        while let Some((object, transform)) = stack.pop() {
            match &scene.objects[object].shape {
                Shape::Mesh(_) if transform.matrix3 == glam::DMat3::ZERO => {}
                Shape::Mesh(_) => {
                    let is_item = object == item.object as usize;
                    instances.push(ObjectInstance { object, item: number, is_item, transform });
                }
                Shape::Components(parts) => {
                    // Components refer only to earlier objects, so this loop ends.
                    let below =
                        parts.iter().rev().filter(|part| (part.object as usize) < object && count(part.object) > 0);
                    stack.extend(below.map(|part| (part.object as usize, transform * part.transform)));
                }
            }
        }
    }
    Ok(instances)
}

impl ObjectInstance {
    /// The instance as a glTF node. `metres` is the length of the scene's unit.
    fn node(&self, scene: &Scene, metres: f64, mesh: usize) -> Result<Value, WriteError> {
        let (item, object) = (&scene.items[self.item], &scene.objects[self.object]);
        let scaled = |v: DVec3| v * metres;
        let DAffine3 { mut matrix3, mut translation } = scene.stood(Up::Y, self.transform);
        matrix3 = glam::DMat3::from_cols(scaled(matrix3.x_axis), scaled(matrix3.y_axis), scaled(matrix3.z_axis));
        translation = scaled(translation);
        if !matrix3.is_finite() || !translation.is_finite() {
            return Err(WriteError::OutOfRange { vertex: 0, value: f64::INFINITY });
        }
        let mut node = json!({ "mesh": mesh });
        let matrix = DAffine3 { matrix3, translation };
        if matrix != DAffine3::IDENTITY {
            let column = |v: DVec3, last: f64| [v.x, v.y, v.z, last];
            let columns = [
                column(matrix3.x_axis, 0.0),
                column(matrix3.y_axis, 0.0),
                column(matrix3.z_axis, 0.0),
                column(translation, 1.0),
            ];
            node["matrix"] = json!(columns.concat());
        }
        let own_name = item.name.as_ref().filter(|_| self.is_item);
        if let Some(name) = own_name.or(object.name.as_ref()).or(item.name.as_ref()) {
            node["name"] = name.as_str().into();
        }
        if self.is_item
            && let Some(extras) = Extras::to_json(item.part_number.as_ref(), ObjectKind::Model, &item.notes)
        {
            node["extras"] = extras;
        }
        Ok(node)
    }
}

/// The content of the GLB file written so far.
struct Writer<'s> {
    table: MaterialTable<'s>,
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

/// The faces of an object with one appearance.
struct Group {
    appearance: Appearance,
    faces: Vec<usize>,
}

impl Writer<'_> {
    /// Writes an object's mesh: one primitive for each appearance.
    fn mesh(&mut self, object: &Object, mesh: &PaintedMesh) -> Result<Value, WriteError> {
        let mut groups: Vec<Group> = Vec::new();
        let mut known: FxHashMap<Appearance, usize> = FxHashMap::default();
        for face in 0..mesh.soup.faces.len() {
            let appearance = self.table.appearance_of(paint_of(mesh, face));
            let next = groups.len();
            let group = *known.entry(appearance).or_insert(next);
            match groups.get_mut(group) {
                Some(group) => group.faces.push(face),
                None => groups.push(Group { appearance, faces: vec![face] }),
            }
        }
        let primitives = groups.iter().map(|group| self.primitive(mesh, group)).collect::<Result<Vec<_>, _>>()?;
        let mut written = json!({ "primitives": primitives });
        if let Some(name) = &object.name {
            written["name"] = name.as_str().into();
        }
        if let Some(extras) = Extras::to_json(object.part_number.as_ref(), object.kind, &object.notes) {
            written["extras"] = extras;
        }
        Ok(written)
    }

    fn primitive(&mut self, mesh: &PaintedMesh, group: &Group) -> Result<Value, WriteError> {
        let appearance = group.appearance;
        let mut known: FxHashMap<(u32, u64), u32> = FxHashMap::default();
        let mut vertices: Vec<(u32, u64)> = Vec::new();
        let mut indices: Vec<u32> = Vec::with_capacity(3 * group.faces.len());
        for &face in &group.faces {
            let paint = paint_of(mesh, face);
            for (corner, &vertex) in mesh.soup.faces[face].iter().enumerate() {
                let corner_key = (vertex, self.table.corner_bits(appearance, paint, corner));
                #[expect(
                    clippy::cast_possible_truncation,
                    reason = "at most the number of corners, which fits 32 bits"
                )]
                let next = vertices.len() as u32;
                let index = *known.entry(corner_key).or_insert(next);
                if index == next {
                    vertices.push(corner_key);
                }
                indices.push(index);
            }
        }
        drop(known);
        let mut attributes = json!({ "POSITION": self.positions(mesh, &vertices)? });
        match appearance {
            Appearance::Unpainted | Appearance::Material(_) => {}
            Appearance::VertexColors(_) => {
                #[expect(clippy::cast_possible_truncation, reason = "a colour has 32 bits")]
                let colors = vertices.iter().flat_map(|(_, bits)| linear_vertex((*bits as u32).to_le_bytes()));
                let bytes = colors.flat_map(u16::to_le_bytes).collect::<Vec<_>>();
                let entry = json!({ "componentType": UNSIGNED_SHORT, "normalized": true, "type": "VEC4", "count": vertices.len() });
                attributes["COLOR_0"] = self.accessor(&bytes, ARRAY_BUFFER, entry).into();
            }
            Appearance::Textured(_) => {
                #[expect(clippy::cast_possible_truncation, reason = "splits the u64 into two halves")]
                let places = vertices.iter().flat_map(|(_, bits)| [(*bits >> 32) as u32, *bits as u32]);
                let bytes = places.flat_map(u32::to_le_bytes).collect::<Vec<_>>();
                let entry = json!({ "componentType": FLOAT, "type": "VEC2", "count": vertices.len() });
                attributes["TEXCOORD_0"] = self.accessor(&bytes, ARRAY_BUFFER, entry).into();
            }
        }
        let mut primitive = json!({ "attributes": attributes, "indices": self.indices(&indices, vertices.len()) });
        if let Some(material) = appearance.material() {
            primitive["material"] = material.into();
        }
        Ok(primitive)
    }

    fn positions(&mut self, mesh: &PaintedMesh, vertices: &[(u32, u64)]) -> Result<usize, WriteError> {
        let mut bytes = Vec::with_capacity(12 * vertices.len());
        let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for &(vertex, _) in vertices {
            let exact = mesh.soup.positions[vertex as usize].to_array();
            for (k, value) in exact.into_iter().enumerate() {
                #[expect(clippy::cast_possible_truncation, reason = "glTF has f32 only")]
                let rounded = value as f32;
                if !rounded.is_finite() {
                    return Err(WriteError::OutOfRange { vertex, value });
                }
                min[k] = min[k].min(rounded);
                max[k] = max[k].max(rounded);
                bytes.extend_from_slice(&rounded.to_le_bytes());
            }
        }
        let entry = json!({ "componentType": FLOAT, "type": "VEC3", "count": vertices.len(), "min": min, "max": max });
        Ok(self.accessor(&bytes, ARRAY_BUFFER, entry))
    }

    /// Writes indices, in 16 bits if possible. The largest value of each type is reserved.
    fn indices(&mut self, indices: &[u32], vertices: usize) -> usize {
        let narrow = vertices <= usize::from(u16::MAX);
        #[expect(clippy::cast_possible_truncation, reason = "less than there are vertices")]
        let bytes: Vec<u8> = match narrow {
            true => indices.iter().flat_map(|&index| (index as u16).to_le_bytes()).collect(),
            false => indices.iter().flat_map(|index| index.to_le_bytes()).collect(),
        };
        let kind = if narrow { UNSIGNED_SHORT } else { UNSIGNED_INT };
        let entry = json!({ "componentType": kind, "type": "SCALAR", "count": indices.len() });
        self.accessor(&bytes, ELEMENT_ARRAY_BUFFER, entry)
    }

    fn accessor(&mut self, bytes: &[u8], target: u32, mut entry: Value) -> usize {
        let view = self.view(bytes);
        self.views[view]["target"] = target.into();
        entry["bufferView"] = view.into();
        self.accessors.push(entry);
        self.accessors.len() - 1
    }

    fn view(&mut self, bytes: &[u8]) -> usize {
        // glTF requires alignment to the component size (glTF 2.0, 3.6.2.4).
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.push(json!({ "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len() }));
        self.bytes.extend_from_slice(bytes);
        self.views.len() - 1
    }

    /// Assembles the file; `None` if it is longer than GLB allows.
    fn finish(mut self, scene: &Scene, nodes: &[Value], meshes: &[Value]) -> Option<Vec<u8>> {
        let image_files = std::mem::take(&mut self.table.images);
        let image = |bytes: &&[u8]| json!({ "bufferView": self.view(bytes), "mimeType": media_type(bytes) });
        let images: Vec<Value> = image_files.iter().map(image).collect();
        let mut document = json!({ "asset": asset(scene), "scene": 0, "scenes": [{}] });
        if !nodes.is_empty() {
            document["scenes"][0]["nodes"] = (0..nodes.len()).collect();
        }
        let buffers = match self.bytes.is_empty() {
            true => Vec::new(),
            false => vec![json!({ "byteLength": self.bytes.len() })],
        };
        let lists: [(&str, &[Value]); 9] = [
            ("nodes", nodes),
            ("meshes", meshes),
            ("materials", &self.table.materials),
            ("textures", &self.table.textures),
            ("samplers", &self.table.samplers),
            ("images", &images),
            ("accessors", &self.accessors),
            ("bufferViews", &self.views),
            ("buffers", &buffers),
        ];
        // glTF forbids empty lists.
        for (name, list) in lists.into_iter().filter(|(_, list)| !list.is_empty()) {
            document[name] = list.into();
        }
        assemble(document.to_string().into_bytes(), self.bytes)
    }
}

fn asset(scene: &Scene) -> Value {
    let mut asset = json!({ "version": "2.0", "generator": crate::ENGINE });
    let mut notes = scene.notes.clone();
    let plain = notes
        .iter()
        .position(|note| note.name == COPYRIGHT && note.namespace.is_none() && note.kind.is_none() && !note.preserve);
    if let Some(at) = plain {
        asset["copyright"] = notes.remove(at).value.into();
    }
    if let Some(extras) = Extras::to_json(None, ObjectKind::Model, &notes) {
        asset["extras"] = extras;
    }
    asset
}

/// The paint of a face; [`PAINTLESS`] if the mesh has no paint.
fn paint_of(mesh: &PaintedMesh, face: usize) -> Paint {
    mesh.paint.get(face).copied().unwrap_or(PAINTLESS)
}
