//! What a printer and its operator want to know of a model.

mod wall_search;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::distribution::percentile;
use super::sampling::{Sample, ask, samples};
use super::{Analysis, InspectOptions, Measures, Solid, finite};
use crate::context::{Cancelled, Context};
use crate::math::Box3;
use crate::scene::{Unit, UnitSource};
use wall_search::{Probe, Prober, Search, Wall};

/// Points from which the wall is measured whatever its thickness.
const SAMPLES: u32 = 256;
/// The same where winding numbers must tell material from air, which costs more.
const COSTLY_SAMPLES: u32 = 64;
/// Points from which it is measured how much of the surface is thin.
const THIN_SAMPLES: u32 = 256;
/// Boxes and triangles that these points together may look at.
const BUDGET: u64 = 10_000_000;
/// Share of the area that is part of a wall which the thin walls are.
const THIN_SHARE: f64 = 0.05;
/// Share of the samples that must have material on one side and air on the other for the mesh to have walls.
const SOLID_SHARE: f64 = 0.5;
/// Angles for which the area is always told, in degrees from the vertical.
const DEGREES: [f64; 3] = [30.0, 45.0, 60.0];
/// How high above the lowest point a face still lies on the build plate, as a share of the diagonal.
const PLATE: f64 = 1e-6;
/// What the sine of a face's angle must exceed that of the limit by, so that faces at just the limit do not count.
const MORE: f64 = 1e-9;

/// Measures for printing. Lengths, areas and volumes are in the model's unit where nothing else is said.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct PrintMeasures {
    /// The model's unit.
    pub unit: Unit,
    /// How it is known.
    pub unit_source: UnitSource,
    /// Sides of the bounding box.
    pub size: [f64; 3],
    /// The same in millimetres.
    pub size_mm: [f64; 3],
    /// Area of all faces.
    pub area: f64,
    /// Enclosed volume; none where the mesh is not closed and consistently turned. What overlaps counts twice.
    pub volume: Option<f64>,
    /// Centre of mass of the enclosed volume; none where that is not reliable or zero.
    pub centre_of_mass: Option<[f64; 3]>,
    /// Closed parts that enclose something and are not the wall of a cavity.
    pub solids: u64,
    /// The thinnest wall.
    pub thinnest_wall: Option<ThinnestWall>,
    /// Why there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub no_wall_reason: Option<NoWallReason>,
    /// Surface that faces down.
    pub overhang: Overhang,
    /// Whether the model fits; none where no build volume was given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fit: Option<Fit>,
}

/// Whether a model fits a printer.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Fit {
    /// Sides of the build volume, in millimetres.
    pub build_volume: [f64; 3],
    /// Whether it fits as it stands.
    pub as_is: bool,
    /// Whether it fits in some order of its axes.
    pub rotated: bool,
}

/// Measures a model for printing; none for a mesh without faces. The work on walls is bounded, so it is O(n log n).
///
/// # Errors
/// [`Cancelled`] when the context says stop.
pub fn print_measures(
    analysis: &Analysis<'_>,
    measures: &Measures,
    options: &InspectOptions,
    context: &Context<'_>,
) -> Result<Option<PrintMeasures>, Cancelled> {
    let Some(bounds) = measures.bounding_box else { return Ok(None) };
    let (unit, unit_source) = match (analysis.subject.unit, options.unit) {
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

/// The centre of the enclosed volume: of the tetrahedra from the middle of the box to each face, by their signed volumes.
fn centre_of_mass(analysis: &Analysis<'_>) -> Option<[f64; 3]> {
    let unit = analysis.unit();
    let about = Box3::of(unit.iter().copied()).centre();
    let (mut volume, mut moment) = (0.0, DVec3::ZERO);
    for face in &analysis.surface.faces {
        let [a, b, c] = face.map(|v| unit[v as usize] - about);
        let part = a.dot(b.cross(c));
        volume += part;
        moment += (a + b + c) * (part / 4.0);
    }
    let centre = (about + moment / volume) / analysis.scale();
    (volume != 0.0 && centre.is_finite()).then(|| centre.to_array())
}

fn count_solids(analysis: &Analysis<'_>, context: &Context<'_>) -> Result<u64, Cancelled> {
    let depths = analysis.depths(context)?;
    let encloses = analysis.solids.iter().map(|solid| solid.closed && solid.volume != 0.0);
    // A part whose nesting can't be told, because it touches others everywhere, is most likely no cavity.
    let cavity = depths.iter().map(|depth| depth.is_some_and(|depth| depth % 2 == 1));
    Ok(encloses.zip(cavity).filter(|&(encloses, cavity)| encloses && !cavity).count() as u64)
}

fn fit(size: [f64; 3], build_volume: [f64; 3]) -> Fit {
    let within = |size: [f64; 3], room: [f64; 3]| size.iter().zip(room).all(|(side, room)| *side <= room);
    let sorted = |mut sides: [f64; 3]| {
        sides.sort_by(f64::total_cmp);
        sides
    };
    let turned = within(sorted(size), sorted(build_volume));
    Fit { build_volume, as_is: within(size, build_volume), rotated: turned }
}

/// Surface that faces down and may need support.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Overhang {
    /// The direction in which the model is built, of length 1.
    pub up: [f64; 3],
    /// The area that hangs over by more than each of some angles, by rising angle. What lies on the build plate is left out.
    pub areas: Vec<OverhangArea>,
}

/// The area that hangs over by more than an angle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct OverhangArea {
    /// The angle from the vertical, in degrees: a wall has 0, a ceiling 90.
    pub degrees: f64,
    /// Area, in square units.
    pub area: f64,
    /// Share of the whole area, in percent.
    pub percent: f64,
}

/// Measures overhangs for the build direction `up`, of any length, at some fixed angles and at `degrees`. A direction that is
/// none counts as +z.
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
    let (mut whole, mut areas) = (0.0, vec![0.0; limits.len()]);
    let sines: Vec<f64> = limits.iter().map(|degrees| degrees.to_radians().sin() + MORE).collect();
    for face in &analysis.surface.faces {
        let [a, b, c] = face.map(|v| unit[v as usize]);
        let area = (b - a).cross(c - a) * 0.5;
        let size = area.length();
        whole += size;
        if size > 0.0 && [a, b, c].iter().any(|p| p.dot(up) > plate) {
            let down = -area.dot(up) / size;
            for (sum, _) in areas.iter_mut().zip(&sines).filter(|(_, sine)| down > **sine) {
                *sum += size;
            }
        }
    }
    let scale = analysis.scale();
    let areas = limits.into_iter().zip(areas).map(|(degrees, area)| OverhangArea {
        degrees,
        area: finite(area / scale / scale),
        percent: if whole > 0.0 { area / whole * 100.0 } else { 0.0 },
    });
    Overhang { up: up.to_array(), areas: areas.collect() }
}

/// The thinnest wall.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
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
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ThinPlace {
    /// The point, on the surface.
    pub at: [f64; 3],
    /// The thickness there, in the model's unit.
    pub thickness: f64,
}

/// Why no wall was measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum NoWallReason {
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
fn thinnest_wall(
    analysis: &Analysis<'_>,
    measures: &Measures,
    context: &Context<'_>,
) -> Result<Result<ThinnestWall, NoWallReason>, Cancelled> {
    let bounding = bounding_parts(analysis, measures, context)?;
    let samples = samples(analysis, if bounding.is_some() { SAMPLES } else { COSTLY_SAMPLES });
    let prober = Prober::new(analysis, bounding);
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
    let Some(least) = thin.first() else { return Ok(Err(NoWallReason::NoOppositeSides)) };
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
    let prober = Prober::new(analysis, None);
    let walls = walls(&samples, context, |sample, steps| prober.probe_by_ball(sample, steps))?.unwrap_or_default();
    let thickness = percentile(&sorted(&walls), THIN_SHARE) / analysis.scale();
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
) -> Result<Result<Vec<Wall>, NoWallReason>, Cancelled> {
    if samples.is_empty() {
        return Ok(Err(NoWallReason::NoSurface));
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
        return Ok(Err(NoWallReason::OpenSurface));
    }
    Ok(Ok(walls))
}

/// Which parts bound the material: their faces have material behind them and air in front. Each other part is wholly within material, or
/// encloses air only. None where nesting does not tell: the mesh is not printable, or parts touch.
fn bounding_parts(
    analysis: &Analysis<'_>,
    measures: &Measures,
    context: &Context<'_>,
) -> Result<Option<Vec<bool>>, Cancelled> {
    if !measures.printable() {
        return Ok(None);
    }
    // What a part adds to the winding numbers within it.
    let own = |solid: &Solid| if solid.volume > 0.0 { 1 } else { -1 };
    let bounds = |(solid, containers): (&Solid, &Option<Vec<u32>>)| {
        let around: i32 = containers.as_ref()?.iter().map(|&part| own(&analysis.solids[part as usize])).sum();
        (solid.volume != 0.0).then(|| around == i32::from(solid.volume < 0.0))
    };
    Ok(analysis.solids.iter().zip(analysis.containers(context)?).map(bounds).collect())
}
