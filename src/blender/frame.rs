//! The frame that a model stands in while Blender has it, and soups on their way into it and back.

use std::collections::HashMap;

use glam::DVec3;

use super::exchange::RawMesh;
use crate::mesh::Soup;

/// Where a model stands while Blender has it: its box centred on the origin and its larger half extent in [16, 32), so
/// that f32 keeps 24 bits of the shape and not of the place, and Blender's absolute tolerances meet ordinary sizes.
///
/// The scale is a power of two, so that only the shift rounds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Frame {
    centre: DVec3,
    /// Model to frame.
    scale: f64,
}

/// Binary exponents that are scaled: outside, a step to f32 and back would leave the normal numbers of f64.
const EXPONENTS: std::ops::RangeInclusive<i64> = -900..=900;
/// The half extent becomes 2^4 to 2^5.
const FRAME_EXPONENT: i64 = 4;

impl Frame {
    /// The frame of the box around `positions`; none where a position is not finite, or the box is a point or of a
    /// size that f64 can't scale (below 2^-900 or above 2^900).
    pub(super) fn around(positions: impl Iterator<Item = DVec3>) -> Option<Self> {
        let mut low = DVec3::INFINITY;
        let mut high = DVec3::NEG_INFINITY;
        for position in positions {
            if !position.is_finite() {
                return None;
            }
            low = low.min(position);
            high = high.max(position);
        }
        // Halves first: the sum of two large corners overflows.
        let half = high * 0.5 - low * 0.5;
        let exponent = binary_exponent(half.max_element())?;
        Some(Self { centre: low * 0.5 + high * 0.5, scale: power_of_two(FRAME_EXPONENT - exponent) })
    }

    /// A position in the frame, rounded as Blender keeps it. Negative zero becomes zero, so that equal positions have
    /// equal bits.
    pub(super) fn enter(&self, position: DVec3) -> [f32; 3] {
        let inside = (position - self.centre) * self.scale;
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the purpose")]
        inside.to_array().map(|c| c as f32 + 0.0)
    }

    /// A position of the frame in the model's unit and place.
    pub(super) fn leave(&self, position: [f32; 3]) -> DVec3 {
        DVec3::from_array(position.map(f64::from)) / self.scale + self.centre
    }

    /// A length of the model in the frame.
    pub(super) fn enter_length(&self, length: f64) -> f64 {
        length * self.scale
    }

    /// A length of the frame in the model's unit.
    pub(super) fn leave_length(&self, length: f64) -> f64 {
        length / self.scale
    }
}

/// The exponent e of a positive `value` in [2^e, 2^(e+1)); none outside [`EXPONENTS`]. Read from the bits, since a
/// logarithm may differ from machine to machine.
fn binary_exponent(value: f64) -> Option<i64> {
    if !value.is_finite() || value <= 0.0 {
        return None;
    }
    let exponent = ((value.to_bits() >> 52) & 0x7ff).cast_signed() - 1023;
    EXPONENTS.contains(&exponent).then_some(exponent)
}

/// 2 to the power of an exponent between -1022 and 1023.
fn power_of_two(exponent: i64) -> f64 {
    f64::from_bits((1023 + exponent).clamp(1, 2046).cast_unsigned() << 52)
}

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

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(corners: &[DVec3]) -> Option<Frame> {
        Frame::around(corners.iter().copied())
    }

    #[test]
    fn a_frame_centres_the_box_and_scales_by_a_power_of_two() {
        let corners = [DVec3::new(1000.0, 0.0, 0.0), DVec3::new(1003.0, 1.0, 0.0)];
        let frame = frame(&corners).unwrap();
        assert_eq!(frame.enter(corners[0]), [-24.0, -8.0, 0.0]);
        assert_eq!(frame.enter(corners[1]), [24.0, 8.0, 0.0]);
        assert_eq!(frame.enter_length(3.0), 48.0);
        assert_eq!(frame.leave_length(48.0), 3.0);
    }

    #[test]
    fn leaving_a_frame_undoes_entering_it_at_any_size_and_place() {
        for size in [1e-200, 1e-6, 1.0, 1e9, 1e200] {
            for place in [0.0, 1.0, -1e5] {
                let corners = [DVec3::splat(size * place), DVec3::new(1.0, 0.5, 0.25) * size + size * place];
                let frame = frame(&corners).unwrap();
                for corner in corners {
                    let back = frame.leave(frame.enter(corner));
                    assert!((back - corner).abs().max_element() <= size * 1e-7, "{corner} came back as {back}");
                }
            }
        }
    }

    #[test]
    fn a_box_that_cannot_be_scaled_has_no_frame() {
        assert_eq!(frame(&[]), None);
        assert_eq!(frame(&[DVec3::ONE, DVec3::ONE]), None);
        assert_eq!(frame(&[DVec3::ZERO, DVec3::splat(f64::MIN_POSITIVE)]), None);
        assert_eq!(frame(&[DVec3::splat(-f64::MAX), DVec3::splat(f64::MAX)]), None);
        assert_eq!(frame(&[DVec3::ZERO, DVec3::new(1.0, f64::NAN, 0.0)]), None);
    }

    #[test]
    fn negative_zero_enters_as_zero() {
        let frame = frame(&[DVec3::splat(-1.0), DVec3::splat(1.0)]).unwrap();
        assert_eq!(frame.enter(DVec3::splat(-0.0)).map(f32::to_bits), [0; 3]);
    }
}
