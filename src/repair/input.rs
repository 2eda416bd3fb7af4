use super::RepairError;
use super::verdict::{JudgeError, Judged, Patches, fates, judge};
use super::{
    Cancelled, Category, Changes, Context, FileSummary, Options, Outcome, Plan, Preset, REPORT_VERSION, Report, summary,
};
use crate::format::{self, Format, Limits, ReadError, ReadMesh};
use crate::inspect::{
    Analysis, Fates, Findings, InspectOptions, Inspection, Level, Measures, Original, Subject, inspect_analysis,
};
use crate::scene::LengthUnit;

/// What came in.
pub(super) struct Input<'a> {
    /// Its bytes, where they may come back as they are.
    pub bytes: Option<&'a [u8]>,
    pub mesh: &'a ReadMesh,
    pub analysis: &'a Analysis<'a>,
    /// The same as what results are compared with.
    pub original: &'a Original<'a>,
    pub before: &'a Inspection,
}

/// What is left of a result when its account was written.
#[derive(Default)]
pub(super) struct Told {
    pub bytes: Vec<u8>,
    pub dialect: String,
    pub source: Vec<u32>,
    pub found: Option<Findings>,
    pub fates: Option<Fates>,
}

impl Input<'_> {
    /// The input's own bytes, or its faces in order in the format that results are judged in; none where no face is left to write. It does not wait for
    /// the end of the time.
    pub fn handed_back(
        &self,
        format: Format,
        options: &Options,
        context: &Context<'_>,
    ) -> Result<Option<Judged>, RepairError> {
        let before = &self.before.measures;
        // A file of which some faces could not be read is never handed out as it is.
        let whole = self.mesh.numbering.is_none_or(|it| it.faces_without_vertex == 0);
        if let Some(bytes) = self.bytes.filter(|_| whole) {
            return Ok(Some(Judged {
                bytes: bytes.to_vec(),
                source: Vec::new(),
                dialect: self.mesh.dialect.clone(),
                measures: before.clone(),
                changes: self.original.changes(self.analysis, before, Some(&[]), &context.without_deadline())?,
                red_flags: Vec::new(),
                looked: None,
                fates: None,
                ledger: None,
            }));
        }
        let surface = &self.analysis.surface;
        if surface.faces.is_empty() {
            return Ok(None);
        }
        match judge(surface, Patches::BySource, format, self.original, options, context) {
            Ok(judged) => Ok(Some(judged)),
            Err(JudgeError::Write(error)) => Err(error.into()),
            Err(JudgeError::Read(error)) => Err(error.into()),
            Err(JudgeError::Cancelled(stop)) => Err(stop.into()),
        }
    }

    /// Looks at a result as at the input: at its own bytes, read back, and at what became of the input. What the input's bytes
    /// say is known already.
    pub fn after(
        &self,
        judged: &mut Judged,
        context: &Context<'_>,
    ) -> Result<(Inspection, Option<Findings>), RepairError> {
        if self.bytes == Some(judged.bytes.as_slice()) {
            judged.fates = fates(self.original, self.analysis, context)?;
            return Ok((self.before.clone(), None));
        }
        if let Some((inspection, findings)) = judged.looked.take() {
            return Ok((inspection, Some(findings)));
        }
        let read = read_own(&judged.bytes)?;
        let analysis = Analysis::new(subject(&read, self.analysis.subject.unit), &context.without_deadline())?;
        let (inspection, findings) = look(&analysis, || Ok(judged.measures.clone()), context)?;
        judged.fates = fates(self.original, &analysis, context)?;
        Ok((inspection, Some(findings)))
    }

    /// Puts down how it ended. Answers what was found on the result, where it is not the input.
    pub fn tell(
        &self,
        report: &mut Report,
        outcome: Outcome,
        judged: Option<Judged>,
        context: &Context<'_>,
    ) -> Result<Told, RepairError> {
        report.outcome = outcome;
        report.summary = summary::in_words(outcome, report, judged.as_ref().map(|j| &j.measures), context);
        let Some(mut judged) = judged else { return Ok(Told::default()) };
        let (after, found) = self.after(&mut judged, context)?;
        report.after = Some(after);
        let surface = judged.fates.as_ref().map(|fates| fates.shares);
        report.changes = Some(Changes { surface, ..judged.changes });
        report.ledger = judged.ledger;
        report.red_flags = judged.red_flags;
        report.verified_from_output_bytes = true;
        Ok(Told { bytes: judged.bytes, dialect: judged.dialect, source: judged.source, found, fates: judged.fates })
    }

    /// The account as far as it is known before anything was run.
    pub fn report(&self, options: &Options, bytes: u64) -> Report {
        let mut warnings = self.mesh.warnings.clone();
        warnings.extend(self.before.measures.left_out());
        let intersections = &self.before.measures.self_intersections;
        if intersections.checked && !intersections.complete {
            warnings.push("so many faces overlap that they were not all counted".to_owned());
        }
        Report {
            version: REPORT_VERSION,
            engine: crate::ENGINE.to_owned(),
            outcome: Outcome::Unrepairable,
            summary: String::new(),
            input: FileSummary { format: self.mesh.format, dialect: self.mesh.dialect.clone(), bytes },
            output: None,
            options: options.clone(),
            unit: self.analysis.subject.unit.cloned().unwrap_or_default(),
            objects: Vec::new(),
            before: self.before.clone(),
            after: None,
            verified_from_output_bytes: false,
            changes: None,
            ledger: None,
            plan: Plan {
                category: Category::Clean,
                preset: Preset::BasicCleanup,
                reason: String::new(),
                rungs: Vec::new(),
            },
            steps: Vec::new(),
            candidates: Vec::new(),
            red_flags: Vec::new(),
            warnings,
            milliseconds: 0.0,
        }
    }
}

/// Reads what we have written, however large it is.
pub(super) fn read_own(bytes: &[u8]) -> Result<ReadMesh, ReadError> {
    format::read(bytes, &Limits::NONE)
}

/// All that a file says, with lengths in a unit.
pub(super) fn subject<'a>(mesh: &'a ReadMesh, unit: Option<&'a LengthUnit>) -> Subject<'a> {
    Subject { soup: &mesh.soup, normals: mesh.normals.as_ref(), numbering: mesh.numbering.as_ref(), unit }
}

/// Looks at everything. When the time is over only what results are judged by is told, from `measures`, since a repair
/// without it is none.
pub(super) fn look(
    analysis: &Analysis<'_>,
    measures: impl FnOnce() -> Result<Measures, Cancelled>,
    context: &Context<'_>,
) -> Result<(Inspection, Findings), Cancelled> {
    let all = InspectOptions::default();
    match inspect_analysis(analysis, &all, context) {
        Err(Cancelled) if !context.is_cancelled() => {
            let measures = measures()?;
            let counts = InspectOptions { level: Level::None, ..all };
            let (counted, findings) = inspect_analysis(analysis, &counts, &context.without_deadline())?;
            Ok((Inspection { measures, ..counted }, findings))
        }
        looked => looked,
    }
}
