//! Shape statistics: face areas, aspect ratios, edge lengths and dihedral angles.

use std::f64::consts::{PI, TAU};

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::distribution::power_of_two;
use super::{Analysis, Attributes, Bins, Distribution, OrientationCounts, Unmeasurable};
use crate::context::{Cancelled, Context};
use crate::math::{Sign, collinear, orient3d, threads};

/// Number of bins for edge angles. An odd number puts flat edges, the most frequent ones, in the middle of a bin. At
/// a bin edge, rounding would scatter them over two bins.
const ANGLE_BINS: usize = 17;

/// Shape statistics of a mesh's faces and edges.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Statistics {
    /// Face areas, in square model units; 0 for a degenerate face.
    pub face_area: Option<Distribution>,
    /// Face aspect ratios: longest edge divided by shortest altitude. The minimum, of an equilateral triangle, is 2 /
    /// sqrt(3), about 1.1547.
    pub face_aspect_ratio: Option<Distribution>,
    /// Number of faces without an aspect ratio: degenerate, or too thin for f64.
    pub faces_without_aspect_ratio: u64,
    /// Edge lengths, in the model's unit.
    pub edge_length: Option<Distribution>,
    /// Dihedral angles at edges with two faces.
    pub edge_angle: EdgeAngles,
}

/// Dihedral angles at edges, measured on the side of the face normals.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct EdgeAngles {
    /// Angles in radians from 0 to 2 pi: pi at a flat edge, 0 where two faces coincide. Angles above pi belong to
    /// edges that are convex as seen from the side of the normals. Excludes boundary edges.
    pub distribution: Option<Distribution>,
    /// Why the distribution is `null`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub not_measurable: Option<Unmeasurable>,
    /// Side to which the normals point; `null` if unknown, for example for an open mesh.
    pub side: Option<Side>,
    /// Number of edges without an angle, because one of their faces is degenerate and has no normal.
    pub edges_without_angle: u64,
}

/// Side on which edge angles were measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// Normals point out of the solid; angles are exterior, 3/2 pi at the edges of a box.
    Exterior,
    /// Normals point into the solid; angles are interior, 1/2 pi at the edges of a box.
    Interior,
    /// The parts have different orientations.
    Mixed,
}

impl Side {
    fn of(orientation: &OrientationCounts) -> Option<Self> {
        match (orientation.outward, orientation.inward, orientation.unknown) {
            (_, _, 1..) | (0, 0, _) => None,
            (_, 0, _) => Some(Self::Exterior),
            (0, _, _) => Some(Self::Interior),
            _ => Some(Self::Mixed),
        }
    }
}

/// Computes shape statistics of a mesh, in linear time.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn statistics(
    analysis: &Analysis<'_>,
    attributes: &Attributes,
    orientation: &OrientationCounts,
    context: &Context<'_>,
) -> Result<Statistics, Cancelled> {
    let length = analysis.unit_length();
    let by_range = |values| Distribution::of(values, Bins::ByRange);
    let of_faces = || {
        let (areas, ratios) = face_values(analysis);
        let without_ratio = (areas.len() - ratios.len()) as u64;
        (by_range(areas).map(|values| values.in_unit(length, 2)), by_range(ratios), without_ratio)
    };
    let of_edges = || by_range(edge_lengths(analysis)).map(|values| values.in_unit(length, 1));
    let ((face_area, face_aspect_ratio, faces_without_aspect_ratio), edge_length) =
        threads::join(analysis.surface.faces.len(), of_faces, of_edges);
    context.check()?;
    let edge_angle = edge_angles(analysis, attributes, orientation);
    context.check()?;
    Ok(Statistics { face_area, face_aspect_ratio, faces_without_aspect_ratio, edge_length, edge_angle })
}

/// Aspect ratio of a face of the analysed surface: longest edge divided by shortest altitude. `None` if the face is
/// degenerate or too thin for f64.
///
/// # Panics
/// If `face` is out of range.
#[must_use]
pub fn aspect_ratio(analysis: &Analysis<'_>, face: u32) -> Option<f64> {
    Shape::of(analysis.unit_corners(face)).aspect_ratio
}

/// Area of each face, and aspect ratio of each face that has one.
fn face_values(analysis: &Analysis<'_>) -> (Vec<f64>, Vec<f64>) {
    let unit = analysis.unit();
    let (areas, mut ratios) = threads::map_pairs(analysis.surface.faces.len(), |face| {
        let Shape { area, aspect_ratio, .. } = Shape::of(analysis.surface.faces[face].map(|v| unit[v as usize]));
        (area, aspect_ratio.unwrap_or(f64::NAN))
    });
    ratios.retain(|ratio| !ratio.is_nan());
    (areas, ratios)
}

fn edge_lengths(analysis: &Analysis<'_>) -> Vec<f64> {
    let unit = analysis.unit();
    let between = |[a, b]: [u32; 2]| {
        let along = unit[b as usize] - unit[a as usize];
        let size = power_of_two(along.abs().max_element());
        (along / size).length() * size
    };
    threads::map_cheap(analysis.edges.len(), |e| between(analysis.edges.vertices(e)))
}

fn edge_angles(analysis: &Analysis<'_>, attributes: &Attributes, orientation: &OrientationCounts) -> EdgeAngles {
    let mut result =
        EdgeAngles { distribution: None, not_measurable: None, side: Side::of(orientation), edges_without_angle: 0 };
    if let Some(reason) = attributes.reason_not_oriented() {
        result.not_measurable = Some(reason);
        return result;
    }
    let (unit, faces, edges) = (analysis.unit(), &analysis.surface.faces, &analysis.edges);
    let corners = |face: usize| faces[face].map(|v| unit[v as usize]);
    // Each normal serves three edges. Zero for a degenerate face, which has no normal.
    let normals = threads::map_cheap(faces.len(), |face| Normal::of(corners(face)).along().unwrap_or(DVec3::ZERO));
    let has_two_faces = |edge: usize| edges.half_edges(edge).len() == 2;
    let at_edge = |edge: usize| {
        let &[h, g] = edges.half_edges(edge) else { return f64::NAN };
        let (face, other) = (h as usize / 3, g as usize / 3);
        let [low, high] = edges.vertices(edge);
        let [n, m] = [normals[face], normals[other]];
        if n == DVec3::ZERO || m == DVec3::ZERO {
            return f64::NAN;
        }
        let opposite = faces[other].iter().find(|&&v| v != low && v != high);
        opposite.map_or(f64::NAN, |&v| angle(corners(face), [n, m], unit[v as usize]))
    };
    let mut angles = threads::map_cheap(edges.len(), at_edge);
    angles.retain(|angle| !angle.is_nan());
    result.edges_without_angle = threads::count(edges.len(), has_two_faces) - angles.len() as u64;
    result.distribution = Distribution::of(angles, Bins::Between(0.0, TAU, ANGLE_BINS));
    result.not_measurable = result.distribution.is_none().then_some(Unmeasurable::NoElement);
    result
}

/// Dihedral angle of two faces that share an edge, of which one has the corners `first`. `n` and `m` are along their normals, and
/// `opposite` is the other face's corner opposite the edge. An exact predicate decides between convex and concave.
fn angle(first: [DVec3; 3], [n, m]: [DVec3; 2], opposite: DVec3) -> f64 {
    let bend = n.cross(m).length().atan2(n.dot(m));
    let [a, b, c] = first;
    match orient3d(a, b, c, opposite) {
        Sign::Positive => (PI + bend).min(TAU),
        Sign::Negative => (PI - bend).max(0.0),
        Sign::Zero if n.dot(m) > 0.0 => PI,
        Sign::Zero => 0.0,
    }
}

/// Shape of a triangle, in coordinates of [`Analysis::unit`].
struct Shape {
    area: f64,
    aspect_ratio: Option<f64>,
}

impl Shape {
    fn of(corners: [DVec3; 3]) -> Self {
        let Normal { doubled, longest_squared, size } = Normal::of(corners);
        let doubled_area = doubled.length();
        let is_known = doubled_area > 0.0;
        Self {
            area: doubled_area / 2.0 * size * size,
            aspect_ratio: is_known.then(|| longest_squared / doubled_area).filter(|ratio| ratio.is_finite()),
        }
    }
}

/// The normal of a triangle that is divided by a power of two near its longest edge.
struct Normal {
    /// A vector along the normal, twice as long as the area; zero for a degenerate triangle.
    doubled: DVec3,
    /// The square of the longest edge.
    longest_squared: f64,
    /// The power of two.
    size: f64,
}

impl Normal {
    /// Computes the normal from the two shorter edges, which loses least precision.
    fn of([a, b, c]: [DVec3; 3]) -> Self {
        let edges = [b - a, c - b, a - c];
        let largest = edges.iter().fold(0.0f64, |m, e| m.max(e.abs().max_element()));
        if largest == 0.0 {
            return Self { doubled: DVec3::ZERO, longest_squared: 0.0, size: 0.0 };
        }
        let size = power_of_two(largest);
        // As exact as a division.
        let inverse = 1.0 / size;
        let edges = edges.map(|e| e * inverse);
        let squares = edges.map(DVec3::length_squared);
        let longest = if squares[0] >= squares[1] && squares[0] >= squares[2] {
            0
        } else if squares[1] >= squares[2] {
            1
        } else {
            2
        };
        let doubled = edges[(longest + 1) % 3].cross(edges[(longest + 2) % 3]);
        // Below this ratio, only an exact predicate distinguishes a thin face from a degenerate one.
        let is_thin = doubled.length_squared() <= (1e-12 * squares[longest]).powi(2);
        let is_degenerate = is_thin && collinear(a, b, c);
        Self { doubled: if is_degenerate { DVec3::ZERO } else { doubled }, longest_squared: squares[longest], size }
    }

    /// A vector along the normal that is neither very long nor very short; `None` for a face without a normal.
    fn along(&self) -> Option<DVec3> {
        let largest = self.doubled.abs().max_element();
        (largest > 0.0).then(|| self.doubled / power_of_two(largest))
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, SQRT_2};
    use std::sync::atomic::AtomicBool;
    use std::time::Duration;

    use super::*;
    use crate::context::NoProgress;
    use crate::inspect::{Answer, measures, shells};
    use crate::mesh::Soup;

    fn of(positions: &[DVec3], faces: &[[u32; 3]]) -> Statistics {
        let soup = Soup { positions: positions.to_vec(), faces: faces.to_vec() };
        let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::MAX);
        let analysis = Analysis::new((&soup).into(), &context).unwrap();
        let (_, orientation) = shells(&analysis, &context).unwrap();
        let attributes = Attributes::new(&measures(&analysis, &context).unwrap(), &orientation);
        statistics(&analysis, &attributes, &orientation, &context).unwrap()
    }

    const CORNER: [DVec3; 4] = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
    const TETRAHEDRON: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];

    /// A unit box with 12 outward-facing triangles.
    fn unit_box() -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let positions =
            (0..8).map(|i| DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2))).collect();
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        (positions, quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect())
    }

    fn turned(faces: &[[u32; 3]]) -> Vec<[u32; 3]> {
        faces.iter().map(|&[a, b, c]| [a, c, b]).collect()
    }

    #[track_caller]
    fn assert_near(found: f64, expected: f64) {
        assert!((found - expected).abs() <= 1e-12 * expected.abs().max(1.0), "{found} is not {expected}");
    }

    #[test]
    fn statistics_of_a_cube_corner_match_hand_computed_values() {
        let stats = of(&CORNER, &TETRAHEDRON);
        let (area, ratio, length) =
            (stats.face_area.unwrap(), stats.face_aspect_ratio.unwrap(), stats.edge_length.unwrap());
        assert_eq!((area.count, area.min, area.median), (4, 0.5, 0.5));
        assert_near(area.max, 3f64.sqrt() / 2.0);
        assert_near(area.mean, (1.5 + 3f64.sqrt() / 2.0) / 4.0);
        // Three right triangles with an altitude of 1 / sqrt(2) on an edge of sqrt(2), and an equilateral one.
        assert_near(ratio.max, 2.0);
        assert_near(ratio.min, 2.0 / 3f64.sqrt());
        assert_eq!((length.count, length.min, length.max), (6, 1.0, SQRT_2));
        assert_near(length.median, f64::midpoint(1.0, SQRT_2));
        assert_near(length.variance, ((SQRT_2 - 1.0) / 2.0).powi(2));
        let angle = stats.edge_angle.distribution.unwrap();
        assert_eq!((angle.count, stats.edge_angle.side), (6, Some(Side::Exterior)));
        assert_near(angle.max, TAU - (1.0 / 3f64.sqrt()).acos());
        assert_near(angle.min, 1.5 * PI);
    }

    #[test]
    fn box_angles_are_exterior_if_outward_and_interior_if_inward() {
        let (positions, faces) = unit_box();
        let stats = of(&positions, &faces).edge_angle;
        let angles = stats.distribution.unwrap();
        assert_eq!((stats.side, stats.not_measurable), (Some(Side::Exterior), None));
        assert_eq!((angles.count, angles.min, angles.max), (18, PI, PI + FRAC_PI_2));
        // Flat edges are in the middle bin of 17.
        assert_eq!((angles.histogram.counts[8], angles.histogram.counts[12]), (6, 12));
        let stats = of(&positions, &turned(&faces)).edge_angle;
        let angles = stats.distribution.unwrap();
        assert_eq!((stats.side, angles.min, angles.max), (Some(Side::Interior), FRAC_PI_2, PI));
        assert_eq!((angles.histogram.counts[8], angles.histogram.counts[4]), (6, 12));
    }

    #[test]
    fn boundary_edges_have_no_angle_and_an_open_mesh_has_no_side() {
        let (positions, faces) = unit_box();
        let stats = of(&positions, &faces[..10]).edge_angle;
        // Four of the 17 remaining edges bound the hole.
        assert_eq!(stats.distribution.unwrap().count, 13);
        assert_eq!(stats.side, None);
    }

    #[test]
    fn angles_of_a_non_manifold_or_inconsistent_mesh_give_a_reason() {
        let positions = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z, DVec3::NEG_Y];
        let stats = of(&positions, &[[0, 1, 2], [1, 0, 3], [0, 1, 4]]).edge_angle;
        assert_eq!((stats.distribution, stats.not_measurable), (None, Some(Unmeasurable::NotManifold)));
        let stats = of(&positions, &[[0, 1, 2], [0, 1, 3]]).edge_angle;
        assert_eq!((stats.distribution, stats.not_measurable), (None, Some(Unmeasurable::NotConsistent)));
        let stats = of(&positions, &[[0, 1, 2]]).edge_angle;
        assert_eq!((stats.distribution, stats.not_measurable), (None, Some(Unmeasurable::NoElement)));
    }

    #[test]
    fn slight_dents_and_ridges_are_on_different_sides_of_flat() {
        let fold = |height: f64| {
            let positions = [DVec3::ZERO, DVec3::X, DVec3::new(0.5, 1.0, 0.0), DVec3::new(0.5, -1.0, height)];
            of(&positions, &[[0, 1, 2], [1, 0, 3]]).edge_angle.distribution.unwrap().min
        };
        assert_eq!(fold(0.0), PI);
        assert!(fold(1e-9) < PI && fold(-1e-9) > PI);
        assert_near(fold(1.0), PI - PI / 4.0);
        assert_near(fold(-1.0), PI + PI / 4.0);
    }

    #[test]
    fn coincident_faces_have_the_angle_zero() {
        let positions = [DVec3::ZERO, DVec3::X, DVec3::new(0.5, 1.0, 0.0), DVec3::new(0.4, 0.9, 0.0)];
        assert_eq!(of(&positions, &[[0, 1, 2], [1, 0, 3]]).edge_angle.distribution.unwrap().min, 0.0);
    }

    #[test]
    fn degenerate_faces_have_no_aspect_ratio_area_or_angle() {
        // Collinear points whose coordinates are inexact in f64, and one point an ulp off their line.
        let d = DVec3::new(0.1, 0.3, 0.7);
        let off = DVec3::new(d.x * 4.0, d.y * 4.0, f64::from_bits((d.z * 4.0).to_bits() + 1));
        let positions = [d, d * 2.0, d * 4.0, DVec3::X, off];
        let stats = of(&positions, &[[0, 1, 2], [1, 0, 3], [0, 0, 3]]);
        assert_eq!((stats.faces_without_aspect_ratio, stats.face_aspect_ratio.unwrap().count), (2, 1));
        let area = stats.face_area.unwrap();
        assert_eq!((area.count, area.min, area.median), (3, 0.0, 0.0));
        assert_eq!(stats.edge_angle.edges_without_angle, 1);
        let stats = of(&positions, &[[0, 1, 4]]);
        assert_eq!(stats.faces_without_aspect_ratio, 0);
        assert!(stats.face_aspect_ratio.unwrap().min > 1e12);
    }

    #[test]
    fn scaling_by_a_power_of_two_is_exact_and_keeps_angles() {
        let (positions, faces) = unit_box();
        let odd: Vec<DVec3> = positions.iter().map(|p| DVec3::new(p.x * 0.7, p.y + p.x * 0.1, p.z * 1.3)).collect();
        let given = of(&odd, &faces);
        for scale in [2f64.powi(40), 2f64.powi(-40)] {
            let scaled: Vec<DVec3> = odd.iter().map(|p| *p * scale).collect();
            let stats = of(&scaled, &faces);
            assert_eq!(stats.face_area, given.face_area.clone().map(|area| area.in_unit(scale, 2)));
            assert_eq!(stats.edge_length, given.edge_length.clone().map(|length| length.in_unit(scale, 1)));
            assert_eq!((&stats.face_aspect_ratio, &stats.edge_angle), (&given.face_aspect_ratio, &given.edge_angle));
        }
    }

    #[test]
    fn coordinates_of_any_magnitude_give_finite_statistics() {
        let (positions, faces) = unit_box();
        for scale in [1e300, 1e-300, f64::MAX, f64::MIN_POSITIVE] {
            let scaled: Vec<DVec3> = positions.iter().map(|p| *p * scale).collect();
            let stats = of(&scaled, &faces);
            let (area, length) = (stats.face_area.unwrap(), stats.edge_length.unwrap());
            assert!([area.min, area.max, area.mean, area.variance, length.variance].iter().all(|x| x.is_finite()));
            assert_near(length.min / scale, 1.0);
            assert_near(stats.face_aspect_ratio.unwrap().max, 2.0);
            assert_eq!(stats.edge_angle.distribution.unwrap().max, 1.5 * PI);
        }
    }

    #[test]
    fn a_needle_beside_a_large_face_keeps_its_shape() {
        let tiny = 1e-80;
        let positions = [DVec3::ZERO, DVec3::X * tiny, DVec3::Y * tiny, DVec3::X, DVec3::Y, DVec3::Z];
        let stats = of(&positions, &[[0, 1, 2], [3, 4, 5]]);
        let (ratio, length) = (stats.face_aspect_ratio.unwrap(), stats.edge_length.unwrap());
        assert_near(ratio.max, 2.0);
        assert_near(length.min / tiny, 1.0);
        assert_near(stats.face_area.unwrap().min / tiny / tiny, 0.5);
    }

    #[test]
    fn attributes_are_not_measurable_without_their_prerequisites() {
        let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::MAX);
        let of = |faces: &[[u32; 3]]| {
            let mut positions = CORNER.to_vec();
            positions.extend([DVec3::NEG_Y, DVec3::NEG_X, DVec3::NEG_Z]);
            let soup = Soup { positions, faces: faces.to_vec() };
            let analysis = Analysis::new((&soup).into(), &context).unwrap();
            let (_, orientation) = shells(&analysis, &context).unwrap();
            let stats = Attributes::new(&measures(&analysis, &context).unwrap(), &orientation);
            [stats.closed, stats.manifold, stats.consistent, stats.outward]
        };
        use Answer::{No, NotMeasurable, Yes};
        assert_eq!(of(&TETRAHEDRON), [Yes, Yes, Yes, Yes]);
        assert_eq!(of(&turned(&TETRAHEDRON)), [Yes, Yes, Yes, No]);
        assert_eq!(of(&TETRAHEDRON[..3]), [No, Yes, Yes, NotMeasurable]);
        let mut one_flipped = TETRAHEDRON;
        one_flipped[0].swap(0, 1);
        assert_eq!(of(&one_flipped), [Yes, Yes, No, NotMeasurable]);
        // Two tetrahedra on one edge are closed, since every edge has at least two faces, but not manifold.
        let two = [TETRAHEDRON.to_vec(), vec![[0, 3, 4], [0, 4, 5], [3, 5, 4], [0, 5, 3]]].concat();
        assert_eq!(of(&two), [Yes, No, NotMeasurable, NotMeasurable]);
    }
}
