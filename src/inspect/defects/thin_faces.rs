use super::super::DefectKind;
use super::scan::Scan;
use crate::context::Cancelled;
use crate::math::collinear;

/// Heights on the unit scale that rounding alone can give to corners on a line, with room to spare.
const ROUNDING: f64 = 1e-13;

/// Finds flat faces, whose smallest height is below the tolerance, and degenerate ones, of which an edge is; each
/// degenerate face is flat too. Answers which faces are flat.
///
/// A height or length of exactly 0 is decided exactly and told as 0, whatever the tolerance.
pub(super) fn find(scan: &mut Scan<'_, '_>) -> Result<Vec<bool>, Cancelled> {
    let faces = &scan.analysis.surface.faces;
    let tolerance = scan.lengths.degenerate;
    let mut flat = vec![false; faces.len()];
    for (&[u, v, w], f) in faces.iter().zip(0u32..) {
        scan.step(f as usize)?;
        let [a, b, c] = scan.corners(f);
        let sides = [(a, b), (b, c), (c, a)].map(|(p, q)| p.distance_squared(q));
        let longest = sides.into_iter().fold(0.0, f64::max).sqrt();
        let shortest = sides.into_iter().fold(f64::INFINITY, f64::min).sqrt();
        let height = if longest > 0.0 { (b - a).cross(c - a).length() / longest } else { 0.0 };
        // Vertices stand at different places, so that only a repeated one makes an edge of no length.
        let repeated = u == v || v == w || w == u;
        let on_line = repeated || (height <= ROUNDING && collinear(a, b, c));
        if repeated || shortest < tolerance {
            let value = if repeated { 0.0 } else { scan.told_above_zero(shortest) };
            scan.put(DefectKind::DegenerateFace, scan.middle(f), [f], &[], Some(value));
        }
        if on_line || height < tolerance {
            flat[f as usize] = true;
            let value = if on_line { 0.0 } else { scan.told_above_zero(height) };
            scan.put(DefectKind::FlatFace, scan.middle(f), [f], &[], Some(value));
        }
    }
    Ok(flat)
}
