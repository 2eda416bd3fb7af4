//! What a file holds, whatever its format: the one mesh that most formats know, or a scene; and what its lengths are in.

use glam::DAffine3;

use super::errors::{ReadError, ReadErrorKind};
use super::formats::Format;
use super::limits::Limits;
use super::paint::Paints;
use crate::math::Box3;
use crate::mesh::{CornerNormals, Numbering, Soup};
use crate::scene::{LengthUnit, Paint, PaintedMesh, Scene, Unit, UnitSource, Up};

/// A mesh read from bytes, with what a reader should tell.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadMesh {
    /// The triangles.
    pub soup: Soup,
    /// The format that was found.
    pub format: Format,
    /// The dialect in words: `binary STL`, `ASCII PLY`, `COFF`.
    pub dialect: String,
    /// The file's own numbers, where the format has numbers.
    pub numbering: Option<Numbering>,
    /// The normals that the file gives, if it gives any. None of them is ever a reason not to read a file.
    pub normals: Option<CornerNormals>,
    /// Of each face the number of its material, where the file is an assembly of bodies of several materials: 3MF alone. Bodies of one
    /// material are judged together, and may touch those of another.
    pub materials: Option<Vec<u32>>,
    /// The polygons of more than three corners that were cut.
    pub polygons: Polygons,
    /// Oddities that were read past, each a sentence for the person who sent the file.
    pub warnings: Vec<String>,
}

impl ReadMesh {
    /// Triangles of a file of this format and dialect that says nothing else.
    pub(crate) fn of(soup: Soup, format: Format, dialect: impl Into<String>) -> Self {
        Self {
            soup,
            format,
            dialect: dialect.into(),
            numbering: None,
            normals: None,
            materials: None,
            polygons: Polygons::default(),
            warnings: Vec::new(),
        }
    }

    /// Other triangles of the same file.
    #[must_use]
    pub fn of_same_file(&self, soup: Soup) -> Self {
        Self::of(soup, self.format, self.dialect.clone())
    }
}

/// The polygons of more than three corners in a file.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Polygons {
    /// How many there are.
    pub count: u64,
    /// How many are twisted by more than [`ReadOptions::twist_angle_deg`](super::ReadOptions::twist_angle_deg); they were cut with the least fold.
    pub twisted: u64,
    /// The largest twist of one, in degrees: the largest angle between the plane of the polygon through its corners' middle and the way from
    /// there to a corner, after Mesh Heal (seed 001).
    pub largest_twist_deg: f64,
}

/// A file read with what it holds beside triangles.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadScene {
    /// What it holds.
    pub scene: Scene,
    /// Its format.
    pub format: Format,
    /// The dialect in words: `3MF`, `GLB`, `OBJ in a ZIP archive`.
    pub dialect: String,
    /// What was ignored or looks wrong, in words.
    pub warnings: Vec<String>,
}

/// A file read with all that it says.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadFile {
    /// All its triangles in their places.
    pub mesh: ReadMesh,
    /// What they are painted with, one a face; empty where none is.
    pub paint: Vec<Paint>,
    /// What the triangles alone don't say: objects and their places, colours, a unit. None where they say everything.
    pub scene: Option<Scene>,
    /// What its lengths are in, once that is settled (see [`ReadFile::settle_unit`]).
    pub unit: Option<LengthUnit>,
}

impl ReadFile {
    /// Whether there is more than one object or place of one.
    #[must_use]
    pub fn has_objects(&self) -> bool {
        self.scene.as_ref().is_some_and(|scene| scene.items.len() > 1 || scene.objects.len() > 1)
    }

    /// The name of its object, if there is only one.
    #[must_use]
    pub fn only_name(&self) -> Option<String> {
        let scene = self.scene.as_ref().filter(|_| !self.has_objects())?;
        scene.objects.first()?.name.clone()
    }
}

impl ReadScene {
    /// The file with all objects in their places as one mesh.
    ///
    /// # Errors
    /// [`ReadError`] where that would have more faces than the limits allow.
    pub(super) fn into_file(self, limits: &Limits) -> Result<ReadFile, ReadError> {
        let Self { scene, format, dialect, warnings } = self;
        let whole = scene.placed(limits.max_faces).map_err(|error| {
            ReadError::whole(ReadErrorKind::TooLarge, format!("{error}; simplify the model before you send it"))
        })?;
        let materials = (format == Format::ThreeMf).then(|| face_materials(&scene)).flatten();
        let mesh = ReadMesh { materials, warnings, ..ReadMesh::of(whole.soup, format, dialect) };
        Ok(ReadFile { mesh, paint: whole.paint, scene: Some(scene), unit: None })
    }
}

/// Most materials of an assembly whose bodies are judged apart.
const MAX_MATERIALS: u32 = 200;

/// Of each face of the placed mesh the number of its material; none where all are of one material.
fn face_materials(scene: &Scene) -> Option<Vec<u32>> {
    let instances = scene.instances(u64::MAX).ok()?;
    let materials = scene.materials_of(&instances).filter(|it| it.iter().all(|&number| number < MAX_MATERIALS))?;
    let mut of_face = Vec::new();
    for (instance, material) in instances.iter().zip(materials).filter(|(instance, _)| instance.is_printed) {
        let faces = scene.objects[instance.object as usize].mesh().map_or(0, |mesh| mesh.soup.faces.len());
        of_face.resize(of_face.len() + faces, material);
    }
    Some(of_face)
}

/// What was read.
pub(super) enum Content {
    Mesh(Box<Painted>),
    Scene(ReadScene),
}

/// A mesh, and what its faces are painted with.
pub(super) struct Painted {
    pub mesh: ReadMesh,
    pub paints: Paints,
}

impl From<ReadMesh> for Painted {
    fn from(mesh: ReadMesh) -> Self {
        Self { mesh, paints: Paints::default() }
    }
}

impl Content {
    /// What was found and what there is to tell.
    pub fn account(&mut self) -> (&mut Format, &mut String, &mut Vec<String>) {
        match self {
            Self::Mesh(it) => (&mut it.mesh.format, &mut it.mesh.dialect, &mut it.mesh.warnings),
            Self::Scene(it) => (&mut it.format, &mut it.dialect, &mut it.warnings),
        }
    }

    /// All of it, and in its places as one mesh.
    pub fn into_file(self, limits: &Limits) -> Result<ReadFile, ReadError> {
        match self {
            Self::Scene(read) => read.into_file(limits),
            Self::Mesh(painted) => {
                let Painted { mesh, paints: Paints { of_faces, palettes, textures } } = *painted;
                let scene = (!of_faces.is_empty()).then(|| {
                    let whole = PaintedMesh { soup: mesh.soup.clone(), paint: of_faces.clone() };
                    Scene { palettes, textures, ..Scene::of_mesh(whole) }
                });
                Ok(ReadFile { mesh, paint: of_faces, scene, unit: None })
            }
        }
    }

    /// All of it as a scene.
    pub fn into_scene(self) -> ReadScene {
        match self {
            Self::Scene(read) => read,
            Self::Mesh(painted) => {
                let Painted { mesh: ReadMesh { soup, format, dialect, warnings, .. }, paints } = *painted;
                let Paints { of_faces, palettes, textures } = paints;
                let scene = Scene::of_mesh(PaintedMesh { soup, paint: of_faces });
                ReadScene { scene: Scene { palettes, textures, ..scene }, format, dialect, warnings }
            }
        }
    }
}

/// Longest sides, in millimetres, of what people have printed. What was taken for millimetres and lies outside was most likely in metres
/// or inches, or in micrometres.
const USUAL_MM: [f64; 2] = [5.0, 2000.0];

impl ReadFile {
    /// Settles what the file's lengths are in: what is declared, else what the file says, else millimetres. Where another unit is asked for
    /// by `scale_to`, they are brought into it.
    pub fn settle_unit(&mut self, declared: Option<Unit>, scale_to: Option<Unit>) -> LengthUnit {
        let said = self.scene.as_ref().and_then(|scene| scene.unit);
        let (own, source) = match (declared, said) {
            (Some(declared), _) => (declared, UnitSource::Declared),
            (None, Some(said)) => (said, UnitSource::File),
            (None, None) => (Unit::Millimetre, UnitSource::Assumed),
        };
        let used = scale_to.unwrap_or(own);
        let note = match (source, said) {
            (UnitSource::Assumed, _) => {
                let doubt = doubt(&self.mesh.soup);
                self.mesh.warnings.extend(doubt.clone());
                let assumed = "the file says no unit, so lengths were taken for millimetres; declare another with unit";
                Some(doubt.unwrap_or_else(|| assumed.to_owned()))
            }
            (UnitSource::Declared, Some(said)) if said != own => {
                Some(format!("the file says {said}, and the request declares {own}, which was taken"))
            }
            _ => None,
        };
        let up = self.scene.as_ref().and_then(|scene| scene.up);
        let scaled = used != own;
        if scaled {
            let factor = own.to(used);
            self.mesh.soup.positions.iter_mut().for_each(|p| *p *= factor);
            self.scene = self.scene.take().map(|scene| scene.scaled(factor));
        }
        if let Some(scene) = &mut self.scene {
            scene.unit = Some(used);
        }
        self.unit.insert(LengthUnit { used, source, scaled_from: scaled.then_some(own), up, note }).clone()
    }

    /// All its triangles with lengths in another unit and with another axis up, without the file's normals; as they are where the file
    /// says neither.
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

/// Why lengths are hardly in millimetres, if so.
fn doubt(soup: &Soup) -> Option<String> {
    let finite = soup.positions.iter().copied().filter(|p| p.is_finite());
    let bounds = Box3::of(finite);
    let longest = (bounds.max - bounds.min).max_element();
    let likely = match longest {
        longest if !longest.is_finite() || longest <= 0.0 => return None,
        longest if longest < USUAL_MM[0] => "it is likely in inches, centimetres or metres",
        longest if longest > USUAL_MM[1] => "it is likely in micrometres, or very large",
        _ => return None,
    };
    Some(format!(
        "the file says no unit, and taken for millimetres the model is {longest:.3} mm long, so {likely}; declare its unit with unit"
    ))
}
