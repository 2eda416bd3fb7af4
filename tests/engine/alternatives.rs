//! Alternatives where a file leaves the model's intent open: which ones are made, and that each is a whole result.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use glam::DVec3;
use meshmend::context::{Context, NoProgress, monotonic_clock};
use meshmend::format::{Format, Limits, write};
use meshmend::mesh::Soup;
use meshmend::repair::{
    AlternativeRequest, AlternativeRuns, Alternatives, DEFAULT_CHOICE, Islands, NotOfferedCause, OpenQuestion, Options,
    PrintOptions, Repaired, RepairedAlternative, Voids, repair,
};

use crate::meshes::{cube, inside_out, join, sphere};

/// A repair with all its alternatives.
fn with_alternatives(soup: &Soup, print: PrintOptions) -> (Repaired, Vec<RepairedAlternative>, Alternatives) {
    let bytes = write(soup, Format::Stl).expect("written");
    let options = Options { alternatives: true, max_tier: 2, print, ..Options::default() };
    let (cancel, clock, limits) = (AtomicBool::new(false), monotonic_clock(), Limits::default());
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(300));
    let default = repair(&bytes, &options, &limits, None, &context).expect("a result");
    let request =
        AlternativeRequest { input: &bytes, options: &options, limits: &limits, remesher: None, context: &context };
    let mut runs = AlternativeRuns::new(request, &default).expect("questions");
    let mut made = Vec::new();
    while let Some(alternative) = runs.make_next().expect("a result") {
        made.push(alternative);
    }
    (default, made, runs.summary())
}

fn ids(summary: &Alternatives) -> Vec<&str> {
    summary.offered.iter().map(|offered| offered.id.as_str()).collect()
}

fn hollow_cube() -> Soup {
    join(&cube(DVec3::ZERO, 20.0, 1), &inside_out(cube(DVec3::splat(5.0), 10.0, 1)))
}

#[test]
fn a_hollow_solid_may_be_taken_with_its_cavity_filled() {
    let (default, made, summary) = with_alternatives(&hollow_cube(), PrintOptions::default());
    assert_eq!(ids(&summary), [DEFAULT_CHOICE, "voids-fill"], "{summary:#?}");
    let [hollow, filled] = &summary.offered[..] else { panic!("{summary:#?}") };
    assert!(hollow.is_default && hollow.question.is_none() && !filled.is_default);
    assert_eq!((filled.question, filled.option.as_deref()), (Some(OpenQuestion::Cavities), Some("voids=fill")));
    let volumes = [hollow, filled].map(|offered| offered.volume_mm3.expect("a volume").round());
    assert_eq!((volumes, [hollow.parts, filled.parts]), ([7000.0, 8000.0], [2, 1]));
    assert_eq!(filled.size_mm, Some([20.0; 3]));
    assert_eq!([hollow, filled].map(|offered| offered.thinnest_wall_mm.map(f64::round)), [Some(5.0), Some(20.0)]);
    assert!(filled.printable && (filled.area_mm2 - 2400.0).abs() < 1e-6);
    let [RepairedAlternative { id, repaired }] = &made[..] else { panic!("one alternative") };
    assert_eq!((id.as_str(), repaired.bytes.len() as u64), ("voids-fill", filled.file.bytes));
    assert!(repaired.report.verified_from_output_bytes && repaired.report.alternatives.is_none());
    assert_ne!(repaired.bytes, default.bytes);
}

#[test]
fn a_plain_solid_leaves_no_question_open() {
    let (_, made, summary) = with_alternatives(&cube(DVec3::ZERO, 20.0, 1), PrintOptions::default());
    assert_eq!((ids(&summary), made.len(), summary.not_offered.len()), (vec![DEFAULT_CHOICE], 0, 0));
}

#[test]
fn an_option_that_answers_the_question_closes_it() {
    let print = PrintOptions { voids: Voids::Fill, ..PrintOptions::default() };
    let (_, made, summary) = with_alternatives(&hollow_cube(), print);
    assert_eq!((ids(&summary), made.len()), (vec![DEFAULT_CHOICE], 0));
}

#[test]
fn small_and_loose_solids_may_be_dropped_or_attached() {
    let crumb = cube(DVec3::new(30.0, 0.0, 0.0), 0.5, 1);
    let pieces = join(&cube(DVec3::ZERO, 20.0, 1), &join(&crumb, &cube(DVec3::new(22.0, 5.0, 5.0), 4.0, 1)));
    let (default, made, summary) = with_alternatives(&pieces, PrintOptions::default());
    assert_eq!(ids(&summary), [DEFAULT_CHOICE, "islands-drop", "islands-attach"], "{summary:#?}");
    let parts: Vec<u64> = summary.offered.iter().map(|offered| offered.parts).collect();
    assert_eq!(parts, [3, 2, 1]);
    assert!(made.iter().all(|alternative| alternative.repaired.report.outcome.is_printable()));
    assert!(made.iter().all(|alternative| alternative.repaired.bytes != default.bytes));
    let print = PrintOptions { islands: Islands::Keep, ..PrintOptions::default() };
    let (_, _, summary) = with_alternatives(&pieces, print);
    assert_eq!(ids(&summary), [DEFAULT_CHOICE], "the request decides about islands");
}

/// A ball as generators make it: two skins 0.05 apart, with pinholes in both, and a crumb.
fn double_shell() -> Soup {
    let mut outer = sphere(DVec3::ZERO, 10.0, 48, 24);
    let mut inner = inside_out(sphere(DVec3::ZERO, 9.95, 48, 24));
    for (skin, every) in [(&mut outer, 400), (&mut inner, 390)] {
        let mut number = 0;
        skin.faces.retain(|_| {
            number += 1;
            number % every != 0
        });
    }
    join(&join(&outer, &inner), &cube(DVec3::new(14.0, 0.0, 0.0), 0.2, 1))
}

#[test]
fn a_double_shell_taken_as_a_solid_may_be_taken_as_hollow() {
    let (default, _, summary) = with_alternatives(&double_shell(), PrintOptions::default());
    let filled = summary.offered.first().expect("the default");
    assert!(filled.volume_mm3.is_some_and(|volume| volume > 4000.0), "{:#?}", default.report.assumptions);
    let keep = summary.offered.iter().find(|offered| offered.id == "interior-keep");
    let refused = summary.not_offered.iter().find(|answer| answer.id == "interior-keep");
    let hollow = keep.is_some_and(|keep| keep.volume_mm3.is_some_and(|volume| volume < 1000.0));
    let reason = refused.is_some_and(|refused| refused.cause == NotOfferedCause::NotPrintable);
    assert!(hollow || reason, "{summary:#?}");
}

#[test]
fn an_exhausted_deadline_leaves_only_the_default() {
    let bytes = write(&hollow_cube(), Format::Stl).expect("written");
    let options = Options { alternatives: true, max_tier: 2, ..Options::default() };
    let (cancel, clock, limits) = (AtomicBool::new(false), || Duration::from_secs(1), Limits::default());
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(300));
    let default = repair(&bytes, &options, &limits, None, &context).expect("a result");
    let late_clock = || Duration::from_secs(301);
    let late = Context::new(&NoProgress, &cancel, &late_clock, Duration::from_secs(300));
    let request =
        AlternativeRequest { input: &bytes, options: &options, limits: &limits, remesher: None, context: &late };
    let mut runs = AlternativeRuns::new(request, &default).expect("questions");
    assert!(runs.make_next().expect("no failure").is_none());
    assert_eq!(ids(&runs.summary()), [DEFAULT_CHOICE]);
}
