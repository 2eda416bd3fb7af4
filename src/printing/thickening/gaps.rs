//! Gaps near balls: the air that must stay free, so that no growth closes a wide gap.
//!
//! The middles of the largest balls of air between opposite sides say where a gap is wide. A ball of almost the least gap
//! around each middle stays free, so whatever passes along the middles still passes: no wide through hole is closed, and no
//! wide gap between solids is bridged.

use glam::DVec3;
use rustc_hash::FxHashSet;
use smallvec::SmallVec;

use crate::context::{Cancelled, Context};
use crate::math::{Box3, Tree, centre_and_radius, halves, nearest_on_segment, nearest_within};
use crate::mesh::{Edges, Surface};

use super::bodies::{MAX_BALLS, cell_of};
use super::clearance::STEPS;
use super::limits::{Filler, Limits};
use super::sampling::TriangleBudget;
use super::walls::{noise_of, trusted_normal};

/// The radius of a sample of the surface, as a share of what stays free. Middles are about twice as far apart.
const SAMPLE: f64 = 0.6;
/// The side of the cells in which one centre on the way to the middle suffices, as a share of what stays free.
const CLOSE: f64 = 0.3;
/// How far outside of balls the surface is sampled, as a share of what stays free.
const BESIDE: f64 = 1.0;
/// The largest length of the gradient of the distance to the surface, at the middle of a gap between opposite sides. Between
/// two planes it is the sine of half their angle, which is 36.9 degrees here.
const MAX_GRADIENT: f64 = 0.316_227_766;
/// A side that is farther from a middle than the nearest one by this factor counts, too.
const AS_NEAR: f64 = 1.1;
/// How far a point moves away from the nearest sides at once, as a share of their distance, and how often at most.
const MOVE: f64 = 0.5;
/// See [`MOVE`].
const MAX_MOVES: usize = 15;
/// The most steps towards the nearest point of a convex hull.
const HULL_STEPS: usize = 16;
/// The largest dot product of the normals at a sharp edge, and the cosine of the angle between directions from it: 36.9 degrees.
const SHARP: f64 = 0.8;
/// The most triangles that faces are split into.
const MAX_TRIANGLES: u64 = 1 << 23;

/// Which gaps are searched.
#[derive(Clone, Copy)]
pub struct GapWidths {
    /// The width from which a gap is wide.
    pub least: f64,
    /// The width from which balls cannot close a gap.
    pub most: f64,
    /// The distance from the middle of a wide gap that stays free.
    pub free: f64,
}

/// The middles of the wide gaps near some balls.
pub struct WideGaps {
    middles: Vec<DVec3>,
    tree: Tree,
    free: f64,
}

impl WideGaps {
    /// The wide gaps of the surface to thicken near some balls. None if there are too many samples.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub fn near(
        limits: &Limits<'_>,
        balls: &[Filler],
        widths: GapWidths,
        context: &Context<'_>,
    ) -> Result<Option<Self>, Cancelled> {
        let surface = limits.input;
        let samples = Samples::new(limits, balls, widths, context);
        let faces = (0u32..).take(surface.faces.len()).map(Sampled::Face);
        let all: Vec<Sampled> = faces.chain(sharp_edges(surface, samples.noise).map(Sampled::Edge)).collect();
        let mut found = context.map_in_parallel(&all, |sampled| samples.of(sampled))?.concat();
        let mut middles = Vec::new();
        for _ in 0..MAX_MOVES {
            let (ended, on_the_way): (Vec<Centre>, Vec<Centre>) =
                found.into_iter().partition(|centre| centre.is_middle);
            middles.extend(ended.iter().map(|centre| centre.at));
            let moved = context.map_in_parallel(&samples.distinct(on_the_way), |centre| samples.moved(centre))?;
            found = moved.into_iter().flatten().collect();
        }
        middles.extend(found.iter().filter(|centre| centre.is_middle).map(|centre| centre.at));
        // Both sides of a gap have the same middles, and faces that are smaller than a sample have more than needed.
        let mut known = FxHashSet::default();
        middles.retain(|middle| known.insert(cell_of(*middle, SAMPLE * widths.free)));
        if middles.len() > MAX_BALLS || samples.budget.is_exceeded() {
            return Ok(None);
        }
        // Where two sides touch except for rounding, a ball of air grows through both, to the middle of a wall.
        let in_air = |&middle: &DVec3| (!limits.is_inside(middle)).then_some(middle);
        let middles: Vec<DVec3> = context.map_in_parallel(&middles, in_air)?.into_iter().flatten().collect();
        let boxes: Vec<Box3> = middles.iter().map(|&middle| Box3::of([middle])).collect();
        Ok(Some(Self { middles, tree: Tree::of_boxes(&boxes), free: widths.free }))
    }

    /// A ball that leaves the gaps open. It moves away from them if it keeps its size there, since a wall at a wide gap can grow on
    /// its other side. Otherwise it gets smaller; nothing is left of one smaller than a cell.
    pub fn left_open_by(&self, ball: Filler, (limits, cell): (&Limits<'_>, f64)) -> Filler {
        let allowed = self.allowed(ball.centre, ball.radius);
        if allowed >= ball.radius {
            return ball;
        }
        let moved = self.clear_of(ball).map(|centre| {
            let mut moved = Filler { centre, slack: 0.0, ..ball };
            limits.apply(&mut moved, cell);
            moved
        });
        moved
            .filter(|moved| moved.radius > allowed)
            .unwrap_or(Filler { radius: if allowed < cell { 0.0 } else { allowed }, ..ball })
    }

    /// The nearest centre, by steps away from the nearest middle, at which a ball leaves the gaps open. None if that is too far.
    fn clear_of(&self, Filler { centre, radius, .. }: Filler) -> Option<DVec3> {
        let mut at = centre;
        for _ in 0..MAX_MOVES {
            let mut nearest = (radius + self.free, None);
            self.tree.overlapping(&Box3::of([at]).grown(nearest.0), |number| {
                let middle = self.middles[number as usize];
                let distance = middle.distance(at);
                if distance < (1.0 - 1e-9) * nearest.0 {
                    nearest = (distance, Some(middle));
                }
                true
            });
            let (distance, Some(middle)) = nearest else { return Some(at) };
            at += (at - middle).normalize_or_zero() * (radius + self.free - distance);
            if at.distance(centre) > radius {
                break;
            }
        }
        None
    }

    /// The largest radius, at most `radius`, of a ball that leaves the gaps open; negative if there is none.
    pub fn allowed(&self, centre: DVec3, radius: f64) -> f64 {
        let mut allowed = radius;
        self.tree.overlapping(&Box3::of([centre]).grown(radius + self.free), |middle| {
            allowed = allowed.min(self.middles[middle as usize].distance(centre) - self.free);
            true
        });
        allowed
    }
}

/// The search for the middles of gaps from samples of a surface near balls.
struct Samples<'a> {
    surface: &'a Surface,
    balls: &'a [Filler],
    /// A tree over the boxes of the balls, grown by the distance up to which the surface is sampled.
    tree_of_balls: Tree,
    /// A tree over the faces.
    tree: &'a Tree,
    /// Height of a triangle below which rounding decides its normal.
    noise: f64,
    widths: GapWidths,
    budget: TriangleBudget<'a>,
}

impl<'a> Samples<'a> {
    fn new(limits: &'a Limits<'_>, balls: &'a [Filler], widths: GapWidths, context: &'a Context<'a>) -> Self {
        let (surface, tree) = (limits.input, &limits.tree);
        let reach = |ball: &Filler| ball.radius + BESIDE * widths.free;
        let boxes: Vec<Box3> = balls.iter().map(|ball| Box3::of([ball.centre]).grown(reach(ball))).collect();
        let (tree_of_balls, noise) = (Tree::of_boxes(&boxes), noise_of(&surface.positions));
        Self { surface, balls, tree_of_balls, tree, noise, widths, budget: TriangleBudget::new(MAX_TRIANGLES, context) }
    }

    /// The centres of balls of air in front of a face or an edge, near balls.
    fn of(&self, sampled: &Sampled) -> Vec<Centre> {
        let mut centres = Vec::new();
        match sampled {
            Sampled::Face(face) => {
                let corners = self.surface.corners(*face as usize);
                let normal = trusted_normal(corners, self.noise);
                if normal != DVec3::ZERO {
                    self.at_points(corners, |point| centres.extend(self.centre_before(point, normal)));
                }
            }
            Sampled::Edge(SharpEdge { ends: [start, end], directions }) => {
                self.at_points([*start, *end, *end], |point| {
                    centres.extend(directions.iter().filter_map(|&direction| self.centre_before(point, direction)));
                })
            }
        }
        centres
    }

    /// Visits points of a triangle near balls, one for each small piece of it.
    fn at_points(&self, corners: [DVec3; 3], mut visit: impl FnMut(DVec3)) {
        let mut open = vec![corners];
        while let Some(corners) = open.pop().filter(|_| !self.budget.should_stop()) {
            let (centre, size) = centre_and_radius(corners);
            if !self.is_near_ball(corners, (centre, size)) {
                continue;
            }
            if size <= SAMPLE * self.widths.free {
                visit(centre);
            } else {
                open.extend(halves(corners));
            }
        }
    }

    fn is_near_ball(&self, corners: [DVec3; 3], (centre, size): (DVec3, f64)) -> bool {
        self.tree_of_balls.any_overlapping(&Box3::of(corners), |ball| {
            let ball = self.balls[ball as usize];
            ball.centre.distance(centre) < ball.radius + BESIDE * self.widths.free + size
        })
    }

    /// The centre of the largest ball of air in front of a point. None if it touches nothing, or if it is the middle of a narrow gap.
    fn centre_before(&self, point: DVec3, direction: DVec3) -> Option<Centre> {
        let corners = |face: u32| self.surface.corners(face as usize);
        let ball = self.tree.shrunk_ball([point, direction], self.widths.most / 2.0, &mut STEPS.clone(), corners)?;
        let (at, touched) = (point + direction * ball.radius, ball.touches?.point);
        let is_middle = far_from_zero(&[-direction, (touched - at).normalize_or_zero()]).is_none();
        self.unless_narrow(Centre { at, distance: ball.radius, is_middle })
    }

    /// Moves a centre away from the nearest sides. It ends in the middle of a gap, between sides that face each other, but not in a
    /// corner.
    ///
    /// In front of the sides of a polygonal hole the largest ball of air touches the next side, far from the middle. So the
    /// centre moves on until there is surface on opposite sides.
    fn moved(&self, &Centre { at, distance, .. }: &Centre) -> Option<Centre> {
        let Some(side) = far_from_zero(&self.sides(at, AS_NEAR * distance)) else {
            return self.unless_narrow(Centre { at, distance, is_middle: true });
        };
        let at = at - side * (MOVE * distance);
        let corners = |face: u32| self.surface.corners(face as usize);
        let distance = self.tree.nearest(at, self.widths.most / 2.0, &mut STEPS.clone(), corners)?.distance;
        Some(Centre { at, distance, is_middle: false })
    }

    fn unless_narrow(&self, centre: Centre) -> Option<Centre> {
        Some(centre).filter(|centre| !centre.is_middle || 2.0 * centre.distance >= self.widths.least)
    }

    /// The centres without those that are close to another one in the same gap: no surface is between two centres that are farther from
    /// the surface than from each other.
    fn distinct(&self, mut centres: Vec<Centre>) -> Vec<Centre> {
        let cell = CLOSE * self.widths.free;
        let mut known = FxHashSet::default();
        centres.retain(|centre| centre.distance < cell * 3f64.sqrt() || known.insert(cell_of(centre.at, cell)));
        centres
    }

    /// The directions from a point to the nearest points of the faces within reach.
    fn sides(&self, middle: DVec3, reach: f64) -> SmallVec<[DVec3; 16]> {
        let mut sides = SmallVec::new();
        self.tree.overlapping(&Box3::of([middle]).grown(reach), |face| {
            let found = nearest_within(middle, self.surface.corners(face as usize), reach);
            sides.extend(found.map(|other| (other - middle).normalize_or_zero()));
            true
        });
        sides
    }
}

/// The centre of a ball of air between sides of a gap.
#[derive(Clone, Copy)]
struct Centre {
    at: DVec3,
    /// The distance to the surface.
    distance: f64,
    /// Whether the ball touches the surface on opposite sides. Otherwise its centre moves on.
    is_middle: bool,
}

/// Where gaps are searched from.
enum Sampled {
    Face(u32),
    Edge(SharpEdge),
}

/// A sharp convex edge, with directions between the normals of its faces.
struct SharpEdge {
    ends: [DVec3; 2],
    directions: SmallVec<[DVec3; 4]>,
}

/// The sharp convex edges of a surface. The sides of a gap may meet it in edges only.
fn sharp_edges(surface: &Surface, noise: f64) -> impl Iterator<Item = SharpEdge> {
    let edges = Edges::new(&surface.faces);
    (0..edges.len()).filter_map(move |edge| {
        let &[one, other] = edges.half_edges(edge) else { return None };
        let normals = [one, other].map(|half_edge| trusted_normal(surface.corners(half_edge as usize / 3), noise));
        let ends = edges.vertices(edge).map(|vertex| surface.positions[vertex as usize]);
        let beyond = surface.positions[Edges::opposite(&surface.faces, other) as usize];
        let is_convex = (beyond - ends[0]).dot(normals[0]) < 0.0;
        let is_known = normals.iter().all(|normal| *normal != DVec3::ZERO);
        (is_known && is_convex && normals[0].dot(normals[1]) < SHARP)
            .then(|| SharpEdge { ends, directions: directions_between(normals) })
    })
}

/// Directions between two unit vectors, without these, that are at most the angle of a sharp edge apart.
fn directions_between([one, other]: [DVec3; 2]) -> SmallVec<[DVec3; 4]> {
    let steps = (1u32..).find(|&steps| one.angle_between(other) <= f64::from(steps) * SHARP.acos()).unwrap_or(1);
    let at = |k: u32| one.slerp(other, f64::from(k) / f64::from(steps));
    (1..steps).map(at).filter(|direction| direction.is_finite()).collect()
}

/// The point nearest to zero of the convex hull of directions (Gilbert 1966), if it is farther than [`MAX_GRADIENT`]. For the
/// directions from a point to the nearest points of a surface, it is the gradient of the distance with its sign reversed.
fn far_from_zero(directions: &[DVec3]) -> Option<DVec3> {
    let mut nearest = *directions.first()?;
    for _ in 0..HULL_STEPS {
        if nearest.length() <= MAX_GRADIENT {
            return None;
        }
        let along = |direction: &&DVec3| direction.dot(nearest);
        let next = directions.iter().min_by(|a, b| along(a).total_cmp(&along(b)))?;
        let closer = nearest_on_segment(DVec3::ZERO, [nearest, *next]);
        if closer.length() >= nearest.length() {
            break;
        }
        nearest = closer;
    }
    Some(nearest)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;
    use std::sync::atomic::AtomicBool;
    use std::time::Duration;

    use super::*;
    use crate::context::{NoProgress, monotonic_clock};
    use crate::math::Precision;
    use crate::printing::shapes::cuboid;
    use crate::printing::thickening::{Growth, Thickening};

    const WIDTHS: GapWidths = GapWidths { least: 0.5, most: 2.5, free: 0.25 };
    const SETTINGS: Thickening =
        Thickening { min_wall: 1.0, growth: Growth::Both, min_gap: 0.5, precision: Precision::F32 };

    /// Two plates of 10 by 10 with the thickness 0.6 and a gap, the lower one on the ground.
    fn plates(gap: f64) -> Surface {
        let mut surface = cuboid(DVec3::ZERO, DVec3::new(10.0, 10.0, 0.6));
        surface.append(cuboid(DVec3::Z * (0.6 + gap), DVec3::new(10.0, 10.0, 1.2 + gap)));
        surface
    }

    /// The gaps near a ball.
    fn near(limits: &Limits<'_>, ball: Filler) -> WideGaps {
        let (clock, cancel) = (monotonic_clock(), AtomicBool::new(false));
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(60));
        WideGaps::near(limits, &[ball], WIDTHS, &context).unwrap().unwrap()
    }

    /// The radius that is left of a ball near the gaps of a surface.
    fn left(surface: &Surface, centre: DVec3, radius: f64) -> f64 {
        near(&Limits::new(surface, SETTINGS), Filler::new(centre, radius)).allowed(centre, radius)
    }

    #[test]
    fn a_ball_leaves_half_of_the_least_gap_before_the_middle_of_a_wide_gap() {
        let radius = |gap: f64| left(&plates(gap), DVec3::new(5.0, 5.0, 0.3), 0.9);
        // The middle of the gap is at 0.6 + 0.4, and 0.25 of it stay free.
        assert!((radius(0.8) - 0.45).abs() < 0.02, "{}", radius(0.8));
        assert_eq!(radius(0.49), 0.9, "a narrow gap");
        assert_eq!(radius(2.4), 0.9, "a gap that the ball does not reach");
    }

    #[test]
    fn a_ball_beside_a_wide_gap_moves_to_the_free_side_of_its_wall() {
        let plates = plates(0.8);
        let limits = Limits::new(&plates, SETTINGS);
        let open = |centre: DVec3| {
            let ball = Filler::new(centre, 0.6);
            near(&limits, ball).left_open_by(ball, (&limits, 0.2))
        };
        // The middle of the gap is at 1, and 0.25 of it stay free.
        let lower = open(DVec3::new(5.0, 5.0, 0.3));
        assert!((lower.radius - 0.6).abs() < 0.01 && (lower.centre.z - 0.15).abs() < 0.02, "{lower:?}");
        // In the gap, there is no side to move to.
        let between = open(DVec3::new(5.0, 5.0, 1.0));
        assert_eq!(between.radius, 0.0);
    }

    #[test]
    fn plates_that_touch_except_for_rounding_have_no_wide_gap_between_them() {
        for gap in [1e-9, 1e-7, 1e-5] {
            assert_eq!(left(&plates(gap), DVec3::new(5.0, 5.0, 0.3), 0.55), 0.55, "{gap}");
        }
    }

    #[test]
    fn a_ball_in_the_corner_between_two_walls_is_not_limited() {
        // Turned inside out, a box has corners of air.
        let mut corner = cuboid(DVec3::splat(-5.0), DVec3::splat(5.0));
        corner.faces.iter_mut().for_each(|face| face.reverse());
        assert_eq!(left(&corner, DVec3::new(4.9, 4.9, 0.0), 0.9), 0.9);
    }

    /// The surface that closed paths of points make, of which each has as many points, from one path to the next.
    fn between_paths(paths: &[Vec<DVec3>]) -> Surface {
        let n = index(paths[0].len());
        let quad = |path: u32, k: u32| {
            let [a, b] = [k, (k + 1) % n].map(|k| path * n + k);
            [[a, a + n, b], [b, a + n, b + n]]
        };
        let count = index(paths.len()) - 1;
        let faces: Vec<[u32; 3]> = (0..count).flat_map(|path| (0..n).flat_map(move |k| quad(path, k))).collect();
        let source = (0..index(faces.len())).collect();
        Surface { positions: paths.concat(), faces, source }
    }

    fn index(count: usize) -> u32 {
        u32::try_from(count).unwrap()
    }

    /// A regular polygon around the z axis.
    fn polygon(n: u32, radius: f64, z: f64) -> Vec<DVec3> {
        let at = |k: u32| (TAU * f64::from(k) / f64::from(n)).sin_cos();
        (0..n).map(at).map(|(sin, cos)| DVec3::new(radius * cos, radius * sin, z)).collect()
    }

    #[test]
    fn a_hole_of_any_number_of_sides_stays_open() {
        for n in [3, 4, 5, 7, 12, 31] {
            // The wall of a hole, whose sides are 0.6 from its axis.
            let radius = 0.6 / (TAU / 2.0 / f64::from(n)).cos();
            let hole = between_paths(&[-5.0, 5.0].map(|z| polygon(n, radius, z)));
            let [one, next] = [hole.positions[0], hole.positions[1]];
            let side = one.midpoint(next).with_z(0.0);
            let left = left(&hole, side * 1.2, 0.9);
            assert!((0.2..1.2 * 0.6 - 0.2).contains(&left), "{left} for {n} sides");
        }
    }

    #[test]
    fn a_hole_with_a_sharp_rim_stays_open() {
        for n in [4, 12, 31] {
            let ring = between_paths(&[polygon(n, 1.0, -0.4), polygon(n, 0.6, 0.0), polygon(n, 1.0, 0.4)]);
            let left = left(&ring, DVec3::X * 0.9, 0.9);
            assert!((0.3..0.7).contains(&left), "{left} for {n} sides");
        }
    }
}
