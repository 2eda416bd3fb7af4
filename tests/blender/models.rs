//! Test meshes and their measurements.

use std::collections::BTreeMap;

use glam::DVec3;
use meshmend::mesh::Soup;

/// An axis-parallel box with outward faces.
pub fn cuboid(low: DVec3, high: DVec3) -> Soup {
    let corner = |i: u32| {
        let pick = |bit: u32, l: f64, h: f64| if i >> bit & 1 == 1 { h } else { l };
        DVec3::new(pick(0, low.x, high.x), pick(1, low.y, high.y), pick(2, low.z, high.z))
    };
    let sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    Soup {
        positions: (0..8).map(corner).collect(),
        faces: sides.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect(),
    }
}

/// The soup with every face flipped.
pub fn flipped(mut soup: Soup) -> Soup {
    soup.faces.iter_mut().for_each(|face| face.swap(1, 2));
    soup
}

/// The soup divided by `size`, so that its volume stays in the range of f64.
pub fn sized(soup: &Soup, size: f64) -> Soup {
    Soup { positions: soup.positions.iter().map(|&position| position / size).collect(), faces: soup.faces.clone() }
}

/// All parts as one soup.
pub fn joined(parts: &[Soup]) -> Soup {
    let mut all = Soup::default();
    for part in parts {
        let first = u32::try_from(all.positions.len()).unwrap();
        all.positions.extend(&part.positions);
        all.faces.extend(part.faces.iter().map(|face| face.map(|v| v + first)));
    }
    all
}

/// Two unit cubes that share an eighth, so that their union has a volume of 1.875; `size` and `place` move them.
pub fn overlapping_cubes(size: f64, place: DVec3) -> Soup {
    let cube = |low: f64| cuboid(place + DVec3::splat(low * size), place + DVec3::splat((low + 1.0) * size));
    joined(&[cube(0.0), cube(0.5)])
}

/// Whether every edge joins exactly two faces that run through it in opposite directions.
pub fn is_closed(soup: &Soup) -> bool {
    let mut edges: BTreeMap<(u32, u32), [u32; 2]> = BTreeMap::new();
    for &[a, b, c] in &soup.faces {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            edges.entry((from.min(to), from.max(to))).or_default()[usize::from(from > to)] += 1;
        }
    }
    !edges.is_empty() && edges.values().all(|&both| both == [1, 1])
}

/// The enclosed volume, positive where faces look outward.
pub fn volume(soup: &Soup) -> f64 {
    let origin = soup.positions.first().copied().unwrap_or_default();
    let cone = |face: usize| {
        let [a, b, c] = soup.corners(face).map(|corner| corner - origin);
        a.dot(b.cross(c)) / 6.0
    };
    (0..soup.faces.len()).map(cone).sum()
}

/// Low and high corner of the bounding box.
pub fn bounds(soup: &Soup) -> (DVec3, DVec3) {
    soup.positions.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &p| (low.min(p), high.max(p)))
}
