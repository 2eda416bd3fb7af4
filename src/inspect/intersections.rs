use std::collections::BTreeMap;

use glam::DVec3;

use super::analysis::{flat_faces, get_or_find};
use super::{Analysis, Defect, DefectKind, Findings, IntersectingPair, Intersections, Meeting, SelfIntersections};
use crate::context::{Cancelled, Context};
use crate::math::{Box3, Contact, Frame, Hit, PairSearch, Tree, common_point, contact, to_unit_range};
use crate::mesh::Parts;

/// Steps that a search may take, and as many more for each face: some seconds, and many times what a usual model needs.
const STEPS: u64 = 128_000_000;
const STEPS_A_FACE: u64 = 500;
/// Steps that a determinant counts for which floating point could not decide.
const STEPS_A_SLOW_SIGN: u64 = 8;
/// Pairs that are listed.
const MOST_PAIRS: usize = 1_000_000;

impl Analysis<'_> {
    /// The faces that intersect, as [`intersections`] finds them.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub fn intersections(&self, context: &Context<'_>) -> Result<&Intersections, Cancelled> {
        get_or_find(&self.intersections, || intersections(self, context))
    }

    /// The faces of the file that lie inside bodies of another material.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub fn faces_in_other_materials(&self, context: &Context<'_>) -> Result<&[u32], Cancelled> {
        get_or_find(&self.faces_in_other_materials, || faces_in_other_materials(self, context)).map(Vec::as_slice)
    }
}

/// Finds all pairs of faces that intersect other than in a vertex or an edge that they share, exactly.
///
/// Faces whose corners are on a line are left out, and so are pairs with the same three vertices: both are counted
/// apart. Crafted input, such as a hundred thousand faces that all overlap, ends the search early; then
/// [`SelfIntersections::complete`] is false, and the counts are at least what is true. Runs on the current pool of
/// threads; the answer is the same for any number of them.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn intersections(analysis: &Analysis<'_>, context: &Context<'_>) -> Result<Intersections, Cancelled> {
    let budget = STEPS + STEPS_A_FACE * analysis.surface.faces.len() as u64;
    intersections_within(analysis, budget, context)
}

fn intersections_within(
    analysis: &Analysis<'_>,
    budget: u64,
    context: &Context<'_>,
) -> Result<Intersections, Cancelled> {
    let (unit, faces) = (analysis.unit(), &analysis.surface.faces);
    let flat = analysis.flat();
    let meeting = |f: u32, g: u32, steps: &mut u64| look(unit, [faces, faces], [flat, flat], [f, g], steps);
    context.check()?;
    let tree = analysis.tree();
    context.check()?;
    let mut found = Found::new([analysis, analysis]);
    let complete = if analysis.subject.materials.is_none() {
        PairSearch { look: meeting, budget }.within(tree, |hits| found.take(hits, context))?
    } else {
        let look = |f: u32, g: u32, steps: &mut u64| {
            let is_one_body = analysis.material(f) == analysis.material(g);
            meeting(f, g, steps).filter(|&meeting| is_one_body || overlap(analysis, [f, g], meeting))
        };
        PairSearch { look, budget }.within(tree, |hits| found.take(hits, context))?
    };
    Ok(found.finish(complete))
}

/// Finds all pairs of a face in `a` and one in `b` that have a point in common, exactly. They share no vertices, so
/// that touching in a vertex counts.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn intersections_between(
    a: &Analysis<'_>,
    b: &Analysis<'_>,
    context: &Context<'_>,
) -> Result<Intersections, Cancelled> {
    // One power of two scales both. The vertices of `b` are numbered after those of `a`.
    let mut positions = a.surface.positions.clone();
    positions.extend(&b.surface.positions);
    let unit = to_unit_range(&positions);
    #[expect(clippy::cast_possible_truncation, reason = "vertices are counted in u32")]
    let first_of_b = a.surface.positions.len() as u32;
    let faces_a = &a.surface.faces;
    let faces_b: Vec<[u32; 3]> = b.surface.faces.iter().map(|f| f.map(|v| v + first_of_b)).collect();
    let (flat_a, flat_b) = (flat_faces(&unit, faces_a), flat_faces(&unit, &faces_b));
    context.check()?;
    let search = PairSearch {
        look: |f: u32, g: u32, steps: &mut u64| look(&unit, [faces_a, &faces_b], [&flat_a, &flat_b], [f, g], steps),
        budget: STEPS + STEPS_A_FACE * (faces_a.len() + faces_b.len()) as u64,
    };
    let frame = Frame::around(&unit, &[faces_a.as_slice(), &faces_b].concat());
    let trees = [Tree::in_frame(frame, &unit, faces_a), Tree::in_frame(frame, &unit, &faces_b)];
    context.check()?;
    let mut found = Found::new([a, b]);
    found.one_mesh = false;
    let complete = search.between(&trees[0], &trees[1], |hits| found.take(hits, context))?;
    Ok(found.finish(complete))
}

#[inline]
fn look(
    unit: &[DVec3],
    faces: [&Vec<[u32; 3]>; 2],
    flat: [&[bool]; 2],
    [f, g]: [u32; 2],
    steps: &mut u64,
) -> Option<Meeting> {
    let (f, g) = (f as usize, g as usize);
    if flat[0][f] || flat[1][g] {
        return None;
    }
    let mut slow = 0;
    let contact = contact(unit, faces[0][f], faces[1][g], &mut slow);
    *steps += slow * STEPS_A_SLOW_SIGN;
    match contact {
        Contact::Disjoint | Contact::Neighbours | Contact::Same => None,
        Contact::Touching => Some(Meeting::Touching),
        Contact::Crossing => Some(Meeting::Crossing),
        Contact::Coplanar => Some(Meeting::Coplanar),
    }
}

/// How deep bodies of two materials may lie in one another and still only touch, in the coordinates of [`Analysis::unit`], in which no
/// coordinate is larger than 1. f32 rounds by 2^-25 there, and vertices that would meet others by it are moved a little farther.
const TOUCHING_DEPTH: f64 = 1e-5;

/// Whether the bodies behind two faces of different materials that meet so have more than their surface in common.
fn overlap(analysis: &Analysis<'_>, faces: [u32; 2], meeting: Meeting) -> bool {
    let corners = faces.map(|face| analysis.unit_corners(face));
    let normals = faces.map(|face| analysis.unit_normal(face));
    // How far a face lies on both sides of the other's plane: the lesser of the two.
    let depth = |one: usize| {
        let other = 1 - one;
        let heights = corners[one].map(|p| (p - corners[other][0]).dot(normals[other]));
        let (above, below) =
            (heights.iter().fold(0.0, |m: f64, &h| m.max(h)), heights.iter().fold(0.0, |m: f64, &h| m.max(-h)));
        above.min(below)
    };
    match meeting {
        Meeting::Touching => false,
        Meeting::Coplanar => normals[0].dot(normals[1]) > 0.0,
        Meeting::Crossing => depth(0).min(depth(1)) > TOUCHING_DEPTH,
    }
}

/// The materials of faces, each once, in ascending order.
pub(super) fn materials_in(of_face: &[u32]) -> Vec<u32> {
    let mut numbers = of_face.to_vec();
    numbers.sort_unstable();
    numbers.dedup();
    numbers
}

/// The faces that lie inside bodies of another material.
///
/// Surfaces that cross are found as intersecting faces; where they don't, a face lies inside another body as a whole or not at all, which
/// the winding number behind its centre tells.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
fn faces_in_other_materials(analysis: &Analysis<'_>, context: &Context<'_>) -> Result<Vec<u32>, Cancelled> {
    let Some(materials) = analysis.subject.materials else { return Ok(Vec::new()) };
    let unit = analysis.unit();
    let count = analysis.surface.faces.len();
    let material: Vec<u32> = (0u32..).take(count).map(|face| analysis.material(face)).collect();
    let mut inside = Vec::new();
    for number in materials_in(materials) {
        let own: Vec<[u32; 3]> = analysis
            .surface
            .faces
            .iter()
            .zip(&material)
            .filter(|(_, it)| **it == number)
            .map(|(face, _)| *face)
            .collect();
        let corners = |face: u32| own[face as usize].map(|v| unit[v as usize]);
        let bounds = Box3::of(own.iter().flatten().map(|&v| unit[v as usize]));
        let tree = Tree::new(unit, &own);
        let dipoles = tree.dipoles(corners);
        let others: Vec<u32> = (0u32..).take(count).filter(|&face| material[face as usize] != number).collect();
        for some in others.chunks(4096) {
            context.check()?;
            for &face in some.iter().filter(|&&face| !analysis.flat()[face as usize]) {
                let behind = analysis.unit_centre(face) - analysis.unit_normal(face) * (2.0 * TOUCHING_DEPTH);
                if bounds.holds(behind) && tree.winding(&dipoles, behind, &mut u64::MAX.clone(), corners).abs() > 0.75 {
                    inside.push(analysis.surface.source[face as usize]);
                }
            }
        }
    }
    inside.sort_unstable();
    Ok(inside)
}

/// What a search has found so far.
struct Found<'a> {
    of: [&'a Analysis<'a>; 2],
    one_mesh: bool,
    pairs: Vec<IntersectingPair>,
    counts: SelfIntersections,
    takes_part: [Vec<bool>; 2],
}

impl<'a> Found<'a> {
    fn new(of: [&'a Analysis<'a>; 2]) -> Self {
        let takes_part = of.map(|a| vec![false; a.subject.soup.faces.len()]);
        Self { of, one_mesh: true, pairs: Vec::new(), counts: SelfIntersections::default(), takes_part }
    }

    fn take(&mut self, hits: Vec<Hit<Meeting>>, context: &Context<'_>) -> Result<(), Cancelled> {
        for ([f, g], meeting) in hits {
            let at = [f as usize, g as usize];
            let mut faces = [self.of[0].surface.source[at[0]], self.of[1].surface.source[at[1]]];
            if self.one_mesh {
                faces.sort_unstable();
            }
            self.takes_part[0][faces[0] as usize] = true;
            self.takes_part[usize::from(!self.one_mesh)][faces[1] as usize] = true;
            let within_one_part = self.one_mesh && same_part(&self.of[0].parts, at);
            let counts = &mut self.counts;
            *match meeting {
                Meeting::Crossing => &mut counts.crossing,
                Meeting::Touching => &mut counts.touching,
                Meeting::Coplanar => &mut counts.coplanar,
            } += 1;
            *if within_one_part { &mut counts.within_one_part } else { &mut counts.between_parts } += 1;
            if self.pairs.len() < MOST_PAIRS {
                self.pairs.push(IntersectingPair { faces, meeting, within_one_part });
            }
        }
        context.check()
    }

    fn finish(mut self, complete: bool) -> Intersections {
        self.pairs.sort_unstable();
        let mut counts = self.counts;
        counts.checked = true;
        counts.complete = complete;
        counts.pairs = Some(counts.within_one_part + counts.between_parts);
        counts.faces = self.takes_part.iter().flatten().filter(|&&t| t).count() as u64;
        Intersections { pairs: self.pairs, counts, takes_part: self.takes_part }
    }
}

fn same_part(parts: &Parts, [f, g]: [usize; 2]) -> bool {
    parts.of_face[f] == parts.of_face[g]
}

impl Intersections {
    /// Puts the pairs of one mesh among its findings, as far as there is room for places.
    pub fn report(&self, analysis: &Analysis<'_>, findings: &mut Findings) {
        let faces: Vec<u32> = (0u32..).zip(&self.takes_part[0]).filter(|(_, takes)| **takes).map(|(f, _)| f).collect();
        findings.mark(DefectKind::SelfIntersection, &faces);
        let room = findings.room(DefectKind::SelfIntersection);
        for pair in self.pairs.iter().take(room) {
            let defect = Defect {
                at: place(analysis, pair).to_array(),
                faces: pair.faces.to_vec(),
                line: Vec::new(),
                value: None,
                meeting: Some(pair.meeting),
            };
            findings.push(DefectKind::SelfIntersection, defect);
        }
        let pairs = self.counts.pairs.unwrap_or(0);
        findings.count_more(DefectKind::SelfIntersection, pairs - room.min(self.pairs.len()) as u64);
    }
}

/// A point that two faces have in common, in the model's unit.
fn place(analysis: &Analysis<'_>, pair: &IntersectingPair) -> DVec3 {
    let [p, q] = pair
        .faces
        .map(|f| analysis.subject.soup.faces[f as usize].map(|v| analysis.subject.soup.positions[v as usize]));
    // Scaled so that products stay in range.
    let largest = p.iter().chain(&q).fold(0.0f64, |m, x| m.max(x.abs().max_element()));
    let down = |t: [DVec3; 3]| t.map(|x| x / largest);
    common_point(&down(p), &down(q), pair.meeting == Meeting::Coplanar) * largest
}

/// Two instances of objects that have points in common where they stand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InstanceContact {
    /// The instances, the smaller number first.
    pub instances: [u32; 2],
    /// Pairs of faces, one of each, that intersect; 0 where the instances only share vertices.
    pub pairs: u64,
    /// A point that both have in common, in the model's unit.
    pub at: [f64; 3],
}

/// Finds the instances that have points in common: a pair of faces that intersects, or a vertex at the same position.
///
/// `instance_of` tells for each face of the file which instance it belongs to. Where the search for intersecting faces was given up,
/// instances also count as in contact when the boxes of their intersecting faces meet. The contacts are sorted.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn instance_contacts(
    analysis: &Analysis<'_>,
    instance_of: impl Fn(u32) -> u32,
    context: &Context<'_>,
) -> Result<Vec<InstanceContact>, Cancelled> {
    let found = analysis.intersections(context)?;
    let mut contacts: BTreeMap<[u32; 2], (u64, DVec3)> = BTreeMap::new();
    for pair in &found.pairs {
        let [a, b] = pair.faces.map(&instance_of);
        if a != b {
            let at = || place(analysis, pair);
            contacts.entry([a.min(b), a.max(b)]).or_insert_with(|| (0, at())).0 += 1;
        }
    }
    let mut first = vec![u32::MAX; analysis.surface.positions.len()];
    for (face, &source) in analysis.surface.faces.iter().zip(&analysis.surface.source) {
        let own = instance_of(source);
        for &v in face {
            let other = &mut first[v as usize];
            if *other == u32::MAX {
                *other = own;
            } else if *other != own {
                let at = analysis.surface.positions[v as usize];
                contacts.entry([own.min(*other), own.max(*other)]).or_insert((0, at));
            }
        }
    }
    if !found.counts.complete || (found.pairs.len() as u64) < found.counts.pairs.unwrap_or(0) {
        add_meeting_boxes(analysis, &found.takes_part[0], &instance_of, &mut contacts);
    }
    let contact = |(instances, (pairs, at)): ([u32; 2], (u64, DVec3))| {
        let at = at.to_array();
        InstanceContact { instances, pairs, at }
    };
    Ok(contacts.into_iter().map(contact).collect())
}

fn add_meeting_boxes(
    analysis: &Analysis<'_>,
    takes_part: &[bool],
    instance_of: &impl Fn(u32) -> u32,
    contacts: &mut BTreeMap<[u32; 2], (u64, DVec3)>,
) {
    let mut boxes: BTreeMap<u32, Box3> = BTreeMap::new();
    let surface = &analysis.surface;
    for (face, &source) in surface.source.iter().enumerate().filter(|(_, source)| takes_part[**source as usize]) {
        let own = Box3::of(surface.corners(face));
        let bounds = boxes.entry(instance_of(source)).or_insert(own);
        bounds.min = bounds.min.min(own.min);
        bounds.max = bounds.max.max(own.max);
    }
    let all: Vec<(u32, Box3)> = boxes.into_iter().collect();
    for (i, (a, own)) in all.iter().enumerate() {
        for (b, other) in &all[i + 1..] {
            if own.meets(other) {
                let at = (own.min.max(other.min) + own.max.min(other.max)) / 2.0;
                contacts.entry([*a, *b]).or_insert((0, at));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;
    use std::time::Duration;

    use super::*;
    use crate::context::NoProgress;
    use crate::mesh::Soup;

    #[test]
    fn where_the_budget_ends_the_search_the_count_is_at_least_and_nothing_is_proven() {
        let mut soup = Soup::default();
        for i in 0..3000u32 {
            let z = f64::from(i);
            let p = [DVec3::new(0.0, 0.0, z), DVec3::new(4000.0, 1.0, 3000.0 - z), DVec3::new(1.0, 4000.0, 1500.0)];
            soup.faces.push([3 * i, 3 * i + 1, 3 * i + 2]);
            soup.positions.extend(p);
        }
        let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::MAX);
        let analysis = Analysis::new((&soup).into(), &context).expect("nobody cancels");
        let all = intersections_within(&analysis, u64::MAX, &context).expect("nobody cancels").counts;
        let some = intersections_within(&analysis, 400_000, &context).expect("nobody cancels").counts;
        assert!(all.complete && !some.complete);
        assert!(some.pairs < all.pairs && some.pairs > Some(10_000), "{some:?} {all:?}");
        let none = SelfIntersections { checked: true, pairs: Some(0), ..SelfIntersections::default() };
        assert!(!none.proven_none());
    }
}
