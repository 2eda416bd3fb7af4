//! A mesh of glTF as one of a scene.

use rustc_hash::FxHashMap;

use super::super::errors::ReadError;
use super::document::Mesh;
use super::file::File;
use super::json::Whole;
use super::paint::Painter;
use super::pose::{Pose, Posed};
use super::primitive::{self, Mode, Used};
use super::source::Source;
use crate::mesh::Soup;
use crate::scene::{PAINTLESS, PaintedMesh};

/// Makes meshes, and counts what they come to together.
pub(super) struct Meshes<'f, 'a> {
    file: &'f File<'a>,
    pub painter: Painter<'f, 'a>,
    faces: u64,
    vertices: u64,
    /// Primitives without triangles or without positions.
    pub left_out: u64,
}

/// A primitive whose faces were read.
struct Part<'f, 'a> {
    source: Source<'f, 'a>,
    faces: Vec<[u32; 3]>,
    /// The vertices that it has, used or not.
    vertices: usize,
}

/// What primitives have in common that have the same vertices.
type Shared = [Option<Whole>; 5];

impl<'f, 'a> Meshes<'f, 'a> {
    pub fn new(file: &'f File<'a>) -> Self {
        Self { file, painter: Painter::new(file), faces: 0, vertices: 0, left_out: 0 }
    }

    /// Makes one mesh of all primitives. Those that have their vertices from the same accessors share them, and vertices that no face names
    /// are left out where most are not named.
    pub fn make(&mut self, mesh: &'f Mesh<'a>, pose: &Pose) -> Result<PaintedMesh, ReadError> {
        let mut parts = Vec::new();
        for primitive in mesh.primitives.iter() {
            match self.part(primitive)? {
                Some(part) => parts.push(part),
                None => self.left_out += 1,
            }
        }
        let mut made = PaintedMesh::default();
        let mut begins = Vec::with_capacity(parts.len());
        for part in &parts {
            begins.push(made.soup.faces.len());
            made.soup.faces.extend_from_slice(&part.faces);
            self.painter.paint(&part.source, &part.faces, part.vertices, &mut made.paint)?;
        }
        if made.paint.iter().all(|&paint| paint == PAINTLESS) {
            made.paint = Vec::new();
        }
        for group in alike(&parts) {
            self.place(&parts, &group, &begins, pose, &mut made.soup)?;
        }
        Ok(made)
    }

    fn part(&mut self, primitive: &'f super::document::Primitive) -> Result<Option<Part<'f, 'a>>, ReadError> {
        let Some(mode) = Mode::of(primitive.mode.map_or(4, |mode| mode.0))? else { return Ok(None) };
        let source = Source::new(self.file, primitive, self.faces, self.vertices)?;
        let Some(positions) = source.positions()? else { return Ok(None) };
        let indices = source.indices()?;
        // What Draco gives is a list, whatever the primitive says.
        let mode = if primitive.extensions.draco.is_some() { Mode::List } else { mode };
        let faces = primitive::faces(mode, indices.as_ref(), positions.count, self.faces, &self.file.limits)?;
        self.faces += faces.len() as u64;
        Ok(Some(Part { source, faces, vertices: positions.count }))
    }

    /// Adds the vertices of parts that share them, and gives their faces the numbers that these have in the whole.
    fn place(
        &mut self,
        parts: &[Part<'f, 'a>],
        group: &[usize],
        begins: &[usize],
        pose: &Pose,
        soup: &mut Soup,
    ) -> Result<(), ReadError> {
        let first = &parts[group[0]];
        let corners = || group.iter().flat_map(|&part| parts[part].faces.iter().flatten().copied());
        let used = Used::of(corners, first.vertices);
        self.vertices += used.len() as u64;
        self.file.limits.check_vertices(self.vertices)?;
        let Some(positions) = first.source.positions()? else { return Ok(()) };
        let posed = Posed::new(&first.source, &positions, pose)?;
        #[expect(clippy::cast_possible_truncation, reason = "the vertices were counted")]
        let base = soup.positions.len() as u32;
        soup.positions.reserve(used.len());
        for vertex in used.iter() {
            soup.positions.push(posed.at(vertex as usize)?);
        }
        for &part in group {
            let faces = &mut soup.faces[begins[part]..][..parts[part].faces.len()];
            faces.as_flattened_mut().iter_mut().for_each(|vertex| *vertex = base + used.rank(*vertex));
        }
        Ok(())
    }
}

/// The parts that have their vertices in common, in order of their first.
fn alike(parts: &[Part<'_, '_>]) -> Vec<Vec<usize>> {
    let mut groups: Vec<Vec<usize>> = Vec::new();
    let mut known: FxHashMap<Shared, usize> = FxHashMap::default();
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
