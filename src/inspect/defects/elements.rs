//! Searches for defects of single faces, edges and vertices, and for holes.

use glam::DVec3;

use super::super::{Analysis, DefectKind, group_faces};
use super::chains::chains;
use super::scan::{Location, ROUNDING, Scan};
use crate::context::Cancelled;
use crate::math::{collinear, threads};
use crate::mesh::{CornerNormals, Edges};

/// Cosine of the angle from which a normal opposes a face. Slightly more than a right angle, since files round
/// normals.
const OPPOSED: f64 = -0.01;

/// Finds faces of the file with a corner that is not finite or names a missing vertex. The place of a face that the
/// reader rejected is one of the face's other corners.
pub(super) fn find_corrupt(scan: &mut Scan<'_, '_>) -> Result<(), Cancelled> {
    let analysis = scan.analysis;
    if analysis.ingest.non_finite_faces > 0 {
        let positions = analysis.file_positions();
        for (face, index) in analysis.file_faces().iter().zip(0u32..) {
            scan.step(index as usize)?;
            let corners = face.map(|v| positions.get(v as usize).copied().filter(|p| p.is_finite()));
            if corners.contains(&None) {
                let at = corners.into_iter().flatten().next().unwrap_or(DVec3::ZERO);
                scan.report_in_file(DefectKind::Corrupt, at, vec![index], None);
            }
        }
    }
    let Some(numbering) = analysis.facts.numbering else { return Ok(()) };
    for face in &numbering.omitted {
        scan.report_in_file(DefectKind::Corrupt, DVec3::from_array(face.at), Vec::new(), None);
    }
    scan.count_more(DefectKind::Corrupt, numbering.faces_without_vertex.saturating_sub(numbering.omitted.len() as u64));
    Ok(())
}

/// Finds flat faces, with a height below the tolerance, and degenerate faces, with an edge below the tolerance. Every
/// degenerate face is also flat. Returns for each face whether it is flat.
///
/// Exact predicates decide whether a height or length is 0, whatever the tolerance; only then the value is 0.
pub(super) fn find_flat(scan: &mut Scan<'_, '_>) -> Result<Vec<bool>, Cancelled> {
    scan.context().check()?;
    let (analysis, tolerance) = (scan.analysis, scan.lengths.degenerate);
    let faces = &analysis.surface.faces;
    let thin = threads::filter_map(faces.len(), |face| Some((face, ThinFace::of(analysis, face, tolerance)?)));
    let mut flat = vec![false; faces.len()];
    for (face, ThinFace { edge, height }) in thin {
        #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
        let f = face as u32;
        let value = |length: f64| if length == 0.0 { 0.0 } else { scan.in_model_unit_above_zero(length) };
        let (edge, height) = (edge.map(value), height.map(value));
        if edge.is_some() {
            scan.report(DefectKind::DegenerateFace, scan.middle(f), [f], edge);
        }
        if height.is_some() {
            flat[face] = true;
            scan.report(DefectKind::FlatFace, scan.middle(f), [f], height);
        }
    }
    Ok(flat)
}

/// A face with an edge or a height below the tolerance. Lengths are on the unit scale, and 0 only if exact predicates
/// decide so.
struct ThinFace {
    /// The shortest edge, if it is below the tolerance.
    edge: Option<f64>,
    /// The height, if it is below the tolerance.
    height: Option<f64>,
}

impl ThinFace {
    fn of(analysis: &Analysis<'_>, face: usize, tolerance: f64) -> Option<Self> {
        let [u, v, w] = analysis.surface.faces[face];
        let [a, b, c] = [u, v, w].map(|v| analysis.unit()[v as usize]);
        let sides = [(a, b), (b, c), (c, a)].map(|(p, q)| p.distance_squared(q));
        let longest = sides.into_iter().fold(0.0, f64::max).sqrt();
        let shortest = sides.into_iter().fold(f64::INFINITY, f64::min).sqrt();
        let height = if longest > 0.0 { (b - a).cross(c - a).length() / longest } else { 0.0 };
        // Vertices have distinct positions, so only a repeated vertex makes an edge of zero length.
        let repeated = u == v || v == w || w == u;
        let on_line = repeated || (height <= ROUNDING && collinear(a, b, c));
        let exact = |is_zero: bool, length: f64| if is_zero { 0.0 } else { length.max(f64::MIN_POSITIVE) };
        let found = Self {
            edge: (repeated || shortest < tolerance).then(|| exact(repeated, shortest)),
            height: (on_line || height < tolerance).then(|| exact(on_line, height)),
        };
        (found.edge.is_some() || found.height.is_some()).then_some(found)
    }
}

/// Finds faces with the same three vertices. In each group, faces with the majority's winding, other than the first,
/// are duplicates; faces with the other winding are opposite faces. Returns pairs of a face and one of its opposites.
pub(super) fn find_duplicates(scan: &mut Scan<'_, '_>) -> Result<Vec<(u32, u32)>, Cancelled> {
    let faces = &scan.analysis.surface.faces;
    let mut opposed = Vec::new();
    for (number, group) in group_faces(faces).iter().enumerate() {
        scan.step(number)?;
        if group.len() < 2 {
            continue;
        }
        let (mut one, mut other): (Vec<u32>, Vec<u32>) = group.iter().partition(|&&f| is_ascending(faces[f as usize]));
        if (one.len(), other.first()) < (other.len(), one.first()) {
            std::mem::swap(&mut one, &mut other);
        }
        let first = one[0];
        for &f in &one[1..] {
            scan.report(DefectKind::DuplicateFace, scan.middle(f), [first, f], None);
        }
        for &f in &other {
            scan.report(DefectKind::OppositeFace, scan.middle(f), [first, f], None);
        }
        if let Some(&facing) = other.first() {
            opposed.extend(one.iter().map(|&f| (f, facing)));
            opposed.extend(other.iter().map(|&f| (f, first)));
        }
    }
    Ok(opposed)
}

/// Whether the corners ascend from the smallest one, which distinguishes the two windings of a face. Always true for
/// a face with a repeated vertex.
fn is_ascending([a, b, c]: [u32; 3]) -> bool {
    a == b || b == c || c == a || (a < b && b < c) || (b < c && c < a) || (c < a && a < b)
}

/// Finds edges with more than two faces, and edges whose two faces have opposite winding.
pub(super) fn find_edges(scan: &mut Scan<'_, '_>) -> Result<(), Cancelled> {
    let analysis = scan.analysis;
    let faces = &analysis.surface.faces;
    for (e, half_edges) in analysis.edges.iter().enumerate() {
        scan.step(e)?;
        let (kind, value) = match *half_edges {
            [_] => continue,
            [x, y] if Edges::is_forward(faces, x) != Edges::is_forward(faces, y) => continue,
            [_, _] => (DefectKind::MisorientedEdge, None),
            #[expect(clippy::cast_precision_loss, reason = "faces are counted in u32")]
            _ => (DefectKind::NonManifoldEdge, Some(half_edges.len() as f64)),
        };
        let [a, b] = analysis.edges.vertices(e).map(|v| analysis.surface.positions[v as usize]);
        let location = Location { at: a * 0.5 + b * 0.5, line: &[a, b] };
        scan.report(kind, location, half_edges.iter().map(|h| h / 3), value);
    }
    Ok(())
}

/// Finds vertices whose faces form more than one fan; the value is the number of fans.
pub(super) fn find_vertices(scan: &mut Scan<'_, '_>) -> Result<(), Cancelled> {
    let analysis = scan.analysis;
    if analysis.fans.non_manifold_vertices == 0 {
        return Ok(());
    }
    let faces = &analysis.surface.faces;
    let fans = analysis.fans.at_vertices(&analysis.surface);
    let corners = (0u32..).zip(faces.iter().flatten()).filter(|&(_, &v)| fans[v as usize] > 1);
    let in_fans = corners.filter(|&(corner, _)| analysis.fans.of_corner(faces, corner).is_some());
    let mut around: Vec<(u32, u32)> = in_fans.map(|(corner, &v)| (v, corner)).collect();
    around.sort_unstable();
    for (number, of_vertex) in around.chunk_by(|x, y| x.0 == y.0).enumerate() {
        scan.step(number)?;
        let v = of_vertex[0].0;
        let at = analysis.surface.positions[v as usize];
        let faces = of_vertex.iter().map(|&(_, corner)| corner / 3);
        scan.report(DefectKind::NonManifoldVertex, at, faces, Some(f64::from(fans[v as usize])));
    }
    Ok(())
}

/// Finds closed chains of boundary edges, as [`count_boundary_chains`](crate::mesh::count_boundary_chains) counts
/// them. Edges are connected if they bound the same fan, whatever the faces' winding. The line is the whole chain,
/// opposite to the faces' half-edges; the value is its length.
pub(super) fn find_holes(scan: &mut Scan<'_, '_>) -> Result<(), Cancelled> {
    let analysis = scan.analysis;
    let faces = &analysis.surface.faces;
    let mut boundary: Vec<u32> = analysis.edges.iter().filter(|h| h.len() == 1).map(|h| h[0]).collect();
    boundary.sort_unstable();
    // Nodes are fans rather than vertices, so that holes touching in a vertex stay separate.
    // Faces with edges have no repeated vertex, so their corners are in fans.
    let fan = |corner: u32| analysis.fans.of_corner(faces, corner).unwrap_or(corner);
    let edges: Vec<[u32; 2]> = boundary.iter().map(|&h| [fan(Edges::next(h)), fan(h)]).collect();
    for (number, hole) in chains(&edges, &[]).into_iter().enumerate() {
        scan.step(number)?;
        let vertices = hole.line.iter().map(|&fan| faces[fan as usize / 3][fan as usize % 3]);
        let line = scan.points(vertices.clone());
        let on_unit: Vec<_> = vertices.map(|v| scan.unit[v as usize]).collect();
        let length = on_unit.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
        let around = hole.edges.iter().map(|&e| boundary[e as usize] / 3);
        scan.report(DefectKind::Hole, Location { at: line[0], line: &line }, around, Some(scan.in_model_unit(length)));
    }
    Ok(())
}

/// Finds vertices with a stored normal that points into the mesh, opposed to the normals of all faces that use the
/// normal at this vertex. The value is the largest angle between such a normal and its faces' normals.
///
/// Ignores flat faces, which have no normal, and stored normals of zero length.
pub(super) fn find_bad_normals(scan: &mut Scan<'_, '_>, flat: &[bool]) -> Result<(), Cancelled> {
    let Some(normals) = scan.analysis.facts.normals else { return Ok(()) };
    let mut bad = match normals {
        CornerNormals::OfFaces { opposed } => bad_face_normals(scan, opposed, flat)?,
        _ => bad_corner_normals(scan, normals, flat)?,
    };
    bad.sort_by_key(|bad| (bad.vertex, bad.face));
    for (number, of_vertex) in bad.chunk_by(|x, y| x.vertex == y.vertex).enumerate() {
        scan.step(number)?;
        let at = scan.points([of_vertex[0].vertex])[0];
        let cosine = of_vertex.iter().map(|bad| bad.cosine).fold(1.0, f64::min);
        let faces = of_vertex.iter().map(|bad| bad.face);
        scan.report(DefectKind::BadVertexNormal, at, faces, Some(cosine.max(-1.0).acos()));
    }
    Ok(())
}

/// A corner of a face with a bad normal.
struct BadNormal {
    vertex: u32,
    face: u32,
    cosine: f64,
}

/// Cosine of the angle between a stored normal and a face's normal; `None` if one of them has no direction.
fn cosine(scan: &Scan<'_, '_>, face: u32, normal: [f32; 3]) -> Option<f64> {
    let of_file = DVec3::from_array(normal.map(f64::from)).try_normalize()?;
    Some(of_file.dot(scan.analysis.unit_area_vector(face).try_normalize()?))
}

fn bad_face_normals(
    scan: &Scan<'_, '_>,
    opposed: &[(u32, [f32; 3])],
    flat: &[bool],
) -> Result<Vec<BadNormal>, Cancelled> {
    let surface = &scan.analysis.surface;
    let mut bad = Vec::new();
    for (number, &(source, normal)) in opposed.iter().enumerate() {
        scan.step(number)?;
        let Ok(f) = surface.source.binary_search(&source) else { continue };
        #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
        let face = f as u32;
        if let Some(cosine) = cosine(scan, face, normal).filter(|&c| c < OPPOSED && !flat[f]) {
            bad.extend(surface.faces[f].map(|vertex| BadNormal { vertex, face, cosine }));
        }
    }
    Ok(bad)
}

fn bad_corner_normals(
    scan: &Scan<'_, '_>,
    normals: &CornerNormals,
    flat: &[bool],
) -> Result<Vec<BadNormal>, Cancelled> {
    let (surface, file_faces) = (&scan.analysis.surface, scan.analysis.file_faces());
    let count = u32::try_from(surface.faces.len()).unwrap_or(u32::MAX);
    let corners = |f: u32| {
        let source = surface.source[f as usize] as usize;
        (0..3).filter_map(move |k| {
            let normal = normals.at(source, file_faces[source], k)?;
            let cosine = cosine(scan, f, normal)?;
            Some((surface.faces[f as usize][k], normal.map(|x| (x + 0.0).to_bits()), f, cosine))
        })
    };
    // Most files have no corner with an opposed normal; then nothing needs sorting.
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
    Ok(all_opposed.flatten().map(|&(vertex, _, face, cosine)| BadNormal { vertex, face, cosine }).collect())
}
