//! Shapes with known walls: plates, pins, tubes, wedges, fins, also turned.

use std::f64::consts::TAU;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use crate::context::{Context, NoProgress, Progress, Stage, monotonic_clock};
use crate::math::Precision;
use crate::mesh::{ClosedSurface, Edges, NotClosed, Soup, Surface, position_key};
use glam::{DQuat, DVec3};

use super::LayerUnion;
use crate::printing::shapes::cuboid;
use crate::printing::thickening::{Growth, PlaceResult, Thickened, Thickening, ThickeningError};

fn thickened(surface: &Surface, settings: Thickening) -> Result<Thickened, ThickeningError> {
    thickened_with(&NoProgress, surface, settings)
}

fn thickened_with(
    progress: &dyn Progress,
    surface: &Surface,
    settings: Thickening,
) -> Result<Thickened, ThickeningError> {
    let (clock, cancel) = (monotonic_clock(), AtomicBool::new(false));
    let closed = ClosedSurface::try_from(surface).unwrap();
    settings.apply(closed, &LayerUnion, &Context::new(progress, &cancel, &clock, Duration::from_secs(60)))
}

/// The milliseconds that a thickening last expected to go on.
#[derive(Default)]
struct Remaining(AtomicU64);

impl Progress for Remaining {
    fn report(&self, _stage: Stage, _tier: Option<u8>, _percent: u8) {}
    fn log(&self, _line: &str) {}
    fn expect_remaining(&self, remaining: Duration) {
        self.0.store(u64::try_from(remaining.as_millis()).unwrap(), Ordering::Relaxed);
    }
}

fn both(min_wall: f64) -> Thickening {
    Thickening { min_wall, growth: Growth::Both, min_gap: 0.0, precision: Precision::F32 }
}

/// A surface in f32; turned if `turn` is not 0.
fn surface(positions: Vec<DVec3>, faces: Vec<[u32; 3]>, turn: f64) -> Surface {
    let turned = DQuat::from_axis_angle(DVec3::new(1.0, -2.0, 0.7).normalize(), turn);
    let offset = DVec3::new(3.1, -2.2, 5.7) * turn;
    let positions = positions.into_iter().map(|p| Precision::F32.round(turned * p + offset)).collect();
    Surface::from_soup(&Soup { positions, faces }).0
}

/// A prism over a polygon that is triangulated already.
fn prism(polygon: &[[f64; 2]], triangles: &[[u32; 3]], height: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let n = u32::try_from(polygon.len()).unwrap();
    let at = |z: f64| polygon.iter().map(move |&[x, y]| DVec3::new(x, y, z));
    let mut faces: Vec<[u32; 3]> = triangles.iter().flat_map(|&[a, b, c]| [[a, c, b], [a + n, b + n, c + n]]).collect();
    faces.extend((0..n).flat_map(|i| {
        let j = (i + 1) % n;
        [[i, j, n + j], [i, n + j, n + i]]
    }));
    (at(0.0).chain(at(height)).collect(), faces)
}

fn convex_prism(polygon: &[[f64; 2]], height: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let triangles: Vec<[u32; 3]> = (2..u32::try_from(polygon.len()).unwrap()).map(|i| [0, i - 1, i]).collect();
    prism(polygon, &triangles, height)
}

fn plate(thickness: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    convex_prism(&[[0.0, 0.0], [10.0, 0.0], [10.0, 7.0], [0.0, 7.0]], thickness)
}

fn circle(count: u32, radius: f64) -> Vec<[f64; 2]> {
    (0..count).map(|i| TAU * f64::from(i) / f64::from(count)).map(|a| [radius * a.cos(), radius * a.sin()]).collect()
}

/// A fin of thickness 0.6 on a block.
fn fin() -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let outline = [[0.0, 0.0], [10.0, 0.0], [10.0, 3.0], [5.3, 3.0], [5.3, 8.0], [4.7, 8.0], [4.7, 3.0], [0.0, 3.0]];
    prism(&outline, &[[0, 1, 2], [0, 2, 3], [0, 3, 6], [0, 6, 7], [3, 4, 5], [3, 5, 6]], 6.0)
}

fn tube(outer: f64, inner: f64, height: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let n = 32;
    let ring = |radius, z| circle(n, radius).into_iter().map(move |[x, y]| DVec3::new(x, y, z));
    let positions =
        ring(outer, 0.0).chain(ring(inner, 0.0)).chain(ring(outer, height)).chain(ring(inner, height)).collect();
    let quad = |[a, b, c, d]: [u32; 4]| [[a, b, c], [a, c, d]];
    let faces = (0..n).flat_map(|i| {
        let j = (i + 1) % n;
        [[i, j, j + 2 * n, i + 2 * n], [j + n, i + n, i + 3 * n, j + 3 * n]]
            .into_iter()
            .chain([[j, i, i + n, j + n], [i + 2 * n, j + 2 * n, j + 3 * n, i + 3 * n]])
            .flat_map(quad)
    });
    (positions, faces.collect())
}

#[test]
fn a_plate_grows_to_the_wall_and_its_sides_stay() {
    for turn in [0.0, 1.0] {
        let (positions, faces) = plate(0.6);
        let plate = surface(positions, faces, turn);
        let done = thickened(&plate, both(1.0)).unwrap();
        assert!(done.is_proved(), "{:?}", done.places);
        assert!((done.added_volume - 70.0 * 0.4).abs() < 0.01 * 28.0, "{}", done.added_volume);
        assert!(done.max_deviation < 0.2 * 1.05);
        let kept = done.surface.faces.len() - done.added_faces.len();
        assert_eq!(kept, 8, "the faces of the four sides");
    }
}

#[test]
fn pins_tubes_wedges_and_fins_reach_the_wall() {
    let wedge = convex_prism(&[[0.0, 0.0], [10.0, 0.0], [10.0, 3.0]], 5.0);
    let taper = convex_prism(&[[0.0, 0.0], [20.0, 0.0], [20.0, 2.0], [0.0, 0.4]], 6.0);
    let pin = |n| convex_prism(&circle(n, 0.3), 8.0);
    for (name, shape) in [
        ("pin", pin(4)),
        ("hexagon", pin(6)),
        ("round", pin(24)),
        ("tube", tube(5.0, 4.4, 8.0)),
        ("wedge", wedge),
        ("taper", taper),
        ("fin", fin()),
    ] {
        for turn in [0.0, 1.0] {
            let solid = surface(shape.0.clone(), shape.1.clone(), turn);
            let done = thickened(&solid, both(1.0)).unwrap();
            assert!(done.is_proved(), "{name} turned by {turn}: {:?}", done.places);
            // Balls have half of the least wall and their margin as radius.
            assert!(done.added_volume > 0.0 && done.max_deviation < 0.7, "{name} {}", done.max_deviation);
        }
    }
}

#[test]
fn faces_far_from_the_thin_place_keep_their_bits() {
    let (positions, faces) = fin();
    let solid = surface(positions, faces, 1.0);
    let done = thickened(&solid, both(1.0)).unwrap();
    let keys = |surface: &Surface, face: usize| surface.corners(face).map(position_key);
    let after: Vec<_> =
        (0..done.surface.faces.len()).map(|f| (keys(&done.surface, f), done.surface.source[f])).collect();
    // The vertices of the fin move, also within the planes beside its sides. All others stay.
    let left: Vec<_> = done.surface.positions.iter().map(|&p| position_key(p)).collect();
    let stays = |&f: &usize| keys(&solid, f).iter().all(|key| left.contains(key));
    let stay: Vec<usize> = (0..solid.faces.len()).filter(stays).collect();
    assert!(stay.len() >= 8, "{} of {}", stay.len(), solid.faces.len());
    assert!(stay.into_iter().all(|f| after.contains(&(keys(&solid, f), solid.source[f]))));
}

#[test]
fn outward_growth_keeps_the_inside_of_a_tube() {
    let (positions, faces) = tube(5.0, 4.4, 8.0);
    let solid = surface(positions, faces, 0.0);
    let done = thickened(&solid, Thickening { growth: Growth::Outward, ..both(1.0) }).unwrap();
    assert!(done.is_proved(), "{:?}", done.places);
    let radius = |p: &DVec3| p.x.hypot(p.y);
    let least = done.surface.positions.iter().map(radius).fold(f64::INFINITY, f64::min);
    assert!((least - 4.4).abs() < 1e-5, "{least}");
    let inward = thickened(&solid, Thickening { growth: Growth::Inward, ..both(1.0) }).unwrap();
    let most = inward.surface.positions.iter().map(radius).fold(0.0, f64::max);
    assert!(inward.is_proved() && (most - 5.0).abs() < 1e-5, "{most}");
}

#[test]
fn a_gap_stays_and_the_other_side_grows() {
    let (mut positions, mut faces) = plate(0.6);
    let (above, more) = plate(0.6);
    positions.extend(above.into_iter().map(|p| p + DVec3::Z));
    faces.extend(more.iter().map(|face| face.map(|v| v + 8)));
    let solid = surface(positions, faces, 0.0);
    let done = thickened(&solid, Thickening { min_gap: 0.3, ..both(1.0) }).unwrap();
    assert!(done.is_proved(), "{:?}", done.places);
    let heights = done.surface.positions.iter().map(|p| p.z);
    let gap = |z: f64| z > 0.62 && z < 0.98;
    let inner: Vec<f64> = heights.filter(|&z| gap(z)).collect();
    assert!(inner.iter().all(|z| (z - 0.65).abs() < 1e-6 || (z - 0.95).abs() < 1e-6), "{inner:?}");
}

#[test]
fn a_solid_inside_the_material_of_another_stays_as_it_is() {
    let mut all = cuboid(DVec3::ZERO, DVec3::new(10.0, 10.0, 0.6));
    let inner = cuboid(DVec3::new(2.0, 2.0, 0.2), DVec3::new(8.0, 8.0, 0.4));
    all.append(inner.clone());
    let done = thickened(&all, both(1.0)).unwrap();
    assert!(done.is_proved(), "{:?}", done.places);
    let keys = |surface: &Surface| (0..surface.faces.len()).map(|f| surface.face_key(f)).collect::<Vec<_>>();
    let (of_inner, of_result) = (keys(&inner), keys(&done.surface));
    assert!(of_inner.iter().all(|key| of_result.contains(key)));
    assert!((done.added_volume - 40.0).abs() < 0.4, "{}", done.added_volume);
}

#[test]
fn a_thick_solid_stays_and_thickening_twice_changes_nothing() {
    let (positions, faces) = plate(2.0);
    let thick = surface(positions, faces, 1.0);
    let done = thickened(&thick, both(1.0)).unwrap();
    assert_eq!((done.is_proved(), done.places.len(), done.surface), (true, 0, thick));
    let (positions, faces) = plate(0.5);
    let once = thickened(&surface(positions, faces, 1.0), both(1.0)).unwrap();
    let twice = thickened(&once.surface, both(1.0)).unwrap();
    assert_eq!(twice.surface, once.surface);
}

#[test]
fn unusable_settings_and_open_surfaces_are_errors() {
    let (positions, mut faces) = plate(0.6);
    let plate = surface(positions.clone(), faces.clone(), 0.0);
    faces.pop();
    let open = surface(positions, faces, 0.0);
    assert!(matches!(ClosedSurface::try_from(&open), Err(NotClosed)));
    for min_wall in [0.0, f64::NAN, -1.0, f64::INFINITY] {
        assert!(matches!(thickened(&plate, both(min_wall)), Err(ThickeningError::Settings { .. })));
    }
}

/// A curved sheet of 4 by 4 and many faces. Its upper side is a copy of the lower one, moved by the thickness, and moved more
/// or less by at most the roughness. The middle has a square hole of as many thirds.
fn curved_sheet(thickness: f64, roughness: f64, hole: u32) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let n = 12;
    let open = 5..5 + hole;
    let at = |i: u32, j: u32, z: f64| {
        let [x, y] = [i, j].map(|k| 4.0 * f64::from(k) / f64::from(n));
        DVec3::new(x, y, z + 0.1 * (x - 2.0).powi(2))
    };
    let m = n + 1;
    let side = |z| (0..m * m).map(move |k| at(k % m, k / m, z));
    let rough = (0u32..).map(|k| DVec3::Z * roughness * ((f64::from(k) * 12.9898).sin() * 43_758.545_3).sin());
    let upper = side(thickness).zip(rough).map(|(p, more)| p + more);
    let positions: Vec<DVec3> = side(0.0).chain(upper).collect();
    let (low, high) = (|i: u32, j: u32| i + m * j, |i: u32, j: u32| m * m + i + m * j);
    let quad = |[a, b, c, d]: [u32; 4]| [[a, b, c], [a, c, d]];
    let mut faces = Vec::new();
    for k in open.clone() {
        let (from, to) = (open.start, open.end);
        faces.extend(quad([low(k, from), high(k, from), high(k + 1, from), low(k + 1, from)]));
        faces.extend(quad([low(k, to), low(k + 1, to), high(k + 1, to), high(k, to)]));
        faces.extend(quad([low(from, k), low(from, k + 1), high(from, k + 1), high(from, k)]));
        faces.extend(quad([low(to, k), high(to, k), high(to, k + 1), low(to, k + 1)]));
    }
    let is_open = |&(i, j): &(u32, u32)| open.contains(&i) && open.contains(&j);
    for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))).filter(|at| !is_open(at)) {
        faces.extend(quad([high(i, j), high(i + 1, j), high(i + 1, j + 1), high(i, j + 1)]));
        faces.extend(quad([low(i, j), low(i, j + 1), low(i + 1, j + 1), low(i + 1, j)]));
    }
    for i in 0..n {
        faces.extend(quad([low(i, 0), low(i + 1, 0), high(i + 1, 0), high(i, 0)]));
        faces.extend(quad([low(i + 1, n), low(i, n), high(i, n), high(i + 1, n)]));
        faces.extend(quad([low(0, i + 1), low(0, i), high(0, i), high(0, i + 1)]));
        faces.extend(quad([low(n, i), low(n, i + 1), high(n, i + 1), high(n, i)]));
    }
    (positions, faces)
}

#[test]
fn a_spike_without_a_thin_wall_gets_material_at_its_tip() {
    let n = 24;
    let base = circle(n, 0.9).into_iter().map(|[x, y]| DVec3::new(x, y, 0.0));
    let positions: Vec<DVec3> = base.chain([DVec3::Z * 10.0]).collect();
    let mut faces: Vec<[u32; 3]> = (2..n).map(|i| [0, i, i - 1]).collect();
    faces.extend((0..n).map(|i| [i, (i + 1) % n, n]));
    let spike = surface(positions, faces, 1.0);
    let grown = |growth: Growth| {
        let done = thickened(&spike, Thickening { growth, ..both(1.0) }).unwrap();
        (done.places.iter().map(|place| place.result).collect::<Vec<_>>(), done.added_volume)
    };
    // A spike has no inner side.
    for growth in [Growth::Both, Growth::Outward, Growth::Inward] {
        let (results, added) = grown(growth);
        assert!(!results.is_empty() && results.iter().all(|result| *result == PlaceResult::Proved), "{results:?}");
        // A rod of the wall's diameter along the thin upper part needs 2.9 more; the balls are up to 20 % larger.
        assert!((2.9..6.5).contains(&added), "{growth:?}: {added}");
    }
}

/// A ridge of length 3 and height 2, the half angle of which grows from 10 to 30 degrees along it.
fn opening_ridge() -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let n = 4;
    let section = |i: u32| {
        let share = f64::from(i) / f64::from(n);
        let half = 2.0 * (10.0 + 20.0 * share).to_radians().tan();
        [DVec3::new(0.0, 3.0 * share, 2.0), DVec3::new(-half, 3.0 * share, 0.0), DVec3::new(half, 3.0 * share, 0.0)]
    };
    let sides = (0..3 * n).step_by(3).flat_map(|at| {
        let [top, left, right] = [at, at + 1, at + 2];
        let ridge =
            [[top, top + 3, left], [top + 3, left + 3, left], [top, right, top + 3], [top + 3, right, right + 3]];
        ridge.into_iter().chain([[left, left + 3, right], [left + 3, right + 3, right]])
    });
    ((0..=n).flat_map(section).collect(), sides.chain([[0, 1, 2], [3 * n, 3 * n + 2, 3 * n + 1]]).collect())
}

#[test]
fn a_ridge_that_is_sharp_at_one_end_is_thickened() {
    let (positions, faces) = opening_ridge();
    let done = thickened(&surface(positions, faces, 0.0), both(0.3)).unwrap();
    assert!(!done.places.is_empty() && done.places.iter().all(|place| place.result == PlaceResult::Proved));
    assert!(done.max_deviation < 1.25 * 0.3, "{}", done.max_deviation);
}

#[test]
fn a_curved_sheet_of_many_faces_is_thickened() {
    let (positions, faces) = curved_sheet(0.5, 0.0, 0);
    let sheet = surface(positions, faces, 1.0);
    let done = thickened(&sheet, both(1.0)).unwrap();
    assert!(done.is_proved(), "{:?}", done.places);
    assert!(done.max_deviation < 0.7, "{}", done.max_deviation);
    // The least volume is 16 * 0.5, without the balls' overhang at the rim.
    assert!((7.5..14.0).contains(&done.added_volume), "{}", done.added_volume);
}

#[test]
fn walls_of_many_faces_are_expected_to_take_long() {
    let (positions, faces) = plate(0.5);
    let (sheet_positions, sheet_faces) = curved_sheet(0.3, 0.2, 0);
    let expected = [surface(positions, faces, 0.0), surface(sheet_positions, sheet_faces, 1.0)].map(|solid| {
        let remaining = Remaining::default();
        thickened_with(&remaining, &solid, both(1.0)).unwrap();
        remaining.0.into_inner()
    });
    assert_eq!(expected[0], 0);
    assert!((500..10_000).contains(&expected[1]), "{expected:?}");
}

#[test]
fn only_a_hole_narrower_than_the_least_gap_is_closed() {
    let euler = |surface: &Surface| surface.euler_characteristic(&Edges::new(&surface.faces));
    // Holes of 0.33 and 0.67.
    for (hole, roughness, closed) in [(1, 0.2, 1), (2, 0.15, 0)] {
        let (positions, faces) = curved_sheet(0.3, roughness, hole);
        let sheet = surface(positions, faces, 1.0);
        assert_eq!(euler(&sheet), 0, "one through hole");
        let done = thickened(&sheet, Thickening { min_gap: 0.5, ..both(1.0) }).unwrap();
        assert_eq!(done.through_holes_closed, closed);
        assert!(done.added_volume > 10.0, "{}", done.added_volume);
        assert!(done.is_proved(), "{:?}", done.places);
        assert!(closed == 1 || euler(&done.surface) <= 0, "the hole is open");
    }
}
