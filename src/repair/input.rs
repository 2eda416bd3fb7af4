//! The input of a repair: what was read and inspected, and how it is handed back.

use std::time::Duration;

use super::judge::{
    Details, JudgeError, Judged, Judging, Patches, inspect_counts, inspect_in_time, read_own, surface_shares,
};
use super::operators::duplicates::remove_duplicates;
use super::operators::orient::Orient;
use super::options::{Nested, Options};
use super::red_flags::Invented;
use super::remesher::Remesher;
use super::report::OmittedSection;
use super::time_budget::{TimeBudget, for_details};
use crate::analyze::subject;
use crate::context::{Cancelled, Context};
use crate::format::{self, Format, ReadError, ReadMesh, WriteError};
use crate::inspect::{
    Analysis, Changes, CompareOptions, DefectKind, InspectOptions, Inspection, Level, Measures, OptionsError, Original,
    inspect_analysis, measure_analysis,
};
use crate::mesh::Soup;
use crate::scene::LengthUnit;

/// Why there is no result at all. A model that can't be repaired is no error: see [`Outcome::Unrepairable`].
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RepairError {
    /// The input is not a mesh that can be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// An option is out of range.
    #[error(transparent)]
    Options(#[from] OptionsError),
    /// The job was canceled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// The deadline came before there was anything to hand out: not even the input could be verified in the output's format.
    #[error(
        "the time was over before the model was inspected, so there is no result: deadline_s is {0}; raise it, or send fewer faces"
    )]
    OutOfTime(f64),
    /// Neither a result nor the input can be said in the output format.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// What was written is not what was judged, which would be a mistake of ours.
    #[error("the written file does not hold the model that was judged; ask for another output format, and report this")]
    Unfaithful,
}

/// What is asked for, and by what means.
#[derive(Clone, Copy)]
pub(super) struct Request<'a> {
    pub options: &'a Options,
    pub remesher: Option<&'a dyn Remesher>,
    pub context: &'a Context<'a>,
    /// Whether what strategies have in common runs once. No result depends on it.
    pub reuses_prefixes: bool,
}

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
            let judging = Judging { format, input: self.original, options, context };
            match judging.judge(surface, Patches::BySource, None) {
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
            self.time.leave_out(OmittedSection::Verification);
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
            non_finite_faces: 0,
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
            details: Details {
                counts: Some(Inspection { measures: measures.clone(), ..self.before.clone() }),
                ..Details::default()
            },
            measures,
            part_accounting: None,
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
            judged.details.surface = surface_shares(self.original, self.analysis, context)?;
            return Ok(self.before.clone());
        }
        if let Some(inspection) = judged.details.inspection.take() {
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
                judged.details.surface = surface;
                Ok(inspection)
            }
            Err(RepairError::Cancelled(_)) if !context.is_cancelled() => {
                self.time.leave_out(OmittedSection::ResultDetails);
                let counts = judged.details.counts.take().unwrap_or_else(|| self.before.clone());
                Ok(Inspection { measures: judged.measures.clone(), ..counts })
            }
            Err(error) => Err(error),
        }
    }

    /// What a person should know of the input.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = self.mesh.warnings.clone();
        warnings.extend(self.before.measures.omitted());
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
    &Request { options, context, .. }: &Request<'_>,
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
        time.leave_out(OmittedSection::InputVerification);
        inspect_counts(analysis, &context.for_verification())?
    };
    if inspection.level == Level::None {
        time.leave_out(OmittedSection::InputDetails);
    }
    Ok((inspection, time))
}

/// The faces of a closed input as [`Orient`] winds them, for measuring what it encloses: parts that are inside out would count against
/// the others. None where nothing is turned, or the input is open, so that its volume says nothing anyway, or where
/// the time was over.
///
/// # Errors
/// [`Cancelled`] when the job was canceled.
fn settle_orientation(
    analysis: &Analysis<'_>,
    before: &Measures,
    options: &Options,
    context: &Context<'_>,
) -> Result<Option<Soup>, Cancelled> {
    let outward = before.consistent && before.inverted_parts == 0 && before.volume.value > 0.0;
    if !before.closed || (outward && options.nested == Nested::Keep) {
        return Ok(None);
    }
    let mut surface = analysis.surface.clone();
    // Faces that are there twice enclose nothing, and hide from each other what is around them.
    remove_duplicates(&mut surface);
    let oriented = Orient { nested: options.nested }.apply(&mut surface, &context.for_verification());
    if context.unless_late(oriented)?.is_none() {
        return Ok(None);
    }
    Ok((surface.faces != analysis.surface.faces).then(|| surface.to_soup()))
}

/// The structure of settled faces; none where there are none, or where the time was over.
///
/// # Errors
/// [`Cancelled`] when the job was canceled.
fn analyse_settled<'a>(soup: Option<&'a Soup>, context: &Context<'_>) -> Result<Option<Analysis<'a>>, Cancelled> {
    let verification = context.for_verification();
    Ok(match soup {
        Some(soup) => context.unless_late(Analysis::new(soup.into(), &verification))?,
        None => None,
    })
}
