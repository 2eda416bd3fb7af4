//! The repair of one object of a file, in its own coordinates.

use super::body::repair_body;
use super::dress::{carried, carrier};
use super::input::{Source, inspected};
use super::objects::ObjectPlace;
use super::{Context, ObjectReport, Options, Progress, Remesher, RepairError, Stage};
use crate::format::{Format, ReadFile};
use crate::mesh::{Soup, Surface};
use crate::scene::Object;

/// A repaired object, before it is painted.
pub(super) struct RepairedObject {
    pub report: ObjectReport,
    /// The object as it was, welded.
    pub before: Surface,
    /// Its result; none where it has nothing that can be written.
    pub soup: Option<Soup>,
    /// For each face of the result the object's face that it was cut from.
    pub source: Vec<u32>,
    /// Whether the object has vertices that are one only by their positions.
    pub welded: bool,
}

/// What the repairs of a file's objects have in common.
pub(super) struct ObjectRepair<'a> {
    pub file: &'a ReadFile,
    pub format: Format,
    pub remesher: Option<&'a dyn Remesher>,
}

impl ObjectRepair<'_> {
    /// Repairs one object as a mesh of its own.
    pub fn run(
        &self,
        object: &Object,
        place: ObjectPlace,
        options: &Options,
        context: &Context<'_>,
    ) -> Result<RepairedObject, RepairError> {
        let start = context.now();
        let mesh = self.file.mesh.of_same_file(object.mesh().map(|mesh| mesh.soup.clone()).unwrap_or_default());
        let source = Source { bytes: None, mesh: &mesh, unit: self.file.unit.as_ref() };
        inspected(&source, options, context, |input| {
            let body = repair_body(&input, carrier(self.format), options, self.remesher, context)?;
            let soup = if body.bytes.is_empty() { None } else { Some(carried(&body.bytes)?) };
            let welded = input.analysis.ingest.merged_vertices > 0 && self.format == Format::ThreeMf;
            let time = context.now().saturating_sub(start);
            let report = ObjectReport::new(place, &input, body.account, time);
            Ok(RepairedObject { report, before: input.analysis.surface.clone(), soup, source: body.source, welded })
        })
    }
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
