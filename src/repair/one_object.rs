//! The repair of one object of a file, in its own coordinates.

use super::dress::{carried, carrier};
use super::input::{Input, Told, inspect_input};
use super::pipeline::{Mended, mend};
use super::settled::{analyse_settled, settle_orientation};
use super::{Context, Options, Progress, Remesher, RepairError, Report, Stage};
use crate::analyze::subject;
use crate::format::{Format, ReadFile};
use crate::inspect::{Analysis, CompareOptions, Original};
use crate::mesh::{Soup, Surface};
use crate::scene::Object;

/// A repaired object, before it is painted.
pub(super) struct RepairedObject {
    pub report: Report,
    /// The object as it was, welded.
    pub before: Surface,
    /// Its result; none where it has nothing that can be written.
    pub soup: Option<Soup>,
    /// For each face of the result the object's face that it was cut from.
    pub source: Vec<u32>,
    /// Whether the object has vertices that are one only by their positions.
    pub welded: bool,
}

/// Repairs one object as a mesh of its own.
pub(super) fn repair_object(
    file: &ReadFile,
    object: &Object,
    format: Format,
    options: &Options,
    remesher: Option<&dyn Remesher>,
    context: &Context<'_>,
) -> Result<RepairedObject, RepairError> {
    let began = context.now();
    let mesh = file.mesh.of_same_file(object.mesh().map(|mesh| mesh.soup.clone()).unwrap_or_default());
    let analysis = Analysis::new(subject(&mesh, file.unit.as_ref()), &context.for_verification())?;
    let (before, time) = inspect_input(&analysis, began, context)?;
    let settled = settle_orientation(&analysis, &before.measures, options, context)?;
    let settled = analyse_settled(settled.as_ref(), context)?;
    let original = Original::new(&analysis, &before.measures, CompareOptions::BRIEF).with_settled(settled.as_ref());
    let input =
        Input { bytes: None, mesh: &mesh, analysis: &analysis, original: &original, before: &before, time: &time };
    let mut report = input.report(options, 0);
    let Mended { outcome, judged } = mend(&input, carrier(format), &mut report, options, remesher, context)?;
    let Told { bytes, source, .. } = input.tell(&mut report, outcome, judged, context)?;
    let soup = if bytes.is_empty() { None } else { Some(carried(&bytes)?) };
    let welded = analysis.ingest.merged_vertices > 0 && format == Format::ThreeMf;
    Ok(RepairedObject { report, before: analysis.surface, soup, source, welded })
}

/// What an object is called in sentences: by its name, or by its number where it has none.
pub(super) fn name_of(object: &Object, number: usize) -> String {
    object.name.as_ref().map_or_else(|| format!("object {}", number + 1), |name| format!("object '{name}'"))
}

/// The progress of one object as a part of the whole.
pub(super) struct Share<'a> {
    pub context: &'a Context<'a>,
    pub from: f64,
    pub to: f64,
    pub name: &'a str,
}

impl Progress for Share<'_> {
    fn report(&self, stage: Stage, tier: Option<u8>, percent: u8) {
        let percent = self.from + (self.to - self.from) * f64::from(percent) / 100.0;
        // What an object is finished with the whole is not.
        let stage = if stage == Stage::Finish { Stage::Verify } else { stage };
        self.context.report(stage, tier, percent as u8);
    }

    fn log(&self, line: &str) {
        self.context.log(&format!("{}: {line}", self.name));
    }
}
