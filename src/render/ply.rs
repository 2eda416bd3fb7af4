use std::fmt::Write as _;

use glam::DVec3;

use super::palette::{SOUND, colour};
use super::scene::{Compactor, Shows};
use super::{Colour, RenderError, Scene};
use crate::context::Context;

/// Radius of the tube around a line, and of a dot, as a share of the model's half extent.
const TUBE: f64 = 0.005;
const DOT: f64 = 0.012;

/// Writes the mesh as binary little-endian PLY with a colour at each vertex, which MeshLab, Blender, Open3D and trimesh
/// all show; those that know face colours only from vertices see each face in one colour, since faces of different
/// colours share no vertex.
///
/// Lines and dots are small tubes and octahedra after the mesh's own faces, because few programs draw PLY's edges. The
/// face property `defect` is 0 for sound surface, otherwise 1 and the kind's number; 255 marks tubes and octahedra. Of a
/// change it is `fate`: 0 kept, 1 moved, 2 added, 3 removed.
/// The legend is in the comments. Positions are `float` where that loses nothing, else `double`.
///
/// # Errors
/// [`RenderError::Cancelled`] when the work should stop, [`RenderError::TooLarge`] beyond 2^32 vertices.
pub fn write_ply(scene: &Scene, context: &Context<'_>) -> Result<Vec<u8>, RenderError> {
    let mut body = Body { wide: !scene.surface.positions.iter().all(|&p| fits_f32(p)), ..Body::default() };
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
    Ok([header(scene, &body, own).into_bytes(), body.vertex_bytes, body.face_bytes].concat())
}

fn header(scene: &Scene, body: &Body, own: u64) -> String {
    let real = if body.wide { "double" } else { "float" };
    let mut text = format!("ply\nformat binary_little_endian 1.0\ncomment {}\n", crate::ENGINE);
    let property = match scene.shows {
        Shows::Defects => "defect",
        Shows::Change => "fate",
    };
    if scene.shows == Shows::Defects {
        let _ = writeln!(text, "comment legend sound {SOUND}");
    }
    for entry in &scene.legend {
        let _ = writeln!(text, "comment legend {} {} {} {}", entry.kind.id(), entry.colour, entry.count, entry.name);
    }
    if scene.shows == Shows::Defects {
        let _ = writeln!(text, "comment faces from {own} on mark lines and points and are no part of the mesh");
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
struct Body {
    wide: bool,
    vertices: u64,
    faces: u64,
    vertex_bytes: Vec<u8>,
    face_bytes: Vec<u8>,
}

impl Body {
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

    /// A tube of three sides, open at its ends.
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
