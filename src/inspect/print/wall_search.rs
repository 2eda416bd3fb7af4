//! The search for the thinnest wall in each region of the model.

use glam::DVec3;

use super::wall_probe::{Overlap, Probe, Wall, WallProber};
use crate::context::{Cancelled, Context};
use crate::inspect::Analysis;
use crate::inspect::sampling::{QUERY_BUDGET_DIVISOR, Sample, SpreadOrder, run_each, samples};
use crate::math::{Box3, threads};

/// Height, on the unit scale, of the thinnest face with a reliable normal: f32 has 24 bits, and the largest coordinate is
/// at most 2.
const RELIABLE_HEIGHT: f64 = 4.8e-7;
/// Number of regions along the longest side of the bounding box. Each region keeps its thinnest wall.
const REGIONS: f64 = 16.0;
/// Limits of thin walls: a fraction of the diagonal, or a multiple of the thinnest wall, whichever is larger.
const THIN: f64 = 0.02;
const THIN_MULTIPLE: f64 = 1.25;
/// Maximum number of regions that the report lists.
const MAX_REGIONS: usize = 100;
/// Number of points spread by area: an eighth of the number of faces, within these limits.
const SPREAD_POINTS: [usize; 2] = [512, 100_000];
/// Most faces at whose centres walls are measured, spread evenly over all faces.
const MAX_CENTRES: usize = 500_000;
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
/// A move must make the wall thinner than this fraction; a smaller improvement does not justify another move.
const IMPROVEMENT: f64 = 0.999;
/// Budget of all moves: boxes and triangles visited.
const MOVES_BUDGET: u64 = 1_000_000;

/// Search for the thinnest wall of each region, from face centres, from points spread by area, and from the places where two
/// opposite faces are nearest.
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
    /// Prepares a search with rays of at most the length `reach`.
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
        let centres = faces.min(MAX_CENTRES);
        let points = (centres + spread.len()) as u64;
        let [base, per_point] = if is_printable { BUDGET } else { UNPRINTABLE_BUDGET };
        let budget = base + per_point * points;
        let may_have_wall = prober.may_have_wall(self.limit());
        let left = self.run_queries(spread.len(), budget, context, |i, search, steps| {
            let sample = may_have_wall[spread[i].face as usize].then_some(&spread[i])?;
            search.probe(prober, sample, steps)
        })?;
        let left = self.run_queries(centres, left, context, |centre, search, steps| {
            let face = centre * faces / centres;
            let sample = may_have_wall[face].then(|| search.centre(u32::try_from(face).ok()?)).flatten()?;
            search.probe(prober, &sample, steps)
        })?;
        if is_printable {
            self.search_overlaps(prober, left, context)?;
        }
        self.descend(prober);
        Ok(())
    }

    /// Measures where a face and an opposite one are nearest, from the thinnest such place on, until none can be thinner than
    /// the thinnest wall so far.
    fn search_overlaps(
        &mut self,
        prober: &WallProber<'_>,
        budget: u64,
        context: &Context<'_>,
    ) -> Result<(), Cancelled> {
        let Some((overlaps, complete)) = prober.thinnest_overlaps(IMPROVEMENT * self.least) else { return Ok(()) };
        self.complete &= complete;
        let (mut left, most) = (budget, (budget / QUERY_BUDGET_DIVISOR).max(1));
        for block in overlaps.chunks(BLOCK[0]) {
            context.check()?;
            if block[0].thickness >= IMPROVEMENT * self.least {
                break;
            }
            if left == 0 {
                self.complete = false;
                break;
            }
            let known = &*self;
            let found = threads::map(block.len(), MIN_PER_THREAD, |i| {
                let mut steps = most;
                (known.wall_in(&block[i], prober, &mut steps), steps)
            });
            for (wall, steps) in found {
                left = left.saturating_sub(self.record(wall, steps, most));
            }
        }
        Ok(())
    }

    /// The wall in an overlap, near its thinnest corner if possible: at the corner itself, the ray may miss the opposite face.
    /// Walls near a sharp edge, where both faces have a common vertex, do not count.
    fn wall_in(&self, overlap: &Overlap, prober: &WallProber<'_>, steps: &mut u64) -> Option<Wall> {
        let face = self.centre(overlap.face)?;
        STEP_FRACTIONS.into_iter().find_map(|fraction| {
            let sample = Sample { point: overlap.middle.lerp(overlap.thinnest, fraction), ..face };
            self.probe(prober, &sample, steps).filter(|wall| !prober.share_a_vertex(wall.faces))
        })
    }

    /// Moves the point of each region's wall to where the wall is thinnest: the thinnest point of a face need not be its centre.
    fn descend(&mut self, prober: &WallProber<'_>) {
        let mut steps = MOVES_BUDGET;
        for wall in self.regions() {
            self.descend_from(wall, prober, &mut steps);
        }
    }

    fn descend_from(&mut self, mut wall: Wall, prober: &WallProber<'_>, steps: &mut u64) {
        for _ in 0..MOVES {
            let Some(thinner) = self.thinner(prober, &wall, steps) else { break };
            self.add(thinner);
            wall = thinner;
        }
    }

    /// Finds a thinner wall near a given one. At the thinnest point itself, the ray may miss the opposite face.
    fn thinner(&self, prober: &WallProber<'_>, wall: &Wall, steps: &mut u64) -> Option<Wall> {
        let thinnest = prober.overlap(wall.faces)?.thinnest;
        let face = wall.faces[0];
        let normal = self.analysis.unit_normal(face);
        STEP_FRACTIONS.into_iter().find_map(|fraction| {
            let sample = Sample { face, point: wall.point.lerp(thinnest, fraction), normal };
            let Probe::Wall(thickness, opposite) = prober.probe(&sample, wall.thickness, steps) else { return None };
            let thinner = Wall { thickness, point: sample.point, faces: [face, opposite] };
            (thickness < IMPROVEMENT * wall.thickness).then_some(thinner)
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
                left = left.saturating_sub(self.record(wall, steps, most));
            }
            self.points += (end - done) as u64;
            done = end;
            block = (block * 2).min(BLOCK[1]);
        }
        Ok(left)
    }

    /// Keeps the answer of a query that has `left` of `most` steps left. Returns the steps that it took.
    fn record(&mut self, wall: Option<Wall>, left: u64, most: u64) -> u64 {
        wall.into_iter().for_each(|wall| self.add(wall));
        self.complete &= left > 0;
        most - left
    }

    fn probe(&self, prober: &WallProber<'_>, sample: &Sample, steps: &mut u64) -> Option<Wall> {
        let Probe::Wall(thickness, face) = prober.probe(sample, self.longest(sample.point), steps) else { return None };
        Some(Wall { thickness, point: sample.point, faces: [sample.face, face] })
    }

    /// A sample at the centre of a face; `None` if the face is so thin that rounding to f32 decides its normal.
    fn centre(&self, face: u32) -> Option<Sample> {
        let [a, b, c] = self.analysis.unit_corners(face);
        let longest = [b - a, c - b, a - c].into_iter().map(DVec3::length).fold(0.0, f64::max);
        let is_reliable = self.analysis.unit_area_vector(face).length() > RELIABLE_HEIGHT * longest;
        let normal = self.analysis.unit_normal(face);
        (is_reliable && normal != DVec3::ZERO).then(|| Sample { face, point: self.analysis.unit_centre(face), normal })
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
