//! Surface of no thickness.

use rayon::prelude::*;

use super::super::{Analysis, DefectKind, Level};
use super::parts::report_parts;
use super::scan::{ROUNDING, Scan};
use crate::context::Cancelled;
use crate::math::{Sign, Tree, orient3d, within};
use crate::mesh::{Parts, UnionFind};

/// Cosine of the angle between two sides of a sheet: a degree from opposite.
const OPPOSITE: f64 = -0.999_847_695;
/// Faces that are looked at around one, where there is little left to spend and where there is much.
const LEAST_AROUND: u64 = 32;
const MOST_AROUND: u64 = 4096;
/// Faces that all together look at, for each and at least.
const MOST_A_FACE: u64 = 64;
const MOST_AT_LEAST: u64 = 4_000_000;
/// Faces that are looked at between two looks at the clock.
const BATCH: usize = 1 << 12;

/// What other searches found before.
pub(super) struct Known<'a> {
    /// Faces with an opposite one of the same vertices, and that one.
    pub opposed: &'a [(u32, u32)],
    /// Flat faces.
    pub flat: &'a [bool],
    /// Thickness of the parts that have none.
    pub thin: &'a [Option<f64>],
    /// Faces in foldovers.
    pub folded: &'a [bool],
}

/// Finds the parts without thickness, and in other parts regions of faces that lie on faces turned the other way: those
/// with the same vertices and, where the level allows a search, those whose middle lies within the tolerance of one.
///
/// Walls of two solids that touch are found as well: what is between them has no thickness either.
pub(super) fn find(scan: &mut Scan<'_, '_>, level: Level, known: &Known<'_>) -> Result<(), Cancelled> {
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

/// Looks for a partner of every face but those in `known`.
fn search(
    scan: &mut Scan<'_, '_>,
    skip: &[bool],
    known: &[bool],
    pairs: &mut Vec<(u32, u32, f64)>,
) -> Result<(), Cancelled> {
    let analysis = scan.analysis;
    let search = Search { analysis, tree: analysis.tree(), skip, tolerance: scan.lengths.sheet.max(ROUNDING) };
    let asked: Vec<u32> = (0u32..).zip(known).filter(|&(_, &known)| !known).map(|(f, _)| f).collect();
    let mut gave_up = false;
    // Shared out from batch to batch, so that the answer is the same for any number of threads.
    let mut budget = MOST_AT_LEAST + MOST_A_FACE * asked.len() as u64;
    for batch in asked.chunks(BATCH) {
        scan.context().check()?;
        let most = (budget / batch.len() as u64).clamp(LEAST_AROUND, MOST_AROUND);
        let found: Vec<(Found, u64)> = batch.par_iter().map(|&f| search.partner(f, most)).collect();
        for (&f, (found, looks)) in batch.iter().zip(found) {
            budget = budget.saturating_sub(looks);
            match found {
                Found::Nothing => {}
                Found::Partner(g, gap) => pairs.push((f, g, gap)),
                Found::GaveUp => gave_up = true,
            }
        }
    }
    if gave_up {
        scan.incomplete(DefectKind::Sheet);
    }
    Ok(())
}

struct Search<'a> {
    analysis: &'a Analysis<'a>,
    /// Built before threads ask it.
    tree: &'a Tree,
    skip: &'a [bool],
    tolerance: f64,
}

enum Found {
    Nothing,
    /// A face, and how far away.
    Partner(u32, f64),
    /// There were too many to look at.
    GaveUp,
}

impl Search<'_> {
    /// A face turned the other way on which the middle of face `f` lies, among the first `most` near it; and how many were
    /// looked at.
    fn partner(&self, f: u32, most: u64) -> (Found, u64) {
        let (normal, middle) = (self.analysis.unit_normal(f), self.analysis.unit_centre(f));
        let (mut found, mut looks) = (Found::Nothing, 0);
        self.tree.around(middle, self.tolerance, |g| {
            if looks == most {
                found = Found::GaveUp;
                return false;
            }
            looks += 1;
            let corners @ [p, q, r] = self.analysis.unit_corners(g);
            let other = (q - p).cross(r - p);
            if g == f || self.skip[g as usize] || normal.dot(other) >= 0.0 {
                return true;
            }
            let other = other.normalize_or_zero();
            if normal.dot(other) > OPPOSITE || !within(middle, corners, self.tolerance) {
                return true;
            }
            let in_plane = self.analysis.unit_corners(f).into_iter().all(|x| orient3d(p, q, r, x) == Sign::Zero);
            found = Found::Partner(g, if in_plane { 0.0 } else { other.dot(middle - p).abs() });
            false
        });
        (found, looks)
    }
}

/// One defect for each set of faces that are in pairs or share edges.
fn report_regions(scan: &mut Scan<'_, '_>, pairs: &[(u32, u32, f64)]) -> Result<(), Cancelled> {
    if pairs.is_empty() {
        return Ok(());
    }
    let count = scan.analysis.surface.faces.len();
    let mut part_of = vec![false; count];
    let mut sets = UnionFind::new(count);
    for &(f, g, _) in pairs {
        part_of[f as usize] = true;
        part_of[g as usize] = true;
        sets.unite(f, g);
    }
    for half_edges in scan.analysis.edges.iter() {
        let mut faces = half_edges.iter().map(|h| h / 3).filter(|&f| part_of[f as usize]);
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
        (0u32..).zip(&part_of).filter(|&(_, &is)| is).map(|(f, _)| (sets.root(f), f)).collect();
    members.sort_unstable();
    for (number, region) in members.chunk_by(|x, y| x.0 == y.0).enumerate() {
        scan.step(number)?;
        let (root, first) = region[0];
        let gap = scan.in_model_unit(gaps[root as usize]);
        scan.put(DefectKind::Sheet, scan.middle(first), region.iter().map(|&(_, f)| f), Some(gap));
    }
    Ok(())
}
