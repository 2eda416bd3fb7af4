use glam::DVec3;

use super::walls::Walls;
use crate::mesh::{Parts, Surface};
use crate::repair::{Cancelled, Context};

/// Faces that vote for a patch.
const VOTERS: usize = 16;
/// Faces that all rays together may look at: this many, and as many again for each face. Enough for a soup of single
/// triangles; a fan of thousands of sheets around one axis, where each ray meets them all, runs out of it.
const BUDGET: u64 = 5_000_000;
const BUDGET_A_FACE: u64 = 8;

/// For each patch that `open` marks, whether it shows its back to the outside.
///
/// From the middle of each of its largest faces a ray goes out along the normal and another against it. The side
/// whose ray crosses the surface an even number of times is outside; the faces' areas are the votes. Patches without
/// a vote, and those after the budget is spent, answer `false`.
pub(super) fn looks_inward(
    surface: &Surface,
    patches: &Parts,
    open: &[bool],
    areas: &[f64],
    context: &Context<'_>,
) -> Result<Vec<bool>, Cancelled> {
    let budget = BUDGET + BUDGET_A_FACE * surface.faces.len() as u64;
    let mut walls = Walls::new(surface, surface.faces.clone(), budget);
    let mut inward = vec![false; patches.count];
    for (patch, mut faces) in patches.faces().into_iter().enumerate().filter(|(p, _)| open[*p]) {
        context.check()?;
        let by_area = |x: &u32, y: &u32| areas[*y as usize].total_cmp(&areas[*x as usize]).then(x.cmp(y));
        if faces.len() > VOTERS {
            faces.select_nth_unstable_by(VOTERS, by_area);
            faces.truncate(VOTERS);
        }
        faces.sort_unstable_by(by_area);
        let mut votes = 0.0;
        for f in faces {
            let [a, b, c] = surface.faces[f as usize].map(|v| walls.unit[v as usize]);
            // The smallest cross product of numbers around 1 may underflow; such a face has no say.
            let normal = (b - a).cross(c - a).normalize_or_zero();
            let from = (a + b + c) / 3.0;
            let mut count = |direction: DVec3| walls.crossings(from, from + direction * 8.0, Some(f));
            if normal.length_squared() < 0.5 {
                continue;
            }
            if let (Some(front), Some(back)) = (count(normal), count(-normal)) {
                match (front % 2, back % 2) {
                    (0, 1) => votes += areas[f as usize],
                    (1, 0) => votes -= areas[f as usize],
                    _ => {}
                }
            }
        }
        inward[patch] = votes < 0.0;
    }
    Ok(inward)
}
