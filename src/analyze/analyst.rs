use std::time::Duration;

use super::{ANALYSIS_VERSION, AnalysisReport, AnalyzeOptions, FileAnalysis};
use crate::context::{Cancelled, Context, Stage};
use crate::format::{self, Limits, ReadError, ReadMesh, ReadOptions};
use crate::inspect::{OptionsError, SetReport, Subject, inspect};
use crate::mesh::Soup;
use crate::render::{Drawing, Marked, RenderError, draw_inspected};
use crate::scene::LengthUnit;

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
        let warnings = mesh.warnings.iter().cloned().chain(measures.left_out()).collect();
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
