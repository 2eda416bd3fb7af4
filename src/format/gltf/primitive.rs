//! The data of a primitive, from accessors or decoded from Draco (`KHR_draco_mesh_compression`), and its triangles (glTF 2.0, 3.7.2.1).

use std::panic::{AssertUnwindSafe, catch_unwind};

use draco_core::{DataType, DecodeLimits, DecoderBuffer, ErrorKind, Mesh, MeshDecoder};

use super::super::errors::{FileLocation, ReadError, ReadErrorKind};
use super::super::limits::Limits;
use super::accessor::{Accessor, Component};
use super::container::Integer;
use super::document::{Attributes, Primitive};
use super::file::{File, View, malformed};

/// A primitive with its decoded data, if it is compressed.
pub(super) struct PrimitiveData<'f, 'a> {
    /// The file.
    pub file: &'f File<'a>,
    /// The primitive in the document.
    pub primitive: &'f Primitive,
    decoded: Option<DecodedPrimitive>,
}

impl<'f, 'a> PrimitiveData<'f, 'a> {
    /// Decodes the primitive if it is compressed. `faces` and `vertices` count those read from the file so far.
    pub fn new(file: &'f File<'a>, primitive: &'f Primitive, faces: u64, vertices: u64) -> Result<Self, ReadError> {
        let decoded = match &primitive.extensions.draco {
            Some(draco) => {
                let decoded = DecodedPrimitive::new(file.view(draco.buffer_view)?, faces, vertices, &file.limits)?;
                file.count_work(decoded.vertices())?;
                Some(decoded)
            }
            None => None,
        };
        Ok(Self { file, primitive, decoded })
    }

    /// The index accessor; `None` if the primitive has no indices.
    pub fn indices(&self) -> Result<Option<Accessor<'f>>, ReadError> {
        match &self.decoded {
            Some(decoded) => Ok(Some(decoded.indices())),
            None => self.primitive.indices.map(|number| Accessor::new(self.file, number)).transpose(),
        }
    }

    /// The positions; `None` if the primitive has none and shows nothing.
    pub fn positions(&self) -> Result<Option<Accessor<'f>>, ReadError> {
        let positions = self.attribute("POSITION", |attributes| attributes.position)?;
        if let Some(positions) = &positions
            && positions.width != 3
        {
            return Err(malformed(format!("a primitive has positions with {} coordinates, not 3", positions.width)));
        }
        Ok(positions)
    }

    /// Another attribute, which must have a value for each of the `vertices` vertices.
    pub fn vertex_attribute(
        &self,
        name: &str,
        which: impl Fn(&Attributes) -> Option<Integer>,
        vertices: usize,
    ) -> Result<Option<Accessor<'f>>, ReadError> {
        let accessor = self.attribute(name, which)?;
        if let Some(accessor) = &accessor
            && accessor.count < vertices
        {
            let detail =
                format!("a primitive of {vertices} vertices has {name} values for only {} of them", accessor.count);
            return Err(ReadError::for_file(ReadErrorKind::Malformed, format!("{detail}; export the model again")));
        }
        Ok(accessor)
    }

    fn attribute(
        &self,
        name: &str,
        which: impl Fn(&Attributes) -> Option<Integer>,
    ) -> Result<Option<Accessor<'f>>, ReadError> {
        let number = which(&self.primitive.attributes);
        if let (Some(decoded), Some(draco)) = (&self.decoded, &self.primitive.extensions.draco)
            && let Some(within) = which(&draco.attributes)
        {
            let declared = number.and_then(|number| self.file.document.accessors.get(number.index()));
            let fraction = declared.is_some_and(|declared| declared.normalized);
            return match decoded.attribute(within.0, fraction) {
                Some(accessor) => Ok(Some(accessor)),
                None => Err(malformed(format!("the Draco-compressed data has no attribute {name}"))),
            };
        }
        number.map(|number| Accessor::new(self.file, number)).transpose()
    }
}

/// Maximum number of components decoded for a vertex: position, normal, tangent, colour, two texture coordinates, joints and weights.
const COMPONENTS_PER_VERTEX: u64 = 3 + 3 + 4 + 4 + 4 + 8;

/// A Draco stream may decode to at least this many vertices and faces, and to [`MAX_PER_BYTE`] more for each of its bytes. Regular meshes
/// compress well, but no real model reaches a thousand faces for each byte.
const MIN_PLAUSIBLE: u64 = 1 << 20;
const MAX_PER_BYTE: u64 = 1000;

/// A decoded primitive.
struct DecodedPrimitive(Mesh);

impl DecodedPrimitive {
    /// Decodes a stream. `faces` and `vertices` count those read from the file so far.
    fn new(view: View<'_>, faces: u64, vertices: u64, limits: &Limits) -> Result<Self, ReadError> {
        // The stream declares its own sizes: a kilobyte can decode to millions of equal points.
        let plausible = MIN_PLAUSIBLE + MAX_PER_BYTE * view.bytes.len() as u64;
        let points = limits.max_vertices.saturating_sub(vertices).min(plausible);
        let ceilings = DecodeLimits::default()
            .with_max_points(points)
            .with_max_faces(limits.max_faces.saturating_sub(faces).min(plausible))
            .with_max_decoded_bytes(points.saturating_mul(4 * COMPONENTS_PER_VERTEX));
        let decode = || {
            let mut mesh = Mesh::new();
            let mut buffer = DecoderBuffer::new(view.bytes).with_limits(ceilings);
            MeshDecoder::new().decode(&mut buffer, &mut mesh).map(|()| mesh)
        };
        let refused = |kind, why: &str| {
            let detail =
                format!("the Draco-compressed data can't be read: {why}; export the model without compression");
            let place = view.place.map(|at| FileLocation::Byte(at as u64));
            ReadError { place, ..ReadError::for_file(kind, detail) }
        };
        // The decoder promises not to panic. Input is untrusted, so a panic is caught and reported as an error anyway.
        match catch_unwind(AssertUnwindSafe(decode)) {
            Ok(Ok(mesh)) => Ok(Self(mesh)),
            Ok(Err(error)) if error.kind() == ErrorKind::LimitExceeded => Err(refused(
                ReadErrorKind::TooLarge,
                "the data decodes to more vertices or faces than the limits allow",
            )),
            Ok(Err(error)) => Err(refused(ReadErrorKind::Malformed, &error.to_string())),
            Err(_) => Err(refused(ReadErrorKind::Malformed, "the data is damaged")),
        }
    }

    /// Number of decoded vertices.
    fn vertices(&self) -> usize {
        self.0.num_points()
    }

    /// The corners of all faces.
    fn indices(&self) -> Accessor<'static> {
        Accessor::from_indices(self.0.faces().iter().flatten().map(|point| point.0))
    }

    /// The attribute with a Draco id; `fraction` tells whether its integers are normalized.
    fn attribute(&self, number: u32, fraction: bool) -> Option<Accessor<'static>> {
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
        Some(Accessor::from_floats(&values, width))
    }
}

/// The topology of a primitive's triangles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Topology {
    List,
    Strip,
    Fan,
}

impl Topology {
    /// The topology of a primitive's mode; `None` for points and lines.
    pub fn of(code: u32) -> Result<Option<Self>, ReadError> {
        match code {
            0..=3 => Ok(None),
            4 => Ok(Some(Self::List)),
            5 => Ok(Some(Self::Strip)),
            6 => Ok(Some(Self::Fan)),
            other => Err(malformed(format!("a primitive has the mode {other}, which glTF does not define"))),
        }
    }

    /// Number of triangles with this many corners, including degenerate ones.
    fn triangles(self, corners: usize) -> usize {
        match self {
            Self::List => corners / 3,
            Self::Strip | Self::Fan => corners.saturating_sub(2),
        }
    }

    /// The corners of a triangle, as positions in the index list.
    fn corners(self, triangle: usize) -> [usize; 3] {
        match self {
            Self::List => [3 * triangle, 3 * triangle + 1, 3 * triangle + 2],
            Self::Strip => [triangle, triangle + 1 + triangle % 2, triangle + 2 - triangle % 2],
            Self::Fan => [triangle + 1, triangle + 2, 0],
        }
    }
}

/// The faces of a primitive with `vertices` vertices. `before` counts the faces read from the file so far. Degenerate triangles of strips
/// and fans only join these, and are dropped.
pub(super) fn faces(
    mode: Topology,
    indices: Option<&Accessor<'_>>,
    vertices: usize,
    before: u64,
    limits: &Limits,
) -> Result<Vec<[u32; 3]>, ReadError> {
    if let Some(indices) = indices
        && (indices.width != 1 || !matches!(indices.component, Component::U8 | Component::U16 | Component::U32))
    {
        return Err(malformed("a primitive has indices that are not unsigned integers"));
    }
    let corners = indices.map_or(vertices, |indices| indices.count);
    let triangles = mode.triangles(corners);
    limits.check_faces(before + triangles as u64)?;
    let corner = |number: usize| match indices {
        #[expect(clippy::cast_possible_truncation, reason = "an accessor counts in 32 bits")]
        None => Ok(number as u32),
        Some(indices) => {
            let [vertex] = indices.integers::<1>(number);
            if vertex as usize >= vertices || vertex == indices.component.restart_index() {
                return Err(out_of_range(indices, number, vertex, vertices));
            }
            Ok(vertex)
        }
    };
    let mut faces = Vec::with_capacity(triangles);
    for triangle in 0..triangles {
        let [a, b, c] = mode.corners(triangle);
        let face = [corner(a)?, corner(b)?, corner(c)?];
        if mode == Topology::List || (face[0] != face[1] && face[1] != face[2] && face[2] != face[0]) {
            faces.push(face);
        }
    }
    Ok(faces)
}

#[cold]
fn out_of_range(indices: &Accessor<'_>, number: usize, vertex: u32, vertices: usize) -> ReadError {
    let detail = if vertex == indices.component.restart_index() {
        format!("an index is {vertex}, the largest of its type, which glTF forbids; export the model again")
    } else {
        format!(
            "a face refers to vertex {vertex}, but its primitive has only {vertices} vertices; export the model again"
        )
    };
    ReadError { place: indices.location(number), ..ReadError::for_file(ReadErrorKind::IndexOutOfRange, detail) }
}

/// The vertices that faces use, renumbered in ascending order.
pub(super) enum UsedVertices {
    /// All vertices; the value is their number.
    All(u32),
    /// Some vertices, in ascending order.
    Some(Vec<u32>),
}

impl UsedVertices {
    /// The vertices that `corners` refer to, of `vertices` vertices. If there are at least as many corners as vertices, all count as used.
    pub fn of<I: Iterator<Item = u32>>(corners: impl Fn() -> I, vertices: usize) -> Self {
        match u32::try_from(vertices) {
            Ok(all) if corners().take(vertices).count() == vertices => Self::All(all),
            _ => {
                let mut some: Vec<u32> = corners().collect();
                some.sort_unstable();
                some.dedup();
                Self::Some(some)
            }
        }
    }

    /// Number of used vertices.
    pub fn len(&self) -> usize {
        match self {
            Self::All(all) => *all as usize,
            Self::Some(some) => some.len(),
        }
    }

    /// The used vertices, in ascending order.
    pub fn iter(&self) -> impl Iterator<Item = u32> {
        let (all, some) = match self {
            Self::All(all) => (0..*all, &[][..]),
            Self::Some(some) => (0..0, &some[..]),
        };
        all.chain(some.iter().copied())
    }

    /// The new index of a used vertex.
    pub fn rank(&self, vertex: u32) -> u32 {
        match self {
            Self::All(_) => vertex,
            #[expect(clippy::cast_possible_truncation, reason = "no longer than 32 bits can number")]
            Self::Some(some) => some.binary_search(&vertex).unwrap_or_default() as u32,
        }
    }
}
