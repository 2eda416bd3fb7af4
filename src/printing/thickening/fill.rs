//! Rounds that unite a solid with balls along the middle of its thin places, until nothing is thin.

use crate::context::{Cancelled, Context};
use crate::math::{Box3, Tree};
use crate::mesh::Surface;
use crate::remesh::{BallUnion, RemeshError};
use glam::DVec3;
use rayon::prelude::*;

use super::bodies::{Filler, Fillers, Search};
use super::gaps::{CELL, balls_over_gaps};
use super::outcome::{Thickening, ThinReason};
use super::results::{Grown, Thin, deviation_of_added, face_count};
use super::spheres::Spheres;
use super::unite::{Added, Broken, SelfUnion, Topology, united};

/// The most rounds.
const MAX_ROUNDS: usize = 12;
/// Sizes of cells, finest first. Measuring the result takes longest, so a body of many faces gets larger cells.
const CELLS: [Cells; 3] = [
    Cells { share: 0.2, margin: 0.08, max_faces: 50_000 },
    Cells { share: 0.32, margin: 0.12, max_faces: 150_000 },
    Cells { share: 0.45, margin: 0.17, max_faces: 250_000 },
];
/// How much more a ball grows in later rounds: this times the square of the number of the round, at most the second value.
/// What stays thin then is just below the least wall, and the caps of small balls there are finer than the cells.
const MORE: [f64; 2] = [0.005, 0.2];
/// How many times the faces of the first round's body a later body may have.
const MAX_MORE_FACES: u64 = 3;
/// The most memory of a body's samples.
const MAX_MEMORY: u64 = 1 << 29;
/// The most unions of a round. More than one is needed only where a promise is broken.
const MAX_UNIONS: usize = 8;
/// The most that balls may move the surface, as a share of the least wall. A ball in the middle of a wall without thickness
/// moves it by half of the least wall; where a gap limits the growth on one side, the other side moves by all of it. The
/// rest is the margin for the error of the balls' surface, and what later rounds add beside earlier balls.
const MAX_DEVIATION: f64 = 1.25;
/// The share of the largest deviation that balls may take. The rest is the error of their surface.
const BALLS_DEVIATION: f64 = 0.9;
/// Wide through holes must stay open for balls that are larger by this share of the least wall, each time. So they stay wider
/// than twice that. Two sizes, since where balls meet faces, the narrow tunnel of a crease can hide that a hole is closed;
/// it hardly ever does with both.
const CLEARANCES: [f64; 2] = [0.1, 0.14];
/// After how many refusals no closed hole is looked at any more. Each look takes as long as several unions.
const MAX_REFUSALS: usize = 2;
/// Balls that break a promise are left out in groups of at most this fraction of a round's balls: one in so many.
const LEFT_OUT: usize = 32;

/// A size of cells.
#[derive(Clone, Copy)]
struct Cells {
    /// The edge length as a share of the least wall.
    share: f64,
    /// The share by which balls are larger than the least wall, to cover the error of their surface.
    margin: f64,
    /// The most faces of the first round's body.
    max_faces: u64,
}

/// The settings of the rounds.
pub struct Filling<'a> {
    pub settings: Thickening,
    pub union: &'a dyn SelfUnion,
    pub context: &'a Context<'a>,
    /// The surface to thicken. Sources from the number of its faces on mean added faces.
    pub input: &'a Surface,
    /// Its topology.
    pub topology: Topology,
}

/// What the rounds share.
struct State<'a> {
    /// The surface with which the balls of all rounds are united, so that no round cuts what another added.
    base: &'a Grown,
    /// The balls of the rounds so far.
    balls: Vec<Filler>,
    /// Balls that broke a promise, and why.
    left_out: Vec<(Filler, Broken)>,
    cells: Cells,
    /// The tree of the base, for the sources.
    base_tree: Tree,
    /// The tree of the input, for the deviation.
    input_tree: Tree,
    /// The balls of the first round, if they are known.
    first: Option<Vec<Filler>>,
    /// The number of the round.
    round: usize,
    /// The topology that the next result must have.
    topology: Topology,
    /// How many times a wide hole was perhaps closed.
    refusals: usize,
}

/// A union with some of the balls of a round.
struct Union {
    /// None if no union kept its promises.
    surface: Option<Surface>,
    /// The balls that are part of it.
    balls: Vec<Filler>,
    /// Why others are not.
    broken: Option<Broken>,
}

impl Filling<'_> {
    /// Runs the rounds. Ends early, with the best result, when the time runs out.
    ///
    /// # Errors
    /// [`Cancelled`] when the work was cancelled.
    pub fn run(&self, base: &Grown) -> Result<Grown, Cancelled> {
        let (mut best, mut current) = (base.clone(), base.clone());
        let Some((cells, first)) = self.context.unless_late(self.cells_for(base))? else {
            best.reason = Some(ThinReason::Time);
            return Ok(best);
        };
        let [base_tree, input_tree] =
            [&base.surface, self.input].map(|surface| Tree::new(&surface.positions, &surface.faces));
        let mut state = State {
            base,
            balls: Vec::new(),
            left_out: Vec::new(),
            cells,
            base_tree,
            input_tree,
            first,
            round: 0,
            topology: self.topology,
            refusals: 0,
        };
        while state.round < MAX_ROUNDS && !current.thin.is_empty() {
            let Some(next) = self.context.unless_late(self.round(&current, &mut state))? else {
                best.reason = Some(ThinReason::Time);
                break;
            };
            state.round += 1;
            best.reason = next.reason.or(best.reason);
            if next.surface == current.surface {
                best.limited.extend(next.limited);
                // A second round also puts balls around thin pairs that no ball touches.
                if state.round > 1 {
                    break;
                }
            } else {
                current = next;
            }
            let deviation = || deviation_of_added((self.input, &state.input_tree), &current.surface);
            if current.thin.lack < best.thin.lack && deviation() <= MAX_DEVIATION * self.settings.min_wall {
                best = current.clone();
            }
        }
        Ok(best)
    }

    /// The finest cells with which the body of the first round has few enough faces. The number of faces with the coarsest
    /// cells, which are quick to build, tells it. Also the balls of the first round, if they are known then.
    fn cells_for(&self, base: &Grown) -> Result<(Cells, Option<Vec<Filler>>), Cancelled> {
        let [finer @ .., coarsest] = CELLS;
        let Some(fillers) = self.fillers(base, coarsest, 0)? else { return Ok((coarsest, None)) };
        let faces = match self.body(&fillers, coarsest.share, u64::MAX) {
            Ok(body) => body.faces.len() as f64,
            Err(RemeshError::Empty) => 0.0,
            Err(RemeshError::Cancelled(cancelled)) => return Err(cancelled),
            Err(_) => f64::INFINITY,
        };
        let fits = |cells: &Cells| faces * (coarsest.share / cells.share).powi(2) <= cells.max_faces as f64;
        Ok(finer.into_iter().find(fits).map_or((coarsest, Some(fillers)), |finer| (finer, None)))
    }

    /// The balls that a result still needs; none if there are too many.
    fn fillers(&self, current: &Grown, cells: Cells, round: usize) -> Result<Option<Vec<Filler>>, Cancelled> {
        let margin = cells.margin + (MORE[0] * (round * round) as f64).min(MORE[1]);
        let search = Search { spacing: cells.share * self.settings.min_wall, margin, is_first: round == 0 };
        Fillers::new(&current.surface, self.settings, search).of(&current.thin, self.context)
    }

    /// One round. The surface stays the same if nothing can grow.
    fn round(&self, current: &Grown, state: &mut State<'_>) -> Result<Grown, Cancelled> {
        let mut next = Grown { reason: Some(ThinReason::Union), ..current.clone() };
        let fillers = match state.first.take() {
            Some(first) => Some(first),
            None => self.fillers(current, state.cells, state.round)?,
        };
        let Some(mut fillers) = fillers else { return Ok(next) };
        next.limited.extend(fillers.iter().filter(|filler| filler.is_limited).map(|filler| filler.centre));
        fillers.par_iter_mut().for_each(|filler| filler.radius = self.allowed_radius(filler, state));
        let is_left_out = |filler: &Filler| {
            let near = 0.5 * self.settings.min_wall;
            state.left_out.iter().find(|(other, _)| other.centre.distance(filler.centre) < near).map(|&(_, why)| why)
        };
        next.reason = fillers.iter().find_map(is_left_out).map(reason);
        fillers.retain(|filler| filler.radius > 0.0 && is_left_out(filler).is_none());
        if fillers.is_empty() {
            return Ok(next);
        }
        let union = self.largest_union(fillers, state)?;
        next.reason = union.broken.map(reason).or(next.reason);
        if let Some(surface) = union.surface {
            state.balls = union.balls;
            next.through_holes_closed = self.topology.handles_lost(state.topology);
            next.surface = self.with_sources(surface, (&state.base.surface, &state.base_tree));
            next.thin = Thin::after(current, &next.surface, self.settings.min_wall, self.context)?;
        }
        Ok(next)
    }

    /// The radius with which a ball moves the input's surface by less than [`MAX_DEVIATION`]: at most that of the ball. None
    /// is left of a ball that would have to be smaller than a cell, since its surface can be a cell away from it.
    fn allowed_radius(&self, &Filler { centre, radius, .. }: &Filler, state: &State<'_>) -> f64 {
        let min_wall = self.settings.min_wall;
        let most = BALLS_DEVIATION * MAX_DEVIATION * min_wall;
        let corners = |face: u32| self.input.corners(face as usize);
        let nearest = state.input_tree.nearest(centre, f64::INFINITY, &mut u64::MAX.clone(), corners);
        let Some(nearest) = nearest else { return radius };
        let [a, b, c] = corners(nearest.face);
        let is_inside = (b - a).cross(c - a).dot(centre - nearest.point) < 0.0;
        let allowed = if is_inside { most + nearest.distance } else { most - nearest.distance };
        if allowed < radius.min(state.cells.share * min_wall) { 0.0 } else { radius.min(allowed) }
    }

    /// The surface of a union of balls, with cells of a share of the least wall.
    fn body(&self, fillers: &[Filler], share: f64, max_faces: u64) -> Result<Surface, RemeshError> {
        let balls: Vec<_> = fillers.iter().map(|filler| (filler.centre, filler.radius)).filter(|b| b.1 > 0.0).collect();
        let (precision, cell) = (self.settings.precision, share * self.settings.min_wall);
        let bounds = self.input.bounds().grown(4.0 * self.settings.min_wall);
        let union = BallUnion { balls: &balls, bounds, cell, max_faces, max_memory: MAX_MEMORY, precision };
        let mut surface = union.surface(self.context)?;
        Spheres::new(&balls, cell, precision).fit(&mut surface);
        Ok(surface)
    }

    /// The union with the balls of all rounds and as many new ones as possible. By halving, where a promise is broken.
    fn largest_union(&self, new: Vec<Filler>, state: &mut State<'_>) -> Result<Union, Cancelled> {
        let mut best = Union { surface: None, balls: state.balls.clone(), broken: None };
        let fewest = new.len() / LEFT_OUT;
        let mut open = vec![new];
        for _ in 0..MAX_UNIONS {
            let Some(some) = open.pop() else { break };
            let with = [&best.balls[..], &some].concat();
            let union = self.union_of(state, &[(&with, state.cells.share)])?;
            let broken_in = |(_, topology): &(Surface, Topology)| topology.broken_since(state.topology);
            let mut broken = union.as_ref().map_or(Some(Broken::Union), broken_in);
            if broken == Some(Broken::ThroughHole) && state.refusals < MAX_REFUSALS {
                if self.leaves_wide_holes_open(&with, state)? {
                    broken = None;
                } else {
                    state.refusals += 1;
                }
            }
            if let Some(broken) = broken {
                best.broken = Some(broken);
                if some.len() > fewest.max(1) {
                    open.extend(halves(some));
                } else {
                    state.left_out.extend(some.into_iter().map(|filler| (filler, broken)));
                }
            } else if let Some((surface, topology)) = union {
                state.topology = state.topology.without_holes_missing_in(topology);
                (best.surface, best.balls) = (Some(surface), with);
            }
        }
        Ok(best)
    }

    /// Whether new balls leave each through hole of the base open that is wider than the least gap, as far as that is known.
    /// They come after those of earlier rounds.
    fn leaves_wide_holes_open(&self, balls: &[Filler], state: &State<'_>) -> Result<bool, Cancelled> {
        let (earlier, new) = balls.split_at(state.balls.len());
        let reach = |ball: &Filler| Filler { radius: ball.radius + self.settings.min_gap, ..*ball };
        let near: Vec<Filler> = new.iter().map(reach).collect();
        let over = balls_over_gaps((self.input, &state.input_tree), &near, &self.settings, self.context)?;
        let Some(over) = over.filter(|over| !over.is_empty()) else { return Ok(false) };
        let topology = |balls: &[Filler]| {
            let over = (&over[..], CELL * self.settings.min_gap / self.settings.min_wall);
            let union = self.union_of(state, &[over, (balls, state.cells.share)])?;
            Ok(union.map(|(_, topology)| topology))
        };
        let Some(base) = topology(&[])? else { return Ok(false) };
        let Some(before) = topology(earlier)? else { return Ok(false) };
        for clearance in CLEARANCES {
            let larger = |ball: &Filler| Filler { radius: ball.radius + clearance * self.settings.min_wall, ..*ball };
            let larger: Vec<Filler> = earlier.iter().copied().chain(new.iter().map(larger)).collect();
            let Some(after) = topology(&larger)? else { return Ok(false) };
            if base.handles_lost(after) > 0 || before.handles_lost(after) > 0 {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// The union of the base and bodies of balls, each with the size of its cells as a share of the least wall, and its
    /// topology; none if it fails.
    fn union_of(
        &self,
        state: &State<'_>,
        bodies: &[(&[Filler], f64)],
    ) -> Result<Option<(Surface, Topology)>, Cancelled> {
        let mut all = state.base.surface.clone();
        for &(balls, share) in bodies {
            match self.body(balls, share, MAX_MORE_FACES * state.cells.max_faces) {
                Ok(body) => all.append(Surface { source: vec![self.mark(); body.faces.len()], ..body }),
                Err(RemeshError::Empty) => {}
                Err(RemeshError::Cancelled(cancelled)) => return Err(cancelled),
                Err(_) => return Ok(None),
            }
        }
        united(&all, (Added::Balls, self.faces()), &self.settings, self.union, self.context)
    }

    /// The number of the input's faces.
    fn faces(&self) -> u32 {
        face_count(self.input)
    }

    /// The source of a body's faces.
    fn mark(&self) -> u32 {
        2 * self.faces()
    }

    /// Gives the faces of a body the source of the nearest face below.
    fn with_sources(&self, mut united: Surface, (below, tree): (&Surface, &Tree)) -> Surface {
        let nearest = |face: usize| {
            let centre = united.corners(face).into_iter().sum::<DVec3>() / 3.0;
            let found = tree.nearest(centre, f64::INFINITY, &mut u64::MAX.clone(), |f| below.corners(f as usize));
            found.map_or(self.faces(), |found| below.source[found.face as usize] % self.faces() + self.faces())
        };
        let source = |face: usize| if united.source[face] == self.mark() { nearest(face) } else { united.source[face] };
        united.source = (0..united.faces.len()).into_par_iter().map(source).collect();
        united
    }
}

/// Balls in two halves, across the longest side of the box of their centres.
fn halves(mut balls: Vec<Filler>) -> [Vec<Filler>; 2] {
    let bounds = Box3::of(balls.iter().map(|ball| ball.centre));
    let size = bounds.max - bounds.min;
    let axis = (0..3).fold(0, |longest, axis| if size[axis] > size[longest] { axis } else { longest });
    balls.sort_by(|a, b| a.centre[axis].total_cmp(&b.centre[axis]));
    let second = balls.split_off(balls.len() / 2);
    [second, balls]
}

fn reason(broken: Broken) -> ThinReason {
    match broken {
        Broken::Union => ThinReason::Union,
        Broken::Parts | Broken::ThroughHole => ThinReason::Topology,
    }
}
