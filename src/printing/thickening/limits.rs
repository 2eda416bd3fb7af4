//! The limits of single balls: how far they may move the surface, and their distance to other solids.

use crate::math::{Box3, Dipoles, Nearest, Tree, nearest_within};
use crate::mesh::{Parts, Surface};
use glam::DVec3;

use super::outcome::Thickening;
use super::unite::{FAR_AWAY, group_of_each_face};
use super::walls::noise_of;

/// The most that balls may move the surface, as a share of the least wall. A ball in the middle of a wall without thickness
/// moves it by half of the least wall; where a gap limits the growth on one side, the other side moves by all of it. The
/// rest is what later rounds add beside earlier balls.
const MAX_BALL_DEVIATION: f64 = 1.125;
/// The most moves of a ball away from other solids.
const MAX_MOVES: usize = 8;

/// A ball that replaces a thin one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Filler {
    /// The centre.
    pub centre: DVec3,
    /// The radius.
    pub radius: f64,
    /// How far the centre may move while the ball still contains the thin one.
    pub slack: f64,
    /// Whether a gap in front limits the ball.
    pub is_limited: bool,
    /// Whether the ball leaves the middles of all wide gaps free.
    pub is_guarded: bool,
}

impl Filler {
    /// A ball that nothing limits, and that does not move.
    pub fn new(centre: DVec3, radius: f64) -> Self {
        Self { centre, radius, slack: 0.0, is_limited: false, is_guarded: false }
    }
}

/// The limits of balls in a surface to thicken.
pub struct Limits<'a> {
    /// The surface.
    pub input: &'a Surface,
    /// Its tree.
    pub tree: Tree,
    /// Its dipoles, for winding numbers.
    dipoles: Dipoles,
    /// The group of solids of each of its faces, if there are several groups.
    group_of_face: Option<Vec<u32>>,
    /// For each of its faces, whether it is on the side of a wall that stays. Empty if there is no such side.
    kept: Vec<bool>,
    /// The distance up to which a point is on a face but for rounding.
    noise: f64,
    /// The least wall and the least gap.
    pub settings: Thickening,
}

impl<'a> Limits<'a> {
    /// Prepares the limits.
    pub fn new(input: &'a Surface, settings: Thickening) -> Self {
        let tree = Tree::new(&input.positions, &input.faces);
        let dipoles = tree.dipoles(|face| input.corners(face as usize));
        let group_of_face = group_of_each_face(input, &settings);
        let noise = noise_of(&input.positions);
        Self { input, tree, dipoles, group_of_face, kept: Vec::new(), noise, settings }
    }

    /// The same limits, but balls stay behind some faces; `kept` tells for each face whether it is one of them.
    pub fn keeping(self, kept: Vec<bool>) -> Self {
        Self { kept: if kept.contains(&true) { kept } else { Vec::new() }, ..self }
    }

    /// Whether a point is on a face that balls stay behind, except for rounding.
    pub fn is_kept(&self, point: DVec3) -> bool {
        self.nearest_kept(point, self.noise).is_some()
    }

    fn nearest_kept(&self, point: DVec3, reach: f64) -> Option<Nearest> {
        if self.kept.is_empty() { None } else { self.nearest(point, reach, |face| self.kept[face as usize]) }
    }

    /// Limits the radius of a ball, so that it moves the input's surface by less than [`MAX_BALL_DEVIATION`], stays behind the kept
    /// faces, and leaves the least gap to other solids. The ball first moves away from other solids, as far as it still contains the thin ball. Nothing is
    /// left of a ball that would have to be smaller than a cell of the balls' surface, since that can be a cell away from it.
    pub fn apply(&self, filler: &mut Filler, cell: f64) {
        let Filler { centre, radius, slack, .. } = *filler;
        let group = self.group_of_face.as_ref().map(|groups| (&groups[..], self.group_at(centre, groups)));
        let Some(mut best) = self.at(centre, radius, group) else { return };
        let mut last = best;
        for _ in 0..MAX_MOVES {
            let Some(other) = last.other.filter(|_| slack > 0.0) else { break };
            let away = (last.centre - other).normalize_or_zero() * (radius - last.radius);
            let moved = centre + (last.centre + away - centre).clamp_length_max(slack);
            if moved == last.centre {
                break;
            }
            let Some(found) = self.at(moved, radius, group) else { break };
            last = found;
            if last.radius > best.radius {
                best = last;
            }
        }
        filler.is_limited |= best.other.is_some();
        filler.slack -= best.centre.distance(centre);
        filler.centre = best.centre;
        filler.radius = if best.radius < radius.min(cell) { 0.0 } else { best.radius };
    }

    /// The largest radius, at most `radius`, of a ball around a point, which belongs to one of several groups of solids. None without
    /// a surface.
    fn at(&self, centre: DVec3, radius: f64, group: Option<(&[u32], u32)>) -> Option<Allowed> {
        let own = self.nearest(centre, f64::INFINITY, |_| true)?;
        let alone = Allowed { centre, radius, other: None };
        let found = group.map_or(alone, |group| self.beside_others((centre, own.distance), radius, group));
        let depth = if self.is_inside(centre) { own.distance } else { -own.distance };
        let most = MAX_BALL_DEVIATION * self.settings.min_wall + depth;
        let kept = self.nearest_kept(centre, radius).map_or(radius, |kept| kept.distance);
        Some(Allowed { radius: found.radius.min(most).min(kept), ..found })
    }

    /// The largest radius, at most `radius`, of a ball around a point with a distance from the surface, so that the least gap to other
    /// solids stays. The ball takes half of what a gap is wider, since a ball of the other solid may take the rest. Where a gap is
    /// narrower, the ball stays behind its side by half of what it lacks.
    fn beside_others(
        &self,
        (centre, own_distance): (DVec3, f64),
        radius: f64,
        (groups, group): (&[u32], u32),
    ) -> Allowed {
        let gap = self.settings.least_gap();
        let reach = 2.0 * radius + own_distance + gap;
        let mut found = Allowed { centre, radius, other: None };
        self.tree.overlapping(&Box3::of([centre]).grown(reach), |face| {
            if ![group, Parts::NONE].contains(&groups[face as usize])
                && let Some(other) = nearest_within(centre, self.input.corners(face as usize), reach)
            {
                let distance = other.distance(centre);
                // A gap is no wider than this way through the centre.
                if distance - f64::midpoint(gap, distance + own_distance) < found.radius {
                    let own = self.nearest(other, f64::INFINITY, |face| groups[face as usize] == group);
                    let width = own.map_or(gap, |own| own.distance);
                    let most = distance - f64::midpoint(gap, width);
                    if most < found.radius {
                        found = Allowed { radius: most, other: Some(other), ..found };
                    }
                }
            }
            true
        });
        found
    }

    /// Whether there are several groups of solids.
    pub fn has_several_solids(&self) -> bool {
        self.group_of_face.is_some()
    }

    /// Whether two points of surfaces that grew from the input belong to different solids.
    pub fn are_of_two_solids(&self, points: [DVec3; 2]) -> bool {
        self.group_of_face.as_ref().is_some_and(|groups| {
            let [one, other] = points.map(|point| self.group_at(point, groups));
            one != other
        })
    }

    /// Whether a point is inside the surface to thicken. The nearest face alone does not decide that: beyond a sharp edge the point can
    /// be behind one of its faces.
    pub fn is_inside(&self, point: DVec3) -> bool {
        let corners = |face: u32| self.input.corners(face as usize);
        self.tree.winding(&self.dipoles, point, &mut u64::MAX.clone(), corners) > 0.5
    }

    /// The group of the nearest solid.
    fn group_at(&self, point: DVec3, groups: &[u32]) -> u32 {
        let nearest = self.nearest(point, f64::INFINITY, |face| groups[face as usize] != Parts::NONE);
        nearest.map_or(Parts::NONE, |nearest| groups[nearest.face as usize])
    }

    /// The nearest point of some faces, within reach.
    fn nearest(&self, point: DVec3, reach: f64, is_meant: impl Fn(u32) -> bool) -> Option<Nearest> {
        let corners = |face: u32| if is_meant(face) { self.input.corners(face as usize) } else { [FAR_AWAY; 3] };
        self.tree.nearest(point, reach, &mut u64::MAX.clone(), corners)
    }
}

/// The largest ball that may be around a point.
#[derive(Clone, Copy)]
struct Allowed {
    centre: DVec3,
    /// The radius. Negative if there is no such ball.
    radius: f64,
    /// The point of another solid that limits it.
    other: Option<DVec3>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Precision;
    use crate::mesh::Soup;
    use crate::printing::shapes::{cuboid, joined};
    use crate::printing::thickening::Growth;

    fn settings(min_gap: f64) -> Thickening {
        Thickening { min_wall: 1.0, growth: Growth::Both, min_gap, precision: Precision::F32 }
    }

    #[test]
    fn a_ball_moves_away_from_another_solid_while_it_contains_the_thin_one() {
        // A cube and a crumb beside it, which is smaller than the least wall.
        let cube = cuboid(DVec3::ZERO, DVec3::splat(5.0));
        let crumb = cuboid(DVec3::new(5.6, 2.45, 2.45), DVec3::new(5.7, 2.55, 2.55));
        let solids = joined(&[cube, crumb]);
        let limits = Limits::new(&solids, settings(0.4));
        let thin = (DVec3::new(5.65, 2.5, 2.5), 0.05);
        let ball = |slack| {
            let mut ball = Filler { slack, ..Filler::new(thin.0, 0.55) };
            limits.apply(&mut ball, 0.2);
            ball
        };
        let moved = ball(0.5);
        assert_eq!(moved.radius, 0.55);
        assert!(moved.centre.x - moved.radius - 5.0 >= 0.5 - 1e-9, "{moved:?}");
        assert!(moved.centre.distance(thin.0) + thin.1 <= moved.radius, "{moved:?}");
        // Without slack it can only get smaller, and less than a cell would be left.
        assert_eq!((ball(0.0).radius, ball(0.0).is_limited), (0.0, true));
    }

    #[test]
    fn a_point_beyond_a_sharp_edge_is_outside() {
        // Both faces at the edge have planes that the points lie behind.
        let corners = [[0.0, 0.0, 0.0], [-10.0, 0.0, 1.0], [-10.0, 0.0, -1.0]];
        let [front, back] = [0.0, 5.0].map(|y| corners.map(|[x, _, z]| DVec3::new(x, y, z)));
        let faces = vec![[0, 1, 2], [3, 5, 4], [0, 3, 1], [1, 3, 4], [0, 2, 3], [2, 5, 3], [1, 4, 2], [2, 4, 5]];
        let wedge = Surface::from_soup(&Soup { positions: [front, back].concat(), faces }).0;
        let limits = Limits::new(&wedge, settings(0.4));
        let is_inside = |x, z| limits.is_inside(DVec3::new(x, 2.5, z));
        assert_eq!([is_inside(0.4, 0.3), is_inside(0.4, -0.3), is_inside(-8.0, 0.3)], [false, false, true]);
    }
}
