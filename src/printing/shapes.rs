//! Shapes with known answers, for tests.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use glam::{DQuat, DVec3};

use crate::context::{Context, NoProgress};
use crate::math::ray_direction;
use crate::mesh::{Soup, Surface};

/// Calls `test` with a context that is never late.
pub fn quietly(test: impl FnOnce(&Context<'_>)) {
    test(&Context::new(&NoProgress, &AtomicBool::new(false), &|| Duration::ZERO, Duration::from_secs(1)));
}

/// Joins surfaces and welds equal positions.
pub fn joined(surfaces: &[Surface]) -> Surface {
    let mut soup = Soup::default();
    for surface in surfaces {
        let first = soup.positions.len() as u32;
        soup.positions.extend(&surface.positions);
        soup.faces.extend(surface.faces.iter().map(|face| face.map(|v| v + first)));
    }
    Surface::from_soup(&soup).0
}

/// The surface with all faces turned round.
pub fn inverted(mut surface: Surface) -> Surface {
    surface.faces.iter_mut().for_each(|face| face.swap(1, 2));
    surface
}

/// A surface from positions and faces.
pub fn surface(positions: Vec<DVec3>, faces: Vec<[u32; 3]>) -> Surface {
    let source = (0..faces.len() as u32).collect();
    Surface { positions, faces, source }
}

/// A box between two corners.
pub fn cuboid(a: DVec3, b: DVec3) -> Surface {
    let at = |i: u32, bit: u32| if i >> bit & 1 == 1 { b[bit as usize] } else { a[bit as usize] };
    let positions = (0..8).map(|i| DVec3::new(at(i, 0), at(i, 1), at(i, 2))).collect();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    surface(positions, quads.iter().flat_map(|&[p, q, r, s]| [[p, q, r], [p, r, s]]).collect())
}

/// A tetrahedron, oriented outward.
pub fn tetrahedron(p: [DVec3; 4]) -> Surface {
    let solid = surface(p.to_vec(), vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]);
    if volume(&solid) > 0.0 { solid } else { inverted(solid) }
}

/// The volume of a tetrahedron, whatever the order of its corners.
pub fn tetrahedron_volume([a, b, c, d]: [DVec3; 4]) -> f64 {
    ((b - a).cross(c - a).dot(d - a) / 6.0).abs()
}

/// A solid of revolution around z: the profile is a closed polygon of (radius, height), counter-clockwise with the
/// radius to the right, with radius 0 only at ends of runs on the axis.
pub fn revolved(profile: &[[f64; 2]], sides: u32) -> Surface {
    let mut rings: Vec<Vec<u32>> = Vec::new();
    let mut positions = Vec::new();
    for &[r, z] in profile {
        let first = positions.len() as u32;
        if r == 0.0 {
            positions.push(DVec3::new(0.0, 0.0, z));
            rings.push(vec![first; sides as usize]);
        } else {
            let angle = |i: u32| std::f64::consts::TAU * f64::from(i) / f64::from(sides);
            positions.extend((0..sides).map(|i| DVec3::new(r * angle(i).cos(), r * angle(i).sin(), z)));
            rings.push((first..first + sides).collect());
        }
    }
    let mut faces = Vec::new();
    for (at, low) in rings.iter().enumerate() {
        let high = &rings[(at + 1) % rings.len()];
        for i in 0..sides as usize {
            let j = (i + 1) % sides as usize;
            faces.push([low[i], low[j], high[j]]);
            faces.push([low[i], high[j], high[i]]);
        }
    }
    faces.retain(|[a, b, c]| a != b && b != c && c != a);
    surface(positions, faces)
}

/// A sphere around the origin: an octahedron, refined.
pub fn sphere(radius: f64, refinements: u32) -> Surface {
    let positions = [DVec3::X, -DVec3::X, DVec3::Y, -DVec3::Y, DVec3::Z, -DVec3::Z].to_vec();
    let mut faces = vec![[0u32, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
    let mut soup = Soup { positions, faces: faces.clone() };
    for _ in 0..refinements {
        let mut positions = Vec::new();
        for face in &faces {
            let [a, b, c] = face.map(|v| soup.positions[v as usize]);
            let [d, e, f] = [(a + b).normalize(), (b + c).normalize(), (c + a).normalize()];
            positions.extend([a, d, f, d, b, e, f, e, c, d, e, f]);
        }
        faces = (0..positions.len() as u32).step_by(3).map(|i| [i, i + 1, i + 2]).collect();
        soup = Soup { positions, faces: faces.clone() };
    }
    let mut surface = Surface::from_soup(&soup).0;
    surface.positions.iter_mut().for_each(|p| *p *= radius);
    surface
}

/// The surface turned by a rotation that depends on `seed`, then moved.
pub fn turned(surface: &Surface, seed: f64, by: DVec3) -> Surface {
    let turn = DQuat::from_axis_angle(ray_direction(seed as u32), 0.3 + seed);
    let mut moved = surface.clone();
    moved.positions.iter_mut().for_each(|p| *p = turn * *p + by);
    moved
}

/// The enclosed volume, with sign.
pub fn volume(surface: &Surface) -> f64 {
    let about = surface.bounds().centre();
    (0..surface.faces.len())
        .map(|f| {
            let [a, b, c] = surface.corners(f).map(|p| p - about);
            a.dot(b.cross(c)) / 6.0
        })
        .sum()
}

/// A block of unit voxels, each filled or not.
pub struct Voxels {
    pub size: [usize; 3],
    filled: Vec<bool>,
}

/// The parts of the air of voxels: connected through sides.
pub struct AirParts {
    size: [usize; 3],
    part: Vec<u32>,
    /// The part of the outside.
    pub outside: u32,
    /// The cells of each part, those around the block left out.
    pub cells: std::collections::BTreeMap<u32, Vec<[usize; 3]>>,
}

impl AirParts {
    /// The part of a cell of the block.
    pub fn part_of(&self, cell: [usize; 3]) -> u32 {
        self.part[padded(self.size, cell.map(|x| x + 1))]
    }
}

fn padded(size: [usize; 3], [i, j, k]: [usize; 3]) -> usize {
    (k * (size[1] + 2) + j) * (size[0] + 2) + i
}

impl Voxels {
    /// A block without filled voxels.
    pub fn empty(size: [usize; 3]) -> Self {
        Self { size, filled: vec![false; size.iter().product()] }
    }

    /// A block of filled voxels.
    pub fn filled(size: [usize; 3]) -> Self {
        Self { size, filled: vec![true; size.iter().product()] }
    }

    /// Fills or empties a voxel of the block.
    pub fn set(&mut self, [i, j, k]: [usize; 3], filled: bool) {
        self.filled[(k * self.size[1] + j) * self.size[0] + i] = filled;
    }

    /// Whether a cell is filled; cells beyond the block are not.
    pub fn get(&self, cell: [i64; 3]) -> bool {
        let inside = (0..3).all(|k| cell[k] >= 0 && cell[k] < self.size[k] as i64);
        inside && self.filled[((cell[2] as usize) * self.size[1] + cell[1] as usize) * self.size[0] + cell[0] as usize]
    }

    /// The boundary of the filled voxels.
    pub fn surface(&self) -> Surface {
        let mut soup = Soup::default();
        let cells = (0..self.filled.len()).map(|at| {
            [at % self.size[0], at / self.size[0] % self.size[1], at / self.size[0] / self.size[1]].map(|x| x as i64)
        });
        for cell in cells.filter(|&cell| self.get(cell)) {
            let low = DVec3::from_array(cell.map(|x| x as f64));
            let cube = cuboid(low, low + 1.0);
            let sides = [[0, 0, -1], [0, 0, 1], [0, -1, 0], [0, 1, 0], [-1, 0, 0], [1, 0, 0]];
            for (side, step) in sides.iter().enumerate() {
                if !self.get([0, 1, 2].map(|k| cell[k] + step[k])) {
                    for face in &cube.faces[2 * side..2 * side + 2] {
                        let first = soup.positions.len() as u32;
                        soup.positions.extend(face.map(|v| cube.positions[v as usize]));
                        soup.faces.push([first, first + 1, first + 2]);
                    }
                }
            }
        }
        Surface::from_soup(&soup).0
    }

    /// The parts of the air in layers below `top`, with a rim of air around the block and below it.
    pub fn air_parts_below(&self, top: usize) -> AirParts {
        let size = self.size;
        let [x, y] = [size[0] + 2, size[1] + 2];
        let mut part = vec![u32::MAX; x * y * (size[2] + 2)];
        let is_air = |[i, j, k]: [usize; 3]| k < top + 1 && !self.get([i, j, k].map(|n| n as i64 - 1));
        let mut cells = std::collections::BTreeMap::new();
        for start in 0..x * y * (top + 1) {
            let cell = [start % x, start / x % y, start / x / y];
            if part[start] != u32::MAX || !is_air(cell) {
                continue;
            }
            let number = start as u32;
            part[start] = number;
            let mut stack = vec![cell];
            while let Some([i, j, k]) = stack.pop() {
                let inside = i > 0 && j > 0 && k > 0 && i <= size[0] && j <= size[1] && k <= size[2];
                if inside {
                    cells.entry(number).or_insert_with(Vec::new).push([i - 1, j - 1, k - 1]);
                }
                let around = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];
                for step in around {
                    let to = [i as i64 + step[0], j as i64 + step[1], k as i64 + step[2]];
                    if (0..3).any(|n| to[n] < 0 || to[n] > size[n] as i64 + 1) {
                        continue;
                    }
                    let to = to.map(|n| n as usize);
                    let at = padded(size, to);
                    if part[at] == u32::MAX && is_air(to) {
                        part[at] = number;
                        stack.push(to);
                    }
                }
            }
        }
        AirParts { size, outside: part[0], part, cells }
    }
}
