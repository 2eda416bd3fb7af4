//! The exact union of a layered surface, and the checks of its promises.

use crate::context::{Cancelled, Context};
use crate::math::{Box3, Tree, winding_exact};
use crate::mesh::{Edges, Parts, Surface, UnionFind, position_key};
use glam::DVec3;
use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::outcome::Thickening;
use super::pockets::{self, Added, is_large_cavity, large_cavities, small, volumes};

/// Computes the boundary of the union of the volumes that a closed surface encloses.
pub trait SelfUnion: Sync {
    /// The boundary of the volume that `surface` winds around outward: closed, manifold by position, without
    /// intersections, with new vertices rounded to the output's precision. No other vertex moves farther than
    /// `max_deviation`. Faces that meet no other face stay as they are, and pieces have the source of their face. None
    /// if there is no such result.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    fn unite(&self, surface: &Surface, max_deviation: f64, context: &Context<'_>)
    -> Result<Option<Surface>, Cancelled>;
}

/// How far rounding may move a vertex, as a share of the least wall.
const MAX_ROUNDING: f64 = 0.01;

/// Why a union is not usable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Broken {
    /// The arrangement or the rounding failed.
    Union,
    /// The groups of solids or the large cavities changed.
    Parts,
    /// A through hole was closed.
    ThroughHole,
}

/// Two solids that are nearer than this share of the least wall touch.
const TOUCHING: f64 = 0.02;
/// A point that is nearest to nothing.
pub const FAR_AWAY: DVec3 = DVec3::splat(1e100);

/// The number of groups of solids, of large cavities, and of handles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Topology {
    solids: usize,
    cavities: usize,
    /// One for each through hole, of all parts.
    handles: i64,
}

impl Topology {
    /// The topology of a surface. Solids that touch belong to one group, and so does a solid smaller than the cube of the
    /// least wall with one that is nearer than the least gap. Cavities smaller than that cube do not count, nor do solids as
    /// small inside the material or in them.
    pub fn of(surface: &Surface, settings: &Thickening) -> Self {
        let edges = Edges::new(&surface.faces);
        let solids = Solids::new(surface, &edges, settings);
        let cavities = solids.volumes.iter().filter(|volume| is_large_cavity(**volume, settings)).count();
        let part_count = i64::try_from(solids.parts.count).unwrap_or(i64::MAX);
        let handles = part_count - surface.euler_characteristic(&edges) / 2;
        Self { solids: solids.groups().count(), cavities, handles }
    }

    /// The property of `before` that a result lacks. It may have more handles: growth can leave a narrow tunnel in a crease.
    pub fn broken_since(self, before: Self) -> Option<Broken> {
        if (self.solids, self.cavities) != (before.solids, before.cavities) {
            return Some(Broken::Parts);
        }
        (self.handles < before.handles).then_some(Broken::ThroughHole)
    }

    /// The same without the through holes that a result lacks.
    pub fn without_holes_missing_in(self, result: Self) -> Self {
        Self { handles: self.handles.min(result.handles), ..self }
    }

    /// The number of handles that a result lacks.
    pub fn handles_lost(self, result: Self) -> u64 {
        u64::try_from(self.handles - result.handles).unwrap_or(0)
    }
}

/// For each face, the first part of its solid's group; [`Parts::NONE`] for faces of cavities and hidden solids. None if there
/// is one group at most.
pub fn group_of_each_face(surface: &Surface, settings: &Thickening) -> Option<Vec<u32>> {
    let solids = Solids::new(surface, &Edges::new(&surface.faces), settings);
    let group = |&part: &u32| if part == Parts::NONE { part } else { solids.group_of_part[part as usize] };
    (solids.groups().count() > 1).then(|| solids.parts.of_face.iter().map(group).collect())
}

/// The parts of a surface, and the groups of those that count as solids.
struct Solids {
    parts: Parts,
    /// The enclosed volume of each part; negative for a cavity.
    volumes: Vec<f64>,
    /// For each part, the first part of its group; [`Parts::NONE`] for a cavity and for a hidden solid.
    group_of_part: Vec<u32>,
}

impl Solids {
    fn new(surface: &Surface, edges: &Edges, settings: &Thickening) -> Self {
        let parts = Parts::new(surface, edges);
        let volumes = volumes(surface, &parts);
        let mut group_of_part = groups(surface, &parts, &volumes, settings);
        let is_hidden = hidden_solids(surface, &parts, &volumes, settings);
        for ((group, volume), is_hidden) in group_of_part.iter_mut().zip(&volumes).zip(is_hidden) {
            if *volume <= 0.0 || is_hidden {
                *group = Parts::NONE;
            }
        }
        Self { parts, volumes, group_of_part }
    }

    /// The first part of each group.
    fn groups(&self) -> impl Iterator<Item = u32> {
        (0u32..).zip(&self.group_of_part).filter(|(part, group)| part == *group).map(|(part, _)| part)
    }
}

/// For each part, the first part of its group.
fn groups(surface: &Surface, parts: &Parts, volumes: &[f64], settings: &Thickening) -> Vec<u32> {
    let mut groups = UnionFind::new(volumes.len());
    if volumes.iter().filter(|volume| **volume > 0.0).count() > 1 {
        let touching = TOUCHING * settings.min_wall;
        let is_small = |part: u32| volumes[part as usize] < small(settings);
        let reach = |part: u32| if is_small(part) { settings.min_gap.max(touching) } else { touching };
        for [one, other] in near_solids(surface, parts, volumes, reach) {
            groups.unite(one, other);
        }
    }
    groups.into_roots()
}

/// Pairs of solids, of which the second is within the reach of a vertex of the first.
fn near_solids(surface: &Surface, parts: &Parts, volumes: &[f64], reach: impl Fn(u32) -> f64 + Sync) -> Vec<[u32; 2]> {
    let tree = Tree::new(&surface.positions, &surface.faces);
    let is_solid = |part: u32| part != Parts::NONE && volumes[part as usize] > 0.0;
    let mut part_of = vec![Parts::NONE; surface.positions.len()];
    for (face, &part) in surface.faces.iter().zip(&parts.of_face) {
        face.iter().for_each(|&v| part_of[v as usize] = part);
    }
    let near = |(&p, &part): (&DVec3, &u32)| {
        let corners = |face: u32| {
            let other = parts.of_face[face as usize];
            if other == part || !is_solid(other) { [FAR_AWAY; 3] } else { surface.corners(face as usize) }
        };
        let found = if is_solid(part) { tree.nearest(p, reach(part), &mut u64::MAX.clone(), corners) } else { None };
        found.map(|found| [part, parts.of_face[found.face as usize]])
    };
    surface.positions.par_iter().zip(&part_of).filter_map(near).collect()
}

/// For each part whether it is a small solid inside another solid, where small cavities count as material.
fn hidden_solids(surface: &Surface, parts: &Parts, volumes: &[f64], settings: &Thickening) -> Vec<bool> {
    let is_small = |part: usize| volumes[part].abs() < small(settings);
    let is_small_solid = |part: usize| is_small(part) && volumes[part] > 0.0;
    if !(0..parts.count).any(is_small_solid) {
        return vec![false; parts.count];
    }
    let faces = parts.faces();
    let corners = |part: usize| faces[part].iter().map(|&face| surface.corners(face as usize));
    let bounds: Vec<Box3> = (0..parts.count).map(|part| Box3::of(corners(part).flatten())).collect();
    let is_hidden = |solid: usize| {
        let Some([vertex, ..]) = corners(solid).next().filter(|_| is_small_solid(solid)) else { return false };
        let may_hold = |part: &usize| {
            let is_counted = !is_small(*part) || volumes[*part] > 0.0;
            *part != solid && is_counted && bounds[*part].holds(vertex)
        };
        (0..parts.count).filter(may_hold).map(|part| winding_exact(vertex, corners(part))).sum::<f64>() > 0.5
    };
    (0..parts.count).into_par_iter().map(is_hidden).collect()
}

/// The large cavities that only one of two surfaces has, as their corners. Cavities are the same if they share a corner; of
/// several that share corners with one cavity, the largest is the same.
pub fn changed_cavities(before: &Surface, after: &Surface, settings: &Thickening) -> Vec<Vec<DVec3>> {
    let [before, mut after] = [before, after].map(|surface| large_cavities(surface, settings));
    let mut of_corner = FxHashMap::default();
    for (number, (corners, _)) in before.iter().enumerate() {
        of_corner.extend(corners.iter().map(|&corner| (position_key(corner), number)));
    }
    after.sort_by(|a, b| a.1.total_cmp(&b.1));
    let mut is_found = vec![false; before.len()];
    after.retain(|(corners, _)| {
        let same = corners.iter().find_map(|&corner| of_corner.get(&position_key(corner)));
        same.is_none_or(|&same| std::mem::replace(&mut is_found[same], true))
    });
    let gone = before.into_iter().zip(is_found).filter(|(_, is_found)| !is_found).map(|(cavity, _)| cavity);
    gone.chain(after).map(|(corners, _)| corners).collect()
}

/// A union of a solid and what was added.
pub struct United {
    pub surface: Surface,
    pub topology: Topology,
    /// The number of narrow slits that were filled, since the added material closed them on all sides.
    pub slits_filled: u64,
}

/// The boundary of the union of a solid and what was added, without small bubbles and crumbs, and its topology. Faces with a
/// source of at least `first_added` are what was added. None if there is no such union.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn united(
    surface: &Surface,
    (added, first_added): (Added, u32),
    settings: &Thickening,
    union: &dyn SelfUnion,
    context: &Context<'_>,
) -> Result<Option<United>, Cancelled> {
    let united = union.unite(surface, MAX_ROUNDING * settings.min_wall, context)?;
    Ok(united.map(|mut united| {
        let slits_filled = pockets::fill(&mut united, surface, (added, first_added), settings);
        let topology = Topology::of(&united, settings);
        United { surface: united, topology, slits_filled }
    }))
}

#[cfg(test)]
mod tests {
    use super::pockets::tests::{settings, tetrahedra};
    use super::*;

    fn of(shapes: &[(f64, f64)]) -> Topology {
        Topology::of(&tetrahedra(shapes), &settings())
    }

    #[test]
    fn a_small_cavity_may_be_lost_but_no_large_one_and_no_solid() {
        let before = of(&[(0.0, 10.0), (1.0, -0.1), (2.0, -1.0), (20.0, 0.1)]);
        let broken = |shapes| of(shapes).broken_since(before);
        assert_eq!(broken(&[(0.0, 10.0), (2.0, -1.0), (20.0, 0.1)]), None);
        assert_eq!(broken(&[(0.0, 10.0), (1.0, -0.1), (20.0, 0.1)]), Some(Broken::Parts));
        assert_eq!(broken(&[(0.0, 10.0), (1.0, -0.1), (2.0, -1.0)]), Some(Broken::Parts));
    }

    #[test]
    fn only_a_small_or_touching_solid_may_join_its_neighbour() {
        // The slanted face of the first is at x + y + z = 3; the others start at (1 + d, 1 + d, 1 + d).
        let one = |before: &[(f64, f64)]| of(&[(0.0, 3.0)]).broken_since(of(before)).is_none();
        assert!(one(&[(0.0, 3.0), (1.1, 0.3)]), "a small solid at less than the gap");
        assert!(!one(&[(0.0, 3.0), (1.2, 0.3)]), "a small solid at more than the gap");
        assert!(!one(&[(0.0, 3.0), (1.1, 3.0)]), "a large solid");
        assert!(one(&[(0.0, 3.0), (1.005, 3.0)]), "a large solid that touches");
    }

    #[test]
    fn a_small_solid_in_a_small_cavity_may_be_joined() {
        // The cavity is inside the large solid, and the smallest solid inside the cavity.
        let before = of(&[(0.0, 10.0), (1.0, -0.2), (1.02, 0.05)]);
        assert_eq!(of(&[(0.0, 10.0)]).broken_since(before), None);
        let apart = of(&[(0.0, 10.0), (1.0, -0.2), (20.0, 0.05)]);
        assert_eq!(of(&[(0.0, 10.0)]).broken_since(apart), Some(Broken::Parts));
    }

    #[test]
    fn balls_keep_clear_of_other_solids_but_not_of_hidden_ones() {
        let groups = |shapes: &[(f64, f64)]| group_of_each_face(&tetrahedra(shapes), &settings());
        assert_eq!(groups(&[(0.0, 10.0), (1.0, -0.2), (1.02, 0.05)]), None);
        let [large, cavity, small] = [[0; 4], [Parts::NONE; 4], [2; 4]];
        assert_eq!(groups(&[(0.0, 10.0), (1.0, -0.2), (20.0, 0.05)]), Some([large, cavity, small].concat()));
    }

    #[test]
    fn closed_opened_and_divided_cavities_are_found_by_their_corners() {
        let solid = (0.0, 30.0);
        let before = [solid, (1.0, -1.0), (4.0, -1.0), (7.0, -0.1)];
        let changed = |after: &[(f64, f64)]| {
            let [before, after] = [&before, after].map(tetrahedra);
            let cavities = changed_cavities(&before, &after, &settings());
            cavities.iter().map(|corners| Box3::of(corners.iter().copied()).min.x).collect::<Vec<_>>()
        };
        assert_eq!(changed(&before), [0.0; 0]);
        assert_eq!(changed(&[solid, (1.0, -1.0), (4.0, -1.0)]), [0.0; 0], "a small cavity");
        assert_eq!(changed(&[solid, (4.0, -1.0)]), [1.0], "lost");
        assert_eq!(changed(&[solid, (1.0, -1.0), (4.0, -1.0), (6.0, -1.1)]), [6.0], "new");
        // Both share a corner with the cavity before; the larger one is the same.
        assert_eq!(changed(&[solid, (1.0, -1.0), (4.0, -1.0), (4.0, -1.1)]), [4.0], "divided");
    }
}
