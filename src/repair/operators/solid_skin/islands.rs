//! Parts of the result that do not touch the largest part.

use crate::inspect::solids;
use crate::mesh::{Edges, Parts, Surface};

/// A part with less than this share of the largest part's volume encloses nothing.
const MIN_SHARE: f64 = 1e-12;

/// Removes solid parts with less volume than `min_volume`, but never the largest part, and all parts that enclose
/// nothing or are inside out: remains of patches. Returns the sources of the removed faces: of solid parts, and of the
/// others.
pub fn drop_small(surface: &mut Surface, min_volume: f64) -> [Vec<u32>; 2] {
    let edges = Edges::new(&surface.faces);
    let parts = Parts::new(surface, &edges);
    let solids = solids(surface, &edges, &parts);
    let largest = solids.iter().map(|solid| solid.volume).fold(0.0, f64::max);
    let least = min_volume.min(largest);
    let is_empty: Vec<bool> = solids.iter().map(|solid| solid.volume <= MIN_SHARE * largest).collect();
    let is_removed: Vec<bool> =
        solids.iter().zip(&is_empty).map(|(solid, &is_empty)| is_empty || solid.volume < least).collect();
    if !is_removed.contains(&true) {
        return [Vec::new(), Vec::new()];
    }
    let mut dropped = [Vec::new(), Vec::new()];
    for (&source, &part) in surface.source.iter().zip(&parts.of_face) {
        if part != Parts::NONE && is_removed[part as usize] {
            dropped[usize::from(is_empty[part as usize])].push(source);
        }
    }
    parts.remove(&is_removed, surface);
    dropped
}
