use glam::DVec3;

use super::Limits;
use super::errors::ReadError;
use super::polygon::Cutter;

/// Collects the polygons of an indexed format as triangles, in the file's order.
pub(super) struct Faces {
    limits: Limits,
    faces: Vec<[u32; 3]>,
    cutter: Cutter,
    /// Polygons whose vertices had not been read yet.
    waiting: Vec<Waiting>,
    waiting_corners: Vec<u32>,
    too_few: u64,
}

struct Waiting {
    face: usize,
    begin: usize,
    end: usize,
}

impl Faces {
    /// With room for `expected` triangles, which the caller has checked against the bytes that are there.
    pub fn new(limits: &Limits, expected: usize) -> Self {
        Self {
            limits: *limits,
            faces: Vec::with_capacity(expected),
            cutter: Cutter::new(),
            waiting: Vec::new(),
            waiting_corners: Vec::new(),
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
        match corners {
            [] | [_] | [_, _] => {
                self.too_few += 1;
                Ok(())
            }
            &[a, b, c] => self.triangle([a, b, c]),
            _ => {
                let triangles = corners.len() - 2;
                self.limits.check_faces((self.faces.len() + triangles) as u64)?;
                if corners.iter().all(|&v| (v as usize) < positions.len()) {
                    self.cutter.cut(positions, corners, |triangle| self.faces.push(triangle));
                } else {
                    let begin = self.waiting_corners.len();
                    self.waiting_corners.extend_from_slice(corners);
                    self.waiting.push(Waiting { face: self.faces.len(), begin, end: begin + corners.len() });
                    self.faces.resize(self.faces.len() + triangles, [0; 3]);
                }
                Ok(())
            }
        }
    }

    /// The triangles; what there is to tell is added to the warnings. All indices must be in range of `positions`.
    pub fn finish(mut self, positions: &[DVec3], warnings: &mut Vec<String>) -> Vec<[u32; 3]> {
        for waiting in &self.waiting {
            let slots = &mut self.faces[waiting.face..];
            let mut next = 0;
            self.cutter.cut(positions, &self.waiting_corners[waiting.begin..waiting.end], |triangle| {
                slots[next] = triangle;
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
        self.faces
    }

    pub fn is_empty(&self) -> bool {
        self.faces.is_empty()
    }
}
