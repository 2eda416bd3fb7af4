//! The wall behind a point, and the search for the thinnest of each region.

use glam::DVec3;

use crate::context::{Cancelled, Context};
use crate::inspect::Analysis;
use crate::inspect::sampling::{InsideTest, SHARE, Sample, Spread, ask_each, samples};
use crate::math::{Box3, OppositeFaces, hit};

/// Winding numbers from which on a point is in material, and up to which it is in air. In between the surface is too open to
/// tell.
const MATERIAL: f64 = 0.75;
const AIR: f64 = 0.25;
/// How far beside the surface is asked for material and air: a share of the diagonal, and what f64 tells apart.
const BESIDE: [f64; 2] = [1e-9, 1e-13];
/// A ray passes over faces nearer than this share of the diagonal: they touch the face from which it starts.
const TOUCHING: f64 = 1e-6;
/// Two sides make a wall where they face away from each other to within 30 degrees (its cosine). At the edges of a box the
/// faces are near each other, but there is no thin wall.
const OPPOSITE: f64 = 0.866_025_403_784_438_6;
/// The same for a ball that touches both sides, which turns with the point: 37 degrees.
const BALL_OPPOSITE: f64 = 0.8;
/// Faces that a ray may pass through on its way to the air, as in overlapping parts.
const MOST_PASSED: usize = 16;
/// Regions along the longest side of the bounding box. Each keeps its thinnest wall.
const REGIONS: f64 = 16.0;
/// Walls up to this share of the diagonal are searched in every region, and so are those up to so many times the thinnest.
const THIN: f64 = 0.02;
const TIMES_THINNEST: f64 = 1.25;
/// Most regions that the report lists.
const MOST_REGIONS: usize = 100;
/// Points spread by area: an eighth as many as faces, but at least and at most so many.
const SPREAD: [usize; 2] = [512, 100_000];
/// Points between two updates of what is known to be thin, at first and at most: rays search for thinner walls only.
const BLOCK: [usize; 2] = [256, 16_384];
/// Fewest points for one thread.
const TASK: usize = 64;
/// Boxes and triangles that the search may look at: so many, and so many more for each point. A mesh that is not printable has less,
/// since its walls are not those that will be printed, and it costs more to tell where its material is.
const BUDGET: [u64; 2] = [10_000_000, 200];
const UNPRINTABLE_BUDGET: [u64; 2] = [1_000_000, 30];
/// Moves towards where a wall is thinner still, and how far each goes, as shares of the way to the thinnest point of the two
/// faces.
const MOVES: usize = 16;
const WAYS: [f64; 3] = [0.999, 0.75, 0.25];
/// Boxes and triangles that all moves together may look at.
const MOVES_BUDGET: u64 = 1_000_000;

/// A wall, in unit coordinates.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wall {
    pub thickness: f64,
    /// The point from which it was measured.
    pub point: DVec3,
    /// The face of that point, and the one opposite.
    pub faces: [u32; 2],
}

/// What is at one sample.
pub(super) enum Probe {
    /// The surface does not part material from air here.
    NotSolid,
    /// No opposite side within the length that was asked for.
    NoWallReason,
    /// The thickness in unit coordinates, and the opposite face.
    Wall(f64, u32),
}

/// Measures the wall behind single points.
pub(super) struct Prober<'a> {
    analysis: &'a Analysis<'a>,
    material: Material<'a>,
    /// Longer than any wall.
    pub reach: f64,
    beside: f64,
    touching: f64,
}

/// What tells on which side of a face the material is.
enum Material<'a> {
    /// Every face of these parts has material behind it and air in front, and other faces are not between the two. With the faces by
    /// the way they are turned.
    Bounded(Vec<bool>, OppositeFaces<'a>),
    /// Winding numbers at points beside the face.
    Measured(InsideTest<'a>),
}

impl<'a> Prober<'a> {
    /// `bounding` as [`bounding_parts`](super::bounding_parts) finds it.
    pub fn new(analysis: &'a Analysis<'a>, bounding: Option<Vec<bool>>) -> Self {
        let diagonal = analysis.unit_diagonal();
        let beside = (BESIDE[0] * diagonal).max(BESIDE[1]);
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
        Self { analysis, material, reach: 2.0 * diagonal, beside, touching: TOUCHING * diagonal }
    }

    /// For each face whether a wall of at most `longest` may be behind it.
    pub fn may_have_wall(&self, longest: f64) -> Vec<bool> {
        let faces = self.analysis.surface.faces.len();
        match &self.material {
            Material::Bounded(_, opposite) => opposite.may_be_within(longest.min(self.reach), faces),
            // Parts may be inside out.
            Material::Measured(_) => vec![true; faces],
        }
    }

    /// The wall behind a sample by the ray inward, where it is at most `longest`. Whether the surface parts material from air is
    /// asked only where a ray meets something within that length, or where it is as long as any wall.
    pub fn probe(&self, sample: &Sample, longest: f64, steps: &mut u64) -> Probe {
        let has_none = match &self.material {
            Material::Bounded(parts, opposite) => {
                is_bounding(self.analysis, parts, sample.face) && !self.meets_opposite(opposite, sample, longest, steps)
            }
            Material::Measured(_) => longest < self.reach && !self.meets_anything(sample, longest, steps),
        };
        if has_none {
            return Probe::NoWallReason;
        }
        let Some(inward) = self.inward(sample, steps) else { return Probe::NotSolid };
        let Some((length, face)) = self.way_out(sample, inward, longest, steps) else { return Probe::NoWallReason };
        if self.is_opposite(face, inward, OPPOSITE) { Probe::Wall(length, face) } else { Probe::NoWallReason }
    }

    /// The wall behind a sample by the ray inward or by the ball inside the material that touches the sample, shrunk until
    /// nothing is in it (Ma et al. 2012): the thinner of both.
    pub fn probe_by_ball(&self, sample: &Sample, steps: &mut u64) -> Probe {
        let Some(inward) = self.inward(sample, steps) else { return Probe::NotSolid };
        let Some((length, face)) = self.way_out(sample, inward, self.reach, steps) else { return Probe::NoWallReason };
        if let Some(wall) = self.ball(sample.point, inward, length / 2.0, steps) {
            return wall;
        }
        if self.is_opposite(face, inward, BALL_OPPOSITE) { Probe::Wall(length, face) } else { Probe::NoWallReason }
    }

    fn is_opposite(&self, face: u32, inward: DVec3, cosine: f64) -> bool {
        let along = self.analysis.unit_normal(face).dot(inward);
        // A part turned inside out has its faces' normals inward.
        (if self.is_measured() { along.abs() } else { along }) >= cosine
    }

    fn is_measured(&self) -> bool {
        matches!(self.material, Material::Measured(_))
    }

    /// Whether a ray from a sample against its normal meets an opposite face within a length.
    fn meets_opposite(&self, opposite: &OppositeFaces<'_>, sample: &Sample, longest: f64, steps: &mut u64) -> bool {
        let (ray, least) = (-sample.normal * longest, self.touching / longest);
        opposite.any_along([sample.point, sample.point + ray], sample.normal, steps, |face| {
            let share = hit(sample.point, ray, self.analysis.unit_corners(face));
            face != sample.face && share.is_some_and(|share| share > least)
        })
    }

    /// Whether a face is within a length of a sample along its normal, to either side.
    fn meets_anything(&self, sample: &Sample, longest: f64, steps: &mut u64) -> bool {
        [-sample.normal, sample.normal].into_iter().any(|way| self.first(sample, way * longest, None, steps).is_some())
    }

    /// The first face that a ray from a sample meets, as a share of the ray.
    fn first(&self, sample: &Sample, ray: DVec3, after: Option<(f64, u32)>, steps: &mut u64) -> Option<(f64, u32)> {
        let least = self.touching / ray.length();
        self.analysis.tree().first_along([sample.point, sample.point + ray], after, steps, |face| {
            let other = face != sample.face && self.may_end_material(face);
            let share = other.then(|| hit(sample.point, ray, self.analysis.unit_corners(face))).flatten();
            share.filter(|&share| share > least)
        })
    }

    /// The direction from a sample into the material, if there is material on one side and air on the other.
    fn inward(&self, sample: &Sample, steps: &mut u64) -> Option<DVec3> {
        let inside = match &self.material {
            Material::Bounded(parts, _) => {
                return is_bounding(self.analysis, parts, sample.face).then_some(-sample.normal);
            }
            Material::Measured(inside) => inside,
        };
        let [front, back] = inside.windings(sample.point, sample.normal * self.beside, steps);
        if front < AIR && back > MATERIAL {
            Some(-sample.normal)
        } else {
            (back < AIR && front > MATERIAL).then_some(sample.normal)
        }
    }

    /// Whether air may begin behind a face that is met from the material.
    fn may_end_material(&self, face: u32) -> bool {
        match &self.material {
            Material::Bounded(parts, _) => is_bounding(self.analysis, parts, face),
            Material::Measured(_) => true,
        }
    }

    /// Whether a point just behind a face that was met from the material is in air.
    fn is_air(&self, beyond: DVec3, steps: &mut u64) -> bool {
        match &self.material {
            Material::Bounded(..) => true,
            Material::Measured(inside) => inside.winding(beyond, steps) < AIR,
        }
    }

    /// How far it is inward to where the air begins, if at most `longest`, and the face there.
    fn way_out(&self, sample: &Sample, inward: DVec3, longest: f64, steps: &mut u64) -> Option<(f64, u32)> {
        let ray = inward * longest;
        let mut passed = None;
        for _ in 0..MOST_PASSED {
            let first = self.first(sample, ray, passed, steps);
            let (share, face) = first.filter(|_| *steps > 0)?;
            let length = share * longest;
            if self.is_air(sample.point + inward * (length + self.beside), steps) {
                return Some((length, face)).filter(|_| *steps > 0);
            }
            passed = first;
        }
        None
    }

    /// The wall by the largest ball of at most `radius` that touches `point` from inside, where it touches an opposite side.
    fn ball(&self, point: DVec3, inward: DVec3, radius: f64, steps: &mut u64) -> Option<Probe> {
        let ball =
            self.analysis.tree().shrunk_ball([point, inward], radius, steps, |f| self.analysis.unit_corners(f))?;
        let contact = ball.touches.filter(|_| *steps > 0)?;
        let outward = (contact.point - (point + inward * ball.radius)) / ball.radius;
        let beyond = contact.point + outward * self.beside;
        let wall = outward.dot(inward) >= BALL_OPPOSITE && self.is_air(beyond, steps);
        wall.then_some(Probe::Wall(2.0 * ball.radius, contact.face))
    }
}

fn is_bounding(analysis: &Analysis<'_>, parts: &[bool], face: u32) -> bool {
    parts.get(analysis.parts.of_face[face as usize] as usize).copied().unwrap_or(false)
}

/// The search for the thinnest wall of each region, from every face's centre and from points spread by area.
pub(super) struct Search<'a> {
    analysis: &'a Analysis<'a>,
    corner: DVec3,
    edge: f64,
    sides: [usize; 3],
    thinnest: Vec<Option<Wall>>,
    least: f64,
    /// See [`THIN`].
    thin: f64,
    /// The longest ray.
    reach: f64,
    /// Points that were asked.
    pub asked: u64,
    /// Whether all points were asked to the end.
    pub complete: bool,
}

impl<'a> Search<'a> {
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
            asked: 0,
            complete: true,
        }
    }

    /// Keeps a wall if it is the thinnest of its region; of equally thin ones the first.
    pub fn add(&mut self, wall: Wall) {
        let region = self.region(wall.point);
        let kept = &mut self.thinnest[region];
        if kept.is_none_or(|kept| wall.thickness < kept.thickness) {
            *kept = Some(wall);
        }
        self.least = self.least.min(wall.thickness);
    }

    /// Asks all points, in blocks. What is known to be thin bounds the rays of the next block, so most of them are short. The
    /// blocks follow from the mesh alone, so the result is the same for any number of threads.
    ///
    /// # Errors
    /// [`Cancelled`] when the context says stop.
    pub fn run(&mut self, prober: &Prober<'_>, is_printable: bool, context: &Context<'_>) -> Result<(), Cancelled> {
        let faces = self.analysis.surface.faces.len();
        let spread = samples(self.analysis, u32::try_from((faces / 8).clamp(SPREAD[0], SPREAD[1])).unwrap_or(u32::MAX));
        let points = (faces + spread.len()) as u64;
        let [base, a_point] = if is_printable { BUDGET } else { UNPRINTABLE_BUDGET };
        let budget = base + a_point * points;
        let may_have_wall = prober.may_have_wall(self.limit());
        let left = self.ask(spread.len(), budget, context, |i, search, steps| {
            let sample = may_have_wall[spread[i].face as usize].then_some(&spread[i])?;
            search.probe(prober, sample, steps)
        })?;
        self.ask(faces, left, context, |face, search, steps| {
            let sample = may_have_wall[face].then(|| search.centre(u32::try_from(face).ok()?)).flatten()?;
            search.probe(prober, &sample, steps)
        })?;
        self.descend(prober);
        Ok(())
    }

    /// Moves the point of each thin wall to where it is thinnest.
    fn descend(&mut self, prober: &Prober<'_>) {
        let mut steps = MOVES_BUDGET;
        for mut wall in self.regions() {
            for _ in 0..MOVES {
                let Some(thinner) = self.thinner(prober, &wall, &mut steps) else { break };
                self.add(thinner);
                wall = thinner;
            }
        }
    }

    /// A thinner wall beside one. Between two faces the thickness changes linearly, so it is least at a corner of what one
    /// shows of the other. Faces that have a vertex in common make an edge and no wall, so there the search ends.
    fn thinner(&self, prober: &Prober<'_>, wall: &Wall, steps: &mut u64) -> Option<Wall> {
        let [face, opposite] = wall.faces;
        let faces = &self.analysis.surface.faces;
        if faces[face as usize].iter().any(|v| faces[opposite as usize].contains(v)) {
            return None;
        }
        let normal = self.centre(face)?.normal;
        let thinnest = thinnest_corner(self.analysis.unit_corners(face), normal, self.analysis.unit_corners(opposite))?;
        WAYS.into_iter().find_map(|way| {
            let sample = Sample { face, point: wall.point.lerp(thinnest, way), normal };
            let Probe::Wall(thickness, opposite) = prober.probe(&sample, wall.thickness, steps) else { return None };
            // Less than a thousandth is not worth another move.
            let thinner = Wall { thickness, point: sample.point, faces: [face, opposite] };
            (thickness < 0.999 * wall.thickness).then_some(thinner)
        })
    }

    /// Asks points 0 to `count`, in an order of which every beginning is spread evenly over all of them. Returns what is left of
    /// the budget.
    fn ask(
        &mut self,
        count: usize,
        budget: u64,
        context: &Context<'_>,
        question: impl Fn(usize, &Self, &mut u64) -> Option<Wall> + Sync,
    ) -> Result<u64, Cancelled> {
        let (order, most) = (Spread::over(count), (budget / SHARE).max(1));
        let (mut asked, mut left, mut block) = (0, budget, BLOCK[0]);
        while asked < count {
            context.check()?;
            if left == 0 {
                self.complete = false;
                break;
            }
            let end = count.min(asked + block);
            let known = &*self;
            let answers = ask_each(order.numbers(asked..end), TASK, most, |i, steps| question(i, known, steps));
            for (_, wall, steps) in answers {
                wall.into_iter().for_each(|wall| self.add(wall));
                self.complete &= steps > 0;
                left = left.saturating_sub(most - steps);
            }
            self.asked += (end - asked) as u64;
            asked = end;
            block = (block * 2).min(BLOCK[1]);
        }
        Ok(left)
    }

    fn probe(&self, prober: &Prober<'_>, sample: &Sample, steps: &mut u64) -> Option<Wall> {
        let Probe::Wall(thickness, face) = prober.probe(sample, self.longest(sample.point), steps) else { return None };
        Some(Wall { thickness, point: sample.point, faces: [sample.face, face] })
    }

    /// The centre of a face; none where it has no area.
    fn centre(&self, face: u32) -> Option<Sample> {
        let normal = self.analysis.unit_normal(face);
        (normal != DVec3::ZERO).then(|| Sample { face, point: self.analysis.unit_centre(face), normal })
    }

    /// The thickness from which on a wall at a point tells nothing new.
    fn longest(&self, point: DVec3) -> f64 {
        let region = self.thinnest[self.region(point)].map_or(self.reach, |wall| wall.thickness);
        region.min(self.limit()).min(self.reach)
    }

    /// Up to which thickness regions are thin.
    fn limit(&self) -> f64 {
        (TIMES_THINNEST * self.least).max(self.thin)
    }

    fn region(&self, point: DVec3) -> usize {
        let at = ((point - self.corner) / self.edge).max(DVec3::ZERO).to_array();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the regions")]
        let [x, y, z] = [0, 1, 2].map(|k| (at[k] as usize).min(self.sides[k] - 1));
        (z * self.sides[1] + y) * self.sides[0] + x
    }

    /// The thinnest wall of each thin region, the thinnest first. What is within a region's edge of a thinner one is not told
    /// again.
    pub fn regions(&self) -> Vec<Wall> {
        let limit = self.limit();
        let mut thin: Vec<Wall> = self.thinnest.iter().flatten().copied().filter(|it| it.thickness <= limit).collect();
        thin.sort_by(|a, b| a.thickness.total_cmp(&b.thickness));
        let mut regions: Vec<Wall> = Vec::new();
        for wall in thin {
            if regions.len() >= MOST_REGIONS {
                break;
            }
            if regions.iter().all(|other| other.point.distance(wall.point) > self.edge) {
                regions.push(wall);
            }
        }
        regions
    }
}

/// Of the part of triangle `p` that lies before triangle `q` as seen along the normal of `p`, the corner nearest to the plane
/// of `q` along it.
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
