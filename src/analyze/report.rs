use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::AnalyzeOptions;
use crate::format::Format;
use crate::inspect::{Inspection, SetReport};
use crate::render::names_of_inspection;
use crate::scene::LengthUnit;

/// The version of [`AnalysisReport`]'s structure. 2: adds the unit of each file. 3: adds `abridged`, and histograms of `set` may be left out.
pub const ANALYSIS_VERSION: u32 = 3;

/// The account of one analysis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
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
    /// The names of the drawings that [`draw`](super::draw) makes of the file.
    #[must_use]
    pub fn drawings(&self) -> Vec<&'static str> {
        names_of_inspection(self.inspection.measures.faces)
    }
}
