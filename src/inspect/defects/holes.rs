use super::super::DefectKind;
use super::chains::chains;
use super::scan::Scan;
use crate::context::Cancelled;
use crate::mesh::Edges;

/// Finds the closed chains of boundary edges, as [`count_boundary_chains`](crate::mesh::count_boundary_chains) counts
/// them: edges belong together where they bound the same fan, whatever way the faces are turned. The line is the whole
/// chain, against the half-edges of the faces; the value is its length.
pub(super) fn find(scan: &mut Scan<'_, '_>) -> Result<(), Cancelled> {
    let analysis = scan.analysis;
    let faces = &analysis.surface.faces;
    let mut boundary: Vec<u32> = analysis.edges.iter().filter(|h| h.len() == 1).map(|h| h[0]).collect();
    boundary.sort_unstable();
    // Fans, not vertices, are the nodes: holes that touch in a vertex are different holes.
    let fan = |corner: u32| analysis.fans.of_corner[corner as usize];
    let edges: Vec<[u32; 2]> = boundary.iter().map(|&h| [fan(Edges::next(h)), fan(h)]).collect();
    for (number, hole) in chains(&edges, &[]).into_iter().enumerate() {
        scan.step(number)?;
        let vertices = hole.line.iter().map(|&fan| faces[fan as usize / 3][fan as usize % 3]);
        let line = scan.points(vertices.clone());
        let on_unit: Vec<_> = vertices.map(|v| scan.unit[v as usize]).collect();
        let length = on_unit.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
        let around = hole.edges.iter().map(|&e| boundary[e as usize] / 3);
        scan.put(DefectKind::Hole, line[0], around, &line, Some(scan.told(length)));
    }
    Ok(())
}
