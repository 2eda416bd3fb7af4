//! Preparation for a printing process: size, cavities, islands, interiors, walls, and the rules of the process.

use glam::{DVec3, IVec3};
use meshmend::mesh::Soup;
use meshmend::printing::rules::{PrintRule, RuleOutcome, RuleResult};
use meshmend::repair::{
    AssumptionKind, DrilledVent, Interior, Islands, NotAppliedCause, OfferedFile, Options, Outcome, OutputFormat,
    Preset, PrintOptions, Repaired, Require, Voids,
};
use meshmend::scene::Unit;

use crate::meshes::{as_f32, cube, cuboid, inside_out, join, push, sphere};
use crate::support::{assert_outcome, measured_file, repair_soup};

fn run(soup: &Soup, print: PrintOptions) -> Repaired {
    let options = Options { print, unit: Some(Unit::Millimetre), max_tier: 2, ..Options::default() };
    repair_soup(soup, &options, None)
}

/// The rule's result in a report.
fn rule(repaired: &Repaired, rule: PrintRule) -> &RuleResult {
    let readiness = repaired.report.print_ready.as_ref().expect("an assessment");
    readiness.rules.iter().find(|result| result.rule == rule).expect("the rule")
}

fn volume(repaired: &Repaired) -> f64 {
    measured_file(&repaired.bytes).volume.value
}

/// A cube of 20 mm with a sealed cubic cavity of 10 mm.
fn hollow_cube() -> Soup {
    join(&cube(DVec3::ZERO, 20.0, 2), &inside_out(cube(DVec3::splat(5.0), 10.0, 2)))
}

/// A ball of radius 20 as two skins, each without some faces.
fn double_shell(gap: f64) -> Soup {
    let inner = inside_out(sphere(DVec3::ZERO, 20.0 - gap, 96, 48));
    let mut both = as_f32(join(&sphere(DVec3::ZERO, 20.0, 96, 48), &inner));
    let faces = both.faces.len();
    let mut at = 0;
    both.faces.retain(|_| {
        at += 1;
        !(at % (faces / 2) == 1200 || at % (faces / 2) == 3000)
    });
    both
}

#[test]
fn a_model_is_scaled_to_the_requested_height_or_longest_side() {
    let plate = cuboid(DVec3::ZERO, DVec3::new(4.0, 2.0, 1.0), 1);
    let tall = run(&plate, PrintOptions { target_height_mm: Some(30.0), ..PrintOptions::default() });
    let size = tall.report.after.as_ref().and_then(|after| after.print.as_ref()).expect("measures").size_mm;
    assert_eq!(size, [120.0, 60.0, 30.0]);
    assert_eq!(tall.report.scaled_by, Some(30.0));
    assert!(tall.report.summary.contains("scaled to the requested size"), "{}", tall.report.summary);
    let long = run(&plate, PrintOptions { target_longest_mm: Some(60.0), ..PrintOptions::default() });
    assert_eq!(long.report.scaled_by, Some(15.0));
    assert!((volume(&long) - 60.0 * 30.0 * 15.0).abs() < 1e-6);
}

#[test]
fn a_requested_size_ends_doubts_about_the_unit() {
    let tiny = cuboid(DVec3::ZERO, DVec3::new(0.05, 0.03, 0.002), 1);
    let warnings = |target_longest_mm| {
        let print = PrintOptions { target_longest_mm, ..PrintOptions::default() };
        let report = repair_soup(&tiny, &Options { print, ..Options::default() }, None).report;
        (report.warnings, report.unit.note)
    };
    let (without_size, note) = warnings(None);
    assert!(without_size.len() == 1 && note.is_some(), "{without_size:?}, {note:?}");
    assert_eq!(warnings(Some(50.0)), (vec![], None));
}

#[test]
fn a_sealed_cavity_is_kept_by_default_and_filled_on_request() {
    let kept = run(&hollow_cube(), PrintOptions::default());
    assert_eq!(kept.report.outcome, Outcome::AlreadyPrintable);
    assert!((volume(&kept) - 7000.0).abs() < 1e-6);
    let filled = run(&hollow_cube(), PrintOptions { voids: Voids::Fill, ..PrintOptions::default() });
    assert_outcome(&filled, Outcome::Repaired);
    assert!((volume(&filled) - 8000.0).abs() < 1e-6);
    assert!(filled.report.red_flags.is_empty());
}

#[test]
fn only_cavities_up_to_a_volume_are_filled() {
    let small = inside_out(cube(DVec3::splat(1.0), 2.0, 1));
    let soup = join(&hollow_cube(), &small);
    let print = PrintOptions { keep_cavities_over_mm3: Some(8.0), ..PrintOptions::default() };
    let filled = run(&soup, print);
    assert_outcome(&filled, Outcome::Repaired);
    assert!((volume(&filled) - 7000.0).abs() < 1e-6, "the small cavity of 8 mm³ is filled, and the large one is kept");
    let all = PrintOptions { keep_cavities_over_mm3: Some(1e6), ..PrintOptions::default() };
    assert!((volume(&run(&soup, all)) - 8000.0).abs() < 1e-6);
    let none = PrintOptions { keep_cavities_over_mm3: Some(7.9), ..PrintOptions::default() };
    let unchanged = run(&soup, none);
    assert!((volume(&unchanged) - 6992.0).abs() < 1e-6);
    let not_applied = &unchanged.report.options_not_applied;
    assert_eq!(not_applied.iter().map(|entry| entry.option.as_str()).collect::<Vec<_>>(), ["keep_cavities_over_mm3"]);
}

#[test]
fn cavities_that_no_vent_reaches_are_counted_by_reason() {
    let cavity = |at: f64, side: f64| inside_out(cube(DVec3::splat(at), side, 2));
    let holey =
        [cavity(5.0, 5.0), cavity(12.0, 3.0)].iter().fold(cube(DVec3::ZERO, 20.0, 2), |all, one| join(&all, one));
    let print = PrintOptions { voids: Voids::Vent, vent_diameter_mm: Some(30.0), ..PrintOptions::default() };
    let repaired = run(&holey, print);
    assert_outcome(&repaired, Outcome::AlreadyPrintable);
    let reasons =
        repaired.report.options_not_applied.iter().map(|entry| (entry.option.as_str(), entry.reason.as_str()));
    let no_way = "2 cavities, of which the largest is at (7.500000, 7.500000, 7.500000): no straight bore of this diameter \
                  leads through one wall to the outside";
    assert_eq!(reasons.collect::<Vec<_>>(), [("voids", no_way), ("vent_diameter_mm", "no cavity was vented")]);
}

#[test]
fn a_vented_cavity_is_open_and_its_process_accepts_it() {
    let process = Some("sla".to_owned());
    let sealed = run(&hollow_cube(), PrintOptions { process: process.clone(), ..PrintOptions::default() });
    assert_eq!(rule(&sealed, PrintRule::EscapeHoles).result, RuleOutcome::Fail);
    assert_eq!(rule(&sealed, PrintRule::EscapeHoles).places.len(), 1);
    let vented = run(&hollow_cube(), PrintOptions { voids: Voids::Vent, process, ..PrintOptions::default() });
    assert_outcome(&vented, Outcome::Repaired);
    assert_eq!(measured_file(&vented.bytes).parts, 1);
    assert_eq!(rule(&vented, PrintRule::EscapeHoles).result, RuleOutcome::Pass);
    let bore = 7000.0 - volume(&vented);
    assert!((40.0..60.0).contains(&bore), "a bore of 3.5 mm through 5 mm removes about 49 mm³, not {bore}");
    let vents: Vec<&DrilledVent> = vented.report.steps.iter().flat_map(|step| &step.vents).collect();
    let [vent] = vents[..] else { panic!("one vent: {vents:?}") };
    assert_eq!((vent.diameter_mm, vent.length_mm, vent.cavity_volume_mm3), (3.5, 5.0, 1000.0));
    let (mouth, cavity) = (DVec3::from_array(vent.at), DVec3::from_array(vent.cavity));
    assert!(cavity.cmpgt(DVec3::splat(5.0)).all() && cavity.cmplt(DVec3::splat(15.0)).all(), "inside: {cavity}");
    let inner_end = mouth - vent.length_mm * DVec3::from_array(vent.direction);
    let on_wall = |at: DVec3, wall: f64| (at - 10.0).abs().max_element() == wall;
    assert!(on_wall(mouth, 10.0) && on_wall(inner_end, 5.0), "{vent:?}");
}

#[test]
fn a_narrow_sealed_cavity_is_no_engraving_but_the_same_groove_outside_is() {
    let groove = |z: f64| inside_out(cuboid(DVec3::new(5.0, 5.0, z), DVec3::new(10.0, 10.0, 0.3), 1));
    let process = Some("sls".to_owned());
    let narrow = |soup: &Soup| {
        let assessed = run(soup, PrintOptions { process: process.clone(), ..PrintOptions::default() });
        [PrintRule::EngravedDetail, PrintRule::Gap].map(|one| rule(&assessed, one).result == RuleOutcome::Fail)
    };
    let sealed = join(&cube(DVec3::ZERO, 20.0, 2), &groove(10.0));
    assert_eq!(narrow(&sealed), [false, false]);
    // Two halves of a cube with a groove between them, which is open on one side.
    let half = |z: f64, height: f64| cuboid(DVec3::new(0.0, 0.0, z), DVec3::new(20.0, 20.0, height), 1);
    let back = cuboid(DVec3::ZERO, DVec3::new(20.0, 15.0, 20.0), 1);
    let open = join(&join(&half(0.0, 9.8), &half(10.2, 9.8)), &back);
    assert!(narrow(&open).contains(&true));
}

#[test]
fn a_thin_wall_between_two_blocks_is_no_embossed_detail_but_a_low_rib_is() {
    let thin = |between: [DVec3; 2]| {
        let [at, size] = between;
        let block = |x: f64| cuboid(DVec3::new(x, 0.0, 0.0), DVec3::new(8.0, 12.0, 10.0), 1);
        let soup = join(&join(&block(0.0), &block(16.0)), &cuboid(at, size, 1));
        let assessed = run(&soup, PrintOptions { process: Some("tpu".to_owned()), ..PrintOptions::default() });
        [PrintRule::SupportedWall, PrintRule::EmbossedDetail].map(|one| rule(&assessed, one).measured)
    };
    // All corners of the wall lie on the edges where it meets the blocks.
    let [wall, detail] = thin([DVec3::new(7.0, 5.5, 0.0), DVec3::new(10.0, 0.9, 10.0)]);
    assert!(detail.is_none() && wall.is_some_and(|wall| (wall - 0.9).abs() < 1e-3), "{wall:?}, {detail:?}");
    let [wall, detail] = thin([DVec3::new(1.0, 5.8, 9.0), DVec3::new(6.0, 0.4, 1.5)]);
    assert!(wall.is_none() && detail.is_some_and(|rib| (rib - 0.4).abs() < 1e-3), "{wall:?}, {detail:?}");
}

#[test]
fn a_low_stub_is_a_raised_detail_and_a_tall_one_is_a_pin() {
    let failed = |height: f64| {
        let stub = cuboid(DVec3::new(4.0, 4.0, 5.0), DVec3::new(0.8, 0.9, 5.0 + height), 1);
        let soup = join(&cube(DVec3::ZERO, 10.0, 1), &stub);
        let assessed = run(&soup, PrintOptions { process: Some("tpu".to_owned()), ..PrintOptions::default() });
        let readiness = assessed.report.print_ready.expect("an assessment");
        let failed = readiness.rules.iter().filter(|result| result.result != RuleOutcome::Pass);
        failed.map(|result| result.rule).collect::<Vec<_>>()
    };
    // Pins need 2 mm, details 0.5 mm.
    assert_eq!(failed(1.2), []);
    assert_eq!(failed(4.0), [PrintRule::Pin]);
}

#[test]
fn small_separate_solids_stay_unless_the_options_drop_them() {
    let crumb = cube(DVec3::new(30.0, 0.0, 0.0), 0.5, 1);
    let soup = join(&cube(DVec3::ZERO, 20.0, 2), &crumb);
    let process = Some("sls".to_owned());
    let kept = run(&soup, PrintOptions { process: process.clone(), ..PrintOptions::default() });
    let failed = rule(&kept, PrintRule::PartVolume);
    assert_eq!((failed.result, failed.measured, failed.count), (RuleOutcome::Fail, Some(0.125), 1));
    let dropped = run(&soup, PrintOptions { islands: Islands::Drop, process, ..PrintOptions::default() });
    assert_outcome(&dropped, Outcome::Repaired);
    assert_eq!(measured_file(&dropped.bytes).parts, 1);
    assert!((volume(&dropped) - 8000.0).abs() < 1e-6);
    assert_eq!(rule(&dropped, PrintRule::PartVolume).result, RuleOutcome::Pass);
    assert!(dropped.report.red_flags.is_empty(), "{:?}", dropped.report.red_flags);
}

#[test]
fn a_double_shell_with_pinholes_becomes_a_solid_and_the_report_says_so() {
    let solid = 4.0 / 3.0 * std::f64::consts::PI * 20f64.powi(3);
    let filled = run(&double_shell(0.1), PrintOptions::default());
    assert_outcome(&filled, Outcome::Repaired);
    assert!((volume(&filled) / solid - 1.0).abs() < 0.02, "{}", volume(&filled));
    assert_eq!(measured_file(&filled.bytes).parts, 1);
    let assumed = filled.report.assumptions.iter().find(|one| one.kind == AssumptionKind::InteriorFilled);
    assert_eq!(assumed.and_then(|one| one.option.as_deref()), Some("interior=keep"));
    assert_eq!(filled.report.plan.preset, Preset::Generated);
    let kept = run(&double_shell(0.1), PrintOptions { interior: Interior::Keep, ..PrintOptions::default() });
    assert!(volume(&kept) < 0.1 * solid, "{}", volume(&kept));
}

#[test]
fn an_inner_skin_seen_only_through_many_pinholes_is_not_missed() {
    let mut shell = double_shell(0.5);
    let (half, mut at) = (shell.faces.len() / 2, 0);
    shell.faces.retain(|_| {
        at += 1;
        !(at < half && at % 50 == 7)
    });
    let filled = run(&shell, PrintOptions::default());
    assert_outcome(&filled, Outcome::Repaired);
    assert!(filled.report.red_flags.is_empty(), "{:?}", filled.report.red_flags);
    assert_eq!(measured_file(&filled.bytes).parts, 1);
    assert!(volume(&filled) > 33_000.0, "the ball is a solid: {}", volume(&filled));
}

/// Two double shells whose outer skins share an edge. Each outer skin lacks the face `hole`.
fn shells_that_share_an_edge(segments: u32, hole: usize) -> Soup {
    let shell = |low: DVec3| {
        let mut outer = cube(low, 20.0, segments);
        outer.faces.remove(hole);
        join(&outer, &inside_out(cube(low + 0.2, 19.6, segments)))
    };
    as_f32(join(&shell(DVec3::ZERO), &shell(DVec3::new(20.0, 20.0, 0.0))))
}

/// The seal that a reason advises.
fn advised_seal(reason: &str) -> Option<f64> {
    let (_, rest) = reason.split_once("`seal_mm` to ")?;
    rest.split(' ').next()?.parse().ok()
}

#[test]
fn a_double_shell_whose_outer_skin_touches_itself_along_an_edge_becomes_a_solid() {
    let fill = PrintOptions { interior: Interior::Fill, ..PrintOptions::default() };
    // With 4 squares on each side, a missing face is wider than the seal, and yet a missing face.
    for squares in [40, 4] {
        let filled = run(&shells_that_share_an_edge(squares, 7), fill.clone());
        assert_outcome(&filled, Outcome::Repaired);
        assert!((volume(&filled) / 16_000.0 - 1.0).abs() < 0.01, "both cubes are solids: {}", volume(&filled));
        assert!(filled.report.options_not_applied.is_empty(), "{:?}", filled.report.options_not_applied);
    }
    // A seal that the request chose is obeyed.
    let open = run(&shells_that_share_an_edge(4, 7), PrintOptions { seal_mm: Some(0.5), ..fill.clone() });
    let [interior, seal] = &open.report.options_not_applied[..] else {
        panic!("{:?}", open.report.options_not_applied)
    };
    for (not_applied, option) in [(interior, "interior"), (seal, "seal_mm")] {
        assert_eq!((not_applied.option.as_str(), not_applied.cause), (option, NotAppliedCause::Unavailable));
        assert!(not_applied.reason.contains("too wide for a `seal_mm` of 0.500"), "{}", not_applied.reason);
    }
    assert!(seal.reason.ends_with("try one above 2.929"), "{}", seal.reason);
    let filled = run(&shells_that_share_an_edge(4, 7), PrintOptions { seal_mm: Some(2.95), ..fill });
    assert!((volume(&filled) / 16_000.0 - 1.0).abs() < 0.01, "{}", volume(&filled));
}

/// The surface of the unit cells of a grid of `n` cells a side for which `is_solid` holds.
fn cells(n: i32, is_solid: impl Fn(IVec3) -> bool) -> Soup {
    let is_solid = |cell: IVec3| cell.cmpge(IVec3::ZERO).all() && cell.cmplt(IVec3::splat(n)).all() && is_solid(cell);
    let mut soup = Soup::default();
    for cell in (0..n.pow(3)).map(|i| IVec3::new(i % n, i / n % n, i / n / n)).filter(|&cell| is_solid(cell)) {
        for (axis, side) in (0..3).flat_map(|axis| [(axis, -1), (axis, 1)]) {
            let unit = |k: usize| IVec3::AXES[(axis + k) % 3];
            if !is_solid(cell + unit(0) * side) {
                let corner = cell + unit(0) * i32::max(side, 0);
                let [a, b] = if side > 0 { [unit(1), unit(2)] } else { [unit(2), unit(1)] };
                let quad = [corner, corner + a, corner + a + b, corner + b].map(|p| p.as_dvec3());
                push(&mut soup, [quad[0], quad[1], quad[2]]);
                push(&mut soup, [quad[0], quad[2], quad[3]]);
            }
        }
    }
    soup
}

#[test]
fn a_shell_that_stays_hollow_tells_the_seal_that_fills_it() {
    // A cube with walls of 1 mm and a tunnel of 2 mm in one of them, which is wider than the largest default seal, 0.83 mm.
    let is_wall = |cell: IVec3| cell.min_element() == 0 || cell.max_element() == 19;
    let is_tunnel = |cell: IVec3| cell.z == 0 && (9..11).contains(&cell.x) && (9..11).contains(&cell.y);
    let shell = cells(20, |cell| is_wall(cell) && !is_tunnel(cell));
    let crumbs = join(&cube(DVec3::splat(21.0), 0.3, 1), &cube(DVec3::new(15.0, -1.0, 4.0), 0.3, 1));
    let repair = |seal_mm| {
        let print = PrintOptions { seal_mm, ..PrintOptions::default() };
        let unit = Some(Unit::Millimetre);
        let options = Options { print, unit, preset: Preset::Generated, max_tier: 2, ..Options::default() };
        repair_soup(&join(&shell, &crumbs), &options, None)
    };
    let hollow = repair(None);
    assert_outcome(&hollow, Outcome::Repaired);
    assert!(volume(&hollow) < 2200.0, "{}", volume(&hollow));
    let accounting = hollow.report.part_accounting.as_ref().expect("a part accounting");
    assert_eq!((accounting.lost, accounting.dropped), (0, 2), "the crumbs were dropped for a reason");
    let [told] = &hollow.report.options_not_applied[..] else { panic!("{:?}", hollow.report.options_not_applied) };
    assert_eq!((told.option.as_str(), told.cause), ("preset", NotAppliedCause::Limited));
    let seal = advised_seal(&told.reason);
    assert!(seal.is_some_and(|seal| (1.0..3.5).contains(&seal)), "{}", told.reason);
    let filled = repair(seal);
    assert_outcome(&filled, Outcome::Repaired);
    assert!((volume(&filled) / 8_000.0 - 1.0).abs() < 0.001, "{}", volume(&filled));
    assert!(filled.report.options_not_applied.is_empty(), "{:?}", filled.report.options_not_applied);
}

#[test]
fn an_ordinary_hollow_print_is_not_taken_for_a_double_shell() {
    for soup in
        [hollow_cube(), join(&sphere(DVec3::ZERO, 20.0, 48, 24), &inside_out(sphere(DVec3::ZERO, 18.0, 48, 24)))]
    {
        let repaired = run(&as_f32(soup), PrintOptions::default());
        assert_eq!(repaired.report.outcome, Outcome::AlreadyPrintable);
    }
}

#[test]
fn a_thin_plate_is_thickened_and_verified_against_the_process() {
    let plate = cuboid(DVec3::ZERO, DVec3::new(40.0, 30.0, 0.4), 1);
    let process = Some("mjf".to_owned());
    let thin = run(&plate, PrintOptions { process: process.clone(), ..PrintOptions::default() });
    let failed = rule(&thin, PrintRule::FreeWall);
    assert_eq!((failed.result, failed.limit), (RuleOutcome::Fail, Some(1.0)));
    assert!((failed.measured.expect("a value") - 0.4).abs() < 1e-6);
    let thick = run(&plate, PrintOptions { thicken_to_process: true, process, ..PrintOptions::default() });
    assert_outcome(&thick, Outcome::Repaired);
    assert_eq!(rule(&thick, PrintRule::FreeWall).result, RuleOutcome::Pass);
    assert!((volume(&thick) / 1200.0 - 1.0).abs() < 0.1, "{}", volume(&thick));
    let thickening = thick.report.steps.iter().find_map(|step| step.thickening.as_ref()).expect("a thickening step");
    assert!((thickening.added_volume_mm3 / 720.0 - 1.0).abs() < 0.1, "{thickening:?}");
    assert!(thickening.added_faces > 0 && thickening.left_count == 0, "{thickening:?}");
    assert!((0.29..0.33).contains(&thickening.max_deviation_mm), "{thickening:?}");
}

#[test]
fn a_result_that_is_not_print_ready_is_refused_on_request() {
    let plate = cuboid(DVec3::ZERO, DVec3::new(40.0, 30.0, 0.4), 1);
    let print = PrintOptions { process: Some("fdm".to_owned()), ..PrintOptions::default() };
    let options = Options { print, require: Require::PrintReady, unit: Some(Unit::Millimetre), ..Options::default() };
    let refused = repair_soup(&plate, &options, None).report;
    assert_eq!((refused.verdict.file, refused.verdict.print_ready), (OfferedFile::None, Some(false)));
    assert!(refused.refusal().is_some_and(|why| why.contains("thickness of free walls")), "{:?}", refused.refusal());
    let block = repair_soup(&cube(DVec3::ZERO, 20.0, 2), &options, None).report;
    assert_eq!((block.verdict.file, block.verdict.print_ready), (OfferedFile::Model, Some(true)));
}

#[test]
fn an_option_without_anything_to_do_is_reported() {
    let print = PrintOptions { voids: Voids::Fill, min_wall: Some(1.0), ..PrintOptions::default() };
    let repaired = run(&cube(DVec3::ZERO, 20.0, 2), print);
    for option in ["voids", "min_wall"] {
        let entry = repaired.report.options_not_applied.iter().find(|entry| entry.option == option);
        assert_eq!(entry.map(|entry| entry.cause), Some(NotAppliedCause::NothingToDo), "{option}");
    }
}

#[test]
fn an_oversized_model_fails_the_build_volume_with_the_side_that_is_too_long() {
    let print = PrintOptions { process: Some("resin".to_owned()), ..PrintOptions::default() };
    let repaired = run(&cuboid(DVec3::ZERO, DVec3::new(20.0, 200.0, 20.0), 1), print);
    let failed = rule(&repaired, PrintRule::BuildVolume);
    assert_eq!((failed.result, failed.limit, failed.measured), (RuleOutcome::Fail, Some(175.0), Some(200.0)));
}

#[test]
fn lengths_in_inches_break_the_rule_of_the_unit_in_a_file_that_names_none() {
    let print = PrintOptions { process: Some("sls-pa12".into()), ..PrintOptions::default() };
    let of_unit = |output, scale_to| {
        let options = Options {
            print: print.clone(),
            unit: Some(Unit::Inch),
            output,
            scale_to,
            max_tier: 2,
            ..Options::default()
        };
        let repaired = repair_soup(&cube(DVec3::ZERO, 1.0, 2), &options, None);
        rule(&repaired, PrintRule::Unit).clone()
    };
    let failed = of_unit(OutputFormat::Stl, None);
    assert_eq!((failed.result, failed.limit, failed.measured), (RuleOutcome::Fail, Some(1.0), Some(25.4)));
    assert!(failed.remedy.is_some_and(|remedy| remedy.contains("scale_to=mm")));
    assert_eq!(of_unit(OutputFormat::Stl, Some(Unit::Millimetre)).result, RuleOutcome::Pass);
    assert_eq!(of_unit(OutputFormat::ThreeMf, None).result, RuleOutcome::Pass);
}

#[test]
fn a_unit_in_doubt_is_reported_with_candidates() {
    // A plate of 50 by 30 by 2 mm, in metres.
    let tiny = cuboid(DVec3::ZERO, DVec3::new(0.05, 0.03, 0.002), 1);
    let repaired = repair_soup(&tiny, &Options::default(), None);
    let candidates = repaired.report.unit_candidates.expect("candidates");
    assert_eq!(candidates.likely, Some(Unit::Metre), "{candidates}");
    let stated = repair_soup(&tiny, &Options { unit: Some(Unit::Millimetre), ..Options::default() }, None);
    assert_eq!(stated.report.unit_candidates, None);
}

#[test]
fn an_unusual_size_has_candidates_even_if_no_unit_leads_clearly() {
    let small = cuboid(DVec3::ZERO, DVec3::new(3.0, 1.1, 1.1), 1);
    let options = |unit| Options {
        print: PrintOptions { process: Some("resin".to_owned()), ..PrintOptions::default() },
        unit,
        ..Options::default()
    };
    let doubted = repair_soup(&small, &options(None), None);
    let candidates = doubted.report.unit_candidates.as_ref().expect("candidates");
    assert_eq!((candidates.likely, candidates.normalised), (None, false), "{candidates}");
    assert!(doubted.report.unit.note.as_ref().is_some_and(|note| note.contains("may be inches")));
    assert_eq!(rule(&doubted, PrintRule::Unit).result, RuleOutcome::Pass);
    assert_eq!(repair_soup(&small, &options(Some(Unit::Millimetre)), None).report.unit_candidates, None);
}

#[test]
fn a_separate_solid_is_attached_with_a_strut_on_request() {
    let soup = join(&cube(DVec3::ZERO, 20.0, 2), &cube(DVec3::new(21.0, 5.0, 5.0), 4.0, 2));
    let attached = run(&soup, PrintOptions { islands: Islands::Attach, ..PrintOptions::default() });
    assert_outcome(&attached, Outcome::Repaired);
    assert_eq!(measured_file(&attached.bytes).parts, 1);
    let added = volume(&attached) - (8000.0 + 64.0);
    assert!((1.0..10.0).contains(&added), "a strut of 2 mm across 1 mm, not {added} mm³");
    assert_eq!(attached.report.assumptions, []);
}

#[test]
fn a_small_solid_that_is_removed_where_others_are_attached_is_an_assumption() {
    let crumb = cube(DVec3::new(30.0, 0.0, 0.0), 0.5, 1);
    let soup = join(&cube(DVec3::ZERO, 20.0, 2), &join(&crumb, &cube(DVec3::new(21.0, 5.0, 5.0), 4.0, 2)));
    let assumptions = |islands: Islands| {
        let repaired = run(&soup, PrintOptions { islands, ..PrintOptions::default() });
        assert_outcome(&repaired, Outcome::Repaired);
        repaired.report.assumptions.iter().map(|assumed| (assumed.kind, assumed.count)).collect::<Vec<_>>()
    };
    assert_eq!(assumptions(Islands::Attach), [(AssumptionKind::PiecesDropped, 1)]);
    assert_eq!(assumptions(Islands::Drop), []);
}
