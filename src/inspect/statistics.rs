use std::f64::consts::{PI, TAU};

use glam::DVec3;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{Analysis, Attributes, Bins, Distribution, Turning, Unmeasurable};
use crate::context::{Cancelled, Context};
use crate::math::{Sign, collinear, orient3d};

/// Elements between two looks at the clock.
const STRIDE: usize = 1 << 16;
/// Bins of edge angles. An odd number, so that flat edges, of which most meshes are full, stand in the middle of a
/// bin and not on a border, where rounding would throw them to either side.
const ANGLE_BINS: usize = 17;

/// How the faces and edges of a mesh are shaped.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Statistics {
    /// Areas of the faces, in square units; 0 for a degenerate face.
    pub face_area: Option<Distribution>,
    /// Aspect ratios of the faces: the longest edge over the shortest altitude. The least is that of an equilateral
    /// triangle, 2 / sqrt(3), about 1.1547.
    pub face_aspect_ratio: Option<Distribution>,
    /// Faces that have no aspect ratio: degenerate, or thinner than f64 can tell.
    pub faces_without_aspect_ratio: u64,
    /// Lengths of the edges.
    pub edge_length: Option<Distribution>,
    /// Angles at the edges between two faces.
    pub edge_angle: EdgeAngles,
}

/// Angles between the two faces of an edge, measured on the side that their normals look to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct EdgeAngles {
    /// The angles in radians, from 0 to 2 pi: pi where the surface is flat, above pi where it is convex seen from the
    /// side of the normals, 0 where two faces lie on each other. Boundary edges have none.
    pub distribution: Option<Distribution>,
    /// Why there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub not_measurable: Option<Unmeasurable>,
    /// The side that the normals look to; none where it is not known, as for an open mesh.
    pub side: Option<Side>,
    /// Edges of a degenerate face, which has no normal; they have no angle.
    pub edges_without_angle: u64,
}

/// Which angles were measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// Normals look out of the solid: angles are exterior, 3/2 pi at the edges of a box.
    Exterior,
    /// Normals look into the solid: angles are interior, 1/2 pi at the edges of a box.
    Interior,
    /// Parts differ.
    Mixed,
}

impl Side {
    fn of(turning: &Turning) -> Option<Self> {
        match (turning.outward, turning.inward, turning.unknown) {
            (_, _, 1..) | (0, 0, _) => None,
            (_, 0, _) => Some(Self::Exterior),
            (0, _, _) => Some(Self::Interior),
            _ => Some(Self::Mixed),
        }
    }
}

/// Describes the faces and edges of a mesh. O(n log n) for sorting the values.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn statistics(
    analysis: &Analysis<'_>,
    attributes: &Attributes,
    turning: &Turning,
    context: &Context<'_>,
) -> Result<Statistics, Cancelled> {
    let length = analysis.unit_length();
    let (areas, ratios) = face_values(analysis, context)?;
    let faces_without_aspect_ratio = (areas.len() - ratios.len()) as u64;
    let face_area = Distribution::of(areas, Bins::ByRange).map(|it| it.in_unit(length, 2));
    context.check()?;
    let face_aspect_ratio = Distribution::of(ratios, Bins::ByRange);
    context.check()?;
    let edge_length = Distribution::of(edge_lengths(analysis), Bins::ByRange).map(|it| it.in_unit(length, 1));
    context.check()?;
    let edge_angle = edge_angles(analysis, attributes, turning, context)?;
    Ok(Statistics { face_area, face_aspect_ratio, faces_without_aspect_ratio, edge_length, edge_angle })
}

/// The aspect ratio of a face of an analysed surface: its longest edge over the height on it. None where it is degenerate, or thinner than f64
/// can tell.
///
/// # Panics
/// When `face` is not an index of the surface's faces.
#[must_use]
pub fn aspect_ratio(analysis: &Analysis<'_>, face: u32) -> Option<f64> {
    Shape::of(analysis.unit_corners(face)).aspect_ratio
}

/// The area of each face, and the aspect ratio of each face that has one.
fn face_values(analysis: &Analysis<'_>, context: &Context<'_>) -> Result<(Vec<f64>, Vec<f64>), Cancelled> {
    let (unit, faces) = (analysis.unit(), &analysis.surface.faces);
    let mut areas = Vec::with_capacity(faces.len());
    let mut ratios = Vec::with_capacity(faces.len());
    for some in faces.chunks(STRIDE) {
        context.check()?;
        for face in some {
            let shape = Shape::of(face.map(|v| unit[v as usize]));
            areas.push(shape.area);
            ratios.extend(shape.aspect_ratio);
        }
    }
    Ok((areas, ratios))
}

fn edge_lengths(analysis: &Analysis<'_>) -> Vec<f64> {
    let unit = analysis.unit();
    let between = |[a, b]: [u32; 2]| {
        let along = unit[b as usize] - unit[a as usize];
        let size = power_of_two(along.abs().max_element());
        (along / size).length() * size
    };
    (0..analysis.edges.len()).map(|e| between(analysis.edges.vertices(e))).collect()
}

fn edge_angles(
    analysis: &Analysis<'_>,
    attributes: &Attributes,
    turning: &Turning,
    context: &Context<'_>,
) -> Result<EdgeAngles, Cancelled> {
    let mut it =
        EdgeAngles { distribution: None, not_measurable: None, side: Side::of(turning), edges_without_angle: 0 };
    if let Some(why) = attributes.why_not_oriented() {
        it.not_measurable = Some(why);
        return Ok(it);
    }
    let (unit, faces, edges) = (analysis.unit(), &analysis.surface.faces, &analysis.edges);
    let mut angles = Vec::with_capacity(edges.len());
    for (e, half_edges) in edges.iter().enumerate() {
        if e % STRIDE == 0 {
            context.check()?;
        }
        let &[h, g] = half_edges else { continue };
        let corners = |h: u32| faces[h as usize / 3].map(|v| unit[v as usize]);
        let [low, high] = edges.vertices(e);
        let opposite = faces[g as usize / 3].iter().find(|&&v| v != low && v != high);
        let angle = opposite.and_then(|&v| angle(corners(h), corners(g), unit[v as usize]));
        match angle {
            Some(angle) => angles.push(angle),
            None => it.edges_without_angle += 1,
        }
    }
    it.distribution = Distribution::of(angles, Bins::Between(0.0, TAU, ANGLE_BINS));
    it.not_measurable = it.distribution.is_none().then_some(Unmeasurable::NoElement);
    Ok(it)
}

/// The angle between two faces of which the second has the corner `opposite` across the edge that they share; none
/// where one of them is degenerate. On which side of flat it is, is decided exactly.
fn angle(first: [DVec3; 3], second: [DVec3; 3], opposite: DVec3) -> Option<f64> {
    let (n, m) = (Shape::of(first).normal?, Shape::of(second).normal?);
    let bend = n.cross(m).length().atan2(n.dot(m));
    let [a, b, c] = first;
    Some(match orient3d(a, b, c, opposite) {
        Sign::Positive => (PI + bend).min(TAU),
        Sign::Negative => (PI - bend).max(0.0),
        Sign::Zero if n.dot(m) > 0.0 => PI,
        Sign::Zero => 0.0,
    })
}

/// The shape of a triangle in coordinates of [`Analysis::unit`].
struct Shape {
    area: f64,
    aspect_ratio: Option<f64>,
    normal: Option<DVec3>,
}

impl Shape {
    const DEGENERATE: Self = Self { area: 0.0, aspect_ratio: None, normal: None };

    /// From the two shorter edges, whose product loses least.
    fn of([a, b, c]: [DVec3; 3]) -> Self {
        let edges = [b - a, c - b, a - c];
        let largest = edges.iter().fold(0.0f64, |m, e| m.max(e.abs().max_element()));
        if largest == 0.0 {
            return Self::DEGENERATE;
        }
        let size = power_of_two(largest);
        let edges = edges.map(|e| e / size);
        let squares = edges.map(DVec3::length_squared);
        let longest = if squares[0] >= squares[1] && squares[0] >= squares[2] {
            0
        } else if squares[1] >= squares[2] {
            1
        } else {
            2
        };
        let doubled = edges[(longest + 1) % 3].cross(edges[(longest + 2) % 3]);
        let doubled_area = doubled.length();
        // Rounding can't bring a face of some height below this share; a face of none has to be told exactly.
        if doubled_area <= 1e-12 * squares[longest] && collinear(a, b, c) {
            return Self::DEGENERATE;
        }
        let known = doubled_area > 0.0;
        Self {
            area: doubled_area / 2.0 * size * size,
            aspect_ratio: known.then(|| squares[longest] / doubled_area).filter(|ratio| ratio.is_finite()),
            normal: known.then(|| doubled / doubled_area),
        }
    }
}

/// The power of two at or below a normal number, to divide by without rounding; 1 for what is not normal.
fn power_of_two(x: f64) -> f64 {
    if x.is_normal() { f64::from_bits(x.to_bits() & 0x7FF0_0000_0000_0000) } else { 1.0 }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests;
