//! Meshes with known defects, and equivalent representations of a mesh.

use glam::DVec3;
use meshmend::inspect::DefectKind;
use meshmend::mesh::{Soup, Surface};

use crate::meshes::{cube, inside_out, join, push};
use DefectKind as K;

/// The same triangles with shared vertices.
pub fn indexed(soup: &Soup) -> Soup {
    Surface::from_soup(soup).0.to_soup()
}

pub fn vertex_at(soup: &Soup, at: DVec3) -> u32 {
    u32::try_from(soup.positions.iter().position(|&p| p == at).unwrap()).unwrap()
}

/// The faces that have all of these positions as corners.
pub fn faces_with(soup: &Soup, corners: &[DVec3]) -> Vec<usize> {
    let has = |f: &usize| corners.iter().all(|c| soup.corners(*f).contains(c));
    (0..soup.faces.len()).filter(has).collect()
}

/// A unit cube with 8 by 8 cells on each side; the cell corners on its top are `top(i, j)`.
pub fn block() -> Soup {
    indexed(&cube(DVec3::ZERO, 1.0, 8))
}

pub fn top(i: u32, j: u32) -> DVec3 {
    DVec3::new(f64::from(i) / 8.0, f64::from(j) / 8.0, 1.0)
}

/// The block with its top cut open along three cells, and one side of the cut moved by `gap`.
pub fn cut(gap: f64) -> Soup {
    let mut soup = block();
    for i in [3, 4] {
        let old = vertex_at(&soup, top(i, 4));
        let new = u32::try_from(soup.positions.len()).unwrap();
        soup.positions.push(top(i, 4) + DVec3::Y * gap);
        for face in &mut soup.faces {
            let above = face.iter().any(|&v| soup.positions[v as usize].y > 0.5)
                && face.iter().all(|&v| soup.positions[v as usize].y >= 0.5 && soup.positions[v as usize].z == 1.0);
            if above {
                *face = face.map(|v| if v == old { new } else { v });
            }
        }
    }
    soup
}

/// The block with a vertex on an edge of its top that only one of the two faces uses, moved by `off` into that face.
/// Returns the vertex too, and the face that would close the gap.
pub fn with_t_junction(off: f64) -> (Soup, DVec3, [DVec3; 3]) {
    let mut soup = block();
    let [a, b] = [top(3, 4), top(4, 4)];
    let f = faces_with(&soup, &[a, b])[0];
    let face = soup.faces[f];
    let c = face.into_iter().find(|&v| ![a, b].contains(&soup.positions[v as usize])).unwrap();
    let way = (soup.positions[c as usize] - a) * DVec3::Y;
    let m = (a + b) * 0.5 + way.normalize() * off;
    let new = u32::try_from(soup.positions.len()).unwrap();
    soup.positions.push(m);
    let [a, b] = [a, b].map(|p| vertex_at(&soup, p));
    soup.faces[f] = face.map(|v| if v == a { new } else { v });
    soup.faces.push(face.map(|v| if v == b { new } else { v }));
    let cap = face.map(|v| if v == c { m } else { soup.positions[v as usize] });
    (soup, m, cap)
}

/// The block with an inner vertex of its top pulled across two edges, so that two faces are upside down.
pub fn folded() -> Soup {
    let mut soup = block();
    let v = vertex_at(&soup, top(4, 4));
    soup.positions[v as usize] = DVec3::new(5.5 / 8.0, 0.5, 1.0);
    soup
}

/// Two coincident layers of a rectangle, joined along the border, each a fan around a different point.
pub fn pouch() -> Soup {
    let border: Vec<DVec3> = (0..14)
        .map(|i| match i {
            0..3 => DVec3::new(f64::from(i), 0.0, 0.0),
            3..7 => DVec3::new(3.0, f64::from(i - 3), 0.0),
            7..10 => DVec3::new(f64::from(10 - i), 4.0, 0.0),
            _ => DVec3::new(0.0, f64::from(14 - i), 0.0),
        })
        .collect();
    let mut soup = Soup::default();
    for i in 0..14 {
        let [a, b] = [border[i], border[(i + 1) % 14]];
        push(&mut soup, [a, b, DVec3::new(1.75, 2.25, 0.0)]);
        push(&mut soup, [b, a, DVec3::new(1.25, 0.5, 0.0)]);
    }
    soup
}

pub fn with_face(mut soup: Soup, face: [DVec3; 3]) -> Soup {
    push(&mut soup, face);
    soup
}

pub fn without(mut soup: Soup, face: usize) -> Soup {
    soup.faces.remove(face);
    soup
}

pub fn flipped(mut soup: Soup, face: usize) -> Soup {
    soup.faces[face].swap(1, 2);
    soup
}

/// A name, a mesh, and the count of each kind of defect in it.
pub type Damaged = (&'static str, Soup, Vec<(DefectKind, u64)>);

/// A mesh for every kind of damage, with the defects to find in it.
pub fn damaged() -> Vec<Damaged> {
    let unit = || cube(DVec3::ZERO, 1.0, 2);
    let corner = unit().corners(9);
    let turned = [corner[0], corner[2], corner[1]];
    let half = DVec3::splat(0.25);
    let shell = |size: f64| cube(DVec3::splat(0.5 - size / 2.0), size, 2);
    let fin = [top(0, 0), top(1, 0), DVec3::new(0.0, -1.0, 2.0)];
    let mut not_a_number = unit();
    not_a_number.positions[30].y = f64::NAN;
    let needle = with_face(unit(), [corner[0], corner[0], corner[1]]);
    let (open, _, cap) = with_t_junction(0.0);
    let capped = with_face(open.clone(), cap);
    vec![
        ("two holes", without(without(block(), 400), 100), vec![(K::Hole, 2)]),
        ("a face the wrong way", flipped(unit(), 7), vec![(K::MisorientedEdge, 3)]),
        (
            "a face beside a hole the wrong way",
            flipped(without(block(), 200), 200),
            vec![(K::MisorientedEdge, 2), (K::Hole, 1)],
        ),
        ("a face twice", with_face(unit(), corner), vec![(K::DuplicateFace, 1), (K::NonManifoldEdge, 3)]),
        (
            "a face with an opposite one",
            with_face(unit(), turned),
            vec![(K::OppositeFace, 1), (K::NonManifoldEdge, 3), (K::Sheet, 1)],
        ),
        (
            "a face three times, once the other way",
            with_face(with_face(unit(), turned), corner),
            vec![(K::DuplicateFace, 1), (K::OppositeFace, 1), (K::NonManifoldEdge, 3), (K::Sheet, 1)],
        ),
        ("a pinch", join(&unit(), &cube(DVec3::ONE, 0.5, 1)), vec![(K::NonManifoldVertex, 1), (K::Disjoint, 1)]),
        ("three faces on an edge", with_face(block(), fin), vec![(K::NonManifoldEdge, 1), (K::Hole, 1)]),
        ("a slit", cut(1e-9), vec![(K::Slit, 1), (K::Hole, 1)]),
        ("a crack", cut(5e-5), vec![(K::Crack, 1), (K::Hole, 1)]),
        ("a gap too wide for a crack", cut(5e-3), vec![(K::Hole, 1)]),
        ("a T-junction", open, vec![(K::TJunction, 1), (K::Hole, 1)]),
        ("a near T-junction", with_t_junction(1e-8).0, vec![(K::TJunction, 1), (K::Hole, 1)]),
        ("a cap", capped, vec![(K::FlatFace, 1)]),
        ("a face with a vertex twice", needle, vec![(K::DegenerateFace, 1), (K::FlatFace, 1)]),
        ("a fold", folded(), vec![(K::Foldover, 1)]),
        ("a pouch", pouch(), vec![(K::Sheet, 1)]),
        (
            "touching walls",
            join(&cube(DVec3::ZERO, 1.0, 1), &cube(DVec3::new(1.0, 0.25, 0.25), 0.5, 1)),
            vec![(K::Sheet, 1), (K::Disjoint, 1)],
        ),
        ("a cavity", join(&shell(1.0), &inside_out(shell(0.5))), vec![(K::InnerShell, 1), (K::Disjoint, 1)]),
        ("a solid in a solid", join(&shell(1.0), &shell(0.5)), vec![(K::InnerShell, 1), (K::Disjoint, 1)]),
        (
            "a solid in a cavity, inside out",
            join(&join(&shell(1.0), &inside_out(shell(0.5))), &inside_out(shell(0.25))),
            vec![(K::InnerShell, 1), (K::InvertedPart, 1), (K::Disjoint, 2)],
        ),
        ("inside out", inside_out(unit()), vec![(K::InvertedPart, 1)]),
        ("overlapping parts", join(&unit(), &cube(half, 0.9, 1)), vec![(K::Disjoint, 1)]),
        ("a tiny part", join(&unit(), &cube(DVec3::splat(2.0), 1e-4, 1)), vec![(K::TinyPart, 1), (K::Disjoint, 1)]),
        ("a corner that is no number", not_a_number, vec![(K::Corrupt, 1), (K::Hole, 1)]),
    ]
}

/// An equivalent mesh: faces reordered, corners rotated, turned by right angles and scaled.
pub struct Variant {
    pub soup: Soup,
    /// For each face, its index in the original mesh.
    pub was: Vec<u32>,
}

pub fn variant(soup: &Soup, seed: u64, turns: usize, power: i32) -> Variant {
    let mut was: Vec<u32> = (0..u32::try_from(soup.faces.len()).unwrap()).collect();
    let mut state = seed;
    let mut random = |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    for i in (1..was.len()).rev() {
        was.swap(i, random(i + 1));
    }
    let mut faces: Vec<[u32; 3]> = was.iter().map(|&f| soup.faces[f as usize]).collect();
    faces.iter_mut().for_each(|face| face.rotate_left(random(3)));
    Variant { soup: Soup { positions: soup.positions.iter().map(|&p| moved(p, turns, power)).collect(), faces }, was }
}

pub fn moved(p: DVec3, turns: usize, power: i32) -> DVec3 {
    let p = match turns % 4 {
        0 => p,
        1 => DVec3::new(-p.y, p.x, p.z),
        2 => DVec3::new(-p.x, -p.y, p.z),
        _ => DVec3::new(p.y, -p.x, p.z),
    };
    let p = match turns / 4 % 3 {
        0 => p,
        1 => DVec3::new(p.z, p.x, p.y),
        _ => DVec3::new(p.y, p.z, p.x),
    };
    p * 2f64.powi(power)
}

/// For each face the first with the same corners in the same order, since equal faces cannot be distinguished.
pub fn first_equal_face(soup: &Soup) -> Vec<u32> {
    let mut first = std::collections::BTreeMap::new();
    (0u32..)
        .zip(&soup.faces)
        .map(|(f, face)| {
            let mut key = face.map(|v| soup.positions[v as usize].to_array().map(|x| (x + 0.0).to_bits()));
            let least = (0..3).min_by_key(|&k| key[k]).unwrap();
            key.rotate_left(least);
            *first.entry(key).or_insert(f)
        })
        .collect()
}
