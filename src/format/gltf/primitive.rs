//! The triangles of a primitive (glTF 2.0, 3.7.2.1).

use super::super::errors::{ReadError, ReadErrorKind};
use super::super::limits::Limits;
use super::accessor::{Accessor, Component};
use super::file::malformed;

/// How corners follow each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Mode {
    List,
    Strip,
    Fan,
}

impl Mode {
    /// The mode of a primitive; none for points and lines.
    pub fn of(code: u32) -> Result<Option<Self>, ReadError> {
        match code {
            0..=3 => Ok(None),
            4 => Ok(Some(Self::List)),
            5 => Ok(Some(Self::Strip)),
            6 => Ok(Some(Self::Fan)),
            other => Err(malformed(format!("a primitive has the mode {other}, which there is not"))),
        }
    }

    /// Triangles of so many corners, degenerate ones among them.
    fn triangles(self, corners: usize) -> usize {
        match self {
            Self::List => corners / 3,
            Self::Strip | Self::Fan => corners.saturating_sub(2),
        }
    }

    /// The places of a triangle's corners among all.
    fn corners(self, triangle: usize) -> [usize; 3] {
        match self {
            Self::List => [3 * triangle, 3 * triangle + 1, 3 * triangle + 2],
            Self::Strip => [triangle, triangle + 1 + triangle % 2, triangle + 2 - triangle % 2],
            Self::Fan => [triangle + 1, triangle + 2, 0],
        }
    }
}

/// The faces of a primitive with so many vertices, of a file that has `before` faces already. Triangles of strips and fans that repeat a
/// vertex are what such are joined with, and are left out.
pub(super) fn faces(
    mode: Mode,
    indices: Option<&Accessor<'_>>,
    vertices: usize,
    before: u64,
    limits: &Limits,
) -> Result<Vec<[u32; 3]>, ReadError> {
    if let Some(indices) = indices
        && (indices.width != 1 || !matches!(indices.component, Component::U8 | Component::U16 | Component::U32))
    {
        return Err(malformed("a primitive has indices that are no whole numbers"));
    }
    let corners = indices.map_or(vertices, |indices| indices.count);
    let triangles = mode.triangles(corners);
    limits.check_faces(before + triangles as u64)?;
    let corner = |number: usize| match indices {
        #[expect(clippy::cast_possible_truncation, reason = "an accessor counts in 32 bits")]
        None => Ok(number as u32),
        Some(indices) => {
            let [vertex] = indices.wholes::<1>(number);
            if vertex as usize >= vertices || vertex == indices.component.restart() {
                return Err(out_of_range(indices, number, vertex, vertices));
            }
            Ok(vertex)
        }
    };
    let mut faces = Vec::with_capacity(triangles);
    for triangle in 0..triangles {
        let [a, b, c] = mode.corners(triangle);
        let face = [corner(a)?, corner(b)?, corner(c)?];
        if mode == Mode::List || (face[0] != face[1] && face[1] != face[2] && face[2] != face[0]) {
            faces.push(face);
        }
    }
    Ok(faces)
}

#[cold]
fn out_of_range(indices: &Accessor<'_>, number: usize, vertex: u32, vertices: usize) -> ReadError {
    let detail = if vertex == indices.component.restart() {
        format!("an index is {vertex}, the largest of its type, which glTF forbids; export the model again")
    } else {
        format!("a face names vertex {vertex}, and its primitive has {vertices}; export the model again")
    };
    ReadError { place: indices.place(number), ..ReadError::whole(ReadErrorKind::IndexOutOfRange, detail) }
}

/// The vertices that faces name, renumbered in ascending order.
pub(super) enum Used {
    /// Every vertex; the value is their count.
    All(u32),
    /// These vertices, in ascending order.
    Some(Vec<u32>),
}

impl Used {
    /// Finds those of `vertices` that `corners` name. With at least as many corners as vertices, it takes all of them.
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

    pub fn len(&self) -> usize {
        match self {
            Self::All(all) => *all as usize,
            Self::Some(some) => some.len(),
        }
    }

    pub fn iter(&self) -> impl Iterator<Item = u32> {
        let (all, some) = match self {
            Self::All(all) => (0..*all, &[][..]),
            Self::Some(some) => (0..0, &some[..]),
        };
        all.chain(some.iter().copied())
    }

    /// The new number of a used vertex.
    pub fn rank(&self, vertex: u32) -> u32 {
        match self {
            Self::All(_) => vertex,
            #[expect(clippy::cast_possible_truncation, reason = "no longer than 32 bits can number")]
            Self::Some(some) => some.binary_search(&vertex).unwrap_or_default() as u32,
        }
    }
}
