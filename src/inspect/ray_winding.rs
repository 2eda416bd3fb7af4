//! Winding numbers of a mesh from one ray per point and the mesh's border, which is fast for meshes with few border edges.

use glam::DVec3;

use super::Analysis;
use super::sampling::InsideTest;
use crate::math::{Crossing, crossing, winding_exact};
use crate::mesh::Edges;

/// Position of the apex in the bounding box, as a share of each side. Models rarely have a plane or an edge through such a
/// point.
const APEX: DVec3 = DVec3::new(0.414_213_562, 0.618_033_989, 0.532_050_808);
/// Length of the rays: longer than any distance between points of a mesh in unit coordinates, which reach 2.
const RAY_LENGTH: f64 = 8.0;
/// Largest coordinate of a point for which rays are cast.
const MAX_COORDINATE: f64 = 4.0;
/// Above one border triangle for so many faces, within these limits, a sum over clusters of faces is faster. Each point takes a step for
/// each border triangle, and the sum takes longer to prepare for more faces.
const FACES_PER_BORDER: usize = 500;
const BORDER_LIMITS: [usize; 2] = [200, 4_000];
/// Above this share of border triangles to faces, a sum over the faces is faster.
const MAX_BORDER_SHARE: usize = 2;

/// Winding numbers of a mesh around points.
///
/// A cone from an apex to the border closes the mesh. A ray that starts at the point and leads away from the apex never meets the cone.
/// So the ray's signed crossings with the mesh are the winding number of mesh and cone together. The winding number of the mesh alone is
/// that integer minus the cone's winding number, which is summed exactly.
pub(super) struct RayWinding<'a> {
    analysis: &'a Analysis<'a>,
    apex: DVec3,
    /// The triangles of the cone, or none if they are too many.
    cone: Option<Vec<[DVec3; 3]>>,
}

impl<'a> RayWinding<'a> {
    /// Prepares the queries, in time linear in the number of faces.
    pub fn new(analysis: &'a Analysis<'a>) -> Self {
        let extent = analysis.extent();
        let apex = extent.min + (extent.max - extent.min) * APEX;
        let cone = cone(analysis, apex);
        // Computed here, before several threads need it.
        analysis.tree();
        if cone.is_none() {
            analysis.dipoles();
        }
        Self { analysis, apex, cone }
    }

    /// Absolute value of the winding number at a point in unit coordinates, independent of the mesh's orientation.
    pub fn winding(&self, point: DVec3, steps: &mut u64) -> f64 {
        self.by_ray(point, steps).unwrap_or_else(|| InsideTest::new(self.analysis).winding(point, steps))
    }

    /// The winding number by a ray; none if the ray touches an edge, or if there is no cone.
    fn by_ray(&self, point: DVec3, steps: &mut u64) -> Option<f64> {
        let cone = self.cone.as_ref()?;
        let direction = (point - self.apex).try_normalize()?;
        if !point.abs().cmple(DVec3::splat(MAX_COORDINATE)).all() {
            return None;
        }
        let end = point + direction * RAY_LENGTH;
        let (mut sum, mut is_clean) = (0.0, true);
        self.analysis.tree().along(point, end, |face| {
            *steps = steps.saturating_sub(1);
            match crossing(point, end, self.analysis.unit_corners(face)) {
                Crossing::Miss => {}
                Crossing::Enters => sum -= 1.0,
                Crossing::Leaves => sum += 1.0,
                Crossing::Touches => is_clean = false,
            }
            is_clean && *steps > 0
        });
        *steps = steps.saturating_sub(cone.len() as u64);
        is_clean.then(|| (sum - winding_exact(point, cone.iter().copied())).abs())
    }
}

/// The cone from an apex to the border of a mesh; none if it has too many triangles. Each edge belongs to the border as often as more of its
/// half-edges run in one direction than in the other.
fn cone(analysis: &Analysis<'_>, apex: DVec3) -> Option<Vec<[DVec3; 3]>> {
    let (faces, unit) = (&analysis.surface.faces, analysis.unit());
    let limit =
        (faces.len() / FACES_PER_BORDER).clamp(BORDER_LIMITS[0], BORDER_LIMITS[1]).min(faces.len() / MAX_BORDER_SHARE);
    let mut cone = Vec::new();
    for (edge, half_edges) in analysis.edges.iter().enumerate() {
        let forward = half_edges.iter().filter(|&&half_edge| Edges::is_forward(faces, half_edge)).count();
        let backward = half_edges.len() - forward;
        if forward == backward {
            continue;
        }
        let [low, high] = analysis.edges.vertices(edge).map(|v| unit[v as usize]);
        let triangle = if forward > backward { [high, low, apex] } else { [low, high, apex] };
        cone.extend(std::iter::repeat_n(triangle, forward.abs_diff(backward)));
        if cone.len() > limit {
            return None;
        }
    }
    Some(cone)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;
    use std::time::Duration;

    use super::*;
    use crate::context::{Context, NoProgress};
    use crate::math::r3;
    use crate::mesh::Soup;

    /// Two overlapping octahedra subdivided once, without the faces that `is_left_out` names.
    fn octahedra(is_left_out: impl Fn(usize) -> bool) -> Soup {
        let mut soup = Soup { positions: Vec::new(), faces: Vec::new() };
        let corner = |axis: usize, sign: f64| {
            let mut p = DVec3::ZERO;
            p[axis] = sign;
            p
        };
        for shift in [DVec3::ZERO, DVec3::new(0.4, 0.3, 0.2)] {
            for octant in 0..8u32 {
                let sign = |axis: u32| if octant >> axis & 1 == 1 { -1.0 } else { 1.0 };
                let [a, mut b, mut c] = [0, 1, 2].map(|axis| corner(axis as usize, sign(axis)));
                if octant.count_ones() % 2 == 1 {
                    std::mem::swap(&mut b, &mut c);
                }
                let [ab, bc, ca] = [(a + b) * 0.6, (b + c) * 0.6, (c + a) * 0.6];
                for triangle in [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]] {
                    let first = u32::try_from(soup.positions.len()).expect("few vertices");
                    soup.positions.extend(triangle.map(|p| p + shift));
                    soup.faces.push([first, first + 1, first + 2]);
                }
            }
        }
        soup.faces = soup.faces.iter().enumerate().filter(|(i, _)| !is_left_out(*i)).map(|(_, &face)| face).collect();
        soup
    }

    fn assert_same_as_exact_sum(soup: &Soup) {
        let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(1));
        let analysis = Analysis::new(soup.into(), &context).expect("an analysis");
        let fast = RayWinding::new(&analysis);
        assert!(fast.cone.is_some(), "too much border");
        let mut answered = 0;
        for i in 0..500 {
            let point = DVec3::from(r3(f64::from(i))) * 3.0 - 1.5;
            let faces = (0u32..).take(analysis.surface.faces.len());
            let exact = winding_exact(point, faces.map(|f| analysis.unit_corners(f)));
            if let Some(number) = fast.by_ray(point, &mut u64::MAX.clone()) {
                answered += 1;
                assert!((number - exact.abs()).abs() < 1e-9, "{number} instead of {exact} at {point}");
            }
        }
        assert!(answered > 490, "{answered} of 500");
    }

    #[test]
    fn a_ray_gives_the_exact_winding_number_of_a_closed_mesh() {
        assert_same_as_exact_sum(&octahedra(|_| false));
    }

    #[test]
    fn a_ray_and_the_border_give_the_exact_winding_number_of_an_open_mesh() {
        assert_same_as_exact_sum(&octahedra(|i| i % 16 == 3 || i == 20));
    }

    #[test]
    fn a_ray_and_the_border_count_turned_faces_as_the_exact_sum_does() {
        let mut soup = octahedra(|i| i == 7);
        soup.faces[12].swap(0, 1);
        assert_same_as_exact_sum(&soup);
    }
}
