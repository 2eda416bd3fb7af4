//! Moves vertices to positions that f32 can hold, without making faces meet.
//!
//! `self_union` and `perturb` use the two functions here after they create vertices; [`RoundCoordinates`] is the operator.

use glam::{DVec3, Vec3Swizzles};
use rustc_hash::{FxHashMap, FxHashSet};
use smallvec::SmallVec;

use super::degenerate::remove_collapsed;
use super::free_positions::{
    DISTINCT_STEP, MoveClearance, NEIGHBOUR_DIRECTIONS, NEW, round_to_f32, spacing, with_vertex,
};
use super::operator::{Applied, Counter, Operation, Scope};
use super::round_at_once::round_at_once;
use crate::inspect::Decimals;
use crate::math::Precision;
use crate::mesh::{Surface, position_key};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// The number of passes over the remaining vertices: moving one vertex may make room for another.
const ROUNDS: usize = 4;
/// How far a vertex may move to merge with another, in units in the last place.
const MERGE_ULPS: f64 = 64.0;
/// The least step near zero, in units in the last place of the model's largest coordinate.
const FINEST_STEP_ULPS: f64 = 1.0 / (1 << 20) as f64;

/// How far a vertex moves so that readers with eight decimals distinguish it, in steps of those decimals, in order of trial.
const DISTINCT_STEPS: [f64; 3] = [1.5, 3.0, 6.0];

/// The outcome of rounding.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Rounded {
    /// Vertices that were rounded although faces then meet, since no other position was clear.
    pub forced: u64,
    /// Vertices that were merged into neighbours.
    pub merged: u64,
}

/// Moves the vertices for which `is_free` holds to positions that f32 can hold, without new contacts between faces.
///
/// A vertex moves to the nearest such position, to one next to it, or into a neighbour that has such a position. Exact
/// predicates test each move.
///
/// ```text
///     o . o . o            o   o   o
///     .  /|\  .     ->        /|\            o: positions of f32
///     o /.|.\ o            o / o \ o
/// ```
///
/// Precondition: faces meet only in shared vertices and edges. Result: the same, except around the vertices counted as
/// `forced`. A vertex moves by one or two units in the last place, or merges within 64 of them. Where sheets are that
/// close, merging may create non-manifold edges and vertices.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub(super) fn round_without_contact(
    surface: &mut Surface,
    is_free: impl Fn(DVec3) -> bool,
    context: &Context<'_>,
) -> Result<Rounded, Cancelled> {
    let lattice = Lattice::of(surface);
    let needs_rounding = |p: DVec3| is_free(p) && lattice.nearest(p) != p;
    let vertices: Vec<u32> =
        (0u32..).zip(&surface.positions).filter(|&(_, &p)| needs_rounding(p)).map(|(v, _)| v).collect();
    let mut done = Rounded::default();
    if vertices.is_empty() {
        return Ok(done);
    }
    let mut left = round_at_once(surface, vertices, |p| lattice.nearest(p), context)?;
    if left.is_empty() {
        return Ok(done);
    }
    let mut rounding = Rounding::new(surface, lattice);
    for _ in 0..ROUNDS {
        let before = left.len();
        let mut again = Vec::new();
        for (at, v) in left.into_iter().enumerate() {
            if at % 64 == 0 {
                context.check()?;
            }
            if rounding.move_to_f32(v) {
                continue;
            }
            if rounding.merge(v) {
                done.merged += 1;
            } else {
                again.push(v);
            }
        }
        left = again;
        if left.is_empty() || left.len() == before {
            break;
        }
    }
    done.forced = left.len() as u64;
    for v in left {
        let p = &mut surface.positions[v as usize];
        *p = lattice.nearest(*p);
    }
    drop_merged(surface);
    Ok(done)
}

/// Limits for [`distinguish_vertices`].
#[derive(Debug, Clone, Copy)]
pub(super) struct DistinguishLimits {
    /// No vertex moves farther than this, in the model's unit.
    pub max_deviation: f64,
    /// Whether vertices without a common edge may move apart; otherwise they stay close together.
    pub moves: bool,
}

/// Separates vertices that readers would confuse, since many readers round positions to eight decimals.
///
/// Vertices with a common edge merge; others move until their rounded positions differ. Vertices for which `is_free` holds
/// move first. As in [`round_without_contact`] no faces come to meet. Returns the number of merged vertices.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub(super) fn distinguish_vertices(
    surface: &mut Surface,
    limits: DistinguishLimits,
    is_free: impl Fn(DVec3) -> bool,
    context: &Context<'_>,
) -> Result<u64, Cancelled> {
    let Some(decimals) = Decimals::of(surface).filter(|decimals| !decimals.tell_apart(&surface.positions)) else {
        return Ok(0);
    };
    let mut groups: FxHashMap<[u64; 3], SmallVec<[u32; 2]>> = FxHashMap::default();
    for (v, &p) in (0u32..).zip(&surface.positions) {
        groups.entry(position_key(decimals.round(p))).or_default().push(v);
    }
    let at = |surface: &Surface, v: u32| surface.positions[v as usize];
    let is_crowded = |group: &&SmallVec<[u32; 2]>| group.iter().any(|&v| at(surface, v) != at(surface, group[0]));
    let mut crowded: Vec<SmallVec<[u32; 2]>> = groups.values().filter(is_crowded).cloned().collect();
    if crowded.is_empty() {
        return Ok(0);
    }
    crowded.sort_unstable();
    let mut taken: FxHashSet<[u64; 3]> = groups.into_keys().collect();
    let lattice = Lattice::of(surface);
    let mut rounding = Rounding::new(surface, lattice);
    // Nearest first; equal distances by z, then y, then x.
    let mut directions = NEIGHBOUR_DIRECTIONS.map(|direction| direction.zyx());
    directions.sort_by(|a, b| a.length_squared().total_cmp(&b.length_squared()));
    let offsets: Vec<DVec3> = DISTINCT_STEPS
        .into_iter()
        .flat_map(|count| directions.map(|direction| direction * decimals.steps(count)))
        .collect();
    let mut merged = 0;
    for mut group in crowded {
        context.check()?;
        group.sort_by_key(|&v| (!is_free(at(rounding.surface, v)), v));
        for v in group.clone() {
            let p = at(rounding.surface, v);
            let others: SmallVec<[u32; 8]> = group.iter().copied().filter(|&u| at(rounding.surface, u) != p).collect();
            let near = others.iter().copied().filter(|&u| at(rounding.surface, u).distance(p) <= limits.max_deviation);
            let is_merged = rounding.merge_into(v, &near.collect::<SmallVec<[u32; 8]>>());
            merged += u64::from(is_merged);
            let candidates = offsets.iter().map(|&offset| lattice.nearest(p + offset));
            let may_take =
                |q: &DVec3| q.distance(p) <= limits.max_deviation && !taken.contains(&position_key(decimals.round(*q)));
            let moves = limits.moves && !others.is_empty();
            if is_merged || (moves && rounding.move_to_first_clear(v, candidates.filter(may_take))) {
                taken.insert(position_key(decimals.round(at(rounding.surface, v))));
                group.retain(|u| *u != v);
            }
        }
    }
    drop_merged(surface);
    Ok(merged)
}

/// Removes the faces that merging collapsed, and the vertices that no face uses.
fn drop_merged(surface: &mut Surface) {
    remove_collapsed(surface);
    surface.drop_unreferenced();
}

/// A surface whose vertices are moved and merged, with the clearance test and the faces at each vertex.
struct Rounding<'a> {
    surface: &'a mut Surface,
    clear: MoveClearance,
    lattice: Lattice,
    /// The faces at each vertex.
    stars: Vec<SmallVec<[u32; 8]>>,
    /// The number of faces that were not merged away; at least one must stay.
    left: usize,
}

impl<'a> Rounding<'a> {
    fn new(surface: &'a mut Surface, lattice: Lattice) -> Self {
        let mut stars = vec![SmallVec::<[u32; 8]>::new(); surface.positions.len()];
        for (face, f) in surface.faces.iter().zip(0u32..) {
            face.iter().for_each(|&v| stars[v as usize].push(f));
        }
        Self { clear: MoveClearance::new(surface), lattice, stars, left: surface.faces.len(), surface }
    }

    /// Moves a vertex to a nearby f32 position.
    fn move_to_f32(&mut self, v: u32) -> bool {
        let around = self.lattice.around(self.surface.positions[v as usize]);
        self.move_to_first_clear(v, around)
    }

    /// Moves a vertex to the first candidate position at which no faces meet.
    fn move_to_first_clear(&mut self, v: u32, candidates: impl IntoIterator<Item = DVec3>) -> bool {
        let new = with_vertex(self.surface, &self.stars[v as usize], v, NEW);
        let clear = candidates.into_iter().find(|&q| self.clear.is_clear(self.surface, &new, &[], q));
        if let Some(q) = clear {
            self.clear.record_move(v, q);
            self.surface.positions[v as usize] = q;
        }
        clear.is_some()
    }

    /// Merges a vertex into a neighbour that has an f32 position.
    fn merge(&mut self, v: u32) -> bool {
        let p = self.surface.positions[v as usize];
        let most = MERGE_ULPS * spacing(p);
        let at = |w: u32| self.surface.positions[w as usize];
        let mut ends: Vec<u32> = self.stars[v as usize]
            .iter()
            .flat_map(|&f| self.surface.faces[f as usize])
            .filter(|&w| w != v && at(w).distance(p) <= most && Precision::F32.round(at(w)) == at(w))
            .collect();
        ends.sort_unstable();
        ends.dedup();
        ends.sort_by(|&a, &b| at(a).distance_squared(p).total_cmp(&at(b).distance_squared(p)).then(a.cmp(&b)));
        self.merge_into(v, &ends)
    }

    /// Merges a vertex into the first of `ends` that is its neighbour and where no faces come to meet.
    fn merge_into(&mut self, v: u32, ends: &[u32]) -> bool {
        for &u in ends {
            let (removed, kept): (Vec<u32>, Vec<u32>) =
                self.stars[v as usize].iter().partition(|&&f| self.surface.faces[f as usize].contains(&u));
            if removed.is_empty() || removed.len() == self.left {
                continue;
            }
            let new = with_vertex(self.surface, &kept, v, u);
            let to = self.surface.positions[u as usize];
            if !self.clear.is_clear(self.surface, &new, &removed, to) {
                continue;
            }
            self.clear.record_move(v, to);
            for &(face, f) in &new {
                self.surface.faces[f as usize] = face;
                self.stars[u as usize].push(f);
            }
            self.left -= removed.len();
            for f in removed {
                let face = self.surface.faces[f as usize];
                face.iter().filter(|&&w| w != v).for_each(|&w| self.stars[w as usize].retain(|g| *g != f));
                self.surface.faces[f as usize] = [u; 3];
            }
            self.stars[v as usize].clear();
            return true;
        }
        false
    }
}

/// The positions that f32 can hold, with a least step near zero. There f32 is so fine that face normals could not be computed.
#[derive(Debug, Clone, Copy)]
struct Lattice {
    /// The least step, a power of two.
    least: f64,
}

impl Lattice {
    fn of(surface: &Surface) -> Self {
        let largest = surface.positions.iter().fold(DVec3::ZERO, |most, p| most.max(p.abs()));
        Self { least: (spacing(largest) * FINEST_STEP_ULPS).max(DISTINCT_STEP.min(spacing(largest))) }
    }

    /// The nearest representable number, the next above and the next below.
    fn near(self, x: f64) -> [f64; 3] {
        #[expect(
            clippy::cast_possible_truncation,
            reason = "rounding is the purpose, and values beyond f32 are handled below"
        )]
        let single = x as f32;
        if !single.is_finite() {
            return [x; 3];
        }
        let step = f64::from(single.abs().next_up()) - f64::from(single.abs());
        if step >= self.least {
            return [single, single.next_up(), single.next_down()].map(f64::from);
        }
        let nearest = (x / self.least).round() * self.least;
        [nearest, nearest + self.least, nearest - self.least]
    }

    /// The nearest representable position.
    fn nearest(self, p: DVec3) -> DVec3 {
        DVec3::from_array(p.to_array().map(|x| self.near(x)[0]))
    }

    /// The representable positions around `p`, nearest first.
    fn around(self, p: DVec3) -> SmallVec<[DVec3; 27]> {
        let [x, y, z] = p.to_array().map(|x| self.near(x));
        let mut all: SmallVec<[DVec3; 27]> = SmallVec::new();
        for i in x {
            for j in y {
                all.extend(z.into_iter().map(|k| DVec3::new(i, j, k)).filter(|q| q.is_finite()));
            }
        }
        all.sort_by(|a, b| a.distance_squared(p).total_cmp(&b.distance_squared(p)));
        all
    }
}

/// Rounds coordinates to values that the output format can hold, and merges vertices that readers would confuse.
#[derive(Debug, Clone, Copy)]
pub struct RoundCoordinates {
    precision: Precision,
    max_deviation: f64,
}

impl Operation<'_> for RoundCoordinates {
    const FIXES: &'static [Counter] = &[];
    const MAY_RAISE: &'static [Counter] = &Counter::ALL;

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self { precision: scope.format.precision(), max_deviation: scope.max_deviation }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let rounded = if self.precision == Precision::F32 { round_to_f32(surface) } else { 0 };
        let limits = DistinguishLimits { max_deviation: self.max_deviation, moves: false };
        let joined = distinguish_vertices(surface, limits, |_| true, context)?;
        Ok(Change::list([
            (ChangeKind::VerticesRoundedToF32, rounded),
            (ChangeKind::NearCoincidentVerticesMerged, joined),
        ])
        .into())
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;
    use std::time::Duration;

    use super::*;
    use crate::context::NoProgress;
    use crate::inspect::joined_by_decimals;
    use crate::mesh::Edges;

    #[test]
    fn candidates_are_f32_numbers_with_a_least_step_near_zero() {
        let lattice = Lattice { least: 2f64.powi(-40) };
        let third = 1.0f32 / 3.0;
        assert_eq!(lattice.near(1.0 / 3.0), [third, third.next_up(), third.next_down()].map(f64::from));
        assert_eq!(lattice.near(1e-17), [0.0, 2f64.powi(-40), -2f64.powi(-40)]);
        assert_eq!(lattice.near(-1e-40), [0.0, 2f64.powi(-40), -2f64.powi(-40)]);
        assert_eq!(lattice.near(1e39), [1e39; 3]);
        let huge = Lattice { least: spacing(DVec3::new(0.0, 1e50, -f64::from(f32::MAX))) * FINEST_STEP_ULPS };
        assert_eq!(huge.near(1.0), [0.0, huge.least, -huge.least]);
        assert_eq!(huge.near(f64::from(f32::MAX))[0], f64::from(f32::MAX));
        for x in lattice.near(1e-7) {
            assert_eq!((x as f32).to_bits(), (x as f32 + 0.0).to_bits());
            assert_eq!(f64::from(x as f32), x, "f32 can hold the value");
            assert!((x - 1e-7).abs() < 2f64.powi(-39));
        }
    }

    fn distinguished(mut surface: Surface, limits: DistinguishLimits) -> (Surface, u64) {
        let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::MAX);
        let merged = distinguish_vertices(&mut surface, limits, |_| true, &context).unwrap();
        (surface, merged)
    }

    /// Two tetrahedra that nearly touch: their closest corners are `gap` apart along each axis.
    fn tetrahedra(gap: f64) -> Surface {
        let corners = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|p| p * 0.015625);
        let positions = corners.into_iter().chain(corners.map(|p| -p - DVec3::splat(gap))).collect();
        let faces = vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3], [4, 5, 6], [4, 7, 5], [4, 6, 7], [5, 7, 6]];
        Surface { positions, faces, source: (0..8).collect() }
    }

    #[test]
    fn near_coincident_corners_of_two_parts_move_apart_only_if_allowed() {
        let surface = tetrahedra(2f64.powi(-30));
        assert!(joined_by_decimals(&surface).is_some());
        let (moved, merged) =
            distinguished(surface.clone(), DistinguishLimits { max_deviation: f64::INFINITY, moves: true });
        assert_eq!((merged, moved.faces.len(), joined_by_decimals(&moved)), (0, 8, None));
        let corners = |surface: &Surface| (0..8).flat_map(|f| surface.corners(f)).collect::<Vec<DVec3>>();
        let far = corners(&surface).into_iter().zip(corners(&moved)).map(|(p, q)| p.distance(q));
        let farthest = far.fold(0.0, f64::max);
        assert!(farthest > 0.0 && farthest < 1e-7, "{farthest}");
        for limits in [
            DistinguishLimits { max_deviation: f64::INFINITY, moves: false },
            DistinguishLimits { max_deviation: 1e-12, moves: true },
        ] {
            let (same, merged) = distinguished(surface.clone(), limits);
            assert_eq!((corners(&same), merged), (corners(&surface), 0));
        }
    }

    #[test]
    fn an_edge_too_short_for_eight_decimals_collapses() {
        let mut surface = tetrahedra(0.01);
        // Splits the edge from 0 to 1 near its start.
        surface.positions.push(DVec3::X * 2f64.powi(-30));
        surface.faces[0] = [0, 2, 8];
        surface.faces[1] = [0, 8, 3];
        surface.faces.extend([[8, 2, 1], [8, 1, 3]]);
        surface.source.extend([0, 1]);
        let (whole, merged) = distinguished(surface, DistinguishLimits { max_deviation: 1e-7, moves: false });
        assert_eq!((merged, whole.faces.len(), joined_by_decimals(&whole)), (1, 8, None));
        assert!(Edges::new(&whole.faces).iter().all(|half_edges| half_edges.len() == 2));
    }
}
