use glam::DVec3;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::context::{Cancelled, Context};
use crate::inspect::compare::{Inside, Sample, percentile, samples, unit_diagonal};
use crate::inspect::queries::ask;
use crate::inspect::{Analysis, Measures, Solid, finite};
use crate::math::hit;

/// Points from which the wall is measured: five on each hundredth of the area.
const SAMPLES: u32 = 512;
/// The same where winding numbers must tell material from air, so that inspecting a small model takes no longer than mending
/// it.
const COSTLY_SAMPLES: u32 = 256;
/// Boxes and triangles that all of them together may look at.
const BUDGET: u64 = 10_000_000;
/// Winding numbers from which on a point is in material, and up to which it is in air. In between the surface is too open to
/// tell.
const MATERIAL: f64 = 0.75;
const AIR: f64 = 0.25;
/// How far beside the surface is asked for material and air: a share of the diagonal, and what f64 tells apart.
const BESIDE: [f64; 2] = [1e-9, 1e-13];
/// Two sides make a wall where they face away from each other by at least the angle of this cosine, 143 degrees: at the
/// edges of a box the faces are near each other, but there is no thin wall.
const OPPOSITE: f64 = 0.8;
/// Faces that a ray may pass through on its way to the air, as in overlapping parts.
const MOST_PASSED: usize = 16;
/// Most places of thin walls that are told.
const MOST_PLACES: usize = 100;
/// Share of the area that is part of a wall which the thin walls are.
const THIN: f64 = 0.05;
/// Share of the samples that must have material on one side and air on the other for the mesh to have walls.
const SOLID_SHARE: f64 = 0.5;

/// The thinnest wall that was found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ThinnestWall {
    /// Its thickness, in the model's unit. Sampled: what is thin on less than a hundredth of the area may be missed.
    pub thickness: f64,
    /// A point on one side of it.
    pub at: [f64; 3],
    /// The faces of the file on both sides of it.
    pub faces: [u32; 2],
    /// The median of the thickness over the area that is part of a wall.
    pub median: f64,
    /// Points at which a wall was measured.
    pub samples: u64,
    /// The thinnest of them, at most 100, the thinnest first: where walls are thinner than a printer makes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub places: Vec<ThinPlace>,
}

/// A point at which the thickness of a wall was measured.
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
}

/// What is at one sample.
enum Probe {
    /// The surface does not part material from air here.
    NotSolid,
    /// Material, but no opposite side.
    NoWall,
    /// The thickness in unit coordinates, and the opposite face.
    Wall(f64, u32),
}

/// Measures the wall behind points spread evenly over the surface: by a ray inward to where the air begins, and by the ball
/// inside the material that touches the point, shrunk until nothing is in it (Ma et al. 2012). Winding numbers tell material
/// from air, so parts may overlap, surfaces intersect, and parts be turned inside out; a printable mesh needs none.
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
    let walls = match walls(analysis, simple, &samples, context)? {
        Ok(walls) => walls,
        Err(why) => return Ok(Err(why)),
    };
    let Some(&(thickness, sample, face)) = walls.iter().min_by(|a, b| a.0.total_cmp(&b.0)) else {
        return Ok(Err(NoWall::NoOppositeSides));
    };
    let scale = analysis.scale();
    Ok(Ok(ThinnestWall {
        thickness: finite(thickness / scale),
        at: sample.point.to_array().map(|x| finite(x / scale)),
        faces: [sample.face, face].map(|face| analysis.surface.source[face as usize]),
        median: finite(percentile(&sorted(&walls), 0.5) / scale),
        samples: walls.len() as u64,
        places: thinnest_places(walls, scale),
    }))
}

/// The thinnest of the samples; of equal ones those that come first.
fn thinnest_places(mut walls: Vec<Wall<'_>>, scale: f64) -> Vec<ThinPlace> {
    walls.sort_by(|a, b| a.0.total_cmp(&b.0));
    let place = |(thickness, sample, _): &Wall<'_>| ThinPlace {
        at: sample.point.to_array().map(|x| finite(x / scale)),
        thickness: finite(thickness / scale),
    };
    walls.iter().take(MOST_PLACES).map(place).collect()
}

/// The thickness, in the model's unit, below which the wall is on a twentieth of the area that is part of a wall: thin, and
/// not the chance of a single point. None where there is no wall to measure.
///
/// # Errors
/// [`Cancelled`] when the context says stop.
pub fn thin_walls(analysis: &Analysis<'_>, context: &Context<'_>) -> Result<Option<f64>, Cancelled> {
    let samples = samples(analysis, COSTLY_SAMPLES);
    let walls = walls(analysis, false, &samples, context)?.unwrap_or_default();
    let thickness = percentile(&sorted(&walls), THIN) / analysis.scale();
    Ok((!walls.is_empty() && thickness > 0.0 && thickness.is_finite()).then_some(thickness))
}

fn sorted(walls: &[Wall<'_>]) -> Vec<f64> {
    let mut sorted: Vec<f64> = walls.iter().map(|wall| wall.0).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    sorted
}

/// A thickness in unit coordinates, where it was measured, and the opposite face.
type Wall<'a> = (f64, &'a Sample, u32);

/// The wall behind each sample that has one. `simple` says that every face parts material from air, with the air in front.
fn walls<'a>(
    analysis: &Analysis<'_>,
    simple: bool,
    samples: &'a [Sample],
    context: &Context<'_>,
) -> Result<Result<Vec<Wall<'a>>, NoWall>, Cancelled> {
    if samples.is_empty() {
        return Ok(Err(NoWall::NoSurface));
    }
    let diagonal = unit_diagonal(analysis);
    let beside = (BESIDE[0] * diagonal).max(BESIDE[1]);
    let inside = (!simple).then(|| Inside::new(analysis));
    let prober = Prober { analysis, inside, reach: 2.0 * diagonal, beside };
    context.check()?;
    let answers = ask(samples.len(), BUDGET, context, |i, steps| {
        let probe = prober.probe(&samples[i], steps);
        (*steps > 0).then_some(probe)
    })?;
    let (mut asked, mut solid, mut walls) = (0u32, 0u32, Vec::new());
    for (sample, probe) in samples.iter().zip(&answers.values) {
        let Some(probe) = probe else { continue };
        asked += 1;
        solid += u32::from(!matches!(probe, Probe::NotSolid));
        if let &Probe::Wall(thickness, face) = probe {
            walls.push((thickness, sample, face));
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

struct Prober<'a> {
    analysis: &'a Analysis<'a>,
    /// What tells material from air; none where every face parts them, with the air in front of it.
    inside: Option<Inside<'a>>,
    reach: f64,
    beside: f64,
}

impl Prober<'_> {
    fn probe(&self, sample: &Sample, steps: &mut u64) -> Probe {
        let Some(inward) = self.inward(sample, steps) else { return Probe::NotSolid };
        let Some((length, face)) = self.way_out(sample, inward, steps) else { return Probe::NoWall };
        if let Some(wall) = self.ball(sample.point, inward, length / 2.0, steps) {
            return wall;
        }
        let [a, b, c] = self.analysis.unit_corners(face);
        let opposite = (b - a).cross(c - a).normalize_or_zero().dot(inward).abs() >= OPPOSITE;
        if opposite { Probe::Wall(length, face) } else { Probe::NoWall }
    }

    /// The direction from a sample into the material, if there is material on one side and air on the other.
    fn inward(&self, sample: &Sample, steps: &mut u64) -> Option<DVec3> {
        let Some(inside) = &self.inside else { return Some(-sample.normal) };
        let [front, back] = inside.windings(sample.point, sample.normal * self.beside, steps);
        if front < AIR && back > MATERIAL {
            Some(-sample.normal)
        } else {
            (back < AIR && front > MATERIAL).then_some(sample.normal)
        }
    }

    /// Whether a point just behind a face that was met from the material is in air.
    fn is_air(&self, beyond: DVec3, steps: &mut u64) -> bool {
        self.inside.as_ref().is_none_or(|inside| inside.winding(beyond, steps) < AIR)
    }

    /// How far it is inward to where the air begins, and the face there.
    fn way_out(&self, sample: &Sample, inward: DVec3, steps: &mut u64) -> Option<(f64, u32)> {
        let ray = inward * self.reach;
        let mut passed = None;
        for _ in 0..MOST_PASSED {
            let first = self.analysis.tree().first_along([sample.point, sample.point + ray], passed, steps, |face| {
                let other = face != sample.face;
                other.then(|| hit(sample.point, ray, self.analysis.unit_corners(face))).flatten()
            });
            let (share, face) = first.filter(|_| *steps > 0)?;
            let length = share * self.reach;
            if self.is_air(sample.point + inward * (length + self.beside), steps) {
                return Some((length, face)).filter(|_| *steps > 0);
            }
            passed = first;
        }
        None
    }

    /// The wall by the largest ball of at most `radius` that touches `point` from inside, where it touches an opposite side.
    fn ball(&self, point: DVec3, inward: DVec3, radius: f64, steps: &mut u64) -> Option<Probe> {
        let ball = self.analysis.tree().shrunk_ball(point, inward, radius, steps, |f| self.analysis.unit_corners(f))?;
        let contact = ball.touches.filter(|_| *steps > 0)?;
        let outward = (contact.point - (point + inward * ball.radius)) / ball.radius;
        let beyond = contact.point + outward * self.beside;
        let wall = outward.dot(inward) >= OPPOSITE && self.is_air(beyond, steps);
        wall.then_some(Probe::Wall(2.0 * ball.radius, contact.face))
    }
}
