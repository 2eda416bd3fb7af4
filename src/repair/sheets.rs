//! Open sheets told from solids with holes.

use glam::DVec3;

use super::operators::OpenParts;
use crate::context::{Cancelled, Context};
use crate::inspect::{Solid, solids};
use crate::math::winding_exact;
use crate::mesh::{Edges, Fans, Parts, Surface, boundary_loops};

/// Share of the area in open sheets from which on the whole model is one.
pub(super) const SHEET_SHARE: f64 = 0.9;

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

/// Mean winding number of an open part on its own faces from which on it is almost closed: half of what a closed one has.
const ALMOST_CLOSED: f64 = 0.25;
/// Faces of a part at which that is asked, at most and at least, ...
const ASKED: [usize; 2] = [8, 64];
/// ... and pairs of faces that a part may take.
const PAIRS: usize = 40_000_000;

/// Of each open part whether it is almost closed, by generalized winding numbers (Jacobson et al. 2013). Where its patches would be
/// those of an open sheet it is not: filling holes leaves it open, so that a thickness is all that it can get.
///
/// On a closed surface the number is 1/2, halfway from 0 outside to 1 inside, on a plane sheet it is 0. A half sphere has 0.33, a box
/// without its lid 0.4. Each part is asked alone, at faces spread evenly over its area. At most a constant number of sums over the
/// part's faces.
pub(super) fn almost_closed(
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

/// The mean winding number of some faces on themselves.
fn mean_winding(surface: &Surface, faces: &[u32]) -> f64 {
    let areas: Vec<f64> = faces.iter().map(|&f| surface.area_vector(f as usize).length()).collect();
    let total: f64 = areas.iter().sum();
    let count = (PAIRS / faces.len().max(1)).clamp(ASKED[0], ASKED[1]);
    if !(total > 0.0 && total.is_finite()) {
        return 0.0;
    }
    let (mut passed, mut asked, mut sum) = (0.0, 0, 0.0);
    for (&face, area) in faces.iter().zip(areas) {
        passed += area;
        // A large face stands for all of the equal shares of the area that end in it.
        let shares = ((passed / total * count as f64 + 0.5) as usize).min(count);
        if shares > asked {
            let [a, b, c] = surface.corners(face as usize);
            let others = faces.iter().filter(|&&other| other != face).map(|&other| surface.corners(other as usize));
            sum += winding_exact((a + b + c) / 3.0, others) * (shares - asked) as f64;
            asked = shares;
        }
    }
    if asked == 0 { 0.0 } else { sum / asked as f64 }
}
