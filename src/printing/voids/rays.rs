//! Rays through the regions of a surface.

use glam::DVec3;

use super::regions::{NO_REGION, OUTSIDE, Regions};
use crate::math::{Crossing, Tree, crossing, ray_direction, to_unit_range, unit_scale};
use crate::mesh::Surface;

/// Rays that are tried to find the region of a point, and their length on the unit scale, which leaves the model.
const ATTEMPTS: u32 = 8;
const RAY_LENGTH: f64 = 8.0;

/// A surface prepared for rays, on the unit scale.
pub(crate) struct RegionRays<'a> {
    regions: &'a Regions,
    faces: &'a [[u32; 3]],
    /// Positions on the unit scale.
    pub unit: Vec<DVec3>,
    /// The factor from the model's unit to the unit scale.
    pub scale: f64,
    tree: Tree,
}

/// A face that a ray passes through.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Passage {
    /// Distance from the ray's start.
    pub distance: f64,
    pub face: u32,
    /// The region before the face and the one behind it.
    pub from: u32,
    pub to: u32,
}

impl<'a> RegionRays<'a> {
    /// Prepares the rays; `regions` must belong to the surface.
    pub fn new(surface: &'a Surface, regions: &'a Regions) -> Self {
        let unit = to_unit_range(&surface.positions);
        let tree = Tree::new(&unit, &surface.faces);
        Self { regions, faces: &surface.faces, scale: unit_scale(&surface.positions), unit, tree }
    }

    /// The region of a point on the unit scale, by rays. `None` if every ray touches an edge.
    pub fn region_at(&self, point: DVec3) -> Option<u32> {
        let hits =
            (0..ATTEMPTS).find_map(|attempt| self.along([point, point + ray_direction(attempt) * RAY_LENGTH], None))?;
        Some(hits.first().map_or(OUTSIDE, |hit| hit.from))
    }

    /// The corners of a face, on the unit scale.
    pub fn corners(&self, face: u32) -> [DVec3; 3] {
        self.faces[face as usize].map(|v| self.unit[v as usize])
    }

    /// The unit normal of a face; zero if it has no area.
    pub fn normal(&self, face: u32) -> DVec3 {
        let [a, b, c] = self.corners(face);
        (b - a).cross(c - a).normalize_or_zero()
    }

    /// The faces between two regions that a segment passes through, in order, `except` apart. `None` if the segment
    /// touches an edge, or if the order is uncertain.
    pub fn along(&self, [from, to]: [DVec3; 2], except: Option<u32>) -> Option<Vec<Passage>> {
        let (mut passages, mut clear) = (Vec::new(), true);
        let length = from.distance(to);
        self.tree.along(from, to, |face| {
            let [front, behind] = self.regions.beside(face);
            if Some(face) == except || front == behind || front == NO_REGION {
                return true;
            }
            let corners = self.corners(face);
            let found = crossing(from, to, corners);
            let (from_region, to_region) = match found {
                Crossing::Miss => return true,
                Crossing::Touches => {
                    clear = false;
                    return false;
                }
                Crossing::Enters => (front, behind),
                Crossing::Leaves => (behind, front),
            };
            let [a, b, c] = corners;
            let normal = (b - a).cross(c - a);
            let distance = length * (normal.dot(a - from) / normal.dot(to - from)).clamp(0.0, 1.0);
            passages.push(Passage { distance, face, from: from_region, to: to_region });
            true
        });
        passages.sort_by(|a, b| a.distance.total_cmp(&b.distance).then(a.face.cmp(&b.face)));
        let is_chain = passages.windows(2).all(|pair| pair[0].to == pair[1].from);
        (clear && is_chain).then_some(passages)
    }
}
