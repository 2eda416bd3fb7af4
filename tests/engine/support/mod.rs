//! Helpers for the tests of the engine: contexts, measurements and repairs without Blender.

pub mod archives;
pub mod manifold;

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use meshmend::arrange::{ArrangeError, Arrangement, Rule, Solid};
use meshmend::format::{Format, Limits, read, write};
use meshmend::inspect::{Measures, measure};
use meshmend::mesh::{ClosedSurface, Soup, Surface};
use meshmend::repair::{
    Change, Context, NoProgress, Options, Outcome, RemeshError, RemeshRequest, Remeshed, Remesher, RemesherInfo,
    RepairError, Repaired, repair,
};
use serde_json::Value;

use crate::prose;

/// Runs `f` with a context whose clock stands still.
pub fn with_context<T>(f: impl FnOnce(&Context<'_>) -> T) -> T {
    let cancel = AtomicBool::new(false);
    let clock = || Duration::ZERO;
    f(&Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(600)))
}

pub fn measured(surface: &Surface) -> Measures {
    with_context(|c| measure(&surface.to_soup(), c)).unwrap()
}

/// Measures a file.
pub fn measured_file(bytes: &[u8]) -> Measures {
    let soup = read(bytes, &Limits::default()).unwrap().soup;
    with_context(|c| measure(&soup, c)).unwrap()
}

/// Measures a surface after writing it as STL and reading it again: with coordinates in f32 and without indices.
pub fn measured_as_stl(surface: &Surface) -> Measures {
    measured_file(&write(&surface.to_soup(), Format::Stl).unwrap())
}

/// The count of the changes of one kind; 0 if there are none.
pub fn change_count(changes: &[Change], kind: &str) -> u64 {
    changes.iter().find(|change| change.kind.as_str() == kind).map_or(0, |change| change.count)
}

pub fn arranged(engine: &dyn Arrangement, surface: &Surface, rule: Rule) -> Result<Solid, ArrangeError> {
    with_context(|c| engine.solid(ClosedSurface::try_from(surface)?, None, rule, c))
}

/// Repairs a soup that is given as an STL file.
pub fn repair_soup(soup: &Soup, options: &Options, remesher: Option<&dyn Remesher>) -> Repaired {
    repair_bytes(&write(soup, Format::Stl).unwrap(), options, remesher).unwrap()
}

/// Repairs a file, and checks that all texts of the report, or of the error, keep the rules for texts.
pub fn repair_bytes(bytes: &[u8], options: &Options, remesher: Option<&dyn Remesher>) -> Result<Repaired, RepairError> {
    let repaired = with_context(|c| repair(bytes, options, &Limits::default(), remesher, c));
    let mut texts = Vec::new();
    match &repaired {
        Ok(repaired) => collect_texts(&serde_json::to_value(&repaired.report).unwrap(), "report", &mut texts),
        Err(error) => texts.push(("error".to_owned(), error.to_string())),
    }
    prose::assert_clear(&texts);
    repaired
}

/// A remesher that always returns the same mesh.
pub struct FixedRemesher(RemesherInfo, Soup);

impl FixedRemesher {
    pub fn returning(answer: Soup) -> Self {
        let info = RemesherInfo { kind: "fake".to_owned(), version: "1.0".to_owned(), program: "fake".to_owned() };
        Self(info, answer)
    }
}

impl Remesher for FixedRemesher {
    fn info(&self) -> Result<&RemesherInfo, &str> {
        Ok(&self.0)
    }

    fn remesh(&self, _: &RemeshRequest<'_>, _: &Context<'_>) -> Result<Remeshed, RemeshError> {
        Ok(Remeshed::from(self.1.clone()))
    }
}

/// Adds the strings of at least three words in a JSON value, each with its place.
fn collect_texts(value: &Value, place: &str, texts: &mut Vec<(String, String)>) {
    match value {
        Value::String(text) if text.split_whitespace().count() > 2 => texts.push((place.to_owned(), text.clone())),
        Value::Object(fields) => fields.iter().for_each(|(key, value)| collect_texts(value, key, texts)),
        Value::Array(values) => values.iter().for_each(|value| collect_texts(value, place, texts)),
        _ => {}
    }
}

/// Repairs a file with tiers 1 and 2 at a coarse voxel resolution, without pictures.
pub fn repair_up_to_tier_2(bytes: &[u8]) -> Repaired {
    let options = Options { max_tier: 2, pictures: false, voxel_resolution: 50, ..Options::default() };
    repair_bytes(bytes, &options, None).unwrap()
}

/// Asserts the outcome of a repair, and shows the summary and the red flags of another.
#[track_caller]
pub fn assert_outcome(repaired: &Repaired, outcome: Outcome) {
    let report = &repaired.report;
    assert_eq!(report.outcome, outcome, "{} {:?}", report.summary, report.red_flags);
}
