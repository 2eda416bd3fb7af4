//! Open sheets told from solids with holes.

use glam::DVec3;

use crate::inspect::{Solid, solids};
use crate::mesh::{Edges, Fans, Parts, Surface, boundary_loops};

/// A part is closed when its patches have at most this share of its own area, ...
const MOST_PATCH_SHARE: f64 = 0.5;
/// ... or when the closed part is at least this round (36 pi V^2 / A^3, 1 for a ball).
const LEAST_QUOTIENT: f64 = 0.02;

/// Whether an open part with patches over its holes is a solid with holes, rather than an open sheet such as terrain
/// or a single wall.
///
/// A sheet's patch is about as large as the sheet, and what lies between them is thin. `volume` is that of the closed
/// part, where all its holes have a patch.
///
/// What it comes to: a box without a lid (share 0.2), a ball without a cap, a tube open at both ends that is longer than
/// its radius, and a thick vase without its rim are closed by the share. A half sphere has the share 0.5 and the quotient
/// 0.6: closed, as its disc makes it a solid that prints. A shallow bowl or dish is closed where it is deeper than
/// about 0.13 of its radius, by the quotient. Flatter dishes, terrain, and single walls, whose patch is as large
/// as they are and encloses next to nothing, are sheets.
#[must_use]
pub fn encloses(area: f64, patch_area: f64, volume: Option<f64>) -> bool {
    if patch_area <= MOST_PATCH_SHARE * area {
        return true;
    }
    let closed = area + patch_area;
    // In this order so that neither factor leaves the range of f64.
    let quotient = |v: f64| 36.0 * std::f64::consts::PI * (v / closed).powi(2) / closed;
    volume.is_some_and(|v| quotient(v) >= LEAST_QUOTIENT)
}

/// Share of the surface's area in parts that are open sheets, each hole being closed by a cone over its middle.
///
/// The surface should be oriented and welded. Linear but for sorting.
#[must_use]
pub fn open_sheet_share(surface: &Surface) -> f64 {
    let edges = Edges::new(&surface.faces);
    let parts = Parts::new(surface, &edges);
    let solids = solids(surface, &edges, &parts);
    let total: f64 = solids.iter().map(|s| s.area).sum();
    let sheets = open_sheets(surface, &edges, &parts, &solids);
    let sheets: f64 = solids.iter().zip(sheets).filter(|(_, sheet)| *sheet).map(|(s, _)| s.area).sum();
    if total > 0.0 { sheets / total } else { 0.0 }
}

/// Of each part whether it is an open sheet, as [`open_sheet_share`] tells them.
pub(super) fn open_sheets(surface: &Surface, edges: &Edges, parts: &Parts, solids: &[Solid]) -> Vec<bool> {
    let fans = Fans::new(surface, edges);
    let loops = boundary_loops(surface, edges, &fans);
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
    // A boundary that can't be walked is that of walls around something, or of faces around an edge.
    let patches = Parts::patches(surface, edges);
    let has_boundary = patches.open(edges);
    let mut frayed = vec![true; parts.count];
    for (&part, &patch) in parts.of_face.iter().zip(&patches.of_face).filter(|&(&part, _)| part != Parts::NONE) {
        frayed[part as usize] &= has_boundary[patch as usize];
    }
    let encloses = |p: usize| encloses(solids[p].area, patch_area[p], Some(volume[p]));
    (0..parts.count).map(|p| open[p] && ((!walked[p] && frayed[p]) || !encloses(p))).collect()
}
