use super::super::DefectKind;
use super::scan::Scan;
use crate::context::Cancelled;
use crate::mesh::Edges;

/// Edges of more than two faces, and edges along which two faces run in the same direction.
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
        scan.put(kind, a * 0.5 + b * 0.5, half_edges.iter().map(|h| h / 3), &[a, b], value);
    }
    Ok(())
}

/// Vertices whose faces form more than one fan; the value is how many.
pub(super) fn find_vertices(scan: &mut Scan<'_, '_>) -> Result<(), Cancelled> {
    let analysis = scan.analysis;
    if analysis.fans.nonmanifold_vertices == 0 {
        return Ok(());
    }
    let faces = &analysis.surface.faces;
    let fan_of = |corner: u32| analysis.fans.of_corner[corner as usize];
    let vertex_of = |corner: u32| faces[corner as usize / 3][corner as usize % 3];
    let corners = || (0u32..).zip(faces.iter().flatten()).filter(|&(corner, _)| fan_of(corner) != u32::MAX);
    let mut fans = vec![0u32; analysis.surface.positions.len()];
    for (corner, &v) in corners() {
        fans[v as usize] += u32::from(fan_of(corner) == corner);
    }
    let mut around: Vec<(u32, u32)> =
        corners().filter(|&(_, &v)| fans[v as usize] > 1).map(|(corner, _)| (vertex_of(corner), corner)).collect();
    around.sort_unstable();
    for (number, of_vertex) in around.chunk_by(|x, y| x.0 == y.0).enumerate() {
        scan.step(number)?;
        let v = of_vertex[0].0;
        let at = analysis.surface.positions[v as usize];
        let faces = of_vertex.iter().map(|&(_, corner)| corner / 3);
        scan.put(DefectKind::NonManifoldVertex, at, faces, &[], Some(f64::from(fans[v as usize])));
    }
    Ok(())
}
