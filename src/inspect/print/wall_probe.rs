//! Wall thickness at a point.

use glam::DVec3;

use crate::inspect::Analysis;
use crate::inspect::sampling::{InsideTest, Sample};
use crate::math::threads::{self, FEW_SEARCHES};
use crate::math::{OppositeFaces, covered, hit};

/// Winding numbers from which a point is in material, and up to which it is in air. Otherwise the surface is too open.
const MATERIAL: f64 = 0.75;
const AIR: f64 = 0.25;
/// Offset from the surface of tests for material and air: a fraction of the diagonal, and at least f64's resolution.
const SIDE_OFFSET: [f64; 2] = [1e-9, 1e-13];
/// Rays ignore faces nearer than this fraction of the diagonal, since these touch the ray's own face.
const TOUCHING: f64 = 1e-6;
/// Cosine of 30 degrees: two faces form a wall if they point away from each other to within this angle. Excludes the
/// edges of a box, where faces are near each other without forming a thin wall.
const OPPOSITE: f64 = 0.866_025_403_784_438_6;
/// Cosine of 37 degrees: the same limit for a ball that touches both sides, whose direction varies with the point.
const BALL_OPPOSITE: f64 = 0.8;
/// Upper bound of the relative rounding error of a thickness, with a margin.
const ROUNDING: f64 = 1e-9;
/// Maximum nodes and triangles visited in the search for the thinnest overlap of a face.
const MAX_STEPS_PER_FACE: u64 = 4096;
/// Maximum number of faces that a ray may pass inside the material, for example in overlapping parts.
const MAX_PASSED: usize = 16;

/// A measured wall, in unit coordinates.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wall {
    pub thickness: f64,
    /// Point from which the thickness was measured.
    pub point: DVec3,
    /// Face of that point, and the opposite face.
    pub faces: [u32; 2],
}

/// The part of a face that an opposite face covers, seen along the face's normal.
#[derive(Debug, Clone, Copy)]
pub(super) struct Overlap {
    pub face: u32,
    /// The corner of the overlap where the two faces are nearest: their distance varies linearly.
    pub thinnest: DVec3,
    /// The distance there.
    pub thickness: f64,
    /// The mean of the overlap's corners.
    pub middle: DVec3,
}

/// Result of measuring at one sample.
pub(super) enum Probe {
    /// The surface does not separate material from air here.
    NotSolid,
    /// No opposite face within the requested length.
    NoWall,
    /// Thickness in unit coordinates, and the opposite face.
    Wall(f64, u32),
}

/// Measures the wall thickness at single points.
pub(super) struct WallProber<'a> {
    analysis: &'a Analysis<'a>,
    material: Material<'a>,
    /// A length greater than any wall thickness.
    pub reach: f64,
    side_offset: f64,
    touching: f64,
}

/// How to decide on which side of a face the material is.
enum Material<'a> {
    /// Every face of these parts has material behind and air in front, and no other face separates the two. With an
    /// index of the faces by direction.
    Bounded(Vec<bool>, OppositeFaces<'a>),
    /// Winding numbers at points near the face decide.
    Measured(InsideTest<'a>),
}

impl<'a> WallProber<'a> {
    /// `bounding` is the result of [`bounding_parts`](super::bounding_parts).
    pub fn new(analysis: &'a Analysis<'a>, bounding: Option<Vec<bool>>) -> Self {
        let diagonal = analysis.unit_diagonal();
        let side_offset = (SIDE_OFFSET[0] * diagonal).max(SIDE_OFFSET[1]);
        let material = match bounding {
            Some(parts) => {
                let normal = |face: u32| {
                    let bounds = is_bounding(analysis, &parts, face);
                    if bounds { analysis.unit_normal(face) } else { DVec3::ZERO }
                };
                let opposite = analysis.tree().opposite_faces(OPPOSITE, normal);
                Material::Bounded(parts, opposite)
            }
            None => Material::Measured(InsideTest::new(analysis)),
        };
        Self { analysis, material, reach: 2.0 * diagonal, side_offset, touching: TOUCHING * diagonal }
    }

    /// For each face, whether a wall of at most `longest` may be behind the face.
    pub fn may_have_wall(&self, longest: f64) -> Vec<bool> {
        let faces = self.analysis.surface.faces.len();
        match &self.material {
            Material::Bounded(_, opposite) => opposite.may_be_within(longest.min(self.reach), faces),
            // Parts may be inside out.
            Material::Measured(_) => vec![true; faces],
        }
    }

    /// For each face the thinnest overlap with an opposite face within `longest` behind it, thinnest first, and whether all
    /// faces were searched to the end. An overlap is a wall only if the space between the two faces is filled. None unless
    /// every part bounds material.
    pub fn thinnest_overlaps(&self, longest: f64) -> Option<(Vec<Overlap>, bool)> {
        let Material::Bounded(_, opposite) = &self.material else { return None };
        let may_have_wall = self.may_have_wall(longest);
        let faces: Vec<u32> = (0u32..).zip(may_have_wall).filter(|(_, may)| *may).map(|(face, _)| face).collect();
        let found = threads::map(faces.len(), FEW_SEARCHES, |i| self.thinnest_overlap(opposite, faces[i], longest));
        let complete = found.iter().all(|(_, complete)| *complete);
        let mut overlaps: Vec<Overlap> = found.into_iter().filter_map(|(overlap, _)| overlap).collect();
        overlaps.sort_by(|a, b| a.thickness.total_cmp(&b.thickness));
        Some((overlaps, complete))
    }

    /// The thinnest overlap of a face with an opposite one within `longest`, and whether the search came to its end.
    fn thinnest_overlap(&self, opposite: &OppositeFaces<'_>, face: u32, longest: f64) -> (Option<Overlap>, bool) {
        let (corners, normal) = (self.analysis.unit_corners(face), self.analysis.unit_normal(face));
        let (mut reach, mut thinnest, mut steps) = (longest * (1.0 + ROUNDING), None, MAX_STEPS_PER_FACE);
        opposite.any_swept((corners, -normal * reach), normal, &mut steps, |other| {
            let is_near = |corner: DVec3| (corners[0] - corner).dot(normal) <= reach;
            let is_opposite = self.analysis.unit_corners(other).into_iter().any(is_near)
                && self.is_opposite(other, -normal, OPPOSITE);
            let overlap = is_opposite.then(|| self.overlap([face, other])).flatten();
            if let Some(overlap) = overlap.filter(|overlap| overlap.thickness < reach) {
                reach = overlap.thickness;
                thinnest = Some(overlap);
            }
            false
        });
        (thinnest, steps > 0)
    }

    /// The overlap of two faces. `None` for two faces with a common vertex, which form an edge rather than a wall.
    pub fn overlap(&self, faces: [u32; 2]) -> Option<Overlap> {
        let normal = self.analysis.unit_normal(faces[0]);
        if normal == DVec3::ZERO || self.share_a_vertex(faces) {
            return None;
        }
        let [corners, opposite] = faces.map(|face| self.analysis.unit_corners(face));
        overlap((faces[0], corners), normal, opposite)
    }

    /// Whether two faces have a common vertex.
    pub fn share_a_vertex(&self, faces: [u32; 2]) -> bool {
        let [face, other] = faces.map(|face| self.analysis.surface.faces[face as usize]);
        face.iter().any(|v| other.contains(v))
    }

    /// Measures the wall of at most `longest` behind a sample with an inward ray. Tests whether the surface separates
    /// material from air only if a ray hits a face within that length, or if the length is unlimited.
    pub fn probe(&self, sample: &Sample, longest: f64, steps: &mut u64) -> Probe {
        let has_none = match &self.material {
            Material::Bounded(parts, opposite) => {
                is_bounding(self.analysis, parts, sample.face) && !self.meets_opposite(opposite, sample, longest, steps)
            }
            Material::Measured(_) => longest < self.reach && !self.meets_anything(sample, longest, steps),
        };
        if has_none {
            return Probe::NoWall;
        }
        let Some(inward) = self.inward(sample, steps) else { return Probe::NotSolid };
        let Some((length, face)) = self.path_to_air(sample, inward, longest, steps) else { return Probe::NoWall };
        if self.is_opposite(face, inward, OPPOSITE) { Probe::Wall(length, face) } else { Probe::NoWall }
    }

    /// Measures the wall behind a sample with an inward ray and with an inscribed ball, and returns the thinner one.
    /// The ball touches the sample and shrinks until it contains no surface (Ma et al. 2012).
    pub fn probe_by_ball(&self, sample: &Sample, steps: &mut u64) -> Probe {
        let Some(inward) = self.inward(sample, steps) else { return Probe::NotSolid };
        let Some((length, face)) = self.path_to_air(sample, inward, self.reach, steps) else { return Probe::NoWall };
        if let Some(wall) = self.ball(sample.point, inward, length / 2.0, steps) {
            return wall;
        }
        if self.is_opposite(face, inward, BALL_OPPOSITE) { Probe::Wall(length, face) } else { Probe::NoWall }
    }

    fn is_opposite(&self, face: u32, inward: DVec3, cosine: f64) -> bool {
        let along = self.analysis.unit_normal(face).dot(inward);
        // A part turned inside out has its faces' normals inward.
        (if self.is_measured() { along.abs() } else { along }) >= cosine
    }

    fn is_measured(&self) -> bool {
        matches!(self.material, Material::Measured(_))
    }

    /// Whether a ray from a sample against its normal hits an opposite face within a length.
    fn meets_opposite(&self, opposite: &OppositeFaces<'_>, sample: &Sample, longest: f64, steps: &mut u64) -> bool {
        let (ray, min_fraction) = (-sample.normal * longest, self.touching / longest);
        opposite.any_along([sample.point, sample.point + ray], sample.normal, steps, |face| {
            let fraction = hit(sample.point, ray, self.analysis.unit_corners(face));
            face != sample.face && fraction.is_some_and(|fraction| fraction > min_fraction)
        })
    }

    /// Whether a face is within a length of a sample along its normal, on either side.
    fn meets_anything(&self, sample: &Sample, longest: f64, steps: &mut u64) -> bool {
        let rays = [-sample.normal * longest, sample.normal * longest];
        rays.into_iter().any(|ray| self.first_hit(sample, ray, None, steps).is_some())
    }

    /// The first face that a ray from a sample hits, with the position as a fraction of the ray.
    fn first_hit(&self, sample: &Sample, ray: DVec3, after: Option<(f64, u32)>, steps: &mut u64) -> Option<(f64, u32)> {
        let min_fraction = self.touching / ray.length();
        self.analysis.tree().first_along([sample.point, sample.point + ray], after, steps, |face| {
            let other = face != sample.face && self.may_end_material(face);
            let fraction = other.then(|| hit(sample.point, ray, self.analysis.unit_corners(face))).flatten();
            fraction.filter(|&fraction| fraction > min_fraction)
        })
    }

    /// Direction from a sample into the material; `None` unless there is material on one side and air on the other.
    fn inward(&self, sample: &Sample, steps: &mut u64) -> Option<DVec3> {
        let inside = match &self.material {
            Material::Bounded(parts, _) => {
                return is_bounding(self.analysis, parts, sample.face).then_some(-sample.normal);
            }
            Material::Measured(inside) => inside,
        };
        let [front, back] = inside.windings(sample.point, sample.normal * self.side_offset, steps);
        if front < AIR && back > MATERIAL {
            Some(-sample.normal)
        } else {
            (back < AIR && front > MATERIAL).then_some(sample.normal)
        }
    }

    /// Whether air may begin behind a face that a ray hits from inside the material.
    fn may_end_material(&self, face: u32) -> bool {
        match &self.material {
            Material::Bounded(parts, _) => is_bounding(self.analysis, parts, face),
            Material::Measured(_) => true,
        }
    }

    /// Whether a point just behind such a face is in air.
    fn is_air(&self, beyond: DVec3, steps: &mut u64) -> bool {
        match &self.material {
            Material::Bounded(..) => true,
            Material::Measured(inside) => inside.winding(beyond, steps) < AIR,
        }
    }

    /// Distance from a sample through the material to the air, if at most `longest`, and the face there.
    fn path_to_air(&self, sample: &Sample, inward: DVec3, longest: f64, steps: &mut u64) -> Option<(f64, u32)> {
        let ray = inward * longest;
        let mut passed = None;
        for _ in 0..MAX_PASSED {
            let first_hit = self.first_hit(sample, ray, passed, steps);
            let (fraction, face) = first_hit.filter(|_| *steps > 0)?;
            let length = fraction * longest;
            if self.is_air(sample.point + inward * (length + self.side_offset), steps) {
                return Some((length, face)).filter(|_| *steps > 0);
            }
            passed = first_hit;
        }
        None
    }

    /// The wall given by the largest ball of at most `radius` that touches `point` from inside, if the ball touches
    /// an opposite face.
    fn ball(&self, point: DVec3, inward: DVec3, radius: f64, steps: &mut u64) -> Option<Probe> {
        let ball =
            self.analysis.tree().shrunk_ball([point, inward], radius, steps, |f| self.analysis.unit_corners(f))?;
        let contact = ball.touches.filter(|_| *steps > 0)?;
        let outward = (contact.point - (point + inward * ball.radius)) / ball.radius;
        let beyond = contact.point + outward * self.side_offset;
        let wall = outward.dot(inward) >= BALL_OPPOSITE && self.is_air(beyond, steps);
        wall.then_some(Probe::Wall(2.0 * ball.radius, contact.face))
    }
}

fn is_bounding(analysis: &Analysis<'_>, parts: &[bool], face: u32) -> bool {
    parts.get(analysis.parts.of_face[face as usize] as usize).copied().unwrap_or(false)
}

/// The overlap of two triangles: `q` projected onto `p` along the normal of `p`. Its distance to the plane of `q` is measured
/// along that normal.
fn overlap((face, p): (u32, [DVec3; 3]), normal: DVec3, q: [DVec3; 3]) -> Option<Overlap> {
    let part = covered(p, q, normal);
    let plane = (q[1] - q[0]).cross(q[2] - q[0]);
    let thickness = |x: DVec3| ((q[0] - x).dot(plane) / normal.dot(plane)).abs();
    let middle = part.iter().sum::<DVec3>() / part.len() as f64;
    let corners = part.into_iter().map(|x| (x, thickness(x)));
    let (thinnest, thickness) = corners.min_by(|(_, a), (_, b)| a.total_cmp(b))?;
    Some(Overlap { face, thinnest, thickness, middle })
}
