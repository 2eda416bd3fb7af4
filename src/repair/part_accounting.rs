//! What became of each part of the input.

use super::operators::debris::is_debris;
use super::operators::duplicates::remove_duplicates;
use super::operators::orient::Orient;
use super::options::Options;
use super::red_flags::Standing;
use super::sheets::open_sheets;
use crate::context::{Cancelled, Context};
use crate::inspect::{Analysis, Dispensable, Original, PartAccounting, PartReason, solids};
use crate::mesh::{Edges, NO_SOURCE, Parts, Surface, is_generated};

/// Mean thickness of a closed part up to which it encloses nothing, as a share of its own diagonal, and of the model's largest
/// coordinate: what f32 can't tell apart.
const NO_THICKNESS: [f64; 2] = [1e-6, 2.0 / (1u64 << 23) as f64];

/// How much more than the share that the options keep a part may have that was dropped: its holes are closed otherwise here.
const MARGIN: f64 = 1.05;

/// What became of each part of the input, looked up on the result's own bytes.
///
/// # Errors
/// [`Cancelled`] when the context says stop.
pub fn part_accounting(
    input: &Original<'_>,
    result: &Analysis<'_>,
    options: &Options,
    context: &Context<'_>,
) -> Result<PartAccounting, Cancelled> {
    input.part_accounting(result, |missed| dispensable(input.analysis(), result, missed, options, context), context)
}

/// Which of the parts that are not in a result enclose nothing, or are too small to print.
fn dispensable(
    input: &Analysis<'_>,
    result: &Analysis<'_>,
    missed: &[u32],
    options: &Options,
    context: &Context<'_>,
) -> Result<Vec<Dispensable>, Cancelled> {
    let volumes = volumes_enclosed(input, missed, context)?;
    let enclosed: f64 = result.solids.iter().map(|it| it.volume).sum();
    let all = enclosed + volumes.iter().sum::<f64>();
    let least = options.min_part_volume_pct / 100.0 * all * MARGIN;
    let open = input.parts.open(&input.edges);
    let mut faces = vec![0usize; input.parts.count];
    for &part in input.parts.of_face.iter().filter(|&&part| part != Parts::NONE) {
        faces[part as usize] += 1;
    }
    let area: f64 = input.solids.iter().map(|solid| solid.area).sum();
    let diagonal = input.surface.bounds().diagonal();
    // What is smaller than what is merged can't stay.
    let merged = options.weld_tolerance.max(options.degenerate_tolerance) * diagonal;
    let dispensable = |(&part, volume): (&u32, f64)| {
        let (solid, open) = (&input.solids[part as usize], open[part as usize]);
        let debris = open && is_debris(solid, faces[part as usize], area, diagonal);
        if volume == 0.0 {
            Dispensable::NoVolume
        } else if debris || solid.bounds.diagonal() <= merged {
            Dispensable::Debris
        } else if volume < least {
            Dispensable::Dropped
        } else {
            Dispensable::No
        }
    };
    Ok(missed.iter().zip(volumes).map(dispensable).collect())
}

/// What each of the parts encloses; 0 where nothing of it but open sheets and closed surface without volume is left when faces
/// that cancel are gone and the others agree on their winding.
fn volumes_enclosed(input: &Analysis<'_>, missed: &[u32], context: &Context<'_>) -> Result<Vec<f64>, Cancelled> {
    let mut wanted = vec![false; input.parts.count];
    missed.iter().for_each(|&part| wanted[part as usize] = true);
    let mut surface = Surface { positions: input.surface.positions.clone(), ..Surface::default() };
    // The faces' own numbers stand for their sources.
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
        .map(|it| {
            let nothing = (NO_THICKNESS[0] * it.bounds.diagonal()).max(NO_THICKNESS[1] * largest);
            it.area == 0.0 || (it.closed && 2.0 * (it.volume / it.area).abs() <= nothing)
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

/// What of the input is in a surface. Where every part is accounted for, none is gone by becoming one with others.
pub(super) fn standing(surface: &Surface, input: &Analysis<'_>, part_accounting: &PartAccounting) -> Standing {
    let mut stands = vec![false; input.subject.soup.faces.len()];
    for &source in surface.source.iter().filter(|&&source| !is_generated(source)) {
        if let Some(stands) = stands.get_mut(source as usize) {
            *stands = true;
        }
    }
    let mut gone = vec![true; input.parts.count];
    for (&part, &source) in input.parts.of_face.iter().zip(&input.surface.source) {
        if part != Parts::NONE && stands[source as usize] {
            gone[part as usize] = false;
        }
    }
    let count = |marks: &[bool]| marks.iter().filter(|&&it| it).count() as u64;
    let parts_gone = if part_accounting.lost == 0 { 0 } else { count(&gone) };
    let [vertices, vertices_before] = vertices_standing(input, &stands, part_accounting);
    let dropped = parts_dropped(part_accounting, input.parts.count);
    let is_dropped = |part: &&u32| dropped.get(**part as usize) == Some(&true);
    let faces_dropped = input.parts.of_face.iter().filter(is_dropped).count() as u64;
    Standing { faces: count(&stands), parts_gone, vertices, vertices_before, faces_dropped }
}

/// Of each part whether it was dropped as the options ask; empty where none was.
pub(super) fn parts_dropped(part_accounting: &PartAccounting, parts: usize) -> Vec<bool> {
    if part_accounting.dropped == 0 {
        return Vec::new();
    }
    let mut dropped = vec![false; parts];
    for (part, _) in part_accounting.certified.iter().filter(|(_, reason)| *reason == PartReason::Dropped) {
        dropped[*part as usize] = true;
    }
    dropped
}

/// The vertices at faces that stand, and those at any face that has an area and is no part that may go.
fn vertices_standing(input: &Analysis<'_>, stands: &[bool], part_accounting: &PartAccounting) -> [u64; 2] {
    let mut may_go = vec![false; input.parts.count];
    part_accounting.certified.iter().for_each(|(part, _)| may_go[*part as usize] = true);
    let mut vertices = vec![[false; 2]; input.surface.positions.len()];
    let faces = input.surface.faces.iter().zip(&input.surface.source).zip(&input.parts.of_face).zip(input.flat());
    for (((face, &source), &part), &flat) in faces {
        if !flat && part != Parts::NONE && !may_go[part as usize] {
            for &v in face {
                let [of_standing, of_any] = &mut vertices[v as usize];
                *of_standing |= stands[source as usize];
                *of_any = true;
            }
        }
    }
    [0, 1].map(|k| vertices.iter().filter(|marks| marks[k]).count() as u64)
}
