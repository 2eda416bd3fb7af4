//! Tests of the operator that makes machine-made skins solid.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use super::*;
use crate::context::NoProgress;
use crate::math::Tree;
use crate::mesh::{ClosedSurface, Edges, Soup};
use crate::printing::shapes::{cuboid, joined};
use crate::printing::skin::{DoubleShell, recognise_double_shell};

/// A ball of triangles, as an octahedron whose faces are split `level` times.
fn ball(centre: DVec3, radius: f64, level: u32) -> Vec<[DVec3; 3]> {
    let mut faces = Vec::new();
    for [x, y, z] in (0..8).map(|k| [0, 1, 2].map(|axis| if k >> axis & 1 == 0 { 1.0 } else { -1.0 })) {
        let corners = [DVec3::X * x, DVec3::Y * y, DVec3::Z * z];
        let [a, b, c] = corners;
        faces.push(if x * y * z > 0.0 { [a, b, c] } else { [a, c, b] });
    }
    for _ in 0..level {
        let split = |[a, b, c]: [DVec3; 3]| {
            let [ab, bc, ca] = [(a + b).normalize(), (b + c).normalize(), (c + a).normalize()];
            [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        };
        faces = faces.into_iter().flat_map(split).collect();
    }
    faces.into_iter().map(|face| face.map(|p| Precision::F32.round(centre + p * radius))).collect()
}

fn inverted(faces: Vec<[DVec3; 3]>) -> Vec<[DVec3; 3]> {
    faces.into_iter().map(|[a, b, c]| [a, c, b]).collect()
}

fn surface(triangles: &[[DVec3; 3]]) -> Surface {
    let faces = (0..triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    Surface::from_soup(&Soup { positions: triangles.concat(), faces }).0
}

fn with_context<T>(run: impl FnOnce(&Context<'_>) -> T) -> T {
    let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
    run(&Context::new(&NoProgress, &cancel, &clock, Duration::MAX))
}

fn skin(surface: &Surface, options: SkinOptions) -> SkinResult {
    with_context(|context| solid_skin(surface, &options, context)).unwrap()
}

fn volume(surface: &Surface) -> f64 {
    signed_volume(surface, DVec3::ZERO)
}

/// A ball of radius 1 as two skins 0.012 apart, made of [`ball`]s of that level, with crumbs inside and outside. Both skins
/// lack the faces with the numbers for which `is_missing` answers.
fn pierced_shell(level: u32, is_missing: fn(usize) -> bool) -> Vec<[DVec3; 3]> {
    let pierced =
        |faces: Vec<[DVec3; 3]>| (0..faces.len()).filter(|&i| !is_missing(i)).map(|i| faces[i]).collect::<Vec<_>>();
    let crumbs = [ball(DVec3::splat(0.2), 0.01, 1), ball(DVec3::splat(1.2), 0.01, 1)].concat();
    [pierced(ball(DVec3::ZERO, 1.0, level)), pierced(inverted(ball(DVec3::ZERO, 0.988, level))), crumbs].concat()
}

/// The same of finer skins, with 21 pinholes in both skins if `is_pierced`.
fn double_shell(is_pierced: bool) -> Vec<[DVec3; 3]> {
    pierced_shell(4, if is_pierced { |i| i % 100 == 7 } else { |_| false })
}

#[test]
fn a_double_shell_with_pinholes_becomes_the_solid() {
    let model = surface(&double_shell(true));
    let solid = volume(&surface(&ball(DVec3::ZERO, 1.0, 4)));
    let result = skin(&model, SkinOptions { seal: Some(0.1), ..SkinOptions::default() });
    let outcome = &result.surface;
    assert!(ClosedSurface::new(outcome, &Edges::new(&outcome.faces)).is_ok());
    assert!((volume(outcome) / solid - 1.0).abs() < 1e-3, "{}", volume(outcome) / solid);
    assert_eq!(result.sealed.len(), 21);
    assert!(result.sealed.iter().all(|place| place.edges == 3 && place.width < 0.1));
    assert_eq!(outcome.source.iter().filter(|&&source| !is_generated(source)).count(), 2027 + 32);
    let count = |reason| result.dropped.iter().filter(|piece| piece.reason == reason).count();
    assert_eq!([DropReason::InnerShell, DropReason::InnerJunk, DropReason::Sheet].map(count), [1, 1, 0]);
    let of_input: Vec<[DVec3; 3]> = (0..model.faces.len()).map(|f| model.corners(f)).collect();
    for (f, &source) in outcome.source.iter().enumerate().filter(|(_, source)| !is_generated(**source)) {
        assert_eq!(outcome.corners(f), of_input[source as usize]);
    }
}

#[test]
fn a_double_shell_is_filled_where_its_missing_faces_are_wider_than_any_seal() {
    // A face is 5 % of the diagonal wide. Some missing faces touch in a vertex, others share an edge.
    let model = surface(&pierced_shell(3, |i| [4, 5, 70, 71].contains(&(i % 128))));
    let found = with_context(|context| recognised(&model, context)).unwrap();
    assert!(found.is_some_and(|shell| shell.void_share > 0.9), "{found:?}");
    let outcome = skin(&model, SkinOptions::default()).surface;
    let solid = volume(&surface(&ball(DVec3::ZERO, 1.0, 3)));
    assert!(ClosedSurface::new(&outcome, &Edges::new(&outcome.faces)).is_ok());
    assert!((volume(&outcome) / solid - 1.0).abs() < 1e-2, "{}", volume(&outcome) / solid);
    assert_eq!(outcome.source.iter().filter(|&&source| !is_generated(source)).count(), 512 - 16 + 32);
    // A narrower seal that the caller chose does not close them.
    let narrow = SkinOptions { seal: Some(0.02), ..SkinOptions::default() };
    let refused = with_context(|context| solid_skin(&model, &narrow, context));
    assert!(matches!(refused, Err(SkinError::Wide { width, .. }) if width > 0.1), "{refused:?}");
}

#[test]
fn a_mouth_with_few_edges_is_no_missing_face() {
    // Without the four faces around its top, the ball is a bowl with a mouth of four edges, 22 % of the diagonal wide.
    let top = ball(DVec3::ZERO, 1.0, 2).iter().map(|face| face.iter().any(|p| p.z == 1.0)).collect::<Vec<_>>();
    let open = |radius: f64| {
        let faces = ball(DVec3::ZERO, radius, 2).into_iter().zip(&top).filter(|(_, is_top)| !**is_top);
        faces.map(|(face, _)| face).collect::<Vec<_>>()
    };
    let model = surface(&[open(1.0), inverted(open(0.988))].concat());
    assert_eq!(with_context(|context| recognised(&model, context)), Ok(None));
}

/// A ball of unit cubes, hollow but for a layer one cube thick, without one in 37 of the outer and of the inner triangles. Also the
/// number of outer triangles, and the volume of the solid ball.
fn stepped_shell(radius: i32) -> (Vec<[DVec3; 3]>, usize, f64) {
    let is_solid = move |[x, y, z]: [i32; 3]| x * x + y * y + z * z < radius * radius;
    let beside = |cell: [i32; 3], axis: usize, step: i32| {
        let mut other = cell;
        other[axis] += step;
        other
    };
    let sides = || (0..3).flat_map(|axis| [(axis, -1), (axis, 1)]);
    let is_wall = |cell: [i32; 3]| is_solid(cell) && sides().any(|(axis, step)| !is_solid(beside(cell, axis, step)));
    let range = || -radius..=radius;
    let cells = || range().flat_map(move |x| range().flat_map(move |y| range().map(move |z| [x, y, z])));
    let (mut outer, mut inner) = (Vec::new(), Vec::new());
    for cell in cells().filter(|&cell| is_wall(cell)) {
        for (axis, step) in sides().filter(|&(axis, step)| !is_wall(beside(cell, axis, step))) {
            let unit = |k: usize| DVec3::AXES[(axis + k) % 3];
            let corner = DVec3::from(cell.map(f64::from)) + unit(0) * f64::from(step.max(0));
            let mut square = [corner, corner + unit(1), corner + unit(1) + unit(2), corner + unit(2)];
            if step < 0 {
                square.swap(1, 3);
            }
            let [a, b, c, d] = square;
            let of = if is_solid(beside(cell, axis, step)) { &mut inner } else { &mut outer };
            of.extend([[a, b, c], [a, c, d]]);
        }
    }
    let pierced = |faces: Vec<[DVec3; 3]>| -> Vec<_> {
        (0..).zip(faces).filter(|(i, _)| i % 37 != 7).map(|(_, face)| face).collect()
    };
    let solid = cells().filter(|&cell| is_solid(cell)).count();
    let outer = pierced(outer);
    let count = outer.len();
    ([outer, pierced(inner)].concat(), count, solid as f64)
}

#[test]
fn pockets_behind_pinholes_in_steps_are_filled() {
    let (triangles, outer, solid) = stepped_shell(14);
    let result = skin(&surface(&triangles), SkinOptions { seal: Some(3.4), ..SkinOptions::default() });
    let outcome = &result.surface;
    assert!((volume(outcome) / solid - 1.0).abs() < 0.01, "{}", volume(outcome) / solid);
    let kept = outcome.source.iter().filter(|&&source| (source as usize) < outer).count();
    assert!(kept as f64 > 0.98 * outer as f64, "{kept} of {outer}");
}

#[test]
fn a_pinhole_at_an_edge_with_four_faces_is_closed() {
    let cubes = [0.0, 1.0].map(|at| cuboid(DVec3::new(at, at, 0.0), DVec3::new(at + 1.0, at + 1.0, 1.0)));
    let mut model = joined(&cubes);
    let at_edge = |face: &[u32; 3]| {
        let ends = face.iter().filter(|&&v| model.positions[v as usize].truncate() == glam::DVec2::ONE);
        ends.count() == 2
    };
    let pierced = model.faces.iter().position(at_edge).unwrap();
    model.faces.remove(pierced);
    model.source.remove(pierced);
    let Closed { surface, sealed, open_pct, .. } =
        with_context(|context| close(model, Precision::F32, context)).unwrap();
    assert_eq!((sealed.len(), open_pct), (1, 0.0));
    assert!((volume(&surface) - 2.0).abs() < 1e-12, "{}", volume(&surface));
}

#[test]
fn a_double_shell_of_steps_is_recognised_by_its_thinnest_places() {
    // One cell is 1.1 % of the diagonal, so rays along the normals are too long, but the steps are closer together.
    let (triangles, ..) = stepped_shell(26);
    let model = surface(&triangles);
    let found = with_context(|context| recognised(&model, context)).unwrap();
    assert!(found.is_some_and(|shell| (0.2..1.0).contains(&shell.median_wall)), "{found:?}");
}

#[test]
fn a_closed_double_shell_is_filled_and_recognised() {
    let model = surface(&double_shell(false));
    let found = with_context(|context| recognised(&model, context)).unwrap().unwrap();
    assert!((found.median_wall - 0.012).abs() < 1e-3 && found.void_share > 0.9, "{found:?}");
    let result = skin(&model, SkinOptions { seal: Some(0.1), ..SkinOptions::default() });
    assert_eq!((result.surface.faces.len(), result.sealed.len()), (2048 + 32, 0));
}

#[test]
fn the_skin_of_a_solid_is_the_solid() {
    for triangles in [ball(DVec3::ZERO, 1.0, 3), inverted(ball(DVec3::ONE, 2.0, 2))] {
        let model = surface(&triangles);
        let result = skin(&model, SkinOptions { seal: Some(0.1), ..SkinOptions::default() });
        assert_eq!((result.surface.faces.len(), result.dropped.len()), (model.faces.len(), 0));
        assert_eq!(result.surface.source, model.source);
        assert!(volume(&result.surface) > 0.0 && result.kept_exactly_pct > 99.999_999);
        assert_eq!(with_context(|context| recognised(&model, context)), Ok(None));
    }
}

#[test]
fn an_opening_wider_than_the_seal_stays_open() {
    // A ball without its top: a bowl with a wall 0.1 thick, closed by a rim.
    let bowl = |radius: f64| {
        ball(DVec3::ZERO, radius, 4).into_iter().filter(move |face| face.iter().any(|p| p.z < 0.3 * radius))
    };
    let mut triangles: Vec<[DVec3; 3]> = bowl(1.0).collect();
    triangles.extend(inverted(bowl(0.9).collect()));
    let open = surface(&triangles);
    let result = skin(&open, SkinOptions { seal: Some(0.3), ..SkinOptions::default() });
    // The gap between the skins is narrower than the seal and gets closed; the bowl stays hollow.
    let thick = 2.0 * std::f64::consts::PI * (1.0 - 0.9f64.powi(3)) / 3.0;
    assert!(volume(&result.surface) < 2.0 * thick, "{} {thick}", volume(&result.surface));
    assert!(result.surface.faces.len() > open.faces.len() * 9 / 10);
}

#[test]
fn a_sheet_encloses_nothing() {
    let sheet = surface(&[[DVec3::ZERO, DVec3::X, DVec3::Y], [DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::Y]]);
    let result = with_context(|context| solid_skin(&sheet, &SkinOptions::default(), context));
    assert!(matches!(result, Err(SkinError::Empty(_))), "{result:?}");
    let empty = with_context(|context| solid_skin(&Surface::default(), &SkinOptions::default(), context));
    assert!(empty.is_err());
}

/// Whether a model is a double shell.
fn recognised(model: &Surface, context: &Context<'_>) -> Result<Option<DoubleShell>, Cancelled> {
    recognise_double_shell(&model.positions, &model.faces, &Tree::new(&model.positions, &model.faces), context)
}
