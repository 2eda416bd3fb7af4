use glam::DVec3;

use super::{Sign, orient3d};

/// How far beside a triangle, as a share of it, a segment may pass and still meet it: more than weights are rounded.
const EDGE: f64 = 1e-12;

/// How a segment meets a triangle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Crossing {
    /// Not at all.
    Miss,
    /// Through the inside, entering the solid: against the triangle's normal.
    Enters,
    /// Through the inside, leaving the solid: along the triangle's normal.
    Leaves,
    /// It touches the border, an end lies in the plane, or the triangle has no area: ask with another segment.
    Touches,
}

/// How the segment from `p` to `q` meets the triangle, by the signs of five tetrahedra, exactly.
///
/// The points must be in the range of [`super::to_unit_range`].
#[must_use]
pub fn crossing(p: DVec3, q: DVec3, [a, b, c]: [DVec3; 3]) -> Crossing {
    let (sp, sq) = (orient3d(a, b, c, p), orient3d(a, b, c, q));
    if sp == sq && sp != Sign::Zero {
        return Crossing::Miss;
    }
    let edges = [orient3d(p, q, a, b), orient3d(p, q, b, c), orient3d(p, q, c, a)];
    if edges.contains(&Sign::Positive) && edges.contains(&Sign::Negative) {
        return Crossing::Miss;
    }
    if edges.contains(&Sign::Zero) || !sp.opposes(sq) {
        return Crossing::Touches;
    }
    // `orient3d` is positive behind the face.
    if sp == Sign::Negative { Crossing::Enters } else { Crossing::Leaves }
}

/// How far along a segment from `origin` by `step` a triangle is, as a share of `step`, where it meets it (Moeller and
/// Trumbore 1997). A segment through an edge that two triangles share meets at least one of them. In f64: a measure, not a
/// decision of topology.
#[must_use]
pub fn hit(origin: DVec3, step: DVec3, [a, b, c]: [DVec3; 3]) -> Option<f64> {
    let (e, f) = (b - a, c - a);
    let p = step.cross(f);
    let determinant = e.dot(p);
    if determinant == 0.0 {
        return None;
    }
    let s = origin - a;
    let u = s.dot(p) / determinant;
    if !(-EDGE..=1.0 + 3.0 * EDGE).contains(&u) {
        return None;
    }
    let q = s.cross(e);
    let v = step.dot(q) / determinant;
    let t = f.dot(q) / determinant;
    (v >= -EDGE && u + v <= 1.0 + EDGE && (0.0..=1.0).contains(&t)).then_some(t)
}

/// The directions in which rays are tried, one after another: unit vectors that no designed surface is aligned with.
#[must_use]
pub fn ray_direction(attempt: u32) -> DVec3 {
    // Irrational steps spread points evenly on the sphere (the golden-angle spiral, with an irrational height).
    let i = f64::from(attempt) + 1.0;
    let z = (i * std::f64::consts::SQRT_2 + 0.123_456_789).fract() * 1.9 - 0.95;
    let angle = i * 2.399_963_229_728_653;
    let r = (1.0 - z * z).sqrt();
    DVec3::new(r * angle.cos(), r * angle.sin(), z)
}

#[cfg(test)]
mod tests {
    use super::*;

    const FACE: [DVec3; 3] = [DVec3::ZERO, DVec3::X, DVec3::Y];

    #[test]
    fn a_segment_through_the_inside_enters_against_the_normal() {
        let (above, below) = (DVec3::new(0.25, 0.25, 1.0), DVec3::new(0.25, 0.25, -1.0));
        assert_eq!(crossing(above, below, FACE), Crossing::Enters);
        assert_eq!(crossing(below, above, FACE), Crossing::Leaves);
    }

    #[test]
    fn a_segment_through_an_edge_touches() {
        assert_eq!(crossing(DVec3::new(0.5, 0.0, 1.0), DVec3::new(0.5, 0.0, -1.0), FACE), Crossing::Touches);
    }

    #[test]
    fn a_segment_that_passes_by_or_ends_before_misses() {
        assert_eq!(crossing(DVec3::new(2.0, 2.0, 1.0), DVec3::new(2.0, 2.0, -1.0), FACE), Crossing::Miss);
        assert_eq!(crossing(DVec3::new(0.25, 0.25, 2.0), DVec3::new(0.25, 0.25, 1.0), FACE), Crossing::Miss);
    }

    #[test]
    fn a_segment_that_starts_on_the_face_touches() {
        assert_eq!(crossing(DVec3::new(0.25, 0.25, 0.0), DVec3::new(0.25, 0.25, 1.0), FACE), Crossing::Touches);
    }

    #[test]
    fn a_hit_tells_how_far_along_it_is() {
        let above = DVec3::new(0.25, 0.25, 1.0);
        assert_eq!(hit(above, DVec3::NEG_Z * 4.0, FACE), Some(0.25));
        for miss in [DVec3::NEG_Z * 0.5, DVec3::Z, DVec3::X, DVec3::new(1.0, 1.0, -1.0)] {
            assert_eq!(hit(above, miss, FACE), None, "{miss}");
        }
    }

    #[test]
    fn directions_have_unit_length_and_differ() {
        for i in 0..32 {
            assert!((ray_direction(i).length() - 1.0).abs() < 1e-12);
            assert!(ray_direction(i).dot(ray_direction(i + 1)) < 0.999);
        }
    }
}
