//! Search for foldovers: surface folded back onto its neighbours.

use std::collections::VecDeque;

use super::super::options::ToleranceLengths;
use super::super::{Analysis, DefectKind};
use super::chains::chains;
use super::scan::{Location, Scan};
use crate::context::Cancelled;
use crate::math::{SharpFold, Sign, orient3d, threads};
use crate::mesh::{Edges, UnionFind};

/// Angles in radians below this may result from rounding alone.
const ROUNDING: f64 = 1e-6;

/// An edge whose two faces lie on each other.
struct Fold {
    ends: [u32; 2],
    faces: [u32; 2],
    height: f64,
}

/// Finds foldovers: regions that are bounded by folds only and face the opposite way from their surroundings.
///
/// ```text
///   ----------.          `.`: a fold. A, B and C are regions between folds. In each connected set, the largest
///     .--------'  B      region, A or C, has the correct side up, and so has every region that is an
///     '---------- C      even number of folds away. The other regions are foldovers.
/// ```
///
/// At a fold, the angle is within the angle tolerance, and the lower face is within the height tolerance of the other
/// face's plane. Flat faces and pairs with the same three vertices form no folds. Faces in `skip` are ignored.
/// Returns for each face whether it is in a foldover.
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
    let folded_roots = folded_over(scan, &folds, &mut sets);
    let mut faces_of: Vec<Vec<u32>> = vec![Vec::new(); folded_roots.len()];
    #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
    for f in 0..count as u32 {
        if let Ok(region) = folded_roots.binary_search(&sets.root(f)) {
            folded[f as usize] = true;
            faces_of[region].push(f);
        }
    }
    // Each fold has one folded side, except in a cycle of an odd number of regions.
    let mut around: Vec<(u32, u32)> = Vec::new();
    for (number, (_, fold)) in (0u32..).zip(&folds) {
        around.extend(fold.faces.map(|f| (sets.root(f), number)));
    }
    around.sort_unstable();
    for (root, faces) in folded_roots.iter().zip(faces_of) {
        scan.context().check()?;
        let begin = around.partition_point(|&(r, _)| r < *root);
        let border: Vec<&Fold> =
            around[begin..].iter().take_while(|&&(r, _)| r == *root).map(|&(_, n)| &folds[n as usize].1).collect();
        let ends: Vec<[u32; 2]> = border.iter().map(|fold| fold.ends).collect();
        let height = border.iter().map(|fold| fold.height).fold(0.0, f64::max);
        let line = chains(&ends, &[]).into_iter().map(|c| c.line).max_by_key(Vec::len).unwrap_or_default();
        let line = scan.points(line);
        let border_faces = border.iter().flat_map(|fold| fold.faces);
        let location = Location { at: scan.middle(faces[0]), line: &line };
        let faces = faces.iter().copied().chain(border_faces);
        scan.report(DefectKind::Foldover, location, faces, Some(scan.in_model_unit(height)));
    }
    Ok(folded)
}

/// The folds with their edge indices, in order of the edges.
fn find_folds(scan: &Scan<'_, '_>, flat: &[bool], skip: &[bool]) -> Result<Vec<(usize, Fold)>, Cancelled> {
    scan.context().check()?;
    let search = FoldSearch { analysis: scan.analysis, lengths: &scan.lengths, ignored: [flat, skip] };
    Ok(threads::filter_map(scan.analysis.edges.len(), |e| Some((e, search.fold_at(e)?))))
}

/// The search for folds, for several threads.
struct FoldSearch<'a, 'm> {
    analysis: &'a Analysis<'m>,
    lengths: &'a ToleranceLengths,
    /// Marks of faces that form no folds.
    ignored: [&'a [bool]; 2],
}

impl FoldSearch<'_, '_> {
    /// The fold at an edge, if there is one.
    fn fold_at(&self, edge: usize) -> Option<Fold> {
        let (faces, unit) = (&self.analysis.surface.faces, self.analysis.unit());
        let &[x, y] = self.analysis.edges.half_edges(edge) else { return None };
        let sides = [x / 3, y / 3];
        if Edges::is_forward(faces, x) == Edges::is_forward(faces, y)
            || sides.iter().any(|&f| self.ignored.iter().any(|ignored| ignored[f as usize]))
        {
            return None;
        }
        let ends = self.analysis.edges.vertices(edge);
        let apex = |h: u32| faces[h as usize / 3][(h as usize % 3 + 2) % 3];
        if apex(x) == apex(y) {
            return None;
        }
        let [a, b] = ends.map(|v| unit[v as usize]);
        let [apex_x, apex_y] = [x, y].map(|h| unit[apex(h) as usize]);
        let fold = SharpFold::of([a, b], [apex_x, apex_y])?;
        // An exact predicate decides a fold of height 0, so that a tolerance of 0 finds it and rounding adds no
        // height.
        let in_plane = fold.angle <= ROUNDING && orient3d(a, b, apex_x, apex_y) == Sign::Zero;
        let angle = if in_plane { 0.0 } else { fold.angle };
        let height = fold.height(angle);
        let is_fold = angle <= self.lengths.foldover_angle && height <= self.lengths.foldover_height;
        is_fold.then_some(Fold { ends, faces: sides, height })
    }
}

/// Regions at an odd number of folds from the largest region connected with them, given as set roots in ascending
/// order.
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
