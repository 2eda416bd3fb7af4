//! Where a union changed the topology of a surface: the change of its Euler characteristic near each group of balls, and the balls
//! that join solids.
//!
//! By the theorem of Gauss and Bonnet, what the angles at all vertices lack to full turns adds up to 2π times the Euler
//! characteristic. A vertex lacks the same however the flat faces around it are split. So where no ball changes a surface,
//! the sum stays the same, and the sum near one group of balls says what these balls changed.

use std::f64::consts::TAU;

use crate::math::{Box3, Tree, nearest_within};
use crate::mesh::{Edges, Parts, Surface, UnionFind};
use glam::DVec3;
use rayon::prelude::*;
use smallvec::SmallVec;

use super::limits::Filler;

/// How far a change of the Euler characteristic may be from an even number, which it is for closed surfaces: 2 (parts - handles).
/// Rounding moves a part of what a vertex lacks along slivers.
const MAX_ERROR: f64 = 0.5;

/// Balls in groups, of which no two touch.
pub struct BallGroups<'a> {
    balls: &'a [Filler],
    /// The distance from a ball up to which a surface belongs to it.
    reach: f64,
    tree: Tree,
    /// The group of each ball.
    pub of_ball: Vec<u32>,
    /// The number of groups.
    pub count: usize,
}

/// The groups of all balls, and those of the new ones alone, which are smaller.
pub struct ChangedGroups<'a> {
    pub all: BallGroups<'a>,
    pub new: BallGroups<'a>,
    /// The group among all of each group of new balls.
    pub of_new: Vec<usize>,
}

impl<'a> ChangedGroups<'a> {
    /// Groups balls, of which the new ones come after `earlier` ones.
    pub fn new(balls: &'a [Filler], earlier: usize, reach: f64) -> Self {
        let (all, new) = (BallGroups::new(balls, reach), BallGroups::new(&balls[earlier..], reach));
        let mut of_new = vec![0; new.count];
        for (group, &of_all) in new.of_ball.iter().zip(&all.of_ball[earlier..]) {
            of_new[*group as usize] = of_all as usize;
        }
        Self { all, new, of_new }
    }
}

/// The topology of a surface near each group of balls. The last entry is that of the rest.
pub struct LocalTopology {
    /// What the angles at the vertices lack to full turns.
    defects: Vec<f64>,
    /// The number of parts that lie in one group as a whole.
    parts: Vec<f64>,
}

impl<'a> BallGroups<'a> {
    /// Groups balls that are nearer to each other than twice the reach.
    pub fn new(balls: &'a [Filler], reach: f64) -> Self {
        let bounds = |ball: &Filler| Box3::of([ball.centre]).grown(ball.radius + reach);
        let boxes: Vec<Box3> = balls.iter().map(bounds).collect();
        let tree = Tree::of_boxes(&boxes);
        let touching = |number: u32| {
            let ball = &balls[number as usize];
            let mut touching: SmallVec<[u32; 16]> = SmallVec::new();
            tree.overlapping(&boxes[number as usize], |other| {
                let near = &balls[other as usize];
                let reach = near.radius + ball.radius + 2.0 * reach;
                if other < number && near.centre.distance_squared(ball.centre) < reach * reach {
                    touching.push(other);
                }
                true
            });
            touching
        };
        let numbers: Vec<u32> = (0u32..).take(balls.len()).collect();
        let all: Vec<SmallVec<[u32; 16]>> = numbers.par_iter().map(|&number| touching(number)).collect();
        let mut groups = UnionFind::new(balls.len());
        for (number, touching) in numbers.into_iter().zip(all) {
            touching.into_iter().for_each(|other| groups.unite(number, other));
        }
        let (of_ball, count) = groups.into_numbers(|_| true);
        Self { balls, reach, tree, of_ball, count }
    }

    /// The group near a point; the number of groups for a point far from all.
    fn at(&self, point: DVec3) -> u32 {
        let mut found = u32::MAX;
        self.tree.overlapping(&Box3::of([point]), |ball| {
            let Filler { centre, radius, .. } = self.balls[ball as usize];
            if centre.distance(point) < radius + self.reach {
                found = self.of_ball[ball as usize];
            }
            found == u32::MAX
        });
        found.min(u32::try_from(self.count).unwrap_or(u32::MAX))
    }

    /// The topology of a closed surface by groups.
    pub fn topology(&self, surface: &Surface) -> LocalTopology {
        let group: Vec<u32> = surface.positions.par_iter().map(|&point| self.at(point)).collect();
        let mut angles = vec![0.0; surface.positions.len()];
        for (number, face) in surface.faces.iter().enumerate() {
            let corners = surface.corners(number);
            for (k, &vertex) in face.iter().enumerate() {
                let [one, other] = [1, 2].map(|step| corners[(k + step) % 3] - corners[k]);
                angles[vertex as usize] += one.cross(other).length().atan2(one.dot(other));
            }
        }
        let mut defects = vec![0.0; self.count + 1];
        for (&group, &angle) in group.iter().zip(&angles).filter(|(_, angle)| **angle > 0.0) {
            defects[group as usize] += TAU - angle;
        }
        Self::with_parts(surface, &group, defects)
    }

    fn with_parts(surface: &Surface, group: &[u32], defects: Vec<f64>) -> LocalTopology {
        let of_all = Parts::new(surface, &Edges::new(&surface.faces));
        let rest = u32::try_from(defects.len() - 1).unwrap_or(u32::MAX);
        let mut of_part = vec![u32::MAX; of_all.count];
        for (face, &part) in surface.faces.iter().zip(&of_all.of_face).filter(|(_, part)| **part != Parts::NONE) {
            for &vertex in face {
                let of_part = &mut of_part[part as usize];
                *of_part =
                    if [u32::MAX, group[vertex as usize]].contains(of_part) { group[vertex as usize] } else { rest };
            }
        }
        let mut parts = vec![0.0; defects.len()];
        of_part.into_iter().filter(|group| *group != u32::MAX).for_each(|group| parts[group as usize] += 1.0);
        LocalTopology { defects, parts }
    }
}

impl LocalTopology {
    /// How many handles a later surface lacks near each group; negative for additional ones. None if the changes can't be
    /// attributed to groups.
    pub fn handles_lost(&self, after: &Self) -> Option<Vec<i64>> {
        let change = |group: usize| (after.defects[group] - self.defects[group]) / TAU;
        let rest = self.defects.len() - 1;
        let even = |group: usize| 2.0 * (change(group) / 2.0).round();
        let is_even = |group: usize| (change(group) - even(group)).abs() < MAX_ERROR;
        let is_clear = change(rest).abs() < MAX_ERROR && (0..rest).all(is_even);
        #[expect(clippy::cast_possible_truncation, reason = "an integer, and far fewer than 2^63")]
        let lost = |group: usize| (even(group) / 2.0 - (after.parts[group] - self.parts[group])) as i64;
        is_clear.then(|| (0..rest).map(lost).collect())
    }
}

/// The numbers of new balls that join solids of a surface: those within reach of two, and those that touch a ball of another solid.
pub fn joining_solids(before: &Surface, new: &[Filler], reach: f64) -> Vec<usize> {
    let parts = Parts::new(before, &Edges::new(&before.faces));
    let tree = Tree::new(&before.positions, &before.faces);
    let of_ball = |ball: &Filler| {
        let (mut nearest, mut is_single) = ((f64::INFINITY, Parts::NONE), true);
        let reach = ball.radius + reach;
        tree.overlapping(&Box3::of([ball.centre]).grown(reach), |face| {
            if let Some(found) = nearest_within(ball.centre, before.corners(face as usize), reach) {
                let found = (found.distance(ball.centre), parts.of_face[face as usize]);
                is_single &= [found.1, Parts::NONE].contains(&nearest.1);
                nearest = if found < nearest { found } else { nearest };
            }
            true
        });
        is_single.then_some(nearest.1)
    };
    let solid: Vec<Option<u32>> = new.par_iter().map(of_ball).collect();
    let boxes: Vec<Box3> = new.iter().map(|ball| Box3::of([ball.centre]).grown(ball.radius + reach)).collect();
    let touching = Tree::of_boxes(&boxes);
    let joins = |ball: &usize| {
        solid[*ball].is_none_or(|own| {
            touching.any_overlapping(&boxes[*ball], |other| {
                let (one, near) = (new[*ball], new[other as usize]);
                let touches = one.centre.distance(near.centre) < one.radius + near.radius + reach;
                touches
                    && solid[other as usize]
                        .is_some_and(|other| other != own && own != Parts::NONE && other != Parts::NONE)
            })
        })
    };
    (0..new.len()).into_par_iter().filter(joins).collect()
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;
    use std::time::Duration;

    use super::*;
    use crate::context::{Context, NoProgress, monotonic_clock};
    use crate::math::Precision;
    use crate::printing::shapes::{cuboid, joined};
    use crate::remesh::BallUnion;

    fn ball(centre: DVec3, radius: f64) -> Filler {
        Filler::new(centre, radius)
    }

    /// The balls of a ring with a hole of diameter 1.4.
    fn ring(centre: DVec3) -> Vec<Filler> {
        let at = |i: u32| f64::from(i) / 32.0 * TAU;
        (0..32).map(|i| ball(centre + DVec3::new(at(i).cos(), at(i).sin(), 0.0), 0.3)).collect()
    }

    fn surface(balls: &[Filler]) -> Surface {
        let (clock, cancel) = (monotonic_clock(), AtomicBool::new(false));
        let balls: Vec<_> = balls.iter().map(|ball| (ball.centre, ball.radius)).collect();
        let bounds = Box3 { min: DVec3::splat(-3.0), max: DVec3::splat(9.0) };
        let limits = (1_000_000, 1 << 28, Precision::F32);
        let (max_faces, max_memory, precision) = limits;
        let union = BallUnion { balls: &balls, bounds, cell: 0.1, max_faces, max_memory, precision };
        union.surface(&Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(60))).unwrap()
    }

    #[test]
    fn a_closed_hole_is_found_where_another_change_hides_it_from_the_total() {
        let far = DVec3::splat(6.0);
        let [open, whole] = [&ring(DVec3::ZERO)[3..], &ring(far)].map(<[_]>::to_vec);
        // One group closes the gap of the open ring, which makes a handle; the other fills the hole of the whole ring.
        let new = [&ring(DVec3::ZERO)[..3], &[ball(far, 0.8)]].concat();
        let before = surface(&[&open[..], &whole].concat());
        let after = surface(&[&open[..], &whole, &new].concat());
        let euler = |surface: &Surface| surface.euler_characteristic(&Edges::new(&surface.faces));
        assert_eq!(euler(&before), euler(&after));
        let groups = BallGroups::new(&new, 0.3);
        assert_eq!((groups.count, &groups.of_ball[..]), (2, &[0, 0, 0, 1][..]));
        let lost = |before, after| groups.topology(before).handles_lost(&groups.topology(after));
        assert_eq!(lost(&before, &after), Some(vec![-1, 1]));
        assert_eq!(lost(&after, &before), Some(vec![1, -1]));
        assert_eq!(lost(&before, &before), Some(vec![0, 0]));
    }

    #[test]
    fn a_change_away_from_all_groups_leaves_the_places_unknown() {
        let before = surface(&ring(DVec3::ZERO)[3..]);
        let after = surface(&ring(DVec3::ZERO));
        let elsewhere = [ball(DVec3::splat(6.0), 0.5)];
        let groups = BallGroups::new(&elsewhere, 0.1);
        assert_eq!(groups.topology(&before).handles_lost(&groups.topology(&after)), None);
    }

    #[test]
    fn a_part_that_comes_or_goes_is_no_lost_handle() {
        let ball_alone = [ball(DVec3::ZERO, 1.0)];
        let with_crumb = surface(&[ball(DVec3::ZERO, 1.0), ball(DVec3::splat(3.0), 0.3)]);
        let without = surface(&ball_alone);
        let near = [ball(DVec3::splat(3.0), 0.5)];
        let groups = BallGroups::new(&near, 0.1);
        let lost = |before, after| groups.topology(before).handles_lost(&groups.topology(after));
        assert_eq!(lost(&with_crumb, &without), Some(vec![0]));
        assert_eq!(lost(&without, &with_crumb), Some(vec![0]));
    }

    #[test]
    fn balls_that_reach_two_solids_or_touch_another_ones_balls_join_them() {
        // The gap is from 1 to 2.
        let far = DVec3::new(9.0, 9.0, 1.0);
        let plates = joined(&[cuboid(DVec3::ZERO, far), cuboid(DVec3::Z * 2.0, far.with_z(3.0))]);
        let balls =
            [(1.0, 0.5, 0.4), (1.0, 0.9, 0.4), (1.0, 2.1, 0.4), (4.0, 1.5, 0.6), (7.0, 0.5, 0.4), (7.0, 2.5, 0.4)];
        let balls = balls.map(|(x, z, radius)| Filler::new(DVec3::new(x, 4.0, z), radius));
        let joining = |reach| joining_solids(&plates, &balls, reach);
        assert_eq!(joining(0.05), [3]);
        assert_eq!(joining(0.45), [1, 2, 3], "their surfaces are at most 0.4 apart");
    }
}
