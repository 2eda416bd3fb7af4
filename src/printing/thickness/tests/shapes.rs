//! Solids with known walls: blocks of a grid, and bodies of revolution; turned, scaled, and with faces split.

use std::collections::HashMap;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use crate::context::{Context, NoProgress};
use crate::mesh::Surface;
use glam::{DQuat, DVec3};

pub fn surface(positions: Vec<DVec3>, faces: Vec<[u32; 3]>) -> Surface {
    let source = (0..faces.len() as u32).collect();
    Surface { positions, faces, source }
}

/// Welds corners at equal positions.
pub fn welded(triangles: &[[DVec3; 3]]) -> Surface {
    let mut index = HashMap::new();
    let mut positions = Vec::new();
    let mut faces = Vec::new();
    for triangle in triangles {
        let face = triangle.map(|p| {
            *index.entry((p + 0.0).to_array().map(f64::to_bits)).or_insert_with(|| {
                positions.push(p);
                positions.len() as u32 - 1
            })
        });
        if face[0] != face[1] && face[1] != face[2] && face[2] != face[0] {
            faces.push(face);
        }
    }
    surface(positions, faces)
}

/// The solid of the grid's filled cells.
pub fn blocks(x: &[f64], y: &[f64], z: &[f64], is_filled: impl Fn(usize, usize, usize) -> bool) -> Surface {
    let filled = |i: isize, j: isize, k: isize| {
        i >= 0
            && j >= 0
            && k >= 0
            && (i as usize) < x.len() - 1
            && (j as usize) < y.len() - 1
            && (k as usize) < z.len() - 1
            && is_filled(i as usize, j as usize, k as usize)
    };
    let mut triangles = Vec::new();
    for i in 0..x.len() as isize - 1 {
        for j in 0..y.len() as isize - 1 {
            for k in 0..z.len() as isize - 1 {
                if !filled(i, j, k) {
                    continue;
                }
                let at = |a: isize, b: isize, c: isize| {
                    DVec3::new(x[(i + a) as usize], y[(j + b) as usize], z[(k + c) as usize])
                };
                let mut quad = |a: DVec3, b: DVec3, c: DVec3, d: DVec3| {
                    triangles.push([a, b, c]);
                    triangles.push([a, c, d]);
                };
                if !filled(i - 1, j, k) {
                    quad(at(0, 0, 0), at(0, 0, 1), at(0, 1, 1), at(0, 1, 0));
                }
                if !filled(i + 1, j, k) {
                    quad(at(1, 0, 0), at(1, 1, 0), at(1, 1, 1), at(1, 0, 1));
                }
                if !filled(i, j - 1, k) {
                    quad(at(0, 0, 0), at(1, 0, 0), at(1, 0, 1), at(0, 0, 1));
                }
                if !filled(i, j + 1, k) {
                    quad(at(0, 1, 0), at(0, 1, 1), at(1, 1, 1), at(1, 1, 0));
                }
                if !filled(i, j, k - 1) {
                    quad(at(0, 0, 0), at(0, 1, 0), at(1, 1, 0), at(1, 0, 0));
                }
                if !filled(i, j, k + 1) {
                    quad(at(0, 0, 1), at(1, 0, 1), at(1, 1, 1), at(0, 1, 1));
                }
            }
        }
    }
    welded(&triangles)
}

pub fn cuboid(size: [f64; 3]) -> Surface {
    blocks(&[0.0, size[0]], &[0.0, size[1]], &[0.0, size[2]], |_, _, _| true)
}

/// The body of a closed outline of (radius, height), counter-clockwise with the radius to the right, turned around z.
pub fn revolved(outline: &[[f64; 2]], n: usize) -> Surface {
    let at = |[r, z]: [f64; 2], i: usize| {
        let angle = std::f64::consts::TAU * (i % n) as f64 / n as f64;
        DVec3::new(r * angle.cos(), r * angle.sin(), z)
    };
    let mut triangles = Vec::new();
    for (k, &a) in outline.iter().enumerate() {
        let b = outline[(k + 1) % outline.len()];
        for i in 0..n {
            let [p, q, r, s] = [at(a, i), at(a, i + 1), at(b, i + 1), at(b, i)];
            triangles.push([p, q, r]);
            triangles.push([p, r, s]);
        }
    }
    welded(&triangles)
}

pub fn prism(n: usize, inradius: f64, height: f64) -> Surface {
    let r = inradius / (std::f64::consts::PI / n as f64).cos();
    revolved(&[[0.0, 0.0], [r, 0.0], [r, height], [0.0, height]], n)
}

pub fn torus(large: f64, small: f64, n: usize, m: usize) -> Surface {
    let outline: Vec<[f64; 2]> = (0..m)
        .map(|i| {
            let angle = std::f64::consts::TAU * i as f64 / m as f64;
            [large + small * angle.cos(), small * angle.sin()]
        })
        .collect();
    revolved(&outline, n)
}

/// Numbers in [0, 1).
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let mut x = self.0;
        x ^= x >> 33;
        x = x.wrapping_mul(0xff51_afd7_ed55_8ccd);
        x ^= x >> 33;
        (x >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }

    pub fn below(&mut self, n: usize) -> usize {
        (self.next() * n as f64) as usize
    }
}

pub fn turned(mut surface: Surface, random: &mut Random) -> Surface {
    let q = DQuat::from_xyzw(
        random.between(-1.0, 1.0),
        random.between(-1.0, 1.0),
        random.between(-1.0, 1.0),
        random.between(-1.0, 1.0),
    )
    .normalize();
    surface.positions.iter_mut().for_each(|p| *p = q * *p);
    surface
}

pub fn scaled(mut surface: Surface, factor: f64) -> Surface {
    surface.positions.iter_mut().for_each(|p| *p *= factor);
    surface
}

/// Splits random edges at random points, both faces of each.
pub fn split(mut surface: Surface, times: usize, random: &mut Random) -> Surface {
    for _ in 0..times {
        let f = random.below(surface.faces.len());
        let i = random.below(3);
        let (a, b) = (surface.faces[f][i], surface.faces[f][(i + 1) % 3]);
        let middle = surface.positions.len() as u32;
        let (p, q) = (surface.positions[a as usize], surface.positions[b as usize]);
        surface.positions.push(p.lerp(q, random.between(0.25, 0.75)));
        for g in 0..surface.faces.len() {
            let face = surface.faces[g];
            let at = (0..3).find(|&i| {
                let (x, y) = (face[i], face[(i + 1) % 3]);
                (x, y) == (a, b) || (x, y) == (b, a)
            });
            if let Some(i) = at {
                let (x, y, z) = (face[i], face[(i + 1) % 3], face[(i + 2) % 3]);
                surface.faces[g] = [x, middle, z];
                surface.faces.push([middle, y, z]);
                surface.source.push(surface.source[g]);
            }
        }
    }
    surface
}

pub fn joined(mut a: Surface, b: &Surface) -> Surface {
    let offset = a.positions.len() as u32;
    a.positions.extend(&b.positions);
    a.faces.extend(b.faces.iter().map(|f| f.map(|v| v + offset)));
    a.source.extend(&b.source);
    a
}

pub fn moved(mut surface: Surface, by: DVec3) -> Surface {
    surface.positions.iter_mut().for_each(|p| *p += by);
    surface
}

pub fn flipped(mut surface: Surface) -> Surface {
    surface.faces.iter_mut().for_each(|f| f.swap(1, 2));
    surface
}

pub fn with_context<T>(run: impl FnOnce(&Context<'_>) -> T) -> T {
    let cancel = AtomicBool::new(false);
    let clock = || Duration::ZERO;
    run(&Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(1)))
}
