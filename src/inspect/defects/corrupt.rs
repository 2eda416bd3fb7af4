use glam::DVec3;

use super::super::DefectKind;
use super::scan::Scan;
use crate::context::Cancelled;

/// Faces of the file with a corner that is not finite or has no vertex; those that the reader could not take are told with the place of
/// their other corners.
pub(super) fn find(scan: &mut Scan<'_, '_>) -> Result<(), Cancelled> {
    let subject = scan.analysis.subject;
    if scan.analysis.ingest.nonfinite_faces > 0 {
        for (face, index) in subject.soup.faces.iter().zip(0u32..) {
            scan.step(index as usize)?;
            let corners = face.map(|v| subject.soup.positions.get(v as usize).copied().filter(|p| p.is_finite()));
            if corners.contains(&None) {
                let at = corners.into_iter().flatten().next().unwrap_or(DVec3::ZERO);
                scan.put_as_read(DefectKind::Corrupt, at, vec![index], &[], None);
            }
        }
    }
    let Some(numbering) = subject.numbering else { return Ok(()) };
    for face in &numbering.left_out {
        scan.put_as_read(DefectKind::Corrupt, DVec3::from_array(face.at), Vec::new(), &[], None);
    }
    scan.count_more(
        DefectKind::Corrupt,
        numbering.faces_without_vertex.saturating_sub(numbering.left_out.len() as u64),
    );
    Ok(())
}
