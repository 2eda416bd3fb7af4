//! Part accounting: each part of the input is in the result, was dropped for a reason, or is lost and raises a red flag.

use glam::DVec3;
use meshmend::format::{self, Format, Limits};
use meshmend::inspect::{Analysis, CompareOptions, Original, measures};
use meshmend::mesh::Soup;
use meshmend::repair::{
    IntendedChanges, OpenSheets, Operator, Options, Outcome, PartAccounting, PartReason, RedFlagCode, Repaired,
    part_accounting, repair,
};
use proptest::prelude::*;

use crate::meshes::{cube, cuboid, inside_out, join, push, sheet, sphere};
use crate::support::{FixedRemesher, with_context};

fn account_parts(before: &Soup, after: &Soup) -> PartAccounting {
    let accounts = with_context(|context| {
        let [before, after] = [before, after].map(|soup| Analysis::new(soup.into(), context).unwrap());
        let measured = measures(&before, context).unwrap();
        let original = Original::new(&before, &measured, CompareOptions::BRIEF);
        part_accounting(&original, &after, &Options::default(), IntendedChanges::default(), context).unwrap()
    });
    let PartAccounting { parts, kept, changed, duplicate, no_volume, inside_another, debris, lost, unknown, .. } =
        accounts;
    assert_eq!(
        kept + changed + duplicate + no_volume + inside_another + debris + lost + unknown,
        parts,
        "{accounts:?}"
    );
    accounts
}

/// The reasons by part.
fn reasons(before: &Soup, after: &Soup) -> Vec<(u32, PartReason)> {
    let accounts = account_parts(before, after);
    assert_eq!(accounts.lost, 0, "{accounts:?}");
    accounts.reasons.iter().map(|accounted| (accounted.part, accounted.reason)).collect()
}

fn box_at(x: f64, size: f64) -> Soup {
    cube(DVec3::new(x, 0.0, 0.0), size, 3)
}

#[test]
fn a_complete_part_is_kept_and_a_partial_one_is_changed() {
    let both = join(&box_at(0.0, 1.0), &box_at(3.0, 1.0));
    let whole = account_parts(&both, &both);
    assert_eq!((whole.parts, whole.kept, whole.changed, whole.united), (2, 2, 0, 0));
    let mut cut = both.clone();
    cut.faces.pop();
    let cut = account_parts(&both, &cut);
    assert_eq!((cut.kept, cut.changed, cut.lost), (1, 1, 0));
    // Remeshed and moved slightly.
    let mut anew = join(&cube(DVec3::ZERO, 1.0, 5), &cube(DVec3::new(3.0, 0.0, 0.0), 1.0, 7));
    anew.positions.iter_mut().for_each(|p| *p += DVec3::splat(0.003));
    assert_eq!(account_parts(&both, &anew).changed, 2);
}

#[test]
fn parts_that_share_a_part_of_the_result_are_united() {
    let apart = join(&join(&box_at(0.0, 1.0), &box_at(0.5, 1.0)), &box_at(5.0, 1.0));
    // The two overlapping cuboids become one.
    let united = join(&cuboid(DVec3::ZERO, DVec3::new(1.5, 1.0, 1.0), 4), &box_at(5.0, 1.0));
    let accounts = account_parts(&apart, &united);
    assert_eq!((accounts.kept, accounts.changed, accounts.united, accounts.lost), (1, 2, 2, 0));
}

#[test]
fn a_copy_of_a_part_is_a_duplicate() {
    let one = box_at(0.0, 1.0);
    let coarse = cube(DVec3::ZERO, 1.0, 1);
    assert_eq!(reasons(&join(&coarse, &one), &one), [(0, PartReason::Duplicate)]);
    // Both copies are remeshed: one remains.
    let anew = cube(DVec3::ZERO, 1.0, 2);
    assert_eq!(reasons(&join(&coarse, &one), &anew), [(1, PartReason::Duplicate)]);
    // Copies with the same faces share their edges, so they are one part; some of that part remains.
    let twice = join(&one, &one);
    assert_eq!((account_parts(&twice, &one).parts, account_parts(&twice, &one).changed), (1, 1));
    assert_eq!(account_parts(&twice, &twice).kept, 1);
}

#[test]
fn a_part_within_the_result_is_inside_another() {
    let outer = box_at(0.0, 4.0);
    let ball = sphere(DVec3::splat(2.0), 1.0, 12, 8);
    for ball in [inside_out(ball.clone()), ball] {
        assert_eq!(reasons(&join(&ball, &outer), &outer), [(0, PartReason::InsideAnother)]);
    }
}

#[test]
fn sheets_and_closed_parts_without_volume_enclose_nothing() {
    let solid = box_at(0.0, 1.0);
    let far = |mut soup: Soup| {
        soup.positions.iter_mut().for_each(|p| *p += DVec3::new(9.0, 0.0, 0.0));
        soup
    };
    let flat = far(sheet(4));
    assert_eq!(reasons(&join(&solid, &flat), &solid), [(1, PartReason::NoVolume)]);
    let double = join(&flat, &inside_out(flat.clone()));
    assert_eq!(reasons(&join(&solid, &double), &solid), [(1, PartReason::NoVolume)]);
    // A box pressed flat: closed, with two layers of different faces.
    let pressed = cuboid(DVec3::new(9.0, 0.0, 0.0), DVec3::new(1.0, 1.0, 1e-9), 3);
    assert_eq!(reasons(&join(&solid, &pressed), &solid), [(1, PartReason::NoVolume)]);
    // A needle with all corners on one line.
    let mut needle = solid.clone();
    push(&mut needle, [DVec3::splat(5.0), DVec3::splat(6.0), DVec3::splat(7.0)]);
    assert_eq!(reasons(&needle, &solid), [(1, PartReason::NoVolume)]);
}

#[test]
fn an_open_piece_too_small_to_print_is_debris() {
    let solid = box_at(0.0, 100.0);
    let mut bit = cube(DVec3::new(150.0, 0.0, 0.0), 0.01, 1);
    bit.faces.truncate(10);
    assert_eq!(reasons(&join(&solid, &bit), &solid), [(1, PartReason::Debris)]);
}

#[test]
fn a_part_that_is_missing_without_a_reason_is_lost() {
    let (big, small) = (box_at(0.0, 4.0), box_at(6.0, 1.0));
    let booked_beside = account_parts(&join(&big, &small), &big);
    assert_eq!((booked_beside.kept, booked_beside.lost), (1, 1));
    let lost = &booked_beside.lost_parts[0];
    assert_eq!((lost.part, lost.first_face, lost.faces), (1, 108, 54 * 2));
    assert!((lost.area - 6.0).abs() < 1e-12);
    assert!((5.9..7.1).contains(&lost.at[0]), "{:?}", lost.at);
    // A part whose faces have inconsistent orientation.
    let mut mixed = small.clone();
    mixed.faces.iter_mut().step_by(3).for_each(|face| face.swap(0, 1));
    assert_eq!(account_parts(&join(&big, &mixed), &big).lost, 1);
    // A box without a lid is not a sheet.
    let mut open = small.clone();
    open.faces.truncate(90);
    assert_eq!(account_parts(&join(&big, &open), &big).lost, 1);
    // A part in a closed cavity is not inside the result.
    let hollow = join(&box_at(0.0, 4.0), &inside_out(cube(DVec3::splat(0.5), 3.0, 2)));
    let ball = sphere(DVec3::splat(2.0), 0.5, 12, 8);
    assert_eq!(account_parts(&join(&hollow, &ball), &hollow).lost, 1);
}

#[test]
fn a_thin_plate_on_a_large_part_is_not_matched_with_its_surface() {
    let table = cube(DVec3::ZERO, 100.0, 4);
    let plate = cuboid(DVec3::new(20.0, 20.0, 100.0), DVec3::new(30.0, 30.0, 0.2), 3);
    assert_eq!(account_parts(&join(&table, &plate), &table).lost, 1);
    let mut near = join(&table, &plate);
    near.positions.iter_mut().for_each(|p| p.x += 0.01);
    assert_eq!(account_parts(&join(&table, &plate), &near).changed, 2);
}

#[test]
fn a_result_of_nothing_loses_all_but_sheets() {
    let input = join(&box_at(0.0, 1.0), &sheet(3));
    let accounts = account_parts(&input, &Soup::default());
    assert_eq!((accounts.parts, accounts.lost, accounts.no_volume), (2, 1, 1));
}

#[test]
fn lists_are_bounded_and_counts_are_not() {
    let mut input = box_at(0.0, 1.0);
    for i in 0..1500 {
        let at = DVec3::new(f64::from(i % 40) * 3.0, f64::from(i / 40) * 3.0, 10.0);
        push(&mut input, [at, at + DVec3::X, at + DVec3::Y]);
    }
    let accounts = account_parts(&input, &box_at(0.0, 1.0));
    assert_eq!((accounts.parts, accounts.no_volume, accounts.reasons.len()), (1501, 1500, 1000));
}

fn remeshed(input: &Soup, answer: Soup) -> Repaired {
    let bytes = format::write(input, Format::Stl).unwrap();
    let options = Options {
        preset: meshmend::repair::Preset::BlenderRemesh,
        // Without these operators tiers 1 and 2 leave the hole, so only the remesh is closed, and its faces are not changed.
        without: vec![Operator::FillHoles, Operator::CleanAndPatch, Operator::Simplify],
        max_surface_lost_pct: 100.0,
        max_face_loss_pct: 100.0,
        max_volume_change_pct: 100.0,
        max_bounding_box_change_pct: 100.0,
        ..Options::default()
    };
    with_context(|context| {
        repair(&bytes, &options, &Limits::default(), Some(&FixedRemesher::returning(answer)), context).unwrap()
    })
}

#[test]
fn a_dropped_part_raises_the_flag_and_makes_the_repair_partial() {
    let mut open = cube(DVec3::ZERO, 4.0, 3);
    open.faces.pop();
    let kept = cube(DVec3::new(2.5, 2.5, 4.5), 1.0, 2);
    let input = join(&join(&open, &cube(DVec3::new(1.0, 1.0, 4.5), 1.0, 3)), &kept);
    let dropped = remeshed(&input, join(&cube(DVec3::ZERO, 4.0, 5), &kept)).report;
    assert_eq!(dropped.outcome, Outcome::PartiallyRepaired);
    assert_eq!(dropped.red_flags.iter().map(|flag| flag.code).collect::<Vec<_>>(), [RedFlagCode::PartLost]);
    assert_eq!(dropped.part_accounting.unwrap().lost_parts[0].part, 1);
    let whole = join(&cube(DVec3::ZERO, 4.0, 5), &cube(DVec3::new(1.0, 1.0, 4.5), 1.0, 4));
    let whole = remeshed(&input, join(&whole, &kept)).report;
    assert_eq!((whole.outcome, whole.red_flags.len()), (Outcome::Repaired, 0));
    assert_eq!(whole.part_accounting.unwrap().changed, 2, "the third is kept");
}

#[test]
fn dropping_a_part_is_worse_than_closing_an_opening_over_a_wall() {
    let block = |low: [f64; 3], high: [f64; 3]| {
        let (low, high) = (DVec3::from_array(low), DVec3::from_array(high));
        cuboid(low, high - low, 2)
    };
    // A tub without a lid, a block through its floor, and a crumb below it.
    let outer = cube(DVec3::ZERO, 4.0, 3);
    let mut tub = outer.clone();
    tub.faces.retain(|face| face.iter().any(|&v| tub.positions[v as usize].z < 4.0));
    let crumb = cube(DVec3::new(0.2, 0.2, -0.4), 0.2, 1);
    let input = join(&join(&tub, &block([1.0, 1.0, -0.5], [3.0, 3.0, 1.5])), &crumb);
    let hollow = inside_out(block([1.0, 1.0, 0.01], [3.0, 3.0, 1.5]));
    let answer = join(&join(&outer, &hollow), &block([1.0, 1.0, -0.5], [3.0, 3.0, -0.01]));
    let options = Options {
        max_volume_change_pct: 100.0,
        without: vec![Operator::Remesh],
        open_sheets: OpenSheets::Leave,
        ..Options::default()
    };
    let bytes = format::write(&input, Format::Stl).unwrap();
    let answers = FixedRemesher::returning(answer);
    let report = with_context(|c| repair(&bytes, &options, &Limits::default(), Some(&answers), c).unwrap()).report;
    let flags = |chosen: bool| {
        let of = report.candidates.iter().filter(move |candidate| candidate.printable && candidate.chosen == chosen);
        of.flat_map(|candidate| &candidate.red_flags).map(|flag| flag.code).collect::<Vec<_>>()
    };
    assert!(flags(false).contains(&RedFlagCode::PartLost), "{:?}", report.candidates);
    assert_eq!(flags(true), [RedFlagCode::SurfaceLost, RedFlagCode::SurfaceInvented]);
    assert_eq!(report.part_accounting.unwrap().lost, 0);
}

#[test]
fn the_native_tiers_lose_no_part_of_a_model_of_many() {
    let mut input = sphere(DVec3::splat(2.0), 0.5, 10, 6);
    for i in 0..4 {
        input = join(&input, &cube(DVec3::splat(f64::from(i) * 0.7), 1.0, 2));
    }
    input = join(&input, &cube(DVec3::splat(0.7), 1.0, 3));
    let bytes = format::write(&input, Format::Stl).unwrap();
    let options = Options { max_tier: 2, ..Options::default() };
    let report = with_context(|context| repair(&bytes, &options, &Limits::default(), None, context).unwrap()).report;
    let accounts = report.part_accounting.unwrap();
    assert_eq!((accounts.parts, accounts.lost, accounts.unknown), (6, 0, 0), "{accounts:?}");
    assert!(accounts.duplicate == 1 && accounts.united >= 4, "{accounts:?}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn exactly_the_dropped_parts_are_lost(
        keep in proptest::collection::vec(any::<bool>(), 2..12),
        size in prop::sample::select(vec![1e-6, 1.0, 1e6]),
        n in 1u32..4,
    ) {
        let (mut before, mut after) = (Soup::default(), Soup::default());
        for (i, &keep) in (0u32..).zip(&keep) {
            let part = cube(DVec3::new(f64::from(i) * 1.5, 0.0, 0.0) * size, size, n);
            before = join(&before, &part);
            // With other faces if the number is even.
            let anew = cube(DVec3::new(f64::from(i) * 1.5, 0.0, 0.0) * size, size, n + u32::from(i % 2 == 0));
            after = if keep { join(&after, &anew) } else { after };
        }
        let accounts = account_parts(&before, &after);
        let lost: Vec<u32> = accounts.lost_parts.iter().map(|part| part.part).collect();
        let dropped: Vec<u32> = (0u32..).zip(&keep).filter(|(_, keep)| !**keep).map(|(i, _)| i).collect();
        prop_assert_eq!(lost, dropped);
    }
}
