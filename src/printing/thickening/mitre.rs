//! Mitres: the offset of a vertex that puts it on the offset planes of the faces around it.

use glam::DVec3;

/// The most projections onto all planes.
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
/// Cyclic projections onto the planes (Kaczmarz 1937) find a near shortest offset. Where the planes allow none, the
/// neighbours' planes are given up.
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

fn project(planes: &[Plane]) -> DVec3 {
    let mut offset = DVec3::ZERO;
    for _ in 0..ROUNDS {
        let before = offset;
        // Neighbours first, so that the tops have the last word.
        for plane in planes.iter().filter(|plane| !plane.is_top) {
            let off = plane.normal.dot(offset) - plane.distance;
            if off > 0.0 || plane.distance == 0.0 {
                offset -= plane.normal * off;
            }
        }
        for plane in planes.iter().filter(|plane| plane.is_top) {
            let off = plane.distance - plane.normal.dot(offset);
            if off > 0.0 {
                offset += plane.normal * off;
            }
        }
        if offset == before {
            break;
        }
    }
    offset
}
