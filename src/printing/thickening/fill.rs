//! Rounds that unite a solid with balls along the middle of its thin places, until nothing is thin.

use crate::context::{Cancelled, Context};
use crate::math::{Box3, Tree};
use crate::mesh::{Parts, Surface};
use crate::remesh::{BallUnion, RemeshError};
use glam::DVec3;
use rayon::prelude::*;

use super::bodies::{Filler, Fillers, Search};
use super::gaps::{CELL, balls_over_gaps};
use super::handles::ChangedGroups;
use super::outcome::{Thickening, ThinReason};
use super::results::{Grown, Thin, deviation_of_added, face_count};
use super::spheres::Spheres;
use super::unite::{Added, Broken, FAR_AWAY, SelfUnion, Topology, group_of_each_face, united};

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
/// After how many refusals closed holes are not checked for their width any more. Each check takes several unions.
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
    /// Its thin walls.
    pub before: &'a Thin,
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
    /// The group of solids of each of the input's faces, if there are several groups.
    group_of_face: Option<Vec<u32>>,
    /// The balls of the first round, if they are known.
    first: Option<Vec<Filler>>,
    /// The number of the round.
    round: usize,
    /// The topology that the next result must have.
    topology: Topology,
    /// How many times a wide hole was perhaps closed.
    refusals: usize,
    /// How many narrow through holes were closed near a ball, which is given by its number.
    allowed: Vec<(usize, i64)>,
}

/// A union before and after new balls.
struct Change<'a> {
    /// All balls, the new ones last.
    balls: &'a [Filler],
    /// The number of earlier balls.
    earlier: usize,
    before: &'a Surface,
    after: &'a Surface,
    /// Whether the surface lacks a handle in total.
    is_lost: bool,
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
            group_of_face: group_of_each_face(self.input, &self.settings),
            first,
            round: 0,
            topology: self.topology,
            refusals: 0,
            allowed: Vec::new(),
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
            if current.is_better_than(&best, self.before) && deviation() <= MAX_DEVIATION * self.settings.min_wall {
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
        fillers.par_iter_mut().for_each(|filler| self.limit(filler, state));
        next.limited.extend(fillers.iter().filter(|filler| filler.is_limited).map(|filler| filler.centre));
        let is_left_out = |filler: &Filler| {
            let near = 0.5 * self.settings.min_wall;
            state.left_out.iter().find(|(other, _)| other.centre.distance(filler.centre) < near).map(|&(_, why)| why)
        };
        next.reason = fillers.iter().find_map(is_left_out).map(reason);
        fillers.retain(|filler| filler.radius > 0.0 && is_left_out(filler).is_none());
        if fillers.is_empty() {
            return Ok(next);
        }
        let union = self.largest_union(fillers, &current.surface, state)?;
        next.reason = union.broken.map(reason).or(next.reason);
        if let Some(surface) = union.surface {
            state.balls = union.balls;
            next.through_holes_closed = self.topology.handles_lost(state.topology);
            next.surface = self.with_sources(surface, (&state.base.surface, &state.base_tree));
            next.thin = Thin::after(current, &next.surface, self.settings.min_wall, self.context)?;
        }
        Ok(next)
    }

    /// Limits the radius of a ball, so that it moves the input's surface by less than [`MAX_DEVIATION`] and leaves the least
    /// gap to other solids. Nothing is left of a ball that would have to be smaller than a cell, since its surface can be a
    /// cell away from it.
    fn limit(&self, filler: &mut Filler, state: &State<'_>) {
        let min_wall = self.settings.min_wall;
        let most = BALLS_DEVIATION * MAX_DEVIATION * min_wall;
        let least = filler.radius.min(state.cells.share * min_wall);
        let nearest = |reach: f64, is_meant: &dyn Fn(u32) -> bool| {
            let corners = |face: u32| if is_meant(face) { self.input.corners(face as usize) } else { [FAR_AWAY; 3] };
            state.input_tree.nearest(filler.centre, reach, &mut u64::MAX.clone(), corners)
        };
        let Some(own) = nearest(f64::INFINITY, &|_| true) else { return };
        let [a, b, c] = self.input.corners(own.face as usize);
        let is_inside = (b - a).cross(c - a).dot(filler.centre - own.point) < 0.0;
        let depth = if is_inside { own.distance } else { -own.distance };
        let mut allowed = most + depth;
        if let Some(groups) = &state.group_of_face {
            // The ball takes half of what the gap is wider than the least one, since a ball of the other solid may take the rest.
            let gap = self.settings.least_gap();
            let of_solid = nearest(f64::INFINITY, &|face| groups[face as usize] != Parts::NONE);
            let group = of_solid.map_or(Parts::NONE, |nearest| groups[nearest.face as usize]);
            let is_other = |face: u32| ![group, Parts::NONE].contains(&groups[face as usize]);
            let other = nearest(2.0 * filler.radius + gap, &is_other);
            let most = other.map_or(f64::INFINITY, |other| (other.distance + depth.max(0.0) - gap) / 2.0);
            filler.is_limited |= most < filler.radius;
            allowed = allowed.min(most);
        }
        filler.radius = if allowed < least { 0.0 } else { filler.radius.min(allowed) };
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

    /// The union with the balls of all rounds and as many new ones as possible. Balls that close a wide through hole are left
    /// out by groups, as far as the change can be attributed to groups, and others that break a promise by halving.
    fn largest_union(&self, new: Vec<Filler>, current: &Surface, state: &mut State<'_>) -> Result<Union, Cancelled> {
        let mut best = Union { surface: None, balls: state.balls.clone(), broken: None };
        let fewest = (new.len() / LEFT_OUT).max(1);
        let mut open = vec![new];
        for _ in 0..MAX_UNIONS {
            let Some(some) = open.pop() else { break };
            let with = [&best.balls[..], &some].concat();
            let union = self.union_of(state, &[(&with, state.cells.share)])?;
            let broken_in = |(_, topology): &(Surface, Topology)| topology.broken_since(state.topology);
            // For each new ball how many are left out with it; 0 for a ball that stays.
            let (broken, left_out) = match (union.as_ref().map_or(Some(Broken::Union), broken_in), &union) {
                (broken @ (None | Some(Broken::ThroughHole)), Some((after, _))) => {
                    let (balls, earlier) = (&with[..], best.balls.len());
                    let before = best.surface.as_ref().unwrap_or(current);
                    let change = Change { balls, earlier, before, after, is_lost: broken.is_some() };
                    (Broken::ThroughHole, self.refused(&change, state)?)
                }
                (broken, _) => (broken.unwrap_or(Broken::Union), vec![some.len(); some.len()]),
            };
            if let Some((surface, topology)) = union.filter(|_| left_out.iter().all(|balls| *balls == 0)) {
                state.topology = state.topology.without_holes_missing_in(topology);
                (best.surface, best.balls) = (Some(surface), with);
                continue;
            }
            best.broken = Some(broken);
            let (mut kept, mut many) = (Vec::new(), Vec::new());
            for (filler, balls) in some.into_iter().zip(left_out) {
                match balls {
                    0 => kept.push(filler),
                    few if few <= fewest => state.left_out.push((filler, broken)),
                    _ => many.push(filler),
                }
            }
            if !many.is_empty() {
                open.extend(halves(many));
            }
            open.extend(Some(kept).filter(|kept| !kept.is_empty()));
        }
        Ok(best)
    }

    /// For each new ball how many there are in its group, if the group perhaps closes a wide through hole; else 0.
    fn refused(&self, change: &Change<'_>, state: &mut State<'_>) -> Result<Vec<usize>, Cancelled> {
        let clearance = CLEARANCES.into_iter().fold(0.0, f64::max);
        let reach = (clearance + state.cells.share) * self.settings.min_wall;
        let groups = ChangedGroups::new(change.balls, change.earlier, reach);
        let lost = groups.all.topology(&state.base.surface).handles_lost(&groups.all.topology(change.after));
        let lost = groups.without_allowed(lost, &state.allowed);
        if !change.is_lost && lost.iter().all(|lost| *lost <= 0) {
            return Ok(vec![0; groups.new.of_ball.len()]);
        }
        let has_lost = |group: usize| lost.iter().all(|lost| *lost <= 0) || lost[groups.of_new[group]] > 0;
        let nearby = groups.new.topology(change.before).handles_lost(&groups.new.topology(change.after));
        let has_lost_nearby = |group: usize| nearby.as_ref().is_none_or(|nearby| nearby[group] > 0);
        let mut suspects: Vec<bool> = (0..groups.new.count).map(|g| has_lost(g) && has_lost_nearby(g)).collect();
        if !suspects.contains(&true) {
            suspects = (0..groups.new.count).map(has_lost).collect();
        }
        if state.refusals < MAX_REFUSALS {
            self.keep_closing_wide_holes(&mut suspects, (change, &groups), state)?;
            state.refusals += usize::from(suspects.contains(&true));
        }
        if !suspects.contains(&true) {
            let first = |group: u32| groups.all.of_ball.iter().position(|of_ball| *of_ball == group);
            let allowed = (0u32..).zip(lost).filter(|(_, lost)| *lost > 0);
            state.allowed.extend(allowed.filter_map(|(group, lost)| Some((first(group)?, lost))));
        }
        let mut sizes = vec![0; groups.new.count];
        groups.new.of_ball.iter().for_each(|&group| sizes[group as usize] += 1);
        let size = |&group: &u32| if suspects[group as usize] { sizes[group as usize] } else { 0 };
        Ok(groups.new.of_ball.iter().map(size).collect())
    }

    /// Keeps of the groups of new balls those that perhaps close a through hole that is wider than the least gap.
    fn keep_closing_wide_holes(
        &self,
        suspects: &mut [bool],
        (change, groups): (&Change<'_>, &ChangedGroups<'_>),
        state: &State<'_>,
    ) -> Result<(), Cancelled> {
        let (earlier, new) = change.balls.split_at(change.earlier);
        let suspected = new.iter().zip(&groups.new.of_ball).filter(|(_, group)| suspects[**group as usize]);
        let reach = |(ball, _): (&Filler, _)| Filler { radius: ball.radius + self.settings.min_gap, ..*ball };
        let near: Vec<Filler> = suspected.map(reach).collect();
        let over = balls_over_gaps((self.input, &state.input_tree), &near, &self.settings, self.context)?;
        let Some(over) = over.filter(|over| !over.is_empty()) else { return Ok(()) };
        let union = |balls: &[Filler]| {
            let over = (&over[..], CELL * self.settings.min_gap / self.settings.min_wall);
            self.union_of(state, &[over, (balls, state.cells.share)])
        };
        let Some((base, topology_of_base)) = union(&[])? else { return Ok(()) };
        let Some((before, topology_before)) = union(earlier)? else { return Ok(()) };
        let [base, before] = [groups.all.topology(&base), groups.new.topology(&before)];
        let allowed = u64::try_from(state.allowed.iter().map(|allowed| allowed.1).sum::<i64>()).unwrap_or(0);
        let mut is_closed = vec![false; suspects.len()];
        for clearance in CLEARANCES {
            let larger = |ball: &Filler| Filler { radius: ball.radius + clearance * self.settings.min_wall, ..*ball };
            let larger: Vec<Filler> = earlier.iter().copied().chain(new.iter().map(larger)).collect();
            let Some((after, topology)) = union(&larger)? else { return Ok(()) };
            let since_base = base.handles_lost(&groups.all.topology(&after));
            let since_before = before.handles_lost(&groups.new.topology(&after));
            let lost_in_total = since_base.is_none() && topology_of_base.handles_lost(topology) > allowed
                || since_before.is_none() && topology_before.handles_lost(topology) > 0;
            let since_base = groups.without_allowed(since_base, &state.allowed);
            let since_before = since_before.unwrap_or_else(|| vec![0; suspects.len()]);
            for (group, is_closed) in is_closed.iter_mut().enumerate() {
                *is_closed |= lost_in_total || since_base[groups.of_new[group]] > 0 || since_before[group] > 0;
            }
        }
        suspects.iter_mut().zip(is_closed).for_each(|(suspect, is_closed)| *suspect &= is_closed);
        Ok(())
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
