use super::operators::debris::is_debris;
use super::operators::duplicates::remove_duplicates;
use super::operators::orient::Orient;
use super::sheets::open_sheets;
use super::{Cancelled, Context, Options};
use crate::inspect::{Analysis, Dispensable, Ledger, Original, solids};
use crate::mesh::{Edges, NO_SOURCE, Parts, Surface};

/// Mean thickness of a closed part up to which it encloses nothing, as a share of its own diagonal, and of the model's largest
/// coordinate: what f32 can't tell apart.
const NO_THICKNESS: [f64; 2] = [1e-6, 2.0 / (1u64 << 23) as f64];

/// How much more than the share that the options keep a part may have that was dropped: its holes are closed otherwise here.
const MARGIN: f64 = 1.05;

/// What became of each part of the input, looked up on the result's own bytes.
///
/// # Errors
/// [`Cancelled`] when the context says stop.
pub fn ledger(
    input: &Original<'_>,
    result: &Analysis<'_>,
    options: &Options,
    context: &Context<'_>,
) -> Result<Ledger, Cancelled> {
    input.ledger(result, |missed| dispensable(input.analysis(), result, missed, options, context), context)
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
    let tell = |(&part, volume): (&u32, f64)| {
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
    Ok(missed.iter().zip(volumes).map(tell).collect())
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
