//! The distinction of open sheets from solids with holes.
//!
//! Holes of a solid are closed; a sheet, such as terrain or a single wall, encloses nothing and stays open unless it gets a thickness.

use glam::DVec3;

use super::border::OpenParts;
use crate::context::{Cancelled, Context};
use crate::inspect::{Solid, solids};
use crate::math::winding_exact;
use crate::mesh::{Edges, Parts, Surface, boundary_loops};

/// Share of the area in open sheets from which the whole model counts as an open sheet.
pub(in crate::repair) const SHEET_SHARE: f64 = 0.9;

/// Largest area of a solid's hole patches, as a share of the part's own area.
const MAX_PATCH_SHARE: f64 = 0.5;
/// Least isoperimetric quotient (36 pi V^2 / A^3, 1 for a ball) of a solid with larger patches.
const MIN_QUOTIENT: f64 = 0.02;

/// Whether an open part with patches over its holes is a solid with holes, rather than an open sheet such as terrain or a single wall.
///
/// The patch of a sheet is about as large as the sheet, and the space between them is thin. `area` and `patch_area` are in square units.
/// `volume` is that of the closed part in cubic units; none unless all holes have a patch.
///
/// Solids by the share of patches: a box without a lid (share 0.2), a ball without a cap, a tube open at both ends and longer than its
/// radius, and a thick vase without its rim. A half sphere has share 0.5 and quotient 0.6, and is a solid that prints. A shallow dish is
/// a solid, by the quotient, if it is deeper than about 0.13 of its radius. Flatter dishes, terrain and single walls are sheets.
#[must_use]
pub fn encloses(area: f64, patch_area: f64, volume: Option<f64>) -> bool {
    if patch_area <= MAX_PATCH_SHARE * area {
        return true;
    }
    let closed = area + patch_area;
    // This order of operations keeps all factors within the range of f64.
    let quotient = |v: f64| 36.0 * std::f64::consts::PI * (v / closed).powi(2) / closed;
    volume.is_some_and(|v| quotient(v) >= MIN_QUOTIENT)
}

/// Share of the surface's area in parts that are open sheets. For the test, each hole is closed by a cone from its centre.
///
/// The surface should be oriented and welded. Linear time except for sorting.
#[must_use]
pub fn open_sheet_share(surface: &Surface) -> f64 {
    open_sheet_share_with(surface, &Edges::new(&surface.faces))
}

/// [`open_sheet_share`] of a surface with these `edges`.
pub(in crate::repair) fn open_sheet_share_with(surface: &Surface, edges: &Edges) -> f64 {
    let parts = Parts::new(surface, edges);
    let solids = solids(surface, edges, &parts);
    let total: f64 = solids.iter().map(|s| s.area).sum();
    let sheets = open_sheets(surface, edges, &parts, &solids);
    let sheets: f64 = solids.iter().zip(sheets).filter(|(_, sheet)| *sheet).map(|(s, _)| s.area).sum();
    if total > 0.0 { sheets / total } else { 0.0 }
}

/// For each part, whether it is an open sheet by the test of [`open_sheet_share`].
pub(in crate::repair) fn open_sheets(surface: &Surface, edges: &Edges, parts: &Parts, solids: &[Solid]) -> Vec<bool> {
    let loops = boundary_loops(surface, edges);
    let mut patch_area = vec![0.0; parts.count];
    let mut volume: Vec<f64> = solids.iter().map(|s| s.volume).collect();
    let (open, mut walked) = (parts.open(edges), vec![false; parts.count]);
    for (vertices, &face) in loops.simple.iter().zip(&loops.face) {
        let part = parts.of_face[face as usize] as usize;
        walked[part] = true;
        let about = solids[part].bounds.centre();
        let at = |i: usize| surface.positions[vertices[i % vertices.len()] as usize] - about;
        #[expect(clippy::cast_precision_loss, reason = "a loop is far shorter than 2^53")]
        let middle = (0..vertices.len()).map(at).sum::<DVec3>() / vertices.len() as f64;
        for i in 0..vertices.len() {
            patch_area[part] += (at(i) - middle).cross(at(i + 1) - middle).length() / 2.0;
            volume[part] += middle.dot(at(i).cross(at(i + 1))) / 6.0;
        }
    }
    // A boundary without simple loops belongs to walls around a space, to faces around a common edge, or to a solid with
    // fins at its holes, which is almost closed.
    let patches = Parts::patches(surface, edges);
    let has_boundary = patches.open(edges);
    let mut frayed = vec![true; parts.count];
    for (&part, &patch) in parts.of_face.iter().zip(&patches.of_face).filter(|&(&part, _)| part != Parts::NONE) {
        frayed[part as usize] &= has_boundary[patch as usize];
    }
    let is_unclear = |p: usize| open[p] && !walked[p] && frayed[p];
    let faces = if (0..parts.count).any(is_unclear) { parts.faces() } else { Vec::new() };
    let encloses = |p: usize| {
        if is_unclear(p) {
            mean_winding(surface, &faces[p]).abs() >= ALMOST_CLOSED
        } else {
            encloses(solids[p].area, patch_area[p], Some(volume[p]))
        }
    };
    (0..parts.count).map(|p| open[p] && !encloses(p)).collect()
}

/// Mean winding number on an open part's own faces from which the part is almost closed: half of a closed part's number.
const ALMOST_CLOSED: f64 = 0.25;
/// Fewest and most faces of a part that are sampled.
const SAMPLES: [usize; 2] = [8, 64];
/// Most pairs of faces that are evaluated for a part.
const MAX_PAIRS: usize = 16_000_000;

/// For each open part, whether it is almost closed, by generalized winding numbers (Jacobson et al. 2013). An open sheet is not almost
/// closed: its holes are not filled, so it can only be thickened.
///
/// On a closed surface the winding number is 1/2, halfway between 0 outside and 1 inside; on a plane sheet it is 0. A half sphere has
/// 0.33, a box without its lid 0.4. Each part is sampled separately, at faces spread evenly over its area, with at most a constant number
/// of sums over the part's faces.
///
/// # Errors
/// [`Cancelled`] if the job was canceled or the deadline passed.
pub(in crate::repair) fn almost_closed(
    surface: &Surface,
    open: &OpenParts,
    context: &Context<'_>,
) -> Result<Vec<bool>, Cancelled> {
    let mut faces: Vec<Vec<u32>> = vec![Vec::new(); open.count as usize];
    for (&face, &part) in open.faces.iter().zip(&open.part) {
        faces[part as usize].push(face);
    }
    let mut almost = Vec::with_capacity(faces.len());
    for faces in &faces {
        context.check()?;
        almost.push(mean_winding(surface, faces).abs() >= ALMOST_CLOSED);
    }
    if almost.contains(&true) {
        let edges = Edges::new(&surface.faces);
        let parts = Parts::new(surface, &edges);
        let sheets = open_sheets(surface, &edges, &parts, &solids(surface, &edges, &parts));
        for (almost, faces) in almost.iter_mut().zip(&faces) {
            *almost &= faces.first().is_some_and(|&face| !sheets[parts.of_face[face as usize] as usize]);
        }
    }
    Ok(almost)
}

/// The mean winding number of a set of faces, sampled on these faces.
fn mean_winding(surface: &Surface, faces: &[u32]) -> f64 {
    let areas: Vec<f64> = faces.iter().map(|&f| surface.area_vector(f as usize).length()).collect();
    let total: f64 = areas.iter().sum();
    let count = (MAX_PAIRS / faces.len().max(1)).clamp(SAMPLES[0], SAMPLES[1]);
    if !(total > 0.0 && total.is_finite()) {
        return 0.0;
    }
    let (mut passed, mut sampled, mut sum) = (0.0, 0, 0.0);
    for (&face, area) in faces.iter().zip(areas) {
        passed += area;
        // A large face counts for all equal shares of the area that end in this face.
        let shares = ((passed / total * count as f64 + 0.5) as usize).min(count);
        if shares > sampled {
            let [a, b, c] = surface.corners(face as usize);
            let others = faces.iter().filter(|&&other| other != face).map(|&other| surface.corners(other as usize));
            sum += winding_exact((a + b + c) / 3.0, others) * (shares - sampled) as f64;
            sampled = shares;
        }
    }
    if sampled == 0 { 0.0 } else { sum / sampled as f64 }
}
