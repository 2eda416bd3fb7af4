//! Rounds that unite a solid with balls along the middle of its thin places, until nothing is thin.

use crate::context::Cancelled;
use crate::math::Tree;
use crate::mesh::Surface;
use crate::remesh::RemeshError;
use glam::DVec3;
use rayon::prelude::*;
use std::time::Duration;

use super::bodies::{Fillers, Search};
use super::limits::Filler;
use super::outcome::ThinReason;
use super::results::{Grown, Thin, deviation_of_added, is_added_within};
use super::unions::{Cells, Filling, State};
use super::unite::Broken;
use super::{KEPT_MEASUREMENTS, LEAST_KEPT};

/// The most rounds.
const MAX_ROUNDS: usize = 12;
/// The rounds end when gaps limit more than this share of the new balls, and two rounds left [`STALLED`] of the thin faces and of
/// what they lack. Where gaps limit nothing, later rounds often mend what earlier ones made worse.
const LIMITED: f64 = 0.6;
/// See [`LIMITED`].
const STALLED: f64 = 0.9;
/// Sizes of cells, finest first. Measuring the result takes longest, so a body of many faces gets larger cells.
const CELLS: [Cells; 3] = [
    Cells { share: 0.2, margin: 0.08, max_faces: 50_000 },
    Cells { share: 0.32, margin: 0.12, max_faces: 150_000 },
    Cells { share: 0.45, margin: 0.17, max_faces: 250_000 },
];
/// The expected duration of all rounds for one ball of the first round, on two cores. It grows with the root of their number.
const EXPECTED: Duration = Duration::from_millis(250);
/// How much more a ball grows in later rounds: this times the square of the number of the round, at most the second value.
/// What stays thin then is just below the least wall, and the caps of small balls there are finer than the cells.
const MORE: [f64; 2] = [0.005, 0.2];
/// How much thicker than the least wall a wall beside a thin place may be to get balls, too: this times the number of the round
/// after the first rounds, at most the second value.
const TOLERANCE: [f64; 2] = [0.03, 0.15];
/// The first rounds, after which [`TOLERANCE`] grows. As a rule they suffice, and balls beside thin places need more material.
const PATIENCE: usize = 3;
/// The most that the surface of all balls may be away from the input, as a share of the least wall. It exceeds balls in creases between
/// them by up to half of a cell.
const MAX_DEVIATION: f64 = 1.35;
/// The rounding of a computed distance, as a share of it, at most.
const ROUNDING: f64 = 1e-9;
/// How far a ball exceeds a sharp edge, as a share of the least wall, so that its surface surely covers the edge: in the
/// first round, and how much more in each later one.
const TIP_COVER: [f64; 2] = [0.03, 0.06];

impl Filling<'_> {
    /// Runs the rounds. Ends early, with the best result, when the time runs out.
    ///
    /// # Errors
    /// [`Cancelled`] when the work was cancelled.
    pub fn run(&self, base: &Grown) -> Result<Grown, Cancelled> {
        let (mut best, mut current) = (base.clone(), base.clone());
        let limited = self.context.ending_before(self.kept);
        let first_round = Filling { context: &limited, ..*self };
        let Some((cells, first)) = self.context.unless_late(first_round.cells_for(base))? else {
            best.reason = Some(ThinReason::Time);
            return Ok(best);
        };
        let mut state = State {
            base,
            balls: Vec::new(),
            left_out: Vec::new(),
            cells,
            first,
            round: 0,
            kept: None,
            topology: self.topology,
            is_limited: false,
        };
        let of_base = deviation_of_added((self.limits.input, &self.limits.tree), &base.surface);
        let most = of_base.max(MAX_DEVIATION * self.settings.min_wall) * (1.0 + ROUNDING);
        let mut left = Vec::new();
        while state.round < MAX_ROUNDS && !current.thin.is_empty() {
            let limited = self.context.ending_before(state.kept.unwrap_or(self.kept));
            let round = Filling { context: &limited, ..*self };
            let Some(next) = self.context.unless_late(round.round(&current, &mut state))? else {
                best.reason = Some(ThinReason::Time);
                break;
            };
            state.round += 1;
            let is_late = self.context.remaining() < state.kept.unwrap_or_default();
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
            if current.is_better_than(&best, self.before)
                && is_added_within(most, (self.limits.input, &self.limits.tree), &current.surface)
            {
                best = current.clone();
            }
            left.push((current.thin.count() as f64, current.thin.lack));
            if state.is_limited && has_stalled(&left) {
                break;
            }
            if is_late && !current.thin.is_empty() {
                best.reason = Some(ThinReason::Time);
                break;
            }
        }
        best.surface = self.with_sources(best.surface, &base.surface);
        Ok(best)
    }

    /// The finest cells with which the body of the first round has few enough faces. The number of faces with the coarsest
    /// cells, which are quick to build, tells it. Also the balls of the first round, if they are known then.
    fn cells_for(&self, base: &Grown) -> Result<(Cells, Option<Vec<Filler>>), Cancelled> {
        let [finer @ .., coarsest] = CELLS;
        let Some(fillers) = self.fillers(base, coarsest, 0)? else { return Ok((coarsest, None)) };
        self.context.expect_remaining(EXPECTED.mul_f64((fillers.len() as f64).sqrt()));
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
        let tip_cover = TIP_COVER[0] + TIP_COVER[1] * round as f64;
        let tolerance = (TOLERANCE[0] * (round + 1).saturating_sub(PATIENCE) as f64).min(TOLERANCE[1]);
        let search = Search {
            tolerance,
            spacing: cells.share * self.settings.min_wall,
            margin,
            tip_cover,
            is_first: round == 0,
        };
        Fillers::new(&current.surface, self.limits, search).of(&current.thin, self.context)
    }

    /// One round. The surface stays the same if nothing can grow.
    fn round(&self, current: &Grown, state: &mut State<'_>) -> Result<Grown, Cancelled> {
        let mut next = Grown { reason: Some(ThinReason::Union), ..current.clone() };
        let fillers = match state.first.take() {
            Some(first) => Some(first),
            None => self.fillers(current, state.cells, state.round)?,
        };
        let Some(mut fillers) = fillers else { return Ok(next) };
        let cell = state.cells.share * self.settings.min_wall;
        fillers.par_iter_mut().for_each(|filler| self.limits.apply(filler, cell));
        let wanted = fillers.len();
        let mut limited: Vec<DVec3> =
            fillers.iter().filter(|filler| filler.is_limited).map(|filler| filler.centre).collect();
        let is_left_out = |filler: &Filler| {
            let near = 0.5 * self.settings.min_wall;
            state.left_out.iter().find(|(other, _)| other.centre.distance(filler.centre) < near).map(|&(_, why)| why)
        };
        next.reason = fillers.iter().find_map(is_left_out).map(reason);
        fillers.retain(|filler| filler.radius > 0.0 && is_left_out(filler).is_none());
        if !fillers.is_empty() {
            let union = self.largest_union(fillers, &current.surface, state)?;
            next.reason = union.broken.map(reason).or(next.reason);
            limited.extend(union.limited);
            if let Some(surface) = union.surface {
                state.balls = union.balls;
                next.through_holes_closed = self.topology.handles_lost(state.topology);
                next.narrow_gaps_filled = union.slits_filled;
                next.surface = surface;
                let remaining = self.context.remaining();
                next.thin = Thin::after(current, &next.surface, self.settings.min_wall, self.context)?;
                let taken = remaining.saturating_sub(self.context.remaining());
                state.kept = state.kept.max(Some((taken * KEPT_MEASUREMENTS).max(LEAST_KEPT)));
            }
        }
        state.is_limited = limited.len() as f64 > LIMITED * wanted as f64;
        next.limited.extend(limited);
        Ok(next)
    }

    /// Gives the faces of a body the source of the nearest face below.
    fn with_sources(&self, mut united: Surface, below: &Surface) -> Surface {
        if !united.source.contains(&self.mark()) {
            return united;
        }
        let tree = Tree::new(&below.positions, &below.faces);
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

/// Whether the last two rounds left nearly all thin faces, and nearly all of what they lack.
fn has_stalled(left: &[(f64, f64)]) -> bool {
    matches!(left, [.., before, _, last] if last.0 > STALLED * before.0 && last.1 > STALLED * before.1)
}

fn reason(broken: Broken) -> ThinReason {
    match broken {
        Broken::Union => ThinReason::Union,
        Broken::Parts | Broken::ThroughHole => ThinReason::Topology,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounds_that_leave_fewer_thin_faces_or_less_lack_go_on() {
        assert!(!has_stalled(&[(100.0, 1.0), (99.0, 1.0)]));
        assert!(has_stalled(&[(100.0, 1.0), (99.0, 1.0), (98.0, 0.99)]));
        assert!(!has_stalled(&[(100.0, 1.0), (99.0, 1.0), (80.0, 1.2)]));
        assert!(!has_stalled(&[(100.0, 1.0), (99.0, 1.0), (120.0, 0.8)]));
    }
}
