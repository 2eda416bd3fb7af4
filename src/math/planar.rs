//! Triangulations of areas between polygons, in the plane that fits best.

use glam::DVec3;
use spade::handles::FixedVertexHandle;
use spade::{ConstrainedDelaunayTriangulation, HasPosition, Point2, Triangulation};

/// A coordinate plane is tried if the normal's component across it is at least this share of the largest component.
const MIN_TILT: f64 = 0.3;

/// A corner projected along an axis.
#[derive(Debug, Clone, Copy)]
struct Corner(Point2<f64>);

impl HasPosition for Corner {
    type Scalar = f64;

    fn position(&self) -> Point2<f64> {
        self.0
    }
}

/// The constrained Delaunay triangulation of the area between closed polygons, projected along an axis: one outer polygon,
/// counter-clockwise seen against `normal`, and any number of clockwise polygons inside it. `ends` holds the end of each
/// polygon in `points`.
///
/// The projection along an axis rounds no coordinate, so the test whether it is simple is exact. A patch with a simple
/// projection does not intersect itself. `None` where no projection is simple. O(n log n) time.
#[must_use]
pub fn triangulated_area(points: &[DVec3], ends: &[usize], normal: DVec3) -> Option<Vec<[usize; 3]>> {
    let mut next: Vec<usize> = (1..=points.len()).collect();
    let mut start = 0;
    for &end in ends {
        *next.get_mut(end.checked_sub(1)?)? = start;
        start = end;
    }
    let size = normal.abs();
    let mut axes = [0, 1, 2];
    axes.sort_by(|&i, &j| size[j].total_cmp(&size[i]));
    axes.into_iter().filter(|&k| size[k] > 0.0 && size[k] >= MIN_TILT * size[axes[0]]).find_map(|k| {
        let (x, y) = if normal[k] > 0.0 { ((k + 1) % 3, (k + 2) % 3) } else { ((k + 2) % 3, (k + 1) % 3) };
        triangulate_projection(points.iter().map(|p| Corner(Point2::new(p[x], p[y]))).collect(), &next, ends.len())
    })
}

/// Triangulates the area to the left of the constraints of a projection.
fn triangulate_projection(corners: Vec<Corner>, next: &[usize], polygons: usize) -> Option<Vec<[usize; 3]>> {
    let n = corners.len();
    let sides = next.iter().enumerate().map(|(i, &j)| [i, j]).collect();
    let mut simple = true;
    let cdt = ConstrainedDelaunayTriangulation::<Corner>::try_bulk_load_cdt(corners, sides, |_| simple = false).ok()?;
    // Coinciding corners are merged, and a side through a corner is split there.
    if !simple || cdt.num_vertices() != n || cdt.num_constraints() != n {
        return None;
    }
    let mut visited = vec![false; cdt.num_all_faces()];
    let mut stack = Vec::new();
    for (i, &j) in next.iter().enumerate() {
        let side = cdt.get_edge_from_neighbors(FixedVertexHandle::from_index(i), FixedVertexHandle::from_index(j))?;
        let face = side.face();
        if !std::mem::replace(&mut visited[face.fix().index()], true) {
            stack.push(face);
        }
    }
    let mut triangles = Vec::with_capacity(n);
    while let Some(face) = stack.pop() {
        let face = face.as_inner()?;
        for edge in face.adjacent_edges() {
            let beyond = edge.rev().face();
            if !edge.is_constraint_edge() && !std::mem::replace(&mut visited[beyond.fix().index()], true) {
                stack.push(beyond);
            }
        }
        triangles.push(face.vertices().map(|v| v.fix().index()));
    }
    (triangles.len() + 4 == n + 2 * polygons).then_some(triangles)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn circle(n: u32, radius: f64, z: impl Fn(f64) -> f64) -> Vec<DVec3> {
        let at = |i: u32| f64::from(i) / f64::from(n) * std::f64::consts::TAU;
        (0..n).map(|i| DVec3::new(radius * at(i).cos(), radius * at(i).sin(), z(at(i)))).collect()
    }

    fn area(points: &[DVec3], triangles: &[[usize; 3]]) -> f64 {
        let of = |t: &[usize; 3]| (points[t[1]] - points[t[0]]).cross(points[t[2]] - points[t[0]]).z / 2.0;
        triangles.iter().map(of).inspect(|&a| assert!(a > 0.0)).sum()
    }

    #[test]
    fn a_polygon_is_covered_once() {
        let points = circle(400, 1.0, |u| 0.1 * (3.0 * u).sin());
        let triangles = triangulated_area(&points, &[400], DVec3::Z).unwrap();
        assert_eq!(triangles.len(), 398);
        assert!((area(&points, &triangles) - 200.0 * (std::f64::consts::TAU / 400.0).sin()).abs() < 1e-9);
        assert_eq!(triangulated_area(&points, &[400], -DVec3::Z), None, "seen from behind, the polygon is clockwise");
    }

    #[test]
    fn holes_in_a_polygon_are_not_covered() {
        let mut points = circle(40, 2.0, |_| 0.0);
        points.extend(circle(20, 0.5, |_| 0.0).iter().rev().map(|p| *p + DVec3::X));
        points.extend(circle(20, 0.5, |_| 0.0).iter().rev().map(|p| *p - DVec3::X));
        let triangles = triangulated_area(&points, &[40, 60, 80], DVec3::Z).unwrap();
        assert_eq!(triangles.len(), 82);
        let ring = |n: f64, r: f64| n / 2.0 * r * r * (std::f64::consts::TAU / n).sin();
        assert!((area(&points, &triangles) - ring(40.0, 2.0) + 2.0 * ring(20.0, 0.5)).abs() < 1e-9);
    }

    #[test]
    fn a_polygon_with_a_self_touching_or_crossing_projection_has_no_planar_patch() {
        // The curve goes twice around the axis and rises and falls once.
        let coil: Vec<DVec3> = (0..48)
            .map(|i| {
                let u = f64::from(i) / 24.0 * std::f64::consts::TAU;
                let r = 2.0 + (u / 2.0 + 0.1).cos();
                DVec3::new(r * u.cos(), r * u.sin(), (u / 2.0).sin())
            })
            .collect();
        assert_eq!(triangulated_area(&coil, &[48], DVec3::Z), None);
        let at = |x: f64, y: f64| DVec3::new(x, y, 0.0);
        let touching = [at(0.0, 0.0), at(4.0, 0.0), at(4.0, 4.0), at(2.0, 0.0), at(0.0, 4.0)];
        assert_eq!(triangulated_area(&touching, &[5], DVec3::Z), None);
    }

    #[test]
    fn collinear_sides_give_no_triangle_without_area() {
        let mut points: Vec<DVec3> = (0..=10).map(|i| DVec3::new(f64::from(i), 0.0, 0.0)).collect();
        points.extend((0..=10).rev().map(|i| DVec3::new(f64::from(i), 1.0, 0.0)));
        let triangles = triangulated_area(&points, &[22], DVec3::Z).unwrap();
        assert!((area(&points, &triangles) - 10.0).abs() < 1e-12);
    }
}
