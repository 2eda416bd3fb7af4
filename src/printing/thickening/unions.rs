//! Unions of a solid with balls that keep their promises: no union fails, changes the large cavities or joins solids, or
//! closes a wide through hole. Balls that break a promise are found by groups and halves, and left out.

use std::collections::BTreeMap;

use crate::context::{Cancelled, Context};
use crate::math::{Box3, Tree};
use crate::mesh::{Surface, position_key};
use crate::remesh::{BallUnion, RemeshError};
use rayon::prelude::*;
use rustc_hash::FxHashSet;

use super::bodies::Filler;
use super::gaps::{CELL, balls_over_gaps, bridging};
use super::handles::ChangedGroups;
use super::outcome::Thickening;
use super::results::{Grown, Thin, face_count};
use super::spheres::Spheres;
use super::unite::{Added, Broken, SelfUnion, Topology, changed_cavities, united};

/// How many times the faces of the first round's body a later body may have.
const MAX_MORE_FACES: u64 = 3;
/// The most memory of a body's samples.
const MAX_MEMORY: u64 = 1 << 29;
/// The most unions of a round. More than one is needed only where a promise is broken.
const MAX_UNIONS: usize = 8;
/// Wide through holes must stay open for balls that are larger by this share of the least wall, each time. So they stay wider
/// than twice that. Two sizes, since where balls meet faces, the narrow tunnel of a crease can hide that a hole is closed;
/// it hardly ever does with both.
const CLEARANCES: [f64; 2] = [0.1, 0.14];
/// After how many refusals closed holes are not checked for their width any more. Each check takes several unions.
const MAX_REFUSALS: usize = 2;
/// The widest gap that new balls of both sides can bridge, in least walls.
const WIDEST_BRIDGE: f64 = 2.5;
/// Balls that break a promise are left out in groups of at most these fractions of a round's balls, and of those that were
/// suspected first: one in so many.
const LEFT_OUT: [usize; 2] = [16, 2];

/// A size of cells.
#[derive(Clone, Copy)]
pub struct Cells {
    /// The edge length as a share of the least wall.
    pub share: f64,
    /// The share by which balls are larger than the least wall, to cover the error of their surface.
    pub margin: f64,
    /// The most faces of the first round's body.
    pub max_faces: u64,
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
pub struct State<'a> {
    /// The surface with which the balls of all rounds are united, so that no round cuts what another added.
    pub base: &'a Grown,
    /// The balls of the rounds so far.
    pub balls: Vec<Filler>,
    /// Balls that broke a promise, and why.
    pub left_out: Vec<(Filler, Broken)>,
    pub cells: Cells,
    /// The tree of the base, for the sources.
    pub base_tree: Tree,
    /// The tree of the input, for the deviation.
    pub input_tree: Tree,
    /// The group of solids of each of the input's faces, if there are several groups.
    pub group_of_face: Option<Vec<u32>>,
    /// The balls of the first round, if they are known.
    pub first: Option<Vec<Filler>>,
    /// The number of the round.
    pub round: usize,
    /// The topology that the next result must have.
    pub topology: Topology,
    /// Whether gaps limit nearly all new balls.
    pub is_limited: bool,
    /// How many times a wide hole was perhaps closed.
    pub refusals: usize,
    /// How many narrow through holes were closed near a ball, which is given by its number.
    pub allowed: Vec<(usize, i64)>,
    /// The base without narrow gaps, if it was needed.
    pub closed_gaps: Option<ClosedGaps>,
}

/// A surface whose narrow gaps near some balls are closed. Through holes that it still has are wide.
pub struct ClosedGaps {
    /// The centres of the balls.
    balls: FxHashSet<[u64; 3]>,
    surface: Surface,
    topology: Topology,
}

impl ClosedGaps {
    /// Whether the gaps are closed near all of some balls.
    fn are_near(&self, balls: &[Filler]) -> bool {
        balls.iter().all(|ball| self.balls.contains(&position_key(ball.centre)))
    }
}

/// A union before and after new balls.
struct Change<'a> {
    /// All balls, the new ones last.
    balls: &'a [Filler],
    /// The number of earlier balls.
    earlier: usize,
    before: &'a Surface,
    after: &'a Surface,
    /// The topology after it.
    topology: Topology,
}

/// A union with some of the balls of a round.
pub struct Union {
    /// None if no union kept its promises.
    pub surface: Option<Surface>,
    /// The balls that are part of it.
    pub balls: Vec<Filler>,
    /// Why others are not.
    pub broken: Option<Broken>,
}

impl Filling<'_> {
    /// The surface of a union of balls, with cells of a share of the least wall.
    pub fn body(&self, fillers: &[Filler], share: f64, max_faces: u64) -> Result<Surface, RemeshError> {
        let balls: Vec<_> = fillers.iter().map(|filler| (filler.centre, filler.radius)).filter(|b| b.1 > 0.0).collect();
        let (precision, cell) = (self.settings.precision, share * self.settings.min_wall);
        let bounds = self.input.bounds().grown(4.0 * self.settings.min_wall);
        let union = BallUnion { balls: &balls, bounds, cell, max_faces, max_memory: MAX_MEMORY, precision };
        let mut surface = union.surface(self.context)?;
        Spheres::new(&balls, cell, precision).fit(&mut surface);
        Ok(surface)
    }

    /// The union with the balls of all rounds and as many new ones as possible. Balls that perhaps break a promise are tried
    /// again in halves of their groups, all first halves at once, and left out if they are few.
    pub fn largest_union(
        &self,
        new: Vec<Filler>,
        current: &Surface,
        state: &mut State<'_>,
    ) -> Result<Union, Cancelled> {
        let mut best = Union { surface: None, balls: state.balls.clone(), broken: None };
        let few_of_all = new.len() / LEFT_OUT[0];
        let mut fewest = None;
        let mut open = vec![new];
        for _ in 0..MAX_UNIONS {
            let Some(some) = open.pop() else { break };
            let with = [&best.balls[..], &some].concat();
            let union = self.union_of(state, &with)?;
            let (broken, suspects) = if let Some((after, topology)) = &union {
                let before = best.surface.as_ref().unwrap_or(current);
                let change = Change { balls: &with, earlier: best.balls.len(), before, after, topology: *topology };
                self.suspects(&change, state)?
            } else {
                (Broken::Union, vec![Some(0); some.len()])
            };
            if let Some((surface, topology)) = union.filter(|_| suspects.iter().all(Option::is_none)) {
                state.topology = state.topology.without_holes_missing_in(topology);
                (best.surface, best.balls) = (Some(surface), with);
                continue;
            }
            best.broken = Some(broken);
            let (mut kept, mut groups) = (Vec::new(), BTreeMap::<u32, Vec<Filler>>::new());
            for (filler, group) in some.into_iter().zip(suspects) {
                group.map_or(&mut kept, |group| groups.entry(group).or_default()).push(filler);
            }
            let suspected = groups.values().map(Vec::len).sum::<usize>();
            let fewest = *fewest.get_or_insert(few_of_all.min(suspected / LEFT_OUT[1]).max(1));
            let [mut first, mut second] = [Vec::new(), Vec::new()];
            for group in groups.into_values() {
                if group.len() <= fewest {
                    state.left_out.extend(group.into_iter().map(|filler| (filler, broken)));
                } else {
                    let [one, other] = halves(group);
                    first.extend(one);
                    second.extend(other);
                }
            }
            open.extend([second, first, kept].into_iter().filter(|balls| !balls.is_empty()));
        }
        Ok(best)
    }

    /// The promise that a union perhaps breaks, and for each new ball its group, if the group perhaps breaks it.
    fn suspects(&self, change: &Change<'_>, state: &mut State<'_>) -> Result<(Broken, Vec<Option<u32>>), Cancelled> {
        Ok(match change.topology.broken_since(state.topology) {
            Some(Broken::Parts) => (Broken::Parts, self.at_changed_parts(change, state)?),
            _ => (Broken::ThroughHole, self.bridging(self.at_closed_holes(change, state)?, change)?),
        })
    }

    /// Of suspected balls those that bridge a wide gap; all of a group in which none does.
    fn bridging(&self, suspects: Vec<Option<u32>>, change: &Change<'_>) -> Result<Vec<Option<u32>>, Cancelled> {
        let new = &change.balls[change.earlier..];
        let numbers: Vec<usize> = (0..new.len()).filter(|&ball| suspects[ball].is_some()).collect();
        if numbers.is_empty() {
            return Ok(suspects);
        }
        let balls: Vec<Filler> = numbers.iter().map(|&ball| new[ball]).collect();
        let tree = Tree::new(&change.before.positions, &change.before.faces);
        let widths = [self.settings.min_gap, WIDEST_BRIDGE * self.settings.min_wall];
        let is_bridging = bridging((change.before, &tree), &balls, widths, self.context)?;
        let bridging = numbers.into_iter().zip(is_bridging).filter(|(_, is_bridging)| *is_bridging);
        let bridging: FxHashSet<usize> = bridging.map(|(ball, _)| ball).collect();
        let with_bridges: FxHashSet<Option<u32>> = bridging.iter().map(|&ball| suspects[ball]).collect();
        let is_suspect =
            |&(ball, group): &(usize, Option<u32>)| !with_bridges.contains(&group) || bridging.contains(&ball);
        Ok(suspects.into_iter().enumerate().map(|of| if is_suspect(&of) { of.1 } else { None }).collect())
    }

    /// For each new ball the group 0, if the ball is at a large cavity that was closed, opened or divided; if none is, because
    /// solids were joined, those that bridge a wide gap.
    fn at_changed_parts(&self, change: &Change<'_>, state: &State<'_>) -> Result<Vec<Option<u32>>, Cancelled> {
        let corners = changed_cavities(change.before, change.after, &self.settings).concat();
        let tree = Tree::of_boxes(&corners.iter().map(|&corner| Box3::of([corner])).collect::<Vec<_>>());
        let is_near = |ball: &Filler| {
            let reach = ball.radius + state.cells.share * self.settings.min_wall;
            let mut is_near = false;
            tree.overlapping(&Box3::of([ball.centre]).grown(reach), |corner| {
                is_near = corners[corner as usize].distance(ball.centre) < reach;
                !is_near
            });
            is_near
        };
        let new = &change.balls[change.earlier..];
        let near: Vec<Option<u32>> = new.par_iter().map(|ball| is_near(ball).then_some(0)).collect();
        if near.iter().any(Option::is_some) { Ok(near) } else { self.bridging(vec![Some(0); new.len()], change) }
    }

    /// For each new ball its group, if the group perhaps closes a wide through hole.
    fn at_closed_holes(&self, change: &Change<'_>, state: &mut State<'_>) -> Result<Vec<Option<u32>>, Cancelled> {
        let clearance = CLEARANCES.into_iter().fold(0.0, f64::max);
        let reach = (clearance + state.cells.share) * self.settings.min_wall;
        let groups = ChangedGroups::new(change.balls, change.earlier, reach);
        let lost = groups.all.topology(&state.base.surface).handles_lost(&groups.all.topology(change.after));
        let lost = groups.without_allowed(lost, &state.allowed);
        let is_lost = change.topology.broken_since(state.topology).is_some();
        if !is_lost && lost.iter().all(|lost| *lost <= 0) {
            return Ok(vec![None; groups.new.of_ball.len()]);
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
        Ok(groups.new.of_ball.iter().map(|&group| suspects[group as usize].then_some(group)).collect())
    }

    /// Keeps of the groups of new balls those that perhaps close a through hole that is wider than the least gap.
    fn keep_closing_wide_holes(
        &self,
        suspects: &mut [bool],
        (change, groups): (&Change<'_>, &ChangedGroups<'_>),
        state: &mut State<'_>,
    ) -> Result<(), Cancelled> {
        let (earlier, new) = change.balls.split_at(change.earlier);
        let suspected = new.iter().zip(&groups.new.of_ball).filter(|(_, group)| suspects[**group as usize]);
        let suspected: Vec<Filler> = suspected.map(|(ball, _)| *ball).collect();
        if !state.closed_gaps.as_ref().is_some_and(|closed| closed.are_near(&suspected)) {
            state.closed_gaps = self.closed_gaps(&suspected, state)?;
        }
        let Some(closed) = &state.closed_gaps else { return Ok(()) };
        let union = |balls: &[Filler]| self.united_with(&closed.surface, balls, (state, state.cells.share));
        let base = groups.all.topology(&closed.surface);
        let allowed = u64::try_from(state.allowed.iter().map(|allowed| allowed.1).sum::<i64>()).unwrap_or(0);
        let mut before = None;
        let mut is_closed = vec![false; suspects.len()];
        let are_all_closed =
            |is_closed: &[bool]| !suspects.iter().zip(is_closed).any(|(suspect, closed)| *suspect && !closed);
        for clearance in CLEARANCES {
            if are_all_closed(&is_closed) {
                break;
            }
            let larger = |ball: &Filler| Filler { radius: ball.radius + clearance * self.settings.min_wall, ..*ball };
            let larger: Vec<Filler> = earlier.iter().copied().chain(new.iter().map(larger)).collect();
            let Some((after, topology)) = union(&larger)? else { return Ok(()) };
            let lost = base.handles_lost(&groups.all.topology(&after));
            let in_total = lost.is_none() && closed.topology.handles_lost(topology) > allowed;
            let lost = groups.without_allowed(lost, &state.allowed);
            for (group, is_closed) in is_closed.iter_mut().enumerate() {
                *is_closed |= in_total || lost[groups.of_new[group]] > 0;
            }
            if are_all_closed(&is_closed) {
                break;
            }
            let known = match before.take() {
                Some(known) => known,
                None => {
                    let Some((surface, topology)) = union(earlier)? else { return Ok(()) };
                    (groups.new.topology(&surface), topology)
                }
            };
            let (before, topology_before) = &*before.insert(known);
            let lost = before.handles_lost(&groups.new.topology(&after));
            let in_total = i64::from(topology_before.handles_lost(topology) > 0);
            let lost = lost.unwrap_or_else(|| vec![in_total; suspects.len()]);
            is_closed.iter_mut().zip(lost).for_each(|(is_closed, lost)| *is_closed |= lost > 0);
        }
        suspects.iter_mut().zip(is_closed).for_each(|(suspect, is_closed)| *suspect &= is_closed);
        Ok(())
    }

    /// The base with its narrow gaps near some balls closed. None if there are none, or if that fails.
    fn closed_gaps(&self, balls: &[Filler], state: &State<'_>) -> Result<Option<ClosedGaps>, Cancelled> {
        let reach = |ball: &Filler| Filler { radius: ball.radius + self.settings.min_gap, ..*ball };
        let near: Vec<Filler> = balls.iter().map(reach).collect();
        let over = balls_over_gaps((self.input, &state.input_tree), &near, &self.settings, self.context)?;
        let Some(over) = over.filter(|over| !over.is_empty()) else { return Ok(None) };
        let cell = CELL * self.settings.min_gap / self.settings.min_wall;
        let closed = self.united_with(&state.base.surface, &over, (state, cell))?;
        let balls = balls.iter().map(|ball| position_key(ball.centre)).collect();
        Ok(closed.map(|(surface, topology)| ClosedGaps { balls, surface, topology }))
    }

    /// The union of the base and balls, with cells of a share of the least wall, and its topology; none if it fails.
    fn union_of(&self, state: &State<'_>, balls: &[Filler]) -> Result<Option<(Surface, Topology)>, Cancelled> {
        self.united_with(&state.base.surface, balls, (state, state.cells.share))
    }

    /// [`Filling::union_of`] on another surface, with cells of another share.
    fn united_with(
        &self,
        surface: &Surface,
        balls: &[Filler],
        (state, share): (&State<'_>, f64),
    ) -> Result<Option<(Surface, Topology)>, Cancelled> {
        let mut all = surface.clone();
        match self.body(balls, share, MAX_MORE_FACES * state.cells.max_faces) {
            Ok(body) => all.append(Surface { source: vec![self.mark(); body.faces.len()], ..body }),
            Err(RemeshError::Empty) => {}
            Err(RemeshError::Cancelled(cancelled)) => return Err(cancelled),
            Err(_) => return Ok(None),
        }
        united(&all, (Added::Balls, self.faces()), &self.settings, self.union, self.context)
    }

    /// The number of the input's faces.
    pub fn faces(&self) -> u32 {
        face_count(self.input)
    }

    /// The source of a body's faces.
    pub fn mark(&self) -> u32 {
        2 * self.faces()
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
