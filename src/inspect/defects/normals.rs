use glam::DVec3;

use super::super::DefectKind;
use super::scan::Scan;
use crate::context::Cancelled;
use crate::mesh::CornerNormals;

/// Cosine of the angle from which on a normal is opposed to that of a face: a little over a right angle, since files
/// round normals.
const OPPOSED: f64 = -0.01;

/// Finds vertices of which a normal of the file points into the mesh: opposed to the normals of all faces whose corners
/// there have it. A vertex with one normal is bad where that is opposed to all faces around it; one with several, where
/// one of them is bad for its faces. The value is the largest angle between a bad normal and its faces'.
///
/// Flat faces have no normal, and normals of no length are none.
pub(super) fn find(scan: &mut Scan<'_, '_>, flat: &[bool]) -> Result<(), Cancelled> {
    let Some(normals) = scan.analysis.subject.normals else { return Ok(()) };
    let mut bad = match normals {
        CornerNormals::OfFaces { opposed } => of_faces(scan, opposed, flat)?,
        _ => of_corners(scan, normals, flat)?,
    };
    bad.sort_by_key(|bad| (bad.vertex, bad.face));
    for (number, of_vertex) in bad.chunk_by(|x, y| x.vertex == y.vertex).enumerate() {
        scan.step(number)?;
        let at = scan.points([of_vertex[0].vertex])[0];
        let cosine = of_vertex.iter().map(|bad| bad.cosine).fold(1.0, f64::min);
        let faces = of_vertex.iter().map(|bad| bad.face);
        scan.put(DefectKind::BadVertexNormal, at, faces, &[], Some(cosine.max(-1.0).acos()));
    }
    Ok(())
}

/// A corner with a bad normal.
struct Bad {
    vertex: u32,
    face: u32,
    cosine: f64,
}

/// Cosine of the angle between a normal of the file and that of a face; none where there is no angle.
fn cosine(scan: &Scan<'_, '_>, face: u32, normal: [f32; 3]) -> Option<f64> {
    let of_file = DVec3::from_array(normal.map(f64::from)).try_normalize()?;
    Some(of_file.dot(scan.area_vector(face).try_normalize()?))
}

fn of_faces(scan: &Scan<'_, '_>, opposed: &[(u32, [f32; 3])], flat: &[bool]) -> Result<Vec<Bad>, Cancelled> {
    let surface = &scan.analysis.surface;
    let mut bad = Vec::new();
    for (number, &(source, normal)) in opposed.iter().enumerate() {
        scan.step(number)?;
        let Ok(f) = surface.source.binary_search(&source) else { continue };
        #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
        let face = f as u32;
        if let Some(cosine) = cosine(scan, face, normal).filter(|&c| c < OPPOSED && !flat[f]) {
            bad.extend(surface.faces[f].map(|vertex| Bad { vertex, face, cosine }));
        }
    }
    Ok(bad)
}

fn of_corners(scan: &Scan<'_, '_>, normals: &CornerNormals, flat: &[bool]) -> Result<Vec<Bad>, Cancelled> {
    let (surface, soup) = (&scan.analysis.surface, scan.analysis.subject.soup);
    let count = u32::try_from(surface.faces.len()).unwrap_or(u32::MAX);
    let corners = |f: u32| {
        let source = surface.source[f as usize] as usize;
        (0..3).filter_map(move |k| {
            let normal = normals.at(source, soup.faces[source], k)?;
            let cosine = cosine(scan, f, normal)?;
            Some((surface.faces[f as usize][k], normal.map(|x| (x + 0.0).to_bits()), f, cosine))
        })
    };
    // Nearly always no corner at all is opposed to its own face, and nothing need be sorted.
    let mut suspect = vec![false; surface.positions.len()];
    for f in 0..count {
        scan.step(f as usize)?;
        if !flat[f as usize] {
            for (vertex, _, _, _) in corners(f).filter(|&(_, _, _, cosine)| cosine < OPPOSED) {
                suspect[vertex as usize] = true;
            }
        }
    }
    let mut at_suspects: Vec<(u32, [u32; 3], u32, f64)> = Vec::new();
    for f in 0..count {
        scan.step(f as usize)?;
        if !flat[f as usize] && surface.faces[f as usize].iter().any(|&v| suspect[v as usize]) {
            at_suspects.extend(corners(f).filter(|&(vertex, _, _, _)| suspect[vertex as usize]));
        }
    }
    at_suspects.sort_by_key(|&(vertex, normal, face, _)| (vertex, normal, face));
    let same = |x: &(u32, [u32; 3], u32, f64), y: &(u32, [u32; 3], u32, f64)| (x.0, x.1) == (y.0, y.1);
    let all_opposed =
        at_suspects.chunk_by(same).filter(|shared| shared.iter().all(|&(_, _, _, cosine)| cosine < OPPOSED));
    Ok(all_opposed.flatten().map(|&(vertex, _, face, cosine)| Bad { vertex, face, cosine }).collect())
}
