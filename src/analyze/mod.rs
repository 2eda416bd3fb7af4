//! Analysis of files: read each, look at it, and say everything in one report.
//!
//! [`Analyst`] is the way in: one file after the other is added, and the end is an [`AnalysisReport`]. What is said of
//! each file is the same [`Inspection`](crate::inspect::Inspection) that a repair reports before and after.

use std::time::Duration;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::context::{Cancelled, Context, Stage};
use crate::format::{self, Format, Limits, ReadError, ReadMesh, ReadOptions};
use crate::inspect::{InspectOptions, Inspection, OptionsError, SetReport, Subject, changed_fields, inspect};
use crate::mesh::Soup;
use crate::render::{Drawing, Marked, RenderError, draw_inspected, names_of_inspection};
use crate::scene::{LengthUnit, Unit};

/// How files are to be analysed. Every field has a default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(default)]
pub struct AnalyzeOptions {
    /// Seconds the analysis of all files may take from its start; then the job fails.
    #[cfg_attr(feature = "openapi", schema(minimum = 1.0, maximum = 3600.0))]
    pub deadline_s: f64,
    /// Whether to count the faces of each file that intersect those of another.
    pub intersections: bool,
    /// Whether to measure the distance from each vertex to the nearest surface of another file.
    pub spacing: bool,
    /// Whether what was found can be had as pictures: `defects.png`, `defects.glb` and `defects.ply` for the first file, `2-defects.png`
    /// and so on for the others. They are drawn when somebody asks for one of them first.
    pub pictures: bool,
    /// The unit that lengths are brought into; without it they stay as they are. Lengths among these options are in it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale_to: Option<Unit>,
    /// What to look for, and how.
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
            inspect: InspectOptions::default(),
        }
    }
}

impl AnalyzeOptions {
    /// The options that differ from their defaults, as JSON.
    #[must_use]
    pub fn to_changed_fields(&self) -> Map<String, Value> {
        changed_fields(self, &Self::default())
    }

    /// Checks every range.
    ///
    /// # Errors
    /// The first option that is out of its range.
    pub fn validate(&self) -> Result<(), OptionsError> {
        let seconds = "between 1 and 3600 seconds";
        OptionsError::unless_within("deadline_s", self.deadline_s, (1.0, 3600.0), seconds)?;
        self.inspect.validate()
    }
}

/// The version of [`AnalysisReport`]'s structure. 2: adds the unit of each file. 3: adds `abridged`, and histograms of `set` may be left out.
pub const ANALYSIS_VERSION: u32 = 3;

/// The account of one analysis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct AnalysisReport {
    /// Version of this structure.
    pub version: u32,
    /// Whether lists are shortened to their first items, and statistics and histograms are left out. Counts are always of everything.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub abridged: bool,
    /// Name and version of the engine.
    pub engine: String,
    /// The options that were in force.
    pub options: AnalyzeOptions,
    /// Whether every file is printable; none where nothing is wrong that was looked for, but not all was looked for.
    pub printable: Option<bool>,
    /// What was found in each file, in the order they were sent.
    pub files: Vec<FileAnalysis>,
    /// What was measured between the files; none where there is only one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub set: Option<SetReport>,
    /// Time from the first file's first byte to the end, in milliseconds.
    pub milliseconds: f64,
}

impl AnalysisReport {
    /// Shortens each list but that of the files to its first `most` items, and leaves out statistics and histograms.
    pub fn abridge(&mut self, most: usize) {
        self.abridged = true;
        self.files.iter_mut().for_each(|file| file.inspection.abridge(most));
        self.set.iter_mut().for_each(|set| set.abridge(most));
    }
}

/// What was found in one file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct FileAnalysis {
    /// The name it was sent with.
    pub name: String,
    /// Its format.
    pub format: Format,
    /// The dialect in words, such as `binary STL`.
    pub dialect: String,
    /// Its size.
    pub bytes: u64,
    /// SHA-256 of its bytes, in hexadecimal, where it is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
    /// The unit of every length that is told of it.
    pub unit: LengthUnit,
    /// Whether it can be printed as it is, as far as its level of inspection tells.
    pub printable: Option<bool>,
    /// Everything that was found, in the same structure as `before` and `after` of a repair report.
    pub inspection: Inspection,
    /// What a person should know.
    pub warnings: Vec<String>,
}

impl FileAnalysis {
    /// The names of the drawings that [`draw`] makes of the file.
    #[must_use]
    pub fn drawings(&self) -> Vec<&'static str> {
        names_of_inspection(self.inspection.measures.faces)
    }
}

/// Why there is no analysis. A model with defects is no error.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum AnalyzeError {
    /// A file is not a mesh that can be read.
    #[error("{}{error}", naming(*.index, name, *.of))]
    Read {
        /// Which file, counted from 0.
        index: usize,
        /// Its name.
        name: String,
        /// How many files there are.
        of: usize,
        /// What is wrong with it.
        error: ReadError,
    },
    /// An option is out of range.
    #[error(transparent)]
    Options(#[from] OptionsError),
    /// The work was asked to stop, or its time ran out.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// Of several files, the one that is spoken of.
fn naming(index: usize, name: &str, of: usize) -> String {
    if of > 1 { format!("file {} of {of}, '{name}': ", index + 1) } else { String::new() }
}

/// Looks at one file after the other, and then at all together.
pub struct Analyst<'a> {
    options: &'a AnalyzeOptions,
    limits: &'a Limits,
    context: Context<'a>,
    start: Duration,
    of: usize,
    files: Vec<FileAnalysis>,
    meshes: Vec<Soup>,
}

impl<'a> Analyst<'a> {
    /// Begins an analysis of `of` files. The deadline of the options runs from here.
    ///
    /// # Errors
    /// [`AnalyzeError::Options`].
    pub fn new(
        options: &'a AnalyzeOptions,
        limits: &'a Limits,
        of: usize,
        context: &Context<'a>,
    ) -> Result<Self, AnalyzeError> {
        options.validate()?;
        let context = context.limited_to(Duration::from_secs_f64(options.deadline_s));
        let start = context.now();
        Ok(Self { options, limits, context, start, of, files: Vec::with_capacity(of), meshes: Vec::with_capacity(of) })
    }

    /// Reads a file and looks at it.
    ///
    /// # Errors
    /// [`AnalyzeError::Read`], which names the file where there are several, or [`AnalyzeError::Cancelled`].
    pub fn add(&mut self, name: &str, sha256: Option<&str>, bytes: &[u8]) -> Result<(), AnalyzeError> {
        let index = self.files.len();
        self.report(Stage::Read, 0);
        let read = read(bytes, self.options, self.limits);
        let (mesh, unit) =
            read.map_err(|error| AnalyzeError::Read { index, name: name.to_owned(), of: self.of, error })?;
        self.report(Stage::Inspect, 20);
        let (inspection, _) = inspect(subject(&mesh, Some(&unit)), &self.options.inspect, &self.context)?;
        let measures = &inspection.measures;
        let warnings = mesh.warnings.iter().cloned().chain(measures.omitted()).collect();
        self.context.log(&format!("{}{}: {}", naming(index, name, self.of), mesh.dialect, measures.in_short()));
        self.files.push(FileAnalysis {
            name: name.to_owned(),
            format: mesh.format,
            dialect: mesh.dialect.clone(),
            bytes: bytes.len() as u64,
            sha256: sha256.map(str::to_owned),
            unit,
            printable: measures.verdict(),
            inspection,
            warnings,
        });
        self.meshes.push(mesh.soup);
        Ok(())
    }

    /// The account of all files that were added, and of what is between them.
    ///
    /// # Errors
    /// [`AnalyzeError::Cancelled`].
    pub fn finish(self) -> Result<AnalysisReport, AnalyzeError> {
        let meshes: Vec<_> = self.meshes.iter().collect();
        let (intersections, spacing) = (self.options.intersections, self.options.spacing);
        let set = SetReport::of(&meshes, intersections, spacing, &self.context)?;
        let verdicts = || self.files.iter().map(|file| file.printable);
        let printable = if verdicts().any(|it| it == Some(false)) {
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

    /// Tells how far the whole is when `percent` of the present file is done; a file's size says little about its time,
    /// so all count the same.
    fn report(&self, stage: Stage, percent: usize) {
        let done = (self.files.len() * 100 + percent) / self.of.max(1);
        self.context.report(stage, None, u8::try_from(done.min(99)).unwrap_or(99));
    }
}

/// Reads a file, with its lengths in the unit that the options say.
fn read(bytes: &[u8], options: &AnalyzeOptions, limits: &Limits) -> Result<(ReadMesh, LengthUnit), ReadError> {
    let mut file = format::read_shape(bytes, &ReadOptions::within(*limits))?;
    let unit = file.settle_unit(options.inspect.unit, options.scale_to);
    Ok((file.mesh, unit))
}

/// All that a file says of its mesh, with lengths in a unit.
pub fn subject<'a>(mesh: &'a ReadMesh, unit: Option<&'a LengthUnit>) -> Subject<'a> {
    Subject {
        soup: &mesh.soup,
        normals: mesh.normals.as_ref(),
        numbering: mesh.numbering.as_ref(),
        materials: mesh.materials.as_deref(),
        is_indexed: mesh.format.is_indexed(),
        unit,
    }
}

/// Why a file could not be drawn.
#[derive(Debug, thiserror::Error)]
pub enum DrawError {
    /// It can't be read, though it could be when it was inspected.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The work was asked to stop, or its time ran out.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// The drawing itself.
    #[error(transparent)]
    Render(#[from] RenderError),
}

/// Draws what is found on a file. It may take as long as the analysis.
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
