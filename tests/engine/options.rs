//! Options take effect, or the report says why they did not.

use glam::DVec3;
use meshmend::format::{self, Format, Limits};
use meshmend::mesh::Soup;
use meshmend::repair::operators::orient::Nested;
use meshmend::repair::operators::stitch::StitchPosition;
use meshmend::repair::{
    AssumptionKind, Category, ChangeKind, Comparison, NotAppliedCause, OpenSheets, Operator, Options, Outcome,
    OutputFormat, Preset, RedFlagCode, Repaired, SurvivingInput, WindingRuleChoice, red_flags,
};

use crate::meshes::{as_f32, cube, join, push, sphere, torus};
use crate::support::{FixedRemesher, repair_bytes, repair_soup};

fn stl(soup: &Soup) -> Vec<u8> {
    format::write(soup, Format::Stl).unwrap()
}

/// The volume of each part, the largest box first.
fn volumes(bytes: &[u8]) -> Vec<f64> {
    let read = format::read(bytes, &Limits::default()).unwrap();
    let soup = read.soup;
    let mut parts: Vec<(f64, Vec<usize>)> = Vec::new();
    // The boxes in these tests have different sizes, so the size of a face shows which box it belongs to.
    for f in 0..soup.faces.len() {
        let reach = soup.corners(f).into_iter().map(|p| p.abs().max_element()).fold(0.0, f64::max);
        match parts.iter_mut().find(|(of_part, _)| (*of_part - reach).abs() < 1e-6) {
            Some((_, faces)) => faces.push(f),
            None => parts.push((reach, vec![f])),
        }
    }
    parts.sort_by(|x, y| y.0.total_cmp(&x.0));
    let volume = |faces: &Vec<usize>| {
        let of_face = |&f: &usize| {
            let [a, b, c] = soup.corners(f);
            a.dot(b.cross(c)) / 6.0
        };
        faces.iter().map(of_face).sum::<f64>()
    };
    parts.iter().map(|(_, faces)| volume(faces).round()).collect()
}

/// Nested boxes of 10, 6 and 3 units, all facing outward.
fn nested_boxes() -> Soup {
    let at = |size: f64| cube(DVec3::splat(-size / 2.0), size, 1);
    join(&join(&at(10.0), &at(6.0)), &at(3.0))
}

fn cause(repaired: &Repaired, option: &str) -> Option<NotAppliedCause> {
    repaired.report.options_not_applied.iter().find(|found| found.option == option).map(|found| found.cause)
}

#[test]
fn nested_boxes_that_are_printable_are_wound_in_layers_where_that_is_asked_for() {
    let bytes = stl(&nested_boxes());
    let usual = repair_bytes(&bytes, &Options::default(), None).unwrap();
    assert_eq!((usual.report.outcome, usual.bytes == bytes), (Outcome::AlreadyPrintable, true));
    assert!(usual.report.options_not_applied.is_empty());
    for options in [
        Options { nested: Nested::Alternate, ..Options::default() },
        Options { winding_rule: WindingRuleChoice::Odd, ..Options::default() },
    ] {
        let repaired = repair_bytes(&bytes, &options, None).unwrap();
        assert_eq!(volumes(&repaired.bytes), [1000.0, -216.0, 27.0], "{:?}", repaired.report.summary);
        assert_eq!(repaired.report.outcome, Outcome::Repaired, "{:?}", repaired.report.red_flags);
        assert!(repaired.report.options_not_applied.is_empty(), "{:?}", repaired.report.options_not_applied);
        // A model that already satisfies the option comes back unchanged, and the report says so.
        let again = repair_bytes(&repaired.bytes, &options, None).unwrap();
        assert_eq!((again.report.outcome, again.bytes == repaired.bytes), (Outcome::AlreadyPrintable, true));
        let [only] = again.report.options_not_applied.as_slice() else { panic!("{:?}", again.report.warnings) };
        assert_eq!(only.cause, NotAppliedCause::NothingToDo);
        assert_eq!(again.report.warnings.last(), Some(&only.in_words()));
    }
}

#[test]
fn a_requested_winding_rule_removes_solids_inside_a_solid() {
    let bytes = stl(&nested_boxes());
    for winding_rule in [WindingRuleChoice::Positive, WindingRuleChoice::Nonzero] {
        let repaired = repair_bytes(&bytes, &Options { winding_rule, ..Options::default() }, None).unwrap();
        assert_eq!(volumes(&repaired.bytes), [1000.0], "{:?}", repaired.report.summary);
        assert_eq!(repaired.report.outcome, Outcome::Repaired, "{:?}", repaired.report.red_flags);
    }
}

#[test]
fn objects_that_are_printable_are_wound_in_layers_too() {
    let bytes = format::write(&nested_boxes(), Format::ThreeMf).unwrap();
    let options = Options { nested: Nested::Alternate, output: OutputFormat::Stl, ..Options::default() };
    let same = Options { output: OutputFormat::Same, ..options.clone() };
    assert_eq!(volumes(&repair_bytes(&bytes, &options, None).unwrap().bytes), [1000.0, -216.0, 27.0]);
    let repaired = repair_bytes(&bytes, &same, None).unwrap();
    assert_eq!(volumes(&repaired.bytes), [1000.0, -216.0, 27.0]);
    assert!(repaired.report.options_not_applied.is_empty());
}

#[test]
fn a_preset_that_is_asked_for_runs_on_a_printable_model() {
    let bytes = stl(&torus(3.0, 1.0, 16, 8));
    for preset in [Preset::BasicCleanup, Preset::FullRepair, Preset::ConservativeRepair, Preset::ManifoldRepair] {
        let repaired = repair_bytes(&bytes, &Options { preset, ..Options::default() }, None).unwrap();
        assert_eq!((repaired.report.outcome, repaired.bytes == bytes), (Outcome::AlreadyPrintable, true), "{preset:?}");
        assert_eq!(repaired.report.plan.preset, preset);
        assert!(!repaired.report.steps.is_empty());
        assert_eq!(cause(&repaired, "preset"), Some(NotAppliedCause::NothingToDo));
    }
}

#[test]
fn a_remesh_that_is_asked_for_runs_on_a_printable_model() {
    let bytes = stl(&as_f32(sphere(DVec3::ZERO, 10.0, 24, 12)));
    let options = Options { with: vec![Operator::Remesh], voxel_size: Some(0.5), ..Options::default() };
    let repaired = repair_bytes(&bytes, &options, None).unwrap();
    assert_eq!(repaired.report.outcome, Outcome::Repaired, "{:?}", repaired.report.options_not_applied);
    assert!(repaired.report.options_not_applied.is_empty(), "{:?}", repaired.report.options_not_applied);
    assert_ne!(repaired.bytes, bytes);
}

/// A box with a sliver of this height along an edge of its top.
fn box_with_a_sliver(height: f64) -> Soup {
    let mut soup = Soup::default();
    let [a, b] = [DVec3::ZERO, DVec3::splat(10.0)];
    let corner = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    let mut quad = |q: [DVec3; 4]| {
        push(&mut soup, [q[0], q[1], q[2]]);
        push(&mut soup, [q[0], q[2], q[3]]);
    };
    let cut = height;
    quad([a, corner(0.0, 10.0, 0.0), corner(10.0, 10.0, 0.0), corner(10.0, 0.0, 0.0)]);
    // The top consists of a wide and a thin strip.
    quad([corner(0.0, 0.0, 10.0), corner(10.0, 0.0, 10.0), corner(10.0, cut, 10.0), corner(0.0, cut, 10.0)]);
    quad([corner(0.0, cut, 10.0), corner(10.0, cut, 10.0), b, corner(0.0, 10.0, 10.0)]);
    quad([a, corner(10.0, 0.0, 0.0), corner(10.0, 0.0, 10.0), corner(0.0, 0.0, 10.0)]);
    quad([corner(0.0, 10.0, 0.0), corner(0.0, 10.0, 10.0), b, corner(10.0, 10.0, 0.0)]);
    for x in [0.0, 10.0] {
        let ring = [[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [cut, 10.0], [0.0, 10.0]].map(|[y, z]| corner(x, y, z));
        for k in 1..4 {
            let t = [ring[0], ring[k], ring[k + 1]];
            push(&mut soup, if x > 0.0 { t } else { [t[0], t[2], t[1]] });
        }
    }
    soup
}

#[test]
fn slivers_of_a_printable_model_are_removed_with_a_tolerance() {
    let bytes = stl(&box_with_a_sliver(1e-3));
    let usual = repair_bytes(&bytes, &Options::default(), None).unwrap();
    assert_eq!((usual.report.outcome, usual.bytes == bytes), (Outcome::AlreadyPrintable, true));
    let repaired = repair_bytes(&bytes, &Options { degenerate_tolerance: 1e-3, ..Options::default() }, None).unwrap();
    assert_eq!(repaired.report.outcome, Outcome::Repaired, "{:?}", repaired.report.options_not_applied);
    assert_eq!(repaired.report.after.unwrap().measures.faces, 12);
    let finer = repair_bytes(&bytes, &Options { degenerate_tolerance: 1e-6, ..Options::default() }, None).unwrap();
    assert_eq!(
        (cause(&finer, "degenerate_tolerance"), finer.bytes == bytes),
        (Some(NotAppliedCause::NothingToDo), true)
    );
}

#[test]
fn options_without_effect_on_a_printable_model_are_reported() {
    let bytes = stl(&cube(DVec3::ZERO, 10.0, 2));
    let options = Options {
        open_sheets: OpenSheets::Thicken,
        thickness: Some(1.0),
        sew_ratio: Some(0.4),
        stitch_threshold: Some(0.005),
        voxel_size: Some(0.1),
        ..Options::default()
    };
    let repaired = repair_bytes(&bytes, &options, None).unwrap();
    assert_eq!((repaired.report.outcome, repaired.bytes == bytes), (Outcome::AlreadyPrintable, true));
    for option in ["open_sheets", "thickness", "sew_ratio", "stitch_threshold", "voxel_size"] {
        assert_eq!(cause(&repaired, option), Some(NotAppliedCause::NothingToDo), "{option}");
    }
    let without = Options { nested: Nested::Alternate, without: vec![Operator::Orient], ..Options::default() };
    assert_eq!(cause(&repair_bytes(&bytes, &without, None).unwrap(), "nested"), Some(NotAppliedCause::Excluded));
}

/// A box whose lid is `gap` above it.
fn box_with_a_lid_above(gap: f64, cells: u32) -> Soup {
    let mut soup = cube(DVec3::ZERO, 10.0, cells);
    for f in 0..soup.faces.len() {
        let on_top = soup.corners(f).iter().all(|p| p.z == 10.0);
        for v in soup.faces[f] {
            soup.positions[v as usize].z += if on_top { gap } else { 0.0 };
        }
    }
    soup
}

#[test]
fn a_requested_sewing_ratio_is_the_only_limit() {
    // The gap is a hundredth of the shortest edge, and more than a thousandth of the diagonal.
    let soup = box_with_a_lid_above(0.05, 2);
    let options = |sew_ratio| Options { sew_ratio, stitch_threshold: Some(0.0), ..Options::default() };
    let sewn = |repaired: &Repaired| {
        repaired.report.steps.iter().any(|step| step.operator == Some(Operator::Sew) && !step.changed.is_empty())
    };
    assert!(!sewn(&repair_soup(&soup, &options(None), None)));
    let repaired = repair_soup(&soup, &options(Some(0.2)), None);
    assert!(sewn(&repaired), "{:?}", repaired.report.steps);
    assert_eq!(repaired.report.outcome, Outcome::Repaired);
}

#[test]
fn a_crack_is_stitched_up_to_a_length_in_the_models_unit() {
    let soup = box_with_a_lid_above(0.05, 2);
    let stitched = |repaired: &Repaired| {
        repaired.report.steps.iter().any(|step| step.operator == Some(Operator::Stitch) && !step.changed.is_empty())
    };
    let options =
        |distance| Options { sew_ratio: Some(0.0), stitch_distance: Some(distance), max_tier: 2, ..Options::default() };
    assert!(!stitched(&repair_soup(&soup, &options(0.04), None)));
    let repaired = repair_soup(&soup, &options(0.06), None);
    assert!(stitched(&repaired), "{:?}", repaired.report.steps);
    assert_eq!(repaired.report.outcome, Outcome::Repaired);
    let heights = |repaired: &Repaired| -> Vec<f64> {
        format::read(&repaired.bytes, &Limits::default()).unwrap().soup.positions.iter().map(|p| p.z).collect()
    };
    let is_halfway = |z: &f64| (z - 10.025).abs() < 1e-5;
    assert!(!heights(&repaired).iter().any(is_halfway));
    let average = Options { stitch_position: StitchPosition::Average, ..options(0.06) };
    let repaired = repair_soup(&soup, &average, None);
    assert_eq!(repaired.report.outcome, Outcome::Repaired);
    assert!(heights(&repaired).iter().any(is_halfway), "{:?}", heights(&repaired));
    assert!(repaired.report.options_not_applied.is_empty(), "{:?}", repaired.report.options_not_applied);
}

#[test]
fn a_gap_wider_than_its_edges_allow_is_reported() {
    // The gap is wider than half of an edge, which is 0.5.
    let soup = box_with_a_lid_above(0.7, 10);
    let options = Options { stitch_distance: Some(1.0), preset: Preset::FullRepair, max_tier: 2, ..Options::default() };
    let repaired = repair_soup(&soup, &options, None);
    assert_eq!(
        cause(&repaired, "stitch_distance"),
        Some(NotAppliedCause::Limited),
        "{:?}",
        repaired.report.options_not_applied
    );
    assert!(repaired.report.warnings.iter().any(|warning| warning.starts_with("`stitch_distance=1.0`")));
}

#[test]
fn a_weld_tolerance_limited_by_shorter_edges_is_reported() {
    let soup = box_with_a_lid_above(0.02, 40);
    let welded = |weld_tolerance| repair_soup(&soup, &Options { weld_tolerance, ..Options::default() }, None);
    assert_eq!(cause(&welded(0.01), "weld_tolerance"), Some(NotAppliedCause::Limited));
    assert_eq!(cause(&welded(1e-6), "weld_tolerance"), None);
}

#[test]
fn a_movement_limit_that_restricts_an_option_is_reported() {
    let soup = box_with_a_lid_above(0.05, 2);
    let limited = Options { stitch_distance: Some(0.06), max_deviation: Some(0.01), ..Options::default() };
    let repaired = repair_soup(&soup, &Options { preset: Preset::FullRepair, max_tier: 2, ..limited }, None);
    assert_eq!(
        cause(&repaired, "stitch_distance"),
        Some(NotAppliedCause::Limited),
        "{:?}",
        repaired.report.options_not_applied
    );
}

#[test]
fn vertices_are_merged_by_their_distance_alone() {
    // Two vertices of each long side are close, and none is on a boundary.
    let bytes = stl(&box_with_a_sliver(1e-3));
    let repaired = repair_bytes(&bytes, &Options { merge_distance: Some(0.01), ..Options::default() }, None).unwrap();
    assert_eq!(repaired.report.outcome, Outcome::Repaired, "{:?}", repaired.report.options_not_applied);
    assert_eq!(repaired.report.after.unwrap().measures.faces, 12);
    let nothing = repair_bytes(&bytes, &Options { merge_distance: Some(1e-4), ..Options::default() }, None).unwrap();
    assert_eq!((cause(&nothing, "merge_distance"), nothing.bytes == bytes), (Some(NotAppliedCause::NothingToDo), true));
}

#[test]
fn small_parts_are_dropped_on_request_and_reported() {
    let crumbs = join(&cube(DVec3::new(20.0, 0.0, 0.0), 0.2, 1), &sphere(DVec3::new(0.0, 20.0, 0.0), 0.3, 8, 6));
    let soup = as_f32(join(&cube(DVec3::ZERO, 10.0, 1), &crumbs));
    let bytes = stl(&soup);
    assert_eq!(repair_bytes(&bytes, &Options::default(), None).unwrap().bytes, bytes);
    let options = Options { min_part_volume_pct: 1.0, ..Options::default() };
    let repaired = repair_bytes(&bytes, &options, None).unwrap();
    assert_eq!(
        repaired.report.outcome,
        Outcome::Repaired,
        "{:?} {:?}",
        repaired.report.options_not_applied,
        repaired.report.red_flags
    );
    assert_eq!(repaired.report.after.as_ref().unwrap().measures.parts, 1);
    let part_accounting = repaired.report.part_accounting.as_ref().unwrap();
    assert_eq!((part_accounting.lost, part_accounting.dropped, part_accounting.kept), (0, 2, 1));
    let assumption = repaired.report.assumptions.iter().find(|a| a.kind == AssumptionKind::PiecesDropped).unwrap();
    assert_eq!((assumption.count, assumption.option.as_deref()), (2, Some("min_part_volume_pct=0")));
    // A broken part is repaired first, and kept because it is large.
    let mut broken = join(&soup, &cube(DVec3::new(0.0, 0.0, 20.0), 8.0, 1));
    broken.faces.pop();
    let result = repair_soup(&broken, &options, None);
    assert_eq!(result.report.outcome, Outcome::Repaired, "{:?}", result.report.red_flags);
    assert_eq!(result.report.after.as_ref().unwrap().measures.parts, 2);
}

#[test]
fn the_cavities_of_a_part_go_with_it_and_those_of_others_stay() {
    let hollow = |at: DVec3, size: f64| {
        let inner = crate::meshes::inside_out(cube(at + DVec3::splat(size / 4.0), size / 2.0, 1));
        join(&cube(at, size, 1), &inner)
    };
    let soup = join(&hollow(DVec3::ZERO, 10.0), &hollow(DVec3::splat(20.0), 1.0));
    let repaired = repair_soup(&soup, &Options { min_part_volume_pct: 5.0, ..Options::default() }, None);
    assert_eq!(repaired.report.outcome, Outcome::Repaired, "{:?}", repaired.report.red_flags);
    assert!((repaired.report.after.unwrap().measures.volume.value - 875.0).abs() < 1e-6);
}

#[test]
fn a_category_that_is_given_chooses_the_plan() {
    let mut soup = cube(DVec3::ZERO, 1.0, 2);
    soup.faces.pop();
    let repaired = repair_soup(&soup, &Options { category: Some(Category::NonManifold), ..Options::default() }, None);
    assert_eq!(
        (repaired.report.plan.category, repaired.report.plan.preset),
        (Category::NonManifold, Preset::ManifoldRepair)
    );
    assert!(repaired.report.plan.reason.contains("non_manifold"));
    assert_eq!(repaired.report.outcome, Outcome::Repaired);
    let whole = repair_soup(
        &cube(DVec3::ZERO, 1.0, 2),
        &Options { category: Some(Category::Holes), ..Options::default() },
        None,
    );
    assert_eq!((whole.report.outcome, whole.report.plan.preset), (Outcome::AlreadyPrintable, Preset::FullRepair));
    let both = Options { category: Some(Category::Holes), preset: Preset::FillHoles, ..Options::default() };
    assert_eq!(cause(&repair_soup(&soup, &both, None), "category"), Some(NotAppliedCause::Excluded));
}

#[test]
fn a_result_that_lost_most_of_the_vertices_is_flagged() {
    let before = repair_soup(&sphere(DVec3::ZERO, 1.0, 24, 12), &Options::default(), None).report;
    let after = repair_soup(&sphere(DVec3::ZERO, 1.0, 8, 6), &Options::default(), None).report;
    let flagged = |vertices, options: &Options| {
        let surviving = SurvivingInput {
            faces: 200,
            parts_gone: 0,
            vertices,
            vertices_before: before.before.measures.vertices,
            faces_dropped: 0,
        };
        let (before, changes) = (&before.before.measures, before.changes.as_ref().unwrap());
        let (settled, after) = (before.volume, &after.before.measures);
        let flags = red_flags(
            &Comparison { before, was_open: false, settled, after, changes, surviving, is_interior_filled: false },
            options,
        );
        flags.iter().any(|flag| flag.code == RedFlagCode::VertexLoss)
    };
    let usual = Options::default();
    assert!(flagged(100, &usual));
    // The merged vertices belong to faces that remain.
    assert!(!flagged(250, &usual));
    assert!(!flagged(100, &Options { max_vertex_loss_pct: 100.0, ..usual.clone() }));
    assert!(!flagged(100, &Options { max_faces: Some(100), ..usual }));
}

#[test]
fn neighbours_that_overlap_go_up_to_the_angle_that_is_asked_for() {
    // A fin folded back to within 10 degrees of a side, farther from it than a ten-thousandth of the diagonal.
    let mut soup = cube(DVec3::ZERO, 10.0, 1);
    let tip = DVec3::new(5.0, -5.0, 10.0 + 5.0 * 10f64.to_radians().tan());
    let tip = DVec3::new(tip.x, 5.0, tip.z);
    push(&mut soup, [DVec3::new(0.0, 0.0, 10.0), DVec3::new(10.0, 0.0, 10.0), tip]);
    let with = vec![Operator::RemoveOverlappingNeighbours];
    let removed = |repaired: &Repaired| {
        let steps =
            repaired.report.steps.iter().filter(|step| step.operator == Some(Operator::RemoveOverlappingNeighbours));
        steps.flat_map(|step| &step.changed).any(|change| change.kind == ChangeKind::OverlappingFacesRemoved)
    };
    let usual = Options { preset: Preset::ConservativeRepair, max_tier: 2, ..Options::default() };
    let run_with = |overlap_angle_deg| {
        repair_soup(&soup, &Options { with: with.clone(), overlap_angle_deg, ..usual.clone() }, None)
    };
    assert!(!removed(&run_with(None)));
    assert!(removed(&run_with(Some(15.0))));
    let alone = repair_soup(&soup, &Options { overlap_angle_deg: Some(15.0), ..usual.clone() }, None);
    assert_eq!(cause(&alone, "overlap_angle_deg"), Some(NotAppliedCause::Excluded));
}

#[test]
fn faces_with_an_ambiguous_outer_side_are_listed() {
    let mut soup = Soup::default();
    push(&mut soup, [DVec3::ZERO, DVec3::X, DVec3::Y]);
    push(&mut soup, [DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::Y]);
    let repaired = repair_soup(&soup, &Options::default(), None);
    let listed = repaired.report.steps.iter().find_map(|step| step.unfixed.as_ref()).unwrap();
    assert_eq!((listed.count, listed.faces.as_slice()), (2, [0, 1].as_slice()));
}

#[test]
fn options_out_of_range_are_refused_by_name() {
    for (options, name) in [
        (Options { merge_distance: Some(-1.0), ..Options::default() }, "merge_distance"),
        (Options { stitch_distance: Some(f64::NAN), ..Options::default() }, "stitch_distance"),
        (Options { stitch_epsilon: 1.5, ..Options::default() }, "stitch_epsilon"),
        (Options { min_part_volume_pct: 101.0, ..Options::default() }, "min_part_volume_pct"),
        (Options { max_vertex_loss_pct: -1.0, ..Options::default() }, "max_vertex_loss_pct"),
        (Options { sew_ratio: Some(0.6), ..Options::default() }, "sew_ratio"),
    ] {
        assert!(options.validate().unwrap_err().to_string().contains(name));
    }
}

#[cfg(feature = "openapi")]
#[test]
fn every_option_is_known_to_the_account_of_those_that_were_not_applied() {
    use meshmend::repair::PrintOptions;
    use utoipa::IntoParams;
    let all = Options::into_params(|| None).into_iter().chain(PrintOptions::into_params(|| None));
    let names: Vec<String> = all.map(|option| option.name).collect();
    assert_eq!(meshmend::repair::options_accounted_for(), names);
}

#[test]
fn a_rejected_remesh_is_named_as_the_reason_why_its_options_have_no_effect() {
    let mut open = cube(DVec3::ZERO, 10.0, 1);
    open.faces.pop();
    let options = Options { preset: Preset::BlenderRemesh, voxel_size: Some(0.3), ..Options::default() };
    let smaller = FixedRemesher::returning(cube(DVec3::splat(2.0), 6.0, 3));
    let repaired = repair_bytes(&stl(&open), &options, Some(&smaller)).unwrap();
    assert_eq!(volumes(&repaired.bytes), [1000.0]);
    assert_eq!(cause(&repaired, "voxel_size"), Some(NotAppliedCause::MadeWorse));
    assert_eq!(cause(&repaired, "preset"), Some(NotAppliedCause::Limited));
    let same = FixedRemesher::returning(cube(DVec3::ZERO, 10.0, 3));
    let repaired = repair_bytes(&stl(&open), &options, Some(&same)).unwrap();
    assert_eq!((cause(&repaired, "voxel_size"), cause(&repaired, "preset")), (None, None));
}
