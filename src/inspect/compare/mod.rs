//! What changed from one mesh to another: counts, sizes, how far the surfaces are apart, and what is inside.

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
use changes::LEAST_INSIDE;
use deviation::{INSIDE_WINDING, Measured, inside_agreement};

pub use changes::{Changes, ComparedMesh};
pub use deviation::{Deviation, InsideAgreement, Spread};
pub use original::{CompareOptions, Original};
pub use part_accounting::{AccountedPart, Dispensable, LostPart, PartAccounting, PartReason};
pub use provenance::{Provenance, SurfaceProvenance, SurfaceShare, SurfaceShares};

/// The version of [`Comparison`]'s structure.
pub const COMPARISON_VERSION: u32 = 1;

/// Share of what is inside the input that a faithful result must have inside, in percent.
const INSIDE_KEPT_PCT: f64 = 50.0;

/// Two meshes compared.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Comparison {
    /// Version of this structure.
    pub version: u32,
    /// Whether the second mesh keeps the first's shape: 99 % of the surface that can be seen from outside is within 0.5 %
    /// of the diagonal of the second mesh, no side of the box moved by more than 1 % of it, and at least half of what is inside the
    /// first, by winding number, is inside the second.
    pub faithful: bool,
    /// What the report of a repair says too.
    #[serde(flatten)]
    pub changes: Changes,
    /// Share of the first mesh's surface that can be seen from outside, in percent; none where nothing was apart, so that
    /// nobody had to look.
    pub visible_pct: Option<f64>,
    /// Distance from all of the first mesh's surface to the second, also from what can't be seen.
    pub deviation: Option<Deviation>,
    /// Whether both agree on what is inside.
    pub inside: Option<InsideAgreement>,
}

/// Compares `before` with `after`. The same meshes give the same figures, on any number of threads.
///
/// # Errors
/// [`Cancelled`] when the context says stop.
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
    /// All that can be said of another mesh.
    ///
    /// # Errors
    /// [`Cancelled`] when the context says stop.
    pub fn compare(
        &self,
        after: &Analysis<'_>,
        measures: &Measures,
        context: &Context<'_>,
    ) -> Result<Comparison, Cancelled> {
        let candidate = ComparedMesh { analysis: after, measures, patches: None, gone: &[] };
        let (mut changes, found) = self.changes_and_distances(&candidate, context)?;
        changes.surface = Some(self.provenance(after, context)?.shares);
        let apart = found.samples.iter().any(|&distance| distance != Some(0.0));
        let all: Vec<usize> = if apart { (0..self.samples().len()).collect() } else { Vec::new() };
        let known: Vec<bool> = self.visible(&all, context)?.into_iter().flatten().collect();
        let visible_pct = percent(known.iter().filter(|&&seen| seen).count() as f64, known.len() as f64);
        let inside = inside_agreement(Pair::new(self.analysis, after), INSIDE_WINDING, self.options.inside, context)?;
        let keeps_inside = inside
            .filter(|it| it.inside_before >= LEAST_INSIDE)
            .and_then(|it| it.kept_pct())
            .is_none_or(|kept| kept >= INSIDE_KEPT_PCT);
        let diagonal = self.analysis.unit_diagonal();
        let measured = Measured { analysis: self.analysis, samples: self.samples(), found: &found, diagonal };
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
