//! Unions of a solid with balls that keep their promises: no union fails, changes the large cavities, joins solids, or closes a
//! wide through hole. Where a hole was closed, balls leave the middles of wide gaps free. Those that still break a promise
//! are found by halves, and left out.

use std::ops::Range;
use std::time::Duration;

use crate::context::{Cancelled, Context};
use crate::math::{Box3, Tree};
use crate::mesh::Surface;
use crate::remesh::{BallUnion, RemeshError};
use glam::DVec3;
use rayon::prelude::*;

use super::gaps::{GapWidths, WideGaps};
use super::handles::{BallGroups, ChangedGroups, joining_solids};
use super::limits::{Filler, Limits};
use super::outcome::Thickening;
use super::pockets::Added;
use super::results::{Grown, Thin, face_count};
use super::spheres::Spheres;
use super::unite::{Broken, SelfUnion, Topology, United, changed_cavities, united};

/// How many times the faces of the first round's body a later body may have.
const MAX_MORE_FACES: u64 = 3;
/// The most memory of a body's samples.
const MAX_MEMORY: u64 = 1 << 29;
/// The most unions of a round. More than one is needed only where a promise is broken.
const MAX_UNIONS: usize = 8;
/// The widest gap that new balls of both sides can close, in least walls.
const WIDEST_BRIDGE: f64 = 2.5;
/// The share of half of the least gap that stays free around the middle of a wide gap. The rest is for rounding.
const FREE: f64 = 0.95;
/// How far the surface of all balls exceeds balls at most, in cells. So far, the middle of a wide gap stays free in any case.
const MAX_EXCESS: f64 = 0.5;
/// Balls whose distance is less than twice this share of the least wall and a cell belong to one group.
const GROUP_REACH: f64 = 0.14;
/// Balls that break a promise are left out where at most these fractions of a round's balls, or of those that were suspected
/// first, are suspected: one in so many.
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
#[derive(Clone, Copy)]
pub struct Filling<'a> {
    pub settings: Thickening,
    pub union: &'a dyn SelfUnion,
    pub context: &'a Context<'a>,
    /// The time that is kept for the end as long as no result was measured.
    pub kept: Duration,
    /// The limits of single balls in the surface to thicken. Sources from the number of its faces on mean added faces.
    pub limits: &'a Limits<'a>,
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
    /// The balls of the first round, if they are known.
    pub first: Option<Vec<Filler>>,
    /// The number of the round.
    pub round: usize,
    /// The time that is kept for the end, by the slowest measurement of a result; none before the first one.
    pub kept: Option<Duration>,
    /// The topology that the next result must have.
    pub topology: Topology,
    /// Whether gaps limit nearly all new balls.
    pub is_limited: bool,
}

/// New balls in a union.
struct Change<'a> {
    /// All balls, the new ones last.
    balls: &'a [Filler],
    /// The number of earlier balls.
    earlier: usize,
    /// The surface without the new balls.
    before: &'a Surface,
}

impl Change<'_> {
    /// The numbers of the new balls.
    fn new_balls(&self) -> Range<usize> {
        self.earlier..self.balls.len()
    }

    /// Those of some balls that can still close wide gaps.
    fn unguarded(&self, numbers: impl Iterator<Item = usize>) -> Vec<usize> {
        numbers.filter(|&ball| !self.balls[ball].is_guarded).collect()
    }
}

/// Balls that perhaps break a promise.
struct Suspects {
    broken: Broken,
    /// Their numbers.
    balls: Vec<usize>,
    /// Whether the promise is kept if they leave the wide gaps open.
    are_guarded: bool,
}

/// A union with some of the balls of a round.
pub struct Union {
    /// None if no union kept its promises.
    pub surface: Option<Surface>,
    /// The number of narrow slits that it filled.
    pub slits_filled: u64,
    /// The balls that are part of it.
    pub balls: Vec<Filler>,
    /// The centres of new balls that are smaller than wanted, or missing, so that wide gaps stay open.
    pub limited: Vec<DVec3>,
    /// Why others are not part of it.
    pub broken: Option<Broken>,
}

impl Filling<'_> {
    /// The surface of a union of balls, with cells of a share of the least wall.
    pub fn body(&self, fillers: &[Filler], share: f64, max_faces: u64) -> Result<Surface, RemeshError> {
        let balls: Vec<_> = fillers.iter().map(|filler| (filler.centre, filler.radius)).filter(|b| b.1 > 0.0).collect();
        let (precision, cell) = (self.settings.precision, share * self.settings.min_wall);
        let bounds = self.limits.input.bounds().grown(4.0 * self.settings.min_wall);
        let union = BallUnion { balls: &balls, bounds, cell, max_faces, max_memory: MAX_MEMORY, precision };
        let mut surface = union.surface(self.context)?;
        Spheres::new(&balls, cell, precision).fit(&mut surface);
        Ok(surface)
    }

    /// The middles of the wide gaps near some balls; none if there are too many.
    fn wide_gaps(&self, balls: &[Filler], state: &State<'_>) -> Result<Option<WideGaps>, Cancelled> {
        let Thickening { min_wall, min_gap, .. } = self.settings;
        let free = (FREE * min_gap / 2.0).max(MAX_EXCESS * state.cells.share * min_wall);
        let widths = GapWidths { least: min_gap, most: WIDEST_BRIDGE * min_wall, free };
        WideGaps::near(self.limits, balls, widths, self.context)
    }

    /// The union with the balls of all rounds and as many new ones as possible. Balls that perhaps close a wide gap get smaller.
    /// Those that still break a promise are tried again in halves, and left out if they are few.
    pub fn largest_union(
        &self,
        new: Vec<Filler>,
        current: &Surface,
        state: &mut State<'_>,
    ) -> Result<Union, Cancelled> {
        let mut best =
            Union { surface: None, slits_filled: 0, balls: state.balls.clone(), limited: Vec::new(), broken: None };
        let mut tries = Tries::new(&state.balls, self.guarded_beside_guarded(new, &mut best, state)?);
        for _ in 0..MAX_UNIONS {
            let Some(some) = tries.open.pop() else { break };
            let with = [&tries.earlier[..], &some].concat();
            let before = best.surface.as_ref().unwrap_or(current);
            let change = Change { balls: &with, earlier: tries.earlier.len(), before };
            let union = self.union_of(&with, state)?;
            let suspects = self.suspects(&change, union.as_ref(), state)?;
            if suspects.balls.is_empty() {
                if let Some(United { surface, topology, slits_filled }) = union {
                    state.topology = state.topology.without_holes_missing_in(topology);
                    tries.earlier.clone_from(&with);
                    (best.surface, best.slits_filled, best.balls) = (Some(surface), slits_filled, with);
                }
                continue;
            }
            let guarded =
                if suspects.are_guarded { None } else { self.guarded(&with, &suspects.balls, &mut best, state)? };
            if let Some(guarded) = guarded {
                tries.again(&guarded);
            } else {
                best.broken = Some(suspects.broken);
                let left_out = tries.in_halves(some, &suspects);
                state.left_out.extend(left_out.into_iter().map(|filler| (filler, suspects.broken)));
            }
        }
        Ok(best)
    }

    /// The balls that perhaps break a promise in a union; none if it keeps all.
    fn suspects(&self, change: &Change<'_>, union: Option<&United>, state: &State<'_>) -> Result<Suspects, Cancelled> {
        let Some(United { surface: after, topology, .. }) = union else {
            return Ok(Suspects { broken: Broken::Union, balls: change.new_balls().collect(), are_guarded: true });
        };
        if topology.broken_since(state.topology) == Some(Broken::Parts) {
            return Ok(self.at_changed_parts(change, after, state));
        }
        let broken = Broken::ThroughHole;
        let (new, earlier) = self.at_closed_holes(change, (after, *topology), state);
        let unguarded = change.unguarded(new.iter().copied());
        if !unguarded.is_empty() {
            return Ok(Suspects { broken, balls: unguarded, are_guarded: false });
        }
        // The new balls leave the wide gaps open. Earlier ones can still be in the way, but stay as they are: what they made thick
        // is worth more than what the new ones add.
        let earlier = change.unguarded(earlier.into_iter());
        let are_in_the_way = !earlier.is_empty() && !self.leave_gaps_open(change.balls, &earlier, state)?;
        Ok(Suspects { broken, balls: if are_in_the_way { new } else { Vec::new() }, are_guarded: true })
    }

    /// The balls that perhaps change the solids or the large cavities.
    fn at_changed_parts(&self, change: &Change<'_>, after: &Surface, state: &State<'_>) -> Suspects {
        let broken = Broken::Parts;
        let near = self.near_changed_cavities(change, after, state);
        if !near.is_empty() {
            return Suspects { broken, balls: near, are_guarded: true };
        }
        let cell = state.cells.share * self.settings.min_wall;
        let joining = joining_solids(change.before, &change.balls[change.earlier..], cell);
        let joining: Vec<usize> = joining.into_iter().map(|ball| change.earlier + ball).collect();
        let is_known = !joining.is_empty();
        let unguarded =
            if is_known { change.unguarded(joining.iter().copied()) } else { change.unguarded(0..change.balls.len()) };
        if !unguarded.is_empty() {
            return Suspects { broken, balls: unguarded, are_guarded: false };
        }
        Suspects { broken, balls: if is_known { joining } else { change.new_balls().collect() }, are_guarded: true }
    }

    /// The new balls at large cavities that were closed, opened or divided.
    fn near_changed_cavities(&self, change: &Change<'_>, after: &Surface, state: &State<'_>) -> Vec<usize> {
        let corners = changed_cavities(change.before, after, &self.settings).concat();
        let tree = Tree::of_boxes(&corners.iter().map(|&corner| Box3::of([corner])).collect::<Vec<_>>());
        let is_near = |ball: &usize| {
            let ball = change.balls[*ball];
            let reach = ball.radius + state.cells.share * self.settings.min_wall;
            tree.any_overlapping(&Box3::of([ball.centre]).grown(reach), |corner| {
                corners[corner as usize].distance(ball.centre) < reach
            })
        };
        change.new_balls().into_par_iter().filter(is_near).collect()
    }

    /// The balls in groups of new balls where a through hole was closed, and the earlier balls that touch them.
    fn at_closed_holes(
        &self,
        change: &Change<'_>,
        (after, topology): (&Surface, Topology),
        state: &State<'_>,
    ) -> (Vec<usize>, Vec<usize>) {
        let groups = ChangedGroups::new(change.balls, change.earlier, self.group_reach(state));
        let lost = groups.all.topology(&state.base.surface).handles_lost(&groups.all.topology(after));
        let lost = lost.unwrap_or_else(|| vec![0; groups.all.count]);
        let is_lost = topology.broken_since(state.topology).is_some();
        if !is_lost && lost.iter().all(|lost| *lost <= 0) {
            return (Vec::new(), Vec::new());
        }
        let has_lost = |group: usize| lost.iter().all(|lost| *lost <= 0) || lost[groups.of_new[group]] > 0;
        let nearby = groups.new.topology(change.before).handles_lost(&groups.new.topology(after));
        let has_lost_nearby = |group: usize| nearby.as_ref().is_none_or(|nearby| nearby[group] > 0);
        let mut is_suspect: Vec<bool> = (0..groups.new.count).map(|g| has_lost(g) && has_lost_nearby(g)).collect();
        if !is_suspect.contains(&true) {
            is_suspect = (0..groups.new.count).map(has_lost).collect();
        }
        let new = &change.balls[change.earlier..];
        let of_suspects = |ball: &usize| is_suspect[groups.new.of_ball[*ball] as usize];
        let suspects: Vec<usize> = (0..new.len()).filter(of_suspects).collect();
        let bounds = |ball: &Filler| Box3::of([ball.centre]).grown(ball.radius);
        let tree = Tree::of_boxes(&suspects.iter().map(|&ball| bounds(&new[ball])).collect::<Vec<_>>());
        let touches = |ball: &usize| tree.any_overlapping(&bounds(&change.balls[*ball]), |_| true);
        let earlier = (0..change.earlier).filter(touches).collect();
        (suspects.iter().map(|ball| change.earlier + ball).collect(), earlier)
    }

    /// The distance from balls up to which a surface belongs to their group.
    fn group_reach(&self, state: &State<'_>) -> f64 {
        (GROUP_REACH + state.cells.share) * self.settings.min_wall
    }

    /// New balls, of which those beside earlier balls that leave the wide gaps open do so, too.
    fn guarded_beside_guarded(
        &self,
        new: Vec<Filler>,
        best: &mut Union,
        state: &State<'_>,
    ) -> Result<Vec<Filler>, Cancelled> {
        if state.balls.iter().all(|ball| !ball.is_guarded) {
            return Ok(new);
        }
        let all = [&state.balls[..], &new].concat();
        let groups = BallGroups::new(&all, self.group_reach(state));
        let mut has_guarded = vec![false; groups.count];
        for (ball, &group) in state.balls.iter().zip(&groups.of_ball) {
            has_guarded[group as usize] |= ball.is_guarded;
        }
        let is_beside = |ball: &usize| has_guarded[groups.of_ball[*ball] as usize];
        let beside: Vec<usize> = (state.balls.len()..all.len()).filter(is_beside).collect();
        let guarded = self.guarded(&all, &beside, best, state)?;
        let guarded = guarded.map(|all| not_empty(&all[state.balls.len()..]));
        Ok(guarded.unwrap_or(new))
    }

    /// Balls, of which those with some numbers move away or get smaller, so that they leave the wide gaps open. None if there are too
    /// many gaps.
    fn guarded(
        &self,
        balls: &[Filler],
        numbers: &[usize],
        best: &mut Union,
        state: &State<'_>,
    ) -> Result<Option<Vec<Filler>>, Cancelled> {
        let cell = state.cells.share * self.settings.min_wall;
        let some: Vec<Filler> = numbers.iter().map(|&ball| balls[ball]).collect();
        let Some(gaps) = self.wide_gaps(&some, state)? else { return Ok(None) };
        let free: Vec<Filler> = some.par_iter().map(|ball| gaps.left_open_by(*ball, (self.limits, cell))).collect();
        let mut guarded = balls.to_vec();
        for (&number, free) in numbers.iter().zip(free) {
            let ball = &mut guarded[number];
            if free.radius < ball.radius {
                best.limited.push(ball.centre);
            }
            *ball = Filler { is_guarded: true, ..free };
        }
        Ok(Some(guarded))
    }

    /// Whether the balls with some numbers leave the wide gaps open. False if there are too many gaps.
    fn leave_gaps_open(&self, balls: &[Filler], numbers: &[usize], state: &State<'_>) -> Result<bool, Cancelled> {
        let some: Vec<Filler> = numbers.iter().map(|&ball| balls[ball]).collect();
        let is_open =
            |gaps: WideGaps| some.par_iter().all(|ball| gaps.allowed(ball.centre, ball.radius) >= ball.radius);
        Ok(self.wide_gaps(&some, state)?.is_some_and(is_open))
    }

    /// The union of the base and balls, and its topology; none if it fails.
    fn union_of(&self, balls: &[Filler], state: &State<'_>) -> Result<Option<United>, Cancelled> {
        let mut all = state.base.surface.clone();
        match self.body(balls, state.cells.share, MAX_MORE_FACES * state.cells.max_faces) {
            Ok(body) => all.append(Surface { source: vec![self.mark(); body.faces.len()], ..body }),
            Err(RemeshError::Empty) => {}
            Err(RemeshError::Cancelled(cancelled)) => return Err(cancelled),
            Err(_) => return Ok(None),
        }
        united(&all, (Added::Balls, self.faces()), &self.settings, self.union, self.context)
    }

    /// The number of the input's faces.
    pub fn faces(&self) -> u32 {
        face_count(self.limits.input)
    }

    /// The source of a body's faces.
    pub fn mark(&self) -> u32 {
        2 * self.faces()
    }
}

/// The balls that are still to be tried in a union.
struct Tries {
    /// The balls of the last good union.
    earlier: Vec<Filler>,
    /// New balls, of which each list is tried with the earlier ones. The last list comes first.
    open: Vec<Vec<Filler>>,
    few_of_all: usize,
    /// The number of suspects that are left out.
    fewest: Option<usize>,
}

impl Tries {
    fn new(earlier: &[Filler], new: Vec<Filler>) -> Self {
        Self { earlier: earlier.to_vec(), few_of_all: new.len() / LEFT_OUT[0], open: vec![new], fewest: None }
    }

    /// Tries the balls of a union again, of which some got smaller.
    fn again(&mut self, balls: &[Filler]) {
        let (earlier, some) = balls.split_at(self.earlier.len());
        self.earlier.copy_from_slice(earlier);
        self.open.push(not_empty(some));
    }

    /// Tries new balls without the suspects, and these in halves. Returns the suspects if they are few.
    fn in_halves(&mut self, some: Vec<Filler>, suspects: &Suspects) -> Vec<Filler> {
        let mut is_suspect = vec![false; self.earlier.len() + some.len()];
        suspects.balls.iter().for_each(|&ball| is_suspect[ball] = true);
        let [mut suspected, mut kept] = [Vec::new(), Vec::new()];
        for (ball, &is_suspect) in some.into_iter().zip(&is_suspect[self.earlier.len()..]) {
            if is_suspect { &mut suspected } else { &mut kept }.push(ball);
        }
        let fewest = *self.fewest.get_or_insert(self.few_of_all.min(suspected.len() / LEFT_OUT[1]).max(1));
        if suspected.len() <= fewest {
            self.open.extend((!kept.is_empty()).then_some(kept));
            return suspected;
        }
        let [first, second] = halves(suspected);
        self.open.extend([second, first, kept].into_iter().filter(|balls| !balls.is_empty()));
        Vec::new()
    }
}

/// The balls of which something is left.
fn not_empty(balls: &[Filler]) -> Vec<Filler> {
    balls.iter().copied().filter(|ball| ball.radius > 0.0).collect()
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
