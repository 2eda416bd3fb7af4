use super::{Format, Limits, ReadError, ReadErrorKind, ReadMesh};
use crate::scene::{LengthUnit, Paint, Scene};

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
