//! Export of a scene as a coloured mesh, in glTF binary and PLY.

use std::fmt::Write as _;

use glam::DVec3;
use serde_json::{Value, json};

use super::palette::{Colour, Paint, SOUND, colour};
use super::scene::{Compactor, RenderError, Scene, Shows};
use crate::context::Context;

/// Ratio of largest coordinate to half extent above which positions are written relative to the model's centre.
const FAR: f64 = 8.0;
/// Range of coordinates that f32 represents well. Models outside are scaled.
const SIZES: std::ops::Range<f64> = 1e-25..1e25;

/// Constants of glTF (glTF 2.0 specification, sections 3.6 and 5).
const UNSIGNED_INT: u32 = 5125;
const FLOAT: u32 = 5126;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;
const POINTS: u32 = 0;
const LINES: u32 = 1;
const TRIANGLES: u32 = 4;

/// Radius of the tube around a line, and of a dot, as a fraction of the model's half extent.
const TUBE: f64 = 0.005;
const DOT: f64 = 0.012;

/// Writes a scene as glTF 2.0 binary. The file has a node `sound` and one node per visible defect kind, named after
/// the kind, with its own material. Lines have mode `LINES` and dots `POINTS`. A drawing of changes has one node per
/// provenance. The scene's `extras` hold the legend.
///
/// The root node rotates z up to y up. If coordinates are large relative to the model's size, the root node also
/// translates the model, so that f32 keeps its detail. Numbers are in the model's unit; if they do not fit f32, they
/// are multiplied by `extras.scale`.
///
/// # Errors
/// [`RenderError::Cancelled`] on cancellation or timeout, [`RenderError::TooLarge`] beyond the format's 4 GiB.
pub fn write_glb(scene: &Scene, context: &Context<'_>) -> Result<Vec<u8>, RenderError> {
    let mut file = GlbFile::new(scene);
    for (paint, faces) in groups_with_lines(scene) {
        context.check()?;
        file.node(scene, paint, &faces)?;
    }
    file.finish(scene)
}

/// Groups of faces by paint, including empty groups for kinds with only lines or dots.
fn groups_with_lines(scene: &Scene) -> Vec<(Paint, Vec<u32>)> {
    let mut groups = scene.groups();
    let kinds = scene.segments.iter().map(|s| s.kind).chain(scene.dots.iter().map(|d| d.kind));
    let mut drawn: Vec<Paint> = kinds.map(Paint::Defect).collect();
    drawn.sort_unstable();
    drawn.dedup();
    for kind in drawn {
        if !groups.iter().any(|(paint, _)| *paint == kind) {
            groups.push((kind, Vec::new()));
        }
    }
    groups.sort_by_key(|(paint, _)| *paint);
    groups
}

struct GlbFile {
    compactor: Compactor,
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    materials: Vec<Value>,
    meshes: Vec<Value>,
    nodes: Vec<Value>,
    /// Factor applied to coordinates, and the centre subtracted afterwards.
    scale: f64,
    centre: DVec3,
}

impl GlbFile {
    fn new(scene: &Scene) -> Self {
        let frame = &scene.frame;
        let largest = frame.bounds.min.abs().max(frame.bounds.max.abs()).max_element();
        let fits = scene.surface.positions.is_empty() || largest == 0.0 || SIZES.contains(&largest);
        let is_far = (frame.centre.abs() / frame.half).max_element() > FAR;
        let scale = if fits { 1.0 } else { frame.scale };
        // Rounded to f32, as programs store a translation.
        let centre = if is_far { (frame.centre / frame.scale * scale).as_vec3().as_dvec3() } else { DVec3::ZERO };
        Self {
            compactor: Compactor::new(scene.surface.positions.len()),
            bytes: Vec::new(),
            views: Vec::new(),
            accessors: Vec::new(),
            materials: Vec::new(),
            meshes: Vec::new(),
            nodes: Vec::new(),
            scale,
            centre,
        }
    }

    /// Writes one node with its triangles, lines and dots.
    fn node(&mut self, scene: &Scene, paint: Paint, faces: &[u32]) -> Result<(), RenderError> {
        let name = paint.id();
        let mut primitives = Vec::new();
        if !faces.is_empty() {
            let group = self.compactor.compact(&scene.surface, faces);
            let points = group.vertices.iter().map(|&v| scene.surface.positions[v as usize]);
            let position = self.positions(points);
            let indices = self.indices(group.faces.iter().flatten().copied());
            let shown = paint.colour();
            let suffix = if matches!(paint, Paint::Defect(kind) if colour(kind) != shown) { "_beside" } else { "" };
            let material = self.material(&format!("{name}{suffix}"), shown);
            primitives.push(primitive(TRIANGLES, position, Some(indices), material));
        }
        if let Paint::Defect(kind) = paint {
            let ends: Vec<DVec3> = scene.segments.iter().filter(|s| s.kind == kind).flat_map(|s| s.ends).collect();
            let dots: Vec<DVec3> = scene.dots.iter().filter(|d| d.kind == kind).map(|d| d.at).collect();
            if !ends.is_empty() || !dots.is_empty() {
                let material = self.material(&name, colour(kind));
                for (mode, points) in [(LINES, ends), (POINTS, dots)] {
                    if !points.is_empty() {
                        let position = self.positions(points.into_iter());
                        primitives.push(primitive(mode, position, None, material));
                    }
                }
            }
        }
        self.nodes.push(json!({ "name": name, "mesh": self.meshes.len() }));
        self.meshes.push(json!({ "name": name, "primitives": primitives }));
        // The format cannot represent more than 4 GiB; checked here before memory runs out.
        u32::try_from(self.bytes.len()).map_err(|_| RenderError::TooLarge).map(drop)
    }

    fn material(&mut self, name: &str, colour: Colour) -> usize {
        if let Some(known) = self.materials.iter().position(|m| m["name"] == name) {
            return known;
        }
        let [r, g, b] = colour.linear().map(|c| (c * 1e4).round() / 1e4);
        self.materials.push(json!({
            "name": name,
            "doubleSided": true,
            "pbrMetallicRoughness": { "baseColorFactor": [r, g, b, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.8 },
        }));
        self.materials.len() - 1
    }

    #[expect(clippy::cast_possible_truncation, reason = "glTF has f32 only")]
    fn positions(&mut self, points: impl Iterator<Item = DVec3>) -> usize {
        let start = self.bytes.len();
        let (mut count, mut min, mut max) = (0usize, [f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for point in points {
            let point = (point * self.scale - self.centre).to_array().map(|x| x as f32);
            for k in 0..3 {
                min[k] = min[k].min(point[k]);
                max[k] = max[k].max(point[k]);
                self.bytes.extend_from_slice(&point[k].to_le_bytes());
            }
            count += 1;
        }
        let view = self.view(start, ARRAY_BUFFER);
        self.accessors.push(json!({
            "bufferView": view, "componentType": FLOAT, "type": "VEC3", "count": count, "min": min, "max": max,
        }));
        self.accessors.len() - 1
    }

    fn indices(&mut self, indices: impl Iterator<Item = u32>) -> usize {
        let start = self.bytes.len();
        for index in indices {
            self.bytes.extend_from_slice(&index.to_le_bytes());
        }
        let count = (self.bytes.len() - start) / 4;
        let view = self.view(start, ELEMENT_ARRAY_BUFFER);
        self.accessors.push(json!({
            "bufferView": view, "componentType": UNSIGNED_INT, "type": "SCALAR", "count": count,
        }));
        self.accessors.len() - 1
    }

    fn view(&mut self, start: usize, target: u32) -> usize {
        let length = self.bytes.len() - start;
        self.views.push(json!({ "buffer": 0, "byteOffset": start, "byteLength": length, "target": target }));
        self.views.len() - 1
    }

    fn finish(mut self, scene: &Scene) -> Result<Vec<u8>, RenderError> {
        let half_root = 0.5f64.sqrt();
        let mut root = json!({ "name": "model", "rotation": [-half_root, 0.0, 0.0, half_root] });
        if !self.nodes.is_empty() {
            root["children"] = (1..=self.nodes.len()).collect();
        }
        if self.centre != DVec3::ZERO {
            // The translation applies after the rotation, so it is in axes with y up.
            root["translation"] = json!([self.centre.x, self.centre.z, -self.centre.y]);
        }
        self.nodes.insert(0, root);
        let name = match scene.shows {
            Shows::Defects => "defects",
            Shows::Change => "change",
            Shows::Thickness => "thickness",
        };
        let mut document = json!({
            "asset": { "version": "2.0", "generator": crate::ENGINE },
            "scene": 0,
            "scenes": [{
                "name": name,
                "nodes": [0],
                "extras": { "legend": scene.legend, "sound": SOUND, "scale": self.scale },
            }],
            "nodes": self.nodes,
        });
        if !self.bytes.is_empty() {
            document["meshes"] = self.meshes.into();
            document["materials"] = self.materials.into();
            document["accessors"] = self.accessors.into();
            document["bufferViews"] = self.views.into();
            document["buffers"] = json!([{ "byteLength": self.bytes.len() }]);
        }
        let mut text = document.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        assemble(&text, &self.bytes)
    }
}

fn primitive(mode: u32, position: usize, indices: Option<usize>, material: usize) -> Value {
    let mut primitive = json!({ "mode": mode, "attributes": { "POSITION": position }, "material": material });
    if let Some(indices) = indices {
        primitive["indices"] = indices.into();
    }
    primitive
}

/// Joins header and chunks, each a multiple of four bytes long (glTF 2.0 specification, section 4).
fn assemble(text: &[u8], bytes: &[u8]) -> Result<Vec<u8>, RenderError> {
    let binary = if bytes.is_empty() { 0 } else { 8 + bytes.len() };
    let length = 12 + 8 + text.len() + binary;
    let size = |n: usize| u32::try_from(n).map_err(|_| RenderError::TooLarge);
    let mut file = Vec::with_capacity(length);
    for word in [u32::from_le_bytes(*b"glTF"), 2, size(length)?, size(text.len())?, u32::from_le_bytes(*b"JSON")] {
        file.extend_from_slice(&word.to_le_bytes());
    }
    file.extend_from_slice(text);
    if !bytes.is_empty() {
        for word in [size(bytes.len())?, u32::from_le_bytes(*b"BIN\0")] {
            file.extend_from_slice(&word.to_le_bytes());
        }
        file.extend_from_slice(bytes);
    }
    Ok(file)
}

/// Writes a scene as binary little-endian PLY with vertex colours, which MeshLab, Blender, Open3D and trimesh all
/// display. Faces of different colours share no vertices, so that programs without face colours show each face in one
/// colour.
///
/// Lines and dots become small tubes and octahedra after the mesh's own faces, since few programs draw PLY edges. The
/// face property `defect` is 0 for sound surface and 1 plus the kind's number otherwise; 255 marks tubes and
/// octahedra. A drawing of changes has the face property `provenance` instead: 0 kept, 1 moved, 2 added, 3 removed.
/// Comments hold the legend. Positions are `float` if that is exact, otherwise `double`.
///
/// # Errors
/// [`RenderError::Cancelled`] on cancellation or timeout, [`RenderError::TooLarge`] beyond 2^32 vertices.
pub fn write_ply(scene: &Scene, context: &Context<'_>) -> Result<Vec<u8>, RenderError> {
    let mut body = PlyBody { wide: !scene.surface.positions.iter().all(|&p| fits_f32(p)), ..PlyBody::default() };
    let mut compactor = Compactor::new(scene.surface.positions.len());
    for (paint, faces) in scene.groups() {
        context.check()?;
        let group = compactor.compact(&scene.surface, &faces);
        let first = body.count()?;
        for &v in &group.vertices {
            body.vertex(scene.surface.positions[v as usize], paint.colour());
        }
        for face in group.faces {
            body.face(first, face, paint.number())?;
        }
    }
    let own = body.faces;
    for segment in &scene.segments {
        body.tube(scene, segment.ends, colour(segment.kind))?;
    }
    context.check()?;
    for dot in scene.dots.iter().filter(|dot| dot.extent < DOT) {
        body.octahedron(scene, dot.at, colour(dot.kind))?;
    }
    Ok([ply_header(scene, &body, own).into_bytes(), body.vertex_bytes, body.face_bytes].concat())
}

fn ply_header(scene: &Scene, body: &PlyBody, own: u64) -> String {
    let real = if body.wide { "double" } else { "float" };
    let mut text = format!("ply\nformat binary_little_endian 1.0\ncomment {}\n", crate::ENGINE);
    let property = match scene.shows {
        Shows::Defects => "defect",
        Shows::Change => "provenance",
        Shows::Thickness => "thickness",
    };
    if scene.shows == Shows::Defects {
        let _ = writeln!(text, "comment legend sound {SOUND}");
    }
    for entry in &scene.legend {
        let _ = writeln!(text, "comment legend {} {} {} {}", entry.kind.id(), entry.colour, entry.count, entry.name);
    }
    if scene.shows == Shows::Defects {
        let _ = writeln!(text, "comment faces from {own} on are markers of lines and points, not part of the mesh");
    }
    let _ = write!(
        text,
        "element vertex {}\nproperty {real} x\nproperty {real} y\nproperty {real} z\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\n\
         element face {}\nproperty list uchar uint vertex_indices\nproperty uchar {property}\nend_header\n",
        body.vertices, body.faces
    );
    text
}

fn fits_f32(p: DVec3) -> bool {
    p.as_vec3().as_dvec3() == p
}

#[derive(Default)]
struct PlyBody {
    wide: bool,
    vertices: u64,
    faces: u64,
    vertex_bytes: Vec<u8>,
    face_bytes: Vec<u8>,
}

impl PlyBody {
    fn count(&self) -> Result<u32, RenderError> {
        u32::try_from(self.vertices).map_err(|_| RenderError::TooLarge)
    }

    fn vertex(&mut self, p: DVec3, colour: Colour) {
        for x in p.to_array() {
            if self.wide {
                self.vertex_bytes.extend_from_slice(&x.to_le_bytes());
            } else {
                #[expect(clippy::cast_possible_truncation, reason = "exact, or the corner of a marker")]
                self.vertex_bytes.extend_from_slice(&(x as f32).to_le_bytes());
            }
        }
        self.vertex_bytes.extend_from_slice(&colour.0);
        self.vertices += 1;
    }

    fn face(&mut self, first: u32, face: [u32; 3], defect: u8) -> Result<(), RenderError> {
        self.face_bytes.push(3);
        for v in face {
            let v = first.checked_add(v).ok_or(RenderError::TooLarge)?;
            self.face_bytes.extend_from_slice(&v.to_le_bytes());
        }
        self.face_bytes.push(defect);
        self.faces += 1;
        Ok(())
    }

    /// Adds a triangular tube with open ends.
    fn tube(&mut self, scene: &Scene, ends: [DVec3; 2], colour: Colour) -> Result<(), RenderError> {
        let [a, b] = ends.map(|p| scene.frame.to_cube(p));
        let along = b - a;
        let Some(along) = along.try_normalize() else { return Ok(()) };
        let u = along.any_orthonormal_vector() * TUBE;
        let v = along.cross(u);
        let first = self.count()?;
        let half_root = 0.75f64.sqrt();
        for end in [a, b] {
            for around in [u, u * -0.5 + v * half_root, u * -0.5 - v * half_root] {
                self.vertex(scene.frame.from_cube(end + around), colour);
            }
        }
        for (i, j) in [(0, 1), (1, 2), (2, 0)] {
            self.face(first, [i, j, j + 3], u8::MAX)?;
            self.face(first, [i, j + 3, i + 3], u8::MAX)?;
        }
        Ok(())
    }

    fn octahedron(&mut self, scene: &Scene, at: DVec3, colour: Colour) -> Result<(), RenderError> {
        let at = scene.frame.to_cube(at);
        let first = self.count()?;
        for axis in DVec3::AXES {
            self.vertex(scene.frame.from_cube(at + axis * DOT), colour);
            self.vertex(scene.frame.from_cube(at - axis * DOT), colour);
        }
        for (x, y, z) in [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)] {
            self.face(first, [x, y, z], u8::MAX)?;
        }
        Ok(())
    }
}
