use glam::DVec3;

use super::deviation::Pair;
use super::inside::Inside;
use super::percent;
use crate::context::{Cancelled, Context};
use crate::inspect::queries::ask;

/// Faces that are asked for, at most.
const FACES: usize = 1000;
/// Nodes and triangles that all of them together may look at.
const BUDGET: u64 = 10_000_000;
/// How far on both sides of a face is asked, in unit coordinates, which reach 2.
const BESIDE: f64 = 1e-6;
/// A winding number of at least this is inside.
const MATERIAL: f64 = 0.9;

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
    let asked: Vec<u32> = gone.iter().copied().step_by(gone.len().div_ceil(FACES).max(1)).collect();
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
    let answers = ask(points.len(), BUDGET, context, |i, steps| {
        let (point, normal) = points[i];
        let sides = inside.windings(point * pair.ratio, normal * BESIDE, steps);
        (*steps > 0).then(|| sides.iter().all(|&number| number >= MATERIAL))
    })?;
    Ok(answers.values)
}
