//! Exact search for intersecting faces in a mesh or between two meshes, for faces inside other materials, and for
//! touching instances.

use std::collections::BTreeMap;

use glam::DVec3;

use super::analysis::{KnownPairs, flat_faces, get_or_try_init};
use super::unfolded_stars::unfolded_stars;
use super::{Analysis, Defect, DefectKind, Findings, IntersectingPair, Intersections, Meeting, SelfIntersections};
use crate::context::{Cancelled, Context};
use crate::math::{
    Box3, ChangedTriangles, Contact, Frame, Hit, Hubs, PairSearch, Tree, common_point, contact, to_unit_range,
};
use crate::mesh::Parts;

/// Budget of a search, in steps: a fixed allowance plus steps per face. Takes a few seconds; typical models need far
/// less.
const STEPS: u64 = 128_000_000;
const STEPS_PER_FACE: u64 = 500;
/// Steps charged for a determinant whose sign needs exact arithmetic.
const STEPS_PER_EXACT_SIGN: u64 = 8;
/// Maximum number of listed pairs.
const MOST_PAIRS: usize = 1_000_000;

impl Analysis<'_> {
    /// Intersecting faces of this mesh, computed once by [`intersections()`].
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    pub fn intersections(&self, context: &Context<'_>) -> Result<&Intersections, Cancelled> {
        get_or_try_init(&self.intersections, || intersections(self, context))
    }

    /// Faces of the file that lie inside a body of another material.
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    pub fn faces_in_other_materials(&self, context: &Context<'_>) -> Result<&[u32], Cancelled> {
        get_or_try_init(&self.faces_in_other_materials, || faces_in_other_materials(self, context)).map(Vec::as_slice)
    }
}

/// Finds all pairs of faces that intersect outside a shared vertex or edge, with exact predicates.
///
/// Ignores flat faces and pairs with the same three vertices, which other measures count. Adversarial input, such as
/// a hundred thousand overlapping faces, exhausts the budget; then [`SelfIntersections::complete`] is false and the
/// counts are lower bounds. Runs on the current thread pool; the result does not depend on the number of threads.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn intersections(analysis: &Analysis<'_>, context: &Context<'_>) -> Result<Intersections, Cancelled> {
    intersections_within(analysis, budget(analysis), context)
}

fn budget(analysis: &Analysis<'_>) -> u64 {
    STEPS + STEPS_PER_FACE * analysis.surface.faces.len() as u64
}

/// [`intersections()`] for a mesh of which some pairs are known. Builds no tree over all faces, so it is faster where few faces have
/// changed and nothing else needs that tree.
pub(super) fn intersections_near_changed(
    analysis: &Analysis<'_>,
    known: &KnownPairs,
    context: &Context<'_>,
) -> Result<Intersections, Cancelled> {
    let (unit, faces, flat) = (analysis.unit(), &analysis.surface.faces, analysis.flat());
    let meeting = |f: u32, g: u32, steps: &mut u64| face_meeting(unit, [faces, faces], [flat, flat], [f, g], steps);
    let triangles = ChangedTriangles::new(unit, faces, &known.changed);
    context.check()?;
    let mut collector = Collector::new([analysis, analysis]);
    collector.add(known.hits.clone(), context)?;
    let complete = triangles.search(meeting, budget(analysis), |hits| collector.add(hits, context))?;
    Ok(collector.finish(complete))
}

fn intersections_within(
    analysis: &Analysis<'_>,
    budget: u64,
    context: &Context<'_>,
) -> Result<Intersections, Cancelled> {
    let (unit, faces) = (analysis.unit(), &analysis.surface.faces);
    let flat = analysis.flat();
    context.check()?;
    let tree = analysis.tree();
    context.check()?;
    let hubs = Hubs::find(unit, faces);
    let hubs = hubs.as_ref();
    // Not worth the time where only pairs with a changed face are tested.
    let is_unfolded = if analysis.known_pairs.is_some() { Vec::new() } else { unfolded_stars(unit, faces) };
    context.check()?;
    let meeting = |f: u32, g: u32, steps: &mut u64| {
        let other = faces[g as usize];
        let is_apart =
            faces[f as usize].iter().any(|v| other.contains(v) && is_unfolded.get(*v as usize) == Some(&true));
        if is_apart { None } else { face_meeting(unit, [faces, faces], [flat, flat], [f, g], steps) }
    };
    let mut collector = Collector::new([analysis, analysis]);
    let complete = if let Some(known) = &analysis.known_pairs {
        collector.add(known.hits.clone(), context)?;
        let search = PairSearch { look: meeting, budget, hubs };
        search.within_changed(tree, &known.changed, |hits| collector.add(hits, context))?
    } else if analysis.facts.materials.is_none() {
        PairSearch { look: meeting, budget, hubs }.within(tree, |hits| collector.add(hits, context))?
    } else {
        let look = |f: u32, g: u32, steps: &mut u64| {
            let is_one_body = analysis.material(f) == analysis.material(g);
            meeting(f, g, steps).filter(|&meeting| is_one_body || bodies_overlap(analysis, [f, g], meeting))
        };
        PairSearch { look, budget, hubs }.within(tree, |hits| collector.add(hits, context))?
    };
    Ok(collector.finish(complete))
}

/// Finds all pairs of a face of `a` and a face of `b` with a common point, with exact predicates. The two meshes
/// share no vertices, so touching at a vertex counts.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn intersections_between(
    a: &Analysis<'_>,
    b: &Analysis<'_>,
    context: &Context<'_>,
) -> Result<Intersections, Cancelled> {
    // One power of two scales both meshes. The vertices of `b` are numbered after the vertices of `a`.
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
        look: |f: u32, g: u32, steps: &mut u64| {
            face_meeting(&unit, [faces_a, &faces_b], [&flat_a, &flat_b], [f, g], steps)
        },
        budget: STEPS + STEPS_PER_FACE * (faces_a.len() + faces_b.len()) as u64,
        hubs: None,
    };
    let frame = Frame::around(&unit, &[faces_a.as_slice(), &faces_b].concat());
    let trees = [Tree::in_frame(frame, &unit, faces_a), Tree::in_frame(frame, &unit, &faces_b)];
    context.check()?;
    let mut collector = Collector::new([a, b]);
    collector.one_mesh = false;
    let complete = search.between(&trees[0], &trees[1], |hits| collector.add(hits, context))?;
    Ok(collector.finish(complete))
}

#[inline]
fn face_meeting(
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
    let mut exact_signs = 0;
    let contact = contact(unit, faces[0][f], faces[1][g], &mut exact_signs);
    *steps += exact_signs * STEPS_PER_EXACT_SIGN;
    match contact {
        Contact::Disjoint | Contact::Neighbours | Contact::Same => None,
        Contact::Touching => Some(Meeting::Touching),
        Contact::Crossing => Some(Meeting::Crossing),
        Contact::Coplanar => Some(Meeting::Coplanar),
    }
}

/// Largest depth to which bodies of two materials may overlap and still count as touching, in coordinates of
/// [`Analysis::unit`], whose absolute values are at most 1. Rounding to f32 moves vertices by 2^-25 at that size, and
/// perturbing them a little farther.
const TOUCHING_DEPTH: f64 = 1e-5;

/// Whether two bodies of different materials overlap by more than their surfaces, judged at two of their faces that
/// meet.
fn bodies_overlap(analysis: &Analysis<'_>, faces: [u32; 2], meeting: Meeting) -> bool {
    let corners = faces.map(|face| analysis.unit_corners(face));
    let normals = faces.map(|face| analysis.unit_normal(face));
    // For one face, its smaller extent on either side of the other face's plane.
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

/// The distinct materials of a list of faces, ascending.
pub(super) fn materials_in(of_face: &[u32]) -> Vec<u32> {
    let mut numbers = of_face.to_vec();
    numbers.sort_unstable();
    numbers.dedup();
    numbers
}

/// Finds the faces that lie inside a body of another material.
///
/// The search for intersecting faces finds surfaces that cross. Any other face is wholly inside or outside a body,
/// and the winding number just behind its centre decides.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
fn faces_in_other_materials(analysis: &Analysis<'_>, context: &Context<'_>) -> Result<Vec<u32>, Cancelled> {
    let Some(materials) = analysis.facts.materials else { return Ok(Vec::new()) };
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
            .filter(|(_, material)| **material == number)
            .map(|(face, _)| *face)
            .collect();
        let corners = |face: u32| own[face as usize].map(|v| unit[v as usize]);
        let bounds = Box3::of(own.iter().flatten().map(|&v| unit[v as usize]));
        let tree = Tree::new(unit, &own);
        let dipoles = tree.dipoles(corners);
        let others: Vec<u32> = (0u32..).take(count).filter(|&face| material[face as usize] != number).collect();
        for chunk in others.chunks(4096) {
            context.check()?;
            for &face in chunk.iter().filter(|&&face| !analysis.flat()[face as usize]) {
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

/// Accumulated result of a search.
struct Collector<'a> {
    of: [&'a Analysis<'a>; 2],
    one_mesh: bool,
    pairs: Vec<IntersectingPair>,
    counts: SelfIntersections,
    takes_part: [Vec<bool>; 2],
}

impl<'a> Collector<'a> {
    fn new(of: [&'a Analysis<'a>; 2]) -> Self {
        let takes_part = of.map(|a| vec![false; a.file_faces().len()]);
        Self { of, one_mesh: true, pairs: Vec::new(), counts: SelfIntersections::default(), takes_part }
    }

    fn add(&mut self, hits: Vec<Hit<Meeting>>, context: &Context<'_>) -> Result<(), Cancelled> {
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
    /// Adds the pairs of one mesh to its findings, with places up to the limit.
    pub fn report(&self, analysis: &Analysis<'_>, findings: &mut Findings) {
        let faces: Vec<u32> = (0u32..).zip(&self.takes_part[0]).filter(|(_, takes)| **takes).map(|(f, _)| f).collect();
        findings.mark(DefectKind::SelfIntersection, &faces);
        let limit = findings.remaining_places(DefectKind::SelfIntersection);
        for pair in self.pairs.iter().take(limit) {
            let defect = Defect {
                at: common_point_of(analysis, pair).to_array(),
                faces: pair.faces.to_vec(),
                line: Vec::new(),
                value: None,
                meeting: Some(pair.meeting),
            };
            findings.push(DefectKind::SelfIntersection, defect);
        }
        let pairs = self.counts.pairs.unwrap_or(0);
        findings.count_more(DefectKind::SelfIntersection, pairs - limit.min(self.pairs.len()) as u64);
    }
}

/// A common point of two faces, in the model's unit.
fn common_point_of(analysis: &Analysis<'_>, pair: &IntersectingPair) -> DVec3 {
    let [p, q] = pair.faces.map(|f| analysis.file_faces()[f as usize].map(|v| analysis.file_positions()[v as usize]));
    // Scaled so that products neither overflow nor underflow.
    let largest = p.iter().chain(&q).fold(0.0f64, |m, x| m.max(x.abs().max_element()));
    let down = |t: [DVec3; 3]| t.map(|x| x / largest);
    common_point(&down(p), &down(q), pair.meeting == Meeting::Coplanar) * largest
}

/// Two instances of objects with common points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InstanceContact {
    /// Indices of the two instances, smaller first.
    pub instances: [u32; 2],
    /// Number of intersecting pairs of faces, one of each instance; 0 if the instances only share vertices.
    pub pairs: u64,
    /// A common point of the two instances, in the model's unit.
    pub at: [f64; 3],
}

/// Finds pairs of instances with common points: intersecting faces or coincident vertices. The contacts are sorted.
///
/// `instance_of` maps each face of the file to its instance. If the search for intersecting faces is incomplete,
/// instances whose intersecting faces have overlapping bounding boxes also count as in contact.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn instance_contacts(
    analysis: &Analysis<'_>,
    instance_of: impl Fn(u32) -> u32,
    context: &Context<'_>,
) -> Result<Vec<InstanceContact>, Cancelled> {
    let intersections = analysis.intersections(context)?;
    let mut contacts: BTreeMap<[u32; 2], (u64, DVec3)> = BTreeMap::new();
    for pair in &intersections.pairs {
        let [a, b] = pair.faces.map(&instance_of);
        if a != b {
            let at = || common_point_of(analysis, pair);
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
    if !intersections.counts.complete || (intersections.pairs.len() as u64) < intersections.counts.pairs.unwrap_or(0) {
        add_overlapping_boxes(analysis, &intersections.takes_part[0], &instance_of, &mut contacts);
    }
    let contact = |(instances, (pairs, at)): ([u32; 2], (u64, DVec3))| {
        let at = at.to_array();
        InstanceContact { instances, pairs, at }
    };
    Ok(contacts.into_iter().map(contact).collect())
}

fn add_overlapping_boxes(
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
    fn an_exhausted_budget_gives_a_lower_bound_and_proves_nothing() {
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
        let partial = intersections_within(&analysis, 400_000, &context).expect("nobody cancels").counts;
        assert!(all.complete && !partial.complete);
        assert!(partial.pairs < all.pairs && partial.pairs > Some(10_000), "{partial:?} {all:?}");
        let none = SelfIntersections { checked: true, pairs: Some(0), ..SelfIntersections::default() };
        assert!(!none.proven_none());
    }
}
