//! Operators of tier 2: solids that are separated stay separate when a reader merges vertices by position.

use glam::DVec3;
use meshmend::arrange::{ArrangeError, Exact, WindingRule};
use meshmend::inspect::measure;
use meshmend::mesh::{NotClosed, Soup, Surface};
use meshmend::repair::operators::debris::remove_debris;
use meshmend::repair::operators::perturb::Perturb;
use meshmend::repair::operators::self_union::{Resolved, SelfUnionRounds};
use meshmend::repair::operators::split_non_manifold::{Pairing, Pinches, split_non_manifold};
use meshmend::repair::{Context, NoProgress};
use proptest::prelude::*;

use crate::meshes::{cube, join, push, sphere, torus};
use crate::support::{change_count, measured_as_stl, with_context};

fn separated(soup: &Soup) -> Surface {
    let (mut surface, _) = Surface::from_soup(soup);
    with_context(|c| Perturb::default().apply(&mut surface, c)).unwrap();
    surface
}

/// Two unit cubes that share only an edge.
fn two_cubes_on_an_edge() -> Soup {
    join(&cube(DVec3::ZERO, 1.0, 2), &cube(DVec3::new(1.0, 1.0, 0.0), 1.0, 2))
}

#[test]
fn two_solids_that_share_an_edge_stay_two_solids() {
    let soup = two_cubes_on_an_edge();
    let before = with_context(|c| measure(&soup, c)).unwrap();
    assert_eq!((before.non_manifold_edges, before.parts), (2, 1));
    let surface = separated(&soup);
    let after = measured_as_stl(&surface);
    assert!(after.manifold && after.closed && after.consistent, "{after:?}");
    assert_eq!((after.parts, after.faces), (2, before.faces));
    assert!((after.volume.value - 2.0).abs() < 1e-5);
}

#[test]
fn vertices_move_by_no_more_than_a_few_units_in_the_last_place() {
    let soup = two_cubes_on_an_edge();
    let surface = separated(&soup);
    let moved = surface.positions.iter().filter(|p| !soup.positions.contains(p)).count();
    assert_eq!(moved, 3, "the three vertices of the shared edge, on one side");
    for p in &surface.positions {
        let nearest = soup.positions.iter().map(|q| q.distance(*p)).fold(f64::MAX, f64::min);
        assert!(nearest < 1e-6, "{p} moved by {nearest}");
    }
}

#[test]
fn solids_that_touch_in_a_vertex_are_separated() {
    let soup = join(&cube(DVec3::ZERO, 1.0, 1), &cube(DVec3::ONE, 1.0, 1));
    assert_eq!(with_context(|c| measure(&soup, c)).unwrap().non_manifold_vertices, 1);
    let after = measured_as_stl(&separated(&soup));
    assert_eq!((after.non_manifold_vertices, after.parts), (0, 2));
    assert!(after.closed && after.manifold);
}

/// A ring of cubes around a hole, two of which share only an edge; around that edge the surface is connected.
fn ring_with_a_pinched_edge() -> Soup {
    let cells = [(0, 0), (1, 0), (2, 0), (2, 1), (1, 2), (0, 2), (0, 1)];
    let filled = |x: i32, y: i32| cells.contains(&(x, y));
    let mut soup = Soup::default();
    for (x, y) in cells {
        let low = DVec3::new(f64::from(x), f64::from(y), 0.0);
        let inner = |p: DVec3| {
            let axis = (0..2).find(|&k| (p[k] - low[k] - 0.5).abs() > 0.4);
            axis.is_some_and(|k| {
                let step = if p[k] > low[k] + 0.5 { 1 } else { -1 };
                if k == 0 { filled(x + step, y) } else { filled(x, y + step) }
            })
        };
        let one = cube(low, 1.0, 1);
        for f in 0..one.faces.len() {
            let [a, b, c] = one.corners(f);
            if !inner((a + b + c) / 3.0) {
                push(&mut soup, [a, b, c]);
            }
        }
    }
    soup
}

#[test]
fn an_edge_where_a_solid_touches_itself_is_split() {
    let soup = ring_with_a_pinched_edge();
    let before = with_context(|c| measure(&soup, c)).unwrap();
    assert_eq!((before.non_manifold_edges, before.boundary_edges), (1, 0));
    let after = measured_as_stl(&separated(&soup));
    assert!(after.closed && after.manifold && after.consistent, "{after:?}");
    assert!((after.volume.value - 7.0).abs() < 1e-5);
}

#[test]
fn a_fin_is_cut_off_and_the_solid_stays_closed() {
    let mut soup = cube(DVec3::ZERO, 1.0, 1);
    push(&mut soup, [DVec3::ZERO, DVec3::X, DVec3::new(0.5, -0.01, -0.01)]);
    let (mut surface, _) = Surface::from_soup(&soup);
    let changes =
        with_context(|c| split_non_manifold(&mut surface, Pairing::FinsLast, Pinches::KeepAtBoundaries, c)).unwrap();
    assert_eq!(change_count(&changes, "faces_without_partner"), 1);
    let changes = with_context(|c| remove_debris(&mut surface, c)).unwrap();
    assert_eq!(
        (change_count(&changes, "debris_parts_removed"), change_count(&changes, "debris_faces_removed")),
        (1, 1)
    );
    let after = measured_as_stl(&surface);
    assert!(after.closed && after.manifold);
    assert_eq!(after.faces, 12);
}

#[test]
fn a_sheet_inside_a_solid_is_removed_and_one_outside_stays() {
    for (middle, goes) in [(DVec3::ZERO, true), (DVec3::X * 3.0, false)] {
        let mut soup = sphere(DVec3::ZERO, 2.0, 16, 8);
        push(&mut soup, [DVec3::X, DVec3::Y, DVec3::Z].map(|p| p + middle));
        let (mut surface, _) = Surface::from_soup(&soup);
        let changes = with_context(|c| remove_debris(&mut surface, c)).unwrap();
        assert_eq!(change_count(&changes, "sheets_inside_solids_removed"), u64::from(goes));
        assert_eq!(surface.faces.len() + usize::from(goes), soup.faces.len());
    }
}

#[test]
fn a_sheet_that_only_begins_inside_a_solid_is_not_counted_with_those_that_went() {
    let mut soup = sphere(DVec3::ZERO, 2.0, 16, 8);
    push(&mut soup, [DVec3::X, DVec3::Y, DVec3::Z]);
    push(&mut soup, [DVec3::X * 4.0, DVec3::new(-2.0, 3.5, 0.0), DVec3::new(-2.0, -3.5, 0.0)]);
    let (mut surface, _) = Surface::from_soup(&soup);
    let changes = with_context(|c| remove_debris(&mut surface, c)).unwrap();
    assert_eq!(
        (change_count(&changes, "sheets_inside_solids_removed"), change_count(&changes, "debris_parts_removed")),
        (1, 0)
    );
    assert_eq!(surface.faces.len() + 1, soup.faces.len());
}

#[test]
fn nothing_is_removed_if_everything_is_debris() {
    let mut soup = Soup::default();
    push(&mut soup, [DVec3::ZERO, DVec3::X, DVec3::Y]);
    let (mut surface, _) = Surface::from_soup(&soup);
    with_context(|c| remove_debris(&mut surface, c)).unwrap();
    assert_eq!(surface.faces.len(), 1);
}

#[test]
fn a_mesh_that_is_manifold_is_left_bit_for_bit() {
    let soup = join(&sphere(DVec3::ZERO, 2.0, 16, 8), &cube(DVec3::splat(5.0), 1.0, 2));
    let (before, _) = Surface::from_soup(&soup);
    let mut after = before.clone();
    let changes = with_context(|c| Perturb::default().apply(&mut after, c)).unwrap().changes;
    assert!(changes.is_empty(), "{changes:?}");
    assert_eq!(before, after);
}

proptest! {
    /// Cubes on a small grid, without the walls between neighbours, touch in edges and vertices in every way. After
    /// separation they are manifold by position and keep the volume of the cells.
    #[test]
    fn cells_of_a_board_become_manifold_solids(board in proptest::collection::vec(any::<bool>(), 27)) {
        let filled = |x: i32, y: i32, z: i32| {
            [x, y, z].iter().all(|k| (0..3).contains(k)) && board[(9 * x + 3 * y + z) as usize]
        };
        let mut soup = Soup::default();
        let mut cells = 0.0;
        for (x, y, z) in (0..27).map(|i| (i / 9, i / 3 % 3, i % 3)).filter(|&(x, y, z)| filled(x, y, z)) {
            cells += 1.0;
            let low = DVec3::new(f64::from(x), f64::from(y), f64::from(z));
            let one = cube(low, 1.0, 1);
            for f in 0..one.faces.len() {
                let [a, b, c] = one.corners(f);
                let side = ((a + b + c) / 3.0 - low - 0.5) * 2.0;
                let step = side.to_array().map(|s| if s > 0.9 { 1 } else if s < -0.9 { -1 } else { 0 });
                if !filled(x + step[0], y + step[1], z + step[2]) {
                    push(&mut soup, [a, b, c]);
                }
            }
        }
        prop_assume!(cells > 0.0);
        let after = measured_as_stl(&separated(&soup));
        prop_assert!(after.closed && after.manifold && after.consistent, "{:?}", after);
        prop_assert!((after.volume.value - cells).abs() < 1e-4);
    }
}

fn resolved(soup: &Soup) -> (Surface, Resolved) {
    let (mut surface, _) = Surface::from_soup(soup);
    let result = with_context(|c| {
        SelfUnionRounds {
            winding_rule: WindingRule::Positive,
            max_deviation: f64::INFINITY,
            sheets: None,
            always: false,
        }
        .apply(&mut surface, &Exact, c)
    })
    .unwrap();
    (surface, result)
}

#[test]
fn two_cubes_that_overlap_become_one_solid_of_their_common_volume() {
    let soup = join(&cube(DVec3::ZERO, 1.0, 2), &cube(DVec3::new(0.5, 0.25, 0.125), 1.0, 2));
    let (surface, result) = resolved(&soup);
    assert!(change_count(&result.changes, "intersecting_pairs_resolved") > 0 && result.error.is_none());
    let after = measured_as_stl(&surface);
    assert!(after.printable(), "{after:?}");
    assert_eq!(after.parts, 1);
    assert!((after.volume.value - (2.0 - 0.5 * 0.75 * 0.875)).abs() < 1e-6, "{}", after.volume.value);
}

#[test]
fn a_union_counts_the_faces_that_it_cut_removed_and_created() {
    // The second cube covers four whole cells of the first cube's wall and cuts the twelve cells around them. The first
    // cube covers one of the second cube's walls, and cuts the twelve cells of each wall beside it in two.
    let soup = join(&cube(DVec3::ZERO, 4.0, 4), &cube(DVec3::new(3.5, 0.5, 0.5), 3.0, 3));
    let before = soup.faces.len() as u64;
    let (surface, result) = resolved(&soup);
    let [cut, removed, created] =
        ["faces_cut", "faces_removed", "faces_created"].map(|kind| change_count(&result.changes, kind));
    assert_eq!(removed, 2 * 4 + 2 * 9);
    assert!((40..=2 * 24).contains(&cut), "{cut}");
    assert_eq!(surface.faces.len() as u64, before - cut - removed + created);
}

#[test]
fn solids_that_share_part_of_a_wall_become_one_without_the_wall() {
    let soup = join(&cube(DVec3::ZERO, 1.0, 1), &cube(DVec3::new(1.0, 0.25, 0.25), 0.5, 1));
    let (surface, _) = resolved(&soup);
    let after = measured_as_stl(&surface);
    assert!(after.printable(), "{after:?}");
    assert!((after.volume.value - 1.125).abs() < 1e-6);
}

#[test]
fn a_sphere_through_a_torus_keeps_the_volume_of_both_without_their_common_part() {
    let (ball, ring) = (sphere(DVec3::new(3.0, 0.0, 0.1), 1.4, 24, 12), torus(3.0, 1.0, 36, 18));
    let volume = |soup: &Soup| with_context(|c| measure(soup, c)).unwrap().volume.value;
    let (surface, result) = resolved(&join(&ball, &ring));
    let after = measured_as_stl(&surface);
    assert!(after.printable(), "{after:?}, {result:?}");
    assert!(after.volume.value < volume(&ball) + volume(&ring));
    assert!(after.volume.value > volume(&ball).max(volume(&ring)));
}

#[test]
fn surfaces_that_are_open_or_do_not_intersect_are_unchanged() {
    let apart = join(&cube(DVec3::ZERO, 1.0, 1), &cube(DVec3::splat(3.0), 1.0, 1));
    let (before, _) = Surface::from_soup(&apart);
    assert_eq!(resolved(&apart), (before, Resolved::default()));
    let mut open = join(&cube(DVec3::ZERO, 1.0, 1), &cube(DVec3::splat(0.5), 1.0, 1));
    open.faces.pop();
    let (before, _) = Surface::from_soup(&open);
    let (after, result) = resolved(&open);
    assert_eq!((after, result.error), (before, Some(ArrangeError::NotClosed(NotClosed))));
}

#[test]
fn a_resolve_that_is_cancelled_leaves_the_surface_as_it_was() {
    let soup = join(&sphere(DVec3::ZERO, 2.0, 64, 32), &sphere(DVec3::X, 2.0, 64, 32));
    let (before, _) = Surface::from_soup(&soup);
    let mut surface = before.clone();
    let cancel = std::sync::atomic::AtomicBool::new(true);
    let clock = || std::time::Duration::ZERO;
    let context = Context::new(&NoProgress, &cancel, &clock, std::time::Duration::from_secs(1));
    let resolve = SelfUnionRounds {
        winding_rule: WindingRule::Positive,
        max_deviation: f64::INFINITY,
        sheets: None,
        always: false,
    };
    assert!(resolve.apply(&mut surface, &Exact, &context).is_err());
    assert_eq!(surface, before);
}
