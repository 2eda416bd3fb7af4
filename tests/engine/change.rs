//! The change from input to result: which surface was kept, moved, added or removed, and how that is drawn.

use glam::DVec3;
use meshmend::format::{self, Format, Limits, read};
use meshmend::inspect::{Analysis, CompareOptions, Original, Provenance, SurfaceProvenance, measures};
use meshmend::mesh::Soup;
use meshmend::render::{Drawing, draw_change};
use meshmend::repair::{Options, Outcome, draw, repair};
use serde_json::Value;

use crate::meshes::{cube, join, push, sphere};
use crate::support::with_context;

fn provenance(before: &Soup, after: &Soup) -> SurfaceProvenance {
    with_context(|context| {
        let [before, after] = [before, after].map(|soup| Analysis::new(soup.into(), context).unwrap());
        let measured = measures(&before, context).unwrap();
        Original::new(&before, &measured, CompareOptions::BRIEF).provenance(&after, context).unwrap()
    })
}

/// The areas that were kept, moved, added and removed.
fn areas(before: &Soup, after: &Soup) -> [f64; 4] {
    let shares = provenance(before, after).shares;
    assert!(shares.complete);
    [shares.kept, shares.moved, shares.added, shares.removed].map(|share| share.area)
}

fn is_near(found: [f64; 4], expected: [f64; 4], within: f64) -> bool {
    found.iter().zip(expected).all(|(a, b)| (a - b).abs() <= within)
}

fn without_top(soup: &Soup) -> Soup {
    let mut open = soup.clone();
    open.faces.retain(|face| !face.iter().all(|&v| soup.positions[v as usize].z == 1.0));
    open
}

#[test]
fn the_same_surface_is_kept_in_any_face_order_and_triangulation() {
    let coarse = cube(DVec3::ZERO, 1.0, 1);
    let mut turned = coarse.clone();
    turned.faces.reverse();
    assert_eq!(areas(&coarse, &turned), [6.0, 0.0, 0.0, 0.0]);
    assert!(is_near(areas(&coarse, &cube(DVec3::ZERO, 1.0, 5)), [6.0, 0.0, 0.0, 0.0], 1e-9));
    assert!(is_near(areas(&cube(DVec3::ZERO, 1.0, 5), &coarse), [6.0, 0.0, 0.0, 0.0], 1e-9));
}

#[test]
fn a_patch_counts_as_added_for_any_hole_and_a_missing_wall_as_removed() {
    let whole = cube(DVec3::ZERO, 1.0, 6);
    assert!(is_near(areas(&without_top(&whole), &whole), [5.0, 0.0, 1.0, 0.0], 1e-9));
    assert!(is_near(areas(&whole, &without_top(&whole)), [5.0, 0.0, 0.0, 1.0], 1e-9));
    // A hole narrower than the distance within which surface counts as moved.
    let fine = cube(DVec3::ZERO, 1.0, 300);
    let mut holed = fine.clone();
    let gone = holed.faces.pop().unwrap();
    let found = provenance(&holed, &fine);
    assert_eq!(found.of_face.iter().filter(|&&provenance| provenance == Some(Provenance::Added)).count(), 1);
    assert_eq!(found.of_face.last(), Some(&Some(Provenance::Added)), "{gone:?}");
    assert_eq!(found.shares.removed.faces, 0);
}

#[test]
fn a_small_displacement_counts_as_moved_and_a_large_one_as_removed_and_added() {
    let before = sphere(DVec3::ZERO, 1.0, 40, 20);
    let scaled = |by: f64| Soup { positions: before.positions.iter().map(|&p| p * by).collect(), ..before.clone() };
    let area = areas(&before, &before)[0];
    assert!(is_near(areas(&before, &scaled(1.002)), [0.0, area * 1.002f64.powi(2), 0.0, 0.0], 1e-9));
    assert!(is_near(areas(&before, &scaled(1.1)), [0.0, 0.0, area * 1.21, area], 1e-9));
    // A displacement as small as rounding to f32.
    assert!(is_near(areas(&before, &scaled(1.0 + 1e-8)), [area, 0.0, 0.0, 0.0], 1e-6));
}

#[test]
fn the_inner_piece_of_a_face_that_enters_a_solid_is_removed() {
    // A bar through the wall of a box. Half of each of the bar's four sides is inside.
    let shell = cube(DVec3::ZERO, 4.0, 1);
    let quad = |soup: &mut Soup, [a, b, c, d]: [DVec3; 4]| {
        push(soup, [a, b, c]);
        push(soup, [a, c, d]);
    };
    let at = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    let ring = |x: f64| [at(x, 1.0, 1.0), at(x, 2.0, 1.0), at(x, 2.0, 2.0), at(x, 1.0, 2.0)];
    let sides = |from: f64, to: f64| {
        let (mut soup, from, to) = (Soup::default(), ring(from), ring(to));
        for i in 0..4 {
            let j = (i + 1) % 4;
            quad(&mut soup, [from[i], from[j], to[j], to[i]]);
        }
        soup
    };
    let before = join(&shell, &sides(2.0, 6.0));
    let after = join(&shell, &sides(4.0, 6.0));
    let [kept, moved, added, removed] = areas(&before, &after);
    assert!((kept - (96.0 + 8.0)).abs() < 1e-9 && moved == 0.0 && added == 0.0, "{kept} {moved} {added}");
    assert!((removed - 8.0).abs() < 0.8, "{removed}");
}

#[test]
fn sizes_and_places_change_nothing_but_the_areas() {
    for size in [1e-150, 1e-9, 1.0, 1e12, 1e150] {
        let before = cube(DVec3::splat(-size), 2.0 * size, 4);
        let mut after = before.clone();
        after.faces.truncate(before.faces.len() - 32);
        let found = areas(&after, &before).map(|area| area / size / size);
        assert!(is_near(found, [20.0, 0.0, 4.0, 0.0], 1e-9), "{size}: {found:?}");
    }
}

#[test]
fn empty_meshes_and_broken_faces_are_handled() {
    let whole = cube(DVec3::ZERO, 1.0, 1);
    let empty = Soup::default();
    assert_eq!(areas(&empty, &empty), [0.0; 4]);
    assert_eq!(areas(&whole, &empty), [0.0, 0.0, 0.0, 6.0]);
    assert_eq!(areas(&empty, &whole), [0.0, 0.0, 6.0, 0.0]);
    let mut broken = whole.clone();
    push(&mut broken, [DVec3::NAN; 3]);
    push(&mut broken, [DVec3::ZERO; 3]);
    let found = provenance(&broken, &broken);
    assert_eq!((found.of_face.len(), found.of_face[12]), (14, None));
    assert_eq!(found.shares.kept.area, 6.0);
}

fn drawing<'a>(drawings: &'a [Drawing], name: &str) -> &'a [u8] {
    &drawings.iter().find(|drawing| drawing.name == name).unwrap_or_else(|| panic!("no {name}")).bytes
}

#[test]
fn a_change_is_drawn_in_four_colours_with_the_legend_in_the_file() {
    let whole = cube(DVec3::ZERO, 1.0, 2);
    let before = join(&without_top(&whole), &sphere(DVec3::splat(0.5), 0.2, 8, 6));
    let mut after = whole.clone();
    // One corner is moved a little.
    after.positions[0] -= DVec3::splat(0.002);
    let found = provenance(&before, &after);
    let drawings = with_context(|context| draw_change(&after, &found, context)).unwrap();
    assert!(drawing(&drawings, "change.png").starts_with(b"\x89PNG"));

    let glb = drawing(&drawings, "change.glb");
    let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    let document: Value = serde_json::from_slice(&glb[20..20 + length]).unwrap();
    let names: Vec<_> = document["nodes"].as_array().unwrap().iter().map(|node| node["name"].clone()).collect();
    assert_eq!(names, ["model", "kept", "moved", "added", "removed"]);
    let legend = &document["scenes"][0]["extras"]["legend"];
    assert_eq!(legend[2]["kind"], "added");
    assert_eq!(legend[2]["colour"], "#0072B2");
    assert_eq!((legend[2]["count"].as_u64(), legend[2]["area"].as_f64()), (Some(8), Some(1.0)));
    let colours: std::collections::BTreeSet<_> =
        (0..4).map(|i| legend[i]["colour"].as_str().unwrap().to_owned()).collect();
    assert_eq!(colours.len(), 4);

    let ply = drawing(&drawings, "change.ply");
    let text = String::from_utf8_lossy(&ply[..800]);
    assert!(text.contains("comment legend removed #D1241B 80 faces removed"), "{text}");
    assert!(text.contains("property uchar provenance\n"), "{text}");
    let faces = read(ply, &Limits::default()).unwrap().soup.faces.len();
    assert_eq!(faces, after.faces.len() + found.removed.len());
}

fn sorted(mut names: Vec<&str>) -> Vec<&str> {
    names.sort_unstable();
    names
}

#[test]
fn a_repair_reports_the_areas_and_draws_them() {
    let input = format::write(&join(&without_top(&cube(DVec3::ZERO, 1.0, 3)), &Soup::default()), Format::Stl).unwrap();
    with_context(|context| {
        let options = Options { max_surface_added_pct: 20.0, ..Options::default() };
        let repaired = repair(&input, &options, &Limits::default(), None, context).unwrap();
        assert_eq!(repaired.report.outcome, Outcome::Repaired);
        let surface = repaired.report.changes.as_ref().unwrap().surface.unwrap();
        assert!((surface.kept.area - 5.0).abs() < 1e-6 && (surface.added.area - 1.0).abs() < 1e-6, "{surface:?}");
        assert_eq!((surface.kept.faces, surface.removed.faces), (90, 0));
        let drawn = |result| draw(&input, result, &options, &Limits::default(), context).unwrap();
        let names: Vec<_> = drawn(Some(&repaired.bytes)).iter().map(|drawing| drawing.name).collect();
        assert_eq!(names[3..], ["after.png", "change.png", "change.glb", "change.ply"]);
        let mut reported = repaired.report.drawings();
        reported.sort_unstable();
        assert_eq!(reported, sorted(names), "the report knows them before they are drawn");
        assert_eq!(drawn(Some(&input)).last().unwrap().name, "remaining.glb", "a hole is left");
        assert_eq!(drawn(None).len(), 3);
    });
}

#[test]
fn a_file_that_comes_back_as_it_was_is_all_kept() {
    let input = format::write(&cube(DVec3::ZERO, 1.0, 3), Format::Stl).unwrap();
    with_context(|context| {
        let repaired = repair(&input, &Options::default(), &Limits::default(), None, context).unwrap();
        assert_eq!(repaired.report.outcome, Outcome::AlreadyPrintable);
        let surface = repaired.report.changes.unwrap().surface.unwrap();
        assert_eq!((surface.kept.faces, surface.moved.faces + surface.added.faces + surface.removed.faces), (108, 0));
    });
}
