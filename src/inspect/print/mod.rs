//! Measures for 3D printing: size, volume, thinnest wall, overhangs, and fit in the build volume.

mod wall_probe;
mod wall_search;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::distribution::percentile;
use super::sampling::{Sample, run_queries, samples};
use super::{Analysis, InspectOptions, Measures, Solid, finite};
use crate::context::{Cancelled, Context};
use crate::math::{Box3, threads};
use crate::scene::{Unit, UnitSource};
use wall_probe::{Probe, Wall, WallProber};
use wall_search::WallSearch;

/// Number of sample points at which the full wall thickness is measured.
const SAMPLES: u32 = 256;
/// Number of such points if winding numbers distinguish material from air, which costs more.
const COSTLY_SAMPLES: u32 = 64;
/// Number of sample points for estimating how much of the surface is thin.
const THIN_SAMPLES: u32 = 256;
/// Budget of these samples: boxes and triangles visited.
const BUDGET: u64 = 10_000_000;
/// Quantile of the wall thickness, by area, that counts as thin.
const THIN_SHARE: f64 = 0.05;
/// Fraction of the samples that must have material on one side and air on the other for the mesh to have walls.
const SOLID_SHARE: f64 = 0.5;
/// Overhang angles that the report always has, in degrees from the vertical.
const DEGREES: [f64; 3] = [30.0, 45.0, 60.0];
/// Height above the lowest point up to which a face lies on the build plate, as a fraction of the diagonal.
const PLATE: f64 = 1e-6;
/// Margin on the sine of an overhang angle, so that faces exactly at the limit do not count.
const SINE_MARGIN: f64 = 1e-9;

/// Measures for printing. Lengths, areas and volumes are in the model's unit unless stated otherwise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct PrintMeasures {
    /// The model's unit.
    pub unit: Unit,
    /// Origin of the unit: declared by the request, given by the file, or assumed.
    pub unit_source: UnitSource,
    /// Side lengths of the bounding box.
    pub size: [f64; 3],
    /// Side lengths of the bounding box, in millimetres.
    pub size_mm: [f64; 3],
    /// Total area of all faces.
    pub area: f64,
    /// Enclosed volume; `null` if the mesh is not closed and consistently oriented. Overlapping parts count twice.
    pub volume: Option<f64>,
    /// Centre of mass of the enclosed volume; `null` if the volume is zero or unreliable.
    pub centre_of_mass: Option<[f64; 3]>,
    /// Number of closed parts with a volume, excluding the surfaces of cavities.
    pub solids: u64,
    /// The thinnest wall; `null` if none was measured.
    pub thinnest_wall: Option<ThinnestWall>,
    /// Why no wall was measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub no_wall_reason: Option<NoWallReason>,
    /// Area of downward-facing surface.
    pub overhang: Overhang,
    /// Whether the model fits the build volume; absent if the request gives no build volume.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fit: Option<Fit>,
}

/// Whether a model fits a printer's build volume.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Fit {
    /// Side lengths of the build volume, in millimetres.
    pub build_volume: [f64; 3],
    /// Whether the model fits in its present orientation.
    pub as_is: bool,
    /// Whether the model fits with its axes permuted, that is, after rotations by 90 degrees.
    pub rotated: bool,
}

/// Measures a model for printing. Returns `None` for a mesh without faces. O(n log n), with a bounded search for
/// walls.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn print_measures(
    analysis: &Analysis<'_>,
    measures: &Measures,
    options: &InspectOptions,
    context: &Context<'_>,
) -> Result<Option<PrintMeasures>, Cancelled> {
    let Some(bounds) = measures.bounding_box else { return Ok(None) };
    let (unit, unit_source) = match (analysis.facts.unit, options.unit) {
        (Some(settled), _) => (settled.used, settled.source),
        (None, Some(unit)) => (unit, UnitSource::Declared),
        (None, None) => (Unit::default(), UnitSource::Assumed),
    };
    let size = [0, 1, 2].map(|k| finite(bounds.max[k] - bounds.min[k]));
    let size_mm = size.map(|side| finite(side * unit.millimetres()));
    let wall = if options.walls_of_printable_only && !measures.printable() {
        Err(NoWallReason::NotPrintable)
    } else {
        thinnest_wall(analysis, measures, context)?
    };
    Ok(Some(PrintMeasures {
        unit,
        unit_source,
        size,
        size_mm,
        area: measures.area,
        volume: measures.volume.reliable.then_some(measures.volume.value),
        centre_of_mass: if measures.volume.reliable { centre_of_mass(analysis) } else { None },
        solids: count_solids(analysis, context)?,
        no_wall_reason: wall.as_ref().err().copied(),
        thinnest_wall: wall.ok(),
        overhang: overhang(analysis, options.up, options.overhang_deg),
        fit: options.build_volume.map(|build_volume| fit(size_mm, build_volume)),
    }))
}

/// Centre of mass of the enclosed volume, as the volume-weighted mean of tetrahedra from the box's centre to each
/// face.
fn centre_of_mass(analysis: &Analysis<'_>) -> Option<[f64; 3]> {
    let unit = analysis.unit();
    let about = Box3::of(unit.iter().copied()).centre();
    let of_chunks = threads::map_chunks(analysis.surface.faces.len(), |faces| {
        let (mut volume, mut moment) = (0.0, DVec3::ZERO);
        for face in &analysis.surface.faces[faces] {
            let [a, b, c] = face.map(|v| unit[v as usize] - about);
            let part = a.dot(b.cross(c));
            volume += part;
            moment += (a + b + c) * (part / 4.0);
        }
        (volume, moment)
    });
    let (volume, moment) =
        of_chunks.into_iter().fold((0.0, DVec3::ZERO), |(v, m), (volume, moment)| (v + volume, m + moment));
    let centre = (about + moment / volume) / analysis.scale();
    (volume != 0.0 && centre.is_finite()).then(|| centre.to_array())
}

fn count_solids(analysis: &Analysis<'_>, context: &Context<'_>) -> Result<u64, Cancelled> {
    let depths = analysis.depths(context)?;
    let encloses = analysis.solids.iter().map(|solid| solid.closed && solid.volume != 0.0);
    // A part with undecided nesting touches others everywhere and is most likely no cavity.
    let cavity = depths.iter().map(|depth| depth.is_some_and(|depth| depth % 2 == 1));
    Ok(encloses.zip(cavity).filter(|&(encloses, cavity)| encloses && !cavity).count() as u64)
}

fn fit(size: [f64; 3], build_volume: [f64; 3]) -> Fit {
    let within = |size: [f64; 3], available: [f64; 3]| size.iter().zip(available).all(|(side, limit)| *side <= limit);
    let sorted = |mut sides: [f64; 3]| {
        sides.sort_by(f64::total_cmp);
        sides
    };
    let rotated = within(sorted(size), sorted(build_volume));
    Fit { build_volume, as_is: within(size, build_volume), rotated }
}

/// Downward-facing surface that may need support.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Overhang {
    /// Build direction, normalised to length 1.
    pub up: [f64; 3],
    /// Area steeper than each overhang angle, by ascending angle. Excludes faces on the build plate.
    pub areas: Vec<OverhangArea>,
}

/// Area of the surface that overhangs by more than an angle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct OverhangArea {
    /// The angle from the vertical, in degrees: 0 for a vertical wall, 90 for a ceiling.
    pub degrees: f64,
    /// Overhanging area, in square model units.
    pub area: f64,
    /// Overhanging share of the total area, in percent.
    pub percent: f64,
}

/// Measures overhangs at the fixed angles and at `degrees`. The build direction `up` may have any length; an invalid
/// direction counts as +z.
fn overhang(analysis: &Analysis<'_>, up: [f64; 3], degrees: f64) -> Overhang {
    let up = DVec3::from(up);
    let largest = up.abs().max_element();
    let up = if largest > 0.0 && largest.is_finite() { (up / largest).normalize() } else { DVec3::Z };
    let mut limits = DEGREES.to_vec();
    limits.push(if degrees.is_nan() { DEGREES[1] } else { degrees.clamp(0.0, 90.0) });
    limits.sort_by(f64::total_cmp);
    limits.dedup();
    let unit = analysis.unit();
    let lowest = unit.iter().map(|p| p.dot(up)).fold(f64::INFINITY, f64::min);
    let plate = lowest + PLATE * analysis.unit_diagonal();
    let sines: Vec<f64> = limits.iter().map(|degrees| degrees.to_radians().sin() + SINE_MARGIN).collect();
    let of_chunks = threads::map_chunks(analysis.surface.faces.len(), |faces| {
        let (mut total, mut areas) = (0.0, vec![0.0; limits.len()]);
        for face in &analysis.surface.faces[faces] {
            let [a, b, c] = face.map(|v| unit[v as usize]);
            let area = (b - a).cross(c - a) * 0.5;
            let size = area.length();
            total += size;
            if size > 0.0 && [a, b, c].iter().any(|p| p.dot(up) > plate) {
                let down = -area.dot(up) / size;
                for (sum, _) in areas.iter_mut().zip(&sines).filter(|(_, sine)| down > **sine) {
                    *sum += size;
                }
            }
        }
        (total, areas)
    });
    let (mut total, mut areas) = (0.0, vec![0.0; limits.len()]);
    for (of_chunk, areas_of_chunk) in of_chunks {
        total += of_chunk;
        areas.iter_mut().zip(areas_of_chunk).for_each(|(sum, area)| *sum += area);
    }
    let scale = analysis.scale();
    let areas = limits.into_iter().zip(areas).map(|(degrees, area)| OverhangArea {
        degrees,
        area: finite(area / scale / scale),
        percent: if total > 0.0 { area / total * 100.0 } else { 0.0 },
    });
    Overhang { up: up.to_array(), areas: areas.collect() }
}

/// The thinnest wall of the model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ThinnestWall {
    /// Thickness in the model's unit: the distance from a face, perpendicular into the material, to an opposite face.
    /// The two faces point away from each other to within 30 degrees. Minimum over face centres and over points spread
    /// by area; of a printable mesh, also over the nearest places of any two opposite faces.
    pub thickness: f64,
    /// A point on one side of the wall.
    pub at: [f64; 3],
    /// The two faces on both sides of the wall, as indices in the file, from 0.
    pub faces: [u32; 2],
    /// Median wall thickness, by area, from at most 256 points. Excludes surface that is not part of a wall.
    pub median: f64,
    /// Number of points from which thinner walls were searched: face centres, at most 500,000, and points spread by area.
    pub samples: u64,
    /// Whether the search covered all of these points. On adversarial meshes, and on meshes with overlapping parts or
    /// holes, the budget may run out first, and the search may miss a thinner wall.
    #[serde(default)]
    pub complete: bool,
    /// The thinnest point of each thin region, thinnest first; at most 100. A region's width is 1/16 of the model's
    /// longest side. A region is thin if its wall is at most 1.25 times the thinnest wall, or at most 2 % of the
    /// diagonal.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub places: Vec<ThinPlace>,
}

/// The thinnest point of a thin region.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ThinPlace {
    /// Position on the surface.
    pub at: [f64; 3],
    /// Wall thickness at this point, in the model's unit.
    pub thickness: f64,
}

/// Why no wall thickness was measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum NoWallReason {
    /// The mesh has no area.
    NoSurface,
    /// Most of the surface does not separate material from air: the mesh is a sheet, or too open to decide.
    OpenSurface,
    /// No two faces point away from each other.
    NoOppositeSides,
    /// The mesh is the unprintable input of a repair; only the result's walls are measured.
    NotPrintable,
}

/// Finds the thinnest wall with inward rays, from face centres and from points spread over the surface, to the
/// first face with air behind. If the mesh is not printable, winding numbers distinguish material from air; then
/// parts may overlap, intersect or be inside out.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
fn thinnest_wall(
    analysis: &Analysis<'_>,
    measures: &Measures,
    context: &Context<'_>,
) -> Result<Result<ThinnestWall, NoWallReason>, Cancelled> {
    let bounding = bounding_parts(analysis, measures, context)?;
    let samples = samples(analysis, if bounding.is_some() { SAMPLES } else { COSTLY_SAMPLES });
    let prober = WallProber::new(analysis, bounding);
    let sampled = match walls(&samples, context, |sample, steps| prober.probe(sample, prober.reach, steps))? {
        Ok(walls) => walls,
        Err(reason) => return Ok(Err(reason)),
    };
    let mut search = WallSearch::new(analysis, prober.reach);
    sampled.iter().for_each(|wall| search.add(*wall));
    search.run(&prober, measures.printable(), context)?;
    let scale = analysis.scale();
    let at = |wall: &Wall| wall.point.to_array().map(|x| finite(x / scale));
    let thickness = |wall: &Wall| finite(wall.thickness / scale);
    let thin = search.regions();
    let Some(least) = thin.first() else { return Ok(Err(NoWallReason::NoOppositeSides)) };
    Ok(Ok(ThinnestWall {
        thickness: thickness(least),
        at: at(least),
        faces: least.faces.map(|face| analysis.surface.source[face as usize]),
        median: if sampled.is_empty() { thickness(least) } else { finite(median(&sampled) / scale) },
        samples: search.points + samples.len() as u64,
        complete: search.complete,
        places: thin.iter().map(|wall| ThinPlace { at: at(wall), thickness: thickness(wall) }).collect(),
    }))
}

fn median(walls: &[Wall]) -> f64 {
    percentile(&sorted(walls), 0.5)
}

/// Thickness of thin walls in the model's unit: the 5 % quantile by area, which does not depend on a single point.
/// `None` if the mesh has no walls. Measures by inscribed balls, since a voxel grid resolves a wall if a ball inside
/// the wall is large enough.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn thin_walls(analysis: &Analysis<'_>, context: &Context<'_>) -> Result<Option<f64>, Cancelled> {
    let samples = samples(analysis, THIN_SAMPLES);
    let prober = WallProber::new(analysis, None);
    let walls = walls(&samples, context, |sample, steps| prober.probe_by_ball(sample, steps))?.unwrap_or_default();
    let thickness = percentile(&sorted(&walls), THIN_SHARE) / analysis.scale();
    Ok((!walls.is_empty() && thickness > 0.0 && thickness.is_finite()).then_some(thickness))
}

fn sorted(walls: &[Wall]) -> Vec<f64> {
    let mut sorted: Vec<f64> = walls.iter().map(|wall| wall.thickness).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    sorted
}

/// Measures the wall at each sample, and returns the walls found.
fn walls(
    samples: &[Sample],
    context: &Context<'_>,
    probe: impl Fn(&Sample, &mut u64) -> Probe + Sync,
) -> Result<Result<Vec<Wall>, NoWallReason>, Cancelled> {
    if samples.is_empty() {
        return Ok(Err(NoWallReason::NoSurface));
    }
    context.check()?;
    let answers = run_queries(samples.len(), BUDGET, context, |i, steps| {
        let probe = probe(&samples[i], steps);
        (*steps > 0).then_some(probe)
    })?;
    let (mut answered, mut solid, mut walls) = (0u32, 0u32, Vec::new());
    for (sample, probe) in samples.iter().zip(&answers.values) {
        let Some(probe) = probe else { continue };
        answered += 1;
        solid += u32::from(!matches!(probe, Probe::NotSolid));
        if let &Probe::Wall(thickness, face) = probe {
            walls.push(Wall { thickness, point: sample.point, faces: [sample.face, face] });
        }
    }
    if f64::from(solid) < SOLID_SHARE * f64::from(answered) || answered == 0 {
        return Ok(Err(NoWallReason::OpenSurface));
    }
    Ok(Ok(walls))
}

/// For each part, whether it separates material from air, with material behind its faces. Any other part is wholly
/// inside material, or encloses only air. `None` if nesting does not decide: the mesh is not printable, or parts
/// touch.
fn bounding_parts(
    analysis: &Analysis<'_>,
    measures: &Measures,
    context: &Context<'_>,
) -> Result<Option<Vec<bool>>, Cancelled> {
    if !measures.printable() {
        return Ok(None);
    }
    // Contribution of a part to the winding number of the points inside.
    let winding_of = |solid: &Solid| if solid.volume > 0.0 { 1 } else { -1 };
    let bounds = |(solid, containers): (&Solid, &Option<Vec<u32>>)| {
        let outer_winding: i32 =
            containers.as_ref()?.iter().map(|&part| winding_of(&analysis.solids[part as usize])).sum();
        (solid.volume != 0.0).then(|| outer_winding == i32::from(solid.volume < 0.0))
    };
    Ok(analysis.solids.iter().zip(analysis.containers(context)?).map(bounds).collect())
}
