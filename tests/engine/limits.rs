//! Limits in the options: operators stay within the allowed deviation.

use glam::DVec3;
use meshmend::mesh::Soup;
use meshmend::repair::{
    Context, Operator, Options, Outcome, RedFlagCode, RemeshError, RemeshRequest, Remeshed, Remesher, RemesherInfo,
    Repaired, StepStatus,
};

use crate::meshes::{cube, join, sphere};
use crate::support::repair_soup;

fn run(soup: &Soup, options: &Options, remesher: Option<&dyn Remesher>) -> Repaired {
    repair_soup(soup, options, remesher)
}

fn native() -> Options {
    Options { max_tier: 2, ..Options::default() }
}

/// Two cubes that share an edge: readers that merge by position see two solids only if a vertex moves.
fn on_an_edge() -> Soup {
    join(&cube(DVec3::ZERO, 1.0, 1), &cube(DVec3::new(1.0, 1.0, 0.0), 1.0, 1))
}

#[test]
fn changes_beyond_max_deviation_are_not_made_and_are_reported() {
    let free = run(&on_an_edge(), &native(), None).report;
    assert_eq!(free.outcome, Outcome::Repaired);
    let farthest = free.steps.iter().map(|s| s.moved).fold(0.0, f64::max);
    assert!(farthest > 0.0 && farthest < 1e-5, "{farthest}");
    let measured = free.changes.unwrap().moved.unwrap().distance.max;
    assert!(measured > 0.0 && measured <= farthest * 1.01, "{measured}");

    let bound = run(&on_an_edge(), &Options { max_deviation: Some(0.0), ..native() }, None).report;
    assert!(bound.steps.iter().all(|s| s.moved == 0.0), "{:?}", bound.steps);
    assert_ne!(bound.outcome, Outcome::Repaired);
    assert!(bound.after.unwrap().measures.non_manifold_edges > 0);
    assert!(bound.summary.contains("non-manifold"), "{}", bound.summary);
}

/// A remesher that returns a ball of the right size with other faces.
struct BallRemesher(RemesherInfo);

impl Remesher for BallRemesher {
    fn info(&self) -> Result<&RemesherInfo, &str> {
        Ok(&self.0)
    }

    fn remesh(&self, _: &RemeshRequest<'_>, _: &Context<'_>) -> Result<Remeshed, RemeshError> {
        Ok(Remeshed::from(sphere(DVec3::ZERO, 1.001, 32, 16)))
    }
}

#[test]
fn a_remesh_farther_from_the_input_than_max_deviation_is_flagged() {
    let mut broken = sphere(DVec3::ZERO, 1.0, 64, 32);
    broken.faces.truncate(broken.faces.len() - 3);
    let ball = BallRemesher(RemesherInfo { kind: "fake".into(), version: "1".into(), program: "none".into() });
    let asked = Options { preset: meshmend::repair::Preset::BlenderRemesh, ..Options::default() };
    let free = run(&broken, &asked, Some(&ball)).report;
    assert_eq!(free.outcome, Outcome::Repaired, "{}", free.summary);
    let bound = run(&broken, &Options { max_deviation: Some(1e-4), ..asked }, Some(&ball)).report;
    let flagged = bound.candidates.iter().any(|c| c.red_flags.iter().any(|f| f.code == RedFlagCode::Deviation));
    assert!(flagged, "{:?}", bound.candidates);
    // Closing the hole moves no vertex, so that result is returned.
    assert_eq!(bound.outcome, Outcome::Repaired);
    assert!(bound.red_flags.is_empty());
}

#[test]
fn an_operator_that_is_switched_off_does_not_run() {
    let mut open = cube(DVec3::ZERO, 1.0, 2);
    open.faces.remove(0);
    let ran = |report: &meshmend::repair::Report| report.steps.iter().any(|s| s.operator == Some(Operator::FillHoles));
    let with = run(&open, &native(), None).report;
    assert!(ran(&with) && with.outcome == Outcome::Repaired);
    // Other operators that would close the hole.
    let off = vec![Operator::FillHoles, Operator::ThickenSheets, Operator::CleanAndPatch, Operator::Remesh];
    let without = run(&open, &Options { without: off, ..native() }, None).report;
    assert!(!ran(&without) && without.outcome != Outcome::Repaired);
    let planned = without.plan.strategies.iter().flat_map(|r| &r.actions).flat_map(|a| &a.operators);
    assert!(planned.into_iter().all(|&o| o != Operator::FillHoles));
}

#[test]
fn operators_are_named_in_one_string_or_in_an_array() {
    let read = |json: &str| serde_json::from_str::<Options>(json);
    let both = vec![Operator::Weld, Operator::FillHoles];
    assert_eq!(read(r#"{"without": "weld, fill_holes"}"#).unwrap().without, both);
    assert_eq!(read(r#"{"without": ["weld", "fill_holes"]}"#).unwrap().without, both);
    let error = read(r#"{"without": "wield"}"#).unwrap_err().to_string();
    assert!(error.contains("unknown operator `wield`; use one of round_coordinates, "), "{error}");
    for &operator in Operator::ALL {
        assert_eq!(serde_json::to_value(operator).unwrap(), operator.as_str());
    }
}

#[test]
fn every_step_names_its_operator_and_no_operator_broke_its_claim() {
    let report = run(&on_an_edge(), &native(), None).report;
    assert!(report.steps.iter().filter(|s| s.tier > 0).all(|s| s.operator.is_some()));
    assert!(report.steps.iter().all(|s| s.status != StepStatus::Reverted), "{:?}", report.steps);
}
