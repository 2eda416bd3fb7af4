//! Known solids, and damage to them that depends only on a seed.

use std::collections::BTreeSet;

use glam::DVec3;
use meshmend::mesh::Soup;

use crate::meshes::{as_f32, cube, inside_out, join, push, sphere, torus};

/// Pseudo-random numbers (SplitMix64, Steele et al. 2014).
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub fn below(&mut self, n: usize) -> usize {
        (self.next() % n as u64) as usize
    }

    /// A vector within [-1, 1] along each axis.
    pub fn vector(&mut self) -> DVec3 {
        let mut one = || (self.next() >> 11) as f64 / (1u64 << 52) as f64 - 1.0;
        DVec3::new(one(), one(), one())
    }
}

/// A damaged mesh, and the properties of the solid that it was.
#[derive(Debug, Clone)]
pub struct Damaged {
    pub soup: Soup,
    /// The volume of the solid.
    pub volume: f64,
    /// The number of closed surfaces that bound the solid.
    pub parts: u64,
    /// The largest volume change that the damage may cause.
    pub slack: f64,
}

/// Makes an undamaged solid.
type Make = fn() -> Damaged;

/// Makers of solids, by name.
pub const SOLIDS: [(&str, Make); 10] = [
    ("cube", || known(cube(DVec3::ZERO, 2.0, 4), 1)),
    ("torus", || known(torus(3.0, 1.0, 20, 12), 1)),
    ("ball", || known(sphere(DVec3::ONE, 2.0, 16, 8), 1)),
    ("L-prism", || known(cells(&[(0, 0, 0), (1, 0, 0), (0, 1, 0)], 2), 1)),
    ("box with a cavity", || known(join(&cube(DVec3::ZERO, 4.0, 4), &inside_out(cube(DVec3::ONE, 2.0, 3))), 2)),
    ("nested", || {
        let shell = join(&cube(DVec3::ZERO, 6.0, 4), &inside_out(cube(DVec3::ONE, 4.0, 4)));
        known(join(&shell, &cube(DVec3::splat(2.0), 2.0, 3)), 3)
    }),
    ("touching in a face", || known(join(&cube(DVec3::ZERO, 1.0, 3), &cube(DVec3::X, 1.0, 3)), 1)),
    ("touching in an edge", || known(join(&cube(DVec3::ZERO, 1.0, 3), &cube(DVec3::new(1.0, 1.0, 0.0), 1.0, 3)), 2)),
    ("touching in a vertex", || known(join(&cube(DVec3::ZERO, 1.0, 3), &cube(DVec3::ONE, 1.0, 3)), 2)),
    ("apart", || {
        let two = join(&torus(3.0, 1.0, 16, 8), &cube(DVec3::new(6.0, 0.0, 0.0), 1.0, 3));
        known(join(&two, &sphere(DVec3::new(0.0, 0.0, 5.0), 1.0, 12, 6)), 3)
    }),
];

fn known(soup: Soup, parts: u64) -> Damaged {
    let soup = as_f32(soup);
    let volume = (0..soup.faces.len()).map(|f| soup.corners(f)).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum();
    Damaged { soup, volume, parts, slack: 1e-4 * volume }
}

/// A solid of unit cubes on a grid, with `n` quads along each edge.
fn cells(at: &[(i32, i32, i32)], n: u32) -> Soup {
    let mut soup = Soup::default();
    for &(x, y, z) in at {
        let low = DVec3::new(f64::from(x), f64::from(y), f64::from(z));
        let one = cube(low, 1.0, n);
        for f in 0..one.faces.len() {
            let corners = one.corners(f);
            let [a, b, c] = corners;
            let beyond = ((a + b + c) / 3.0 + (b - a).cross(c - a).normalize() * 0.5).floor();
            if !at.contains(&(beyond.x as i32, beyond.y as i32, beyond.z as i32)) {
                push(&mut soup, corners);
            }
        }
    }
    soup
}

/// Does `amount` of damage at random places.
pub type Damage = fn(&mut Damaged, amount: usize, random: &mut Random);

/// Kinds of damage, by name.
pub const DAMAGES: [(&str, Damage); 5] = [
    ("faces removed", remove_faces),
    ("patches flipped", flip_patches),
    ("faces doubled", double_faces),
    ("walls without thickness", double_walls),
    ("order shuffled", shuffle),
];

/// Removes faces, no two of which share a vertex.
fn remove_faces(on: &mut Damaged, amount: usize, random: &mut Random) {
    let soup = &mut on.soup;
    let key = |p: DVec3| p.to_array().map(f64::to_bits);
    let (mut gone, mut around) = (BTreeSet::new(), BTreeSet::new());
    for _ in 0..amount {
        let f = random.below(soup.faces.len());
        let corners = soup.corners(f);
        if corners.iter().any(|&p| around.contains(&key(p))) {
            continue;
        }
        around.extend(corners.map(key));
        gone.insert(f);
        let [a, b, c] = corners;
        let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
        on.slack += (b - a).cross(c - a).length() / 2.0 * longest;
    }
    let mut f = 0;
    soup.faces.retain(|_| {
        f += 1;
        !gone.contains(&(f - 1))
    });
}

/// Flips the faces around some points.
fn flip_patches(on: &mut Damaged, amount: usize, random: &mut Random) {
    let soup = &mut on.soup;
    for _ in 0..amount.min(3) {
        let centre = soup.corners(random.below(soup.faces.len()))[0];
        for f in 0..soup.faces.len() {
            let [a, b, c] = soup.corners(f);
            if centre.distance((a + b + c) / 3.0) < 0.5 {
                soup.faces[f].swap(1, 2);
            }
        }
    }
}

/// Duplicates some faces.
fn double_faces(on: &mut Damaged, amount: usize, random: &mut Random) {
    for _ in 0..amount {
        let corners = on.soup.corners(random.below(on.soup.faces.len()));
        push(&mut on.soup, corners);
    }
}

/// Puts two faces of opposite orientation onto some faces.
fn double_walls(on: &mut Damaged, amount: usize, random: &mut Random) {
    for _ in 0..amount {
        let [a, b, c] = on.soup.corners(random.below(on.soup.faces.len()));
        push(&mut on.soup, [a, b, c]);
        push(&mut on.soup, [a, c, b]);
    }
}

/// Reorders the faces and rotates the corners of each.
fn shuffle(on: &mut Damaged, _: usize, random: &mut Random) {
    let faces = &mut on.soup.faces;
    for f in (1..faces.len()).rev() {
        faces.swap(f, random.below(f + 1));
        faces[f].rotate_left(random.below(3));
    }
}

/// Kinds of damage that tear the surface open along lines.
pub const TEARS: [(&str, Damage); 2] =
    [("split along paths and jittered", split_along_paths), ("T-junctions", t_junctions)];

/// The largest displacement of a crack's side along each axis.
const JITTER: f64 = 2e-4;

/// Tears the surface along planes near some points: corners on one side move, equal positions by the same amount.
fn split_along_paths(on: &mut Damaged, amount: usize, random: &mut Random) {
    let soup = &mut on.soup;
    let area: f64 =
        (0..soup.faces.len()).map(|f| soup.corners(f)).map(|[a, b, c]| (b - a).cross(c - a).length() / 2.0).sum();
    on.slack += 4.0 * JITTER * area;
    for _ in 0..amount.min(2) {
        let centre = soup.corners(random.below(soup.faces.len()))[0];
        let normal = (random.vector() + DVec3::splat(0.01)).normalize();
        // Faces behind the plane move where they touch faces in front of it.
        let near = |[a, b, c]: [DVec3; 3]| centre.distance((a + b + c) / 3.0) < 1.2;
        let behind = |[a, b, c]: [DVec3; 3]| ((a + b + c) / 3.0 - centre).dot(normal) < 0.0;
        let key = |p: DVec3| p.to_array().map(f64::to_bits);
        let faces: Vec<[DVec3; 3]> = (0..soup.faces.len()).map(|f| soup.corners(f)).collect();
        let before: BTreeSet<_> = faces.iter().filter(|&&t| near(t) && !behind(t)).flatten().map(|&p| key(p)).collect();
        let far: BTreeSet<_> = faces.iter().filter(|&&t| !near(t)).flatten().map(|&p| key(p)).collect();
        let mut moved = std::collections::BTreeMap::new();
        for (f, corners) in faces.iter().enumerate().filter(|&(_, &t)| near(t) && behind(t)) {
            for (i, &p) in corners.iter().enumerate() {
                if before.contains(&key(p)) && !far.contains(&key(p)) {
                    let to = *moved.entry(key(p)).or_insert_with(|| p + random.vector() * JITTER);
                    let v = soup.faces[f][i] as usize;
                    soup.positions[v] = to.as_vec3().as_dvec3();
                }
            }
        }
    }
}

/// Splits some faces at the middle of an edge, but not the neighbours across it.
fn t_junctions(on: &mut Damaged, amount: usize, random: &mut Random) {
    let soup = &mut on.soup;
    for _ in 0..amount {
        let f = random.below(soup.faces.len());
        let [a, b, c] = soup.corners(f);
        let middle = ((a + b) / 2.0).as_vec3().as_dvec3();
        if middle == a || middle == b {
            continue;
        }
        let corner = soup.faces[f][1] as usize;
        soup.positions[corner] = middle;
        push(soup, [middle, b, c]);
    }
}
