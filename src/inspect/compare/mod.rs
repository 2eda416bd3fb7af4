//! Comparison of two meshes: counts, sizes, surface deviation, enclosed volume, and provenance of surface and parts.

mod changes;
mod deviation;
mod original;
mod part_accounting;
mod probes;
mod provenance;

use serde::{Deserialize, Serialize};

use super::analysis::Pair;
use super::{Analysis, Measures, measures, percent};
use crate::context::{Cancelled, Context};
use changes::MIN_INSIDE_POINTS;
use deviation::{INSIDE_WINDING, Measured, inside_agreement};

pub use changes::{Changes, ComparedMesh};
pub use deviation::{Deviation, InsideAgreement, Spread};
pub use original::{CompareOptions, Original};
pub use part_accounting::{AccountedPart, LostPart, PartAccounting, PartReason};
pub use provenance::{Provenance, SurfaceProvenance, SurfaceShare, SurfaceShares};

/// Version of the structure of [`Comparison`].
pub const COMPARISON_VERSION: u32 = 1;

/// Percentage of the input's inside that a faithful result must keep.
const INSIDE_KEPT_PCT: f64 = 50.0;

/// Comparison of two meshes, `before` and `after`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Comparison {
    /// Version of this structure.
    pub version: u32,
    /// Whether the second mesh keeps the first's shape. At least 99 % of the surface visible from outside has the
    /// second mesh within 0.5 % of the diagonal. No side of the bounding box moved by more than 1 % of the diagonal.
    /// The second mesh encloses at least half of what the first encloses, by winding number.
    pub faithful: bool,
    /// The figures that a repair report also has.
    #[serde(flatten)]
    pub changes: Changes,
    /// Share of the first mesh's surface that is visible from outside, in percent; `null` if the surfaces coincide,
    /// which makes the visibility test unnecessary.
    pub visible_pct: Option<f64>,
    /// Distance from the first mesh's whole surface, visible or hidden, to the second mesh.
    pub deviation: Option<Deviation>,
    /// Whether both meshes enclose the same points.
    pub inside: Option<InsideAgreement>,
}

/// Compares `before` with `after`. The result does not depend on the number of threads.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn compare(
    before: &Analysis<'_>,
    after: &Analysis<'_>,
    options: CompareOptions,
    context: &Context<'_>,
) -> Result<Comparison, Cancelled> {
    let (before_measures, after_measures) = (measures(before, context)?, measures(after, context)?);
    Original::new(before, &before_measures, options).compare(after, &after_measures, context)
}

impl Original<'_> {
    /// Compares this mesh with another one and returns the complete comparison.
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    pub fn compare(
        &self,
        after: &Analysis<'_>,
        measures: &Measures,
        context: &Context<'_>,
    ) -> Result<Comparison, Cancelled> {
        let candidate = ComparedMesh { analysis: after, measures, patches: None, gone: &[], opaque: &Vec::new };
        let (mut changes, distances) = self.changes_and_distances(&candidate, context)?;
        changes.surface = Some(self.surface_shares(after, context)?);
        let apart = distances.samples.iter().any(|&distance| distance != Some(0.0));
        let all: Vec<usize> = if apart { (0..self.samples().len()).collect() } else { Vec::new() };
        let known: Vec<bool> = self.visible(&all, context)?.into_iter().flatten().collect();
        let visible_pct = percent(known.iter().filter(|&&seen| seen).count() as f64, known.len() as f64);
        let inside = inside_agreement(Pair::new(self.analysis, after), INSIDE_WINDING, self.options.inside, context)?;
        let keeps_inside = inside
            .filter(|agreement| agreement.inside_before >= MIN_INSIDE_POINTS)
            .and_then(|agreement| agreement.kept_pct())
            .is_none_or(|kept| kept >= INSIDE_KEPT_PCT);
        let diagonal = self.analysis.unit_diagonal();
        let measured = Measured { analysis: self.analysis, samples: self.samples(), distances: &distances, diagonal };
        Ok(Comparison {
            version: COMPARISON_VERSION,
            faithful: keeps_inside && changes.keeps_visible_surface(),
            changes,
            visible_pct,
            deviation: measured.deviation(|_| true, |_| true),
            inside,
        })
    }
}
