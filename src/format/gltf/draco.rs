//! Primitives that are compressed with Draco (`KHR_draco_mesh_compression`).

use std::panic::{AssertUnwindSafe, catch_unwind};

use draco_core::{DataType, DecodeLimits, DecoderBuffer, ErrorKind, Mesh, MeshDecoder};

use super::super::errors::{ReadError, ReadErrorKind};
use super::super::limits::Limits;
use super::accessor::Accessor;
use super::file::View;

/// The numbers of a vertex that may be decoded: a position, a normal, a tangent, a colour, two places in textures, joints and weights.
const NUMBERS: u64 = 3 + 3 + 4 + 4 + 4 + 8;

/// As many vertices and faces are believed in any stream, and as many for each of its bytes: what is regular packs well, but a model of a
/// thousand faces a byte is none.
const LEAST: u64 = 1 << 20;
const RATIO: u64 = 1000;

/// A primitive that was decoded.
pub(super) struct Decoded(Mesh);

impl Decoded {
    /// Decodes a primitive of a file that has `faces` and `vertices` already.
    pub fn new(view: View<'_>, faces: u64, vertices: u64, limits: &Limits) -> Result<Self, ReadError> {
        // The stream says how much it makes of itself: a kilobyte can be millions of equal points.
        let plausible = LEAST + RATIO * view.bytes.len() as u64;
        let points = limits.max_vertices.saturating_sub(vertices).min(plausible);
        let ceilings = DecodeLimits::default()
            .with_max_points(points)
            .with_max_faces(limits.max_faces.saturating_sub(faces).min(plausible))
            .with_max_decoded_bytes(points.saturating_mul(4 * NUMBERS));
        let decode = || {
            let mut mesh = Mesh::new();
            let mut buffer = DecoderBuffer::new(view.bytes).with_limits(ceilings);
            MeshDecoder::new().decode(&mut buffer, &mut mesh).map(|()| mesh)
        };
        let refused = |kind, why: &str| {
            let detail = format!(
                "the data that is compressed with Draco can't be read: {why}; export the model without compression"
            );
            let place = view.place.map(|at| super::super::Place::Byte(at as u64));
            ReadError { place, ..ReadError::whole(kind, detail) }
        };
        // The decoder promises not to panic; should it break its word on a stranger's bytes, that is an answer too.
        match catch_unwind(AssertUnwindSafe(decode)) {
            Ok(Ok(mesh)) => Ok(Self(mesh)),
            Ok(Err(error)) if error.kind() == ErrorKind::LimitExceeded => {
                Err(refused(ReadErrorKind::TooLarge, "it makes more vertices or faces than may be"))
            }
            Ok(Err(error)) => Err(refused(ReadErrorKind::Malformed, &error.to_string())),
            Err(_) => Err(refused(ReadErrorKind::Malformed, "it is damaged")),
        }
    }

    /// How many vertices it has.
    pub fn vertices(&self) -> usize {
        self.0.num_points()
    }

    /// The corners of all faces.
    pub fn indices(&self) -> Accessor<'static> {
        Accessor::of_indices(self.0.faces().iter().flatten().map(|point| point.0))
    }

    /// The attribute of a number; `fraction` where its integers stand for fractions.
    pub fn attribute(&self, number: u32, fraction: bool) -> Option<Accessor<'static>> {
        let attribute = self.0.attribute_by_unique_id(number)?;
        let width = usize::from(attribute.num_components());
        if width == 0 {
            return None;
        }
        let mut values = attribute.read_f32s(self.0.num_points(), width);
        let most = match attribute.data_type() {
            _ if !fraction && !attribute.normalized() => 1.0,
            DataType::Int8 => 127.0,
            DataType::Uint8 => 255.0,
            DataType::Int16 => 32767.0,
            DataType::Uint16 => 65535.0,
            _ => 1.0,
        };
        values
            .iter_mut()
            .for_each(|value| *value = (*value / most).max(if most == 1.0 { f32::NEG_INFINITY } else { -1.0 }));
        Some(Accessor::of_floats(&values, width))
    }
}
