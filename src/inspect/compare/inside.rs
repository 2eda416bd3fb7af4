use glam::DVec3;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::super::analysis::Pair;
use super::super::percent;
use super::super::sampling::{Inside, ask};
use crate::context::{Cancelled, Context};
use crate::math::{Box3, r3};

/// Nodes and triangles that all winding numbers of both meshes together may look at: so many, and so many more for each
/// point.
const BUDGET: u64 = 10_000_000;
const BUDGET_A_POINT: u64 = 2000;

/// Faces that are asked for, at most.
const BURIED_FACES: usize = 1000;
/// Nodes and triangles that all of them together may look at.
const BURIED_BUDGET: u64 = 10_000_000;
/// How far on both sides of a face is asked, in unit coordinates, which reach 2.
const BESIDE: f64 = 1e-6;
/// A winding number of at least this is inside.
const MATERIAL: f64 = 0.9;

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

/// Of the faces of `pair.from` that `stands` denies, the share with material of `pair.to` on both sides, in percent: walls that
/// parts had inside one another, and that their union has no more. Faces spread evenly over all of them are asked. None where
/// all stand, or none could be asked for.
///
/// # Errors
/// [`Cancelled`] when the context says stop.
pub(super) fn buried_pct(
    pair: Pair<'_>,
    stands: impl Fn(u32) -> bool,
    context: &Context<'_>,
) -> Result<Option<f64>, Cancelled> {
    let gone: Vec<u32> = (0u32..).take(pair.from.surface.faces.len()).filter(|&f| !stands(f)).collect();
    let asked: Vec<u32> = gone.iter().copied().step_by(gone.len().div_ceil(BURIED_FACES).max(1)).collect();
    if asked.is_empty() || pair.to.surface.faces.is_empty() {
        return Ok(None);
    }
    let points = asked.iter().map(|&f| {
        let [a, b, c] = pair.from.unit_corners(f);
        ((a + b + c) / 3.0, (b - a).cross(c - a).normalize_or_zero())
    });
    let known: Vec<bool> = are_buried(pair, &points.collect::<Vec<_>>(), context)?.into_iter().flatten().collect();
    let buried = known.iter().filter(|&&buried| buried).count();
    Ok(percent(buried as f64, known.len() as f64))
}

/// Which points of `pair.from`, each with the unit normal there, have material of `pair.to` on both sides; none for those that the
/// budget did not reach.
///
/// # Errors
/// [`Cancelled`] when the context says stop.
pub(super) fn are_buried(
    pair: Pair<'_>,
    points: &[(DVec3, DVec3)],
    context: &Context<'_>,
) -> Result<Vec<Option<bool>>, Cancelled> {
    let inside = Inside::new(pair.to);
    let answers = ask(points.len(), BURIED_BUDGET, context, |i, steps| {
        let (point, normal) = points[i];
        let sides = inside.windings(point * pair.ratio, normal * BESIDE, steps);
        (*steps > 0).then(|| sides.iter().all(|&number| number >= MATERIAL))
    })?;
    Ok(answers.values)
}
