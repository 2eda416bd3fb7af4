//! Shared state of the defect searches, with conversion of lengths and reporting of defects.

use glam::DVec3;

use super::super::options::ToleranceLengths;
use super::super::{Analysis, Defect, DefectKind, Findings, Tolerances};
use crate::context::{Cancelled, Context};
use crate::math::Box3;

/// Maximum number of faces that one defect lists. All affected faces are marked.
const MOST_FACES: usize = 1000;
/// Upper bound on lengths that result from rounding alone, on the unit scale.
pub(super) const ROUNDING: f64 = 1e-13;
/// Number of loop iterations between two cancellation checks.
const STRIDE: usize = 4096;

/// Shared input and output of all searches. Searches measure lengths on the scale of [`Analysis::unit`], where
/// squares of coordinates neither overflow nor underflow, and report them in the model's unit.
pub(super) struct Scan<'a, 'm> {
    /// The analysed mesh.
    pub analysis: &'a Analysis<'m>,
    /// Positions on the unit scale.
    pub unit: &'a [DVec3],
    /// Tolerances on the unit scale.
    pub lengths: ToleranceLengths,
    context: &'a Context<'a>,
    findings: &'a mut Findings,
    /// Factor from the unit scale to the model's unit.
    scale: f64,
}

impl<'a, 'm> Scan<'a, 'm> {
    /// Prepares the searches on a mesh.
    pub fn new(
        analysis: &'a Analysis<'m>,
        tolerances: &Tolerances,
        findings: &'a mut Findings,
        context: &'a Context<'a>,
    ) -> Self {
        let unit = analysis.unit();
        let largest = |points: &[DVec3]| points.iter().fold(0.0f64, |m, p| m.max(p.abs().max_element()));
        let scale = largest(&analysis.surface.positions) / largest(unit);
        let scale = if scale > 0.0 && scale.is_finite() { scale } else { 1.0 };
        let diagonal = Box3::of(unit.iter().copied()).diagonal();
        let lengths = tolerances.lengths(diagonal, scale);
        Self { analysis, unit, lengths, context, findings, scale }
    }

    /// Checks for cancellation in every [`STRIDE`]th iteration.
    pub fn step(&self, number: usize) -> Result<(), Cancelled> {
        if number.is_multiple_of(STRIDE) { self.context.check() } else { Ok(()) }
    }

    /// Context for cancellation checks.
    pub fn context(&self) -> &'a Context<'a> {
        self.context
    }

    /// Converts a length from the unit scale to the model's unit, clamped to finite numbers as JSON requires.
    pub fn in_model_unit(&self, length: f64) -> f64 {
        (length * self.scale).clamp(f64::MIN, f64::MAX)
    }

    /// Converts a length above 0, keeping the result above 0. A value of 0 is reserved for exact coincidence.
    pub fn in_model_unit_above_zero(&self, length: f64) -> f64 {
        self.in_model_unit(length).max(f64::MIN_POSITIVE)
    }

    /// Centroid of a face, in the model's unit.
    pub fn middle(&self, face: u32) -> DVec3 {
        self.analysis.surface.corners(face as usize).into_iter().map(|p| p / 3.0).sum()
    }

    /// Positions of vertices, in the model's unit.
    pub fn points(&self, vertices: impl IntoIterator<Item = u32>) -> Vec<DVec3> {
        vertices.into_iter().map(|v| self.analysis.surface.positions[v as usize]).collect()
    }

    /// Records that the search for a kind stopped early.
    pub fn mark_incomplete(&mut self, kind: DefectKind) {
        self.findings.mark_incomplete(kind);
    }

    /// Counts defects whose places are unknown.
    pub fn count_more(&mut self, kind: DefectKind, count: u64) {
        self.findings.count_more(kind, count);
    }

    /// Adds a defect whose faces are indices into the surface.
    pub fn report<'l>(
        &mut self,
        kind: DefectKind,
        location: impl Into<Location<'l>>,
        faces: impl IntoIterator<Item = u32>,
        value: Option<f64>,
    ) {
        let source = &self.analysis.surface.source;
        self.report_in_file(kind, location, faces.into_iter().map(|f| source[f as usize]).collect(), value);
    }

    /// Adds a defect whose faces are indices into the file.
    pub fn report_in_file<'l>(
        &mut self,
        kind: DefectKind,
        location: impl Into<Location<'l>>,
        mut faces: Vec<u32>,
        value: Option<f64>,
    ) {
        faces.sort_unstable();
        faces.dedup();
        self.findings.mark(kind, &faces);
        faces.truncate(MOST_FACES);
        let Location { at, line } = location.into();
        let line = line.iter().map(|p| p.to_array()).collect();
        self.findings.push(kind, Defect { at: at.to_array(), faces, line, value, meeting: None });
    }
}

/// Place of a defect in the model's unit: a point, and the points of its line if it has one.
pub(super) struct Location<'l> {
    /// A point of the defect.
    pub at: DVec3,
    /// Points along the defect's edges; empty for a face or a vertex.
    pub line: &'l [DVec3],
}

impl From<DVec3> for Location<'_> {
    fn from(at: DVec3) -> Self {
        Self { at, line: &[] }
    }
}
