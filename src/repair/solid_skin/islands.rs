//! Parts of the result that do not touch the largest part.

use crate::context::{Cancelled, Context};
use crate::inspect::{nesting, solids};
use crate::mesh::{Edges, Parts, Surface};

/// Removes solid parts with less volume than `min_volume`, and the cavities in them, but never the largest part.
/// Returns the sources of the removed faces.
pub fn drop_small(surface: &mut Surface, min_volume: f64, context: &Context<'_>) -> Result<Vec<u32>, Cancelled> {
    let edges = Edges::new(&surface.faces);
    let parts = Parts::new(surface, &edges);
    let solids = solids(surface, &edges, &parts);
    let largest = solids.iter().map(|solid| solid.volume).fold(0.0, f64::max);
    let least = min_volume.min(largest);
    let mut is_removed: Vec<bool> = solids.iter().map(|solid| solid.volume > 0.0 && solid.volume < least).collect();
    if !is_removed.contains(&true) {
        return Ok(Vec::new());
    }
    let is_cavity: Vec<bool> = solids.iter().map(|solid| solid.volume < 0.0).collect();
    if is_cavity.contains(&true) {
        let containers = nesting(surface, &parts, &solids, &is_cavity, context)?;
        for part in (0..parts.count).filter(|&part| is_cavity[part]) {
            is_removed[part] = containers[part].iter().flatten().any(|&around| is_removed[around as usize]);
        }
    }
    let is_in = |part: u32| part != Parts::NONE && is_removed[part as usize];
    let dropped = surface.source.iter().zip(&parts.of_face).filter(|&(_, &part)| is_in(part)).map(|(&s, _)| s);
    let dropped = dropped.collect();
    parts.remove(&is_removed, surface);
    Ok(dropped)
}
