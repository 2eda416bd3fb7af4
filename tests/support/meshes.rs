//! Small meshes, and simple changes to them.

use glam::DVec3;
use meshmend::mesh::Soup;

/// An axis-parallel box with `n` cells along each side, outward.
pub fn cube(low: DVec3, size: f64, n: u32) -> Soup {
    let mut soup = Soup::default();
    let at = |k: usize, side: f64, u: f64, v: f64| {
        let mut p = DVec3::ZERO;
        p[k] = side;
        p[(k + 1) % 3] = u;
        p[(k + 2) % 3] = v;
        low + p * size
    };
    let step = |i: u32| f64::from(i) / f64::from(n);
    for k in 0..3 {
        for side in [0.0, 1.0] {
            for i in 0..n {
                for j in 0..n {
                    let q =
                        [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)].map(|(i, j)| at(k, side, step(i), step(j)));
                    let q = if side > 0.5 { q } else { [q[0], q[3], q[2], q[1]] };
                    push(&mut soup, [q[0], q[1], q[2]]);
                    push(&mut soup, [q[0], q[2], q[3]]);
                }
            }
        }
    }
    soup
}

/// An axis-parallel box with sides of these lengths and `n` cells along each side, outward.
pub fn cuboid(low: DVec3, sides: DVec3, n: u32) -> Soup {
    let mut soup = cube(DVec3::ZERO, 1.0, n);
    soup.positions.iter_mut().for_each(|p| *p = low + *p * sides);
    soup
}

/// A torus of `n` by `m` quads around the z axis, outward.
pub fn torus(big: f64, small: f64, n: u32, m: u32) -> Soup {
    let at = |i: u32, j: u32| {
        let u = f64::from(i % n) / f64::from(n) * std::f64::consts::TAU;
        let v = f64::from(j % m) / f64::from(m) * std::f64::consts::TAU;
        let r = big + small * v.cos();
        DVec3::new(r * u.cos(), r * u.sin(), small * v.sin())
    };
    grid(n, m, at)
}

/// A ball of `n` by `m` quads, with triangles at the poles, outward.
pub fn sphere(centre: DVec3, radius: f64, n: u32, m: u32) -> Soup {
    let at = |i: u32, j: u32| {
        let u = f64::from(i % n) / f64::from(n) * std::f64::consts::TAU;
        let v = (f64::from(j) / f64::from(m) - 0.5) * std::f64::consts::PI;
        let r = if j == 0 || j == m { 0.0 } else { v.cos() };
        centre + radius * DVec3::new(r * u.cos(), r * u.sin(), v.sin())
    };
    grid(n, m, at)
}

/// A wavy square sheet of `n` by `n` quads.
pub fn sheet(n: u32) -> Soup {
    grid(n, n, |i, j| DVec3::new(f64::from(i), f64::from(j), 0.3 * f64::from(i).sin()))
}

fn grid(n: u32, m: u32, at: impl Fn(u32, u32) -> DVec3) -> Soup {
    let mut soup = Soup::default();
    for i in 0..n {
        for j in 0..m {
            let q = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            for t in [[q[0], q[1], q[2]], [q[0], q[2], q[3]]] {
                if t[0] != t[1] && t[1] != t[2] && t[2] != t[0] {
                    push(&mut soup, t);
                }
            }
        }
    }
    soup
}

/// Adds a triangle with separate vertices, as in an STL file.
pub fn push(soup: &mut Soup, triangle: [DVec3; 3]) {
    let first = soup.positions.len() as u32;
    soup.positions.extend(triangle);
    soup.faces.push([first, first + 1, first + 2]);
}

/// Both meshes in one.
pub fn join(a: &Soup, b: &Soup) -> Soup {
    let mut both = a.clone();
    let offset = a.positions.len() as u32;
    both.positions.extend(&b.positions);
    both.faces.extend(b.faces.iter().map(|f| f.map(|v| v + offset)));
    both
}

/// Flips every face.
pub fn inside_out(mut soup: Soup) -> Soup {
    for face in &mut soup.faces {
        face.swap(1, 2);
    }
    soup
}

/// Rounds positions as an STL file does.
pub fn as_f32(mut soup: Soup) -> Soup {
    for p in &mut soup.positions {
        *p = p.as_vec3().as_dvec3();
    }
    soup
}

/// A cylinder around a line along z, of `n` sides, outward.
pub fn cylinder(foot: DVec3, radius: f64, height: f64, n: u32) -> Soup {
    let mut soup = Soup::default();
    let at = |i: u32, z: f64| {
        let u = f64::from(i % n) / f64::from(n) * std::f64::consts::TAU;
        foot + DVec3::new(radius * u.cos(), radius * u.sin(), z)
    };
    for i in 0..n {
        let [a, b, c, d] = [at(i, 0.0), at(i + 1, 0.0), at(i + 1, height), at(i, height)];
        push(&mut soup, [a, b, c]);
        push(&mut soup, [a, c, d]);
        push(&mut soup, [foot, b, a]);
        push(&mut soup, [foot + DVec3::Z * height, d, c]);
    }
    soup
}
