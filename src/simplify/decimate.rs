use std::ops::Range;

use glam::DVec3;

use super::collapse::{Attempt, Collapser, Why};
use super::complex::{Complex, NONE, prepare};
use super::deviation::Reference;
use super::queue::{Queue, choose, fill, push_around, version};
use crate::context::{Cancelled, Context};
use crate::math::{Precision, Rounding, to_unit_range, unit_scale};
use crate::mesh::{Surface, weld_exactly};

/// Edges between two looks at whether the work should stop.
const BETWEEN_CHECKS: u64 = 1024;
/// Times that all edges are tried again, while that brings anything.
const MOST_PASSES: usize = 12;
/// Share of the faces that a pass must remove for another one to be worth its time.
const WORTH_A_PASS: f64 = 1e-3;
/// By how much what makes slender faces is put back in the queue.
const PATIENCE: f64 = 16.0;

/// Removes faces by collapsing edges.
#[derive(Clone, Copy)]
pub struct Simplify<'a> {
    /// Stop at this many faces. None: as few as `max_error` allows.
    pub max_faces: Option<u64>,
    /// The farthest that the result may be from the surface it is made of, and that from the result, in the model's unit.
    ///
    /// Each collapse is a map between the faces before and after it, and how far that moves any point is known. What a face has
    /// gathered so is added up. Where that sum says too much, it is measured instead: from all vertices of the start that the
    /// faces stand for (of more than 256 the 128 farthest), and from the middles of the faces and of their edges. So at vertices and
    /// middles this is what was asked for; that **no** point is farther than 8 times it is certain, to some 1e-14 of the largest
    /// coordinate, since the whole sum is held below that.
    pub max_error: f64,
    /// Edges whose faces differ by more than this angle, in degrees, are lines: their vertices go only along the line, and no
    /// vertex of a line moves. Ends and branches of lines stay. So it is with boundaries, whatever the angle.
    pub feature_angle_deg: f64,
    /// Whether every new position is one that f32 holds.
    pub precision: Precision,
    /// Another surface to stay near, such as the input before it was remeshed: the middles of new faces and of their edges
    /// are within `max_error` of it, or as near as the faces were that they stand for. The bound of `max_error` holds as well.
    pub toward: Option<Reference<'a>>,
}

/// What was done.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Simplified {
    /// Faces before.
    pub faces_before: u64,
    /// Faces after.
    pub faces_after: u64,
    /// How far the result is from the start and that from it, as for `max_error`, in the model's unit; 0 where nothing was
    /// collapsed or all of it in one plane.
    pub error: f64,
    /// What no point is farther than, for certain.
    pub bound: f64,
    /// Why there are more faces than were asked for, in words.
    pub left: Option<String>,
    /// Whether the deadline ended it.
    pub is_late: bool,
}

/// What of a surface must stay as it is, and where the rest must stay.
#[derive(Debug, Default)]
pub(super) struct Held {
    /// Vertices that stay where they are with all their edges, by number; those beyond the list are free.
    pub fixed: Vec<bool>,
    /// The slab that no new position may leave, in the model's unit: an axis, and the coordinates from and below which it lies.
    pub slab: Option<(usize, Range<f64>)>,
}

impl Held {
    /// Whether a position is in the slab.
    pub fn allows(&self, p: DVec3) -> bool {
        self.slab.as_ref().is_none_or(|(axis, range)| range.contains(&p[*axis]))
    }
}

impl Simplify<'_> {
    /// Simplifies a surface as a whole, in which some of it must stay.
    pub(super) fn apply_held(
        &self,
        surface: &mut Surface,
        held: &Held,
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
        let (mut it, bodies) = prepare(&welded, unit, cosine, context)?;
        // Where each welded vertex stands among the surface's own. Several at one position stay, with all their faces.
        let mut own = vec![NONE; welded.positions.len()];
        for (v, w) in surface.faces.iter().flatten().zip(welded.faces.iter().flatten()) {
            let slot = &mut own[*w as usize];
            it.fixed[*w as usize] |= (*slot != NONE && slot != v) || held.fixed.get(*v as usize) == Some(&true);
            *slot = *v;
        }
        drop(welded);
        let rounding = Rounding { scale, precision: self.precision };
        let mut collapser = Collapser::new(it, bodies, self.max_error * scale, 1.0 / scale, self.toward);
        let ended = self.collapse_all(&mut collapser, rounding, held, context)?;
        let it = &collapser.it;
        if it.alive == surface.faces.len() {
            return Ok(Simplified { left: self.left(it.alive, &ended), is_late: ended.is_late, ..untouched });
        }
        for (w, &v) in own.iter().enumerate().filter(|(w, v)| **v != NONE && it.version[*w] > 0) {
            let position = &mut surface.positions[v as usize];
            // As it was where it is the same.
            if *position * scale != it.at[w] {
                *position = it.at[w] / scale;
            }
        }
        debug_assert!(merged > 0 || own.iter().all(|&v| v != NONE));
        for (face, now) in surface.faces.iter_mut().zip(&it.faces).filter(|(_, now)| now[0] != NONE) {
            for (v, w) in face.iter_mut().zip(now) {
                if !it.fixed[*w as usize] {
                    *v = own[*w as usize];
                }
            }
        }
        let error = (0..it.faces.len()).filter(|&f| it.is_alive(f)).map(|f| it.error[f]).fold(0.0, f32::max);
        let keep: Vec<bool> = (0..it.faces.len()).map(|f| it.is_alive(f)).collect();
        surface.retain_faces(&keep);
        surface.drop_unreferenced();
        Ok(Simplified {
            faces_before,
            faces_after: surface.faces.len() as u64,
            error: f64::from(error) / scale,
            bound: collapser.bound / scale,
            left: self.left(it.alive, &ended),
            is_late: ended.is_late,
        })
    }

    /// Collapses edges until there are few enough faces or nothing goes any more.
    fn collapse_all(
        &self,
        collapser: &mut Collapser<'_>,
        rounding: Rounding,
        held: &Held,
        context: &Context<'_>,
    ) -> Result<Ended, Cancelled> {
        let enough = |it: &Complex| self.max_faces.is_some_and(|most| it.alive as u64 <= most);
        let (mut queue, mut steps, mut around) = (Queue::default(), 0u64, Vec::new());
        let mut ended = Ended::default();
        for _ in 0..MOST_PASSES {
            let before_pass = collapser.it.alive;
            ended = Ended::default();
            fill(&mut queue, &collapser.it, rounding);
            while let Some(waiting) = queue.pop() {
                if enough(&collapser.it) {
                    return Ok(ended);
                }
                steps += 1;
                if steps.is_multiple_of(BETWEEN_CHECKS) && context.unless_late(context.check())?.is_none() {
                    ended.is_late = true;
                    return Ok(ended);
                }
                let [a, b] = waiting.ends;
                if version(&collapser.it, a, b) != waiting.version {
                    continue;
                }
                if collapser.clearance.near_left == 0 {
                    ended.spent = true;
                    return Ok(ended);
                }
                let Some(choice) = choose(&collapser.it, [a, b], waiting.along_line, |p| rounding.of(p)) else {
                    continue;
                };
                if !held.allows(choice.at * collapser.unscale) {
                    ended.refused[Why::Clearance as usize] += 1;
                    continue;
                }
                match collapser.attempt(choice, waiting.patient) {
                    Attempt::Done => push_around(&mut queue, &mut collapser.it, choice.kept, &mut around, rounding),
                    Attempt::Later => queue.push(waiting.patient(PATIENCE)),
                    Attempt::Refused(why) => ended.refused[why as usize] += 1,
                }
            }
            let gone = before_pass - collapser.it.alive;
            if (gone as f64) <= WORTH_A_PASS * before_pass as f64 && (gone == 0 || before_pass > 10_000) {
                break;
            }
        }
        Ok(ended)
    }

    /// What to say where more faces were asked to go.
    fn left(&self, alive: usize, ended: &Ended) -> Option<String> {
        let most = self.max_faces.filter(|&most| alive as u64 > most)?;
        let mut line = format!("{alive} faces are left of {most} that were asked for");
        if ended.is_late {
            line.push_str(": the time was over");
            return Some(line);
        }
        if ended.spent {
            line.push_str(": so many faces are near one another that the search was given up");
            return Some(line);
        }
        let mut reasons: Vec<(u64, &str)> =
            Why::ALL.iter().map(|&(why, words)| (ended.refused[why as usize], words)).filter(|r| r.0 > 0).collect();
        reasons.sort_by_key(|reason| std::cmp::Reverse(reason.0));
        for (i, (count, words)) in reasons.iter().enumerate() {
            line.push_str(if i == 0 { "; " } else { ", " });
            line.push_str(&format!("{count} edges stay {words}"));
        }
        Some(line)
    }
}

/// How the last pass ended.
#[derive(Default)]
struct Ended {
    /// Edges that were refused, by reason.
    refused: [u64; 4],
    /// Whether the search for intersections was given up.
    spent: bool,
    /// Whether the deadline came.
    is_late: bool,
}
