//! Groups boundary loops into holes: a hole has an outer loop, and one more loop for each island in it.

use glam::DVec3;

use crate::math::{Box3, Tree};
use crate::mesh::{BoundaryLoops, Parts};

/// A loop of an island runs opposite to the outer loop: their normals have at most this cosine.
const MAX_OPPOSED_COSINE: f64 = -0.9;
/// The largest distance of an island from the hole's plane, as a share of the root of the hole's area.
const MAX_OFF_PLANE: f64 = 0.25;
/// The same where both loops bound one part, which may also be a short tube with two open ends.
const MAX_OFF_PLANE_SAME_PART: f64 = 1e-4;
/// A face whose normal has a lower cosine with the patch's normal lies behind the patch, which would cover the face.
const BEHIND_COSINE: f64 = -0.5;
/// The most corners that all containment tests may visit.
const STEP_BUDGET: u64 = 50_000_000;

/// A hole: its outer loop, and the loops of islands in it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Hole {
    /// The loops, outer loop first. Patches run along all of them.
    pub loops: Vec<Vec<u32>>,
    /// For each loop the part that it bounds.
    pub parts: Vec<u32>,
    /// The diagonal of the hole's bounding box.
    pub extent: f64,
}

impl Hole {
    /// The number of edges of all loops.
    pub fn edges(&self) -> usize {
        self.loops.iter().map(Vec::len).sum()
    }
}

/// Geometric properties of a loop.
struct LoopShape {
    bounds: Box3,
    normal: DVec3,
    /// The root of the area of the loop's projection along its normal.
    size: f64,
    /// Whether most faces at the loop lie behind a flat patch: a patch inside the loop, and a patch around the loop.
    behind: [bool; 2],
}

/// Twice the area vector of a closed polygon, by Newell's method.
pub fn newell(points: &[DVec3]) -> DVec3 {
    let Some(&origin) = points.first() else { return DVec3::ZERO };
    let next = points.iter().cycle().skip(1);
    points.iter().zip(next).map(|(p, q)| (p - origin).cross(q - origin)).sum()
}

/// Groups the loops that bound one hole. The loop of an island lies close to the plane of the outer loop, inside it when
/// projected along its normal, and runs in the opposite direction.
///
/// ```text
///    ___________
///   |  _______  |      the patch is the ring between the loops,
///   | |island | |      and joins the island to the surface around it
///   | |_______| |
///   |___________|
/// ```
///
/// Of several loops around a loop the smallest counts. A loop inside an island is an outer loop again. `face_normal` returns
/// the normal of the face at a boundary edge. O(n log n) time for loops side by side. Nested loops are tested within a budget;
/// after that each loop is a separate hole.
pub(super) fn group_loops(
    positions: &[DVec3],
    loops: BoundaryLoops,
    parts: &Parts,
    face_normal: impl Fn(u32, u32) -> DVec3,
) -> Vec<Hole> {
    let shapes: Vec<LoopShape> = loops.simple.iter().map(|l| loop_shape(positions, l, &face_normal)).collect();
    let part = |i: usize| parts.of_face[loops.face[i] as usize];
    let mut inner_of: Vec<Option<usize>> = vec![None; shapes.len()];
    if shapes.len() > 1 {
        let boxes: Vec<Box3> = shapes.iter().map(|shape| shape.bounds).collect();
        let tree = Tree::of_boxes(&boxes);
        let mut order: Vec<usize> = (0..shapes.len()).collect();
        order.sort_by(|&i, &j| shapes[j].size.total_cmp(&shapes[i].size).then(i.cmp(&j)));
        let mut steps = STEP_BUDGET;
        for &i in &order {
            let mut around: Option<usize> = None;
            tree.overlapping(&shapes[i].bounds, |f| {
                let j = f as usize;
                steps = steps.saturating_sub(1);
                let off = if part(i) == part(j) { MAX_OFF_PLANE_SAME_PART } else { MAX_OFF_PLANE };
                let smaller =
                    shapes[j].size > shapes[i].size && around.is_none_or(|k| (shapes[j].size, k) < (shapes[k].size, j));
                if smaller && shapes[i].normal.dot(shapes[j].normal).abs() >= -MAX_OPPOSED_COSINE {
                    steps = steps.saturating_sub((loops.simple[i].len() + loops.simple[j].len()) as u64);
                    if is_inside(positions, &loops.simple[i], &loops.simple[j], &shapes[j], off) {
                        around = Some(j);
                    }
                }
                steps > 0
            });
            if steps == 0 {
                break;
            }
            let Some(j) = around else { continue };
            let opposed = shapes[i].normal.dot(shapes[j].normal) <= MAX_OPPOSED_COSINE;
            if inner_of[j].is_none() && opposed && !shapes[i].behind[1] && !shapes[j].behind[0] {
                inner_of[i] = Some(j);
            }
        }
    }
    let mut holes: Vec<Hole> = Vec::with_capacity(shapes.len());
    let mut number = vec![0; shapes.len()];
    let mut inner = Vec::new();
    for (i, border) in loops.simple.into_iter().enumerate() {
        let of_part = parts.of_face[loops.face[i] as usize];
        if let Some(j) = inner_of[i] {
            inner.push((j, of_part, border));
        } else {
            number[i] = holes.len();
            holes.push(Hole { loops: vec![border], parts: vec![of_part], extent: shapes[i].bounds.diagonal() });
        }
    }
    for (j, of_part, border) in inner {
        let hole = &mut holes[number[j]];
        hole.loops.push(border);
        hole.parts.push(of_part);
    }
    holes
}

/// Measures a loop.
fn loop_shape(positions: &[DVec3], border: &[u32], face_normal: &impl Fn(u32, u32) -> DVec3) -> LoopShape {
    let points: Vec<DVec3> = border.iter().map(|&v| positions[v as usize]).collect();
    let newell = newell(&points);
    let normal = newell.try_normalize().unwrap_or(DVec3::ZERO);
    // A patch around an island faces as the outer loop does, which is opposite to the island's loop.
    let behind = [normal, -normal].map(|normal| {
        let next = border.iter().cycle().skip(1);
        let count = border.iter().zip(next).filter(|&(&a, &b)| face_normal(a, b).dot(normal) < BEHIND_COSINE).count();
        2 * count > border.len()
    });
    let size = (newell.length() / 2.0).sqrt();
    LoopShape { bounds: Box3::of(points), normal, size, behind }
}

/// Whether a loop is close to the plane of another, and its first vertex inside it when projected along the normal.
fn is_inside(positions: &[DVec3], inner: &[u32], outer: &[u32], loop_shape: &LoopShape, off: f64) -> bool {
    let at = |v: &u32| positions[*v as usize];
    let count = f64::from(u32::try_from(outer.len()).unwrap_or(u32::MAX));
    let middle = outer.iter().map(at).sum::<DVec3>() / count;
    if inner.iter().any(|v| (at(v) - middle).dot(loop_shape.normal).abs() > off * loop_shape.size) {
        return false;
    }
    let x = loop_shape.normal.any_orthonormal_vector();
    let y = loop_shape.normal.cross(x);
    let origin = at(&inner[0]);
    let project = |v: &u32| ((at(v) - origin).dot(x), (at(v) - origin).dot(y));
    let next = outer.iter().cycle().skip(1);
    // The sides that cross the ray to the right: an odd number for a point inside the polygon.
    let crossed = outer.iter().zip(next).filter(|&(v, w)| {
        let ((ax, ay), (bx, by)) = (project(v), project(w));
        (ay > 0.0) != (by > 0.0) && ax - ay * (bx - ax) / (by - ay) > 0.0
    });
    crossed.count() % 2 == 1
}

impl Hole {
    /// Splits the hole into one hole for each loop, the last loop first.
    pub fn split_loops(self) -> impl Iterator<Item = Hole> {
        let extent = self.extent;
        let each = self.loops.into_iter().zip(self.parts).rev();
        each.map(move |(border, part)| Hole { loops: vec![border], parts: vec![part], extent })
    }
}
