use super::super::{DefectKind, group_faces};
use super::scan::Scan;
use crate::context::Cancelled;

/// Faces with the same three vertices: of each group, those turned as most of them are beyond the first are
/// duplicates, and those turned the other way are opposite faces. Answers the faces that have an opposite one, each with
/// one of its opposites.
pub(super) fn find(scan: &mut Scan<'_, '_>) -> Result<Vec<(u32, u32)>, Cancelled> {
    let faces = &scan.analysis.surface.faces;
    let mut opposed = Vec::new();
    for (number, group) in group_faces(faces).iter().enumerate() {
        scan.step(number)?;
        if group.len() < 2 {
            continue;
        }
        let (mut one, mut other): (Vec<u32>, Vec<u32>) = group.iter().partition(|&&f| rises(faces[f as usize]));
        if (one.len(), other.first()) < (other.len(), one.first()) {
            std::mem::swap(&mut one, &mut other);
        }
        let first = one[0];
        for &f in &one[1..] {
            scan.put(DefectKind::DuplicateFace, scan.middle(f), [first, f], &[], None);
        }
        for &f in &other {
            scan.put(DefectKind::OppositeFace, scan.middle(f), [first, f], &[], None);
        }
        if let Some(&facing) = other.first() {
            opposed.extend(one.iter().map(|&f| (f, facing)));
            opposed.extend(other.iter().map(|&f| (f, first)));
        }
    }
    Ok(opposed)
}

/// Whether the corners, from the smallest on, rise before they fall: which of the two ways a face of these vertices is
/// turned. One with a repeated vertex has only one way.
fn rises([a, b, c]: [u32; 3]) -> bool {
    a == b || b == c || c == a || (a < b && b < c) || (b < c && c < a) || (c < a && a < b)
}
