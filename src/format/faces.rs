use glam::DVec3;

use super::errors::ReadError;
use super::polygon::Cutter;
use super::{Limits, Polygons, ReadOptions};

/// Collects the polygons of an indexed format as triangles, in the file's order.
pub(super) struct Faces {
    limits: Limits,
    faces: Vec<[u32; 3]>,
    /// For the first faces, up to the last that has one, the normals at their corners.
    normals: Vec<[u32; 3]>,
    cutter: Cutter,
    /// Polygons whose vertices had not been read yet.
    waiting: Vec<Waiting>,
    waiting_corners: Vec<u32>,
    /// The normals at `waiting_corners`, up to the last that has one.
    waiting_normals: Vec<u32>,
    too_few: u64,
}

/// The number of no normal.
pub(super) const NO_NORMAL: u32 = u32::MAX;

/// What [`Faces`] has collected.
pub(super) struct Finished {
    pub faces: Vec<[u32; 3]>,
    /// The numbers of the normals at the triangles' corners; the last triangles without any are left out.
    pub normals: Vec<[u32; 3]>,
    pub polygons: Polygons,
}

struct Waiting {
    face: usize,
    begin: usize,
    end: usize,
}

impl Faces {
    /// With room for `expected` triangles, which the caller has checked against the bytes that are there.
    pub fn new(options: &ReadOptions, expected: usize) -> Self {
        Self {
            limits: options.limits,
            faces: Vec::with_capacity(expected),
            normals: Vec::new(),
            cutter: Cutter::new(options.twist_angle_deg),
            waiting: Vec::new(),
            waiting_corners: Vec::new(),
            waiting_normals: Vec::new(),
            too_few: 0,
        }
    }

    /// Takes a triangle whose indices the caller has checked.
    pub fn triangle(&mut self, corners: [u32; 3]) -> Result<(), ReadError> {
        self.limits.check_faces(self.faces.len() as u64 + 1)?;
        self.faces.push(corners);
        Ok(())
    }

    /// Takes a polygon whose indices the caller has checked, or will have checked before [`Faces::finish`].
    /// Fewer than three corners are counted and left out.
    pub fn polygon(&mut self, positions: &[DVec3], corners: &[u32]) -> Result<(), ReadError> {
        self.polygon_with_normals(positions, corners, &[])
    }

    /// As [`Faces::polygon`], with the number of a normal for each corner, or for none of them.
    pub fn polygon_with_normals(
        &mut self,
        positions: &[DVec3],
        corners: &[u32],
        normals: &[u32],
    ) -> Result<(), ReadError> {
        match corners {
            [] | [_] | [_, _] => self.too_few += 1,
            &[a, b, c] => {
                if let &[p, q, r] = normals {
                    self.normals.resize(self.faces.len(), [NO_NORMAL; 3]);
                    self.normals.push([p, q, r]);
                }
                self.triangle([a, b, c])?;
            }
            _ => {
                let triangles = corners.len() - 2;
                self.limits.check_faces((self.faces.len() + triangles) as u64)?;
                if !normals.is_empty() {
                    self.normals.resize(self.faces.len(), [NO_NORMAL; 3]);
                }
                if corners.iter().all(|&v| (v as usize) < positions.len()) {
                    self.cutter.cut(positions, corners, |places| {
                        self.faces.push(places.map(|k| corners[k]));
                        if !normals.is_empty() {
                            self.normals.push(places.map(|k| normals[k]));
                        }
                    });
                } else {
                    let begin = self.waiting_corners.len();
                    if !normals.is_empty() {
                        self.waiting_normals.resize(begin, NO_NORMAL);
                        self.waiting_normals.extend_from_slice(normals);
                        self.normals.resize(self.faces.len() + triangles, [NO_NORMAL; 3]);
                    }
                    self.waiting_corners.extend_from_slice(corners);
                    self.waiting.push(Waiting { face: self.faces.len(), begin, end: begin + corners.len() });
                    self.faces.resize(self.faces.len() + triangles, [0; 3]);
                }
            }
        }
        Ok(())
    }

    /// The triangles; what there is to tell is added to the warnings. All indices must be in range of `positions`.
    pub fn finish(self, positions: &[DVec3], warnings: &mut Vec<String>) -> (Vec<[u32; 3]>, Polygons) {
        let Finished { faces, polygons, .. } = self.finish_with_normals(positions, warnings);
        (faces, polygons)
    }

    /// As [`Faces::finish`], with normals.
    pub fn finish_with_normals(mut self, positions: &[DVec3], warnings: &mut Vec<String>) -> Finished {
        for waiting in &self.waiting {
            let corners = &self.waiting_corners[waiting.begin..waiting.end];
            let normals = self.waiting_normals.get(waiting.begin..waiting.end);
            let mut next = waiting.face;
            self.cutter.cut(positions, corners, |places| {
                self.faces[next] = places.map(|k| corners[k]);
                if let (Some(normals), Some(slot)) = (normals, self.normals.get_mut(next)) {
                    *slot = places.map(|k| normals[k]);
                }
                next += 1;
            });
        }
        if self.cutter.without_normal() > 0 {
            warnings.push(format!(
                "polygons whose corners lie on a line or have no position: {}",
                self.cutter.without_normal()
            ));
        }
        if self.cutter.fanned() > 0 {
            warnings.push(format!(
                "polygons that cross themselves or have too many corners were cut as fans: {}; look at the result there",
                self.cutter.fanned()
            ));
        }
        if self.too_few > 0 {
            warnings.push(format!("faces with fewer than three corners were left out: {}", self.too_few));
        }
        let polygons = self.cutter.polygons();
        if polygons.twisted > 0 {
            warnings.push(format!(
                "polygons that are not flat were cut into triangles with the least fold: {}, the most twisted by {:.1} degrees",
                polygons.twisted, polygons.largest_twist_deg
            ));
        }
        Finished { faces: self.faces, normals: self.normals, polygons }
    }

    pub fn is_empty(&self) -> bool {
        self.faces.is_empty()
    }
}
