//! The export of a judged result as the returned file, with its colours, objects and unit.

use glam::DVec3;

use super::attribute_transfer::{Painted, SoupWithSource, transfer_paint};
use super::conclusion::RepairedBody;
use super::input::{Input, RepairError};
use super::judge::read_own;
use super::report::OmittedSection;
use crate::context::Context;
use crate::format::{self, Format, Limits, ReadFile, ReadMesh, ReadOptions, WriteError};
use crate::mesh::{Soup, Surface, position_key};
use crate::scene::{Item, Object, PaintedMesh, Scene, Shape};

/// The judging format for an output format: it stores the same coordinates, and only triangles.
pub(super) fn judging_format(format: Format) -> Format {
    match format {
        Format::Glb => Format::Stl,
        Format::ThreeMf | Format::Zip => Format::Ply,
        plain => plain,
    }
}

/// The triangles of a judged result, welded because some formats give each face its own vertices.
///
/// # Errors
/// [`RepairError`] if the bytes cannot be read.
pub(super) fn judged_soup(bytes: &[u8]) -> Result<Soup, RepairError> {
    Ok(Surface::from_soup(&read_own(bytes)?.soup).0.to_soup())
}

/// Exports one mesh, with its colours if the format can store them. A file that needs no export is returned as it is.
///
/// # Errors
/// [`RepairError`] if the file cannot be written, does not read back as judged, or the job was canceled.
pub(super) fn export_one(
    mut body: RepairedBody,
    input: &Input<'_>,
    file: &ReadFile,
    format: Format,
    context: &Context<'_>,
) -> Result<RepairedBody, RepairError> {
    let is_input = input.bytes == Some(body.bytes.as_slice());
    if body.bytes.is_empty()
        || is_input
        || (judging_format(format) == format && (file.paint.is_empty() || !format.has_paint()))
    {
        return Ok(body);
    }
    let verification = &context.for_verification();
    let soup = judged_soup(&body.bytes)?;
    let mut scene = file.scene.as_ref().map(Scene::without_objects).unwrap_or_default();
    scene.unit = file.unit.as_ref().map(|unit| unit.used);
    let painted = Painted { surface: &input.analysis.surface, paint: &file.paint };
    let result = SoupWithSource { soup: &soup, source: &body.source };
    let paint = transfer_paint(painted, result, &mut scene.palettes, verification);
    let paint = verification.unless_late(paint)?.unwrap_or_else(|| {
        input.time.omit(OmittedSection::Attributes);
        body.draft.omitted = input.time.omitted();
        Vec::new()
    });
    scene.objects = vec![Object::of_mesh(file.only_name(), PaintedMesh { soup, paint })];
    scene.items = vec![Item::of(0)];
    let Exported { bytes, mesh } = export(&scene, format)?;
    Ok(RepairedBody { bytes, dialect: mesh.dialect, ..body })
}

/// An exported file that holds exactly the judged faces.
pub(super) struct Exported {
    /// The file.
    pub bytes: Vec<u8>,
    /// The mesh that was read back from the file, in the judged positions and unit.
    pub mesh: ReadMesh,
}

/// Writes a scene, reads the file back, and checks that each placed mesh has exactly the same faces.
///
/// # Errors
/// [`RepairError`] if the scene cannot be written or read back, and [`RepairError::Unfaithful`] if faces differ.
pub(super) fn export(scene: &Scene, format: Format) -> Result<Exported, RepairError> {
    let bytes = format::write_scene(scene, format)?;
    let read = format::read_file(&bytes, &ReadOptions::within(Limits::NONE))?;
    let Some(again) = read.scene.as_ref().filter(|_| format.has_objects()) else {
        // A format without objects stores the whole scene as one mesh.
        let whole = scene.placed(u64::MAX).map_err(|_| WriteError::TooLarge)?;
        require_same(&[&whole.soup], &[&read.mesh.soup])?;
        return Ok(Exported { bytes, mesh: read.mesh });
    };
    let (ours, theirs) = (meshes(scene), meshes(again));
    let (before, after): (Vec<_>, Vec<_>) = (soups(scene, &ours), soups(again, &theirs));
    require_same(&before, &after)?;
    // Uses the judged transforms, because the file format may have rotated or scaled the objects.
    let mut placed = scene.clone();
    for (&own, soup) in ours.iter().zip(after) {
        placed.objects[own].shape = Shape::Mesh(PaintedMesh { soup: soup.clone(), paint: Vec::new() });
    }
    let soup = placed.placed(u64::MAX).map_err(|_| WriteError::TooLarge)?.soup;
    let materials = read.mesh.materials.clone().filter(|materials| materials.len() == soup.faces.len());
    let mesh = ReadMesh { materials, ..read.mesh.of_same_file(soup) };
    Ok(Exported { bytes, mesh })
}

/// The indices of objects that have faces and an instance, in order.
fn meshes(scene: &Scene) -> Vec<usize> {
    let places = scene.places();
    (0..places.len()).filter(|&object| places[object] > 0 && scene.objects[object].has_faces()).collect()
}

/// The triangles of the objects with these indices.
fn soups<'s>(scene: &'s Scene, meshes: &[usize]) -> Vec<&'s Soup> {
    meshes.iter().filter_map(|&object| scene.objects[object].mesh()).map(|mesh| &mesh.soup).collect()
}

/// Checks that two lists of meshes have the same faces, in any order.
fn require_same(a: &[&Soup], b: &[&Soup]) -> Result<(), RepairError> {
    let sorted = |soup: &Soup| {
        let mut order: Vec<usize> = (0..soup.faces.len()).collect();
        order.sort_unstable_by_key(|&face| key(soup, face));
        order
    };
    let is_same = |(a, b): (&&Soup, &&Soup)| {
        let faces = 0..a.faces.len();
        a.faces.len() == b.faces.len()
            && (faces.clone().all(|face| key(a, face) == key(b, face))
                || sorted(a).into_iter().zip(sorted(b)).all(|(x, y)| key(a, x) == key(b, y)))
    };
    if a.len() == b.len() && a.iter().zip(b).all(is_same) { Ok(()) } else { Err(RepairError::Unfaithful) }
}

/// A key of a face that does not depend on its first corner, but changes if the face is flipped.
fn key(soup: &Soup, face: usize) -> [[u64; 3]; 3] {
    let [a, b, c] = soup.corners(face).map(|p: DVec3| position_key(p));
    [[a, b, c], [b, c, a], [c, a, b]].into_iter().min().unwrap_or([a, b, c])
}
