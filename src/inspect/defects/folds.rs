//! Surface that is folded back on its neighbours.

use std::collections::VecDeque;

use super::super::DefectKind;
use super::chains::chains;
use super::scan::{Location, Scan};
use crate::context::Cancelled;
use crate::math::{Sign, orient3d};
use crate::mesh::{Edges, UnionFind};

/// Angles below this may be rounding alone.
const ROUNDING: f64 = 1e-6;

/// An edge whose two faces lie on one another.
struct Fold {
    ends: [u32; 2],
    faces: [u32; 2],
    height: f64,
}

/// Finds foldovers: regions bounded by folds alone, with the surface around turned the other way.
///
/// ```text
///        A
///   ----------.          `.`: a fold. A, B and C are regions between folds; the largest of those that
///     .--------'  B      hang together, A or C, is taken to be the right way up, and so is every region
///     '---------- C      an even number of folds away. The others are foldovers.
/// ```
///
/// A fold has an angle up to the tolerance, and of its two faces the lower stands off from the plane of the other by no
/// more than the height tolerance. Flat faces have no angle and make no fold, nor do faces of the same three vertices.
/// `skip` says of which faces folds are not looked at. Answers which faces are in foldovers.
pub(super) fn find(scan: &mut Scan<'_, '_>, flat: &[bool], skip: &[bool]) -> Result<Vec<bool>, Cancelled> {
    let count = scan.analysis.surface.faces.len();
    let mut folded = vec![false; count];
    let folds = find_folds(scan, flat, skip)?;
    if folds.is_empty() {
        return Ok(folded);
    }
    let mut sets = UnionFind::new(count);
    let mut next = 0;
    for (e, half_edges) in scan.analysis.edges.iter().enumerate() {
        if folds.get(next).is_some_and(|&(edge, _)| edge == e) {
            next += 1;
            continue;
        }
        for pair in half_edges.windows(2) {
            sets.unite(pair[0] / 3, pair[1] / 3);
        }
    }
    scan.context().check()?;
    let over = folded_over(scan, &folds, &mut sets);
    let mut faces_of: Vec<Vec<u32>> = vec![Vec::new(); over.len()];
    #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
    for f in 0..count as u32 {
        if let Ok(region) = over.binary_search(&sets.root(f)) {
            folded[f as usize] = true;
            faces_of[region].push(f);
        }
    }
    // Each fold has one folded side, but in a chain of regions that closes in an odd number.
    let mut around: Vec<(u32, u32)> = Vec::new();
    for (number, (_, fold)) in (0u32..).zip(&folds) {
        around.extend(fold.faces.map(|f| (sets.root(f), number)));
    }
    around.sort_unstable();
    for (root, faces) in over.iter().zip(faces_of) {
        scan.context().check()?;
        let begin = around.partition_point(|&(r, _)| r < *root);
        let border: Vec<&Fold> =
            around[begin..].iter().take_while(|&&(r, _)| r == *root).map(|&(_, n)| &folds[n as usize].1).collect();
        let ends: Vec<[u32; 2]> = border.iter().map(|fold| fold.ends).collect();
        let height = border.iter().map(|fold| fold.height).fold(0.0, f64::max);
        let line = chains(&ends, &[]).into_iter().map(|c| c.line).max_by_key(Vec::len).unwrap_or_default();
        let line = scan.points(line);
        let beside = border.iter().flat_map(|fold| fold.faces);
        let location = Location { at: scan.middle(faces[0]), line: &line };
        let faces = faces.iter().copied().chain(beside);
        scan.put(DefectKind::Foldover, location, faces, Some(scan.in_model_unit(height)));
    }
    Ok(folded)
}

/// The folds, each with its edge, in order of the edges.
fn find_folds(scan: &Scan<'_, '_>, flat: &[bool], skip: &[bool]) -> Result<Vec<(usize, Fold)>, Cancelled> {
    let (faces, unit) = (&scan.analysis.surface.faces, scan.unit);
    let mut folds = Vec::new();
    for (e, half_edges) in scan.analysis.edges.iter().enumerate() {
        scan.step(e)?;
        let &[x, y] = half_edges else { continue };
        let sides = [x / 3, y / 3];
        if Edges::is_forward(faces, x) == Edges::is_forward(faces, y)
            || sides.iter().any(|&f| flat[f as usize] || skip[f as usize])
        {
            continue;
        }
        let ends = scan.analysis.edges.vertices(e);
        let apex = |h: u32| faces[h as usize / 3][(h as usize % 3 + 2) % 3];
        if apex(x) == apex(y) {
            continue;
        }
        let [a, b] = ends.map(|v| unit[v as usize]);
        let along = (b - a).normalize_or_zero();
        // From the edge to the corner beyond, at right angles to the edge.
        let [p, q] = [x, y].map(|h| {
            let to = unit[apex(h) as usize] - a;
            to - along * to.dot(along)
        });
        if p.dot(q) <= 0.0 {
            continue;
        }
        let measured = p.cross(q).length().atan2(p.dot(q));
        // A fold of no height is decided exactly, so that a tolerance of 0 finds it and rounding gives it no height.
        let [apex_x, apex_y] = [x, y].map(|h| unit[apex(h) as usize]);
        let in_plane = measured <= ROUNDING && orient3d(a, b, apex_x, apex_y) == Sign::Zero;
        let angle = if in_plane { 0.0 } else { measured };
        let height = p.length().min(q.length()) * angle.sin();
        if angle <= scan.lengths.foldover_angle && height <= scan.lengths.foldover_height {
            folds.push((e, Fold { ends, faces: sides, height }));
        }
    }
    Ok(folds)
}

/// The regions, by the roots of their sets, that are an odd number of folds away from the largest that they hang
/// together with; ascending.
fn folded_over(scan: &Scan<'_, '_>, folds: &[(usize, Fold)], sets: &mut UnionFind) -> Vec<u32> {
    let mut pairs: Vec<[u32; 2]> = Vec::new();
    for (_, fold) in folds {
        let [a, b] = fold.faces.map(|f| sets.root(f));
        if a != b {
            pairs.extend([[a, b], [b, a]]);
        }
    }
    pairs.sort_unstable();
    pairs.dedup();
    let mut roots: Vec<u32> = pairs.iter().map(|pair| pair[0]).collect();
    roots.dedup();
    let mut area = vec![0.0f64; roots.len()];
    #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
    for f in 0..scan.analysis.surface.faces.len() as u32 {
        if let Ok(region) = roots.binary_search(&sets.root(f)) {
            area[region] += scan.analysis.unit_area_vector(f).length();
        }
    }
    let mut by_area: Vec<usize> = (0..roots.len()).collect();
    by_area.sort_by(|&i, &j| area[j].total_cmp(&area[i]).then(i.cmp(&j)));
    let mut distance = vec![u32::MAX; roots.len()];
    for start in by_area {
        if distance[start] != u32::MAX {
            continue;
        }
        distance[start] = 0;
        let mut queue = VecDeque::from([start]);
        while let Some(at) = queue.pop_front() {
            let begin = pairs.partition_point(|pair| pair[0] < roots[at]);
            for pair in pairs[begin..].iter().take_while(|pair| pair[0] == roots[at]) {
                let other = roots.partition_point(|&r| r < pair[1]);
                if distance[other] == u32::MAX {
                    distance[other] = distance[at] + 1;
                    queue.push_back(other);
                }
            }
        }
    }
    (0..roots.len()).filter(|&region| distance[region] % 2 == 1).map(|region| roots[region]).collect()
}
