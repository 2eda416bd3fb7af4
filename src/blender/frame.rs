//! The coordinate frame in which Blender gets a model, and the conversion of meshes into it and back.

use std::collections::HashMap;

use glam::DVec3;

use super::exchange::RawMesh;
use crate::mesh::Soup;

/// A coordinate frame that suits Blender. The model's bounding box is centred on the origin, and its largest half extent is in
/// [16, 32). The 24 bits of f32 thus describe the shape and not its location, and Blender's absolute tolerances fit.
///
/// The scale is a power of two, so that only the translation rounds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Frame {
    centre: DVec3,
    /// Frame units per model unit.
    scale: f64,
}

/// Binary exponents of extents that can be scaled. Outside, a conversion to f32 and back would leave f64's normal numbers.
const EXPONENTS: std::ops::RangeInclusive<i64> = -900..=900;
/// The largest half extent in the frame is in [2^4, 2^5).
const FRAME_EXPONENT: i64 = 4;

impl Frame {
    /// The frame for the bounding box of `positions`. `None` if a position is not finite, if all positions coincide, or if the box is
    /// smaller than 2^-900 or larger than 2^900.
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
        // Each is halved first, since the sum of two large corners could overflow.
        let half = high * 0.5 - low * 0.5;
        let exponent = binary_exponent(half.max_element())?;
        Some(Self { centre: low * 0.5 + high * 0.5, scale: power_of_two(FRAME_EXPONENT - exponent) })
    }

    /// A model position in the frame, rounded to f32 as Blender stores it. Negative zero becomes zero, so that equal positions have
    /// equal bits.
    pub(super) fn enter(&self, position: DVec3) -> [f32; 3] {
        let framed = (position - self.centre) * self.scale;
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the purpose")]
        framed.to_array().map(|c| c as f32 + 0.0)
    }

    /// A position of the frame in the model's coordinates.
    pub(super) fn leave(&self, position: [f32; 3]) -> DVec3 {
        DVec3::from_array(position.map(f64::from)) / self.scale + self.centre
    }

    /// A model length in the frame.
    pub(super) fn enter_length(&self, length: f64) -> f64 {
        length * self.scale
    }

    /// A length of the frame in the model's unit.
    pub(super) fn leave_length(&self, length: f64) -> f64 {
        length / self.scale
    }
}

/// The exponent e of a positive `value` in [2^e, 2^(e+1)); `None` outside [`EXPONENTS`]. It is read from the bits, since a logarithm
/// may differ between machines.
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

/// A position in the frame.
type FramePosition = [f32; 3];

/// The faces of a soup in the frame, without those that have two equal corners. Such faces enclose no volume, their edges cancel, and
/// Blender can't represent them.
fn framed(soup: &Soup, frame: Frame) -> impl Iterator<Item = ([u32; 3], [FramePosition; 3])> {
    soup.faces.iter().filter_map(move |face| {
        let corners = face.map(|v| soup.positions.get(v as usize).map(|&position| frame.enter(position)));
        let [Some(a), Some(b), Some(c)] = corners else { return None };
        (a != b && b != c && c != a).then_some((*face, [a, b, c]))
    })
}

/// The input of a voxel remesh: shared vertices stay shared, and unused vertices are omitted.
pub(super) fn for_voxels(soup: &Soup, frame: Frame) -> RawMesh {
    let mut new_index: Vec<Option<u32>> = vec![None; soup.positions.len()];
    let mut mesh = RawMesh::default();
    for (face, positions) in framed(soup, frame) {
        let mut corners = [0; 3];
        for ((corner, v), position) in corners.iter_mut().zip(face).zip(positions) {
            let Some(known) = new_index.get_mut(v as usize) else { continue };
            *corner = *known.get_or_insert_with(|| {
                mesh.positions.push(position);
                index(mesh.positions.len() - 1)
            });
        }
        mesh.faces.push(corners);
    }
    mesh
}

/// The input of a boolean: each face has its own three vertices. Blender's mesh can't hold two faces on the same three vertices, and
/// dropping one side of a double wall would open a closed surface. Its exact boolean welds by position anyway.
///
/// Faces on the same three positions are counted per orientation, as in chain arithmetic, but at most once. Several copies of one
/// orientation become one face, which keeps a closed surface closed. Equal counts of both orientations become one face of each.
pub(super) fn for_boolean(soup: &Soup, frame: Frame) -> RawMesh {
    /// The numbers of copies with even and with odd orientation.
    type Counts = [u32; 2];
    let mut counts: HashMap<[[u32; 3]; 3], Counts> = HashMap::with_capacity(soup.faces.len());
    for (_, positions) in framed(soup, frame) {
        let (key, orientation) = unoriented(positions);
        let count = &mut counts.entry(key).or_default()[orientation];
        *count = count.saturating_add(1);
    }
    let mut mesh = RawMesh::default();
    for (_, positions) in framed(soup, frame) {
        let (key, orientation) = unoriented(positions);
        let Some(pair) = counts.get_mut(&key) else { continue };
        if pair[orientation] == 0 || pair[orientation] < pair[1 - orientation] {
            continue;
        }
        let first = index(mesh.positions.len());
        mesh.positions.extend(positions);
        mesh.faces.push([first, first + 1, first + 2]);
        // This orientation is done. If both counts were equal, the other orientation is still to come.
        *pair = if pair[orientation] == pair[1 - orientation] {
            [u32::from(orientation == 1), u32::from(orientation == 0)]
        } else {
            [0, 0]
        };
    }
    mesh
}

/// The bits of three positions in ascending order, and whether that order is an even (0) or odd (1) permutation of the face.
fn unoriented(positions: [FramePosition; 3]) -> ([[u32; 3]; 3], usize) {
    let [a, b, c] = positions.map(|position| position.map(f32::to_bits));
    let odd = usize::from(a > b) + usize::from(b > c) + usize::from(a > c);
    let mut key = [a, b, c];
    key.sort_unstable();
    (key, odd % 2)
}

/// An index of a mesh. The limit on sent faces keeps indices within u32.
fn index(position: usize) -> u32 {
    u32::try_from(position).unwrap_or(u32::MAX)
}

/// The first position of the soup for each position of the frame, by its bits.
pub(super) fn originals(soup: &Soup, frame: Frame) -> HashMap<[u32; 3], DVec3> {
    let mut originals = HashMap::with_capacity(soup.positions.len());
    for &position in &soup.positions {
        originals.entry(frame.enter(position).map(f32::to_bits)).or_insert(position);
    }
    originals
}

/// Blender's result in the model's coordinates, without unused vertices. A vertex that Blender did not move gets its original position
/// exactly.
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
    fn the_frame_centres_the_box_and_scales_by_a_power_of_two() {
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
    fn negative_zero_enters_the_frame_as_zero() {
        let frame = frame(&[DVec3::splat(-1.0), DVec3::splat(1.0)]).unwrap();
        assert_eq!(frame.enter(DVec3::splat(-0.0)).map(f32::to_bits), [0; 3]);
    }
}
