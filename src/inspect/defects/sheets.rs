//! Search for sheets: zero-thickness surface whose two sides coincide.

use glam::DVec3;

use super::super::{Analysis, DefectKind, Level};
use super::parts::report_parts;
use super::scan::{ROUNDING, Scan};
use crate::context::Cancelled;
use crate::math::threads::{self, FEW_SEARCHES};
use crate::math::{Sign, Tree, orient3d, within};
use crate::mesh::{Parts, UnionFind};

/// Cosine of the angle between the normals of a sheet's two sides: one degree from opposite.
const OPPOSITE: f64 = -0.999_847_695;
/// Minimum and maximum number of neighbours examined around one face, depending on the remaining budget.
const MIN_NEIGHBOURS: u64 = 32;
const MAX_NEIGHBOURS: u64 = 4096;
/// Budget of all searches: neighbours per face, plus a fixed allowance.
const BUDGET_PER_FACE: u64 = 64;
const BUDGET: u64 = 4_000_000;
/// Number of faces between two cancellation checks.
const BATCH: usize = 1 << 12;

/// Results of earlier searches.
pub(super) struct EarlierResults<'a> {
    /// Pairs of a face and an opposite face with the same vertices.
    pub opposed: &'a [(u32, u32)],
    /// For each face, whether it is flat.
    pub flat: &'a [bool],
    /// For each part its thickness, if it is a zero-thickness part.
    pub thin: &'a [Option<f64>],
    /// For each face, whether it is in a foldover.
    pub folded: &'a [bool],
}

/// Finds zero-thickness parts, and in the other parts zero-thickness regions: faces that lie on faces with opposite
/// normals. Two faces form a pair if they have the same vertices. At level `full`, they also form a pair if the
/// centre of one lies within the tolerance of the other.
///
/// Also finds the touching surfaces of two solids, since the space between has no thickness.
pub(super) fn find(scan: &mut Scan<'_, '_>, level: Level, known: &EarlierResults<'_>) -> Result<(), Cancelled> {
    let parts = &scan.analysis.parts;
    let skip: Vec<bool> = (0..known.flat.len())
        .map(|f| {
            let part = parts.of_face[f];
            part == Parts::NONE || known.flat[f] || known.folded[f] || known.thin[part as usize].is_some()
        })
        .collect();
    let mut pairs: Vec<(u32, u32, f64)> =
        known.opposed.iter().filter(|&&(f, _)| !skip[f as usize]).map(|&(f, g)| (f, g, 0.0)).collect();
    if level >= Level::Full {
        let mut doubled = skip.clone();
        for &(f, _) in known.opposed {
            doubled[f as usize] = true;
        }
        search(scan, &skip, &doubled, &mut pairs)?;
    }
    report_parts(scan, known.thin);
    report_regions(scan, &pairs)
}

/// Searches a partner for every face that is not in `known`.
fn search(
    scan: &mut Scan<'_, '_>,
    skip: &[bool],
    known: &[bool],
    pairs: &mut Vec<(u32, u32, f64)>,
) -> Result<(), Cancelled> {
    let analysis = scan.analysis;
    let (tree, tolerance) = (analysis.tree(), scan.lengths.sheet.max(ROUNDING));
    let search = SheetSearch { analysis, tree, skip, tolerance };
    let normal = |face: u32| if skip[face as usize] { DVec3::ZERO } else { analysis.unit_normal(face) };
    let may_have_partner = tree.opposite_faces(-OPPOSITE, normal).may_be_near(tolerance, known.len());
    let remaining: Vec<u32> = (0u32..)
        .zip(known.iter().zip(may_have_partner))
        .filter(|&(_, (&known, may_have_partner))| !known && may_have_partner)
        .map(|(f, _)| f)
        .collect();
    let mut gave_up = false;
    // The budget is distributed batch by batch, so that the result does not depend on the number of threads.
    let mut budget = BUDGET + BUDGET_PER_FACE * remaining.len() as u64;
    for batch in remaining.chunks(BATCH) {
        scan.context().check()?;
        let most = (budget / batch.len() as u64).clamp(MIN_NEIGHBOURS, MAX_NEIGHBOURS);
        let partners: Vec<(Partner, u64)> = threads::map(batch.len(), FEW_SEARCHES, |i| search.partner(batch[i], most));
        for (&f, (partner, examined)) in batch.iter().zip(partners) {
            budget = budget.saturating_sub(examined);
            match partner {
                Partner::None => {}
                Partner::Face(g, gap) => pairs.push((f, g, gap)),
                Partner::GaveUp => gave_up = true,
            }
        }
    }
    if gave_up {
        scan.mark_incomplete(DefectKind::Sheet);
    }
    Ok(())
}

struct SheetSearch<'a> {
    analysis: &'a Analysis<'a>,
    /// Built before the threads start.
    tree: &'a Tree,
    skip: &'a [bool],
    tolerance: f64,
}

enum Partner {
    None,
    /// The partner face and its distance.
    Face(u32, f64),
    /// The face has more neighbours than the budget allows.
    GaveUp,
}

impl SheetSearch<'_> {
    /// Searches a face with opposite normal on which the centre of face `f` lies, among the first `most` neighbours.
    /// Also returns the number of neighbours examined.
    fn partner(&self, f: u32, most: u64) -> (Partner, u64) {
        let (normal, centre) = (self.analysis.unit_normal(f), self.analysis.unit_centre(f));
        let (mut partner, mut examined) = (Partner::None, 0);
        self.tree.around(centre, self.tolerance, |g| {
            if examined == most {
                partner = Partner::GaveUp;
                return false;
            }
            examined += 1;
            let corners @ [p, q, r] = self.analysis.unit_corners(g);
            let other = (q - p).cross(r - p);
            if g == f || self.skip[g as usize] || normal.dot(other) >= 0.0 {
                return true;
            }
            let other = other.normalize_or_zero();
            if normal.dot(other) > OPPOSITE || !within(centre, corners, self.tolerance) {
                return true;
            }
            let in_plane = self.analysis.unit_corners(f).into_iter().all(|x| orient3d(p, q, r, x) == Sign::Zero);
            partner = Partner::Face(g, if in_plane { 0.0 } else { other.dot(centre - p).abs() });
            false
        });
        (partner, examined)
    }
}

/// Reports one defect for each set of faces connected by pairs or shared edges.
fn report_regions(scan: &mut Scan<'_, '_>, pairs: &[(u32, u32, f64)]) -> Result<(), Cancelled> {
    if pairs.is_empty() {
        return Ok(());
    }
    let count = scan.analysis.surface.faces.len();
    let mut is_member = vec![false; count];
    let mut sets = UnionFind::new(count);
    for &(f, g, _) in pairs {
        is_member[f as usize] = true;
        is_member[g as usize] = true;
        sets.unite(f, g);
    }
    for half_edges in scan.analysis.edges.iter() {
        let mut faces = half_edges.iter().map(|h| h / 3).filter(|&f| is_member[f as usize]);
        if let Some(first) = faces.next() {
            faces.for_each(|f| sets.unite(first, f));
        }
    }
    let mut gaps = vec![0.0f64; count];
    for &(f, _, gap) in pairs {
        let widest = &mut gaps[sets.root(f) as usize];
        *widest = widest.max(gap);
    }
    let mut members: Vec<(u32, u32)> =
        (0u32..).zip(&is_member).filter(|&(_, &is)| is).map(|(f, _)| (sets.root(f), f)).collect();
    members.sort_unstable();
    for (number, region) in members.chunk_by(|x, y| x.0 == y.0).enumerate() {
        scan.step(number)?;
        let (root, first) = region[0];
        let gap = scan.in_model_unit(gaps[root as usize]);
        scan.report(DefectKind::Sheet, scan.middle(first), region.iter().map(|&(_, f)| f), Some(gap));
    }
    Ok(())
}
