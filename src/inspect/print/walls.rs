use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::wall_search::{Probe, Prober, Search, Wall};
use crate::context::{Cancelled, Context};
use crate::inspect::distribution::percentile;
use crate::inspect::sampling::{Sample, ask, samples};
use crate::inspect::{Analysis, Measures, Solid, finite};

/// Points from which the wall is measured whatever its thickness.
const SAMPLES: u32 = 256;
/// The same where winding numbers must tell material from air, which costs more.
const COSTLY_SAMPLES: u32 = 64;
/// Points from which it is measured how much of the surface is thin.
const THIN_SAMPLES: u32 = 256;
/// Boxes and triangles that these points together may look at.
const BUDGET: u64 = 10_000_000;
/// Share of the area that is part of a wall which the thin walls are.
const THIN: f64 = 0.05;
/// Share of the samples that must have material on one side and air on the other for the mesh to have walls.
const SOLID_SHARE: f64 = 0.5;

/// The thinnest wall.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ThinnestWall {
    /// Its thickness, in the model's unit: the way from a face straight into the material to where it leaves through a face turned
    /// the other way to within 30 degrees. The least over every face's centre and over points spread by area.
    pub thickness: f64,
    /// A point on one side of it.
    pub at: [f64; 3],
    /// The faces of the file on both sides of it.
    pub faces: [u32; 2],
    /// The median of the thickness over the area that is part of a wall, from at most 256 points.
    pub median: f64,
    /// Points from which a thinner wall was searched: every face's centre, and points spread by area.
    pub samples: u64,
    /// Whether the search looked at all of these points. A mesh made to be slow, or one with overlapping parts or holes, may
    /// spend the search's budget first; then a thinner wall may have been missed.
    #[serde(default)]
    pub complete: bool,
    /// The thinnest point of each thin region, at most 100, the thinnest first. A region is a sixteenth of the model's
    /// longest side wide. Regions count that are at most a quarter thicker than the thinnest, or as thick as 2 % of the diagonal.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub places: Vec<ThinPlace>,
}

/// The thinnest point of a thin region.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ThinPlace {
    /// The point, on the surface.
    pub at: [f64; 3],
    /// The thickness there, in the model's unit.
    pub thickness: f64,
}

/// Why no wall was measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum NoWall {
    /// The mesh has no area.
    NoSurface,
    /// Most of the surface has no material on one side and air on the other: it is a sheet, or too open to tell.
    OpenSurface,
    /// No two sides face away from each other.
    NoOppositeSides,
    /// It is the input of a repair and not printable: the walls that are measured are those of the result.
    NotPrintable,
}

/// Measures the thinnest wall by rays inward, from every face's centre and from points spread over the surface, to where the
/// air begins. Where the mesh is not printable, winding numbers tell material from air, so parts may overlap, surfaces intersect,
/// and parts be turned inside out.
///
/// # Errors
/// [`Cancelled`] when the context says stop.
pub(super) fn thinnest_wall(
    analysis: &Analysis<'_>,
    measures: &Measures,
    context: &Context<'_>,
) -> Result<Result<ThinnestWall, NoWall>, Cancelled> {
    let simple = parts_material_from_air(analysis, measures, context)?;
    let samples = samples(analysis, if simple { SAMPLES } else { COSTLY_SAMPLES });
    let prober = Prober::new(analysis, simple);
    let sampled = match walls(&samples, context, |sample, steps| prober.probe(sample, prober.reach, steps))? {
        Ok(walls) => walls,
        Err(why) => return Ok(Err(why)),
    };
    let mut search = Search::new(analysis, prober.reach);
    sampled.iter().for_each(|wall| search.add(*wall));
    search.run(&prober, measures.printable(), context)?;
    let scale = analysis.scale();
    let at = |wall: &Wall| wall.point.to_array().map(|x| finite(x / scale));
    let thickness = |wall: &Wall| finite(wall.thickness / scale);
    let thin = search.regions();
    let Some(least) = thin.first() else { return Ok(Err(NoWall::NoOppositeSides)) };
    Ok(Ok(ThinnestWall {
        thickness: thickness(least),
        at: at(least),
        faces: least.faces.map(|face| analysis.surface.source[face as usize]),
        median: if sampled.is_empty() { thickness(least) } else { finite(median(&sampled) / scale) },
        samples: search.asked + samples.len() as u64,
        complete: search.complete,
        places: thin.iter().map(|wall| ThinPlace { at: at(wall), thickness: thickness(wall) }).collect(),
    }))
}

fn median(walls: &[Wall]) -> f64 {
    percentile(&sorted(walls), 0.5)
}

/// The thickness, in the model's unit, below which the wall is on a twentieth of the area that is part of a wall: thin, and
/// not the chance of a single point. None where there is no wall to measure. By balls inside the material, since a grid resolves
/// a wall by the room that it leaves.
///
/// # Errors
/// [`Cancelled`] when the context says stop.
pub fn thin_walls(analysis: &Analysis<'_>, context: &Context<'_>) -> Result<Option<f64>, Cancelled> {
    let samples = samples(analysis, THIN_SAMPLES);
    let prober = Prober::new(analysis, false);
    let walls = walls(&samples, context, |sample, steps| prober.probe_by_ball(sample, steps))?.unwrap_or_default();
    let thickness = percentile(&sorted(&walls), THIN) / analysis.scale();
    Ok((!walls.is_empty() && thickness > 0.0 && thickness.is_finite()).then_some(thickness))
}

fn sorted(walls: &[Wall]) -> Vec<f64> {
    let mut sorted: Vec<f64> = walls.iter().map(|wall| wall.thickness).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    sorted
}

/// The wall behind each sample that has one.
fn walls(
    samples: &[Sample],
    context: &Context<'_>,
    probe: impl Fn(&Sample, &mut u64) -> Probe + Sync,
) -> Result<Result<Vec<Wall>, NoWall>, Cancelled> {
    if samples.is_empty() {
        return Ok(Err(NoWall::NoSurface));
    }
    context.check()?;
    let answers = ask(samples.len(), BUDGET, context, |i, steps| {
        let probe = probe(&samples[i], steps);
        (*steps > 0).then_some(probe)
    })?;
    let (mut asked, mut solid, mut walls) = (0u32, 0u32, Vec::new());
    for (sample, probe) in samples.iter().zip(&answers.values) {
        let Some(probe) = probe else { continue };
        asked += 1;
        solid += u32::from(!matches!(probe, Probe::NotSolid));
        if let &Probe::Wall(thickness, face) = probe {
            walls.push(Wall { thickness, point: sample.point, faces: [sample.face, face] });
        }
    }
    if f64::from(solid) < SOLID_SHARE * f64::from(asked) || asked == 0 {
        return Ok(Err(NoWall::OpenSurface));
    }
    Ok(Ok(walls))
}

/// Whether each face has material behind it and air in front of it for certain: nothing intersects, and parts within others
/// are cavities and solids by turns.
fn parts_material_from_air(
    analysis: &Analysis<'_>,
    measures: &Measures,
    context: &Context<'_>,
) -> Result<bool, Cancelled> {
    if !measures.printable() {
        return Ok(false);
    }
    let depths = analysis.depths(context)?;
    let by_turns = |(solid, depth): (&Solid, &Option<u32>)| {
        depth.is_some_and(|depth| (solid.volume > 0.0) == (depth % 2 == 0)) && solid.volume != 0.0
    };
    Ok(analysis.solids.iter().zip(depths).all(by_turns))
}
