//! The part accounting: for each part of the input, whether it is in the result, or the reason why it may be missing.
//!
//! [`surviving_input`] counts which faces, vertices and parts of the input are left, for the red flags.

use super::operators::debris::is_debris;
use super::operators::duplicates::remove_duplicates;
use super::operators::orient::Orient;
use super::operators::sheets::open_sheets;
use super::options::Options;
use super::red_flags::SurvivingInput;
use crate::context::{Cancelled, Context};
use crate::inspect::{Analysis, Original, PartAccounting, PartReason, solids};
use crate::mesh::{Edges, NO_SOURCE, Parts, Surface, is_generated};

/// Mean thickness up to which a closed part counts as empty: as a share of its own diagonal, and of the model's largest coordinate.
/// f32 cannot represent a smaller thickness.
const NO_THICKNESS: [f64; 2] = [1e-6, 2.0 / (1u64 << 23) as f64];

/// Factor on `min_part_volume_pct` up to which a missing part counts as dropped. Its holes are closed differently here than in the
/// operator that drops parts, so the two volumes differ slightly.
const MARGIN: f64 = 1.05;

/// Changes to what is solid that a repair made on purpose, so that they are no signs of damage.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct IntendedChanges {
    /// Whether the interior was filled, so that the input's volume is no reference.
    pub is_interior_filled: bool,
    /// Whether small separate solids were removed or attached.
    pub are_islands_treated: bool,
}

/// Accounts for each part of the input in a result that was read back from its own bytes. Small solids may be
/// missing if `intended` says so.
///
/// # Errors
/// [`Cancelled`] if the job was canceled or the deadline passed.
pub fn part_accounting(
    input: &Original<'_>,
    result: &Analysis<'_>,
    options: &Options,
    intended: IntendedChanges,
    context: &Context<'_>,
) -> Result<PartAccounting, Cancelled> {
    let drops_islands = intended.are_islands_treated || options.print.islands.drops(intended.is_interior_filled);
    let reasons_of =
        |missed: &[u32]| reasons_of_absence(input.analysis(), result, missed, (options, drops_islands), context);
    input.part_accounting(result, reasons_of, context)
}

/// Why the absence of each missing part is no loss: the part encloses nothing or is too small. None for a part that must stay.
fn reasons_of_absence(
    input: &Analysis<'_>,
    result: &Analysis<'_>,
    missed: &[u32],
    (options, drops_islands): (&Options, bool),
    context: &Context<'_>,
) -> Result<Vec<Option<PartReason>>, Cancelled> {
    let volumes = volumes_enclosed(input, missed, context)?;
    let enclosed: f64 = result.solids.iter().map(|solid| solid.volume).sum();
    let all = enclosed + volumes.iter().sum::<f64>();
    let millimetres = input.facts.unit.map_or(1.0, |unit| unit.used.millimetres());
    let small = drops_islands.then(|| options.print.min_island_volume(millimetres, || all));
    let least = (options.min_part_volume_pct / 100.0 * all).max(small.unwrap_or(0.0)) * MARGIN;
    let open = input.parts.open(&input.edges);
    let mut faces = vec![0usize; input.parts.count];
    for &part in input.parts.of_face.iter().filter(|&&part| part != Parts::NONE) {
        faces[part as usize] += 1;
    }
    let area: f64 = input.solids.iter().map(|solid| solid.area).sum();
    let diagonal = input.surface.bounds().diagonal();
    // A part smaller than the merge distance collapses to a point.
    let merge_distance = options.weld_tolerance.max(options.degenerate_tolerance) * diagonal;
    let reason = |(&part, volume): (&u32, f64)| {
        let (solid, open) = (&input.solids[part as usize], open[part as usize]);
        let debris = open && is_debris(solid, faces[part as usize], area, diagonal);
        if volume == 0.0 {
            Some(PartReason::NoVolume)
        } else if debris || solid.bounds.diagonal() <= merge_distance {
            Some(PartReason::Debris)
        } else if volume < least {
            Some(PartReason::Dropped)
        } else {
            None
        }
    };
    Ok(missed.iter().zip(volumes).map(reason).collect())
}

/// The volume that each missing part encloses, in cubic units.
///
/// Opposite duplicate faces are removed and the rest is oriented first. The volume is 0 if only open sheets and closed surface without
/// thickness are left.
fn volumes_enclosed(input: &Analysis<'_>, missed: &[u32], context: &Context<'_>) -> Result<Vec<f64>, Cancelled> {
    let mut wanted = vec![false; input.parts.count];
    missed.iter().for_each(|&part| wanted[part as usize] = true);
    let mut surface = Surface { positions: input.surface.positions.clone(), ..Surface::default() };
    // Here the source of a face is its own index in the input.
    for ((&face, &part), f) in input.surface.faces.iter().zip(&input.parts.of_face).zip(0u32..) {
        if part != Parts::NONE && wanted[part as usize] {
            surface.faces.push(face);
            surface.source.push(f);
        }
    }
    surface.drop_unreferenced();
    remove_duplicates(&mut surface);
    Orient::default().apply(&mut surface, context)?;
    let edges = Edges::new(&surface.faces);
    let parts = Parts::new(&surface, &edges);
    let solids = solids(&surface, &edges, &parts);
    let sheets = open_sheets(&surface, &edges, &parts, &solids);
    let largest = input.surface.positions.iter().map(|p| p.abs().max_element()).fold(0.0, f64::max);
    let thin: Vec<bool> = solids
        .iter()
        .map(|solid| {
            let least = (NO_THICKNESS[0] * solid.bounds.diagonal()).max(NO_THICKNESS[1] * largest);
            solid.area == 0.0 || (solid.closed && 2.0 * (solid.volume / solid.area).abs() <= least)
        })
        .collect();
    let mut volumes = vec![0.0f64; input.parts.count];
    for (&part, &source) in parts.of_face.iter().zip(&surface.source) {
        if part != Parts::NONE && source != NO_SOURCE && !sheets[part as usize] && !thin[part as usize] {
            let volume = &mut volumes[input.parts.of_face[source as usize] as usize];
            *volume = volume.max(solids[part as usize].volume.abs()).max(f64::MIN_POSITIVE);
        }
    }
    Ok(missed.iter().map(|&part| volumes[part as usize]).collect())
}

/// Counts the faces, vertices and parts of the input that a surface still has. If every part is accounted for, no part counts as gone.
pub(super) fn surviving_input(
    surface: &Surface,
    input: &Analysis<'_>,
    part_accounting: &PartAccounting,
) -> SurvivingInput {
    let mut is_left = vec![false; input.file_faces().len()];
    for &source in surface.source.iter().filter(|&&source| !is_generated(source)) {
        if let Some(is_left) = is_left.get_mut(source as usize) {
            *is_left = true;
        }
    }
    let mut gone = vec![true; input.parts.count];
    for (&part, &source) in input.parts.of_face.iter().zip(&input.surface.source) {
        if part != Parts::NONE && is_left[source as usize] {
            gone[part as usize] = false;
        }
    }
    let count = |marks: &[bool]| marks.iter().filter(|&&mark| mark).count() as u64;
    let parts_gone = if part_accounting.lost == 0 { 0 } else { count(&gone) };
    let [vertices, vertices_before] = vertices_left(input, &is_left, part_accounting);
    let dropped = parts_dropped(part_accounting, input.parts.count);
    let is_dropped = |part: &&u32| dropped.get(**part as usize) == Some(&true);
    let faces_dropped = input.parts.of_face.iter().filter(is_dropped).count() as u64;
    SurvivingInput { faces: count(&is_left), parts_gone, vertices, vertices_before, faces_dropped }
}

/// For each part, whether it was dropped because of `min_part_volume_pct`. Empty if no part was dropped.
pub(super) fn parts_dropped(part_accounting: &PartAccounting, parts: usize) -> Vec<bool> {
    if part_accounting.dropped == 0 {
        return Vec::new();
    }
    let mut dropped = vec![false; parts];
    for (part, _) in part_accounting.all_reasons.iter().filter(|(_, reason)| *reason == PartReason::Dropped) {
        dropped[*part as usize] = true;
    }
    dropped
}

/// The number of vertices at faces that are left, and at all faces. Faces without area, and of parts that may be missing, do not count.
fn vertices_left(input: &Analysis<'_>, is_left: &[bool], part_accounting: &PartAccounting) -> [u64; 2] {
    let mut may_be_missing = vec![false; input.parts.count];
    part_accounting.all_reasons.iter().for_each(|(part, _)| may_be_missing[*part as usize] = true);
    let mut vertices = vec![[false; 2]; input.surface.positions.len()];
    let faces = input.surface.faces.iter().zip(&input.surface.source).zip(&input.parts.of_face).zip(input.flat());
    for (((face, &source), &part), &flat) in faces {
        if !flat && part != Parts::NONE && !may_be_missing[part as usize] {
            for &v in face {
                let [at_left, at_any] = &mut vertices[v as usize];
                *at_left |= is_left[source as usize];
                *at_any = true;
            }
        }
    }
    [0, 1].map(|k| vertices.iter().filter(|marks| marks[k]).count() as u64)
}
