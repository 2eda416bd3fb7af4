//! Open sheets within solids go, and what bounds something stays.

use glam::DVec3;
use meshmend::mesh::{Soup, Surface, weld_exactly};
use meshmend::repair::operators::internal_faces::remove_internal_sheets;

use crate::meshes::{cube, inside_out, join, push};
use crate::operators::{count, with_context};

/// What goes of a mesh, as parts and faces.
fn removed(soup: &Soup) -> (u64, u64) {
    let (mut surface, _) = Surface::from_soup(soup);
    weld_exactly(&mut surface);
    let applied = with_context(|c| remove_internal_sheets(&mut surface, c)).unwrap();
    (count(&applied.changes, "internal_sheets_removed"), count(&applied.changes, "sheet_faces_removed"))
}

/// A box of side 4 in quads of side 1, without its first face.
fn holed() -> Soup {
    let mut soup = cube(DVec3::ZERO, 4.0, 4);
    soup.faces.remove(0);
    soup
}

fn with_triangle(mut soup: Soup, triangle: [[f64; 3]; 3]) -> Soup {
    push(&mut soup, triangle.map(DVec3::from));
    soup
}

#[test]
fn a_sheet_that_hangs_within_or_floats_goes_though_the_solid_has_a_hole() {
    let hanging = [[2.0, 2.0, 0.0], [2.0, 3.0, 0.0], [2.0, 2.5, 1.0]];
    assert_eq!(removed(&with_triangle(holed(), hanging)), (1, 1));
    let floating = [[2.0, 2.0, 1.0], [2.0, 3.0, 1.0], [2.0, 2.5, 2.0]];
    assert_eq!(removed(&with_triangle(holed(), floating)), (1, 1));
    assert_eq!(removed(&with_triangle(with_triangle(holed(), floating), hanging)), (2, 2));
}

#[test]
fn what_is_outside_or_reaches_out_stays() {
    let fin = [[2.0, 2.0, 4.0], [2.0, 3.0, 4.0], [2.0, 2.5, 5.0]];
    assert_eq!(removed(&with_triangle(holed(), fin)), (0, 0));
    let through = [[2.0, 2.0, 3.0], [2.0, 3.0, 3.0], [2.0, 2.5, 7.0]];
    assert_eq!(removed(&with_triangle(holed(), through)), (0, 0));
}

#[test]
fn a_cavity_with_a_hole_and_a_loose_piece_of_the_wall_stay() {
    let mut cavity = inside_out(cube(DVec3::ONE, 2.0, 2));
    cavity.faces.remove(3);
    assert_eq!(removed(&join(&holed(), &cavity)), (0, 0));
    let mut apart = cube(DVec3::ZERO, 4.0, 4);
    let corners = apart.corners(7);
    let inset = (corners[0] + corners[1] + corners[2]) / 3.0;
    apart.faces.remove(7);
    let piece = corners.map(|p| (inset + (p - inset) * 0.99).to_array());
    assert_eq!(removed(&with_triangle(apart, piece)), (0, 0));
}
