use super::RepairError;
use super::verdict::{JudgeError, Judged, Patches, fates, judge};
use super::{Cancelled, Category, Context, FileSummary, Options, Outcome, Plan, Preset, REPORT_VERSION, Report};
use crate::format::{self, Format, Limits, ReadError, ReadMesh};
use crate::inspect::{
    Analysis, Findings, InspectOptions, Inspection, Level, Measures, Original, Subject, inspect_analysis,
};

/// What came in.
pub(super) struct Input<'a> {
    pub bytes: &'a [u8],
    pub mesh: &'a ReadMesh,
    pub analysis: &'a Analysis<'a>,
    /// The same as what results are compared with.
    pub original: &'a Original<'a>,
    pub before: &'a Inspection,
}

impl Input<'_> {
    /// The input's own bytes, or its faces in order in another format; none where no face is left to write. It does not wait for
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
        // Nor is an archive handed out for the model in it.
        let is_alone = format::sniff(self.bytes, Some(self.bytes.len() as u64)).is_ok_and(|it| it == format);
        if format == self.mesh.format && whole && is_alone {
            return Ok(Some(Judged {
                bytes: self.bytes.to_vec(),
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
        if judged.bytes == self.bytes {
            judged.fates = fates(self.original, self.analysis, context)?;
            return Ok((self.before.clone(), None));
        }
        if let Some((inspection, findings)) = judged.looked.take() {
            return Ok((inspection, Some(findings)));
        }
        let read = read_own(&judged.bytes)?;
        let analysis = Analysis::new(subject(&read), &context.without_deadline())?;
        let (inspection, findings) = look(&analysis, || Ok(judged.measures.clone()), context)?;
        judged.fates = fates(self.original, &analysis, context)?;
        Ok((inspection, Some(findings)))
    }

    /// The account as far as it is known before anything was run.
    pub fn report(&self, options: &Options) -> Report {
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
            input: FileSummary {
                format: self.mesh.format,
                dialect: self.mesh.dialect.clone(),
                bytes: self.bytes.len() as u64,
            },
            output: None,
            options: options.clone(),
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
    format::read(bytes, &Limits { max_bytes: u64::MAX, max_faces: u64::MAX, max_vertices: u64::MAX })
}

/// All that a file says.
pub(super) fn subject(mesh: &ReadMesh) -> Subject<'_> {
    Subject { soup: &mesh.soup, normals: mesh.normals.as_ref(), numbering: mesh.numbering.as_ref() }
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
