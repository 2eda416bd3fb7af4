//! Comparison with a measurement at many points of every face, against every other face.

use glam::DVec3;

use crate::math::{hit, r2};
use crate::mesh::Surface;
use crate::printing::thickness::facing::Least;

use super::shapes::*;
use super::*;

/// The least perpendicular chord from points of each face to an opposed face, by testing all faces.
fn least_rays(surface: &Surface, points: usize) -> Vec<f64> {
    let normal = |f: usize| surface.area_vector(f).normalize();
    let count = surface.faces.len();
    (0..count)
        .map(|f| {
            let [a, b, c] = surface.corners(f);
            let n = normal(f);
            let mut least = f64::INFINITY;
            for i in 0..points {
                let [u, v] = r2(i as f64 + 1.0);
                let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                let p = a + (b - a) * u + (c - a) * v;
                let first = (0..count)
                    .filter(|&h| h != f)
                    .filter_map(|h| hit(p, -n * 100.0, surface.corners(h)).map(|t| (t * 100.0, h)))
                    .filter(|hit| hit.0 > 1e-9)
                    .min_by(|x, y| x.0.total_cmp(&y.0));
                if let Some((distance, h)) = first
                    && n.dot(normal(h)) <= -0.8
                {
                    least = least.min(distance);
                }
            }
            least
        })
        .collect()
}

/// A random solid: a bumpy ball, cylinder or ring, whose walls have all angles.
fn lump(random: &mut Random) -> Surface {
    let n = 5 + random.below(9);
    let k = 3 + random.below(6);
    let mut outline: Vec<[f64; 2]> = (0..k)
        .map(|i| {
            let angle = std::f64::consts::TAU * i as f64 / k as f64;
            let r = random.between(0.2, 1.5);
            [2.0 + r * angle.cos(), r * angle.sin()]
        })
        .collect();
    if random.next() < 0.3 {
        outline.reverse();
        let low = outline.iter().fold(f64::INFINITY, |m, p| m.min(p[1])) - random.between(0.1, 1.0);
        let high = outline.iter().fold(f64::NEG_INFINITY, |m, p| m.max(p[1])) + random.between(0.1, 1.0);
        let r = outline.iter().fold(0.0f64, |m, p| m.max(p[0])) + random.between(0.3, 1.0);
        let cover = revolved(&[[0.0, low], [r, low], [r, high], [0.0, high]], n);
        return joined(cover, &revolved(&outline, n));
    }
    revolved(&outline, n)
}

#[test]
fn no_face_is_thicker_than_a_brute_force_search_finds_it() {
    let mut random = Random(11);
    let (mut thin, mut tight) = (0, 0);
    for _ in 0..16 {
        let lump = lump(&mut random);
        let lump = split(turned(lump, &mut random), 10, &mut random);
        let limit = random.between(0.3, 2.0);
        for side in [Space::Material, Space::Air] {
            let seen = if side == Space::Air { flipped(lump.clone()) } else { lump.clone() };
            let found = search(&lump, limit, side);
            let mut of_face = vec![f64::INFINITY; lump.faces.len()];
            for pair in found.walls.iter().chain(&found.tips) {
                let least = &mut of_face[pair.faces[0] as usize];
                *least = least.min(pair.thickness);
            }
            for (f, rays) in least_rays(&seen, 30).into_iter().enumerate() {
                if rays < limit {
                    assert!(of_face[f] <= rays * (1.0 + 1e-9), "{f} {} {rays} {side:?}", of_face[f]);
                    thin += 1;
                    tight += u32::from(of_face[f] > rays * 0.5);
                }
            }
        }
    }
    assert!(thin > 200 && tight > thin / 2, "{thin} {tight}");
}

#[test]
fn no_chord_at_a_concave_edge_or_corner_is_missed() {
    let mut random = Random(13);
    let mut at_concave = 0;
    for _ in 0..24 {
        let lump = split(turned(lump(&mut random), &mut random), 10, &mut random);
        for side in [Space::Material, Space::Air] {
            let prepared = Prepared::new(&lump, side);
            let limit = 4.0 * prepared.scale;
            let found = with_context(|context| prepared.thinnest(limit, context).unwrap());
            let faces = || (0u32..).take(lump.faces.len()).filter(|&f| prepared.normal(f) != DVec3::ZERO);
            let wall = |f: &u32| found[*f as usize].wall.map_or(f64::INFINITY, |(_, chord)| chord.thickness);
            for f in faces().filter(|&f| prepared.spread[f as usize] > 0.0) {
                for h in faces().filter(|&h| h != f) {
                    let chord = match prepared.least_concave([f, h], limit, &mut u64::MAX.clone()) {
                        Least::Found(chord) if !prepared.is_tip([f, h], &chord, &mut u64::MAX.clone()) => chord,
                        _ => continue,
                    };
                    // It is enough that the search finds the chord from one of the faces at its ends.
                    let ends = [(f, chord.points[0]), (h, chord.points[1])];
                    let around = ends.iter().flat_map(|&(face, point)| prepared.faces_at(face, point));
                    let least = around.map(|face| wall(&face)).fold(f64::INFINITY, f64::min);
                    assert!(least <= chord.thickness, "{f} {h} {least} {chord:?} {side:?}");
                    at_concave += u32::from(wall(&f) == chord.thickness);
                }
            }
        }
    }
    assert!(at_concave > 100, "{at_concave}");
}

#[test]
fn chords_lie_inside_and_are_not_shorter_than_measured() {
    let mut random = Random(12);
    for _ in 0..40 {
        let lump = turned(lump(&mut random), &mut random);
        let found = search(&lump, 1.5, Space::Material);
        for pair in found.walls {
            let [p, q] = pair.points;
            let middle = (p + q) / 2.0;
            let winding = crate::math::winding_exact(
                middle + (middle - p).any_orthonormal_vector() * 1e-9,
                (0..lump.faces.len()).map(|f| lump.corners(f)),
            );
            assert!(winding > 0.2, "{winding} {pair:?}");
            assert!(pair.thickness >= pair.distance * (1.0 - 1e-9));
            assert!(pair.distance >= pair.thickness * 0.9);
            for (face, point) in pair.faces.into_iter().zip(pair.points) {
                let on = crate::math::nearest_on_triangle(point, lump.corners(face as usize));
                assert!(on.distance(point) < 1e-9);
            }
        }
    }
}

#[test]
fn the_result_is_the_same_for_any_number_of_threads_and_order() {
    let mut random = Random(13);
    let lump = split(turned(lump(&mut random), &mut random), 200, &mut random);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| search(&lump, 1.5, Space::Material))
    };
    let one = run(1);
    assert!(!one.walls.is_empty());
    assert_eq!(one, run(3));
    let mut reversed = lump.clone();
    reversed.faces.reverse();
    let other = search(&reversed, 1.5, Space::Material);
    assert_eq!(one.walls.len(), other.walls.len());
    let last = lump.faces.len() as u32 - 1;
    for (a, b) in one.walls.iter().zip(other.walls.iter().rev()) {
        assert_eq!(a.faces[0], last - b.faces[0]);
        assert!((a.thickness - b.thickness).abs() < 1e-9 * a.thickness);
    }
}
