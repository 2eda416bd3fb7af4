//! From a result that was judged to the file that is handed out, with its colours, objects and unit.

use glam::DVec3;

use super::input::{Input, Told, look, read_own, subject};
use super::repaint::repaint;
use super::verdict::fates;
use super::{Context, RepairError};
use crate::format::{self, Format, Limits, ReadFile, ReadOptions, WriteError};
use crate::inspect::{Analysis, measure_analysis};
use crate::mesh::{Soup, Surface, position_key};
use crate::scene::{Item, Object, PaintedMesh, Scene, Shape, Unit};

/// The format that results are judged in: it says the same coordinates as `format`, and nothing but triangles.
pub(super) fn carrier(format: Format) -> Format {
    match format {
        Format::Glb => Format::Stl,
        Format::ThreeMf => Format::Ply,
        plain => plain,
    }
}

/// The file of one mesh: with its colours, where the format can say them.
pub(super) fn dress_one(
    told: Told,
    input: &Input<'_>,
    file: &ReadFile,
    format: Format,
    unit: Unit,
    context: &Context<'_>,
) -> Result<Told, RepairError> {
    let is_input = input.bytes == Some(told.bytes.as_slice());
    if told.bytes.is_empty()
        || is_input
        || (carrier(format) == format && (file.paint.is_empty() || !format.has_paint()))
    {
        return Ok(told);
    }
    let patient = &context.without_deadline();
    // Some formats give each face its own vertices.
    let soup = Surface::from_soup(&read_own(&told.bytes)?.soup).0.to_soup();
    let mut scene = file.scene.as_ref().map(Scene::without_objects).unwrap_or_default();
    scene.unit = Some(unit);
    let paint = match file.paint.as_slice() {
        [] => Vec::new(),
        paint => repaint(&input.analysis.surface, paint, &soup, &told.source, &mut scene.palettes, patient)?,
    };
    scene.objects = vec![Object::of_mesh(file.only_name(), PaintedMesh { soup, paint })];
    scene.items = vec![Item::of(0)];
    let Dressed { bytes, read, in_order } = dress(&scene, format)?;
    if in_order {
        return Ok(Told { bytes, dialect: read.mesh.dialect, ..told });
    }
    // What was found is told of faces by their order.
    let analysis = Analysis::new(subject(&read.mesh), patient)?;
    let (_, found) = look(&analysis, || measure_analysis(&analysis, patient), context)?;
    let fates = fates(input.original, &analysis, context)?;
    Ok(Told { bytes, dialect: read.mesh.dialect, found: Some(found), fates, ..told })
}

/// A file that holds just what was judged.
pub(super) struct Dressed {
    pub bytes: Vec<u8>,
    /// What was read back from them.
    pub read: ReadFile,
    /// Whether faces stand in the order in which they were judged.
    pub in_order: bool,
}

/// Writes a scene, reads the written bytes back, and sees that each of its meshes in use has just the faces that it had.
pub(super) fn dress(scene: &Scene, format: Format) -> Result<Dressed, RepairError> {
    let bytes = format::write_scene(scene, format)?;
    let options = ReadOptions { limits: Limits::NONE, ..ReadOptions::default() };
    let read = format::read_file(&bytes, &options)?;
    let in_order = match &read.scene {
        Some(again) if format.has_objects() => compare(&meshes(scene), &meshes(again)),
        // One mesh, whatever the scene is made of.
        _ => {
            let whole = scene.placed(u64::MAX).map_err(|_| WriteError::TooLarge)?;
            compare(&[&whole.soup], &[&read.mesh.soup])
        }
    };
    let in_order = in_order.ok_or(RepairError::Unfaithful)?;
    Ok(Dressed { bytes, read, in_order })
}

/// The meshes with faces that stand somewhere, in their order.
fn meshes(scene: &Scene) -> Vec<&Soup> {
    let mut used = vec![false; scene.objects.len()];
    let mut stack: Vec<u32> = scene.items.iter().map(|item| item.object).collect();
    while let Some(object) = stack.pop() {
        let object = object as usize;
        if object < used.len()
            && !std::mem::replace(&mut used[object], true)
            && let Shape::Components(parts) = &scene.objects[object].shape
        {
            stack.extend(parts.iter().map(|part| part.object));
        }
    }
    let in_use = scene.objects.iter().zip(used).filter(|(_, used)| *used);
    in_use
        .filter_map(|(object, _)| object.mesh())
        .map(|mesh| &mesh.soup)
        .filter(|soup| !soup.faces.is_empty())
        .collect()
}

/// Whether meshes have the same faces, and if so whether in the same order; none if they don't.
fn compare(a: &[&Soup], b: &[&Soup]) -> Option<bool> {
    let mut in_order = a.len() == b.len();
    for (a, b) in a.iter().zip(b) {
        if a.faces.len() != b.faces.len() {
            return None;
        }
        let faces = 0..a.faces.len();
        if !faces.clone().all(|face| key(a, face) == key(b, face)) {
            let sorted = |soup: &Soup| {
                let mut order: Vec<usize> = faces.clone().collect();
                order.sort_unstable_by_key(|&face| key(soup, face));
                order
            };
            if !sorted(a).into_iter().zip(sorted(b)).all(|(x, y)| key(a, x) == key(b, y)) {
                return None;
            }
            in_order = false;
        }
    }
    (a.len() == b.len()).then_some(in_order)
}

/// The same for a face from whichever corner it is told, and another one if it is turned over.
fn key(soup: &Soup, face: usize) -> [[u64; 3]; 3] {
    let [a, b, c] = soup.corners(face).map(|p: DVec3| position_key(p));
    [[a, b, c], [b, c, a], [c, a, b]].into_iter().min().unwrap_or([a, b, c])
}
