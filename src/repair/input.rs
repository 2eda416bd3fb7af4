use std::time::Duration;

use super::RepairError;
use super::invented::Invented;
use super::settled::{analyse_settled, settle_orientation};
use super::time_budget::{TimeBudget, for_details};
use super::verdict::{JudgeError, Judged, Patches, judge, surface_shares};
use super::{Cancelled, Changes, Context, LeftOut, Options};
use crate::analyze::subject;
use crate::format::{self, Format, Limits, ReadError, ReadMesh};
use crate::inspect::{
    Analysis, CompareOptions, DefectKind, Findings, InspectOptions, Inspection, Level, Measures, Original,
    inspect_analysis, measure_analysis,
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
    pub time: &'a TimeBudget,
}

impl Input<'_> {
    /// The input's own bytes, or its faces in order in the format that results are judged in; none where no face is left to write, or
    /// where there was no time to verify what was written.
    pub fn handed_back(
        &self,
        format: Format,
        options: &Options,
        context: &Context<'_>,
    ) -> Result<Option<Judged>, RepairError> {
        let before = &self.before.measures;
        // A file of which some faces could not be read is never handed out as it is, nor one whose normals point into the mesh: written
        // again, it has none, or those of its faces.
        let whole = self.mesh.numbering.as_ref().is_none_or(|it| it.faces_without_vertex == 0);
        if let Some(bytes) = self.bytes.filter(|_| whole && self.bad_normals() == 0) {
            return Ok(Some(self.unchanged(bytes.to_vec(), self.mesh.dialect.clone(), before.clone(), context)?));
        }
        let surface = &self.analysis.surface;
        if surface.faces.is_empty() {
            return Ok(None);
        }
        if self.time.can_verify(surface.faces.len(), context) {
            let start = context.now();
            match judge(surface, Patches::BySource, None, format, self.original, options, context) {
                Ok(judged) => {
                    self.time.note_verification(surface.faces.len(), context.now().saturating_sub(start));
                    return Ok(Some(judged));
                }
                Err(JudgeError::Write(error)) => return Err(error.into()),
                Err(JudgeError::Read(error)) => return Err(error.into()),
                Err(JudgeError::Cancelled(stop)) if context.is_cancelled() => return Err(stop.into()),
                Err(JudgeError::Cancelled(_)) => {}
            }
        }
        let same = self.converted(format, context)?;
        if same.is_none() {
            self.time.leave_out(LeftOut::Verification);
        }
        Ok(same)
    }

    /// The input's faces in another format, where the written bytes have the very same coordinates, so that all that was measured on
    /// the input is true of them.
    fn converted(&self, format: Format, context: &Context<'_>) -> Result<Option<Judged>, RepairError> {
        let surface = &self.analysis.surface;
        let bytes = format::write(&surface.to_soup(), format)?;
        let read = read_own(&bytes)?;
        let is_same = read.soup.faces.len() == surface.faces.len()
            && (0..surface.faces.len()).all(|face| read.soup.corners(face) == surface.corners(face));
        if !is_same {
            return Ok(None);
        }
        let faces = surface.faces.len() as u64;
        let measures = Measures {
            faces,
            nonfinite_faces: 0,
            unreferenced_vertices: 0,
            unreadable_faces: 0,
            unshared_edges: 0,
            ..self.before.measures.clone()
        };
        Ok(Some(self.unchanged(bytes, read.dialect, measures, context)?))
    }

    /// The input itself as a result.
    fn unchanged(
        &self,
        bytes: Vec<u8>,
        dialect: String,
        measures: Measures,
        context: &Context<'_>,
    ) -> Result<Judged, Cancelled> {
        let changes = self.original.changes(self.analysis, &measures, Some(&[]), context);
        let changes = context.unless_late(changes)?.unwrap_or_else(|| Changes::none(&self.before.measures, &measures));
        Ok(Judged {
            bytes,
            source: Vec::new(),
            dialect,
            changes,
            red_flags: Vec::new(),
            looked: None,
            counts: Some(Inspection { measures: measures.clone(), ..self.before.clone() }),
            measures,
            surface: None,
            ledger: None,
            assumptions: Vec::new(),
            cavities: Vec::new(),
            invented: Invented::default(),
        })
    }

    /// Vertices of which a normal of the file points into the mesh.
    pub fn bad_normals(&self) -> u64 {
        self.before.count(DefectKind::BadVertexNormal)
    }

    /// Looks at a result as at the input: at its own bytes, read back, and at what became of the input. What the input's bytes
    /// say is known already.
    pub fn after(&self, judged: &mut Judged, context: &Context<'_>) -> Result<Inspection, RepairError> {
        if self.bytes == Some(judged.bytes.as_slice()) {
            judged.surface = surface_shares(self.original, self.analysis, context)?;
            return Ok(self.before.clone());
        }
        if let Some(inspection) = judged.looked.take() {
            return Ok(inspection);
        }
        let inspected = || {
            context.check()?;
            let read = read_own(&judged.bytes)?;
            let analysis = Analysis::new(subject(&read, self.analysis.subject.unit), context)?;
            let (inspection, _) = inspect_analysis(&analysis, &InspectOptions::default(), context)?;
            Ok((inspection, surface_shares(self.original, &analysis, context)?))
        };
        match inspected() {
            Ok((inspection, surface)) => {
                judged.surface = surface;
                Ok(inspection)
            }
            Err(RepairError::Cancelled(_)) if !context.is_cancelled() => {
                self.time.leave_out(LeftOut::ResultDetails);
                let counts = judged.counts.take().unwrap_or_else(|| self.before.clone());
                Ok(Inspection { measures: judged.measures.clone(), ..counts })
            }
            Err(error) => Err(error),
        }
    }

    /// What a person should know of the input.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = self.mesh.warnings.clone();
        warnings.extend(self.before.measures.left_out());
        let bad = self.bad_normals();
        if bad > 0 {
            warnings.push(format!(
                "Vertices with a normal that points into the mesh: {bad}. The result is written without the file's normals."
            ));
        }
        let intersections = &self.before.measures.self_intersections;
        if intersections.checked && !intersections.complete {
            warnings.push("so many faces overlap that they were not all counted".to_owned());
        }
        warnings
    }
}

/// A mesh of a file, before it is inspected.
pub(super) struct Source<'a> {
    /// Its bytes, where they may come back as they are.
    pub bytes: Option<&'a [u8]>,
    pub mesh: &'a ReadMesh,
    pub unit: Option<&'a LengthUnit>,
}

/// Inspects a mesh, and repairs it by `repair` as the input that it is.
pub(super) fn inspected<T>(
    source: &Source<'_>,
    options: &Options,
    context: &Context<'_>,
    repair: impl FnOnce(Input<'_>) -> Result<T, RepairError>,
) -> Result<T, RepairError> {
    let began = context.now();
    let &Source { bytes, mesh, unit } = source;
    let analysis = &Analysis::new(subject(mesh, unit), &context.for_verification())?;
    let (before, time) = &inspect_input(analysis, began, context)?;
    let settled = settle_orientation(analysis, &before.measures, options, context)?;
    let settled = analyse_settled(settled.as_ref(), context)?;
    let original = Original::new(analysis, &before.measures, CompareOptions::BRIEF).with_settled(settled.as_ref());
    repair(Input { bytes, mesh, analysis, original: &original, before, time })
}

/// Reads what we have written, however large it is.
pub(super) fn read_own(bytes: &[u8]) -> Result<ReadMesh, ReadError> {
    format::read(bytes, &Limits::NONE)
}

/// Inspects the input. `began` is when the finding of its structure began; what took long then will take long again.
///
/// Where the deadline comes before it is known which faces intersect, the inspection has nothing but counts, and says so.
fn inspect_input(
    analysis: &Analysis<'_>,
    began: Duration,
    context: &Context<'_>,
) -> Result<(Inspection, TimeBudget), Cancelled> {
    let is_measured = context.unless_late(measure_analysis(analysis, context))?.is_some();
    let time = TimeBudget::new(analysis.surface.faces.len(), context.now().saturating_sub(began));
    let (inspection, _) = if is_measured {
        inspect_in_time(
            analysis,
            &InspectOptions { walls_of_printable_only: true, ..InspectOptions::default() },
            &for_details(context),
        )?
    } else {
        time.leave_out(LeftOut::InputVerification);
        inspect_counts(analysis, &context.for_verification())?
    };
    if inspection.level == Level::None {
        time.leave_out(LeftOut::InputDetails);
    }
    Ok((inspection, time))
}

/// Inspects a mesh that was measured. When the deadline has passed, nothing but what results are judged by is there.
pub(super) fn inspect_measured(
    analysis: &Analysis<'_>,
    context: &Context<'_>,
) -> Result<(Inspection, Findings), Cancelled> {
    inspect_in_time(analysis, &InspectOptions::default(), context)
}

fn inspect_in_time(
    analysis: &Analysis<'_>,
    options: &InspectOptions,
    context: &Context<'_>,
) -> Result<(Inspection, Findings), Cancelled> {
    if let Some(whole) = context.unless_late(inspect_analysis(analysis, options, context))? {
        return Ok(whole);
    }
    let verification = &context.for_verification();
    let measures = measure_analysis(analysis, verification)?;
    let (counted, findings) = inspect_counts(analysis, verification)?;
    Ok((Inspection { measures, ..counted }, findings))
}

/// Counts what is counted of every mesh, whatever the time.
pub(super) fn inspect_counts(
    analysis: &Analysis<'_>,
    context: &Context<'_>,
) -> Result<(Inspection, Findings), Cancelled> {
    inspect_analysis(analysis, &InspectOptions { level: Level::None, ..InspectOptions::default() }, context)
}
