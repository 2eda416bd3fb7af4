//! The kind of a thin place: walks along the middle of the wall or wire and sees how it ends.

use glam::DVec3;

use super::prepared::Prepared;

/// Directions in which a wall is followed; even, so that each has an opposite one.
const DIRECTIONS: usize = 16;
/// Steps of one walk.
const MAX_WALK: usize = 96;
/// Share of the local thickness below which a step or the free way ahead counts as the end.
const SHORTEST: f64 = 0.1;
/// A wall that turns by more than this supports itself: cosine of 60 degrees.
const TURNED: f64 = 0.5;
/// Budget of one ray.
const RAY: u64 = 1 << 14;

/// How a walk ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum End {
    /// At a place that is not thin, or around a bend.
    Held,
    /// At a rim.
    Free,
    /// Back at the start.
    Loop,
    /// After too many steps.
    Far,
}

/// The form of a thin place, before it is named for material or air.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Form {
    /// Thin in one direction; whether two opposite sides are held.
    Sheet { is_supported: bool },
    /// Thin in two directions; the number of held ends.
    Rod { held: u8 },
}

/// A position in the middle of a thin place.
#[derive(Debug, Clone, Copy)]
struct Middle {
    centre: DVec3,
    /// Unit vector across the thin place.
    across: DVec3,
    width: f64,
}

/// A thin place in which walks run.
pub(super) struct Walker<'a> {
    pub prepared: &'a Prepared<'a>,
    /// Width from which a place is not thin.
    pub limit: f64,
}

impl Walker<'_> {
    /// The form at the middle of a chord; None if the chord's middle is not in the material.
    pub fn form(&self, [from, to]: [DVec3; 2]) -> Option<Form> {
        let width = from.distance(to);
        let across = (to - from) / width;
        let middle = Middle { centre: (from + to) / 2.0, across, width };
        if !across.is_finite() || self.span(middle.centre, across)?.1 > self.limit * 1.01 {
            return None;
        }
        let (x, y) = across.any_orthonormal_pair();
        let way = |k: usize| {
            let (sin, cos) = (std::f64::consts::TAU * k as f64 / DIRECTIONS as f64).sin_cos();
            x * cos + y * sin
        };
        let half = DIRECTIONS / 2;
        let spans = (0..half).map(|k| (k, self.span(middle.centre, way(k)).map_or(f64::INFINITY, |span| span.1)));
        let (narrowest, span) = spans.min_by(|a, b| a.1.total_cmp(&b.1))?;
        if span < self.limit {
            return Some(Form::Rod { held: self.held_ends(middle, way(narrowest)) });
        }
        let ends: Vec<End> = (0..DIRECTIONS).map(|k| self.walk_sheet(middle, way(k))).collect();
        let is_held = |k: usize| ends[k] == End::Held || ends[k] == End::Loop;
        Some(Form::Sheet { is_supported: (0..half).any(|k| is_held(k) && is_held(k + half)) })
    }

    /// The middle between the surfaces on both sides of a point along a direction, and their distance; the distance is
    /// infinite if a side is farther than the limit. None if the point is not in the material.
    fn span(&self, point: DVec3, direction: DVec3) -> Option<(DVec3, f64)> {
        let longest = self.limit * 1.1;
        let side = |way: DVec3| match self.prepared.first_hit([point, way], longest, None, &mut RAY.clone()) {
            Some((_, face)) if self.prepared.normal(face).dot(way) < 0.0 => None,
            Some((distance, _)) => Some(distance),
            None => Some(f64::INFINITY),
        };
        let (ahead, behind) = (side(direction)?, side(-direction)?);
        let middle = if ahead + behind < f64::INFINITY { (ahead - behind) / 2.0 } else { 0.0 };
        Some((point + direction * middle, ahead + behind))
    }

    /// The free way ahead, at most `longest`.
    fn ahead(&self, point: DVec3, way: DVec3, longest: f64) -> f64 {
        self.prepared.first_hit([point, way], longest, None, &mut RAY.clone()).map_or(longest, |(distance, _)| distance)
    }

    /// Follows a sheet from its middle.
    fn walk_sheet(&self, start: Middle, way: DVec3) -> End {
        let (mut at, mut way, mut step) = (start, way, start.width);
        for _ in 0..MAX_WALK {
            let free = self.ahead(at.centre, way, 2.0 * step);
            let length = step.min(free * 0.6);
            if length < SHORTEST * at.width {
                return End::Free;
            }
            let Some((centre, width)) = self.span(at.centre + way * length, at.across) else {
                step = length / 2.0;
                continue;
            };
            if width > self.limit * 1.02 {
                return End::Held;
            }
            let moved = (centre - at.centre).normalize_or(way);
            let side = way.cross(at.across);
            let across = side.cross(moved).normalize_or(at.across);
            let across = if across.dot(at.across) < 0.0 { -across } else { across };
            if across.dot(start.across) < TURNED {
                return End::Held;
            }
            step = if moved.dot(way) > 0.98 { length * 2.0 } else { length };
            step = step.max(SHORTEST * at.width * 1.5);
            (at, way) = (Middle { centre, across, width }, moved);
        }
        End::Far
    }

    /// The held ends of a rod, given the direction in which it is second narrowest.
    fn held_ends(&self, start: Middle, second: DVec3) -> u8 {
        let axis = start.across.cross(second).normalize_or_zero();
        // The middle of the section, along both of its directions.
        let centre = self.span(start.centre, second).filter(|span| span.1 < self.limit).map_or(start.centre, |s| s.0);
        let start = Middle { centre, ..start };
        let ends = [axis, -axis].map(|way| self.walk_rod(start, way));
        if ends.contains(&End::Loop) {
            return 2;
        }
        ends.into_iter().filter(|&end| end == End::Held || end == End::Far).count() as u8
    }

    /// Follows a rod from its middle.
    fn walk_rod(&self, start: Middle, way: DVec3) -> End {
        let (mut at, mut way, mut step, mut walked) = (start, way, start.width / 2.0, 0.0);
        for _ in 0..4 * MAX_WALK {
            let free = self.ahead(at.centre, way, 2.0 * step);
            let length = step.min(free * 0.6);
            if length < SHORTEST * at.width {
                return End::Free;
            }
            let next = at.centre + way * length;
            let second = way.cross(at.across).normalize_or_zero();
            let spans = self.span(next, at.across).and_then(|first| Some((first, self.span(first.0, second)?)));
            let Some(((_, width), (centre, other))) = spans else {
                step = length / 2.0;
                continue;
            };
            if width.max(other) > self.limit * 1.02 {
                return End::Held;
            }
            walked += length;
            if walked > 4.0 * start.width && centre.distance(start.centre) < 1.5 * length {
                return End::Loop;
            }
            let moved = (centre - at.centre).normalize_or(way);
            let across = (at.across - moved * at.across.dot(moved)).normalize_or(at.across);
            step = if moved.dot(way) > 0.98 { length * 1.5 } else { length };
            step = step.min(8.0 * start.width).max(SHORTEST * at.width * 1.5);
            (at, way) = (Middle { centre, across, width }, moved);
        }
        End::Far
    }
}
