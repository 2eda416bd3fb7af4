//! The file formats, what each can store, and what a scene loses when it is written in one.

use serde::{Deserialize, Serialize};

use crate::math::Precision;
use crate::scene::{Note, PAINTLESS, Paint, Palette, Scene, Shape, Unit};

/// The first bytes of a GLB file.
pub(super) const GLB_SIGNATURE: &[u8; 4] = b"glTF";

/// A file format that meshmend reads and writes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// STL, binary or ASCII; written as binary. Coordinates are f32, and faces have no vertex indices.
    Stl,
    /// Wavefront OBJ.
    Obj,
    /// Stanford PLY, ASCII or binary of either byte order; written as little-endian binary.
    Ply,
    /// Object File Format (OFF) with its variants, such as COFF and NOFF.
    Off,
    /// Vertex/Face text, the format of meshalyzer: lines `Vertex i x y z` and `Face j v1 v2 v3`, numbered from 1.
    Mesh,
    /// glTF 2.0, read as GLB or as JSON with embedded buffers, or with sidecar buffers in a ZIP archive. Written as GLB; f32, in metres.
    Glb,
    /// 3D Manufacturing Format: objects, build items, colours and a unit, in a ZIP package.
    #[serde(rename = "3mf")]
    ThreeMf,
    /// OBJ zip: a Wavefront OBJ with its materials and textures in a ZIP archive. A ZIP archive with one model of another format is read
    /// as that format.
    Zip,
}

impl Format {
    /// All formats, in the order of the variants.
    pub const ALL: [Self; 8] =
        [Self::Stl, Self::Obj, Self::Ply, Self::Off, Self::Mesh, Self::Glb, Self::ThreeMf, Self::Zip];

    /// The usual file name extension, without the dot.
    #[must_use]
    pub fn extension(self) -> &'static str {
        match self {
            Self::Stl => "stl",
            Self::Obj => "obj",
            Self::Ply => "ply",
            Self::Off => "off",
            Self::Mesh => "mesh",
            Self::Glb => "glb",
            Self::ThreeMf => "3mf",
            Self::Zip => "zip",
        }
    }

    /// The precision in which the format stores coordinates.
    #[must_use]
    pub fn precision(self) -> Precision {
        match self {
            Self::Stl | Self::Glb => Precision::F32,
            _ => Precision::F64,
        }
    }

    /// Whether faces share vertices by index, and readers keep them as they are. STL has no indices. glTF repeats a vertex for each of its
    /// normals and texture coordinates, so readers of STL and glTF join vertices by position.
    #[must_use]
    pub fn is_indexed(self) -> bool {
        !matches!(self, Self::Stl | Self::Glb)
    }

    /// Whether the format stores colours, materials or textures of faces.
    #[must_use]
    pub fn has_paint(self) -> bool {
        matches!(self, Self::Ply | Self::Zip | Self::Glb | Self::ThreeMf)
    }

    /// Whether the format stores separate objects and their instances.
    #[must_use]
    pub fn has_objects(self) -> bool {
        matches!(self, Self::Glb | Self::ThreeMf)
    }
}

/// A property of a scene that a format can't store.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Loss {
    /// Separate objects, or several instances of one: they become one mesh.
    Objects,
    /// Colours of faces, other than textures.
    Colors,
    /// Textures.
    Textures,
    /// Names of materials, in a format that stores colours.
    Materials,
    /// A colour that a texture is multiplied with.
    Tints,
    /// A unit other than the millimetre, which readers assume if a file declares none.
    Unit,
    /// Metadata, such as title and designer.
    Notes,
}

impl Loss {
    /// The phrase for this loss in a warning.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Objects => "separate objects",
            Self::Colors => "colours",
            Self::Textures => "textures",
            Self::Materials => "material names",
            Self::Tints => "texture tints",
            Self::Unit => "the unit",
            Self::Notes => "metadata",
        }
    }

    /// Whether `format` can't store this property.
    fn is_of(self, format: Format) -> bool {
        match self {
            Self::Objects | Self::Unit | Self::Notes => !format.has_objects(),
            Self::Colors => !format.has_paint(),
            Self::Textures => !format.has_paint() || format == Format::Ply,
            // A format without colours loses the materials as `Colors`.
            Self::Materials => format == Format::Ply,
            Self::Tints => format == Format::ThreeMf,
        }
    }
}

/// The properties of a scene that are lost when it is written in `format`, in the order of [`Loss`].
#[must_use]
pub fn losses(scene: &Scene, format: Format) -> Vec<Loss> {
    let mut losses = paint_losses(scene);
    if has_several_instances(scene) {
        losses.push(Loss::Objects);
    }
    if scene.unit.is_some_and(|unit| unit != Unit::Millimetre) {
        losses.push(Loss::Unit);
    }
    let has_notes = |notes: &[Note]| !notes.is_empty();
    if has_notes(&scene.notes)
        || scene.objects.iter().any(|object| has_notes(&object.notes))
        || scene.items.iter().any(|item| has_notes(&item.notes))
    {
        losses.push(Loss::Notes);
    }
    losses.retain(|loss| loss.is_of(format));
    losses.sort_unstable();
    losses
}

/// A warning that names what `format` loses of a scene, and formats that keep it; `None` if nothing is lost.
#[must_use]
pub fn losses_in_words(scene: &Scene, format: Format) -> Option<String> {
    let losses = losses(scene, format);
    let words: Vec<&str> = losses.iter().map(|loss| loss.as_str()).collect();
    let (last, before) = words.split_last()?;
    let lost = if before.is_empty() { (*last).to_owned() } else { format!("{} and {last}", before.join(", ")) };
    let keeps = |other: &Format| !losses.iter().any(|loss| loss.is_of(*other));
    let others: Vec<&str> = [Format::ThreeMf, Format::Glb].into_iter().filter(keeps).map(name).collect();
    let (name, others) = (name(format), others.join(" or "));
    let [was, them] = if losses == [Loss::Unit] { ["it was", "it"] } else { ["they were", "them"] };
    let keep = (!others.is_empty()).then(|| format!("choose {others} as output format to keep {them}"));
    let unit = scene.unit.filter(|_| losses.contains(&Loss::Unit));
    let convert =
        unit.map(|unit| format!("lengths stay in {unit}, and slicers assume mm: convert them with `scale_to=mm`"));
    let advice: String = keep.into_iter().chain(convert).map(|advice| format!("; {advice}")).collect();
    Some(format!("{name} can't store {lost}, so {was} dropped{advice}"))
}

/// The format's name for a message.
fn name(format: Format) -> &'static str {
    match format {
        Format::Stl => "STL",
        Format::Obj => "OBJ",
        Format::Ply => "PLY",
        Format::Off => "OFF",
        Format::Mesh => "Vertex/Face text",
        Format::Glb => "GLB",
        Format::ThreeMf => "3MF",
        Format::Zip => "OBJ in a ZIP archive",
    }
}

/// Whether the scene has more than one object or instance.
fn has_several_instances(scene: &Scene) -> bool {
    match &scene.items[..] {
        [item] => match scene.objects.get(item.object as usize).map(|object| &object.shape) {
            Some(Shape::Components(parts)) => parts.len() > 1,
            _ => false,
        },
        items => items.len() > 1,
    }
}

/// What would be lost of the faces' paint in a format that stores none.
fn paint_losses(scene: &Scene) -> Vec<Loss> {
    let mut used = vec![false; scene.palettes.len()];
    let meshes = scene.objects.iter().filter_map(|object| object.mesh());
    for Paint { palette, .. } in meshes.flat_map(|mesh| &mesh.paint).filter(|paint| **paint != PAINTLESS) {
        if let Some(used) = used.get_mut(*palette as usize) {
            *used = true;
        }
    }
    let mut losses = Vec::new();
    for (palette, _) in scene.palettes.iter().zip(used).filter(|(_, used)| *used) {
        let own: &[Loss] = match palette {
            Palette::Colors(_) => &[Loss::Colors],
            Palette::Materials(materials) if materials.iter().all(|material| material.name.is_empty()) => {
                &[Loss::Colors]
            }
            Palette::Materials(_) => &[Loss::Colors, Loss::Materials],
            Palette::Textured { tint: [255, 255, 255, 255], .. } => &[Loss::Textures],
            Palette::Textured { .. } => &[Loss::Textures, Loss::Tints],
        };
        losses.extend(own.iter().filter(|loss| !losses.contains(*loss)).collect::<Vec<_>>());
    }
    losses
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::mesh::Soup;
    use crate::scene::{Item, Material, PaintedMesh};

    fn painted(palettes: Vec<Palette>) -> Scene {
        let paint: Vec<Paint> = (0..palettes.len() as u32).map(|palette| Paint { palette, at: [0; 3] }).collect();
        let soup = Soup { positions: vec![DVec3::ZERO], faces: vec![[0; 3]; paint.len()] };
        Scene { palettes, ..Scene::of_mesh(PaintedMesh { soup, paint }) }
    }

    fn textured(tint: [u8; 4]) -> Palette {
        Palette::Textured { texture: 0, name: None, tint, places: vec![[0.0; 2]] }
    }

    #[test]
    fn an_unpainted_mesh_loses_nothing_in_any_format() {
        let mut scene = painted(Vec::new());
        scene.palettes.push(Palette::Colors(vec![[0; 4]]));
        scene.unit = Some(Unit::Millimetre);
        for format in Format::ALL {
            assert_eq!(losses_in_words(&scene, format), None);
        }
    }

    #[test]
    fn each_format_loses_what_it_cannot_store() {
        let material = Material { name: "PLA".to_owned(), color: [1; 4] };
        let mut scene = painted(vec![Palette::Materials(vec![material]), textured([255; 4])]);
        scene.items.push(Item::of(0));
        scene.unit = Some(Unit::Inch);
        use Loss::{Colors, Materials, Objects, Textures};
        for format in [Format::Stl, Format::Obj, Format::Off, Format::Mesh] {
            assert_eq!(losses(&scene, format), [Objects, Colors, Textures, Loss::Unit]);
        }
        assert_eq!(losses(&scene, Format::Ply), [Objects, Textures, Materials, Loss::Unit]);
        assert_eq!(losses(&scene, Format::Zip), [Objects, Loss::Unit]);
        for format in [Format::Glb, Format::ThreeMf] {
            assert_eq!(losses(&scene, format), []);
        }
    }

    #[test]
    fn the_warning_names_formats_that_keep_the_losses() {
        let mut scene = painted(vec![Palette::Colors(vec![[0; 4]]), textured([1; 4])]);
        assert_eq!(
            losses_in_words(&scene, Format::ThreeMf).as_deref(),
            Some("3MF can't store texture tints, so they were dropped; choose GLB as output format to keep them")
        );
        scene = painted(vec![Palette::Colors(vec![[0; 4]])]);
        scene.items.push(Item::of(0));
        assert_eq!(
            losses_in_words(&scene, Format::Stl).as_deref(),
            Some(
                "STL can't store separate objects and colours, so they were dropped; choose 3MF or GLB as output format to keep them"
            )
        );
        scene = Scene { unit: Some(Unit::Metre), ..Scene::default() };
        assert_eq!(
            losses_in_words(&scene, Format::Stl).as_deref(),
            Some(
                "STL can't store the unit, so it was dropped; choose 3MF or GLB as output format to keep it; lengths stay in m, and slicers assume mm: convert them with `scale_to=mm`"
            )
        );
    }
}
