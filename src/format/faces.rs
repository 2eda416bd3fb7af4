//! Collecting the polygons of an indexed format (OBJ, PLY, OFF) as triangles.
//!
//! OBJ and PLY may name vertices before the file defines them. A polygon with more than three corners then waits until all positions are
//! known, because its triangulation depends on them.

use glam::DVec3;

use super::content::Polygons;
use super::errors::ReadError;
use super::limits::{Limits, ReadOptions};
use super::polygon::Cutter;

/// Collects polygons, triangulates them and keeps the file's order.
pub(super) struct Faces {
    limits: Limits,
    faces: Vec<[u32; 3]>,
    /// Normal and texture coordinate indices of the corners.
    numbers: [OfCorners; KINDS],
    cutter: Cutter,
    /// Polygons whose vertices had not been read yet, to be triangulated at the end.
    waiting: Vec<Waiting>,
    waiting_corners: Vec<u32>,
    too_few: u64,
}

/// Number of optional attributes of a corner: a normal index and a texture coordinate index.
const KINDS: usize = 2;
/// The index of an attribute that a corner does not have.
pub(super) const NONE: u32 = u32::MAX;

/// The triangles that [`Faces`] has collected, with their attributes.
pub(super) struct Finished {
    /// Vertex indices of each triangle.
    pub faces: Vec<[u32; 3]>,
    /// Normal indices of the triangles' corners, up to the last triangle that has one.
    pub normals: Vec<[u32; 3]>,
    /// Texture coordinate indices of the triangles' corners, up to the last triangle that has one.
    pub places: Vec<[u32; 3]>,
    /// Counts of the polygons with more than three corners.
    pub polygons: Polygons,
}

/// Indices of one attribute at the corners of triangles.
#[derive(Default)]
struct OfCorners {
    /// One entry for each triangle, up to the last triangle that has the attribute.
    triangles: Vec<[u32; 3]>,
    /// One entry for each corner of the waiting polygons, up to the last that has the attribute.
    waiting: Vec<u32>,
}

impl OfCorners {
    fn set(&mut self, triangle: usize, numbers: [u32; 3]) {
        self.triangles.resize(triangle, [NONE; 3]);
        self.triangles.push(numbers);
    }

    fn wait(&mut self, begin: usize, numbers: &[u32]) {
        self.waiting.resize(begin, NONE);
        self.waiting.extend_from_slice(numbers);
    }
}

/// The attributes that a polygon's corners have, with their indices.
fn there<'n>(
    all: &'n mut [OfCorners; KINDS],
    numbers: [&'n [u32]; KINDS],
) -> impl Iterator<Item = (&'n mut OfCorners, &'n [u32])> {
    all.iter_mut().zip(numbers).filter(|(_, numbers)| !numbers.is_empty())
}

/// A polygon that waits for its vertices: its first triangle, and its range in `waiting_corners`.
struct Waiting {
    face: usize,
    begin: usize,
    end: usize,
}

impl Faces {
    /// An empty collection with capacity for `expected` triangles. The caller has checked `expected` against the size of the file.
    pub fn new(options: &ReadOptions, expected: usize) -> Self {
        Self {
            limits: options.limits,
            faces: Vec::with_capacity(expected),
            numbers: Default::default(),
            cutter: Cutter::new(options.twist_angle_deg),
            waiting: Vec::new(),
            waiting_corners: Vec::new(),
            too_few: 0,
        }
    }

    /// Adds a triangle whose indices the caller has checked.
    pub fn triangle(&mut self, corners: [u32; 3]) -> Result<(), ReadError> {
        self.limits.check_faces(self.faces.len() as u64 + 1)?;
        self.faces.push(corners);
        Ok(())
    }

    /// Adds a polygon whose indices the caller has checked, or checks before [`Faces::finish`]. Polygons with fewer than three corners are
    /// counted and dropped.
    ///
    /// # Errors
    /// A [`ReadError`] of kind `TooLarge` when there are more triangles than the limits allow.
    pub fn polygon(&mut self, positions: &[DVec3], corners: &[u32]) -> Result<(), ReadError> {
        self.polygon_with(positions, corners, [&[], &[]])
    }

    /// As [`Faces::polygon`], with normal and texture coordinate indices: one for each corner, or none.
    pub fn polygon_with(
        &mut self,
        positions: &[DVec3],
        corners: &[u32],
        numbers: [&[u32]; KINDS],
    ) -> Result<(), ReadError> {
        match corners {
            [] | [_] | [_, _] => self.too_few += 1,
            &[a, b, c] => {
                for (of_corners, numbers) in there(&mut self.numbers, numbers) {
                    of_corners.set(self.faces.len(), [0, 1, 2].map(|k| numbers[k]));
                }
                self.triangle([a, b, c])?;
            }
            _ => {
                let triangles = corners.len() - 2;
                self.limits.check_faces((self.faces.len() + triangles) as u64)?;
                if corners.iter().all(|&v| (v as usize) < positions.len()) {
                    self.cutter.cut(positions, corners, |places| {
                        for (of_corners, numbers) in there(&mut self.numbers, numbers) {
                            of_corners.set(self.faces.len(), places.map(|k| numbers[k]));
                        }
                        self.faces.push(places.map(|k| corners[k]));
                    });
                } else {
                    let begin = self.waiting_corners.len();
                    for (of_corners, numbers) in there(&mut self.numbers, numbers) {
                        of_corners.wait(begin, numbers);
                        of_corners.triangles.resize(self.faces.len() + triangles, [NONE; 3]);
                    }
                    self.waiting_corners.extend_from_slice(corners);
                    self.waiting.push(Waiting { face: self.faces.len(), begin, end: begin + corners.len() });
                    self.faces.resize(self.faces.len() + triangles, [0; 3]);
                }
            }
        }
        Ok(())
    }

    /// Returns the triangles and appends warnings. All indices must be in range of `positions`.
    pub fn finish(self, positions: &[DVec3], warnings: &mut Vec<String>) -> (Vec<[u32; 3]>, Polygons) {
        let Finished { faces, polygons, .. } = self.finish_with_all(positions, warnings);
        (faces, polygons)
    }

    /// As [`Faces::finish`], with the corners' attributes.
    pub fn finish_with_all(mut self, positions: &[DVec3], warnings: &mut Vec<String>) -> Finished {
        for waiting in &self.waiting {
            let corners = &self.waiting_corners[waiting.begin..waiting.end];
            let mut next = waiting.face;
            self.cutter.cut(positions, corners, |places| {
                self.faces[next] = places.map(|k| corners[k]);
                for of_corners in &mut self.numbers {
                    let numbers = of_corners.waiting.get(waiting.begin..waiting.end);
                    if let (Some(numbers), Some(slot)) = (numbers, of_corners.triangles.get_mut(next)) {
                        *slot = places.map(|k| numbers[k]);
                    }
                }
                next += 1;
            });
        }
        if self.cutter.degenerate_count() > 0 {
            warnings.push(format!(
                "polygons whose corners lie on a line or are not finite: {}",
                self.cutter.degenerate_count()
            ));
        }
        if self.cutter.fan_count() > 0 {
            warnings.push(format!(
                "polygons that cross themselves or have too many corners: {}; they were split as fans, so check the result there",
                self.cutter.fan_count()
            ));
        }
        if self.too_few > 0 {
            warnings.push(format!("faces with fewer than three corners were dropped: {}", self.too_few));
        }
        let polygons = self.cutter.polygons();
        if polygons.twisted > 0 {
            warnings.push(format!(
                "polygons that are not flat were split into triangles with the least fold: {}, the most twisted by {:.1} degrees",
                polygons.twisted, polygons.largest_twist_deg
            ));
        }
        let [normals, places] = self.numbers.map(|of_corners| of_corners.triangles);
        Finished { faces: self.faces, normals, places, polygons }
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
