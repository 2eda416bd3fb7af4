//! Mitres: the offset of a vertex that puts it on the offset planes of the faces around it.

use glam::DVec3;
use smallvec::{SmallVec, smallvec};

/// The most rounds over all planes, for the shortest offset and again to reach all tops.
const ROUNDS: usize = 64;
/// The longest offset, relative to the largest distance of a top.
const LONGEST: f64 = 2.5;
/// Relative error of distances that is accepted.
const ENOUGH: f64 = 1e-4;

/// A plane that bounds an offset.
#[derive(Debug, Clone, Copy)]
pub struct Plane {
    /// Unit normal.
    pub normal: DVec3,
    /// Distance from the vertex along the normal, in the model's unit.
    pub distance: f64,
    /// Whether this is the plane of a top: the offset reaches the plane or goes beyond. Otherwise it is the plane of a
    /// neighbour: the offset stays in the plane if the distance is 0, and behind it if the distance is negative.
    pub is_top: bool,
}

/// The offset of a vertex: on or beyond the planes of tops, and as far as possible within those of neighbours.
///
/// The shortest such offset, but for rounding and at most a few thousandths of the largest distance. Where the planes allow
/// none, the neighbours' planes are given up.
pub fn mitre(planes: &[Plane]) -> DVec3 {
    let most = planes.iter().filter(|plane| plane.is_top).map(|plane| plane.distance).fold(0.0, f64::max);
    let is_fit = |offset: DVec3| offset.length() <= LONGEST * most && lack(planes, offset) <= ENOUGH * most;
    let offset = project(planes);
    if is_fit(offset) {
        return offset;
    }
    let tops: Vec<Plane> = planes.iter().copied().filter(|plane| plane.is_top).collect();
    let offset = project(&tops);
    if is_fit(offset) {
        return offset;
    }
    offset * (LONGEST * most / offset.length().max(f64::MIN_POSITIVE)).min(1.0)
}

/// How far an offset stays below a top, at most.
fn lack(planes: &[Plane], offset: DVec3) -> f64 {
    let tops = planes.iter().filter(|plane| plane.is_top);
    tops.map(|plane| plane.distance - plane.normal.dot(offset)).fold(0.0, f64::max)
}

/// The shortest offset within all planes, by coordinate ascent on their multipliers (Hildreth 1957). It can end before the
/// tops are reached; cyclic projections onto the planes (Kaczmarz 1937) then reach them, a little beyond where needed.
fn project(planes: &[Plane]) -> DVec3 {
    let mut offset = DVec3::ZERO;
    let mut multipliers: SmallVec<[f64; 8]> = smallvec![0.0; planes.len()];
    let mut rounds = |is_shortest: bool| {
        for _ in 0..ROUNDS {
            let before = offset;
            // Neighbours first, so that the tops have the last word.
            for is_top in [false, true] {
                let of_kind = planes.iter().zip(&mut multipliers).filter(|(plane, _)| plane.is_top == is_top);
                for (plane, multiplier) in of_kind {
                    // How far the offset must move along the normal, and the way back to where the plane has no effect.
                    let (step, back) = (plane.distance - plane.normal.dot(offset), -*multiplier);
                    let back = if is_shortest { back } else { 0.0 };
                    let step = match (plane.is_top, plane.distance == 0.0) {
                        (true, _) => step.max(back),
                        (false, false) => step.min(back),
                        (false, true) => step,
                    };
                    offset += plane.normal * step;
                    *multiplier += step;
                }
            }
            if offset == before {
                break;
            }
        }
    };
    rounds(true);
    rounds(false);
    offset
}

#[cfg(test)]
mod tests {
    use super::*;

    fn top(x: f64, y: f64, z: f64) -> Plane {
        Plane { normal: DVec3::new(x, y, z).normalize(), distance: 1.0, is_top: true }
    }

    #[test]
    fn a_corner_moves_to_where_the_moved_planes_meet_and_no_farther() {
        for degrees in [5.0f64, 30.0, 60.0, 90.0, 120.0] {
            let (sin, cos) = degrees.to_radians().sin_cos();
            let planes =
                [top(1.0, 0.0, 0.0), top(cos, sin, 0.0), Plane { distance: 0.0, is_top: false, ..top(0.0, 0.0, 1.0) }];
            let shortest = 1.0 / (degrees.to_radians() / 2.0).cos();
            let offset = mitre(&planes);
            assert!(offset.z.abs() < 1e-9 && lack(&planes, offset) <= ENOUGH, "{degrees}: {offset}");
            assert!((offset.length() / shortest - 1.0).abs() < 4e-3, "{degrees}: {offset}");
        }
    }

    #[test]
    fn a_plane_that_another_one_hides_does_not_lengthen_the_offset() {
        let planes = [
            Plane { distance: 0.2, ..top(1.0, 0.0, 0.0) },
            top(1.0, 1.0, 0.0),
            Plane { distance: 0.1, ..top(0.0, 1.0, 0.0) },
        ];
        assert!((mitre(&planes) - planes[1].normal).length() < 1e-9);
    }
}
