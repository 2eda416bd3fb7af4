use glam::DVec3;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::deviation::Pair;
use crate::context::{Cancelled, Context};
use crate::inspect::Analysis;
use crate::inspect::queries::ask;
use crate::math::{Box3, Dipoles, r3};

/// Nodes and triangles that all winding numbers of both meshes together may look at: so many, and so many more for each
/// point.
const BUDGET: u64 = 10_000_000;
const BUDGET_A_POINT: u64 = 2000;

/// Whether two meshes agree on what is inside, by generalized winding numbers (Jacobson et al. 2013) at points spread evenly
/// in the box around both. Inside is where the number is at least a half, whichever way the mesh is turned.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct InsideAgreement {
    /// Points that were asked for.
    pub points: u64,
    /// Share of them on which both agree, in percent.
    pub agree_pct: f64,
    /// Share of those inside at least one that are inside both, in percent; none where no point is inside.
    pub overlap_pct: Option<f64>,
    /// Points inside the first mesh.
    pub inside_before: u64,
    /// Points inside the second mesh.
    pub inside_after: u64,
}

impl InsideAgreement {
    /// Share of the points inside the first mesh that are inside the second too, in percent; none where the first has none.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
    pub fn kept_pct(&self) -> Option<f64> {
        let (before, after) = (self.inside_before as f64, self.inside_after as f64);
        let overlap = self.overlap_pct? / 100.0;
        let both = overlap * (before + after) / (1.0 + overlap);
        (before > 0.0).then(|| (both / before * 100.0).min(100.0))
    }
}

/// The winding number from which on a point counts as inside a closed mesh.
pub(super) const INSIDE_WINDING: f64 = 0.5;

/// Compares what is inside. Points count as inside the first mesh from a winding number of `least_before` on. None where one mesh has no face or no point could be asked for.
///
/// # Errors
/// [`Cancelled`] when the context says stop.
pub(super) fn inside_agreement(
    pair: Pair<'_>,
    least_before: f64,
    points: u32,
    context: &Context<'_>,
) -> Result<Option<InsideAgreement>, Cancelled> {
    let mut bounds = Box3::of(pair.from.unit().iter().copied());
    for &p in pair.to.unit() {
        bounds.extend(p / pair.ratio);
    }
    if points == 0 || pair.from.surface.faces.is_empty() || pair.to.surface.faces.is_empty() {
        return Ok(None);
    }
    let insides = [Inside::new(pair.from), Inside::new(pair.to)];
    context.check()?;
    let answers = ask(points as usize, BUDGET + BUDGET_A_POINT * u64::from(points), context, |i, steps| {
        let share = DVec3::from(r3(i as f64));
        let point = bounds.min * (DVec3::ONE - share) + bounds.max * share;
        let is_inside = [insides[0].winding(point, steps), insides[1].winding(point * pair.ratio, steps)];
        let found = (is_inside[0] >= least_before, is_inside[1] >= INSIDE_WINDING);
        (*steps > 0).then_some(found)
    })?;
    let count =
        |wanted: fn(&(bool, bool)) -> bool| answers.values.iter().flatten().filter(|it| wanted(it)).count() as f64;
    let asked = count(|_| true);
    let (either, both) = (count(|it| it.0 || it.1), count(|it| it.0 && it.1));
    Ok((asked > 0.0).then(|| InsideAgreement {
        points: asked as u64,
        agree_pct: (asked - either + both) / asked * 100.0,
        overlap_pct: (either > 0.0).then(|| both / either * 100.0),
        inside_before: count(|it| it.0) as u64,
        inside_after: count(|it| it.1) as u64,
    }))
}

/// Tells what is inside a mesh.
pub(in crate::inspect) struct Inside<'a> {
    analysis: &'a Analysis<'a>,
    dipoles: &'a Dipoles,
}

impl<'a> Inside<'a> {
    /// Sums the faces, unless that was done for the same mesh before.
    pub fn new(analysis: &'a Analysis<'a>) -> Self {
        Self { analysis, dipoles: analysis.dipoles() }
    }

    /// The size of the winding number at a point in unit coordinates, whichever way the mesh is turned.
    pub fn winding(&self, point: DVec3, steps: &mut u64) -> f64 {
        self.analysis.tree().winding(self.dipoles, point, steps, |f| self.analysis.unit_corners(f)).abs()
    }

    /// The same on both sides of a point.
    pub fn windings(&self, point: DVec3, aside: DVec3, steps: &mut u64) -> [f64; 2] {
        let tree = self.analysis.tree();
        tree.windings(self.dipoles, point, aside, steps, |f| self.analysis.unit_corners(f)).map(f64::abs)
    }
}
