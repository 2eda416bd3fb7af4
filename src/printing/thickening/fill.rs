//! Rounds that unite a solid with balls along the middle of its thin places, until nothing is thin.

use crate::context::Cancelled;
use crate::math::{Dipoles, Tree};
use crate::mesh::{Parts, Surface};
use crate::remesh::RemeshError;
use glam::DVec3;
use rayon::prelude::*;

use super::bodies::{Filler, Fillers, Search};
use super::outcome::ThinReason;
use super::results::{Grown, Thin, deviation_of_added};
use super::unions::{Cells, Filling, State};
use super::unite::{Broken, FAR_AWAY, group_of_each_face};
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
/// How much more a ball grows in later rounds: this times the square of the number of the round, at most the second value.
/// What stays thin then is just below the least wall, and the caps of small balls there are finer than the cells.
const MORE: [f64; 2] = [0.005, 0.2];
/// How much thicker than the least wall a wall beside a thin place may be to get balls, too: this times the number of the round
/// after the first rounds, at most the second value.
const TOLERANCE: [f64; 2] = [0.03, 0.15];
/// The first rounds, after which [`TOLERANCE`] grows. As a rule they suffice, and balls beside thin places need more material.
const PATIENCE: usize = 3;
/// The most that balls may move the surface, as a share of the least wall. A ball in the middle of a wall without thickness
/// moves it by half of the least wall; where a gap limits the growth on one side, the other side moves by all of it. The
/// rest is what later rounds add beside earlier balls.
const MAX_BALL_DEVIATION: f64 = 1.125;
/// The same for the surface of all balls, which exceeds balls in creases between them by up to half of a cell.
const MAX_DEVIATION: f64 = 1.35;
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
        let [base_tree, input_tree] =
            [&base.surface, self.input].map(|surface| Tree::new(&surface.positions, &surface.faces));
        let mut state = State {
            base,
            balls: Vec::new(),
            left_out: Vec::new(),
            cells,
            base_tree,
            dipoles: input_tree.dipoles(|face| self.input.corners(face as usize)),
            input_tree,
            group_of_face: group_of_each_face(self.input, &self.settings),
            first,
            round: 0,
            kept: None,
            topology: self.topology,
            is_limited: false,
        };
        let of_base = deviation_of_added((self.input, &state.input_tree), &base.surface);
        let most = of_base.max(MAX_DEVIATION * self.settings.min_wall);
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
            let deviation = || deviation_of_added((self.input, &state.input_tree), &current.surface);
            if current.is_better_than(&best, self.before) && deviation() <= most {
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
        let tip_cover = TIP_COVER[0] + TIP_COVER[1] * round as f64;
        let tolerance = (TOLERANCE[0] * (round + 1).saturating_sub(PATIENCE) as f64).min(TOLERANCE[1]);
        let search = Search {
            tolerance,
            spacing: cells.share * self.settings.min_wall,
            margin,
            tip_cover,
            is_first: round == 0,
        };
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
                next.slits_filled = union.slits_filled;
                next.surface = self.with_sources(surface, (&state.base.surface, &state.base_tree));
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

    /// Limits the radius of a ball, so that it moves the input's surface by less than [`MAX_BALL_DEVIATION`] and leaves the least
    /// gap to other solids. Nothing is left of a ball that would have to be smaller than a cell, since its surface can be a
    /// cell away from it.
    fn limit(&self, filler: &mut Filler, state: &State<'_>) {
        let min_wall = self.settings.min_wall;
        let most = MAX_BALL_DEVIATION * min_wall;
        let least = filler.radius.min(state.cells.share * min_wall);
        let nearest = |reach: f64, is_meant: &dyn Fn(u32) -> bool| {
            let corners = |face: u32| if is_meant(face) { self.input.corners(face as usize) } else { [FAR_AWAY; 3] };
            state.input_tree.nearest(filler.centre, reach, &mut u64::MAX.clone(), corners)
        };
        let Some(own) = nearest(f64::INFINITY, &|_| true) else { return };
        let input = (self.input, &state.input_tree, &state.dipoles);
        let depth = depth(input, filler.centre, own.distance);
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

/// The depth inside the input of a point, which has a distance from its surface; negative outside. The nearest face alone does
/// not decide the side: beyond a sharp edge the point can be behind one of its faces.
fn depth((input, tree, dipoles): (&Surface, &Tree, &Dipoles), point: DVec3, distance: f64) -> f64 {
    let corners = |face: u32| input.corners(face as usize);
    let is_inside = tree.winding(dipoles, point, &mut u64::MAX.clone(), corners) > 0.5;
    if is_inside { distance } else { -distance }
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
    use crate::mesh::Soup;

    #[test]
    fn a_point_beyond_a_sharp_edge_is_outside() {
        // Both faces at the edge have planes that the points lie behind.
        let corners = [[0.0, 0.0, 0.0], [-10.0, 0.0, 1.0], [-10.0, 0.0, -1.0]];
        let [front, back] = [0.0, 5.0].map(|y| corners.map(|[x, _, z]| DVec3::new(x, y, z)));
        let faces = vec![[0, 1, 2], [3, 5, 4], [0, 3, 1], [1, 3, 4], [0, 2, 3], [2, 5, 3], [1, 4, 2], [2, 4, 5]];
        let wedge = Surface::from_soup(&Soup { positions: [front, back].concat(), faces }).0;
        let tree = Tree::new(&wedge.positions, &wedge.faces);
        let dipoles = tree.dipoles(|face| wedge.corners(face as usize));
        let depth = |x, z| depth((&wedge, &tree, &dipoles), DVec3::new(x, 2.5, z), 0.5);
        assert_eq!([depth(0.4, 0.3), depth(0.4, -0.3), depth(-8.0, 0.3)], [-0.5, -0.5, 0.5]);
    }

    #[test]
    fn rounds_that_leave_fewer_thin_faces_or_less_lack_go_on() {
        assert!(!has_stalled(&[(100.0, 1.0), (99.0, 1.0)]));
        assert!(has_stalled(&[(100.0, 1.0), (99.0, 1.0), (98.0, 0.99)]));
        assert!(!has_stalled(&[(100.0, 1.0), (99.0, 1.0), (80.0, 1.2)]));
        assert!(!has_stalled(&[(100.0, 1.0), (99.0, 1.0), (120.0, 0.8)]));
    }
}
