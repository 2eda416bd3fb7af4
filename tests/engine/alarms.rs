//! Red flags without false alarms: stray faces, inverted parts and cracks do not make a good repair look bad.

use glam::DVec3;
use meshmend::mesh::Soup;
use meshmend::repair::{Category, Operator, Options, Outcome, RedFlagCode, Repaired};

use crate::meshes::{cube, inside_out, join, push, sheet, sphere};
use crate::support::{assert_outcome, repair_soup};

/// Repairs without Blender, and asserts that the first strategy gives a good result.
fn repaired_at_once(soup: &Soup) -> Repaired {
    let repaired = repair_soup(soup, &Options::default(), None);
    assert_outcome(&repaired, Outcome::Repaired);
    assert_eq!(repaired.report.red_flags, []);
    assert_eq!(repaired.report.candidates.len(), 1, "the first result is good");
    repaired
}

fn volume(repaired: &Repaired) -> f64 {
    repaired.report.after.as_ref().unwrap().measures.volume.value
}

fn assert_close(a: f64, b: f64, most: f64) {
    assert!((a - b).abs() <= most, "{a} is not {b}");
}

fn cube_at(x: f64, size: f64) -> Soup {
    cube(DVec3::new(x, 0.0, 0.0), size, 1)
}

/// A box centred on the origin.
fn centered_cube(half: f64) -> Soup {
    cube(DVec3::splat(-half), 2.0 * half, 1)
}

/// The soup split into groups of faces, each moved by `shift` of its index and its centre.
fn split_into_groups(soup: &Soup, faces_a_group: usize, shift: impl Fn(usize, DVec3) -> DVec3) -> Soup {
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
    let mut soup = cube_at(0.0, 10.0);
    push(&mut soup, [DVec3::new(500.0, 0.0, 0.0); 3]);
    push(&mut soup, [600.0, 601.0, 602.0].map(DVec3::splat));
    let repaired = repaired_at_once(&soup);
    let changes = repaired.report.changes.unwrap();
    assert_eq!(changes.bounding_box_change_pct, Some(0.0));
    assert!((volume(&repaired) - 1000.0).abs() < 1e-9, "{}", volume(&repaired));
}

#[test]
fn a_removed_face_with_an_area_still_changes_the_bounding_box() {
    let soup = join(&cube_at(0.0, 1.0), &cube_at(50.0, 1.0));
    let options = Options { with: vec![], ..Options::default() };
    let whole = repair_soup(&soup, &options, None);
    assert_eq!(whole.report.outcome, Outcome::AlreadyPrintable);
    let (before, after) = (soup, cube_at(0.0, 1.0));
    let cancel = std::sync::atomic::AtomicBool::new(false);
    let clock = || std::time::Duration::ZERO;
    let context =
        meshmend::repair::Context::new(&meshmend::repair::NoProgress, &cancel, &clock, std::time::Duration::MAX);
    let [a, b] = [&before, &after].map(|soup| meshmend::inspect::Analysis::new(soup.into(), &context).unwrap());
    let comparison = meshmend::inspect::compare(&a, &b, Default::default(), &context).unwrap();
    assert!(comparison.changes.bounding_box_change_pct.unwrap() > 90.0);
    assert!(!comparison.faithful);
}

#[test]
fn one_of_three_boxes_inside_out_changes_no_volume() {
    let soup = join(&join(&cube_at(0.0, 10.0), &cube_at(20.0, 10.0)), &inside_out(cube_at(40.0, 10.0)));
    let repaired = repaired_at_once(&soup);
    assert_close(volume(&repaired), 3000.0, 1e-6);
    assert_close(repaired.report.changes.unwrap().volume_change_pct.unwrap(), 0.0, 1e-6);
}

#[test]
fn boxes_whose_volumes_cancel_are_turned_without_a_flag() {
    let repaired = repaired_at_once(&join(&cube_at(0.0, 10.0), &inside_out(cube_at(40.0, 10.0))));
    assert_close(volume(&repaired), 2000.0, 1e-6);
    assert!(repaired.report.changes.unwrap().volume_change_pct.is_none_or(|change| change.abs() < 1e-6));
}

#[test]
fn nested_boxes_of_every_orientation_are_repaired_at_once() {
    let volumes = [1000.0, 216.0, 8.0];
    for turned in 0..8u32 {
        let mut soup = Soup::default();
        for (number, half) in [5.0, 3.0, 1.0].into_iter().enumerate() {
            let part = centered_cube(half);
            soup = join(&soup, &if turned >> number & 1 == 1 { inside_out(part) } else { part });
        }
        let repaired = repair_soup(&soup, &Options::default(), None);
        let what = format!("{turned:03b}: {} {:?}", repaired.report.summary, repaired.report.red_flags);
        assert!(matches!(repaired.report.outcome, Outcome::Repaired | Outcome::AlreadyPrintable), "{what}");
        assert!(repaired.report.red_flags.is_empty() && repaired.report.candidates.len() == 1, "{what}");
        // A cavity stays a cavity, even if the whole model was inside out. An inner box with the orientation of the outer one
        // stays a solid, unless only the outer one was flipped.
        let inner = match turned & 0b11 {
            0b00 => volumes[1],
            _ => -volumes[1],
        };
        assert_close(volume(&repaired), volumes[0] + inner + volumes[2], 1e-6);
    }
}

#[test]
fn a_missing_part_is_still_flagged_if_another_part_was_inside_out() {
    // Without the lost part, the result has the same volume as the signed volumes of the input add up to.
    let input = join(&join(&cube_at(0.0, 10.0), &cube_at(20.0, 10.0)), &inside_out(cube_at(40.0, 10.0)));
    let repaired = repair_soup(&input, &Options { max_volume_change_pct: 0.0, ..Options::default() }, None);
    assert!(repaired.report.red_flags.iter().all(|flag| flag.code != RedFlagCode::VolumeChange));
}

#[test]
fn six_loose_sides_with_gaps_are_a_box() {
    for gap in [1e-3, 1e-4] {
        let soup = split_into_groups(&cube(DVec3::splat(-5.0), 10.0, 1), 2, |_, middle| middle.normalize() * gap);
        let repaired = repaired_at_once(&soup);
        assert_close(volume(&repaired), 1000.0, 1.0);
        assert_ne!(repaired.report.plan.category, Category::OpenSheet);
    }
}

#[test]
fn exploded_triangles_are_the_solid_that_they_were() {
    for gap in [1e-3, 1e-4] {
        for solid in [centered_cube(5.0), sphere(DVec3::ZERO, 10.0, 24, 12)] {
            let whole = {
                let repaired = repair_soup(&solid, &Options::default(), None);
                volume(&repaired)
            };
            let soup = split_into_groups(&solid, 1, |_, middle| middle.normalize() * gap);
            let result = repair_soup(&soup, &Options::default(), None);
            assert_eq!(
                result.report.outcome,
                Outcome::Repaired,
                "{gap}: {} {:?}",
                result.report.summary,
                result.report.red_flags
            );
            assert_close(volume(&result), whole, whole * 2e-3);
        }
    }
}

#[test]
fn an_open_surface_in_pieces_is_still_a_sheet() {
    for soup in [sheet(12), split_into_groups(&sheet(12), 1, |number, _| DVec3::Z * 1e-4 * (number % 3) as f64)] {
        let repaired = repair_soup(&soup, &Options::default(), None);
        assert_eq!(repaired.report.plan.category, Category::OpenSheet);
        assert_ne!(repaired.report.outcome, Outcome::Repaired);
    }
}

#[test]
fn boxes_with_tops_one_f32_step_apart_are_repaired_for_readers_of_eight_decimals() {
    // Small coordinates, as in a robot part in metres: f32 distinguishes positions that are equal in eight decimals.
    let (top, below) = (0.05f32, 0.05f32.next_down());
    let over = |p: DVec3| DVec3::new(0.1 * p.x - 0.03, 0.08 * p.y - 0.02, (f64::from(below) + 0.04) * p.z - 0.04);
    let mut wide = cube(DVec3::ZERO, 1.0, 1);
    wide.positions.iter_mut().for_each(|p| *p = over(*p));
    let repaired = repaired_at_once(&join(&cube(DVec3::ZERO, f64::from(top), 1), &wide));
    assert_eq!(repaired.report.after.unwrap().measures.near_coincident_defects, 0);
}

#[test]
fn a_sphere_cut_into_eight_is_flagged_and_methods_sharing_its_closed_holes_skipped() {
    let mut chips = Soup::default();
    let ball = sphere(DVec3::ZERO, 10.0, 48, 24);
    for face in &ball.faces {
        let corners = face.map(|v| ball.positions[v as usize]);
        let octant = corners.into_iter().sum::<DVec3>().map(f64::signum);
        push(&mut chips, corners.map(|p| p + 0.05 * octant));
    }
    let repaired = repair_soup(&chips, &Options::default(), None).report;
    assert_eq!(repaired.outcome, Outcome::PartiallyRepaired, "{}", repaired.summary);
    assert!(repaired.red_flags.iter().any(|flag| flag.code == RedFlagCode::VolumeChange), "{:?}", repaired.red_flags);
    assert!(repaired.steps.iter().all(|step| step.operator != Some(Operator::Remesh)));
    let why = "the strategy starts from the same closed holes, so it would enclose the same space";
    assert!(repaired.steps.iter().any(|step| step.note.as_deref() == Some(why)), "{:?}", repaired.steps);
}

#[test]
fn surface_seen_through_a_pinhole_alone_is_not_lost() {
    let options = Options { max_surface_lost_pct: 0.2, ..Options::default() };
    // A ball reaches into a box. `open` faces of the box's top are missing, above what is then inside the box.
    let seen_through = |open: usize| {
        let mut soup = cube(DVec3::ZERO, 10.0, 24);
        let middle = DVec3::new(5.0, 5.0, 10.0);
        let distance =
            |face: &[u32; 3]| face.map(|v| soup.positions[v as usize]).iter().sum::<DVec3>().distance(middle * 3.0);
        let mut near: Vec<usize> = (0..soup.faces.len()).collect();
        near.sort_by(|&a, &b| distance(&soup.faces[a]).total_cmp(&distance(&soup.faces[b])));
        let gone: Vec<usize> = near[..open].to_vec();
        let mut kept = 0..;
        soup.faces.retain(|_| kept.next().is_some_and(|f| !gone.contains(&f)));
        let ball = sphere(DVec3::new(5.0, 9.0, 6.0), 3.9, 32, 16);
        repair_soup(&join(&soup, &ball), &options, None)
    };
    let pinhole = seen_through(12);
    assert_eq!(pinhole.report.red_flags, []);
    assert_outcome(&pinhole, Outcome::Repaired);
    assert_eq!(pinhole.report.changes.unwrap().surface_lost_pct, Some(0.0));
    let opening = seen_through(60).report.changes.unwrap();
    assert!(opening.surface_lost_pct.unwrap() > 1.0, "an opening of a twentieth of the top shows the inside");
}
