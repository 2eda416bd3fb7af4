//! Analysis of one or more files: reads and inspects each file, and combines the results in one report.
//!
//! [`Analyst`] is the entry point. Add the files one by one, then finish with an [`AnalysisReport`]. The report has
//! one [`Inspection`](crate::inspect::Inspection) per file, of the same structure as in a repair report.

use std::borrow::Cow;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::context::{Cancelled, Context, Stage};
use crate::format::{self, Format, Limits, ReadError, ReadMesh, ReadOptions};
use crate::inspect::{
    Analysis, FileFacts, InspectOptions, Inspection, OptionsError, SetReport, Subject, changed_fields, inspect,
    inspect_analysis,
};
use crate::mesh::Soup;
use crate::printing::profile::{ProcessLimits, checked_profile};
use crate::printing::readiness::{AssessedFile, PrintReadiness, assess};
use crate::printing::unit_candidates::{FileEvidence, UnitCandidates, units_in_doubt};
use crate::render::{Drawing, Marked, RenderError, draw_inspected, names_of_inspection};
use crate::scene::{LengthUnit, Unit, UnitSource};

/// Options of an analysis. Every field has a default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct AnalyzeOptions {
    /// Time limit in seconds for the analysis of all files, from 1 to 3600. The job fails when the limit is exceeded.
    #[cfg_attr(feature = "openapi", schema(minimum = 1.0, maximum = 3600.0))]
    pub deadline_s: f64,
    /// Whether to count intersecting faces between each two files.
    pub intersections: bool,
    /// Whether to measure the distance from each vertex to the nearest surface of another file.
    pub spacing: bool,
    /// Whether to provide pictures of the defects: `defects.png`, `defects.glb` and `defects.ply` for the first file,
    /// `2-defects.png` and so on for the others. The first request for one of them renders all.
    pub pictures: bool,
    /// Unit to which all lengths are converted; by default lengths keep the file's unit. Lengths among these options
    /// are in this unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale_to: Option<Unit>,
    /// Printing process to check each file against, such as `fdm-0.4` or `sls-pa12`. The report's `print_ready` has the
    /// result for each rule.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub process: Option<String>,
    /// Limits that replace those of the process's profile. Absent limits stay as they are.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub process_limits: Option<ProcessLimits>,
    /// Options of the inspection of each file.
    #[serde(flatten)]
    pub inspect: InspectOptions,
}

impl Default for AnalyzeOptions {
    fn default() -> Self {
        Self {
            deadline_s: 300.0,
            intersections: true,
            spacing: true,
            pictures: true,
            scale_to: None,
            process: None,
            process_limits: None,
            inspect: InspectOptions::default(),
        }
    }
}

impl AnalyzeOptions {
    /// Serializes the options that differ from their defaults as a JSON object.
    #[must_use]
    pub fn to_changed_fields(&self) -> Map<String, Value> {
        changed_fields(self, &Self::default())
    }

    /// Checks that every option is in its range.
    ///
    /// # Errors
    /// [`OptionsError`] for the first option out of range.
    pub fn validate(&self) -> Result<(), OptionsError> {
        let seconds = "from 1 to 3600 seconds";
        OptionsError::unless_within("deadline_s", self.deadline_s, (1.0, 3600.0), seconds)?;
        checked_profile(self.process.as_deref(), self.process_limits.as_ref())?;
        self.inspect.validate()
    }
}

/// Version of the structure of [`AnalysisReport`]. Version 2 adds the unit of each file. Version 3 adds `abridged`,
/// and makes histograms of `set` optional.
pub const ANALYSIS_VERSION: u32 = 3;

/// Report of one analysis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct AnalysisReport {
    /// Version of this structure.
    pub version: u32,
    /// Whether the report is shortened: lists have only their first items, and statistics and histograms are omitted.
    /// Counts are always complete.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub abridged: bool,
    /// Name and version of the engine.
    pub engine: String,
    /// The effective options.
    pub options: AnalyzeOptions,
    /// Whether every file is printable. `null` if no file is known to be unprintable, but the inspection of at least
    /// one file was not complete enough to decide.
    pub printable: Option<bool>,
    /// Results for each file, in the order of the request.
    pub files: Vec<FileAnalysis>,
    /// Measurements between the files; absent if there is only one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub set: Option<SetReport>,
    /// Time from reading the first file to the end, in milliseconds.
    pub milliseconds: f64,
}

impl AnalysisReport {
    /// Shortens every list except the list of files to its first `most` items. Removes statistics and histograms.
    pub fn abridge(&mut self, most: usize) {
        self.abridged = true;
        for file in &mut self.files {
            file.inspection.abridge(most);
            file.print_ready.iter_mut().for_each(|readiness| readiness.abridge(most));
        }
        self.set.iter_mut().for_each(|set| set.abridge(most));
    }
}

/// Analysis of one file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct FileAnalysis {
    /// Name of the file in the request.
    pub name: String,
    /// File format.
    pub format: Format,
    /// Description of the format's variant, such as `binary STL`.
    pub dialect: String,
    /// Size of the file, in bytes.
    pub bytes: u64,
    /// SHA-256 of the file, in hexadecimal; absent if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
    /// Unit of all lengths reported for the file.
    pub unit: LengthUnit,
    /// Whether the file is printable as it is; `null` if its inspection level does not decide.
    pub printable: Option<bool>,
    /// Inspection of the file, of the same structure as `before` and `after` of a repair report.
    pub inspection: Inspection,
    /// The units that the file may have, if its unit is in doubt; absent if the unit is plausible.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit_candidates: Option<UnitCandidates>,
    /// Whether the file meets each rule of the process; absent without the option `process`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub print_ready: Option<PrintReadiness>,
    /// Warnings for the sender of the file.
    pub warnings: Vec<String>,
}

impl FileAnalysis {
    /// Names of the drawings that [`draw`] makes of the file.
    #[must_use]
    pub fn drawings(&self) -> Vec<&'static str> {
        names_of_inspection(self.inspection.measures.faces)
    }
}

/// Why an analysis failed. Defects of a model are results, not errors.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum AnalyzeError {
    /// A file is not a readable mesh.
    #[error("{}{error}", file_prefix(*.index, name, *.of))]
    Read {
        /// Position of the file in the request, from 0.
        index: usize,
        /// Name of the file.
        name: String,
        /// Number of files in the request.
        of: usize,
        /// What is wrong with the file.
        error: ReadError,
    },
    /// An option is out of range.
    #[error(transparent)]
    Options(#[from] OptionsError),
    /// The analysis was cancelled or exceeded its time limit.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// Prefix of a message that names the file, if the request has several.
fn file_prefix(index: usize, name: &str, of: usize) -> String {
    if of > 1 { format!("file {} of {of}, '{name}': ", index + 1) } else { String::new() }
}

/// Analyses files one by one, then measures between them.
pub struct Analyst<'a> {
    options: &'a AnalyzeOptions,
    limits: &'a Limits,
    context: Context<'a>,
    start: Duration,
    of: usize,
    files: Vec<FileAnalysis>,
    meshes: Vec<Soup>,
    evidence: Vec<FileEvidence>,
}

impl<'a> Analyst<'a> {
    /// Starts an analysis of `of` files. The time limit runs from this call.
    ///
    /// # Errors
    /// [`AnalyzeError::Options`] if an option is out of range.
    pub fn new(
        options: &'a AnalyzeOptions,
        limits: &'a Limits,
        of: usize,
        context: &Context<'a>,
    ) -> Result<Self, AnalyzeError> {
        options.validate()?;
        let context = context.limited_to(Duration::from_secs_f64(options.deadline_s));
        let start = context.now();
        let (files, meshes, evidence) = (Vec::with_capacity(of), Vec::with_capacity(of), Vec::with_capacity(of));
        Ok(Self { options, limits, context, start, of, files, meshes, evidence })
    }

    /// Reads and inspects a file.
    ///
    /// # Errors
    /// [`AnalyzeError::Read`], with the file's name if there are several files, or [`AnalyzeError::Cancelled`].
    pub fn add(&mut self, name: &str, sha256: Option<&str>, bytes: &[u8]) -> Result<(), AnalyzeError> {
        let index = self.files.len();
        self.report(Stage::Read, 0);
        let read = read(bytes, self.options, self.limits);
        let (mesh, unit) =
            read.map_err(|error| AnalyzeError::Read { index, name: name.to_owned(), of: self.of, error })?;
        self.report(Stage::Inspect, 20);
        let analysis = Analysis::new(subject(&mesh, Some(&unit)), &self.context)?;
        let (inspection, _) = inspect_analysis(&analysis, &self.options.inspect, &self.context)?;
        let print_ready = self.assess(&analysis, &inspection, bytes.len())?;
        self.evidence.push(FileEvidence::of(&analysis, &unit, format::program_of(bytes, mesh.format)));
        drop(analysis);
        let measures = &inspection.measures;
        let warnings = mesh.warnings.iter().cloned().chain(measures.omitted()).collect();
        self.context.log(&format!("{}{}: {}", file_prefix(index, name, self.of), mesh.dialect, measures.in_short()));
        self.files.push(FileAnalysis {
            name: name.to_owned(),
            format: mesh.format,
            dialect: mesh.dialect.clone(),
            bytes: bytes.len() as u64,
            sha256: sha256.map(str::to_owned),
            unit,
            printable: measures.verdict(),
            inspection,
            unit_candidates: None,
            print_ready,
            warnings,
        });
        self.meshes.push(mesh.soup);
        Ok(())
    }

    /// Assesses a file against the process, if the options name one.
    fn assess(
        &self,
        analysis: &Analysis<'_>,
        inspection: &Inspection,
        bytes: usize,
    ) -> Result<Option<PrintReadiness>, Cancelled> {
        let Ok(Some(profile)) = checked_profile(self.options.process.as_deref(), self.options.process_limits.as_ref())
        else {
            return Ok(None);
        };
        let file = AssessedFile { analysis, measures: &inspection.measures, bytes: bytes as u64, lost_unit: false };
        assess(file, &profile, &self.context).map(Some)
    }

    /// Returns the report of all added files and of the measurements between them.
    ///
    /// # Errors
    /// [`AnalyzeError::Cancelled`].
    pub fn finish(mut self) -> Result<AnalysisReport, AnalyzeError> {
        self.rank_units();
        let meshes: Vec<_> = self.meshes.iter().collect();
        let (intersections, spacing) = (self.options.intersections, self.options.spacing);
        let set = SetReport::of(&meshes, intersections, spacing, &self.context)?;
        let verdicts = || self.files.iter().map(|file| file.printable);
        let printable = if verdicts().any(|verdict| verdict == Some(false)) {
            Some(false)
        } else {
            verdicts().collect::<Option<Vec<_>>>().map(|_| true)
        };
        self.context.report(Stage::Finish, None, 100);
        Ok(AnalysisReport {
            version: ANALYSIS_VERSION,
            abridged: false,
            engine: crate::ENGINE.to_owned(),
            options: self.options.clone(),
            printable,
            files: self.files,
            set,
            milliseconds: self.context.now().saturating_sub(self.start).as_secs_f64() * 1e3,
        })
    }

    /// Ranks the units of each file whose unit is in doubt. Units that other files state are evidence too.
    fn rank_units(&mut self) {
        let units: Vec<LengthUnit> = self.files.iter().map(|file| file.unit.clone()).collect();
        for (number, (file, evidence)) in self.files.iter_mut().zip(&mut self.evidence).enumerate() {
            let others = units.iter().enumerate().filter(|&(other, _)| other != number).map(|(_, unit)| unit);
            evidence.siblings = agreed_unit(others);
            file.unit_candidates = units_in_doubt(&file.inspection, &file.unit, evidence, None);
        }
    }

    /// Reports overall progress when `percent` of the current file is done. All files count the same, since file size
    /// hardly predicts the time.
    fn report(&self, stage: Stage, percent: usize) {
        let done = (self.files.len() * 100 + percent) / self.of.max(1);
        self.context.report(stage, None, u8::try_from(done.min(99)).unwrap_or(99));
    }
}

/// The unit that files state, if all that state one agree.
fn agreed_unit<'a>(units: impl Iterator<Item = &'a LengthUnit>) -> Option<Unit> {
    let mut stated = units.filter(|unit| unit.source != UnitSource::Assumed).map(|unit| unit.used);
    let first = stated.next()?;
    stated.all(|unit| unit == first).then_some(first)
}

/// Reads a file and converts its lengths to the unit of the options.
fn read(bytes: &[u8], options: &AnalyzeOptions, limits: &Limits) -> Result<(ReadMesh, LengthUnit), ReadError> {
    let mut file = format::read_shape(bytes, &ReadOptions::within(*limits))?;
    let unit = file.settle_unit(options.inspect.unit, options.scale_to);
    Ok((file.mesh, unit))
}

/// Collects the parts of a read file that an analysis needs, with its settled unit.
pub fn subject<'a>(mesh: &'a ReadMesh, unit: Option<&'a LengthUnit>) -> Subject<'a> {
    Subject { soup: Cow::Borrowed(&mesh.soup), facts: file_facts(mesh, unit) }
}

/// Like [`subject`], but takes the mesh's triangles, so that the analysis may drop them.
pub fn subject_taken<'a>(mesh: &'a mut ReadMesh, unit: Option<&'a LengthUnit>) -> Subject<'a> {
    let soup = Cow::Owned(std::mem::take(&mut mesh.soup));
    Subject { soup, facts: file_facts(mesh, unit) }
}

/// What is known of a read mesh besides its triangles, with its settled unit.
pub fn file_facts<'a>(mesh: &'a ReadMesh, unit: Option<&'a LengthUnit>) -> FileFacts<'a> {
    FileFacts {
        normals: mesh.normals.as_ref(),
        numbering: mesh.numbering.as_ref(),
        materials: mesh.materials.as_deref(),
        stored_vertices: mesh.stored_vertices,
        is_indexed: mesh.format.is_indexed(),
        unit,
    }
}

/// Why a file could not be drawn.
#[derive(Debug, thiserror::Error)]
pub enum DrawError {
    /// The file is not readable, although its inspection succeeded before.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// Drawing was cancelled or exceeded its time limit.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// Rendering failed.
    #[error(transparent)]
    Render(#[from] RenderError),
}

/// Draws the defects of a file. Repeats the inspection, so it may take as long as the analysis.
///
/// # Errors
/// [`DrawError`].
pub fn draw(
    bytes: &[u8],
    options: &AnalyzeOptions,
    limits: &Limits,
    context: &Context<'_>,
) -> Result<Vec<Drawing>, DrawError> {
    let context = &context.limited_to(Duration::from_secs_f64(options.deadline_s));
    let (mesh, unit) = read(bytes, options, limits)?;
    let (_, findings) = inspect(subject(&mesh, Some(&unit)), &options.inspect, context)?;
    Ok(draw_inspected(Marked { soup: &mesh.soup, findings: &findings }, context)?)
}
