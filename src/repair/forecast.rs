//! The forecast of a native remesh, made from two coarse remeshes of the same surface.
//!
//! The surface that a remesh loses shrinks about linearly with the size of its cells. So the line through two coarse sizes,
//! extended to size zero, bounds what any size can reach. If even that bound ranks no better than a known result, the fine remesh is
//! skipped: it would take a hundred times as long as the forecast.

use super::judge::{Cause, Judged, Judging, Patches, ResultClass, class_of_printable};
use super::operators::remesh::RemeshInside;
use super::red_flags::AddedSurface;
use super::report::{RedFlag, RedFlagCode};
use crate::context::Cancelled;
use crate::mesh::Surface;

/// Cells along the diagonal of the two coarse remeshes; the second has twice as many as the first.
const COARSE_RESOLUTIONS: [f64; 2] = [48.0, 96.0];

/// The result that a remesh with infinitely small cells would reach.
pub(super) struct Forecast {
    /// The class of that result.
    pub class: ResultClass,
    /// The share of visible surface that it would lose, in tenths of a percent.
    pub lost_tenths: u64,
    /// Its red flags, with the values of the finer coarse remesh.
    flags: Vec<RedFlag>,
}

impl Forecast {
    /// Remeshes a surface twice, coarsely, judges both results and extrapolates. Returns none if a coarse remesh fails or cannot be
    /// judged in time.
    ///
    /// # Errors
    /// [`Cancelled`] if the job was canceled.
    pub fn of(
        remesh: &RemeshInside,
        surface: &Surface,
        added: &AddedSurface,
        judging: &Judging<'_, '_>,
    ) -> Result<Option<Self>, Cancelled> {
        let diagonal = surface.bounds().diagonal();
        let mut results: Vec<Judged> = Vec::new();
        for resolution in COARSE_RESOLUTIONS {
            let mut coarse = surface.clone();
            if remesh.with_cell(diagonal / resolution).apply(&mut coarse, judging.context)?.failed.is_some() {
                return Ok(None);
            }
            let cause = Cause { before_remesh: Some(added), ..Cause::default() };
            let Ok(judged) = judging.judge(&coarse, None, Patches::None, cause) else {
                return if judging.context.is_cancelled() { Err(Cancelled) } else { Ok(None) };
            };
            results.push(judged);
        }
        let [coarse, fine] = &results[..] else { return Ok(None) };
        Ok(Some(Self::extrapolated(coarse, fine)))
    }

    /// Extrapolates two results, of which the second has cells of half the size, to cells of size zero.
    fn extrapolated(coarse: &Judged, fine: &Judged) -> Self {
        let at_zero = |fine: f64, coarse: Option<f64>| 2.0 * fine - coarse.unwrap_or(fine);
        let remains = |flag: &&RedFlag| {
            let of_coarse = coarse.red_flags.iter().find(|other| other.code == flag.code);
            at_zero(flag.value, of_coarse.map(|other| other.value)) > flag.threshold
        };
        let flags: Vec<RedFlag> = fine.red_flags.iter().filter(remains).cloned().collect();
        let lost = at_zero(fine.changes.surface_lost_pct.unwrap_or(0.0), coarse.changes.surface_lost_pct);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a percentage of at least zero")]
        let lost_tenths = (lost.max(0.0) * 10.0).round() as u64;
        Self { class: class_of_printable(&flags), lost_tenths, flags }
    }

    /// Whether the red flags are such that agreement with another method would explain them by the input (see
    /// [`explain_by_agreement`](super::method_agreement::explain_by_agreement)). Only the remesh itself can show that.
    pub fn is_explainable(&self) -> bool {
        let is_lost_or_added =
            |flag: &RedFlag| matches!(flag.code, RedFlagCode::SurfaceLost | RedFlagCode::SurfaceInvented);
        self.class != ResultClass::Destroyed && self.flags.iter().all(is_lost_or_added)
    }

    /// The red flags that no size of cells avoids, as text.
    pub fn text(&self) -> String {
        self.flags.iter().map(|flag| flag.detail.as_str()).collect::<Vec<_>>().join("; ")
    }
}
