use std::collections::BTreeMap;

use glam::DVec3;

use super::{Analysis, intersections};
use crate::context::{Cancelled, Context};
use crate::math::Box3;

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
            let at = || intersections::place(analysis, pair);
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
