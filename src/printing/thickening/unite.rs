//! The exact union of a layered surface, and the checks of its promises.

use crate::context::{Cancelled, Context};
use crate::mesh::{Edges, Parts, Surface};

/// Computes the boundary of the union of the volumes that a closed surface encloses.
pub trait SelfUnion: Sync {
    /// The boundary of the volume that `surface` winds around outward: closed, manifold by position, without
    /// intersections, with new vertices rounded to the output's precision. No other vertex moves farther than
    /// `max_deviation`. Faces that meet no other face stay as they are, and pieces have the source of their face. None
    /// if there is no such result.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    fn unite(&self, surface: &Surface, max_deviation: f64, context: &Context<'_>)
    -> Result<Option<Surface>, Cancelled>;
}

/// How far rounding may move a vertex, as a share of the least wall.
const MAX_ROUNDING: f64 = 0.01;

/// Why a union is not usable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Broken {
    /// The arrangement or the rounding failed.
    Union,
    /// Parts, cavities or handles changed.
    Topology,
    /// The place stayed thin.
    Rounds,
}

/// The number of parts, and the Euler characteristic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Topology {
    parts: usize,
    euler: i64,
}

impl Topology {
    /// The topology of a surface.
    pub fn of(surface: &Surface) -> Self {
        let edges = Edges::new(&surface.faces);
        let count = |n: usize| i64::try_from(n).unwrap_or(i64::MAX);
        let euler = count(surface.positions.len()) - count(edges.len()) + count(surface.faces.len());
        Self { parts: Parts::new(surface, &edges).count, euler }
    }
}

/// The expectations of a union.
#[derive(Debug, Clone, Copy)]
pub struct Expected {
    /// The topology that the result must have.
    pub topology: Topology,
    /// The least wall, in the model's unit.
    pub min_wall: f64,
    /// The least source of added faces.
    pub first_added: u32,
}

/// The boundary of the union of a solid and its layer.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn united(
    surface: &Surface,
    expected: Expected,
    union: &dyn SelfUnion,
    context: &Context<'_>,
) -> Result<Result<Surface, Broken>, Cancelled> {
    let Some(mut united) = union.unite(surface, MAX_ROUNDING * expected.min_wall, context)? else {
        return Ok(Err(Broken::Union));
    };
    fill_bubbles(&mut united, expected.first_added, expected.min_wall.powi(3));
    Ok(if Topology::of(&united) == expected.topology { Ok(united) } else { Err(Broken::Topology) })
}

/// Removes the closed parts smaller than `most` cubic units that the layer creates: bubbles of air between its prisms, and
/// crumbs of the layer alone. A bubble that held air of the model keeps its faces only if it is larger.
fn fill_bubbles(surface: &mut Surface, first_added: u32, most: f64) {
    let parts = Parts::new(surface, &Edges::new(&surface.faces));
    let origin = surface.bounds().centre();
    let mut volume = vec![0.0; parts.count];
    let mut has_added = vec![false; parts.count];
    let mut has_old = vec![false; parts.count];
    for (face, &part) in parts.of_face.iter().enumerate().filter(|(_, part)| **part != Parts::NONE) {
        let [a, b, c] = surface.corners(face).map(|p| p - origin);
        volume[part as usize] += a.dot(b.cross(c)) / 6.0;
        let is_added = surface.source[face] >= first_added;
        has_added[part as usize] |= is_added;
        has_old[part as usize] |= !is_added;
    }
    let is_bubble = |part: usize| volume[part] <= 0.0 && has_added[part];
    let is_crumb = |part: usize| volume[part] > 0.0 && !has_old[part];
    let is_removed: Vec<bool> =
        (0..parts.count).map(|part| volume[part].abs() < most && (is_bubble(part) || is_crumb(part))).collect();
    if is_removed.contains(&true) {
        parts.remove(&is_removed, surface);
    }
}
