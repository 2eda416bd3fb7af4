//! What reading a file returns: a mesh or a scene with its dialect and warnings, and the unit of its lengths.
//!
//! Most formats hold one mesh; 3MF and glTF hold scenes. [`Content`] is either one, and converts to [`ReadFile`] or [`ReadScene`].

use glam::DAffine3;

use super::errors::{ReadError, ReadErrorKind};
use super::formats::Format;
use super::limits::Limits;
use super::paint::MeshPaint;
use crate::math::Box3;
use crate::mesh::{CornerNormals, Numbering, Soup};
use crate::scene::{LengthUnit, PLAUSIBLE_SIZE_MM, Paint, PaintedMesh, Scene, Unit, UnitSource, Up};

/// A mesh read from a file, with the file's dialect, numbering, normals and warnings.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadMesh {
    /// The triangles.
    pub soup: Soup,
    /// The format, detected from the file's content.
    pub format: Format,
    /// The dialect in words, such as `binary STL`, `ASCII PLY` or `COFF`.
    pub dialect: String,
    /// The file's own element numbers; `None` for formats without numbers.
    pub numbering: Option<Numbering>,
    /// The normals in the file; `None` if it has none. Bad normals never make reading fail.
    pub normals: Option<CornerNormals>,
    /// The material number of each face, if a 3MF file is an assembly of several materials. Bodies of one material are judged together,
    /// and may touch bodies of another material.
    pub materials: Option<Vec<u32>>,
    /// The number of vertices in the file, if the reader joined equal ones: STL stores three for each facet.
    pub stored_vertices: Option<u64>,
    /// Counts of the polygons with more than three corners, which were triangulated.
    pub polygons: Polygons,
    /// Oddities that did not prevent reading, each as a sentence for the user.
    pub warnings: Vec<String>,
}

impl ReadMesh {
    /// A mesh with this format and dialect, and no other information.
    pub(crate) fn of(soup: Soup, format: Format, dialect: impl Into<String>) -> Self {
        Self {
            soup,
            format,
            dialect: dialect.into(),
            numbering: None,
            normals: None,
            materials: None,
            stored_vertices: None,
            polygons: Polygons::default(),
            warnings: Vec::new(),
        }
    }

    /// A mesh of other triangles with the same format and dialect.
    #[must_use]
    pub fn of_same_file(&self, soup: Soup) -> Self {
        Self::of(soup, self.format, self.dialect.clone())
    }
}

/// Counts of the polygons with more than three corners in a file.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Polygons {
    /// Number of polygons with more than three corners.
    pub count: u64,
    /// Number of polygons twisted by more than [`ReadOptions::twist_angle_deg`](super::ReadOptions::twist_angle_deg). They were
    /// triangulated with the least fold.
    pub twisted: u64,
    /// The largest twist of a polygon, in degrees, as the program Mesh Heal defines twist. It is the largest angle between the plane through
    /// the corners' centroid and the line from the centroid to a corner.
    pub largest_twist_deg: f64,
}

/// A scene read from a file: objects, instances and paint, with the file's dialect and warnings.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadScene {
    /// The objects, instances, palettes and textures.
    pub scene: Scene,
    /// The format, detected from the file's content.
    pub format: Format,
    /// The dialect in words, such as `3MF`, `GLB` or `OBJ in a ZIP archive`.
    pub dialect: String,
    /// Oddities that did not prevent reading, each as a sentence for the user.
    pub warnings: Vec<String>,
}

/// A file read completely: one mesh of all placed triangles, and its scene if it has one.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadFile {
    /// All triangles of all instances, placed.
    pub mesh: ReadMesh,
    /// The paint of each face of `mesh`; empty if no face is painted.
    pub paint: Vec<Paint>,
    /// Objects, instances, colours and unit; `None` if the file holds bare triangles only.
    pub scene: Option<Scene>,
    /// The unit of the file's lengths; `None` until [`ReadFile::settle_unit`] is called.
    pub unit: Option<LengthUnit>,
}

impl ReadFile {
    /// Whether the file has more than one object or more than one build item.
    #[must_use]
    pub fn has_objects(&self) -> bool {
        self.scene.as_ref().is_some_and(|scene| scene.items.len() > 1 || scene.objects.len() > 1)
    }

    /// The object's name, if the file has exactly one object and the object has a name.
    #[must_use]
    pub fn only_name(&self) -> Option<String> {
        let scene = self.scene.as_ref().filter(|_| !self.has_objects())?;
        scene.objects.first()?.name.clone()
    }
}

impl ReadScene {
    /// Places all objects and joins them to one mesh.
    ///
    /// # Errors
    /// A [`ReadError`] of kind `TooLarge` if the placed mesh would have more faces than `limits` allow.
    pub(super) fn into_file(self, limits: &Limits) -> Result<ReadFile, ReadError> {
        let Self { scene, format, dialect, warnings } = self;
        let whole = scene.placed(limits.max_faces).map_err(|error| {
            ReadError::for_file(ReadErrorKind::TooLarge, format!("{error}; simplify the model before you send it"))
        })?;
        let materials = (format == Format::ThreeMf).then(|| face_materials(&scene)).flatten();
        let mesh = ReadMesh { materials, warnings, ..ReadMesh::of(whole.soup, format, dialect) };
        Ok(ReadFile { mesh, paint: whole.paint, scene: Some(scene), unit: None })
    }
}

/// Maximum number of materials in an assembly. With more, all bodies are judged as one material.
const MAX_MATERIALS: u32 = 200;

/// The material number of each face of the placed mesh; `None` if all faces have one material.
fn face_materials(scene: &Scene) -> Option<Vec<u32>> {
    let instances = scene.instances(u64::MAX).ok()?;
    let materials =
        scene.materials_of(&instances).filter(|materials| materials.iter().all(|&number| number < MAX_MATERIALS))?;
    let mut of_face = Vec::new();
    for (instance, material) in instances.iter().zip(materials).filter(|(instance, _)| instance.is_printed) {
        let faces = scene.objects[instance.object as usize].mesh().map_or(0, |mesh| mesh.soup.faces.len());
        of_face.resize(of_face.len() + faces, material);
    }
    Some(of_face)
}

/// A mesh or a scene, as the format's reader returned it.
pub(super) enum Content {
    Mesh(Box<MeshAndPaint>),
    Scene(ReadScene),
}

/// A mesh and the paint of its faces.
pub(super) struct MeshAndPaint {
    /// The mesh.
    pub mesh: ReadMesh,
    /// The paint of its faces.
    pub paints: MeshPaint,
}

impl From<ReadMesh> for MeshAndPaint {
    fn from(mesh: ReadMesh) -> Self {
        Self { mesh, paints: MeshPaint::default() }
    }
}

impl Content {
    /// Mutable access to format, dialect and warnings.
    pub fn metadata_mut(&mut self) -> (&mut Format, &mut String, &mut Vec<String>) {
        match self {
            Self::Mesh(read) => (&mut read.mesh.format, &mut read.mesh.dialect, &mut read.mesh.warnings),
            Self::Scene(read) => (&mut read.format, &mut read.dialect, &mut read.warnings),
        }
    }

    /// Converts to a [`ReadFile`] with one placed mesh.
    ///
    /// # Errors
    /// A [`ReadError`] of kind `TooLarge` if the placed mesh would have more faces than `limits` allow.
    pub fn into_file(self, limits: &Limits) -> Result<ReadFile, ReadError> {
        match self {
            Self::Scene(read) => read.into_file(limits),
            Self::Mesh(painted) => {
                let MeshAndPaint { mesh, paints: MeshPaint { of_faces, palettes, textures } } = *painted;
                let scene = (!of_faces.is_empty()).then(|| {
                    let whole = PaintedMesh { soup: mesh.soup.clone(), paint: of_faces.clone() };
                    Scene { palettes, textures, ..Scene::of_mesh(whole) }
                });
                Ok(ReadFile { mesh, paint: of_faces, scene, unit: None })
            }
        }
    }

    /// Converts to a scene; a mesh becomes a scene of one object.
    pub fn into_scene(self) -> ReadScene {
        match self {
            Self::Scene(read) => read,
            Self::Mesh(painted) => {
                let MeshAndPaint { mesh: ReadMesh { soup, format, dialect, warnings, .. }, paints } = *painted;
                let MeshPaint { of_faces, palettes, textures } = paints;
                let scene = Scene::of_mesh(PaintedMesh { soup, paint: of_faces });
                ReadScene { scene: Scene { palettes, textures, ..scene }, format, dialect, warnings }
            }
        }
    }
}

impl ReadFile {
    /// The unit that the file itself states.
    #[must_use]
    pub fn own_unit(&self) -> Option<Unit> {
        self.scene.as_ref().and_then(|scene| scene.unit)
    }

    /// Settles the unit of the file's lengths: the declared unit, else the file's own unit, else millimetres. With `scale_to`, the lengths
    /// are converted to that unit.
    pub fn settle_unit(&mut self, declared: Option<Unit>, scale_to: Option<Unit>) -> LengthUnit {
        let file_unit = self.own_unit();
        let (own, source) = match (declared, file_unit) {
            (Some(declared), _) => (declared, UnitSource::Declared),
            (None, Some(file_unit)) => (file_unit, UnitSource::File),
            (None, None) => (Unit::Millimetre, UnitSource::Assumed),
        };
        let used = scale_to.unwrap_or(own);
        let note = match (source, file_unit) {
            (UnitSource::Assumed, _) => {
                let implausible_size_warning = implausible_size_warning(&self.mesh.soup);
                self.mesh.warnings.extend(implausible_size_warning.clone());
                let assumed = "the file declares no unit, so lengths were read as millimetres; set the `unit` option for another unit";
                Some(implausible_size_warning.unwrap_or_else(|| assumed.to_owned()))
            }
            (UnitSource::Declared, Some(file_unit)) if file_unit != own => {
                Some(format!("the file declares {file_unit}, but the request declares {own}; {own} was used"))
            }
            _ => None,
        };
        let up = self.scene.as_ref().and_then(|scene| scene.up);
        let scaled = used != own;
        if scaled {
            let factor = own.to(used);
            self.scale(factor);
        }
        if let Some(scene) = &mut self.scene {
            scene.unit = Some(used);
        }
        self.unit.insert(LengthUnit { used, source, scaled_from: scaled.then_some(own), up, note }).clone()
    }

    /// Scales all lengths by a factor. The unit stays.
    pub fn scale(&mut self, factor: f64) {
        if factor != 1.0 {
            self.mesh.soup.positions.iter_mut().for_each(|p| *p *= factor);
            self.scene = self.scene.take().map(|scene| scene.scaled(factor));
        }
    }

    /// All triangles converted to `unit` and to the up axis `up`, without the file's normals. Without a scene, coordinates stay unchanged.
    #[must_use]
    pub fn mesh_in(self, unit: Unit, up: Option<Up>) -> ReadMesh {
        let mut mesh = ReadMesh { normals: None, ..self.mesh };
        if let Some(scene) = self.scene {
            let factor = scene.unit.map_or(1.0, |own| own.to(unit));
            let turn = up.map_or(DAffine3::IDENTITY, |up| scene.stood(up, DAffine3::IDENTITY));
            if factor != 1.0 || turn != DAffine3::IDENTITY {
                mesh.soup.positions.iter_mut().for_each(|p| *p = turn.transform_point3(*p * factor));
            }
        }
        mesh
    }
}

/// A warning that the model's size is implausible in millimetres; `None` if the size is plausible.
fn implausible_size_warning(soup: &Soup) -> Option<String> {
    let finite = soup.positions.iter().copied().filter(|p| p.is_finite());
    let bounds = Box3::of(finite);
    let longest = (bounds.max - bounds.min).max_element();
    let likely = match longest {
        longest if !longest.is_finite() || longest <= 0.0 => return None,
        longest if longest < PLAUSIBLE_SIZE_MM[0] => "the real unit may be inches, centimetres or metres",
        longest if longest > PLAUSIBLE_SIZE_MM[1] => "the real unit may be micrometres, or the model is very large",
        _ => return None,
    };
    Some(format!(
        "the file declares no unit; in millimetres the model would be {longest:.3} mm long, so {likely}; set the `unit` option"
    ))
}
