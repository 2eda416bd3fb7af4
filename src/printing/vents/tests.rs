//! Tests of vents: what is drilled, and where.

use super::*;
use crate::arrange::{Arrangement, Exact, WindingRule};
use crate::math::Precision;
use crate::mesh::{ClosedSurface, weld_exactly};
use crate::printing::shapes::*;
use crate::printing::voids::voids_in;

/// The exact union, with all positions rounded to f32.
fn union(surface: Surface, context: &Context<'_>) -> Result<Surface, UnionError> {
    let failed = |error: String| UnionError::Failed(error);
    let closed = ClosedSurface::try_from(&surface).map_err(|e| failed(e.to_string()))?;
    let solid = Exact.solid(closed, None, WindingRule::Positive.into(), context).map_err(|e| failed(e.to_string()))?;
    let mut result = solid.surface;
    result.positions.iter_mut().for_each(|p| *p = Precision::F32.round(*p));
    weld_exactly(&mut result);
    Ok(result)
}

fn rounded(mut surface: Surface) -> Surface {
    surface.positions.iter_mut().for_each(|p| *p = Precision::F32.round(*p));
    surface
}

fn drilled(surface: &Surface, options: VentOptions) -> Vented {
    let mut result = None;
    quietly(|context| result = Some(vent_voids(surface.try_into().unwrap(), &options, &union, context).unwrap()));
    result.unwrap()
}

fn vented(surface: &Surface, diameter: f64, per_void: u32) -> Vented {
    let wall = diameter / 2.0;
    drilled(surface, VentOptions { diameter, per_void, wall, up: DVec3::Z, precision: Precision::F32 })
}

fn voids(surface: &Surface) -> usize {
    let mut count = 0;
    quietly(|context| count = voids_in(surface, context).len());
    count
}

/// The closed pockets of air by an independent flood fill over voxels of a given size: parity of crossings upward.
fn pockets(surface: &Surface, size: f64) -> usize {
    let bounds = surface.bounds();
    let n = ((bounds.max - bounds.min) / size).to_array().map(|x| x.ceil() as usize);
    let mut voxels = Voxels::empty(n);
    for i in 0..n[0] {
        for j in 0..n[1] {
            let (x, y) = (bounds.min.x + (i as f64 + 0.5031) * size, bounds.min.y + (j as f64 + 0.4973) * size);
            let mut heights: Vec<f64> = (0..surface.faces.len())
                .filter_map(|f| {
                    crate::math::hit(
                        DVec3::new(x, y, bounds.min.z - 1.0),
                        DVec3::Z * (bounds.max.z - bounds.min.z + 2.0),
                        surface.corners(f),
                    )
                })
                .map(|t| t * (bounds.max.z - bounds.min.z + 2.0) - 1.0)
                .collect();
            heights.sort_by(f64::total_cmp);
            for k in 0..n[2] {
                let z = (k as f64 + 0.5) * size;
                voxels.set([i, j, k], heights.iter().filter(|&&h| h < z).count() % 2 == 1);
            }
        }
    }
    let parts = voxels.air_parts_below(n[2] + 1);
    parts.cells.keys().filter(|&&part| part != parts.outside).count()
}

#[test]
fn a_hollow_box_gets_one_bore_straight_down_through_the_base() {
    let model = joined(&[
        cuboid(DVec3::ZERO, DVec3::new(20.0, 20.0, 20.0)),
        inverted(cuboid(DVec3::splat(2.0), DVec3::new(18.0, 18.0, 17.0))),
    ]);
    let done = vented(&model, 4.0, 1);
    assert!(done.failed.is_empty(), "{:?}", done.failed);
    let [vent] = done.vents[..] else { panic!("{:?}", done.vents) };
    assert_eq!((vent.direction, vent.void, vent.diameter), (-DVec3::Z, 0, 4.0));
    assert!((vent.length - 2.0).abs() < 1e-9 && vent.at.z.abs() < 1e-9);
    assert_eq!(voids(&done.surface), 0);
    assert_eq!([pockets(&model, 0.5), pockets(&done.surface, 0.5)], [1, 0]);
    let bore = 24.0 * (std::f64::consts::PI / 24.0).tan() * 4.0 * 2.0;
    let removed = volume(&model) - volume(&done.surface);
    assert!((removed / bore - 1.0).abs() < 1e-4, "{removed} {bore}");
}

#[test]
fn nested_dolls_get_a_chain_of_bores() {
    let radii = [12.0, 10.5, 8.0, 6.5, 4.5, 3.0];
    let shells: Vec<Surface> = (0..6u32)
        .map(|k| {
            let ball = turned(&sphere(radii[k as usize], 2), f64::from(k), DVec3::new(30.0, 1.0, -7.0));
            rounded(if k % 2 == 1 { inverted(ball) } else { ball })
        })
        .collect();
    let model = joined(&shells);
    let done = vented(&model, 1.5, 2);
    assert!(done.failed.is_empty(), "{:?}", done.failed);
    assert_eq!(done.vents.len(), 6);
    assert_eq!((voids(&model), voids(&done.surface)), (3, 0));
    assert_eq!([pockets(&model, 0.4), pockets(&done.surface, 0.4)], [3, 0]);
    for pair in done.vents.chunks(2) {
        assert_eq!(pair[0].void, pair[1].void);
        assert!(pair[0].direction.z < -0.5, "the first is on the underside: {pair:?}");
        assert!(pair[0].at.distance(pair[1].at) > 4.5, "{pair:?}");
    }
}

#[test]
fn a_diameter_that_is_no_number_is_refused() {
    quietly(|context| {
        for diameter in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let options = VentOptions { diameter, per_void: 1, wall: 1.0, up: DVec3::Z, precision: Precision::F32 };
            let result = vent_voids((&sphere(1.0, 1)).try_into().unwrap(), &options, &union, context);
            assert_eq!(result.unwrap_err(), VentError::Diameter);
        }
    });
}

#[test]
fn a_void_too_deep_for_any_bore_is_left_with_the_reason() {
    // The bore is wider than the whole model.
    let model =
        joined(&[cuboid(DVec3::ZERO, DVec3::splat(10.0)), inverted(cuboid(DVec3::splat(4.0), DVec3::splat(6.0)))]);
    let done = vented(&model, 30.0, 1);
    assert_eq!(done.failed, [(0, VentFailure::NoWay)]);
    assert_eq!(done.surface, model);
}

#[test]
fn a_union_that_fails_or_lies_leaves_the_model_as_it_was() {
    let model =
        joined(&[cuboid(DVec3::ZERO, DVec3::splat(10.0)), inverted(cuboid(DVec3::splat(2.0), DVec3::splat(8.0)))]);
    quietly(|context| {
        let options = VentOptions { diameter: 2.0, per_void: 1, wall: 1.0, up: DVec3::Z, precision: Precision::F32 };
        let fails = |_: Surface, _: &Context<'_>| Err(UnionError::Failed("no".to_owned()));
        let done = vent_voids((&model).try_into().unwrap(), &options, &fails, context).unwrap();
        assert_eq!(done.failed, [(0, VentFailure::NotSubtracted("no".to_owned()))]);
        assert_eq!(done.surface, model);
        let unchanged = model.clone();
        let lies = move |_: Surface, _: &Context<'_>| Ok(unchanged.clone());
        let done = vent_voids((&model).try_into().unwrap(), &options, &lies, context).unwrap();
        assert_eq!(done.failed, [(0, VentFailure::NotVerified(Mistake::Topology))]);
        assert_eq!(done.surface, model);
    });
}

/// A ball of 10 with up to four cavities at random places, apart from each other.
fn cheese(seed: u32) -> (Surface, usize) {
    let mut parts = vec![rounded(turned(&sphere(10.0, 2), f64::from(seed), DVec3::ZERO))];
    let mut placed: Vec<(DVec3, f64)> = Vec::new();
    for i in 0..12u32 {
        let [x, y, z] = crate::math::r3(f64::from(seed * 31 + i));
        let (at, radius) = ((DVec3::new(x, y, z) - 0.5) * 14.0, 1.0 + 2.0 * z);
        let is_free = placed.iter().all(|(other, r)| at.distance(*other) > radius + r + 0.8);
        if placed.len() < 4 && is_free && at.length() + radius < 8.5 {
            placed.push((at, radius));
            let cavity = match i % 3 {
                0 => cuboid(DVec3::splat(-0.55 * radius), DVec3::splat(0.55 * radius)),
                _ => sphere(radius, 1 + i % 2),
            };
            parts.push(inverted(rounded(turned(&cavity, f64::from(i), at))));
        }
    }
    (joined(&parts), placed.len())
}

#[test]
fn bores_of_random_cavities_change_no_face_away_from_them() {
    let mut drilled = 0;
    for seed in 0..4u32 {
        let (model, cavities) = cheese(seed);
        assert_eq!(voids(&model), cavities);
        let done = vented(&model, 0.9, 1);
        let open: Vec<usize> = done.failed.iter().map(|(void, _)| *void).collect();
        assert_eq!(done.vents.len() + open.len(), cavities, "{:?}", done.failed);
        assert_eq!(voids(&done.surface), open.len(), "{seed}");
        assert_eq!(pockets(&done.surface, 0.35), open.len(), "{seed}");
        drilled += done.vents.len();
        let key = |surface: &Surface, f: usize| surface.corners(f).map(|p| p.to_array().map(f64::to_bits));
        let kept: std::collections::HashSet<_> = (0..done.surface.faces.len()).map(|f| key(&done.surface, f)).collect();
        for f in 0..model.faces.len() {
            let corners = model.corners(f);
            let near = done.vents.iter().any(|vent| {
                let axis = [vent.at + vent.direction, vent.at - vent.direction * (vent.length + 1.0)];
                (0..=40).any(|i| {
                    let p = axis[0].lerp(axis[1], f64::from(i) / 40.0);
                    p.distance(crate::math::nearest_on_triangle(p, corners)) < 0.75
                })
            });
            assert!(near || kept.contains(&key(&model, f)), "{seed}: face {f} is gone");
        }
    }
    assert!(drilled > 8, "{drilled}");
}

#[test]
fn bores_leave_the_wanted_wall_to_the_sides_and_to_each_other() {
    let outer = 20.0;
    let model =
        joined(&[cuboid(DVec3::ZERO, DVec3::splat(outer)), inverted(cuboid(DVec3::splat(5.0), DVec3::splat(15.0)))]);
    for (diameter, per_void, wall) in [(3.5, 2, 0.7), (3.5, 4, 1.0), (2.0, 2, 3.0), (6.0, 2, 1.5)] {
        let done = drilled(&model, VentOptions { diameter, per_void, wall, up: DVec3::Z, precision: Precision::F32 });
        assert!(done.failed.is_empty(), "{diameter}: {:?}", done.failed);
        for (i, vent) in done.vents.iter().enumerate() {
            let far = diameter / 2.0 + wall;
            for axis in (0..3).filter(|&axis| vent.at[axis].min(outer - vent.at[axis]) > 1e-6) {
                let free = vent.at[axis].min(outer - vent.at[axis]);
                assert!(free >= far - 1e-9, "{diameter}: {free} beside {:?}", vent.at);
            }
            let apart = |other: &Vent| vent.direction == -other.direction || vent.at.distance(other.at) >= far;
            assert!(done.vents[..i].iter().all(apart), "{diameter}: {:?}", done.vents);
        }
    }
}

#[test]
fn a_bore_with_too_little_wall_is_drilled_where_no_other_has_a_place() {
    let model = joined(&[
        cuboid(DVec3::ZERO, DVec3::new(6.0, 6.0, 20.0)),
        inverted(cuboid(DVec3::new(1.0, 1.0, 4.0), DVec3::new(5.0, 5.0, 16.0))),
    ]);
    let options = |wall| VentOptions { diameter: 3.0, per_void: 1, wall, up: DVec3::Z, precision: Precision::F32 };
    for wall in [0.5, 8.0] {
        let done = drilled(&model, options(wall));
        assert_eq!((done.failed.len(), voids(&done.surface)), (0, 0), "{wall}: {:?}", done.failed);
    }
}
