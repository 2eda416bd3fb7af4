//! Open sheets inside solids are removed, and surface that bounds a volume stays.

use glam::DVec3;
use meshmend::mesh::{Soup, Surface, weld_exactly};
use meshmend::repair::operators::internal_faces::remove_internal_sheets;

use crate::meshes::{cube, inside_out, join, push};
use crate::support::{change_count, with_context};

/// The number of parts and faces that are removed from a mesh.
fn removed(soup: &Soup) -> (u64, u64) {
    let (mut surface, _) = Surface::from_soup(soup);
    weld_exactly(&mut surface);
    let applied = with_context(|c| remove_internal_sheets(&mut surface, c)).unwrap();
    (change_count(&applied.changes, "internal_sheets_removed"), change_count(&applied.changes, "sheet_faces_removed"))
}

/// A cube of side 4 with quads of side 1, without its first face.
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
fn an_internal_sheet_is_removed_even_if_the_solid_has_a_hole() {
    let hanging = [[2.0, 2.0, 0.0], [2.0, 3.0, 0.0], [2.0, 2.5, 1.0]];
    assert_eq!(removed(&with_triangle(holed(), hanging)), (1, 1));
    let floating = [[2.0, 2.0, 1.0], [2.0, 3.0, 1.0], [2.0, 2.5, 2.0]];
    assert_eq!(removed(&with_triangle(holed(), floating)), (1, 1));
    assert_eq!(removed(&with_triangle(with_triangle(holed(), floating), hanging)), (2, 2));
}

#[test]
fn sheets_outside_or_partly_outside_a_solid_stay() {
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
