//! The polygons of an indexed format as triangles.

use glam::DVec3;

use super::content::Polygons;
use super::errors::ReadError;
use super::limits::{Limits, ReadOptions};
use super::polygon::Cutter;

/// Collects the polygons of an indexed format as triangles, in the file's order.
pub(super) struct Faces {
    limits: Limits,
    faces: Vec<[u32; 3]>,
    /// What else corners have.
    numbers: [OfCorners; KINDS],
    cutter: Cutter,
    /// Polygons whose vertices had not been read yet.
    waiting: Vec<Waiting>,
    waiting_corners: Vec<u32>,
    too_few: u64,
}

/// What corners may have beside a vertex: the number of a normal, and that of a place in a picture.
const KINDS: usize = 2;
/// The number of what a corner does not have.
pub(super) const NONE: u32 = u32::MAX;

/// What [`Faces`] has collected.
pub(super) struct Finished {
    pub faces: Vec<[u32; 3]>,
    /// The numbers of the normals at the triangles' corners; the last triangles without any are left out.
    pub normals: Vec<[u32; 3]>,
    /// The same of places in a picture.
    pub places: Vec<[u32; 3]>,
    pub polygons: Polygons,
}

/// Numbers at the corners of triangles.
#[derive(Default)]
struct OfCorners {
    /// For the first triangles, up to the last that has some.
    triangles: Vec<[u32; 3]>,
    /// Those at the corners of polygons that wait, up to the last that has some.
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

/// The kinds that these corners have.
fn there<'n>(
    all: &'n mut [OfCorners; KINDS],
    numbers: [&'n [u32]; KINDS],
) -> impl Iterator<Item = (&'n mut OfCorners, &'n [u32])> {
    all.iter_mut().zip(numbers).filter(|(_, numbers)| !numbers.is_empty())
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
            numbers: Default::default(),
            cutter: Cutter::new(options.twist_angle_deg),
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
        self.polygon_with(positions, corners, [&[], &[]])
    }

    /// As [`Faces::polygon`], with the number of a normal and that of a place in a picture for each corner, or for none of them.
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

    /// The triangles; what there is to tell is added to the warnings. All indices must be in range of `positions`.
    pub fn finish(self, positions: &[DVec3], warnings: &mut Vec<String>) -> (Vec<[u32; 3]>, Polygons) {
        let Finished { faces, polygons, .. } = self.finish_with_all(positions, warnings);
        (faces, polygons)
    }

    /// As [`Faces::finish`], with what else corners have.
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
        let [normals, places] = self.numbers.map(|of_corners| of_corners.triangles);
        Finished { faces: self.faces, normals, places, polygons }
    }

    /// How many triangles there are, with those that wait.
    pub fn len(&self) -> usize {
        self.faces.len()
    }

    pub fn is_empty(&self) -> bool {
        self.faces.is_empty()
    }
}
