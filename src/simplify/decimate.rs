//! The options and the main loop of a simplification.

use std::ops::Range;

use glam::DVec3;
use rustc_hash::FxHashSet;

use super::collapse::{Attempt, Collapser, Refusal};
use super::dynamic_mesh::{DynamicMesh, NONE, prepare};
use super::queue::{Queue, choose, fill, push_around, version};
use crate::context::{Cancelled, Context};
use crate::math::{Precision, Rounding, to_unit_range, unit_scale};
use crate::mesh::{Surface, position_key, weld_exactly};

/// Edges processed between two checks for cancellation.
const CHECK_INTERVAL: u64 = 1024;
/// Maximum number of passes over all edges.
const MAX_PASSES: usize = 12;
/// Minimum share of the faces that a pass must remove for another pass to be worthwhile.
const MIN_PASS_SHARE: f64 = 1e-3;
/// Cost factor for an edge that is deferred because its collapse would create slender faces.
const DEFERRED_COST_FACTOR: f64 = 16.0;

/// Options of a simplification by edge collapse.
#[derive(Clone, Copy)]
pub struct Simplify {
    /// Stop at this many faces. None: as few as `max_error` allows.
    pub max_faces: Option<u64>,
    /// Maximum distance between the result and the original surface, in both directions, in the model's unit.
    ///
    /// Each collapse maps the faces before to the faces after it, with a known maximum displacement. The displacements
    /// of each face are added up. If the sum exceeds the limit, the distance is measured instead: from all original
    /// vertices that the faces replace (of more than 256 the farthest 128), and from the centroids and edge midpoints
    /// of the faces. The limit holds at those points. For **every** point 8 times the limit is guaranteed, up to about
    /// 1e-14 of the largest coordinate, because the sum is kept below that.
    pub max_error: f64,
    /// Whether `max_error` holds at every point instead of only the measured ones. Then each new face is tested
    /// completely if that is quick, and in the end both surfaces. If the distance is larger somewhere, the original
    /// surface is simplified again with the original faces kept there.
    pub everywhere: bool,
    /// Edges whose face normals differ by more than this angle, in degrees, are lines. Vertices on a line collapse only
    /// along the line, and are never moved; ends and branches of lines stay. Boundary edges are lines at any angle.
    pub feature_angle_deg: f64,
    /// Precision to which new positions are rounded, such as f32 for STL.
    pub precision: Precision,
}

/// The result of a simplification.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Simplified {
    /// Number of faces before.
    pub faces_before: u64,
    /// Number of faces after.
    pub faces_after: u64,
    /// Distance between the result and the original surface at the measured points, in the model's unit: see
    /// [`Simplify::max_error`]. It is 0 if nothing collapsed or all collapses were within planes.
    pub error: f64,
    /// Guaranteed upper bound of the distance at every point, in the model's unit.
    pub bound: f64,
    /// Why more faces remain than requested, in words; none if the target was reached.
    pub shortfall: Option<String>,
    /// Whether the deadline ended the work early.
    pub is_late: bool,
}

/// Vertices and positions that a simplification must respect.
#[derive(Debug, Default)]
pub(super) struct Constraints<'a> {
    /// Vertices that keep their position and all their edges, by index; vertices beyond the list are free.
    pub fixed: Vec<bool>,
    /// Keys of the positions of further such vertices: see [`position_key`].
    pub fixed_positions: Option<&'a FxHashSet<[u64; 3]>>,
    /// The slab that new positions must stay in, in the model's unit: an axis, and the half-open range of coordinates.
    pub slab: Option<(usize, Range<f64>)>,
}

impl Constraints<'_> {
    /// Whether vertex `v` keeps its position and all its edges.
    fn is_fixed(&self, v: u32, p: DVec3) -> bool {
        self.fixed.get(v as usize) == Some(&true)
            || self.fixed_positions.is_some_and(|positions| positions.contains(&position_key(p)))
    }

    /// Whether a position is in the slab.
    pub fn allows(&self, p: DVec3) -> bool {
        self.slab.as_ref().is_none_or(|(axis, range)| range.contains(&p[*axis]))
    }
}

impl Simplify {
    /// Simplifies a whole surface under constraints.
    pub(super) fn apply_constrained(
        &self,
        surface: &mut Surface,
        constraints: &Constraints<'_>,
        context: &Context<'_>,
    ) -> Result<Simplified, Cancelled> {
        let faces_before = surface.faces.len() as u64;
        let untouched = Simplified { faces_before, faces_after: faces_before, ..Simplified::default() };
        if self.max_faces.is_some_and(|most| faces_before <= most) || self.max_error.is_nan() {
            return Ok(untouched);
        }
        let mut welded = surface.clone();
        let merged = weld_exactly(&mut welded);
        let unit = to_unit_range(&welded.positions);
        let scale = unit_scale(&welded.positions);
        context.check()?;
        let cosine = self.feature_angle_deg.to_radians().cos();
        let (mut mesh, part_volumes) = prepare(&welded, unit, cosine, context)?;
        // The index in the surface of each welded vertex. Vertices that share a position stay, with all their faces.
        let mut index_of = vec![NONE; welded.positions.len()];
        for (v, w) in surface.faces.iter().flatten().zip(welded.faces.iter().flatten()) {
            let slot = &mut index_of[*w as usize];
            mesh.fixed[*w as usize] |=
                (*slot != NONE && slot != v) || constraints.is_fixed(*v, surface.positions[*v as usize]);
            *slot = *v;
        }
        drop(welded);
        let rounding = Rounding { scale, precision: self.precision };
        let mut collapser = Collapser::new(mesh, part_volumes, self.max_error * scale, self.everywhere);
        let ended = self.collapse_all(&mut collapser, rounding, constraints, context)?;
        let mesh = &collapser.mesh;
        let (shortfall, is_late) = (self.shortfall(mesh.alive, &ended), ended.is_late);
        if mesh.alive == surface.faces.len() {
            return Ok(Simplified { shortfall, is_late, ..untouched });
        }
        for (w, &v) in index_of.iter().enumerate().filter(|(w, v)| **v != NONE && mesh.version[*w] > 0) {
            let position = &mut surface.positions[v as usize];
            // An unmoved vertex keeps its exact coordinates.
            if *position * scale != mesh.at[w] {
                *position = mesh.at[w] / scale;
            }
        }
        debug_assert!(merged > 0 || index_of.iter().all(|&v| v != NONE));
        for (face, now) in surface.faces.iter_mut().zip(&mesh.faces).filter(|(_, now)| now[0] != NONE) {
            for (v, w) in face.iter_mut().zip(now) {
                if !mesh.fixed[*w as usize] {
                    *v = index_of[*w as usize];
                }
            }
        }
        let error = (0..mesh.faces.len()).filter(|&f| mesh.is_alive(f)).map(|f| mesh.error[f]).fold(0.0, f32::max);
        let keep: Vec<bool> = (0..mesh.faces.len()).map(|f| mesh.is_alive(f)).collect();
        surface.retain_faces(&keep);
        surface.drop_unreferenced();
        Ok(Simplified {
            faces_before,
            faces_after: surface.faces.len() as u64,
            error: f64::from(error) / scale,
            bound: collapser.bound / scale,
            shortfall,
            is_late,
        })
    }

    /// Collapses edges until there are few enough faces or no edge may collapse.
    fn collapse_all(
        &self,
        collapser: &mut Collapser,
        rounding: Rounding,
        constraints: &Constraints<'_>,
        context: &Context<'_>,
    ) -> Result<Ended, Cancelled> {
        let enough = |mesh: &DynamicMesh| self.max_faces.is_some_and(|most| mesh.alive as u64 <= most);
        let (mut queue, mut steps, mut around) = (Queue::default(), 0u64, Vec::new());
        let mut ended = Ended::default();
        for _ in 0..MAX_PASSES {
            let before_pass = collapser.mesh.alive;
            ended = Ended::default();
            fill(&mut queue, &collapser.mesh, rounding);
            while let Some(candidate) = queue.pop() {
                if enough(&collapser.mesh) {
                    return Ok(ended);
                }
                steps += 1;
                if steps.is_multiple_of(CHECK_INTERVAL) && context.unless_late(context.check())?.is_none() {
                    ended.is_late = true;
                    return Ok(ended);
                }
                let [a, b] = candidate.ends;
                if version(&collapser.mesh, a, b) != candidate.version {
                    continue;
                }
                if collapser.clearance.nearby_left == 0 {
                    ended.is_exhausted = true;
                    return Ok(ended);
                }
                let Some(choice) = choose(&collapser.mesh, [a, b], candidate.along_line, |p| rounding.of(p)) else {
                    continue;
                };
                if !constraints.allows(choice.at / rounding.scale) {
                    ended.refused[Refusal::Clearance as usize] += 1;
                    continue;
                }
                match collapser.attempt(choice, candidate.deferred) {
                    Attempt::Done => {
                        push_around(&mut queue, &mut collapser.mesh, choice.kept, &mut around, rounding);
                    }
                    Attempt::Later => queue.push(candidate.deferred(DEFERRED_COST_FACTOR)),
                    Attempt::Refused(refusal) => ended.refused[refusal as usize] += 1,
                }
            }
            let gone = before_pass - collapser.mesh.alive;
            if (gone as f64) <= MIN_PASS_SHARE * before_pass as f64 && (gone == 0 || before_pass > 10_000) {
                break;
            }
        }
        Ok(ended)
    }

    /// Explains why more faces remain than requested; none if the target was reached.
    fn shortfall(&self, alive: usize, ended: &Ended) -> Option<String> {
        let most = self.max_faces.filter(|&most| alive as u64 > most)?;
        let mut line = format!("{alive} faces remain; {most} were requested");
        if ended.is_late {
            line.push_str(": the deadline came");
            return Some(line);
        }
        if ended.is_exhausted {
            line.push_str(": too many faces are close together to check for intersections");
            return Some(line);
        }
        let mut reasons: Vec<(u64, &str)> = Refusal::ALL
            .iter()
            .map(|&(refusal, words)| (ended.refused[refusal as usize], words))
            .filter(|r| r.0 > 0)
            .collect();
        reasons.sort_by_key(|reason| std::cmp::Reverse(reason.0));
        for (i, (count, words)) in reasons.iter().enumerate() {
            line.push_str(if i == 0 { "; " } else { ", " });
            line.push_str(&format!("{count} {words}"));
        }
        Some(line)
    }
}

/// How the last pass ended.
#[derive(Default)]
struct Ended {
    /// Number of refused edges, by reason.
    refused: [u64; 4],
    /// Whether the budget of the intersection search was spent.
    is_exhausted: bool,
    /// Whether the deadline passed.
    is_late: bool,
}
