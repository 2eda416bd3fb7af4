//! Wall thickness at a point, and the search for the thinnest wall in each region of the model.

use glam::DVec3;

use crate::context::{Cancelled, Context};
use crate::inspect::Analysis;
use crate::inspect::sampling::{InsideTest, QUERY_BUDGET_DIVISOR, Sample, SpreadOrder, run_each, samples};
use crate::math::{Box3, OppositeFaces, hit};

/// Winding numbers from which a point is in material, and up to which it is in air. Otherwise the surface is too open.
const MATERIAL: f64 = 0.75;
const AIR: f64 = 0.25;
/// Offset from the surface of tests for material and air: a fraction of the diagonal, and at least f64's resolution.
const SIDE_OFFSET: [f64; 2] = [1e-9, 1e-13];
/// Rays ignore faces nearer than this fraction of the diagonal, since these touch the ray's own face.
const TOUCHING: f64 = 1e-6;
/// Cosine of 30 degrees: two faces form a wall if they point away from each other to within this angle. Excludes the
/// edges of a box, where faces are near each other without forming a thin wall.
const OPPOSITE: f64 = 0.866_025_403_784_438_6;
/// Cosine of 37 degrees: the same limit for a ball that touches both sides, whose direction varies with the point.
const BALL_OPPOSITE: f64 = 0.8;
/// Maximum number of faces that a ray may pass inside the material, for example in overlapping parts.
const MAX_PASSED: usize = 16;
/// Number of regions along the longest side of the bounding box. Each region keeps its thinnest wall.
const REGIONS: f64 = 16.0;
/// Limits of thin walls: a fraction of the diagonal, or a multiple of the thinnest wall, whichever is larger.
const THIN: f64 = 0.02;
const THIN_MULTIPLE: f64 = 1.25;
/// Maximum number of regions that the report lists.
const MAX_REGIONS: usize = 100;
/// Number of points spread by area: an eighth of the number of faces, within these limits.
const SPREAD_POINTS: [usize; 2] = [512, 100_000];
/// Number of points per block, initially and at most. Thin walls found in a block shorten the rays of the next.
const BLOCK: [usize; 2] = [256, 16_384];
/// Minimum number of points per thread.
const MIN_PER_THREAD: usize = 64;
/// Budget of the search: boxes and triangles visited, plus an allowance per point. Smaller for an unprintable mesh,
/// where material tests cost more and the walls are not the ones to be printed.
const BUDGET: [u64; 2] = [10_000_000, 200];
const UNPRINTABLE_BUDGET: [u64; 2] = [1_000_000, 30];
/// Maximum number of moves towards a thinner wall, and the fractions of the way that each move tries.
const MOVES: usize = 16;
const STEP_FRACTIONS: [f64; 3] = [0.999, 0.75, 0.25];
/// Budget of all moves: boxes and triangles visited.
const MOVES_BUDGET: u64 = 1_000_000;

/// A measured wall, in unit coordinates.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wall {
    pub thickness: f64,
    /// Point from which the thickness was measured.
    pub point: DVec3,
    /// Face of that point, and the opposite face.
    pub faces: [u32; 2],
}

/// Result of measuring at one sample.
pub(super) enum Probe {
    /// The surface does not separate material from air here.
    NotSolid,
    /// No opposite face within the requested length.
    NoWall,
    /// Thickness in unit coordinates, and the opposite face.
    Wall(f64, u32),
}

/// Measures the wall thickness at single points.
pub(super) struct WallProber<'a> {
    analysis: &'a Analysis<'a>,
    material: Material<'a>,
    /// A length greater than any wall thickness.
    pub reach: f64,
    side_offset: f64,
    touching: f64,
}

/// How to decide on which side of a face the material is.
enum Material<'a> {
    /// Every face of these parts has material behind and air in front, and no other face separates the two. With an
    /// index of the faces by direction.
    Bounded(Vec<bool>, OppositeFaces<'a>),
    /// Winding numbers at points near the face decide.
    Measured(InsideTest<'a>),
}

impl<'a> WallProber<'a> {
    /// `bounding` is the result of [`bounding_parts`](super::bounding_parts).
    pub fn new(analysis: &'a Analysis<'a>, bounding: Option<Vec<bool>>) -> Self {
        let diagonal = analysis.unit_diagonal();
        let side_offset = (SIDE_OFFSET[0] * diagonal).max(SIDE_OFFSET[1]);
        let material = match bounding {
            Some(parts) => {
                let normal = |face: u32| {
                    let bounds = is_bounding(analysis, &parts, face);
                    if bounds { analysis.unit_normal(face) } else { DVec3::ZERO }
                };
                let opposite = analysis.tree().opposite_faces(OPPOSITE, normal);
                Material::Bounded(parts, opposite)
            }
            None => Material::Measured(InsideTest::new(analysis)),
        };
        Self { analysis, material, reach: 2.0 * diagonal, side_offset, touching: TOUCHING * diagonal }
    }

    /// For each face, whether a wall of at most `longest` may be behind the face.
    pub fn may_have_wall(&self, longest: f64) -> Vec<bool> {
        let faces = self.analysis.surface.faces.len();
        match &self.material {
            Material::Bounded(_, opposite) => opposite.may_be_within(longest.min(self.reach), faces),
            // Parts may be inside out.
            Material::Measured(_) => vec![true; faces],
        }
    }

    /// Measures the wall of at most `longest` behind a sample with an inward ray. Tests whether the surface separates
    /// material from air only if a ray hits a face within that length, or if the length is unlimited.
    pub fn probe(&self, sample: &Sample, longest: f64, steps: &mut u64) -> Probe {
        let has_none = match &self.material {
            Material::Bounded(parts, opposite) => {
                is_bounding(self.analysis, parts, sample.face) && !self.meets_opposite(opposite, sample, longest, steps)
            }
            Material::Measured(_) => longest < self.reach && !self.meets_anything(sample, longest, steps),
        };
        if has_none {
            return Probe::NoWall;
        }
        let Some(inward) = self.inward(sample, steps) else { return Probe::NotSolid };
        let Some((length, face)) = self.path_to_air(sample, inward, longest, steps) else { return Probe::NoWall };
        if self.is_opposite(face, inward, OPPOSITE) { Probe::Wall(length, face) } else { Probe::NoWall }
    }

    /// Measures the wall behind a sample with an inward ray and with an inscribed ball, and returns the thinner one.
    /// The ball touches the sample and shrinks until it contains no surface (Ma et al. 2012).
    pub fn probe_by_ball(&self, sample: &Sample, steps: &mut u64) -> Probe {
        let Some(inward) = self.inward(sample, steps) else { return Probe::NotSolid };
        let Some((length, face)) = self.path_to_air(sample, inward, self.reach, steps) else { return Probe::NoWall };
        if let Some(wall) = self.ball(sample.point, inward, length / 2.0, steps) {
            return wall;
        }
        if self.is_opposite(face, inward, BALL_OPPOSITE) { Probe::Wall(length, face) } else { Probe::NoWall }
    }

    fn is_opposite(&self, face: u32, inward: DVec3, cosine: f64) -> bool {
        let along = self.analysis.unit_normal(face).dot(inward);
        // A part turned inside out has its faces' normals inward.
        (if self.is_measured() { along.abs() } else { along }) >= cosine
    }

    fn is_measured(&self) -> bool {
        matches!(self.material, Material::Measured(_))
    }

    /// Whether a ray from a sample against its normal hits an opposite face within a length.
    fn meets_opposite(&self, opposite: &OppositeFaces<'_>, sample: &Sample, longest: f64, steps: &mut u64) -> bool {
        let (ray, min_fraction) = (-sample.normal * longest, self.touching / longest);
        opposite.any_along([sample.point, sample.point + ray], sample.normal, steps, |face| {
            let fraction = hit(sample.point, ray, self.analysis.unit_corners(face));
            face != sample.face && fraction.is_some_and(|fraction| fraction > min_fraction)
        })
    }

    /// Whether a face is within a length of a sample along its normal, on either side.
    fn meets_anything(&self, sample: &Sample, longest: f64, steps: &mut u64) -> bool {
        let rays = [-sample.normal * longest, sample.normal * longest];
        rays.into_iter().any(|ray| self.first_hit(sample, ray, None, steps).is_some())
    }

    /// The first face that a ray from a sample hits, with the position as a fraction of the ray.
    fn first_hit(&self, sample: &Sample, ray: DVec3, after: Option<(f64, u32)>, steps: &mut u64) -> Option<(f64, u32)> {
        let min_fraction = self.touching / ray.length();
        self.analysis.tree().first_along([sample.point, sample.point + ray], after, steps, |face| {
            let other = face != sample.face && self.may_end_material(face);
            let fraction = other.then(|| hit(sample.point, ray, self.analysis.unit_corners(face))).flatten();
            fraction.filter(|&fraction| fraction > min_fraction)
        })
    }

    /// Direction from a sample into the material; `None` unless there is material on one side and air on the other.
    fn inward(&self, sample: &Sample, steps: &mut u64) -> Option<DVec3> {
        let inside = match &self.material {
            Material::Bounded(parts, _) => {
                return is_bounding(self.analysis, parts, sample.face).then_some(-sample.normal);
            }
            Material::Measured(inside) => inside,
        };
        let [front, back] = inside.windings(sample.point, sample.normal * self.side_offset, steps);
        if front < AIR && back > MATERIAL {
            Some(-sample.normal)
        } else {
            (back < AIR && front > MATERIAL).then_some(sample.normal)
        }
    }

    /// Whether air may begin behind a face that a ray hits from inside the material.
    fn may_end_material(&self, face: u32) -> bool {
        match &self.material {
            Material::Bounded(parts, _) => is_bounding(self.analysis, parts, face),
            Material::Measured(_) => true,
        }
    }

    /// Whether a point just behind such a face is in air.
    fn is_air(&self, beyond: DVec3, steps: &mut u64) -> bool {
        match &self.material {
            Material::Bounded(..) => true,
            Material::Measured(inside) => inside.winding(beyond, steps) < AIR,
        }
    }

    /// Distance from a sample through the material to the air, if at most `longest`, and the face there.
    fn path_to_air(&self, sample: &Sample, inward: DVec3, longest: f64, steps: &mut u64) -> Option<(f64, u32)> {
        let ray = inward * longest;
        let mut passed = None;
        for _ in 0..MAX_PASSED {
            let first_hit = self.first_hit(sample, ray, passed, steps);
            let (fraction, face) = first_hit.filter(|_| *steps > 0)?;
            let length = fraction * longest;
            if self.is_air(sample.point + inward * (length + self.side_offset), steps) {
                return Some((length, face)).filter(|_| *steps > 0);
            }
            passed = first_hit;
        }
        None
    }

    /// The wall given by the largest ball of at most `radius` that touches `point` from inside, if the ball touches
    /// an opposite face.
    fn ball(&self, point: DVec3, inward: DVec3, radius: f64, steps: &mut u64) -> Option<Probe> {
        let ball =
            self.analysis.tree().shrunk_ball([point, inward], radius, steps, |f| self.analysis.unit_corners(f))?;
        let contact = ball.touches.filter(|_| *steps > 0)?;
        let outward = (contact.point - (point + inward * ball.radius)) / ball.radius;
        let beyond = contact.point + outward * self.side_offset;
        let wall = outward.dot(inward) >= BALL_OPPOSITE && self.is_air(beyond, steps);
        wall.then_some(Probe::Wall(2.0 * ball.radius, contact.face))
    }
}

fn is_bounding(analysis: &Analysis<'_>, parts: &[bool], face: u32) -> bool {
    parts.get(analysis.parts.of_face[face as usize] as usize).copied().unwrap_or(false)
}

/// Search for the thinnest wall of each region, from all face centres and from points spread by area.
pub(super) struct WallSearch<'a> {
    analysis: &'a Analysis<'a>,
    corner: DVec3,
    edge: f64,
    sides: [usize; 3],
    thinnest: Vec<Option<Wall>>,
    least: f64,
    /// Thickness up to which every wall is thin. See [`THIN`].
    thin: f64,
    /// Length of the longest ray.
    reach: f64,
    /// Number of points covered.
    pub points: u64,
    /// Whether all points were covered within the budget.
    pub complete: bool,
}

impl<'a> WallSearch<'a> {
    pub fn new(analysis: &'a Analysis<'a>, reach: f64) -> Self {
        let bounds = Box3::of(analysis.unit().iter().copied());
        let size = if bounds.is_empty() { DVec3::ZERO } else { bounds.max - bounds.min };
        let edge = (size.max_element() / REGIONS).max(f64::MIN_POSITIVE);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "at most the regions along a side")]
        let sides = (size / edge).to_array().map(|count| (count.min(REGIONS - 1.0) as usize) + 1);
        Self {
            analysis,
            corner: bounds.min,
            edge,
            sides,
            thinnest: vec![None; sides.iter().product()],
            least: f64::INFINITY,
            thin: THIN * analysis.unit_diagonal(),
            reach,
            points: 0,
            complete: true,
        }
    }

    /// Keeps a wall if it is the thinnest of its region. The first of equally thin walls stays.
    pub fn add(&mut self, wall: Wall) {
        let region = self.region(wall.point);
        let kept = &mut self.thinnest[region];
        if kept.is_none_or(|kept| wall.thickness < kept.thickness) {
            *kept = Some(wall);
        }
        self.least = self.least.min(wall.thickness);
    }

    /// Measures at all points, in blocks. Known thin walls bound the rays of the next block, so most rays are short.
    /// Blocks depend on the mesh only, so the result is the same for any number of threads.
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    pub fn run(&mut self, prober: &WallProber<'_>, is_printable: bool, context: &Context<'_>) -> Result<(), Cancelled> {
        let faces = self.analysis.surface.faces.len();
        let count = (faces / 8).clamp(SPREAD_POINTS[0], SPREAD_POINTS[1]);
        let spread = samples(self.analysis, u32::try_from(count).unwrap_or(u32::MAX));
        let points = (faces + spread.len()) as u64;
        let [base, per_point] = if is_printable { BUDGET } else { UNPRINTABLE_BUDGET };
        let budget = base + per_point * points;
        let may_have_wall = prober.may_have_wall(self.limit());
        let left = self.run_queries(spread.len(), budget, context, |i, search, steps| {
            let sample = may_have_wall[spread[i].face as usize].then_some(&spread[i])?;
            search.probe(prober, sample, steps)
        })?;
        self.run_queries(faces, left, context, |face, search, steps| {
            let sample = may_have_wall[face].then(|| search.centre(u32::try_from(face).ok()?)).flatten()?;
            search.probe(prober, &sample, steps)
        })?;
        self.descend(prober);
        Ok(())
    }

    /// Moves the point of each thin wall to where the wall is thinnest.
    fn descend(&mut self, prober: &WallProber<'_>) {
        let mut steps = MOVES_BUDGET;
        for mut wall in self.regions() {
            for _ in 0..MOVES {
                let Some(thinner) = self.thinner(prober, &wall, &mut steps) else { break };
                self.add(thinner);
                wall = thinner;
            }
        }
    }

    /// Finds a thinner wall near a given one. The thickness between two faces varies linearly, so its minimum is at a
    /// corner of their overlap. Two faces with a common vertex form an edge rather than a wall, which ends the
    /// search.
    fn thinner(&self, prober: &WallProber<'_>, wall: &Wall, steps: &mut u64) -> Option<Wall> {
        let [face, opposite] = wall.faces;
        let faces = &self.analysis.surface.faces;
        if faces[face as usize].iter().any(|v| faces[opposite as usize].contains(v)) {
            return None;
        }
        let normal = self.centre(face)?.normal;
        let thinnest = thinnest_corner(self.analysis.unit_corners(face), normal, self.analysis.unit_corners(opposite))?;
        STEP_FRACTIONS.into_iter().find_map(|fraction| {
            let sample = Sample { face, point: wall.point.lerp(thinnest, fraction), normal };
            let Probe::Wall(thickness, opposite) = prober.probe(&sample, wall.thickness, steps) else { return None };
            // An improvement of less than a thousandth does not justify another move.
            let thinner = Wall { thickness, point: sample.point, faces: [face, opposite] };
            (thickness < 0.999 * wall.thickness).then_some(thinner)
        })
    }

    /// Runs queries 0 to `count` in an order whose every prefix is spread evenly over all of them. Returns the
    /// remaining budget.
    fn run_queries(
        &mut self,
        count: usize,
        budget: u64,
        context: &Context<'_>,
        query: impl Fn(usize, &Self, &mut u64) -> Option<Wall> + Sync,
    ) -> Result<u64, Cancelled> {
        let (order, most) = (SpreadOrder::over(count), (budget / QUERY_BUDGET_DIVISOR).max(1));
        let (mut done, mut left, mut block) = (0, budget, BLOCK[0]);
        while done < count {
            context.check()?;
            if left == 0 {
                self.complete = false;
                break;
            }
            let end = count.min(done + block);
            let known = &*self;
            let answers = run_each(order, done..end, (MIN_PER_THREAD, most), |i, steps| query(i, known, steps));
            for (_, wall, steps) in answers {
                wall.into_iter().for_each(|wall| self.add(wall));
                self.complete &= steps > 0;
                left = left.saturating_sub(most - steps);
            }
            self.points += (end - done) as u64;
            done = end;
            block = (block * 2).min(BLOCK[1]);
        }
        Ok(left)
    }

    fn probe(&self, prober: &WallProber<'_>, sample: &Sample, steps: &mut u64) -> Option<Wall> {
        let Probe::Wall(thickness, face) = prober.probe(sample, self.longest(sample.point), steps) else { return None };
        Some(Wall { thickness, point: sample.point, faces: [sample.face, face] })
    }

    /// A sample at the centre of a face; `None` if the face has no area.
    fn centre(&self, face: u32) -> Option<Sample> {
        let normal = self.analysis.unit_normal(face);
        (normal != DVec3::ZERO).then(|| Sample { face, point: self.analysis.unit_centre(face), normal })
    }

    /// Thickness from which a wall at a point is irrelevant.
    fn longest(&self, point: DVec3) -> f64 {
        let region = self.thinnest[self.region(point)].map_or(self.reach, |wall| wall.thickness);
        region.min(self.limit()).min(self.reach)
    }

    /// Thickness up to which a region is thin.
    fn limit(&self) -> f64 {
        (THIN_MULTIPLE * self.least).max(self.thin)
    }

    fn region(&self, point: DVec3) -> usize {
        let at = ((point - self.corner) / self.edge).max(DVec3::ZERO).to_array();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the regions")]
        let [x, y, z] = [0, 1, 2].map(|k| (at[k] as usize).min(self.sides[k] - 1));
        (z * self.sides[1] + y) * self.sides[0] + x
    }

    /// The thinnest wall of each thin region, thinnest first. Omits walls within a region's width of a thinner one.
    pub fn regions(&self) -> Vec<Wall> {
        let limit = self.limit();
        let mut thin: Vec<Wall> = self.thinnest.iter().flatten().copied().filter(|w| w.thickness <= limit).collect();
        thin.sort_by(|a, b| a.thickness.total_cmp(&b.thickness));
        let mut regions: Vec<Wall> = Vec::new();
        for wall in thin {
            if regions.len() >= MAX_REGIONS {
                break;
            }
            if regions.iter().all(|other| other.point.distance(wall.point) > self.edge) {
                regions.push(wall);
            }
        }
        regions
    }
}

/// Thinnest corner between two triangles: projects triangle `q` onto triangle `p` along the normal of `p`, and
/// returns the corner of the overlap that is nearest to the plane of `q`.
fn thinnest_corner(p: [DVec3; 3], normal: DVec3, q: [DVec3; 3]) -> Option<DVec3> {
    let mut part = p.to_vec();
    for k in 0..3 {
        let (start, end, third) = (q[k], q[(k + 1) % 3], q[(k + 2) % 3]);
        let across = (end - start).cross(normal);
        let across = if across.dot(third - start) < 0.0 { -across } else { across };
        let height = |x: DVec3| across.dot(x - start);
        part = (0..part.len())
            .flat_map(|i| {
                let (a, b) = (part[i], part[(i + 1) % part.len()]);
                let (from, to) = (height(a), height(b));
                let crossing = (from < 0.0) != (to < 0.0);
                [(from >= 0.0).then_some(a), crossing.then(|| a.lerp(b, from / (from - to)))]
            })
            .flatten()
            .collect();
    }
    let plane = (q[1] - q[0]).cross(q[2] - q[0]);
    let thickness = |x: DVec3| ((q[0] - x).dot(plane) / normal.dot(plane)).abs();
    part.into_iter().min_by(|&x, &y| thickness(x).total_cmp(&thickness(y)))
}
