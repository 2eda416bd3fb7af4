//! Open sheets: thickened, put on a base, or joined with a solid.

use glam::DVec3;
use meshmend::format::{self, Limits};
use meshmend::inspect::measure;
use meshmend::math::Precision;
use meshmend::mesh::{Soup, Surface};
use meshmend::repair::operators::base::AddBase;
use meshmend::repair::operators::holes::FillHoles;
use meshmend::repair::operators::join::JoinParts;
use meshmend::repair::operators::thicken::{Skins, ThickenSheets};
use meshmend::repair::operators::{Applied, Counter, Counts};
use meshmend::repair::{
    Action, AssumptionKind, Category, OpenSheets, Operator, Options, Outcome, Repaired, StepStatus,
};
use proptest::prelude::*;

use crate::meshes::{as_f32, cube, join, push, sheet, torus};
use crate::support::{change_count, measured, repair_soup, with_context};

fn thickened(soup: &Soup, thickness: f64, skins: Skins) -> (Surface, Applied) {
    let (mut surface, _) = Surface::from_soup(soup);
    let thicken = ThickenSheets {
        thickness: Some(thickness),
        skins,
        spares_solids: false,
        max_deviation: f64::INFINITY,
        precision: Precision::F32,
    };
    let applied = with_context(|c| thicken.apply(&mut surface, c)).unwrap();
    surface.drop_unreferenced();
    (surface, applied)
}

fn put_on_base(soup: &Soup, thickness: f64) -> (Surface, Applied) {
    let (mut surface, _) = Surface::from_soup(soup);
    let base = AddBase { thickness: Some(thickness), max_deviation: f64::INFINITY, precision: Precision::F32 };
    let applied = with_context(|c| base.apply(&mut surface, c)).unwrap();
    (surface, applied)
}

fn run(soup: &Soup, options: &Options) -> Repaired {
    repair_soup(soup, options, None)
}

/// A Möbius band of `n` quads.
fn moebius(n: u32) -> Soup {
    let at = |i: u32, side: f64| {
        let turn = f64::from(i % n) / f64::from(n) * std::f64::consts::TAU;
        let side = if i == n { -side } else { side };
        let r = 10.0 + side * (turn / 2.0).cos();
        DVec3::new(r * turn.cos(), r * turn.sin(), side * (turn / 2.0).sin())
    };
    let mut soup = Soup::default();
    for i in 0..n {
        let q = [at(i, -1.0), at(i + 1, -1.0), at(i + 1, 1.0), at(i, 1.0)];
        push(&mut soup, [q[0], q[1], q[2]]);
        push(&mut soup, [q[0], q[2], q[3]]);
    }
    soup
}

/// The corner positions of each face, from its smallest corner on, to find faces by position.
fn face_positions(soup: &Soup) -> Vec<[[u64; 3]; 3]> {
    let mut all: Vec<_> = soup
        .faces
        .iter()
        .map(|f| {
            let mut corners = f.map(|v| soup.positions[v as usize].to_array().map(|x| (x + 0.0).to_bits()));
            let least = (0..3).min_by_key(|&i| corners[i]).unwrap();
            corners.rotate_left(least);
            corners
        })
        .collect();
    all.sort_unstable();
    all
}

fn keeps_every_face(surface: &Surface, soup: &Soup) -> bool {
    let after = face_positions(&surface.to_soup());
    face_positions(soup).iter().all(|face| after.binary_search(face).is_ok())
}

#[test]
fn a_thickened_sheet_is_a_solid_of_its_area_times_the_thickness() {
    let soup = as_f32(sheet(20));
    let area = with_context(|c| measure(&soup, c)).unwrap().area;
    for skins in [Skins::Behind, Skins::BothSides] {
        let (surface, applied) = thickened(&soup, 0.05, skins);
        let m = measured(&surface);
        assert!(m.closed && m.manifold && m.consistent && m.parts == 1, "{m:?}");
        assert_eq!(m.self_intersections.pairs, Some(0));
        assert!((m.volume.value / (area * 0.05) - 1.0).abs() < 0.02, "{} for {}", m.volume.value, area * 0.05);
        assert_eq!(change_count(&applied.changes, "sheets_thickened"), 1);
        assert_eq!(keeps_every_face(&surface, &soup), skins == Skins::Behind);
    }
}

#[test]
fn one_skin_is_behind_the_normal_and_two_skins_are_half_the_thickness_off() {
    let mut soup = Soup::default();
    push(&mut soup, [DVec3::ZERO, DVec3::X, DVec3::Y]);
    let heights = |skins| {
        let (surface, _) = thickened(&soup, 0.25, skins);
        let z: Vec<f64> = surface.positions.iter().map(|p| p.z).collect();
        (z.iter().copied().fold(f64::MAX, f64::min), z.iter().copied().fold(f64::MIN, f64::max))
    };
    assert_eq!(heights(Skins::Behind), (-0.25, 0.0));
    assert_eq!(heights(Skins::BothSides), (-0.125, 0.125));
}

#[test]
fn a_moebius_band_gets_one_skin_that_goes_around_twice() {
    for skins in [Skins::Behind, Skins::BothSides] {
        let (surface, _) = thickened(&as_f32(moebius(48)), 0.1, skins);
        let m = measured(&surface);
        assert!(m.closed && m.manifold && m.consistent, "{m:?}");
        assert_eq!((m.parts, m.faces), (1, 48 * 4 + 2 * 48 * 2));
        assert!(m.volume.value > 0.0);
    }
}

#[test]
fn a_closed_part_beside_a_sheet_is_untouched() {
    let solid = cube(DVec3::splat(40.0), 1.0, 2);
    let (surface, applied) = thickened(&join(&as_f32(sheet(3)), &solid), 0.1, Skins::BothSides);
    assert!(keeps_every_face(&surface, &solid));
    assert_eq!(change_count(&applied.changes, "sheets_thickened"), 1);
}

#[test]
fn a_thickness_that_rounding_would_swallow_is_refused() {
    let soup = as_f32(sheet(3));
    let (surface, applied) = thickened(&soup, 1e-6, Skins::Behind);
    assert_eq!(surface.faces.len(), soup.faces.len());
    assert!(applied.changes.is_empty() && applied.left.unwrap().contains("rounding"));
}

#[test]
fn a_thickness_stays_within_what_may_be_moved() {
    let (mut surface, _) = Surface::from_soup(&as_f32(sheet(6)));
    let thicken = ThickenSheets {
        thickness: Some(1.0),
        skins: Skins::Behind,
        spares_solids: false,
        max_deviation: 0.02,
        precision: Precision::F32,
    };
    with_context(|c| thicken.apply(&mut surface, c)).unwrap();
    let flat = |p: &DVec3| p.z - 0.3 * p.x.sin();
    assert!(surface.positions.iter().all(|p| flat(p) > -0.03));
}

#[test]
fn terrain_is_put_on_a_flat_base_around_its_hole() {
    let mut soup = as_f32(sheet(8));
    soup.faces.drain(70..72);
    let area = 62.0 + 1.0;
    let (surface, applied) = put_on_base(&soup, 1.0);
    let m = measured(&surface);
    assert!(m.closed && m.manifold && m.consistent, "{m:?}");
    assert_eq!(m.self_intersections.pairs, Some(0));
    assert_eq!(change_count(&applied.changes, "bases_added"), 1);
    assert!(keeps_every_face(&surface, &soup));
    // On this grid 0.3 sin(x) is lowest at x = 5.
    let lowest = f64::from((0.3 * 5f64.sin()) as f32);
    assert!((m.bounding_box.unwrap().min[2] - (lowest - 1.0)).abs() < 1e-6);
    assert!(m.volume.value > 0.9 * area && m.volume.value < 1.6 * area, "{}", m.volume.value);
    // Skirts along 32 outer edges and 4 edges of the hole.
    assert_eq!(surface.faces.len(), 2 * soup.faces.len() + 2 * 36);
}

#[test]
fn terrain_that_faces_down_is_flipped_and_still_gets_its_base() {
    let soup = crate::meshes::inside_out(as_f32(sheet(5)));
    let (surface, applied) = put_on_base(&soup, 1.0);
    let m = measured(&surface);
    assert!(m.closed && m.consistent && m.volume.value > 0.0, "{m:?}");
    assert_eq!(change_count(&applied.changes, "open_parts_flipped"), 1);
}

#[test]
fn a_sheet_along_another_axis_is_extruded_along_it() {
    let mut soup = as_f32(sheet(5));
    for p in &mut soup.positions {
        *p = DVec3::new(p.z, p.x, p.y);
    }
    let m = measured(&put_on_base(&soup, 1.0).0);
    assert!(m.closed && m.manifold && m.volume.value > 0.0, "{m:?}");
    assert!(m.bounding_box.unwrap().min[0] < -1.0);
}

#[test]
fn a_surface_that_is_not_a_height_field_gets_no_base() {
    let mut soup = torus(3.0, 1.0, 16, 8);
    soup.faces.truncate(200);
    let (surface, applied) = put_on_base(&soup, 1.0);
    assert_eq!(surface.faces.len(), 200);
    assert!(applied.left.unwrap().contains("height field"));
}

#[test]
fn two_open_tubes_are_joined_and_their_holes_closed_around_both() {
    let tube = |z: f64| {
        let mut soup = cube(DVec3::new(0.0, 0.0, z), 1.0, 2);
        soup.faces.retain(|f| {
            let z = f.map(|v| soup.positions[v as usize].z);
            !(z[0] == z[1] && z[1] == z[2])
        });
        soup
    };
    let (mut surface, _) = Surface::from_soup(&join(&tube(0.0), &tube(1.5)));
    let applied = with_context(|c| JoinParts { max_deviation: f64::INFINITY }.apply(&mut surface, c)).unwrap();
    assert_eq!(change_count(&applied.changes, "parts_joined"), 1);
    let joined = Counts::of(&surface);
    assert_eq!(joined.get(Counter::MisorientedEdges) + joined.get(Counter::NonManifoldEdges), 0);
    with_context(|c| FillHoles { max_edges: 100, ..FillHoles::default() }.apply(&mut surface, c)).unwrap();
    let m = measured(&surface);
    assert!(m.closed && m.consistent && m.parts == 1, "{m:?}");
}

#[test]
fn parts_too_far_from_one_another_are_not_joined() {
    let (mut surface, _) = Surface::from_soup(&join(&sheet(2), &sheet(2)));
    for p in surface.positions.iter_mut().skip(9) {
        p.z += 50.0;
    }
    let applied = with_context(|c| JoinParts { max_deviation: 1.0 }.apply(&mut surface, c)).unwrap();
    assert!(applied.changes.is_empty());
}

#[test]
fn parts_are_joined_only_on_request_and_that_is_reported() {
    let soup = join(&as_f32(sheet(4)), &{
        let mut other = as_f32(sheet(4));
        other.positions.iter_mut().for_each(|p| p.x += 5.0);
        other
    });
    let ran = |repaired: &Repaired| repaired.report.steps.iter().any(|s| s.operator == Some(Operator::JoinParts));
    let asked = Options {
        with: vec![Operator::JoinParts],
        open_sheets: OpenSheets::Thicken,
        max_tier: 2,
        ..Options::default()
    };
    let repaired = run(&soup, &asked);
    let joined = repaired.report.assumptions.iter().any(|assumption| assumption.kind == AssumptionKind::PartsJoined);
    assert!(ran(&repaired) && joined, "{:?}", repaired.report.assumptions);
    assert!(!ran(&run(&soup, &Options { with: vec![], ..asked })));
}

/// A box with a sheet through it that sticks out on both sides.
fn box_with_a_sheet_through_it() -> Soup {
    let mut soup = cube(DVec3::ZERO, 4.0, 2);
    let at = |x: f64, y: f64| DVec3::new(x, y, 2.1);
    push(&mut soup, [at(-6.0, 1.1), at(10.0, 1.2), at(10.0, 2.9)]);
    push(&mut soup, [at(-6.0, 1.1), at(10.0, 2.9), at(-6.0, 2.8)]);
    as_f32(soup)
}

#[test]
fn a_sheet_through_a_box_joins_the_solid_and_nothing_of_the_box_is_removed() {
    let soup = box_with_a_sheet_through_it();
    let repaired = run(&soup, &Options { max_tier: 2, max_surface_added_pct: 100.0, ..Options::default() });
    let after = repaired.report.after.as_ref().unwrap();
    assert_eq!(repaired.report.outcome, Outcome::Repaired, "{:?}", repaired.report.red_flags);
    assert!(after.measures.printable());
    assert!(after.measures.volume.value > 64.0 && after.measures.volume.value < 66.5);
    let result = format::read(&repaired.bytes, &Limits::default()).unwrap().soup;
    let (surface, _) = Surface::from_soup(&result);
    // The sides that the sheet does not cross are unchanged.
    let mut untouched = cube(DVec3::ZERO, 4.0, 2);
    untouched.faces.retain(|f| {
        let x = f.map(|v| untouched.positions[v as usize].x);
        !(x[0] == x[1] && x[1] == x[2])
    });
    assert!(keeps_every_face(&surface, &untouched));
    let close =
        repaired.report.plan.strategies.iter().position(|r| r.actions.iter().any(|a| a.action == Action::CloseSheets));
    assert_eq!(repaired.report.candidates.iter().find(|c| c.chosen).unwrap().strategy, close.map(|c| c as u32));
    assert!(repaired.report.assumptions.iter().any(|assumption| assumption.kind == AssumptionKind::SheetsThickened));
}

#[test]
fn sheets_are_left_open_on_request() {
    let options = Options { open_sheets: OpenSheets::Leave, max_tier: 2, ..Options::default() };
    let repaired = run(&box_with_a_sheet_through_it(), &options);
    assert!(repaired.report.steps.iter().all(|s| s.action != Action::CloseSheets));
}

#[test]
fn a_model_that_is_a_sheet_is_made_solid_only_when_that_is_asked_for() {
    let soup = as_f32(sheet(12));
    let with =
        |open_sheets| run(&soup, &Options { open_sheets, max_tier: 2, thickness: Some(0.2), ..Options::default() });
    let left = with(OpenSheets::Auto);
    assert_eq!((left.report.outcome, left.report.plan.category), (Outcome::Unrepairable, Category::OpenSheet));
    for asked in [OpenSheets::Thicken, OpenSheets::Base] {
        let result = with(asked);
        assert_eq!(result.report.outcome, Outcome::Repaired, "{asked:?} {:?}", result.report.red_flags);
    }
}

#[test]
fn sheets_are_closed_in_a_separate_strategy_only_if_something_was_left_open() {
    let soup = join(&cube(DVec3::ZERO, 1.0, 1), &cube(DVec3::new(1.0, 1.0, 0.0), 1.0, 1));
    let repaired = run(&soup, &Options { max_tier: 2, ..Options::default() });
    let ran = |s: &&meshmend::repair::Step| s.action == Action::CloseSheets && s.status != StepStatus::Skipped;
    assert_eq!(repaired.report.steps.iter().find(ran), None);
}

#[test]
fn a_thickness_must_be_above_zero() {
    for thickness in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let options = Options { thickness: Some(thickness), ..Options::default() };
        assert!(options.validate().is_err(), "{thickness}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn any_faces_become_closed_and_consistently_oriented_by_index(
        faces in prop::collection::vec([0u32..9, 0u32..9, 0u32..9], 1..24),
        points in prop::collection::vec([-5.0f64..5.0, -5.0f64..5.0, -5.0f64..5.0], 9),
    ) {
        let positions = points.into_iter().map(DVec3::from_array).collect();
        let faces: Vec<[u32; 3]> = faces.into_iter().filter(|[a, b, c]| a != b && b != c && c != a).collect();
        let soup = as_f32(Soup { positions, faces });
        for skins in [Skins::Behind, Skins::BothSides] {
            let (surface, _) = thickened(&soup, 0.1, skins);
            let parts_open = Counts::of(&surface).get(Counter::BoundaryEdges);
            prop_assert_eq!(parts_open, 0);
        }
    }
}

#[test]
fn a_box_without_one_face_and_with_a_fin_at_the_hole_is_no_open_sheet() {
    let bit = |corner: u32, bit: u32| f64::from(corner >> bit & 1);
    let mut positions: Vec<DVec3> = (0..8).map(|k| DVec3::new(bit(k, 2), bit(k, 1), bit(k, 0)) * 10.0).collect();
    positions.push(DVec3::new(10.01, 10.01, 5.0));
    // The face 5, 4, 6 is missing. The fin comes before the faces beside it, so the walk around the hole meets it.
    let fin = [7, 8, 6];
    let mut faces = vec![[7, 3, 5], [5, 1, 4], fin, [7, 6, 2], [6, 4, 2], [1, 0, 4]];
    faces.extend([[7, 5, 6], [1, 3, 0], [3, 2, 0], [2, 4, 0], [3, 1, 5], [3, 7, 2]]);
    let report = repair_soup(&Soup { positions, faces }, &Options::default(), None).report;
    assert_ne!(report.plan.category, Category::OpenSheet);
    assert!((report.after.unwrap().measures.volume.value - 1000.0).abs() < 1e-6);
}
