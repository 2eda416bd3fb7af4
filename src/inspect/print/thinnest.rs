use glam::DVec3;

use super::walls::{Probe, Prober};
use crate::context::{Cancelled, Context};
use crate::inspect::Analysis;
use crate::inspect::compare::{Sample, samples, unit_diagonal};
use crate::inspect::queries::{SHARE, Spread, ask_each};
use crate::math::Box3;

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
const UNPRINTABLE_BUDGET: [u64; 2] = [100_000, 3];
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
            thin: THIN * unit_diagonal(analysis),
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
        let [a, b, c] = self.analysis.unit_corners(face);
        let normal = (b - a).cross(c - a).normalize_or_zero();
        (normal != DVec3::ZERO).then(|| Sample { face, point: (a + b + c) / 3.0, normal })
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
