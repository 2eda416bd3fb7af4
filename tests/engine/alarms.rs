//! No false alarm: what encloses nothing, is turned inside out or is cracked makes no verdict worse than the model is.

use glam::DVec3;
use meshmend::mesh::Soup;
use meshmend::repair::{Category, Operator, Options, Outcome, RedFlagCode, Repaired};

use crate::meshes::{cube, inside_out, join, push, sheet, sphere};
use crate::pipeline::run;

/// Without Blender, and at most one result for each of the two arrangements.
fn repaired_at_once(soup: &Soup) -> Repaired {
    let it = run(soup, &Options::default(), None);
    assert_eq!(it.report.outcome, Outcome::Repaired, "{} {:?}", it.report.summary, it.report.red_flags);
    assert_eq!(it.report.red_flags, []);
    assert_eq!(it.report.candidates.len(), 1, "the first result is good");
    it
}

fn volume(it: &Repaired) -> f64 {
    it.report.after.as_ref().unwrap().measures.volume.value
}

fn close(a: f64, b: f64, most: f64) {
    assert!((a - b).abs() <= most, "{a} is not {b}");
}

fn at(x: f64, size: f64) -> Soup {
    cube(DVec3::new(x, 0.0, 0.0), size, 1)
}

/// A box about the origin.
fn about(half: f64) -> Soup {
    cube(DVec3::splat(-half), 2.0 * half, 1)
}

/// Each of some groups of faces as surface of its own, moved by what `shift` says of its middle.
fn apart(soup: &Soup, faces_a_group: usize, shift: impl Fn(usize, DVec3) -> DVec3) -> Soup {
    let mut all = Soup::default();
    for (number, group) in soup.faces.chunks(faces_a_group).enumerate() {
        let corners: Vec<[DVec3; 3]> = group.iter().map(|face| face.map(|v| soup.positions[v as usize])).collect();
        let count = (3 * corners.len()) as f64;
        let middle = corners.iter().flatten().sum::<DVec3>() / count;
        let by = shift(number, middle);
        corners.into_iter().for_each(|corners| push(&mut all, corners.map(|p| p + by)));
    }
    all
}

#[test]
fn stray_faces_without_area_are_no_part_of_the_box() {
    let mut soup = at(0.0, 10.0);
    push(&mut soup, [DVec3::new(500.0, 0.0, 0.0); 3]);
    push(&mut soup, [600.0, 601.0, 602.0].map(DVec3::splat));
    let it = repaired_at_once(&soup);
    let changes = it.report.changes.unwrap();
    assert_eq!(changes.bounding_box_change_pct, Some(0.0));
    assert!((volume(&it) - 1000.0).abs() < 1e-9, "{}", volume(&it));
}

#[test]
fn a_face_with_an_area_that_is_gone_still_moves_the_box() {
    let soup = join(&at(0.0, 1.0), &at(50.0, 1.0));
    let options = Options { with: vec![], ..Options::default() };
    let whole = run(&soup, &options, None);
    assert_eq!(whole.report.outcome, Outcome::AlreadyPrintable);
    let (before, after) = (soup, at(0.0, 1.0));
    let cancel = std::sync::atomic::AtomicBool::new(false);
    let clock = || std::time::Duration::ZERO;
    let context =
        meshmend::repair::Context::new(&meshmend::repair::NoProgress, &cancel, &clock, std::time::Duration::MAX);
    let [a, b] = [&before, &after].map(|soup| meshmend::inspect::Analysis::new(soup.into(), &context).unwrap());
    let it = meshmend::inspect::compare(&a, &b, Default::default(), &context).unwrap();
    assert!(it.changes.bounding_box_change_pct.unwrap() > 90.0);
    assert!(!it.faithful);
}

#[test]
fn one_of_three_boxes_inside_out_changes_no_volume() {
    let soup = join(&join(&at(0.0, 10.0), &at(20.0, 10.0)), &inside_out(at(40.0, 10.0)));
    let it = repaired_at_once(&soup);
    close(volume(&it), 3000.0, 1e-6);
    close(it.report.changes.unwrap().volume_change_pct.unwrap(), 0.0, 1e-6);
}

#[test]
fn boxes_whose_volumes_cancel_are_turned_without_a_flag() {
    let it = repaired_at_once(&join(&at(0.0, 10.0), &inside_out(at(40.0, 10.0))));
    close(volume(&it), 2000.0, 1e-6);
    assert!(it.report.changes.unwrap().volume_change_pct.is_none_or(|change| change.abs() < 1e-6));
}

#[test]
fn nested_boxes_of_every_orientation_are_repaired_at_once() {
    let volumes = [1000.0, 216.0, 8.0];
    for turned in 0..8u32 {
        let mut soup = Soup::default();
        for (number, half) in [5.0, 3.0, 1.0].into_iter().enumerate() {
            let part = about(half);
            soup = join(&soup, &if turned >> number & 1 == 1 { inside_out(part) } else { part });
        }
        let it = run(&soup, &Options::default(), None);
        let what = format!("{turned:03b}: {} {:?}", it.report.summary, it.report.red_flags);
        assert!(matches!(it.report.outcome, Outcome::Repaired | Outcome::AlreadyPrintable), "{what}");
        assert!(it.report.red_flags.is_empty() && it.report.candidates.len() == 1, "{what}");
        // A cavity stays a cavity, also in a solid that was inside out as a whole; an inner box as the outer one stays a solid,
        // unless that one alone was turned.
        let inner = match turned & 0b11 {
            0b00 => volumes[1],
            _ => -volumes[1],
        };
        close(volume(&it), volumes[0] + inner + volumes[2], 1e-6);
    }
}

#[test]
fn a_part_that_is_gone_is_still_flagged_where_another_was_inside_out() {
    // What is left after the loss has the volume that the input had by its signs.
    let input = join(&join(&at(0.0, 10.0), &at(20.0, 10.0)), &inside_out(at(40.0, 10.0)));
    let it = run(&input, &Options { max_volume_change_pct: 0.0, ..Options::default() }, None);
    assert!(it.report.red_flags.iter().all(|flag| flag.code != RedFlagCode::VolumeChange));
}

#[test]
fn six_loose_sides_with_gaps_are_a_box() {
    for gap in [1e-3, 1e-4] {
        let soup = apart(&cube(DVec3::splat(-5.0), 10.0, 1), 2, |_, middle| middle.normalize() * gap);
        let it = repaired_at_once(&soup);
        close(volume(&it), 1000.0, 1.0);
        assert_ne!(it.report.plan.category, Category::OpenSheet);
    }
}

#[test]
fn exploded_triangles_are_the_solid_that_they_were() {
    for gap in [1e-3, 1e-4] {
        for solid in [about(5.0), sphere(DVec3::ZERO, 10.0, 24, 12)] {
            let whole = {
                let it = run(&solid, &Options::default(), None);
                volume(&it)
            };
            let soup = apart(&solid, 1, |_, middle| middle.normalize() * gap);
            let it = run(&soup, &Options::default(), None);
            assert_eq!(it.report.outcome, Outcome::Repaired, "{gap}: {} {:?}", it.report.summary, it.report.red_flags);
            close(volume(&it), whole, whole * 2e-3);
        }
    }
}

#[test]
fn an_open_surface_in_pieces_is_still_a_sheet() {
    for soup in [sheet(12), apart(&sheet(12), 1, |number, _| DVec3::Z * 1e-4 * (number % 3) as f64)] {
        let it = run(&soup, &Options::default(), None);
        assert_eq!(it.report.plan.category, Category::OpenSheet);
        assert_ne!(it.report.outcome, Outcome::Repaired);
    }
}

#[test]
fn boxes_whose_tops_are_a_step_of_f32_apart_are_repaired_at_once_for_readers_of_eight_decimals() {
    // As in a robot's link in metres: there f32 tells positions apart that eight decimals do not.
    let (top, below) = (0.05f32, 0.05f32.next_down());
    let over = |p: DVec3| DVec3::new(0.1 * p.x - 0.03, 0.08 * p.y - 0.02, (f64::from(below) + 0.04) * p.z - 0.04);
    let mut wide = cube(DVec3::ZERO, 1.0, 1);
    wide.positions.iter_mut().for_each(|p| *p = over(*p));
    let it = repaired_at_once(&join(&cube(DVec3::ZERO, f64::from(top), 1), &wide));
    assert_eq!(it.report.after.unwrap().measures.near_coincident_defects, 0);
}

#[test]
fn a_ball_in_eight_chips_is_flagged_without_methods_that_start_from_the_same_closed_holes() {
    let mut chips = Soup::default();
    let ball = sphere(DVec3::ZERO, 10.0, 48, 24);
    for face in &ball.faces {
        let corners = face.map(|v| ball.positions[v as usize]);
        let octant = corners.into_iter().sum::<DVec3>().map(f64::signum);
        push(&mut chips, corners.map(|p| p + 0.05 * octant));
    }
    let it = run(&chips, &Options::default(), None).report;
    assert_eq!(it.outcome, Outcome::PartiallyRepaired, "{}", it.summary);
    assert!(it.red_flags.iter().any(|flag| flag.code == RedFlagCode::VolumeChange), "{:?}", it.red_flags);
    assert!(it.steps.iter().all(|step| step.operator != Some(Operator::Remesh)));
    let why = "it starts from the same closed holes, so it encloses the same room";
    assert!(it.steps.iter().any(|step| step.note.as_deref() == Some(why)), "{:?}", it.steps);
}
