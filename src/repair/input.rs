//! The input of a repair: the mesh that was read, its inspection, and its return without changes.

use std::borrow::Cow;
use std::time::Duration;

use super::estimate::estimate;
use super::judge::{
    Cause, Details, JudgeError, Judged, Judging, Patches, inspect_counts, inspect_in_time, read_own, surface_shares,
};
use super::operators::duplicates::remove_duplicates;
use super::operators::orient::Orient;
use super::options::{Nested, Options};
use super::presets::changes_printable;
use super::red_flags::AddedSurface;
use super::remesher::Remesher;
use super::report::OmittedSection;
use super::time_budget::{TimeBudget, for_details};
use crate::analyze::{file_facts, subject_taken};
use crate::context::{Cancelled, Context};
use crate::format::{self, Format, ReadError, ReadMesh, WriteError};
use crate::inspect::{
    Analysis, Changes, CompareOptions, DefectKind, InspectOptions, Inspection, Level, Measures, OptionsError, Original,
    Subject, inspect_analysis, measure_analysis,
};
use crate::mesh::Soup;
use crate::scene::LengthUnit;

/// Why a repair has no result at all. A model that cannot be repaired is not an error: see [`Outcome::Unrepairable`].
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RepairError {
    /// The input cannot be read as a mesh.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// An option is out of range.
    #[error(transparent)]
    Options(#[from] OptionsError),
    /// The job was canceled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// The deadline, in seconds, passed before anything could be returned: not even the input could be verified in the output format.
    #[error(
        "the deadline of {0} s passed before the inspection finished, so there is no result; raise `deadline_s`, or send fewer faces"
    )]
    OutOfTime(f64),
    /// Neither a result nor the input can be written in the output format.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// The written file does not hold the judged model: a program error.
    #[error(
        "the written file does not match the verified model; choose another `output` format, and report this error"
    )]
    Unfaithful,
}

/// A repair request: the options, and the means to follow them.
#[derive(Clone, Copy)]
pub(super) struct RepairRequest<'a> {
    /// The options of the repair.
    pub options: &'a Options,
    /// Blender, if it is available.
    pub remesher: Option<&'a dyn Remesher>,
    /// Progress, cancellation and deadline.
    pub context: &'a Context<'a>,
    /// Whether steps that strategies share run only once. Results do not depend on it.
    pub reuses_prefixes: bool,
}

/// The inspected input of a repair.
pub(super) struct Input<'a> {
    /// The file's bytes, if they may be returned unchanged.
    pub bytes: Option<&'a [u8]>,
    /// The mesh as it was read, possibly without its triangles.
    pub mesh: &'a ReadMesh,
    /// The structure of the mesh.
    pub analysis: &'a Analysis<'a>,
    /// The input in the form that results are compared with.
    pub original: &'a Original<'a>,
    /// The inspection of the input.
    pub before: &'a Inspection,
    /// The division of the repair's time.
    pub time: &'a TimeBudget,
}

impl Input<'_> {
    /// The unchanged input as a result: its own bytes, or its faces in order in the judging format. None if no face can be written, or if
    /// there was no time to verify the written bytes.
    ///
    /// # Errors
    /// [`RepairError`] if the job was canceled, or the faces cannot be written or read back.
    pub fn unchanged_input(
        &self,
        format: Format,
        options: &Options,
        context: &Context<'_>,
    ) -> Result<Option<Judged>, RepairError> {
        let before = &self.before.measures;
        // A file with unreadable faces, or with vertex normals that point into the mesh, is never returned as it is. Writing it again
        // removes both.
        let whole = self.mesh.numbering.as_ref().is_none_or(|numbering| numbering.faces_without_vertex == 0);
        if let Some(bytes) = self.bytes.filter(|_| whole && self.bad_normals() == 0) {
            return Ok(Some(self.as_result(bytes.to_vec(), self.mesh.dialect.clone(), before.clone(), context)?));
        }
        let surface = &self.analysis.surface;
        if surface.faces.is_empty() {
            return Ok(None);
        }
        if self.time.can_verify(surface.faces.len(), context) {
            let start = context.now();
            let judging = Judging { format, input: self.original, options, context };
            match judging.judge(surface, None, Patches::BySource, Cause::default()) {
                Ok(judged) => {
                    self.time.record_verification(surface.faces.len(), context.now().saturating_sub(start));
                    return Ok(Some(judged));
                }
                Err(JudgeError::Write(error)) => return Err(error.into()),
                Err(JudgeError::Read(error)) => return Err(error.into()),
                Err(JudgeError::Cancelled(stop)) if context.is_cancelled() => return Err(stop.into()),
                Err(JudgeError::Cancelled(_)) => {}
            }
        }
        let converted = self.converted(format, context)?;
        if converted.is_none() {
            self.time.omit(OmittedSection::Verification);
        }
        Ok(converted)
    }

    /// The input's faces in another format, if the written bytes have exactly the same coordinates, so that the input's measures hold for
    /// them.
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
        Ok(Some(self.as_result(bytes, read.dialect, measures, context)?))
    }

    /// The input itself as a result.
    fn as_result(
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
            added_surface: AddedSurface::default(),
        })
    }

    /// The number of vertices with a normal in the file that points into the mesh.
    pub fn bad_normals(&self) -> u64 {
        self.before.count(DefectKind::BadVertexNormal)
    }

    /// Inspects a result like the input, on its own bytes, and compares the surfaces. The input's bytes are not inspected again.
    ///
    /// # Errors
    /// [`RepairError`] if the job was canceled or the bytes cannot be read back.
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
            let mut read = read_own(&judged.bytes)?;
            let analysis = Analysis::new(subject_taken(&mut read, self.analysis.facts.unit), context)?;
            let (inspection, _) = inspect_analysis(&analysis, &InspectOptions::default(), context)?;
            Ok((inspection, surface_shares(self.original, &analysis, context)?))
        };
        match inspected() {
            Ok((inspection, surface)) => {
                judged.details.surface = surface;
                Ok(inspection)
            }
            Err(RepairError::Cancelled(_)) if !context.is_cancelled() => {
                self.time.omit(OmittedSection::ResultDetails);
                let counts = judged.details.counts.take().unwrap_or_else(|| self.before.clone());
                Ok(Inspection { measures: judged.measures.clone(), ..counts })
            }
            Err(error) => Err(error),
        }
    }

    /// The warnings about the input.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = self.mesh.warnings.clone();
        warnings.extend(self.before.measures.omitted());
        let bad = self.bad_normals();
        if bad > 0 {
            warnings.push(format!(
                "{bad} vertices have a normal that points into the mesh. The result is written without the file's normals."
            ));
        }
        let intersections = &self.before.measures.self_intersections;
        if intersections.checked && !intersections.complete {
            warnings.push("Too many faces overlap to count them all.".to_owned());
        }
        warnings
    }
}

/// A mesh of a file, before it is inspected.
pub(super) struct MeshSource<'a> {
    /// The file's bytes, if they may be returned unchanged.
    pub bytes: Option<&'a [u8]>,
    /// The triangles, which are dropped if they are owned and as good as welded.
    pub soup: Cow<'a, Soup>,
    /// What else was read.
    pub mesh: &'a ReadMesh,
    /// The unit of the mesh.
    pub unit: Option<&'a LengthUnit>,
}

/// Inspects a mesh and passes it to `repair` as the input.
///
/// # Errors
/// The errors of `repair`, and [`Cancelled`] if the job was canceled or there was no time for the inspection.
pub(super) fn with_inspected_input<T>(
    source: MeshSource<'_>,
    &RepairRequest { options, context, .. }: &RepairRequest<'_>,
    repair: impl FnOnce(Input<'_>) -> Result<T, RepairError>,
) -> Result<T, RepairError> {
    let began = context.now();
    let MeshSource { bytes, soup, mesh, unit } = source;
    let subject = Subject { soup, facts: file_facts(mesh, unit) };
    let analysis = &Analysis::new(subject, &context.for_verification())?;
    let (before, time) = &inspect_input(analysis, began, context)?;
    let keeps_whole = !changes_printable(options) && !options.asks_for_fewer_faces_than(before.measures.faces);
    let is_whole = before.measures.printable() && keeps_whole;
    context.estimate(estimate(&before.measures, is_whole));
    let settled = settle_orientation(analysis, &before.measures, options, context)?;
    let settled = analyse_settled(settled.as_ref(), context)?;
    let original = Original::new(analysis, &before.measures, CompareOptions::BRIEF).with_settled(settled.as_ref());
    repair(Input { bytes, mesh, analysis, original: &original, before, time })
}

/// Inspects the input. `began` is the start of its analysis; the duration predicts how long verifications will take.
///
/// If the deadline passes before the intersecting faces are known, the inspection has only counts, and the omitted sections say so.
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
        time.omit(OmittedSection::InputVerification);
        inspect_counts(analysis, &context.for_verification())?
    };
    if inspection.level == Level::None {
        time.omit(OmittedSection::InputDetails);
    }
    Ok((inspection, time))
}

/// The faces of a closed input as [`Orient`] orients them, to measure the enclosed volume. Inverted parts would count negative otherwise.
///
/// None if no face is flipped, if the input is open and so has no reliable volume, or if the deadline passed.
///
/// # Errors
/// [`Cancelled`] if the job was canceled.
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
    // Duplicate faces enclose nothing and block each other's view of the outside.
    remove_duplicates(&mut surface);
    let oriented =
        Orient { nested: options.nested }.apply_knowing(Some(analysis), &mut surface, &context.for_verification());
    if context.unless_late(oriented)?.is_none() {
        return Ok(None);
    }
    Ok((surface.faces != analysis.surface.faces).then(|| surface.to_soup()))
}

/// The structure of reoriented faces; none if there are none, or if the deadline passed.
///
/// # Errors
/// [`Cancelled`] if the job was canceled.
fn analyse_settled<'a>(soup: Option<&'a Soup>, context: &Context<'_>) -> Result<Option<Analysis<'a>>, Cancelled> {
    let verification = context.for_verification();
    Ok(match soup {
        Some(soup) => context.unless_late(Analysis::new(soup.into(), &verification))?,
        None => None,
    })
}
