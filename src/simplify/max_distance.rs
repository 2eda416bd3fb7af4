//! The largest distance from the points of one surface to another surface, over all points and not only samples.

use glam::DVec3;
use rayon::prelude::*;
use smallvec::{SmallVec, smallvec};

use crate::context::{Cancelled, Context};
use crate::math::{Polygon, Tree, clip, nearest_on_triangle, sides_along};
use crate::mesh::Surface;

/// Budget of a complete test, in boxes and triangles visited: for each face, plus an allowance divided among all faces.
const BUDGET_PER_FACE: u64 = 200_000;
const SHARED_BUDGET: u64 = 1_000_000_000;
/// Part of the shared allowance for each face of the target.
const BUDGET_PER_TARGET: u64 = 5000;
/// A polygon is cut along the sides of a triangle only if its radius is at most this multiple of the triangle's sides.
const MAX_CUT_RATIO: f64 = 2.0;
/// Maximum number of faces in a parallel task, and of polygons tested between two checks for cancellation.
const CHECK_INTERVAL: usize = 256;
/// Minimum number of parallel tasks, unless there are fewer faces. A large face can take long.
const MIN_CHUNKS: usize = 64;

/// The result of testing every point of a face.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Reach {
    /// All points are within the limit.
    Within,
    /// A point is beyond the limit; this face of the target is the nearest to it.
    Beyond(u32),
    /// The search was too long; this face of the target is near the last tested point.
    Unknown(u32),
}

/// A surface to which distances are measured.
#[derive(Clone, Copy)]
pub(super) struct Target<'a> {
    /// The search tree over the faces.
    pub tree: &'a Tree,
    /// Vertex positions.
    pub positions: &'a [DVec3],
    /// Faces as indices into `positions`.
    pub faces: &'a [[u32; 3]],
}

impl Target<'_> {
    /// The distance from `p` to the surface; none if it exceeds `bound`.
    pub fn distance(&self, p: DVec3, bound: f64) -> Option<f64> {
        self.tree.nearest(p, bound, &mut u64::MAX.clone(), |f| self.corners(f)).map(|nearest| nearest.distance)
    }

    /// The faces of `surface` with points farther than `limit` from this surface, each with the nearest face of this
    /// surface. A face whose search exhausts its budget is among them.
    ///
    /// # Errors
    /// [`Cancelled`] if the work is cancelled or the deadline passes.
    pub fn faces_beyond(
        &self,
        surface: &Surface,
        limit: f64,
        context: &Context<'_>,
    ) -> Result<Vec<[u32; 2]>, Cancelled> {
        let shared = SHARED_BUDGET + BUDGET_PER_TARGET * self.faces.len() as u64;
        let budget = BUDGET_PER_FACE + shared / surface.faces.len().max(1) as u64;
        let size = (surface.faces.len() / MIN_CHUNKS).clamp(1, CHECK_INTERVAL);
        let chunks: Vec<_> = (0u32..).step_by(size).zip(surface.faces.chunks(size)).collect();
        let found: Vec<Vec<[u32; 2]>> = chunks
            .into_par_iter()
            .map(|(first, faces)| {
                let is_stopped = || context.check().is_err();
                let pairs = (first..).zip(faces).filter_map(|(index, face)| {
                    match self.reach(face.map(|v| surface.positions[v as usize]), limit, budget, is_stopped) {
                        Reach::Within => None,
                        Reach::Beyond(nearest) | Reach::Unknown(nearest) => Some([index, nearest]),
                    }
                });
                let pairs = pairs.collect();
                context.check()?;
                Ok(pairs)
            })
            .collect::<Result<_, _>>()?;
        Ok(found.concat())
    }

    /// Tests every point of a triangle. The distance to one convex triangle is a convex function, so over a convex polygon
    /// it is largest at a corner. A polygon whose corners are all within `limit` of the **same** triangle is therefore
    /// done. Otherwise the polygon is cut along the sides of the triangle nearest to its centre, and each piece is tested
    /// by itself. A polygon that is much larger than that triangle is halved first. Ends when `steps` run out, and soon
    /// after `is_stopped` returns true.
    pub fn reach(&self, triangle: [DVec3; 3], limit: f64, mut steps: u64, is_stopped: impl Fn() -> bool) -> Reach {
        let mut pending = vec![(Polygon::from(triangle.as_slice()), true)];
        let (mut nearest, mut tested) = (None, 0);
        while let Some((polygon, is_cut_next)) = pending.pop() {
            tested += 1;
            if tested % CHECK_INTERVAL == 0 && is_stopped() {
                return Reach::Unknown(nearest.unwrap_or_default());
            }
            let centre = polygon.iter().sum::<DVec3>() / polygon.len() as f64;
            let distance = self.tree.distance(centre, &mut nearest, &mut steps, |f| self.corners(f));
            let face = nearest.unwrap_or_default();
            let Some(distance) = distance.filter(|_| steps > 0) else { return Reach::Unknown(face) };
            if distance > limit {
                return Reach::Beyond(face);
            }
            let radius = polygon.iter().map(|p| p.distance(centre)).fold(0.0, f64::max);
            if distance + radius <= limit {
                continue;
            }
            let target = self.corners(face);
            let is_near = |p: &DVec3| p.distance_squared(nearest_on_triangle(*p, target)) <= limit * limit;
            let is_all_near = |polygon: &Polygon| polygon.iter().all(is_near);
            if is_all_near(&polygon) {
                continue;
            }
            let is_large =
                radius > MAX_CUT_RATIO * (target[1] - target[0]).length().max((target[2] - target[0]).length());
            // Rounding can leave a piece as large as it was, so pieces are halved at every second step.
            let pieces = if is_cut_next && !is_large { cut(&polygon, target) } else { halves(&polygon, centre) };
            pending.extend(pieces.into_iter().filter(|piece| !is_all_near(piece)).map(|piece| (piece, !is_cut_next)));
        }
        Reach::Within
    }

    fn corners(&self, face: u32) -> [DVec3; 3] {
        self.faces[face as usize].map(|v| self.positions[v as usize])
    }
}

/// Cuts a convex polygon along the sides of a triangle, seen along the triangle's normal, into the part over the
/// triangle and those beside it.
fn cut(polygon: &Polygon, triangle: [DVec3; 3]) -> SmallVec<[Polygon; 4]> {
    let normal = (triangle[1] - triangle[0]).cross(triangle[2] - triangle[0]);
    let (mut over, mut pieces) = (polygon.clone(), SmallVec::<[Polygon; 4]>::new());
    for (across, start) in sides_along(triangle, normal) {
        let height = |p: DVec3| across.dot(p - start);
        if over.iter().any(|p| height(*p) < 0.0) {
            pieces.push(clip(&over, |p| -height(p)));
            over = clip(&over, height);
        }
    }
    pieces.push(over);
    pieces.retain(|piece| !piece.is_empty());
    pieces
}

/// The two halves of a convex polygon on both sides of a plane through its centre, across its longest extent.
fn halves(polygon: &Polygon, centre: DVec3) -> SmallVec<[Polygon; 4]> {
    let farthest =
        polygon.iter().copied().max_by(|a, b| a.distance_squared(centre).total_cmp(&b.distance_squared(centre)));
    let across = farthest.unwrap_or(centre) - centre;
    smallvec![clip(polygon, |p| across.dot(p - centre)), clip(polygon, |p| -across.dot(p - centre))]
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;
    use std::time::Duration;

    use super::*;
    use crate::context::NoProgress;

    fn is_within(from: &Surface, to: &Surface, limit: f64) -> bool {
        let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(1));
        let tree = Tree::new(&to.positions, &to.faces);
        let to = Target { tree: &tree, positions: &to.positions, faces: &to.faces };
        to.faces_beyond(from, limit, &context).unwrap().is_empty()
    }

    /// A grid of `n` by `n` squares over the unit square, at the given heights.
    fn sheet(n: u32, height: impl Fn(f64, f64) -> f64) -> Surface {
        let step = |i: u32| f64::from(i) / f64::from(n);
        let corners = (0..=n).flat_map(|i| (0..=n).map(move |j| (step(i), step(j))));
        let positions = corners.map(|(x, y)| DVec3::new(x, y, height(x, y))).collect();
        let mut faces = Vec::new();
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            let at = |i: u32, j: u32| i * (n + 1) + j;
            faces.extend([[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]]);
        }
        Surface { source: (0..2 * n * n).collect(), positions, faces }
    }

    #[test]
    fn a_peak_between_all_vertices_and_centres_counts() {
        // A narrow peak at a vertex of the finer sheet, which is on the coarse face but is none of its vertices.
        let (coarse, peak) =
            (sheet(1, |_, _| 0.0), sheet(32, |x, y| if x == 0.28125 && y == 0.75 { 0.1 } else { 0.0 }));
        for (from, to) in [(&coarse, &peak), (&peak, &coarse)] {
            assert!(is_within(from, to, 0.1001));
        }
        assert!(!is_within(&peak, &coarse, 0.0999));
        // The flat sheet is nearest to the slopes of the peak: at most the height of the inscribed ball over its foot.
        assert!(!is_within(&coarse, &peak, 0.01));
    }

    #[test]
    fn a_large_face_over_many_coplanar_ones_is_within_a_tiny_limit() {
        let (coarse, fine) = (sheet(1, |_, _| 0.5), sheet(40, |_, _| 0.5 + 1e-7));
        assert!(is_within(&coarse, &fine, 1.01e-7) && is_within(&fine, &coarse, 1.01e-7));
        assert!(!is_within(&coarse, &fine, 0.99e-7) && !is_within(&fine, &coarse, 0.99e-7));
    }

    #[test]
    fn a_large_face_is_left_when_the_work_should_stop() {
        let fine = sheet(40, |_, _| 1e-7);
        let tree = Tree::new(&fine.positions, &fine.faces);
        let target = Target { tree: &tree, positions: &fine.positions, faces: &fine.faces };
        let reach = |is_stopped: bool| target.reach([DVec3::ZERO, DVec3::X, DVec3::Y], 2e-7, u64::MAX, || is_stopped);
        assert_eq!(reach(false), Reach::Within);
        assert!(matches!(reach(true), Reach::Unknown(_)));
    }

    #[test]
    fn a_valley_deeper_than_the_limit_is_found_wherever_it_is() {
        let valley = |x: f64, y: f64| -0.2 * (x - 0.37).abs().max((y - 0.61).abs()).mul_add(-9.0, 1.0).max(0.0);
        let (fine, coarse) = (sheet(50, valley), sheet(2, |_, _| 0.0));
        let deepest = fine.positions.iter().map(|p| -p.z).fold(0.0, f64::max);
        assert!(is_within(&fine, &coarse, deepest * 1.001) && !is_within(&fine, &coarse, deepest * 0.999));
    }
}
