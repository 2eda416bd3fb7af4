use std::collections::HashMap;

use glam::DVec3;

use super::exchange::RawMesh;
use super::frame::Frame;
use crate::mesh::Soup;

/// A position of the frame.
type Place = [f32; 3];

/// The faces of a soup in the frame, without those that have two corners in one place: they enclose nothing, their edges
/// cancel, and Blender can't hold them.
fn framed(soup: &Soup, frame: Frame) -> impl Iterator<Item = ([u32; 3], [Place; 3])> {
    soup.faces.iter().filter_map(move |face| {
        let corners = face.map(|v| soup.positions.get(v as usize).map(|&position| frame.enter(position)));
        let [Some(a), Some(b), Some(c)] = corners else { return None };
        (a != b && b != c && c != a).then_some((*face, [a, b, c]))
    })
}

/// What a voxel remesh is given: shared vertices stay shared, and vertices that no face uses are left out.
pub(super) fn for_voxels(soup: &Soup, frame: Frame) -> RawMesh {
    let mut new_index: Vec<Option<u32>> = vec![None; soup.positions.len()];
    let mut mesh = RawMesh::default();
    for (face, places) in framed(soup, frame) {
        let mut corners = [0; 3];
        for ((corner, v), place) in corners.iter_mut().zip(face).zip(places) {
            let Some(known) = new_index.get_mut(v as usize) else { continue };
            *corner = *known.get_or_insert_with(|| {
                mesh.positions.push(place);
                index(mesh.positions.len() - 1)
            });
        }
        mesh.faces.push(corners);
    }
    mesh
}

/// What a boolean is given: each face with three vertices of its own. Blender's mesh can't hold two faces on the same
/// three vertices, and to drop one side of a double wall would open what was closed; its exact boolean welds by
/// position anyway.
///
/// Faces on the same three places count as in chain arithmetic, up to one: copies turned the same way become one, which
/// keeps a closed surface closed, and as many of one turn as of the other become one of each.
pub(super) fn for_boolean(soup: &Soup, frame: Frame) -> RawMesh {
    /// Copies of one turn, then of the other.
    type Turns = [u32; 2];
    let mut turns: HashMap<[[u32; 3]; 3], Turns> = HashMap::with_capacity(soup.faces.len());
    for (_, places) in framed(soup, frame) {
        let (key, turn) = without_turn(places);
        let count = &mut turns.entry(key).or_default()[turn];
        *count = count.saturating_add(1);
    }
    let mut mesh = RawMesh::default();
    for (_, places) in framed(soup, frame) {
        let (key, turn) = without_turn(places);
        let Some(counts) = turns.get_mut(&key) else { continue };
        if counts[turn] == 0 || counts[turn] < counts[1 - turn] {
            continue;
        }
        let first = index(mesh.positions.len());
        mesh.positions.extend(places);
        mesh.faces.push([first, first + 1, first + 2]);
        // Taken; of two equal counts the other turn is still to come.
        *counts = if counts[turn] == counts[1 - turn] { [u32::from(turn == 1), u32::from(turn == 0)] } else { [0, 0] };
    }
    mesh
}

/// The bits of three places in ascending order, and whether the order of the face is an even (0) or odd (1) exchange of it.
fn without_turn(places: [Place; 3]) -> ([[u32; 3]; 3], usize) {
    let [a, b, c] = places.map(|place| place.map(f32::to_bits));
    let odd = usize::from(a > b) + usize::from(b > c) + usize::from(a > c);
    let mut key = [a, b, c];
    key.sort_unstable();
    (key, odd % 2)
}

/// An index of a mesh; the most faces that are sent keep it within u32.
fn index(position: usize) -> u32 {
    u32::try_from(position).unwrap_or(u32::MAX)
}

/// The first position of the soup for each place of the frame.
pub(super) fn originals(soup: &Soup, frame: Frame) -> HashMap<[u32; 3], DVec3> {
    let mut originals = HashMap::with_capacity(soup.positions.len());
    for &position in &soup.positions {
        originals.entry(frame.enter(position).map(f32::to_bits)).or_insert(position);
    }
    originals
}

/// What Blender made, in the model's unit and place, without vertices that no face uses. A vertex that is still where
/// it was sent gets its position back to the last bit.
pub(super) fn unframed(mesh: &RawMesh, frame: Frame, originals: &HashMap<[u32; 3], DVec3>) -> Soup {
    const UNUSED: u32 = u32::MAX;
    let mut soup = Soup::default();
    let mut new_index = vec![UNUSED; mesh.positions.len()];
    for face in &mesh.faces {
        let face = face.map(|v| {
            let (Some(new), Some(position)) = (new_index.get_mut(v as usize), mesh.positions.get(v as usize)) else {
                return UNUSED;
            };
            if *new == UNUSED {
                *new = u32::try_from(soup.positions.len()).unwrap_or(UNUSED);
                let position = position.map(|c| c + 0.0);
                let original = originals.get(&position.map(f32::to_bits));
                soup.positions.push(original.copied().unwrap_or_else(|| frame.leave(position)));
            }
            *new
        });
        soup.faces.push(face);
    }
    soup
}
