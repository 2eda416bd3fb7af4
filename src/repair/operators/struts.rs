//! Struts that join separate solids to the largest one.

use glam::DVec3;

use super::solid_skin::resolve;
use crate::context::{Cancelled, Context};
use crate::inspect::{solids, spread_by_area};
use crate::math::{Precision, Tree};
use crate::mesh::{Edges, Parts, Surface};

/// Sides of a strut.
const SIDES: u32 = 8;
/// Boxes and faces that one search may visit.
const STEPS: u64 = 1 << 24;
/// Points of a solid from which a strut may start: at most, at least, and of all solids together.
const SAMPLES: [u32; 3] = [2000, 100, 100_000];
/// How much longer a strut may be at a place where its whole end meets the solids, in radii, than at one where nothing does.
const LONGER: f64 = 4.0;

/// Joins every separate solid to the largest one with a prism of the given diameter, in the model's unit, and unites them. Returns
/// the number of struts; 0 if the union failed, and the surface is unchanged then.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub(super) fn attach(
    surface: &mut Surface,
    diameter: f64,
    precision: Precision,
    context: &Context<'_>,
) -> Result<u64, Cancelled> {
    let edges = Edges::new(&surface.faces);
    let parts = Parts::new(surface, &edges);
    let solids = solids(surface, &edges, &parts);
    let Some(largest) = (0..parts.count).max_by(|&a, &b| solids[a].volume.total_cmp(&solids[b].volume)) else {
        return Ok(0);
    };
    let islands = || (0..parts.count).filter(|&part| part != largest && solids[part].volume > 0.0);
    #[expect(clippy::cast_possible_truncation, reason = "parts are counted in u32")]
    let samples = (SAMPLES[2] / (islands().count().max(1) as u32)).clamp(SAMPLES[1], SAMPLES[0]);
    let faces = parts.faces();
    let places = Places::new(surface, &faces[largest], diameter / 2.0, context);
    let mut joined = surface.clone();
    let mut count = 0;
    for island in islands() {
        if let Some(strut) = places.strut(&faces[island], samples)? {
            strut.push(&mut joined, diameter / 2.0, precision);
            count += 1;
        }
    }
    if count == 0 || !resolve(&mut joined, context)? {
        return Ok(0);
    }
    *surface = joined;
    Ok(count)
}

/// Search for the places of struts.
struct Places<'a> {
    surface: &'a Surface,
    /// The tree of all faces.
    tree: Tree,
    /// The faces of the largest solid, and their tree.
    main: &'a [u32],
    main_tree: Tree,
    radius: f64,
    /// The diagonal of the box around all solids.
    diagonal: f64,
    context: &'a Context<'a>,
}

/// The way from a point of a solid to the nearest point of the largest solid.
struct Way {
    points: [DVec3; 2],
    /// The faces at the two ends; none at a vertex.
    faces: [Option<u32>; 2],
}

/// The line of a strut, whose ends lie inside the two solids.
struct Strut([DVec3; 2]);

impl<'a> Places<'a> {
    fn new(surface: &'a Surface, main: &'a [u32], radius: f64, context: &'a Context<'a>) -> Self {
        let of_main: Vec<[u32; 3]> = main.iter().map(|&f| surface.faces[f as usize]).collect();
        let main_tree = Tree::new(&surface.positions, &of_main);
        let (tree, diagonal) = (Tree::new(&surface.positions, &surface.faces), surface.bounds().diagonal());
        Self { surface, tree, main, main_tree, radius, diagonal, context }
    }

    /// The place of the strut from a solid with these faces: where the way is short, and both solids hold the whole end of the
    /// strut. A strut from the corner of a box would be half outside the box, and thinner than its diameter there.
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    fn strut(&self, island: &[u32], samples: u32) -> Result<Option<Strut>, Cancelled> {
        self.context.check()?;
        let ways = self.ways(island, samples);
        let Some(shortest) = ways.iter().map(Way::length).min_by(f64::total_cmp) else { return Ok(None) };
        let slack = 1e-6 * (self.radius + shortest);
        // The best strut, with its cost and its depth, and the most that a better one may cost.
        let (mut best, mut most): (Option<(f64, f64, Strut)>, _) = (None, shortest + LONGER * self.radius);
        for way in &ways {
            self.context.check()?;
            // The length alone is often more, and needs no search.
            if way.length() > most {
                continue;
            }
            let cost = way.length() + LONGER * self.radius * (1.0 - self.held(way));
            if cost > most {
                continue;
            }
            let depths = [0, 1].map(|end| way.faces[end].map_or(0.0, |face| self.depth(way.points[end], face)));
            let depth = depths[0].min(depths[1]);
            // Of places with equal costs, the thickest is the farthest from edges.
            let is_better = |&(least, deepest, _): &(f64, f64, Strut)| cost < least - slack || depth > deepest;
            if best.as_ref().is_none_or(is_better) {
                best = Some((cost, depth, self.along(way, depths)));
                most = cost + slack;
            }
        }
        Ok(best.map(|(.., strut)| strut))
    }

    /// The share of the corners of a strut along a way from which lines parallel to the way soon meet the solids.
    fn held(&self, way: &Way) -> f64 {
        let [from, to] = way.points;
        let (middle, axis) = (from.midpoint(to), (to - from).normalize_or_zero());
        let reach = axis * (way.length() / 2.0 + self.radius);
        let lines = corners(axis, self.radius).flat_map(|aside| [(middle + aside, reach), (middle + aside, -reach)]);
        let meets = |&(start, step): &(DVec3, DVec3)| {
            let corners = |f: u32| self.surface.corners(f as usize);
            self.tree.first_hit([start, step], None, &mut STEPS.clone(), corners).is_some()
        };
        lines.filter(meets).count() as f64 / f64::from(2 * SIDES)
    }

    /// The ways from the vertices of a solid, and from points spread over its faces. Ways that are too long are left out.
    fn ways(&self, island: &[u32], samples: u32) -> Vec<Way> {
        let (surface, corners) = (self.surface, |f: u32| self.surface.corners(f as usize));
        let area = |f: u32| surface.area_vector(f as usize).length();
        let spread = spread_by_area(island.iter().copied(), samples, area, corners);
        let mut vertices: Vec<u32> = island.iter().flat_map(|&f| surface.faces[f as usize]).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let vertices = vertices.into_iter().map(|v| (None, surface.positions[v as usize]));
        let points = vertices.chain(spread.into_iter().map(|(face, point)| (Some(face), point)));
        let mut shortest = f64::INFINITY;
        let way = |(face, from): (Option<u32>, DVec3)| {
            let bound = shortest + LONGER * self.radius;
            let corners = |f: u32| corners(self.main[f as usize]);
            let found = self.main_tree.nearest(from, bound, &mut STEPS.clone(), corners)?;
            shortest = shortest.min(found.distance);
            let faces = [face, Some(self.main[found.face as usize])];
            (from != found.point).then_some(Way { points: [from, found.point], faces })
        };
        points.filter_map(way).collect()
    }

    /// The radius of the largest ball in a solid that touches a face at a point.
    fn depth(&self, at: DVec3, face: u32) -> f64 {
        let inward = -self.surface.area_vector(face as usize).normalize_or_zero();
        let corners = |f: u32| self.surface.corners(f as usize);
        let ball = self.tree.shrunk_ball([at, inward], self.diagonal, &mut STEPS.clone(), corners);
        ball.filter(|_| inward != DVec3::ZERO).map_or(0.0, |ball| ball.radius)
    }

    /// The strut along a way. It reaches into each solid by its radius, but only to the middle of a thinner solid.
    fn along(&self, way: &Way, depths: [f64; 2]) -> Strut {
        let [from, to] = way.points;
        let axis = (to - from).normalize_or_zero();
        let [before, after] = depths.map(|depth| if depth > 0.0 { depth.min(self.radius) } else { self.radius });
        Strut([from - axis * before, to + axis * after])
    }
}

impl Way {
    fn length(&self) -> f64 {
        self.points[0].distance(self.points[1])
    }
}

impl Strut {
    /// Adds the strut to a surface as a closed prism.
    fn push(self, surface: &mut Surface, radius: f64, precision: Precision) {
        let axis = (self.0[1] - self.0[0]).normalize_or_zero();
        let ring = |end: DVec3| corners(axis, radius).map(|aside| precision.round(end + aside)).collect::<Vec<_>>();
        let [low, high] = self.0.map(ring);
        surface.push_prism([&low, &high], false);
    }
}

/// The corners of a regular polygon across an axis, circumscribed to a circle, so that its sides are a diameter apart.
fn corners(axis: DVec3, radius: f64) -> impl Iterator<Item = DVec3> {
    let (u, v) = axis.any_orthonormal_pair();
    let reach = radius / (std::f64::consts::PI / f64::from(SIDES)).cos();
    let angle = |side: u32| std::f64::consts::TAU * f64::from(side) / f64::from(SIDES);
    (0..SIDES).map(move |side| (u * angle(side).cos() + v * angle(side).sin()) * reach)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::ClosedSurface;
    use crate::printing::shapes::{cuboid, joined, quietly, sphere, volume};
    use crate::printing::thickness::{Space, opposed_pairs};

    fn attached(solids: &[Surface], diameter: f64) -> Surface {
        let mut surface = joined(solids);
        quietly(|context| {
            let struts = attach(&mut surface, diameter, Precision::F32, context).unwrap();
            assert_eq!(struts, solids.len() as u64 - 1);
        });
        let edges = Edges::new(&surface.faces);
        assert!(ClosedSurface::new(&surface, &edges).is_ok());
        assert_eq!(Parts::new(&surface, &edges).count, 1);
        surface
    }

    /// The area of a regular octagon whose sides are this far apart.
    fn octagon(diameter: f64) -> f64 {
        diameter * diameter * 2.0 * (std::f64::consts::SQRT_2 - 1.0)
    }

    #[test]
    fn a_strut_stands_in_the_middle_of_the_sides_that_face_each_other() {
        let [block, small] = [
            cuboid(DVec3::ZERO, DVec3::splat(20.0)),
            cuboid(DVec3::new(21.5, 10.0, 10.0), DVec3::new(23.5, 12.0, 12.0)),
        ];
        let surface = attached(&[block, small], 1.0);
        let added = volume(&surface) - 8000.0 - 8.0;
        assert!((added / (1.5 * octagon(1.0)) - 1.0).abs() < 1e-3, "{added}");
        let between = surface.positions.iter().filter(|p| p.x == 21.5 && p.y > 10.0 && p.y < 12.0);
        assert!(between.clone().count() >= 8 && between.into_iter().all(|p| (p.y - 11.0).hypot(p.z - 11.0) < 0.7));
    }

    #[test]
    fn a_strut_does_not_come_out_behind_a_thin_solid() {
        let plate = cuboid(DVec3::new(21.0, 5.0, 5.0), DVec3::new(21.25, 15.0, 15.0));
        let surface = attached(&[cuboid(DVec3::ZERO, DVec3::splat(20.0)), plate], 2.0);
        assert_eq!(surface.bounds().max.x, 21.25);
        let added = volume(&surface) - 8000.0 - 25.0;
        assert!((added / octagon(2.0) - 1.0).abs() < 1e-3, "{added}");
    }

    #[test]
    fn a_strut_between_balls_takes_the_shortest_way() {
        let mut small = sphere(1.0, 2);
        small.positions.iter_mut().for_each(|p| *p += DVec3::new(7.0, 0.0, 0.0));
        let surface = attached(&[sphere(5.0, 3), small], 0.4);
        let apart = volume(&sphere(5.0, 3)) + volume(&sphere(1.0, 2));
        let added = volume(&surface) - apart;
        assert!((0.9..1.5).contains(&(added / octagon(0.4))), "{added}");
    }

    #[test]
    fn walls_beside_a_strut_that_ends_at_an_edge_are_measured() {
        let [block, small] = [
            cuboid(DVec3::ZERO, DVec3::splat(20.0)),
            cuboid(DVec3::new(21.5, 10.0, 10.0), DVec3::new(23.5, 12.0, 12.0)),
        ];
        let mut surface = joined(&[block, small]);
        Strut([DVec3::new(22.0, 10.0, 12.0), DVec3::new(19.5, 10.0, 12.0)]).push(&mut surface, 0.5, Precision::F32);
        quietly(|context| {
            assert!(resolve(&mut surface, context).unwrap());
            for side in [Space::Material, Space::Air] {
                let found = opposed_pairs(&surface, 1.5, side, context).unwrap();
                assert!(found.is_complete, "{side:?}: {:?}", found.undecided_faces);
            }
        });
    }
}
