//! What a printer and its operator want to know of a model.

mod wall_search;
mod walls;

use glam::DVec3;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{Analysis, InspectOptions, Measures, finite};
use crate::context::{Cancelled, Context};
use crate::math::Box3;
use crate::scene::{Unit, UnitSource};
use walls::thinnest_wall;

pub use walls::{NoWall, ThinPlace, ThinnestWall, thin_walls};

/// Angles for which the area is always told, in degrees from the vertical.
const DEGREES: [f64; 3] = [30.0, 45.0, 60.0];
/// How high above the lowest point a face still lies on the build plate, as a share of the diagonal.
const PLATE: f64 = 1e-6;
/// What the sine of a face's angle must exceed that of the limit by, so that faces at just the limit do not count.
const MORE: f64 = 1e-9;

/// Measures for printing. Lengths, areas and volumes are in the model's unit where nothing else is said.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
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
    pub no_wall: Option<NoWall>,
    /// Surface that faces down.
    pub overhang: Overhang,
    /// Whether the model fits; none where no build volume was given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fit: Option<Fit>,
}

/// Whether a model fits a printer.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Fit {
    /// Sides of the build volume, in millimetres.
    pub build_volume: [f64; 3],
    /// Whether it fits as it stands.
    pub as_is: bool,
    /// Whether it fits in some order of its axes.
    pub turned: bool,
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
        Err(NoWall::NotPrintable)
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
        no_wall: wall.as_ref().err().copied(),
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
    Fit { build_volume, as_is: within(size, build_volume), turned }
}

/// Surface that faces down and may need support.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Overhang {
    /// The direction in which the model is built, of length 1.
    pub up: [f64; 3],
    /// The area that hangs over by more than each of some angles, by rising angle. What lies on the build plate is left out.
    pub beyond: Vec<OverhangArea>,
}

/// The area that hangs over by more than an angle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
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
    let beyond = limits.into_iter().zip(areas).map(|(degrees, area)| OverhangArea {
        degrees,
        area: finite(area / scale / scale),
        percent: if whole > 0.0 { area / whole * 100.0 } else { 0.0 },
    });
    Overhang { up: up.to_array(), beyond: beyond.collect() }
}
