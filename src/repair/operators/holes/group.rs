//! Which boundary loops bound one hole: islands in it have loops of their own.

use glam::DVec3;

use crate::math::{Box3, Frame, Tree};
use crate::mesh::{BoundaryLoops, Parts};

/// A loop in a hole runs against the hole's own: their normals have at most this cosine.
const LEAST_OPPOSED: f64 = -0.9;
/// An island may be this far off the hole's plane, as a share of the root of its area, ...
const OFF_PLANE: f64 = 0.25;
/// ... and this far where both loops bound the same part, which may also be a short tube open at both ends.
const OFF_PLANE_WITHIN: f64 = 1e-4;
/// A face that turns away from a patch by more than this cosine lies behind it: the patch would cover it.
const BEHIND: f64 = -0.5;
/// Corners that all questions whether a loop is in another may look at.
const STEPS: u64 = 50_000_000;

/// A hole: its border, and the borders of islands in it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Hole {
    /// The outer loop first. Patches run along all of them.
    pub loops: Vec<Vec<u32>>,
    /// For each loop the part that it bounds.
    pub parts: Vec<u32>,
    /// Diagonal of the box around it.
    pub extent: f64,
}

impl Hole {
    pub fn edges(&self) -> usize {
        self.loops.iter().map(Vec::len).sum()
    }
}

/// What a loop looks like.
struct Shape {
    bounds: Box3,
    normal: DVec3,
    /// Root of its area, seen along its normal.
    size: f64,
    /// Whether the faces around it lie behind a flat patch: one over it, or one around it.
    behind: [bool; 2],
}

/// Twice the area vector of a closed polygon, after Newell.
pub(super) fn newell(points: &[DVec3]) -> DVec3 {
    let Some(&about) = points.first() else { return DVec3::ZERO };
    let next = points.iter().cycle().skip(1);
    points.iter().zip(next).map(|(p, q)| (p - about).cross(q - about)).sum()
}

/// Puts loops together that bound one hole: an inner loop lies near the plane of the outer one, within it as seen along its
/// normal, and runs the other way.
///
/// ```text
///    ___________
///   |  _______  |      the patch is the ring between the loops,
///   | |island | |      and joins the island to what is around it
///   | |_______| |
///   |___________|
/// ```
///
/// Of several loops around a loop the smallest counts, and a loop in an inner loop is an outer one again. `face_normal`
/// tells the normal of the face at a border's edge. O(n log n) for loops that lie side by side; nested ones are looked at
/// within a bound, after which each is a hole of its own.
pub(super) fn group(
    positions: &[DVec3],
    loops: BoundaryLoops,
    parts: &Parts,
    face_normal: impl Fn(u32, u32) -> DVec3,
) -> Vec<Hole> {
    let shapes: Vec<Shape> = loops.simple.iter().map(|l| shape(positions, l, &face_normal)).collect();
    let part = |i: usize| parts.of_face[loops.face[i] as usize];
    let mut inner_of: Vec<Option<usize>> = vec![None; shapes.len()];
    if shapes.len() > 1 {
        let corners: Vec<DVec3> = shapes.iter().flat_map(|s| [s.bounds.min, s.bounds.max]).collect();
        #[expect(clippy::cast_possible_truncation, reason = "fewer loops than half-edges")]
        let boxes: Vec<[u32; 3]> = (0..shapes.len() as u32).map(|i| [2 * i, 2 * i + 1, 2 * i]).collect();
        let tree = Tree::in_frame(Frame::around(&corners, &boxes), &corners, &boxes);
        let mut order: Vec<usize> = (0..shapes.len()).collect();
        order.sort_by(|&i, &j| shapes[j].size.total_cmp(&shapes[i].size).then(i.cmp(&j)));
        let mut steps = STEPS;
        for &i in &order {
            let mut around: Option<usize> = None;
            tree.overlapping(&shapes[i].bounds, |f| {
                let j = f as usize;
                steps = steps.saturating_sub(1);
                let off = if part(i) == part(j) { OFF_PLANE_WITHIN } else { OFF_PLANE };
                let smaller =
                    shapes[j].size > shapes[i].size && around.is_none_or(|k| (shapes[j].size, k) < (shapes[k].size, j));
                if smaller && shapes[i].normal.dot(shapes[j].normal).abs() >= -LEAST_OPPOSED {
                    steps = steps.saturating_sub((loops.simple[i].len() + loops.simple[j].len()) as u64);
                    if lies_in(positions, &loops.simple[i], &loops.simple[j], &shapes[j], off) {
                        around = Some(j);
                    }
                }
                steps > 0
            });
            if steps == 0 {
                break;
            }
            let Some(j) = around else { continue };
            let opposed = shapes[i].normal.dot(shapes[j].normal) <= LEAST_OPPOSED;
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

fn shape(positions: &[DVec3], border: &[u32], face_normal: &impl Fn(u32, u32) -> DVec3) -> Shape {
    let points: Vec<DVec3> = border.iter().map(|&v| positions[v as usize]).collect();
    let newell = newell(&points);
    let normal = newell.try_normalize().unwrap_or(DVec3::ZERO);
    // A patch around an island looks the way of the outer loop, which runs against this one.
    let behind = [normal, -normal].map(|normal| {
        let next = border.iter().cycle().skip(1);
        let count = border.iter().zip(next).filter(|&(&a, &b)| face_normal(a, b).dot(normal) < BEHIND).count();
        2 * count > border.len()
    });
    let size = (newell.length() / 2.0).sqrt();
    Shape { bounds: Box3::of(points), normal, size, behind }
}

/// Whether a loop lies near the plane of another, and its first vertex in it as seen along the normal.
fn lies_in(positions: &[DVec3], inner: &[u32], outer: &[u32], shape: &Shape, off: f64) -> bool {
    let at = |v: &u32| positions[*v as usize];
    let count = f64::from(u32::try_from(outer.len()).unwrap_or(u32::MAX));
    let middle = outer.iter().map(at).sum::<DVec3>() / count;
    if inner.iter().any(|v| (at(v) - middle).dot(shape.normal).abs() > off * shape.size) {
        return false;
    }
    let x = shape.normal.any_orthonormal_vector();
    let y = shape.normal.cross(x);
    let place = at(&inner[0]);
    let seen = |v: &u32| ((at(v) - place).dot(x), (at(v) - place).dot(y));
    let next = outer.iter().cycle().skip(1);
    // Sides that cross the ray to the right: an odd number where the point is in the polygon.
    let crossed = outer.iter().zip(next).filter(|&(v, w)| {
        let ((ax, ay), (bx, by)) = (seen(v), seen(w));
        (ay > 0.0) != (by > 0.0) && ax - ay * (bx - ax) / (by - ay) > 0.0
    });
    crossed.count() % 2 == 1
}

impl Hole {
    /// Each loop as a hole of its own, the last one first.
    pub fn apart(self) -> impl Iterator<Item = Hole> {
        let extent = self.extent;
        let each = self.loops.into_iter().zip(self.parts).rev();
        each.map(move |(border, part)| Hole { loops: vec![border], parts: vec![part], extent })
    }
}
