use glam::DVec3;

use super::complex::Complex;

/// What an edge costs for its length alone, per length to the fourth. It orders what quadrics call free, so that a plane
/// collapses evenly and not from one side, and counts for nothing against a fold of a thousandth of the length.
const COST_OF_LENGTH: f64 = 1e-6;
/// Distance from its planes, in the range of exact predicates, that rounding to f32 explains.
const ROUNDING: f64 = 2.4e-7;
/// The farthest from an edge's middle that its vertex may come to stand, in lengths of the edge.
const FARTHEST: f64 = 2.0;

/// Which end of an edge goes, and where the other stands then.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Choice {
    pub gone: u32,
    pub kept: u32,
    pub at: DVec3,
    /// What orders the queue.
    pub cost: f64,
}

/// The cheapest way to collapse an edge that keeps lines where they are, if there is one: a vertex on no line may go, and
/// one that is no end or branch of its line along that line. Only where both ends are on no line is a new position made.
///
/// An end is preferred to a new position where it is as good but for rounding, so that flat faces keep their coordinates.
pub(super) fn choose(
    it: &Complex,
    [a, b]: [u32; 2],
    along_line: bool,
    written: impl Fn(DVec3) -> DVec3,
) -> Option<Choice> {
    if it.fixed[a as usize] || it.fixed[b as usize] {
        return None;
    }
    let [p, q] = [a, b].map(|v| it.at[v as usize]);
    let square = p.distance_squared(q);
    let mut quadric = it.quadric[a as usize];
    quadric.add(&it.quadric[b as usize]);
    let of_length = COST_OF_LENGTH * square * square;
    let may_go = |v: u32| match it.lines[v as usize] {
        0 => true,
        2 => along_line,
        _ => false,
    };
    let stay = |gone: u32, kept: u32| {
        let at = it.at[kept as usize];
        may_go(gone).then(|| Choice { gone, kept, at, cost: quadric.at(at) })
    };
    let end = match (stay(a, b), stay(b, a)) {
        (Some(one), Some(other)) => Some(if other.cost < one.cost { other } else { one }),
        (one, other) => one.or(other),
    }?;
    let mut best = end;
    if it.lines[a as usize] == 0 && it.lines[b as usize] == 0 && end.cost > ROUNDING * ROUNDING * quadric.weight {
        let middle = p.midpoint(q);
        let new = quadric
            .lowest(middle)
            .map(&written)
            .filter(|new| new.is_finite() && new.distance_squared(middle) <= FARTHEST * FARTHEST * square);
        for at in [new, Some(written(middle))].into_iter().flatten().filter(|at| at.is_finite()) {
            let cost = quadric.at(at);
            if cost < best.cost {
                best = Choice { at, cost, ..best };
            }
        }
    }
    Some(Choice { cost: best.cost + of_length, ..best })
}
