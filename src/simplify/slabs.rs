//! Simplifies large surfaces in parallel slabs, and then once more as a whole to treat the seams between slabs.

use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;

use super::decimate::{Constraints, Simplified, Simplify};
use crate::context::{Cancelled, Context};
use crate::mesh::Surface;

/// Approximate number of faces of a slab. The slabs depend on the surface alone, so the result does not depend on the
/// number of threads.
const FACES_PER_SLAB: usize = 40_000;
const MAX_SLABS: usize = 64;
/// Share of the maximum error available to the slabs; the rest is for the seams.
const SLAB_ERROR_SHARE: f64 = 0.6;

/// A slab of a surface as a separate surface, with the faces that cross its ends as obstacles.
struct Slab {
    surface: Surface,
    /// Number of faces that cross an end. These faces come first.
    seam_faces: usize,
    /// The vertices of the whole surface that the slab's first vertices are. They stay.
    seam: Vec<u32>,
    /// The coordinates of the slab along the axis.
    range: Range<f64>,
}

/// Whether a surface is large enough for slabs.
pub(super) fn is_large(surface: &Surface) -> bool {
    surface.faces.len() >= 2 * FACES_PER_SLAB
}

/// Simplifies a surface in slabs across its longest side. Of the constraints, fixed positions apply.
///
/// ```text
///      slab 0  :  slab 1  :  slab 2
///    +-------+---+------+---+-------+
///    |       |///|      |///|       |       ///  faces across a plane between slabs: they stay, with all vertices
///    +-------+---+------+---+-------+
/// ```
///
/// Faces with all vertices on one side of a plane never meet those on the other side. Slabs are therefore independent
/// as long as no vertex leaves its slab. The final pass over the whole surface checks the volume of parts that extend
/// over several slabs.
///
/// # Errors
/// [`Cancelled`] if the work is cancelled; the surface is then unchanged.
pub(super) fn simplify_in_slabs(
    options: &Simplify,
    surface: &mut Surface,
    constraints: &Constraints<'_>,
    context: &Context<'_>,
) -> Result<Simplified, Cancelled> {
    let faces_before = surface.faces.len() as u64;
    let axis = longest_axis(surface);
    let planes = planes(surface, axis);
    let slab_of: Vec<u32> = surface.positions.iter().map(|p| slab_at(&planes, p[axis])).collect();
    let mut slabs: Vec<Slab> =
        (0..=planes.len()).into_par_iter().map(|slab| extract_slab(surface, &slab_of, slab, &planes)).collect();
    let own = Simplify { max_error: options.max_error * SLAB_ERROR_SHARE, ..*options };
    let done: Vec<Simplified> = slabs
        .par_iter_mut()
        .map(|slab| {
            let mut fixed = vec![true; slab.seam.len()];
            fixed.resize(slab.surface.positions.len(), false);
            let constraints = Constraints { fixed, slab: Some((axis, slab.range.clone())), ..*constraints };
            own.apply_constrained(&mut slab.surface, &constraints, context)
        })
        .collect::<Result<_, _>>()?;
    let mut whole = combined(surface, &slab_of, slabs);
    let most = |of: fn(&Simplified) -> f64| done.iter().map(of).fold(0.0, f64::max);
    let (error, bound) = (most(|slab| slab.error), most(|slab| slab.bound));
    let is_late = done.iter().any(|slab| slab.is_late);
    let rest = Simplify { max_error: options.max_error - error, ..*options };
    let last =
        if is_late { None } else { context.unless_late(rest.apply_constrained(&mut whole, constraints, context))? };
    *surface = whole;
    Ok(Simplified {
        faces_before,
        faces_after: surface.faces.len() as u64,
        error: error + last.as_ref().map_or(0.0, |pass| pass.error),
        bound: bound + last.as_ref().map_or(0.0, |pass| pass.bound),
        shortfall: last.as_ref().and_then(|pass| pass.shortfall.clone()),
        is_late: last.is_none_or(|pass| pass.is_late),
    })
}

/// The axis along which the surface is longest.
fn longest_axis(surface: &Surface) -> usize {
    let bounds = surface.bounds();
    let size = (bounds.max - bounds.min).to_array();
    (0..3).max_by(|&a, &b| size[a].total_cmp(&size[b]).then(b.cmp(&a))).unwrap_or(0)
}

/// The coordinates that separate slabs with about equal numbers of vertices, in ascending order.
fn planes(surface: &Surface, axis: usize) -> Vec<f64> {
    let count = (surface.faces.len() / FACES_PER_SLAB).clamp(2, MAX_SLABS);
    let mut coordinates: Vec<f64> = surface.positions.iter().map(|p| p[axis]).collect();
    coordinates.par_sort_unstable_by(f64::total_cmp);
    let mut planes: Vec<f64> = (1..count).map(|i| coordinates[i * coordinates.len() / count]).collect();
    planes.dedup();
    planes
}

/// The slab that contains a coordinate: the number of planes at or below it.
fn slab_at(planes: &[f64], x: f64) -> u32 {
    u32::try_from(planes.partition_point(|plane| *plane <= x)).unwrap_or(u32::MAX)
}

/// The first and the last slab that contain a vertex of a face.
fn reach(slab_of: &[u32], face: &[u32; 3]) -> [u32; 2] {
    let [a, b, c] = face.map(|v| slab_of[v as usize]);
    [a.min(b).min(c), a.max(b).max(c)]
}

/// Extracts a slab.
fn extract_slab(surface: &Surface, slab_of: &[u32], slab: usize, planes: &[f64]) -> Slab {
    let from = slab.checked_sub(1).map_or(f64::NEG_INFINITY, |below| planes[below]);
    let range = from..planes.get(slab).copied().unwrap_or(f64::INFINITY);
    let own = |[first, last]: [u32; 2]| first == last && first as usize == slab;
    let crosses = |[first, last]: [u32; 2]| first != last && (first as usize..=last as usize).contains(&slab);
    let chosen = |is_chosen: &dyn Fn([u32; 2]) -> bool| -> Vec<usize> {
        (0..surface.faces.len()).filter(|&f| is_chosen(reach(slab_of, &surface.faces[f]))).collect()
    };
    let (mut faces, inner) = (chosen(&crosses), chosen(&own));
    let seam_faces = faces.len();
    faces.extend(inner);
    let mut number = vec![u32::MAX; surface.positions.len()];
    let (mut seam, mut positions): (Vec<u32>, Vec<DVec3>) = (Vec::new(), Vec::new());
    // Numbers vertices by first use, like the simplified slab.
    let mut add = |v: u32, positions: &mut Vec<DVec3>| {
        let slot = &mut number[v as usize];
        if *slot == u32::MAX {
            *slot = u32::try_from(positions.len()).unwrap_or(u32::MAX);
            positions.push(surface.positions[v as usize]);
        }
        *slot
    };
    for &v in faces[..seam_faces].iter().flat_map(|&f| &surface.faces[f]) {
        if add(v, &mut positions) as usize == seam.len() {
            seam.push(v);
        }
    }
    let corners = faces.iter().map(|&f| surface.faces[f].map(|v| add(v, &mut positions))).collect();
    let source = faces.iter().map(|&f| surface.source[f]).collect();
    Slab { surface: Surface { positions, faces: corners, source }, seam_faces, seam, range }
}

/// Combines the unchanged faces that cross planes with the simplified slabs.
fn combined(surface: &Surface, slab_of: &[u32], slabs: Vec<Slab>) -> Surface {
    let mut whole = Surface::default();
    let mut number = vec![u32::MAX; surface.positions.len()];
    let mut at = |v: u32, whole: &mut Surface| {
        let slot = &mut number[v as usize];
        if *slot == u32::MAX {
            *slot = u32::try_from(whole.positions.len()).unwrap_or(u32::MAX);
            whole.positions.push(surface.positions[v as usize]);
        }
        *slot
    };
    for (face, &source) in surface.faces.iter().zip(&surface.source) {
        let [first, last] = reach(slab_of, face);
        if first != last {
            let face = face.map(|v| at(v, &mut whole));
            whole.faces.push(face);
            whole.source.push(source);
        }
    }
    for slab in slabs {
        let seam: Vec<u32> = slab.seam.iter().map(|&v| at(v, &mut whole)).collect();
        let first = whole.positions.len();
        let inner = |v: u32| u32::try_from(first + v as usize - seam.len()).unwrap_or(u32::MAX);
        let to_whole = |v: u32| seam.get(v as usize).copied().unwrap_or_else(|| inner(v));
        whole.positions.extend(&slab.surface.positions[seam.len()..]);
        let kept = slab.surface.faces[slab.seam_faces..].iter();
        whole.faces.extend(kept.map(|face| face.map(to_whole)));
        whole.source.extend(&slab.surface.source[slab.seam_faces..]);
    }
    whole
}
