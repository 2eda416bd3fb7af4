//! Models for the tests of the command line.

use crate::files::{BOX, stl};

/// A box of side 1, moved by `by`.
pub fn moved_box(by: [f32; 3]) -> Vec<u8> {
    stl(&BOX.map(|triangle| triangle.map(|[x, y, z]| [x + by[0], y + by[1], z + by[2]])))
}

/// A box with these sides.
pub fn stretched_box(sides: [f32; 3]) -> Vec<u8> {
    stl(&BOX.map(|triangle| triangle.map(|[x, y, z]| [x * sides[0], y * sides[1], z * sides[2]])))
}

/// A sphere-like surface with this many holes of one face each, no two of which share a vertex.
pub fn sphere_with_holes(holes: usize) -> Vec<u8> {
    let (rings, around) = (20, 2 * holes);
    let point = |ring: usize, step: usize| {
        if ring == rings {
            return [0., 0., -1.];
        }
        let (a, b) = (
            std::f64::consts::PI * ring as f64 / rings as f64,
            std::f64::consts::TAU * (step % around) as f64 / around as f64,
        );
        [(a.sin() * b.cos()) as f32, (a.sin() * b.sin()) as f32, a.cos() as f32]
    };
    let mut triangles = Vec::new();
    for ring in 0..rings {
        for step in 0..around {
            let corners = [(ring, step), (ring + 1, step), (ring + 1, step + 1), (ring, step + 1)];
            let [p, q, r, s] = corners.map(|(ring, step)| point(ring, step));
            let hole = step % 2 == 0 && ring == 5 + step % 10;
            if ring + 1 < rings && !hole {
                triangles.push([p, q, r]);
            }
            if ring > 0 {
                triangles.push([p, r, s]);
            }
        }
    }
    stl(&triangles)
}
