//! Doubtful patches: a region that is visible through a patch is not filled.

use glam::DVec3;
use meshmend::arrange::{Exact, Rule, Solid, WindingRule};
use meshmend::mesh::{NO_SOURCE, Soup, Surface};
use meshmend::repair::{Options, Outcome};

use crate::meshes::{as_f32, cube, inside_out, join};
use crate::support::{arranged, measured, repair_soup};

/// A cube of side 4 whose lid at `z = 4` is the patch of a hole.
fn cup() -> Soup {
    cube(DVec3::ZERO, 4.0, 2)
}

fn is_lid(soup: &Soup, face: usize) -> bool {
    soup.corners(face).iter().all(|p| p.z == 4.0)
}

/// The solid of a soup whose lid is a patch.
fn solid(soup: &Soup, rule: Rule) -> Solid {
    let (mut surface, _) = Surface::from_soup(soup);
    for f in 0..soup.faces.len() {
        if is_lid(soup, f) {
            surface.source[f] = NO_SOURCE;
        }
    }
    arranged(&Exact, &surface, rule).unwrap()
}

fn doubting(winding_rule: WindingRule) -> Rule {
    Rule { winding_rule, reopens_patches: true }
}

fn volume(solid: &Solid) -> f64 {
    measured(&solid.surface).volume.value
}

fn in_the_cup(size: f64) -> Soup {
    cube(DVec3::splat(2.0 - size / 2.0), size, 1)
}

#[test]
fn a_region_is_left_open_if_its_content_is_visible_through_a_patch() {
    let soup = join(&cup(), &in_the_cup(1.5));
    let filled = solid(&soup, WindingRule::Positive.into());
    assert!((volume(&filled) - 64.0).abs() < 1e-9 && filled.opened.faces.is_empty());
    let open = solid(&soup, doubting(WindingRule::Positive));
    assert!((volume(&open) - 1.5f64.powi(3)).abs() < 1e-9, "{}", volume(&open));
    // The cup's walls and floor, still facing outward, and nothing of the lid.
    assert_eq!(open.opened.faces.len(), 40);
    for f in 0..open.opened.faces.len() {
        let [a, b, c] = open.opened.corners(f);
        let outward = (a + b + c) / 3.0 - DVec3::splat(2.0);
        assert!(open.opened.area_vector(f).dot(outward) > 0.0 && a.min(b).min(c).z < 4.0);
    }
}

#[test]
fn the_content_of_an_inverted_region_is_behind_its_skin_too() {
    let soup = inside_out(join(&cup(), &in_the_cup(1.5)));
    let open = solid(&soup, doubting(WindingRule::Nonzero));
    let outward = |f| (open.opened.corners(f)[0] - DVec3::splat(2.0)).dot(open.opened.area_vector(f)) > 0.0;
    assert!(!open.opened.faces.is_empty() && (0..open.opened.faces.len()).all(outward));
}

#[test]
fn a_region_is_filled_if_it_contains_nothing_visible() {
    let alone = solid(&cup(), doubting(WindingRule::Positive));
    assert!((volume(&alone) - 64.0).abs() < 1e-9 && alone.opened.faces.is_empty());
    // A region that touches no patch is hidden by real walls.
    let closed = join(&cube(DVec3::new(0.5, 0.5, 0.5), 3.0, 1), &in_the_cup(1.5));
    let hidden = solid(&join(&cup(), &closed), doubting(WindingRule::Positive));
    let behind =
        hidden.surface.positions.iter().filter(|p| (**p - DVec3::splat(2.0)).abs().max_element() < 1.0).count();
    assert_eq!(behind, 0, "the cube in the closed box in the cup is not seen");
    assert!((volume(&hidden) - 27.0).abs() < 1e-9, "{}", volume(&hidden));
}

#[test]
fn a_speck_in_a_region_does_not_leave_it_open() {
    let speck = solid(&join(&cup(), &in_the_cup(0.1)), doubting(WindingRule::Positive));
    assert!((volume(&speck) - 64.0).abs() < 1e-9 && speck.opened.faces.is_empty());
}

/// A cup without a lid, with a block in it.
fn open_cup_with_block() -> Soup {
    let mut soup = join(&cup(), &in_the_cup(1.5));
    let mut is_open = (0..soup.faces.len()).map(|f| is_lid(&soup, f)).collect::<Vec<_>>().into_iter();
    soup.faces.retain(|_| is_open.next() == Some(false));
    soup
}

fn assert_the_block_stays_visible(soup: Soup) {
    let repaired =
        repair_soup(&as_f32(soup), &Options { max_tier: 2, max_surface_added_pct: 100.0, ..Options::default() }, None);
    assert_eq!(repaired.report.outcome, Outcome::Repaired, "{:?}", repaired.report.red_flags);
    let after = &repaired.report.after.unwrap().measures;
    assert!(after.printable() && after.parts == 2, "{after:?}");
    // The volume of the block, and of five walls with a thickness of 0.3 % of the diagonal.
    let walls = 5.0 * 16.0 * 0.003 * 6.9282;
    assert!((after.volume.value - 3.375 - walls).abs() < 0.1, "{}", after.volume.value);
    let reported = repaired.report.assumptions.iter().any(|assumption| assumption.detail.contains("regions stay open"));
    assert!(reported, "{:?}", repaired.report.assumptions);
}

#[test]
fn a_cup_with_a_block_in_it_keeps_the_block_visible() {
    assert_the_block_stays_visible(open_cup_with_block());
}

#[test]
fn a_cup_with_a_face_for_each_side_keeps_the_block_visible_too() {
    let mut soup = open_cup_with_block();
    let back: Vec<[u32; 3]> = soup.faces.iter().map(|&[a, b, c]| [a, c, b]).collect();
    soup.faces.extend(back);
    assert_the_block_stays_visible(soup);
}
