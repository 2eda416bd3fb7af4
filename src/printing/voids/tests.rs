//! Tests of sealed voids: their volumes, and their filling.

use glam::DVec3;

use super::voids_in;
use crate::mesh::{ClosedSurface, NotClosed, Surface};
use crate::printing::shapes::*;

fn ball_volume(r: f64) -> f64 {
    4.0 / 3.0 * std::f64::consts::PI * r.powi(3)
}

#[test]
fn a_solid_without_cavities_has_no_void() {
    quietly(|context| {
        assert!(voids_in(&cuboid(DVec3::ZERO, DVec3::ONE), context).is_empty());
        let two = joined(&[cuboid(DVec3::ZERO, DVec3::ONE), cuboid(DVec3::splat(2.0), DVec3::splat(3.0))]);
        assert!(voids_in(&two, context).is_empty());
        assert!(voids_in(&Surface::default(), context).is_empty());
    });
}

#[test]
fn nested_boxes_have_exact_volumes_and_containers() {
    quietly(|context| {
        // Solid, void, solid, void, and a second void beside it.
        let shells = joined(&[
            cuboid(DVec3::ZERO, DVec3::splat(10.0)),
            inverted(cuboid(DVec3::splat(1.0), DVec3::new(7.0, 9.0, 9.0))),
            cuboid(DVec3::splat(2.0), DVec3::splat(6.0)),
            inverted(cuboid(DVec3::splat(3.0), DVec3::splat(4.5))),
            inverted(cuboid(DVec3::new(8.0, 1.0, 1.0), DVec3::new(9.0, 2.0, 3.0))),
        ]);
        let voids = voids_in(&shells, context);
        let volumes: Vec<f64> = voids.iter().map(|void| void.volume).collect();
        for (volume, expected) in volumes.iter().zip([6.0 * 64.0 - 64.0, 1.5f64.powi(3), 2.0]) {
            assert!((volume / expected - 1.0).abs() < 1e-12, "{volumes:?}");
        }
        assert_eq!(voids.iter().map(|v| v.container).collect::<Vec<_>>(), [None, Some(0), None]);
        assert_eq!(voids.iter().map(|v| v.solids).collect::<Vec<_>>(), [1, 0, 0]);
        assert_eq!(voids[0].faces.len(), 24);
        assert!(voids.iter().all(|void| void.widest_at_most >= void.widest));
        assert!((voids[1].widest - 1.5).abs() < 0.016 && (voids[2].widest - 1.0).abs() < 0.011);
        let at = voids[0].at;
        assert!(at.cmpgt(DVec3::splat(1.0)).all() && at.cmplt(DVec3::new(7.0, 9.0, 9.0)).all());
        assert!(!(at.cmpgt(DVec3::splat(2.0)).all() && at.cmplt(DVec3::splat(6.0)).all()));
    });
}

#[test]
fn a_void_that_touches_the_outer_skin_along_an_edge_is_still_sealed() {
    quietly(|context| {
        // Faces are welded by position: the cavity shares an edge with the box.
        let outer = cuboid(DVec3::ZERO, DVec3::splat(4.0));
        let p = [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [1.0, 1.0, 0.5], [1.0, 0.5, 1.0]].map(DVec3::from);
        let cavity = inverted(tetrahedron(p));
        let both = joined(&[outer, cavity]);
        let voids = voids_in(&both, context);
        assert_eq!(voids.len(), 1);
        assert!((voids[0].volume - tetrahedron_volume(p)).abs() < 1e-12);
    });
}

#[test]
fn nested_dolls_turned_at_random_have_their_volumes_within_1e_9() {
    quietly(|context| {
        let radii = [10.0, 9.0, 7.5, 6.0, 5.0, 3.0];
        for seed in [0.0, 1.0, 2.0, 3.0] {
            let shells: Vec<Surface> = (0..6usize)
                .map(|k| {
                    let ball = turned(&sphere(radii[k], 2), seed + 7.0 * k as f64, DVec3::new(100.0, -20.0, 3.0));
                    if k % 2 == 1 { inverted(ball) } else { ball }
                })
                .collect();
            let exact = |k: usize| volume(&shells[k]).abs();
            let voids = voids_in(&joined(&shells), context);
            assert_eq!(voids.len(), 3);
            for (void, expected) in voids.iter().zip([exact(1) - exact(2), exact(3) - exact(4), exact(5)]) {
                assert!((void.volume / expected - 1.0).abs() < 1e-9, "{} {expected}", void.volume);
            }
            assert!(voids[2].volume < ball_volume(3.0));
            assert_eq!(voids.iter().map(|v| v.container).collect::<Vec<_>>(), [None, Some(0), Some(1)]);
            let inner = &voids[2];
            assert!(
                inner.widest > 5.6 && inner.widest <= 6.0 && inner.at.distance(DVec3::new(100.0, -20.0, 3.0)) < 0.2
            );
        }
    });
}

#[test]
fn an_inverted_or_doubled_part_makes_no_void() {
    quietly(|context| {
        let outer = cuboid(DVec3::ZERO, DVec3::splat(4.0));
        let inner = cuboid(DVec3::ONE, DVec3::splat(2.0));
        assert!(voids_in(&joined(&[outer.clone(), inner.clone()]), context).is_empty());
        assert!(voids_in(&inverted(outer.clone()), context).is_empty());
        let open = Surface { faces: outer.faces[1..].to_vec(), source: vec![0; 11], ..outer };
        assert!(matches!(ClosedSurface::try_from(&open), Err(NotClosed)));
    });
}

#[test]
fn a_hundred_bubbles_are_each_found_once() {
    quietly(|context| {
        let mut parts = vec![cuboid(DVec3::splat(-1.0), DVec3::splat(10.0))];
        for i in 0..125u32 {
            let at = DVec3::new(f64::from(i % 5), f64::from(i / 5 % 5), f64::from(i / 25)) * 2.0;
            parts.push(inverted(turned(&sphere(0.3 + 0.005 * f64::from(i), 1), f64::from(i), at)));
        }
        let voids = voids_in(&joined(&parts), context);
        assert_eq!(voids.len(), 125);
        assert!(voids.windows(2).all(|pair| pair[0].volume >= pair[1].volume));
        assert!(voids.iter().all(|void| void.container.is_none() && void.widest > 0.4));
    });
}

#[test]
fn parts_without_area_are_ignored() {
    quietly(|context| {
        let mut model =
            joined(&[cuboid(DVec3::ZERO, DVec3::splat(4.0)), inverted(cuboid(DVec3::ONE, DVec3::splat(2.0)))]);
        let first = model.positions.len() as u32;
        model.positions.extend([1.2, 1.4, 1.9].map(DVec3::splat));
        model.faces.extend([[first, first + 1, first + 2], [first, first + 2, first + 1], [0, 0, 1]]);
        model.source.extend([30, 31, 32]);
        let voids = voids_in(&model, context);
        assert_eq!(voids.iter().map(|void| void.volume).collect::<Vec<_>>(), [1.0]);
    });
}

#[test]
fn a_void_that_is_narrower_than_rounding_errors_along_a_ray_is_found() {
    quietly(|context| {
        let least = 1.0f64.next_up();
        let shells = joined(&[
            cuboid(DVec3::splat(-2.0), DVec3::splat(2.0)),
            inverted(cuboid(DVec3::splat(-least), DVec3::splat(least))),
            cuboid(DVec3::NEG_ONE, DVec3::ONE),
        ]);
        let voids = voids_in(&shells, context);
        assert_eq!(voids.len(), 1, "{voids:?}");
        assert!(voids[0].volume >= 0.0 && voids[0].volume < 1e-12, "{}", voids[0].volume);
    });
}
