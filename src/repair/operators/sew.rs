//! Sewing: merging boundary vertices that are close for the size of what is around them.

use super::border::{Border, Near};
use super::{Applied, Counter, Operation, Scope};
use crate::mesh::Surface;
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// How far boundary vertices may be apart to be merged.
#[derive(Debug, Clone, Copy)]
pub struct Sew {
    /// Most of the distance over the shortest boundary edge at either vertex; 0.2 by default.
    pub ratio: f64,
    /// Most of the distance over the bounding box's diagonal; 0.001 by default, infinite for none.
    pub tolerance: f64,
    /// No vertex is moved farther than this, in the model's unit.
    pub max_deviation: f64,
}

impl Default for Sew {
    fn default() -> Self {
        Self { ratio: 0.2, tolerance: 1e-3, max_deviation: f64::INFINITY }
    }
}

impl Sew {
    /// Merges the boundary vertices whose distance is below a share of the shortest boundary edge at either, the nearest
    /// pair first. Of a pair the first vertex stays where it is, or the second where the first may not be moved into.
    ///
    /// ```text
    ///   ---a-------b---         ---a-------b---
    ///   ---c-------d---   ->    ---'-------'---     |ac| < ratio * |ab|
    /// ```
    ///
    /// Both vertices must have boundary edges that run along one another, as the sides of a crack do, so that what only
    /// touches is not joined.
    ///
    /// Precondition: none. Result: no face goes, loses its area or turns over, and no edge has more faces than two that
    /// had one. Leaves: pairs that share an edge, and those for which that would not hold.
    ///
    /// After *Sew* of the Blender add-on Mesh Heal.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; what is merged stays merged.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let cap = (self.tolerance * surface.bounds().diagonal()).min(self.max_deviation);
        let Some(mut border) = Border::new(surface).filter(|_| cap > 0.0) else { return Ok(Applied::default()) };
        let mut reach = vec![cap; border.vertices.len()];
        for ([a, b], length) in border.lengths().collect::<Vec<_>>() {
            for v in [a, b] {
                let reach = &mut reach[border.place(v)];
                *reach = reach.min(self.ratio * length);
            }
        }
        let pairs = pairs(&mut border, &reach, context)?;
        let mut merged = 0;
        for (count, &(_, a, b)) in pairs.iter().enumerate() {
            if count % 4096 == 0 {
                context.check()?;
            }
            let (a, b) = (border.now(a), border.now(b));
            let most = reach[border.place(a)].min(reach[border.place(b)]);
            if a == b || border.position(a).distance(border.position(b)) >= most {
                continue;
            }
            let [one, other] = [a, b].map(|v| border.courses(v));
            if Border::run_along(&one, &other) && (border.merge(b, a, cap) || border.merge(a, b, cap)) {
                merged += 1;
            }
        }
        let left = border.gave_up();
        let moved = border.farthest();
        if merged > 0 {
            surface.drop_unreferenced();
        }
        Ok(Applied {
            changes: Change::list([(ChangeKind::BoundaryVerticesSewn, merged)]),
            moved,
            left,
            ..Applied::default()
        })
    }
}

/// The pairs of vertices within reach of one another, the nearest first.
fn pairs(border: &mut Border<'_>, reach: &[f64], context: &Context<'_>) -> Result<Vec<(f64, u32, u32)>, Cancelled> {
    let mut pairs = Vec::new();
    let mut near: Vec<Near> = Vec::new();
    for (at, within) in reach.iter().enumerate() {
        if at % 4096 == 0 {
            context.check()?;
        }
        let v = border.vertices[at];
        near.clear();
        border.near(v, *within, &mut near);
        for other in near.iter().flat_map(|found| found.ends).filter(|&other| other > v) {
            let distance = border.position(v).distance(border.position(other));
            if distance < within.min(reach[border.place(other)]) {
                pairs.push((distance, v, other));
            }
        }
    }
    pairs.sort_unstable_by(|x, y| x.0.total_cmp(&y.0).then((x.1, x.2).cmp(&(y.1, y.2))));
    pairs.dedup();
    Ok(pairs)
}

impl Operation for Sew {
    const FIXES: &'static [Counter] =
        &[Counter::BoundaryEdges, Counter::MisorientedEdges, Counter::NonmanifoldEdges, Counter::DuplicateFaces];
    const MAY_RAISE: &'static [Counter] = &[Counter::PinchedVertices];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        let (usual, asked) = (Self::default(), scope.options.sew_ratio);
        // A ratio that was asked for is the only limit.
        let tolerance = if asked.is_some() { f64::INFINITY } else { usual.tolerance };
        Self { ratio: asked.unwrap_or(usual.ratio), tolerance, max_deviation: scope.max_deviation }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}
