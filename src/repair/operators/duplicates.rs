//! Removes faces with the same three vertices, and zero-thickness facets.
//!
//! A *cancelling pair* is an even number of faces on the same three vertices. Connected pairs form a *patch*, which is removed
//! or kept as a single sheet as a whole.

use std::collections::HashSet;

use rustc_hash::FxHashMap;

use super::operator::{Applied, Counter, Operation, Scope};
use super::ray_caster::RayCaster;
use crate::inspect::{FaceGroups, group_faces};
use crate::math::ray_direction;
use crate::mesh::{ClosedSurface, Edges, Surface, UnionFind};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// Zero-thickness patches above this share of the total area stay as one sheet where they are visible.
const LARGE_AREA_SHARE: f64 = 5e-3;
/// Pairs of a patch above which equal windings of each pair are no accident in a surface that is wound at random.
const LEAST_COPY: usize = 4;
/// The most sampled faces, the rays tried from each, and the faces that all rays together may test.
const MAX_SAMPLES: usize = 256;
const RAYS: u32 = 24;
const BUDGET: u64 = 5_000_000;
/// The most passes over the patches: the best choice for one patch depends on its neighbours.
const MAX_PASSES: u32 = 8;

/// Keeps one face of each group of faces with the same three vertices, or none where the faces cancel.
///
/// As chains modulo 2, two faces on the same vertices cancel. The pair may be a zero-thickness facet or a piece of surface
/// that was written twice. Connected pairs are judged together. All of them go where that leaves fewer boundary or
/// non-manifold edges than one sheet would; otherwise one sheet stays, so that a free-standing two-sided sheet is not lost.
/// Large visible patches also stay, and so do closed patches whose pairs are each wound alike: solids that were written
/// twice.
///
/// ```text
///    ____________                    ____________
///   |      |facet|          ->      |            |
///   |______|_____|  (two faces)     |____________|
/// ```
///
/// Precondition: none. Result: no two faces have the same three vertices; of faces with the same winding the first stays.
/// Leaves: overlapping faces with different vertices.
pub fn remove_duplicates(surface: &mut Surface) -> Vec<Change> {
    remove(surface, false)
}

/// Groups with an even number of faces on the same three vertices, and others that enclose a place more than once.
#[derive(Default)]
struct Pairs {
    /// The face of each group that stays if the group does.
    faces: Vec<u32>,
    /// Whether the faces of each group are all wound alike.
    have_one_winding: Vec<bool>,
    /// A face of each other group in which one winding outnumbers the other by three or more.
    repeated: Vec<u32>,
}

impl Pairs {
    /// Whether faces of some group are wound alike.
    fn have_repeats(&self) -> bool {
        !self.repeated.is_empty() || self.have_one_winding.contains(&true)
    }
}

/// Removes duplicates. With `may_keep_solids`, parts of solids that were written twice stay twice where one copy would leave
/// the solids open: the union, which counts how often a place is enclosed, then resolves them.
fn remove(surface: &mut Surface, may_keep_solids: bool) -> Vec<Change> {
    let groups = group_faces(&surface.faces);
    if groups.len() == surface.faces.len() {
        return Vec::new();
    }
    let mut keep = vec![true; surface.faces.len()];
    let mut pairs = Pairs::default();
    for group in groups.iter().filter(|g| g.len() > 1) {
        let even = group.iter().filter(|&&f| is_even(surface.faces[f as usize])).count();
        let majority = 2 * even >= group.len();
        let first = group.iter().find(|&&f| is_even(surface.faces[f as usize]) == majority);
        for &f in group {
            keep[f as usize] = Some(&f) == first;
        }
        // Parity is used rather than winding: that of a single face means little before the surface is oriented.
        if group.len() % 2 == 0 {
            pairs.faces.extend(first.copied());
            pairs.have_one_winding.push(even == 0 || even == group.len());
        } else if (2 * even).abs_diff(group.len()) > 1 {
            pairs.repeated.extend(first.copied());
        }
    }
    let mut cancelled = drop_cancelling_patches(surface, &mut keep, &pairs);
    if may_keep_solids && pairs.have_repeats() && !stays_closed(surface, &keep) && is_union_of_solids(surface, &pairs) {
        keep_by_winding(surface, &groups, &mut keep);
        cancelled = keep.iter().filter(|is_kept| !**is_kept).count() as u64;
    }
    let removed = surface.retain_faces(&keep);
    Change::list([
        (ChangeKind::DuplicateFacesRemoved, removed - cancelled),
        (ChangeKind::CancellingFacesRemoved, cancelled),
    ])
}

/// Keeps as many faces of each group as one winding outnumbers the other, so that each place stays enclosed as often as
/// before.
fn keep_by_winding(surface: &Surface, groups: &FaceGroups, keep: &mut [bool]) {
    for group in groups.iter().filter(|group| group.len() > 1) {
        let (even, odd): (Vec<u32>, Vec<u32>) = group.iter().partition(|&&f| is_even(surface.faces[f as usize]));
        let (more, fewer) = if even.len() >= odd.len() { (even, odd) } else { (odd, even) };
        group.iter().for_each(|&f| keep[f as usize] = false);
        more[fewer.len()..].iter().for_each(|&f| keep[f as usize] = true);
    }
}

/// Whether the faces to keep form a closed surface.
fn stays_closed(surface: &Surface, keep: &[bool]) -> bool {
    let mut kept = surface.clone();
    kept.retain_faces(keep);
    ClosedSurface::try_from(&kept).is_ok()
}

/// Whether the surface is made of closed solids that all face outward, as far as samples tell: no place in front of the
/// sampled faces is enclosed less than never.
fn is_union_of_solids(surface: &Surface, pairs: &Pairs) -> bool {
    if ClosedSurface::try_from(surface).is_err() {
        return false;
    }
    let is_one = pairs.faces.iter().zip(&pairs.have_one_winding).filter(|(_, is_one)| **is_one);
    let sheets: Vec<u32> = is_one.map(|(&f, _)| f).chain(pairs.repeated.iter().copied()).collect();
    let mut rays = RayCaster::of_whole(surface, None, BUDGET);
    let stride = sheets.len().div_ceil(MAX_SAMPLES);
    let mut decided = 0;
    for &f in sheets.iter().step_by(stride) {
        let (face, normal) = (surface.faces[f as usize], surface.area_vector(f as usize));
        let from = rays.centroid(face);
        let mut ahead = (0..RAYS).map(ray_direction).filter(|ray| ray.dot(normal) > 0.0);
        match ahead.find_map(|ray| rays.winding(from, from + ray * 8.0, face)) {
            Some(winding) if winding < 0 => return false,
            Some(_) => decided += 1,
            None => {}
        }
    }
    decided > 0
}

/// Removes the remaining sheet of patches that should be removed. `pairs` are the groups with an even number of faces.
/// Returns the number of removed faces, both faces of each pair counted.
fn drop_cancelling_patches(surface: &Surface, keep: &mut [bool], pairs: &Pairs) -> u64 {
    let canceling = &pairs.faces;
    if canceling.is_empty() {
        return 0;
    }
    let mut pair_at = vec![u32::MAX; surface.faces.len()];
    for (&f, i) in canceling.iter().zip(0u32..) {
        pair_at[f as usize] = i;
    }
    let edges = Edges::new(&surface.faces);
    let mut sets = UnionFind::new(canceling.len());
    let mut attached = vec![false; canceling.len()];
    // For each sheet that may stay its edges, and for each edge the number of faces that stay.
    let mut edges_of = vec![[u32::MAX; 3]; canceling.len()];
    let mut kept_count = vec![0u32; edges.len()];
    for ((half_edges, e), kept_count) in edges.iter().zip(0u32..).zip(&mut kept_count) {
        let kept = half_edges.iter().copied().filter(|&h| keep[h as usize / 3]);
        let (paired, others): (Vec<u32>, Vec<u32>) = kept.partition(|&h| pair_at[h as usize / 3] != u32::MAX);
        for &h in &paired {
            let pair = pair_at[h as usize / 3] as usize;
            edges_of[pair][h as usize % 3] = e;
            attached[pair] |= !others.is_empty();
            // Only edges without other faces connect pairs: elsewhere a facet may meet a piece of surface written twice.
            if others.is_empty() {
                sets.unite(pair_at[paired[0] as usize / 3], pair_at[h as usize / 3]);
            }
        }
        *kept_count = u32::try_from(paired.len() + others.len()).unwrap_or(u32::MAX);
    }
    let mut patches: Vec<Vec<u32>> = vec![Vec::new(); canceling.len()];
    for i in (0u32..).take(canceling.len()) {
        patches[sets.root(i) as usize].push(i);
    }
    let is_copy =
        |patch: &[u32]| patch.len() >= LEAST_COPY && patch.iter().all(|&i| pairs.have_one_winding[i as usize]);
    let is_closed = |patch: &[u32]| {
        let mut of_edge: FxHashMap<u32, u32> = FxHashMap::default();
        patch.iter().flat_map(|&i| edges_of[i as usize]).for_each(|e| *of_edge.entry(e).or_default() += 1);
        of_edge.values().all(|count| count % 2 == 0)
    };
    patches.retain(|patch| patch.iter().any(|&i| attached[i as usize]) && !(is_copy(patch) && is_closed(patch)));
    let mut is_kept = vec![true; canceling.len()];
    let mut choice = PairChoice { edges_of: &edges_of, kept_count, is_kept: &mut is_kept };
    choice.choose(&patches);
    keep_visible_boards(surface, canceling, &mut is_kept, |i| sets.root(i));
    let mut removed = 0;
    for (&f, is_kept) in canceling.iter().zip(is_kept) {
        if !is_kept {
            keep[f as usize] = false;
            removed += 2;
        }
    }
    removed
}

/// Samples the faces numbered in `candidates` and reports for each sample whether a ray from its centroid escapes the surface.
fn sample_visibility(surface: &Surface, faces: &[u32], candidates: &[u32]) -> Vec<(u32, bool)> {
    if candidates.is_empty() {
        return Vec::new();
    }
    // Rays start on the sampled faces, so those faces and their duplicates are left out.
    let own: HashSet<[u32; 3]> =
        candidates.iter().map(|&i| sorted(surface.faces[faces[i as usize] as usize])).collect();
    let others = surface.faces.iter().copied().filter(|&face| !own.contains(&sorted(face))).collect();
    let mut rays = RayCaster::new(surface, others, BUDGET);
    let stride = candidates.len().div_ceil(MAX_SAMPLES);
    let is_visible = |&i: &u32| {
        let from = rays.centroid(surface.faces[faces[i as usize] as usize]);
        let free = (0..RAYS).any(|ray| rays.crossings(from, from + ray_direction(ray) * 8.0, None) == Some(0));
        (i, free)
    };
    candidates.iter().step_by(stride).map(is_visible).collect()
}

fn sorted(mut face: [u32; 3]) -> [u32; 3] {
    face.sort_unstable();
    face
}

/// Keeps large visible patches as one sheet: boards that were modelled without thickness are part of the model. `patch` maps
/// a pair to its patch.
fn keep_visible_boards(surface: &Surface, faces: &[u32], is_kept: &mut [bool], mut patch: impl FnMut(u32) -> u32) {
    let removed_pairs: Vec<u32> = (0u32..).zip(&*is_kept).filter(|(_, is_kept)| !**is_kept).map(|(i, _)| i).collect();
    let mut area = vec![0.0; faces.len()];
    for &i in &removed_pairs {
        area[patch(i) as usize] += surface.area_vector(faces[i as usize] as usize).length();
    }
    let total: f64 = (0..surface.faces.len()).map(|f| surface.area_vector(f).length()).sum();
    let large: Vec<u32> =
        removed_pairs.into_iter().filter(|&i| area[patch(i) as usize] > LARGE_AREA_SHARE * total).collect();
    // Visible samples minus hidden samples, for each patch.
    let mut seen = vec![0i64; faces.len()];
    for (i, is_seen) in sample_visibility(surface, faces, &large) {
        seen[patch(i) as usize] += if is_seen { 1 } else { -1 };
    }
    for i in large {
        is_kept[i as usize] = seen[patch(i) as usize] > 0;
    }
}

/// The choice, for each cancelling pair, whether one sheet of the pair stays.
struct PairChoice<'a> {
    /// The edges of each pair's face.
    edges_of: &'a [[u32; 3]],
    /// How many faces stay at each edge.
    kept_count: Vec<u32>,
    is_kept: &'a mut [bool],
}

impl PairChoice<'_> {
    /// Chooses for each patch, and then for single pairs of patches that would go.
    fn choose(&mut self, patches: &[Vec<u32>]) {
        for _ in 0..MAX_PASSES {
            // Each change alters the best choice for the neighbours.
            let changed = patches.iter().filter(|patch| self.toggle_if_better(patch)).count();
            if changed == 0 {
                break;
            }
        }
        // Bring back single pairs: pieces of surface that were written twice and are only connected to a facet.
        for _ in 0..MAX_PASSES {
            let back: Vec<u32> = patches.iter().flatten().copied().filter(|&i| !self.is_kept[i as usize]).collect();
            if back.iter().filter(|&&i| self.toggle_if_better(&[i])).count() == 0 {
                break;
            }
        }
    }

    /// Toggles the choice for a patch where that leaves fewer boundary or non-manifold edges. Returns whether it did.
    fn toggle_if_better(&mut self, patch: &[u32]) -> bool {
        if self.toggle(patch) < 0 {
            return true;
        }
        self.toggle(patch);
        false
    }

    /// Toggles the choice for each pair of a patch. Returns by how much the number of defective edges rises.
    fn toggle(&mut self, patch: &[u32]) -> i64 {
        let bad = |n: u32| i64::from(!matches!(n, 0 | 2));
        let mut more = 0;
        for &i in patch {
            let is_kept = &mut self.is_kept[i as usize];
            // A face with a repeated vertex has no edges.
            for &e in self.edges_of[i as usize].iter().filter(|e| **e != u32::MAX) {
                let n = &mut self.kept_count[e as usize];
                more -= bad(*n);
                *n = if *is_kept { *n - 1 } else { *n + 1 };
                more += bad(*n);
            }
            *is_kept = !*is_kept;
        }
        more
    }
}

/// Whether the face's vertices are an even permutation of their sorted order.
fn is_even([a, b, c]: [u32; 3]) -> bool {
    (a < b) == ((b < c) == (a < c))
}

/// Removes faces with the same three vertices, and zero-thickness facets.
#[derive(Debug, Clone, Copy)]
pub struct RemoveDuplicates;

impl Operation<'_> for RemoveDuplicates {
    const FIXES: &'static [Counter] = &[Counter::DuplicateFaces];
    const MAY_RAISE: &'static [Counter] =
        &[Counter::BoundaryEdges, Counter::MisorientedEdges, Counter::NonManifoldEdges, Counter::PinchedVertices];
    const ACTS_ON: &'static [Counter] = &[Counter::DuplicateFaces];

    fn with_scope(_scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self
    }

    fn run(&self, surface: &mut Surface, _context: &Context<'_>) -> Result<Applied, Cancelled> {
        Ok(remove(surface, true).into())
    }
}
