//! Tests of the ranking of units.

use super::*;
use glam::DVec3;

fn sized(x: f64, y: f64, z: f64) -> Box3 {
    Box3 { min: DVec3::splat(10.0 * x), max: DVec3::splat(10.0 * x) + DVec3::new(x, y, z) }
}

fn best(found: &UnitCandidates) -> Unit {
    found.ranked[0].unit
}

fn with_walls(bounds: Box3, wall: f64) -> SizeEvidence<'static> {
    SizeEvidence { median_wall: Some(wall), least_wall: Some(wall), ..SizeEvidence::of(bounds) }
}

#[test]
fn a_unit_cube_is_undecidable() {
    let found = unit_candidates(&SizeEvidence::of(sized(1.0, 1.0, 1.0)));
    assert_eq!((found.taken, found.likely, found.normalised), (Unit::Millimetre, None, true));
    assert!(found.to_string().contains("give its height"));
}

#[test]
fn a_plate_of_an_eighth_by_three_is_in_inches() {
    let found = unit_candidates(&with_walls(sized(3.0, 2.0, 0.125), 0.125));
    assert_eq!((best(&found), found.likely, found.taken), (Unit::Inch, Some(Unit::Inch), Unit::Millimetre));
    assert!((found.ranked[0].size_mm[0] - 76.2).abs() < 1e-9);
    assert_eq!(found.ranked[0].wall_mm, Some(0.125 * 25.4));
    let words = found.to_string();
    assert!(words.contains("walls would be 3.17 mm thick") && words.contains("multiples of 1/32 inch"), "{words}");
}

#[test]
fn a_part_0_05_long_with_walls_of_0_002_is_in_metres() {
    let found = unit_candidates(&with_walls(sized(0.05, 0.03, 0.02), 0.002));
    assert_eq!((best(&found), found.likely), (Unit::Metre, Some(Unit::Metre)));
}

#[test]
fn usual_parts_in_millimetres_raise_no_doubt() {
    for (bounds, wall) in [
        (sized(70.0, 40.0, 3.0), Some(3.0)),
        (sized(25.4, 50.8, 12.7), Some(2.0)),
        (sized(80.0, 60.0, 180.0), None),
        (sized(8.0, 6.0, 2.0), Some(1.0)),
        (sized(5.5, 5.0, 4.0), Some(0.6)),
        (sized(300.0, 200.0, 250.0), Some(4.0)),
        (sized(41.37, 28.91, 17.03), None),
    ] {
        let found = unit_candidates(&SizeEvidence { median_wall: wall, ..SizeEvidence::of(bounds) });
        assert_eq!((found.taken, found.likely, found.normalised), (Unit::Millimetre, None, false), "{bounds:?}");
    }
    let converted = unit_candidates(&SizeEvidence::of(sized(25.4, 50.8, 12.7)));
    assert_eq!(best(&converted), Unit::Millimetre);
    assert!(converted.ranked[0].reasons.contains(&UnitReason::RoundLengths { metric: 0, imperial: 3, of: 3 }));
    assert_eq!(best(&unit_candidates(&SizeEvidence::of(sized(70.0, 40.0, 3.0)))), Unit::Millimetre);
    assert_eq!(best(&unit_candidates(&SizeEvidence::of(sized(80.0, 60.0, 180.0)))), Unit::Millimetre);
}

#[test]
fn round_millimetres_written_in_inches_are_recognised() {
    // 100 x 60 x 10 mm with walls of 3 and bosses of 8 and 45, divided by 25.4 and printed with six digits.
    let inches = |mm: f64| (mm / 25.4 * 1e6).round() / 1e6;
    let lengths = [3.0, 8.0, 45.0].map(inches);
    let evidence =
        SizeEvidence { lengths: &lengths, ..with_walls(sized(inches(100.0), inches(60.0), inches(10.0)), inches(3.0)) };
    let found = unit_candidates(&evidence);
    assert_eq!((best(&found), found.likely), (Unit::Inch, Some(Unit::Inch)));
    assert!(found.ranked[0].reasons.contains(&UnitReason::RoundLengths { metric: 6, imperial: 0, of: 6 }));
}

#[test]
fn a_centred_model_about_1_tall_is_normalised() {
    for size in [0.9, 0.95, 1.0, 2.0] {
        let half = DVec3::new(0.31, 0.22, 0.5) * size;
        let bounds = Box3 { min: -half, max: half };
        let stated = Some((Unit::Metre, UnitSource::File));
        let found = unit_candidates(&SizeEvidence { stated, ..SizeEvidence::of(bounds) });
        assert!(found.normalised && found.likely.is_none(), "{size}");
        let declared = Some((Unit::Metre, UnitSource::Declared));
        let found = unit_candidates(&SizeEvidence { stated: declared, ..SizeEvidence::of(bounds) });
        assert!(!found.normalised && found.taken == Unit::Metre, "{size}");
    }
    let aside = Box3 { min: DVec3::ZERO, max: DVec3::new(0.5, 0.4, 0.96) };
    assert!(!unit_candidates(&SizeEvidence::of(aside)).normalised);
    let generated = SizeEvidence { program: Some("Exported by TRELLIS.2"), ..SizeEvidence::of(aside) };
    assert!(unit_candidates(&generated).normalised);
}

#[test]
fn a_stated_unit_is_kept_and_doubted_only_with_strong_evidence() {
    let stated = |unit| Some((unit, UnitSource::File));
    let figure = SizeEvidence { stated: stated(Unit::Inch), ..SizeEvidence::of(sized(3.0, 2.0, 5.0)) };
    let found = unit_candidates(&figure);
    assert_eq!((found.taken, found.likely), (Unit::Inch, None));
    let wrong = SizeEvidence { stated: stated(Unit::Metre), ..with_walls(sized(70.0, 40.0, 3.0), 3.0) };
    let found = unit_candidates(&wrong);
    assert_eq!((found.taken, found.likely), (Unit::Metre, Some(Unit::Millimetre)));
    assert!(found.ranked.iter().any(|c| c.reasons.contains(&UnitReason::StatedByFile)));
}

#[test]
fn holes_programs_and_sibling_files_count() {
    let score = |evidence: &SizeEvidence<'_>, unit: Unit| {
        unit_candidates(evidence).ranked.iter().find(|c| c.unit == unit).map(|c| c.score).unwrap()
    };
    let plain = SizeEvidence::of(sized(40.3, 21.7, 6.1));
    let holes = SizeEvidence { holes: &[3.3, 4.4, 7.1], ..plain };
    assert!(unit_candidates(&holes).ranked[0].reasons.contains(&UnitReason::ScrewHoles { fit: 2, of: 3 }));
    for (evidence, unit) in [
        (SizeEvidence { program: Some("OpenSCAD_Model"), ..plain }, Unit::Millimetre),
        (SizeEvidence { program: Some("STL by SketchUp"), ..plain }, Unit::Inch),
        (SizeEvidence { siblings: Some(Unit::Centimetre), ..plain }, Unit::Centimetre),
    ] {
        assert!(score(&evidence, unit) > score(&plain, unit) + 1.0);
    }
}

#[test]
fn plausible_parts_in_any_unit_are_never_misjudged_by_more_than_5() {
    for unit in Unit::ALL {
        for (i, longest) in [12.0, 20.0, 35.0, 60.0, 110.0, 200.0].into_iter().enumerate() {
            for wall in [0.8, 1.5, 3.0] {
                let mm = unit.millimetres();
                let size =
                    [longest, longest * 0.6, longest * (0.2 + 0.1 * i as f64)].map(|x| (x * 2.0).round() / 2.0 / mm);
                let found = unit_candidates(&with_walls(sized(size[0], size[1], size[2]), wall / mm));
                let own = found.ranked.iter().find(|c| c.unit == unit).unwrap().score;
                assert!(found.ranked[0].score - own <= 5.0, "{unit} {longest} {wall}: {found:?}");
                assert!(found.likely.is_none_or(|likely| likely == unit || found.ranked[0].score - own < 3.0));
            }
        }
    }
}

#[test]
fn empty_and_absurd_models_are_ranked_without_a_claim() {
    for bounds in [Box3::EMPTY, sized(0.0, 0.0, 0.0), sized(1e300, 1e300, 1e300)] {
        let found = unit_candidates(&SizeEvidence::of(bounds));
        assert_eq!(found.ranked.len(), 6);
        assert!(found.ranked.iter().all(|c| c.score.is_finite()), "{found:?}");
    }
    assert_eq!(unit_candidates(&SizeEvidence::of(sized(0.0, 0.0, 0.0))).likely, None);
}
