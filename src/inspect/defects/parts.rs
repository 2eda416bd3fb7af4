//! Search for defects of whole parts: parts other than the largest, tiny parts, inverted parts, nested parts and
//! zero-thickness parts.

use glam::DVec3;

use super::super::{DefectKind, Level, Solid, nesting_depths};
use super::scan::{ROUNDING, Scan};
use crate::context::Cancelled;
use crate::mesh::Parts;

/// Area and signed volume of a part on the unit scale. The values of [`Solid`](super::super::Solid) overflow or
/// underflow f64 for extreme coordinates.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Size {
    /// Signed volume, in cubic units of the unit scale.
    pub volume: f64,
    /// Area, in square units of the unit scale.
    pub area: f64,
}

/// Defects of one part.
struct PartDefects {
    is_secondary: bool,
    tiny: Option<f64>,
    inverted: bool,
    depth: Option<u32>,
}

/// Measures every part relative to its first corner, for precision.
pub(super) fn sizes(scan: &Scan<'_, '_>) -> Vec<Size> {
    let parts = &scan.analysis.parts;
    let mut sizes = vec![Size::default(); parts.count];
    let mut about: Vec<Option<DVec3>> = vec![None; parts.count];
    for (&part, f) in parts.of_face.iter().zip(0u32..).filter(|&(&part, _)| part != Parts::NONE) {
        let corners = scan.analysis.unit_corners(f);
        let about = *about[part as usize].get_or_insert(corners[0]);
        let [a, b, c] = corners.map(|p| p - about);
        let size = &mut sizes[part as usize];
        size.volume += a.dot(b.cross(c)) / 6.0;
        size.area += (b - a).cross(c - a).length() / 2.0;
    }
    sizes
}

/// Reports parts other than the largest, tiny parts, inverted parts and, at level `full`, parts inside others.
///
/// The nesting depth of a closed part is the number of other parts that a ray from the part to infinity leaves (see
/// [`nesting_depths`](super::super::nesting_depths)). An inward-facing part is a cavity at odd depth and inverted at
/// even depth. `thin` lists the zero-thickness parts, which have no inside.
pub(super) fn find_parts(
    scan: &mut Scan<'_, '_>,
    level: Level,
    sizes: &[Size],
    thin: &[Option<f64>],
) -> Result<(), Cancelled> {
    let analysis = scan.analysis;
    let solids = &analysis.solids;
    // Like `measures` at any level: only an inward-facing part can be inverted.
    let inward = |part: usize| sizes[part].volume < 0.0;
    let wanted: Vec<bool> = (0..solids.len())
        .map(|part| solids[part].closed && thin[part].is_none() && (inward(part) || level >= Level::Full))
        .collect();
    let depths = nesting_depths(&analysis.surface, &analysis.parts, solids, &wanted, scan.context())?;
    for part in (0..solids.len()).filter(|&part| wanted[part] && depths[part].is_none()) {
        scan.mark_incomplete(if inward(part) { DefectKind::InvertedPart } else { DefectKind::InnerShell });
    }
    let largest = (0..solids.len()).rev().max_by(|&i, &j| sizes[i].area.total_cmp(&sizes[j].area));
    let mesh_diagonal = analysis.surface.bounds().diagonal();
    let tiny = |part: usize| {
        let diagonal = solids[part].bounds.diagonal();
        (diagonal <= scan.in_model_unit(scan.lengths.tiny_part) && diagonal < mesh_diagonal).then_some(diagonal)
    };
    let describe = |(part, depth): (usize, Option<u32>)| PartDefects {
        is_secondary: solids.len() > 1 && Some(part) != largest,
        tiny: tiny(part),
        inverted: inward(part) && depth.is_some_and(|depth| depth % 2 == 0),
        depth: depth.filter(|&depth| depth > 0 && level >= Level::Full),
    };
    let defects: Vec<PartDefects> = depths.into_iter().enumerate().map(describe).collect();
    if defects.iter().all(|part| !part.is_secondary && part.tiny.is_none() && !part.inverted && part.depth.is_none()) {
        return Ok(());
    }
    for (part, (defects, faces)) in defects.into_iter().zip(analysis.parts.faces()).enumerate() {
        scan.step(part)?;
        let Some(&first) = faces.first() else { continue };
        let at = scan.points([analysis.surface.faces[first as usize][0]])[0];
        let mut report = |kind, value| scan.report(kind, at, faces.iter().copied(), value);
        if defects.is_secondary {
            #[expect(clippy::cast_precision_loss, reason = "faces are counted in u32")]
            report(DefectKind::Disjoint, Some(faces.len() as f64));
        }
        if let Some(diagonal) = defects.tiny {
            report(DefectKind::TinyPart, Some(diagonal));
        }
        if defects.inverted {
            report(DefectKind::InvertedPart, defects.depth.map(f64::from));
        } else if let Some(depth) = defects.depth {
            report(DefectKind::InnerShell, Some(f64::from(depth) * if inward(part) { 1.0 } else { -1.0 }));
        }
    }
    Ok(())
}

/// Finds zero-thickness parts: closed parts with at most the volume of a sheet of their area with the tolerance's
/// thickness. Returns their thickness on the unit scale, and `None` for the other parts.
pub(super) fn find_thin_parts(scan: &Scan<'_, '_>, sizes: &[Size]) -> Vec<Option<f64>> {
    let thickness = |(size, solid): (&Size, &Solid)| {
        let thin = solid.closed && size.volume.abs() <= scan.lengths.sheet.max(ROUNDING) * size.area / 2.0;
        thin.then(|| if size.area > 0.0 { 2.0 * size.volume.abs() / size.area } else { 0.0 })
    };
    sizes.iter().zip(&scan.analysis.solids).map(thickness).collect()
}

/// Reports one defect for each zero-thickness part.
pub(super) fn report_parts(scan: &mut Scan<'_, '_>, thin: &[Option<f64>]) {
    if thin.iter().all(Option::is_none) {
        return;
    }
    let mut faces: Vec<Vec<u32>> = vec![Vec::new(); thin.len()];
    for (&part, f) in scan.analysis.parts.of_face.iter().zip(0u32..) {
        if part != Parts::NONE && thin[part as usize].is_some() {
            faces[part as usize].push(f);
        }
    }
    for (thickness, faces) in thin.iter().zip(faces) {
        if let (Some(thickness), Some(&first)) = (thickness, faces.first()) {
            scan.report(DefectKind::Sheet, scan.middle(first), faces, Some(scan.in_model_unit(*thickness)));
        }
    }
}
