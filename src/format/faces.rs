//! Collecting the polygons of an indexed format (OBJ, PLY, OFF) as triangles.
//!
//! OBJ and PLY may name vertices before the file defines them. A polygon with more than three corners then waits until all positions are
//! known, because its triangulation depends on them.

use glam::DVec3;

use super::content::Polygons;
use super::errors::ReadError;
use super::limits::{Limits, ReadOptions};
use super::polygon::Triangulator;

/// Collects polygons, triangulates them and keeps the file's order.
pub(super) struct FaceCollector {
    limits: Limits,
    faces: Vec<[u32; 3]>,
    /// Normal and texture coordinate indices of the corners.
    attributes: [CornerAttribute; ATTRIBUTES],
    triangulator: Triangulator,
    /// Polygons whose vertices had not been read yet, to be triangulated at the end.
    waiting: Vec<WaitingPolygon>,
    waiting_corners: Vec<u32>,
    /// Number of polygons with fewer than three corners.
    dropped: u64,
}

/// Number of optional attributes of a corner: a normal index and a texture coordinate index.
const ATTRIBUTES: usize = 2;
/// The index of an attribute that a corner does not have.
pub(super) const NO_INDEX: u32 = u32::MAX;

/// The triangles that [`FaceCollector`] has collected, with their attributes.
pub(super) struct CollectedFaces {
    /// Vertex indices of each triangle.
    pub faces: Vec<[u32; 3]>,
    /// Normal indices of the triangles' corners, up to the last triangle that has one.
    pub normals: Vec<[u32; 3]>,
    /// Texture coordinate indices of the triangles' corners, up to the last triangle that has one.
    pub texture_coordinates: Vec<[u32; 3]>,
    /// Counts of the polygons with more than three corners.
    pub polygons: Polygons,
}

/// Indices of one attribute at the corners of triangles.
#[derive(Default)]
struct CornerAttribute {
    /// One entry for each triangle, up to the last triangle that has the attribute.
    triangles: Vec<[u32; 3]>,
    /// One entry for each corner of the waiting polygons, up to the last that has the attribute.
    waiting: Vec<u32>,
}

impl CornerAttribute {
    fn set(&mut self, triangle: usize, indices: [u32; 3]) {
        self.triangles.resize(triangle, [NO_INDEX; 3]);
        self.triangles.push(indices);
    }

    fn wait(&mut self, begin: usize, indices: &[u32]) {
        self.waiting.resize(begin, NO_INDEX);
        self.waiting.extend_from_slice(indices);
    }
}

/// The attributes that a polygon's corners have, with their indices.
fn present_attributes<'n>(
    all: &'n mut [CornerAttribute; ATTRIBUTES],
    indices: [&'n [u32]; ATTRIBUTES],
) -> impl Iterator<Item = (&'n mut CornerAttribute, &'n [u32])> {
    all.iter_mut().zip(indices).filter(|(_, indices)| !indices.is_empty())
}

/// A polygon that waits for its vertices: its first triangle, and its range in `waiting_corners`.
struct WaitingPolygon {
    face: usize,
    begin: usize,
    end: usize,
}

impl FaceCollector {
    /// An empty collection with capacity for `expected` triangles. The caller has checked `expected` against the size of the file.
    pub fn new(options: &ReadOptions, expected: usize) -> Self {
        Self {
            limits: options.limits,
            faces: Vec::with_capacity(expected),
            attributes: Default::default(),
            triangulator: Triangulator::new(options.twist_angle_deg),
            waiting: Vec::new(),
            waiting_corners: Vec::new(),
            dropped: 0,
        }
    }

    /// Adds a triangle whose indices the caller has checked.
    pub fn triangle(&mut self, corners: [u32; 3]) -> Result<(), ReadError> {
        self.limits.check_faces(self.faces.len() as u64 + 1)?;
        self.faces.push(corners);
        Ok(())
    }

    /// Adds a polygon whose indices the caller has checked, or checks before [`FaceCollector::finish`]. Polygons with fewer than three
    /// corners are counted and dropped.
    ///
    /// # Errors
    /// A [`ReadError`] of kind `TooLarge` when there are more triangles than the limits allow.
    pub fn polygon(&mut self, positions: &[DVec3], corners: &[u32]) -> Result<(), ReadError> {
        self.polygon_with(positions, corners, [&[], &[]])
    }

    /// As [`FaceCollector::polygon`], with normal and texture coordinate indices: one for each corner, or none.
    pub fn polygon_with(
        &mut self,
        positions: &[DVec3],
        corners: &[u32],
        indices: [&[u32]; ATTRIBUTES],
    ) -> Result<(), ReadError> {
        match corners {
            [] | [_] | [_, _] => self.dropped += 1,
            &[a, b, c] => {
                for (attribute, indices) in present_attributes(&mut self.attributes, indices) {
                    attribute.set(self.faces.len(), [0, 1, 2].map(|k| indices[k]));
                }
                self.triangle([a, b, c])?;
            }
            _ => {
                let triangles = corners.len() - 2;
                self.limits.check_faces((self.faces.len() + triangles) as u64)?;
                if corners.iter().all(|&v| (v as usize) < positions.len()) {
                    self.triangulator.triangulate(positions, corners, |triangle| {
                        for (attribute, indices) in present_attributes(&mut self.attributes, indices) {
                            attribute.set(self.faces.len(), triangle.map(|k| indices[k]));
                        }
                        self.faces.push(triangle.map(|k| corners[k]));
                    });
                } else {
                    let begin = self.waiting_corners.len();
                    for (attribute, indices) in present_attributes(&mut self.attributes, indices) {
                        attribute.wait(begin, indices);
                        attribute.triangles.resize(self.faces.len() + triangles, [NO_INDEX; 3]);
                    }
                    self.waiting_corners.extend_from_slice(corners);
                    self.waiting.push(WaitingPolygon { face: self.faces.len(), begin, end: begin + corners.len() });
                    self.faces.resize(self.faces.len() + triangles, [0; 3]);
                }
            }
        }
        Ok(())
    }

    /// Returns the triangles and appends warnings. All indices must be in range of `positions`.
    pub fn finish(self, positions: &[DVec3], warnings: &mut Vec<String>) -> (Vec<[u32; 3]>, Polygons) {
        let CollectedFaces { faces, polygons, .. } = self.finish_with_all(positions, warnings);
        (faces, polygons)
    }

    /// As [`FaceCollector::finish`], with the corners' attributes.
    pub fn finish_with_all(mut self, positions: &[DVec3], warnings: &mut Vec<String>) -> CollectedFaces {
        for waiting in &self.waiting {
            let corners = &self.waiting_corners[waiting.begin..waiting.end];
            let mut next = waiting.face;
            self.triangulator.triangulate(positions, corners, |triangle| {
                self.faces[next] = triangle.map(|k| corners[k]);
                for attribute in &mut self.attributes {
                    let indices = attribute.waiting.get(waiting.begin..waiting.end);
                    if let (Some(indices), Some(slot)) = (indices, attribute.triangles.get_mut(next)) {
                        *slot = triangle.map(|k| indices[k]);
                    }
                }
                next += 1;
            });
        }
        if self.triangulator.degenerate_count() > 0 {
            warnings.push(format!(
                "polygons whose corners lie on a line or are not finite: {}",
                self.triangulator.degenerate_count()
            ));
        }
        if self.triangulator.fan_count() > 0 {
            warnings.push(format!(
                "polygons that cross themselves or have too many corners: {}; they were split as fans, so check the result there",
                self.triangulator.fan_count()
            ));
        }
        if self.dropped > 0 {
            warnings.push(format!("faces with fewer than three corners were dropped: {}", self.dropped));
        }
        let polygons = self.triangulator.polygons();
        if polygons.twisted > 0 {
            warnings.push(format!(
                "polygons that are not flat were split into triangles with the least fold: {}, the most twisted by {:.1} degrees",
                polygons.twisted, polygons.largest_twist_deg
            ));
        }
        let [normals, texture_coordinates] = self.attributes.map(|attribute| attribute.triangles);
        CollectedFaces { faces: self.faces, normals, texture_coordinates, polygons }
    }

    /// The number of triangles so far, including those of waiting polygons.
    pub fn len(&self) -> usize {
        self.faces.len()
    }

    /// Whether there are no triangles so far.
    pub fn is_empty(&self) -> bool {
        self.faces.is_empty()
    }
}
