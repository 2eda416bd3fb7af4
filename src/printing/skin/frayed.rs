//! Keeps facets that hang on by few edges between pinholes.

use std::collections::BTreeMap;

use super::evidence::Evidence;
use super::states::Labels;
use crate::arrange::SideLink;

/// The most rounds; chains of such facets are kept one after another.
const MAX_ROUNDS: usize = 4;
/// The most that keeping a facet may lengthen the cut, as a share of its edges' length.
const MAX_GROWTH: f64 = 0.5;

/// Keeps facets that a ball from outside touches on one side alone, and that the cut gave up: where it is shorter, the
/// cut runs along the one edge that still holds such a facet.
pub fn keep_frayed(labels: &mut Labels<'_>) {
    for _ in 0..MAX_ROUNDS {
        let given_up: Vec<bool> =
            (0u32..).take(labels.outer.len() / 2).map(|facet| is_given_up(labels, facet)).collect();
        // For each such facet, the growth of the cut and the length of its edges, both counted twice.
        let mut growth: BTreeMap<u32, [f64; 2]> = BTreeMap::new();
        for &SideLink { sides: [a, b], length } in &labels.sides.links {
            let wanted = |side: u32, facet: u32| {
                if side / 2 == facet { wants_outer(labels, side) } else { labels.outer[side as usize] }
            };
            for facet in if a / 2 == b / 2 { vec![a / 2] } else { vec![a / 2, b / 2] } {
                if given_up[facet as usize] {
                    let was_cut = labels.outer[a as usize] != labels.outer[b as usize];
                    let is_cut = wanted(a, facet) != wanted(b, facet);
                    let [growth, edges] = growth.entry(facet).or_default();
                    *growth += 2.0 * length * (f64::from(u8::from(is_cut)) - f64::from(u8::from(was_cut)));
                    *edges += if a / 2 == b / 2 { 2.0 * length } else { length };
                }
            }
        }
        let kept = growth.into_iter().filter(|(_, [growth, edges])| *growth <= MAX_GROWTH * edges);
        let kept: Vec<u32> = kept.map(|(facet, _)| facet).collect();
        for side in kept.iter().flat_map(|facet| [2 * facet, 2 * facet + 1]) {
            labels.outer[side as usize] = wants_outer(labels, side);
        }
        if kept.is_empty() {
            return;
        }
    }
}

/// Whether a ball from outside touches a side.
fn wants_outer(labels: &Labels<'_>, side: u32) -> bool {
    labels.evidence[side as usize] == Evidence::Outer
}

/// Whether a ball from outside touches a facet on one side alone, yet both sides have the same label.
fn is_given_up(labels: &Labels<'_>, facet: u32) -> bool {
    let sides = [2 * facet, 2 * facet + 1];
    sides.iter().all(|&side| labels.is_cut(side))
        && labels.outer[sides[0] as usize] == labels.outer[sides[1] as usize]
        && wants_outer(labels, sides[0]) != wants_outer(labels, sides[1])
}
