//! Arrangements of solids with whole corners, where everything coincides.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use glam::{DVec3, IVec3};
use meshmend::arrange::{ArrangeError, Arrangement, Exact, WindingRule};
use meshmend::context::{Context, NoProgress};
use meshmend::math::{collinear, winding_exact};
use meshmend::mesh::{ClosedSurface, Edges, Soup, Surface};

/// Most solids: what each meets may be all others.
const MOST: usize = 12;
/// Each coordinate is below.
const SIDE: u8 = 8;

/// Reads boxes and tetrahedra, turned either way, from the bytes, and asks what is inside of them.
///
/// # Panics
/// Where the result is not closed, or has another inside than the solids at some point.
pub fn arrange(bytes: &[u8]) {
    let mut soup = Soup::default();
    for it in bytes.chunks_exact(13).take(MOST) {
        let corner = |i: usize| IVec3::from([0, 1, 2].map(|k| i32::from(it[1 + 3 * i + k] % SIDE)));
        if it[0] & 1 == 0 {
            add_box(&mut soup, corner(0), corner(1), it[0] & 2 != 0);
        } else {
            add_tetrahedron(&mut soup, [0, 1, 2, 3].map(corner), it[0] & 2 != 0);
        }
    }
    if soup.faces.is_empty() {
        return;
    }
    let (surface, _) = Surface::from_soup(&soup);
    let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::MAX);
    let closed = ClosedSurface::try_from(&surface).expect("boxes and tetrahedra are closed");
    for rule in [WindingRule::Positive, WindingRule::Nonzero, WindingRule::Odd] {
        match Exact.solid(closed, None, rule.into(), &context) {
            Ok(made) => hold_to_its_word(&soup, &made.surface, rule),
            Err(ArrangeError::Empty) => hold_to_its_word(&soup, &Surface::default(), rule),
            Err(error) => panic!("{error}"),
        }
    }
}

fn hold_to_its_word(soup: &Soup, made: &Surface, rule: WindingRule) {
    for half_edges in Edges::new(&made.faces).iter() {
        let forward = half_edges.iter().filter(|&&h| Edges::is_forward(&made.faces, h)).count();
        assert_eq!(2 * forward, half_edges.len(), "{rule:?}: an edge is not used as often both ways");
    }
    // Points in no plane of the lattice, an uneven way apart.
    let steps = (0..5).map(|i| f64::from(SIDE) * (f64::from(i) + 0.381_966) / 5.0);
    let points = steps.clone().flat_map(|x| {
        let steps = steps.clone();
        steps.clone().flat_map(move |y| steps.clone().map(move |z| DVec3::new(x, y * 1.013, z * 0.991)))
    });
    for p in points {
        let asked = winding_exact(p, (0..soup.faces.len()).map(|f| soup.corners(f)));
        let got = winding_exact(p, (0..made.faces.len()).map(|f| made.corners(f)));
        // On a wall it is neither.
        if (asked - asked.round()).abs() > 1e-6 {
            continue;
        }
        let expected = match rule {
            WindingRule::Positive => asked > 0.5,
            WindingRule::Nonzero => asked.abs() > 0.5,
            WindingRule::Odd => asked.round().rem_euclid(2.0) == 1.0,
        };
        assert!((got - f64::from(u8::from(expected))).abs() < 1e-6, "{rule:?} at {p}: {got} instead of {expected}");
    }
}

fn add(soup: &mut Soup, corners: &[IVec3], faces: &[[usize; 3]], turned: bool) {
    let at = |i: usize| corners[i].as_dvec3();
    if faces.iter().any(|&[a, b, c]| collinear(at(a), at(b), at(c))) {
        return;
    }
    let first = soup.positions.len() as u32;
    soup.positions.extend(corners.iter().map(|p| p.as_dvec3()));
    for &[a, b, c] in faces {
        let face = if turned { [a, c, b] } else { [a, b, c] };
        soup.faces.push(face.map(|i| first + i as u32));
    }
}

/// The box between two corners; none where it is flat.
fn add_box(soup: &mut Soup, p: IVec3, q: IVec3, turned: bool) {
    let (low, high) = (p.min(q), p.max(q));
    let corners: Vec<IVec3> =
        (0..8).map(|i| IVec3::from([0, 1, 2].map(|k| if i >> k & 1 == 1 { high[k] } else { low[k] }))).collect();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let faces: Vec<[usize; 3]> = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    add(soup, &corners, &faces, turned);
}

/// A tetrahedron, which may be flat.
fn add_tetrahedron(soup: &mut Soup, [a, b, c, d]: [IVec3; 4], turned: bool) {
    let outward = (b - a).cross(c - a).dot(d - a) < 0;
    add(soup, &[a, b, c, d], &[[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]], outward == turned);
}
