//! Faces with the same three vertices, and walls of no thickness.

use std::collections::HashSet;

use super::inside::RayCaster;
use super::operator::{Applied, Counter, Operation, Scope};
use crate::inspect::group_faces;
use crate::math::ray_direction;
use crate::mesh::{Edges, Surface, UnionFind};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// Walls over this share of the whole area stay as one sheet where they can be seen.
const LARGE: f64 = 5e-3;
/// Faces of walls that are asked, rays tried from each, and faces that all rays together may look at.
const ASKED: usize = 256;
const RAYS: u32 = 24;
const BUDGET: u64 = 5_000_000;
/// Times that the choice between gone and one sheet is gone through, where it depends on that of neighbours.
const PASSES: u32 = 8;

/// Leaves one face of each group of faces with the same three vertices, or none where they cancel.
///
/// In the arithmetic of chains two faces on the same vertices add up to nothing: they may be a wall of no thickness,
/// a flap, or a piece of surface that was written twice. Such pairs are taken together with the pairs next to them;
/// all of them go where that leaves fewer open or non-manifold edges than one sheet of them would, and one sheet
/// stays otherwise, so that a two-sided sheet standing alone is not lost. Nor does a wall go that can be seen and is large.
///
/// ```text
///    ____________                    ____________
///   |      |wall |          ->      |            |
///   |______|_____|  (two faces)     |____________|
/// ```
///
/// Precondition: none. Result: no two faces have the same three vertices; of faces that wind the same way the first
/// one stays. Leaves: faces that lie on one another with different vertices.
pub fn remove_duplicates(surface: &mut Surface) -> Vec<Change> {
    let groups = group_faces(&surface.faces);
    if groups.len() == surface.faces.len() {
        return Vec::new();
    }
    let mut keep = vec![true; surface.faces.len()];
    let mut canceling = Vec::new();
    for group in groups.iter().filter(|g| g.len() > 1) {
        let even = group.iter().filter(|&&f| is_even(surface.faces[f as usize])).count();
        let majority = 2 * even >= group.len();
        let first = group.iter().find(|&&f| is_even(surface.faces[f as usize]) == majority);
        for &f in group {
            keep[f as usize] = Some(&f) == first;
        }
        // By number and not by winding, which says little before faces are turned.
        if group.len() % 2 == 0 {
            canceling.extend(first.copied());
        }
    }
    let walls = drop_walls(surface, &mut keep, &canceling);
    let gone = surface.retain_faces(&keep);
    Change::list([(ChangeKind::DuplicateFacesRemoved, gone - walls), (ChangeKind::CancellingFacesRemoved, walls)])
}

/// Takes back the sheets of those walls that are better gone. `canceling` are the kept faces of groups of even
/// number. Answers how many faces that is.
fn drop_walls(surface: &Surface, keep: &mut [bool], canceling: &[u32]) -> u64 {
    if canceling.is_empty() {
        return 0;
    }
    let mut wall_of = vec![u32::MAX; surface.faces.len()];
    for (&f, i) in canceling.iter().zip(0u32..) {
        wall_of[f as usize] = i;
    }
    let edges = Edges::new(&surface.faces);
    let mut sets = UnionFind::new(canceling.len());
    let mut attached = vec![false; canceling.len()];
    // Of each sheet that may stay the edges, and for each edge the faces that stay.
    let mut edges_of = vec![[u32::MAX; 3]; canceling.len()];
    let mut staying = vec![0u32; edges.len()];
    for ((half_edges, e), staying) in edges.iter().zip(0u32..).zip(&mut staying) {
        let kept = half_edges.iter().copied().filter(|&h| keep[h as usize / 3]);
        let (walls, others): (Vec<u32>, Vec<u32>) = kept.partition(|&h| wall_of[h as usize / 3] != u32::MAX);
        for &h in &walls {
            let wall = wall_of[h as usize / 3] as usize;
            edges_of[wall][h as usize % 3] = e;
            attached[wall] |= !others.is_empty();
            // Where other surface ends, a wall and a piece of that surface that is there twice may meet.
            if others.is_empty() {
                sets.unite(wall_of[walls[0] as usize / 3], wall_of[h as usize / 3]);
            }
        }
        *staying = u32::try_from(walls.len() + others.len()).unwrap_or(u32::MAX);
    }
    let mut walls: Vec<Vec<u32>> = vec![Vec::new(); canceling.len()];
    for i in (0u32..).take(canceling.len()) {
        walls[sets.root(i) as usize].push(i);
    }
    walls.retain(|wall| wall.iter().any(|&i| attached[i as usize]));
    let mut stays = vec![true; canceling.len()];
    let mut choice = Choice { edges_of: &edges_of, staying, stays: &mut stays };
    for _ in 0..PASSES {
        // Any that changes alters what is best for those next to it.
        let changed = walls.iter().filter(|wall| choice.turn_if_better(wall)).count();
        if changed == 0 {
            break;
        }
    }
    // Pieces of surface that are there twice and only hang together with a wall.
    for _ in 0..PASSES {
        let back: Vec<u32> = walls.iter().flatten().copied().filter(|&i| !choice.stays[i as usize]).collect();
        if back.iter().filter(|&&i| choice.turn_if_better(&[i])).count() == 0 {
            break;
        }
    }
    keep_boards(surface, canceling, &mut stays, |i| sets.root(i));
    let mut gone = 0;
    for (&f, stays) in canceling.iter().zip(stays) {
        if !stays {
            keep[f as usize] = false;
            gone += 2;
        }
    }
    gone
}

/// Of some of the faces numbered in `asked`, by number, whether a ray from their middle leaves the surface unhindered.
fn seen_from_outside(surface: &Surface, faces: &[u32], asked: &[u32]) -> Vec<(u32, bool)> {
    if asked.is_empty() {
        return Vec::new();
    }
    // The faces themselves, and their doubles, are no hindrance: rays begin within them.
    let own: HashSet<[u32; 3]> = asked.iter().map(|&i| sorted(surface.faces[faces[i as usize] as usize])).collect();
    let others = surface.faces.iter().copied().filter(|&face| !own.contains(&sorted(face))).collect();
    let mut rays = RayCaster::new(surface, others, BUDGET);
    let stride = asked.len().div_ceil(ASKED);
    let see = |&i: &u32| {
        let from = rays.middle(surface.faces[faces[i as usize] as usize]);
        let free = (0..RAYS).any(|ray| rays.crossings(from, from + ray_direction(ray) * 8.0, None) == Some(0));
        (i, free)
    };
    asked.iter().step_by(stride).map(see).collect()
}

fn sorted(mut face: [u32; 3]) -> [u32; 3] {
    face.sort_unstable();
    face
}

/// Lets walls stay as one sheet that are large and can be seen: boards that were drawn without thickness, and part of the
/// model. `wall` tells which faces are one wall.
fn keep_boards(surface: &Surface, faces: &[u32], stays: &mut [bool], mut wall: impl FnMut(u32) -> u32) {
    let goes: Vec<u32> = (0u32..).zip(&*stays).filter(|(_, stays)| !**stays).map(|(i, _)| i).collect();
    let mut area = vec![0.0; faces.len()];
    for &i in &goes {
        area[wall(i) as usize] += surface.area_vector(faces[i as usize] as usize).length();
    }
    let total: f64 = (0..surface.faces.len()).map(|f| surface.area_vector(f).length()).sum();
    let large: Vec<u32> = goes.into_iter().filter(|&i| area[wall(i) as usize] > LARGE * total).collect();
    // Faces that are seen less those that are not.
    let mut seen = vec![0i64; faces.len()];
    for (i, is_seen) in seen_from_outside(surface, faces, &large) {
        seen[wall(i) as usize] += if is_seen { 1 } else { -1 };
    }
    for i in large {
        stays[i as usize] = seen[wall(i) as usize] > 0;
    }
}

/// Which of the sheets that may go stay.
struct Choice<'a> {
    /// The edges of each sheet's face.
    edges_of: &'a [[u32; 3]],
    /// How many faces stay at each edge.
    staying: Vec<u32>,
    stays: &'a mut [bool],
}

impl Choice<'_> {
    /// Takes some away that stay, or has them back, where that leaves fewer edges open or non-manifold.
    fn turn_if_better(&mut self, wall: &[u32]) -> bool {
        if self.turn(wall) < 0 {
            return true;
        }
        self.turn(wall);
        false
    }

    /// Turns the choice on some. Answers how many more edges are bad.
    fn turn(&mut self, wall: &[u32]) -> i64 {
        let bad = |n: u32| i64::from(!matches!(n, 0 | 2));
        let mut more = 0;
        for &i in wall {
            let stays = &mut self.stays[i as usize];
            // A face with a vertex twice has no edges.
            for &e in self.edges_of[i as usize].iter().filter(|e| **e != u32::MAX) {
                let n = &mut self.staying[e as usize];
                more -= bad(*n);
                *n = if *stays { *n - 1 } else { *n + 1 };
                more += bad(*n);
            }
            *stays = !*stays;
        }
        more
    }
}

/// Whether the face's vertices are an even permutation of their sorted order.
fn is_even([a, b, c]: [u32; 3]) -> bool {
    (a < b) == ((b < c) == (a < c))
}

/// Drops faces with the same three vertices, and walls of no thickness.
#[derive(Debug, Clone, Copy)]
pub struct RemoveDuplicates;

impl Operation for RemoveDuplicates {
    const FIXES: &'static [Counter] = &[Counter::DuplicateFaces];
    const MAY_RAISE: &'static [Counter] =
        &[Counter::BoundaryEdges, Counter::MisorientedEdges, Counter::NonManifoldEdges, Counter::PinchedVertices];

    fn with_scope(_scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self
    }

    fn run(&self, surface: &mut Surface, _context: &Context<'_>) -> Result<Applied, Cancelled> {
        Ok(remove_duplicates(surface).into())
    }
}
