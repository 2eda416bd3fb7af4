use super::verdict::{JudgeError, Judged, judge};
use super::{
    Cancelled, Category, Context, FileSummary, Options, Outcome, Plan, Preset, REPORT_VERSION, Report, compare,
};
use super::{RepairError, Stage};
use crate::format::{self, Format, Limits, ReadError, ReadMesh};
use crate::inspect::{InspectOptions, Inspection, Level, Subject, inspect};
use crate::mesh::{Soup, Surface};

/// What came in, read and looked at.
pub(super) struct Input<'a> {
    pub bytes: &'a [u8],
    pub soup: Soup,
    pub format: Format,
    pub dialect: String,
    pub before: Inspection,
    pub warnings: Vec<String>,
}

impl<'a> Input<'a> {
    /// Reads a file and looks at its mesh.
    pub fn read(bytes: &'a [u8], limits: &Limits, context: &Context<'_>) -> Result<Self, RepairError> {
        context.report(Stage::Read, None, 0);
        let ReadMesh { soup, format, dialect, mut warnings } = format::read(bytes, limits)?;
        context.report(Stage::Inspect, None, 3);
        let before = look((&soup).into(), context)?;
        let Inspection { measures, .. } = &before;
        let (faces, parts, defects) = (measures.faces, measures.parts, measures.defects());
        context.log(&format!("read {dialect}: {faces} faces, {parts} parts, {defects} defects"));
        warnings.extend(measures.left_out());
        warnings.push("self-intersections were not checked by this version".to_owned());
        Ok(Self { bytes, soup, format, dialect, before, warnings })
    }

    /// The input's own bytes, or its faces in order in another format; none where no face is left to write.
    pub fn handed_back(
        &self,
        format: Format,
        options: &Options,
        context: &Context<'_>,
    ) -> Result<Option<Judged>, RepairError> {
        let before = &self.before.measures;
        if format == self.format {
            return Ok(Some(Judged {
                bytes: self.bytes.to_vec(),
                dialect: self.dialect.clone(),
                measures: before.clone(),
                changes: compare(before, before, &self.soup, &self.soup, context)?,
                red_flags: Vec::new(),
            }));
        }
        let (surface, _) = Surface::from_soup(&self.soup);
        if surface.faces.is_empty() {
            return Ok(None);
        }
        match judge(&surface, format, &self.soup, before, options, context) {
            Ok(judged) => Ok(Some(judged)),
            Err(JudgeError::Write(error)) => Err(error.into()),
            Err(JudgeError::Read(error)) => Err(error.into()),
            Err(JudgeError::Cancelled(stop)) => Err(stop.into()),
        }
    }

    /// Looks at a result as at the input: at its own bytes, read back. Those of the input are known already.
    pub fn after(&self, judged: &Judged, context: &Context<'_>) -> Result<Inspection, RepairError> {
        if judged.bytes == self.bytes {
            return Ok(self.before.clone());
        }
        let read = read_own(&judged.bytes)?;
        Ok(look((&read.soup).into(), context)?)
    }

    /// The account as far as it is known before anything was run.
    pub fn report(&self, options: &Options) -> Report {
        Report {
            version: REPORT_VERSION,
            engine: crate::ENGINE.to_owned(),
            outcome: Outcome::Unrepairable,
            summary: String::new(),
            input: FileSummary { format: self.format, dialect: self.dialect.clone(), bytes: self.bytes.len() as u64 },
            output: None,
            options: options.clone(),
            before: self.before.clone(),
            after: None,
            verified_from_output_bytes: false,
            changes: None,
            plan: Plan {
                category: Category::Clean,
                preset: Preset::BasicCleanup,
                reason: String::new(),
                rungs: Vec::new(),
            },
            steps: Vec::new(),
            candidates: Vec::new(),
            red_flags: Vec::new(),
            warnings: self.warnings.clone(),
            milliseconds: 0.0,
        }
    }
}

/// Reads what we have written, however large it is.
pub(super) fn read_own(bytes: &[u8]) -> Result<ReadMesh, ReadError> {
    format::read(bytes, &Limits { max_bytes: u64::MAX, max_faces: u64::MAX, max_vertices: u64::MAX })
}

/// Looks at everything; when the time is over, only counts, since a repair without measures is none.
fn look(subject: Subject<'_>, context: &Context<'_>) -> Result<Inspection, Cancelled> {
    let all = InspectOptions::default();
    match inspect(subject, &all, context) {
        Err(Cancelled) if !context.is_cancelled() => {
            inspect(subject, &InspectOptions { level: Level::None, ..all }, &context.without_deadline())
        }
        looked => looked,
    }
    .map(|(inspection, _)| inspection)
}
