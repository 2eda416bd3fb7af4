use glam::DVec3;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::thinnest::{Search, Wall};
use crate::context::{Cancelled, Context};
use crate::inspect::compare::{Inside, Sample, percentile, samples, unit_diagonal};
use crate::inspect::queries::ask;
use crate::inspect::{Analysis, Measures, Solid, finite};
use crate::math::{OppositeFaces, hit};

/// Points from which the wall is measured whatever its thickness.
const SAMPLES: u32 = 256;
/// The same where winding numbers must tell material from air, which costs more.
const COSTLY_SAMPLES: u32 = 64;
/// Points from which it is measured how much of the surface is thin.
const THIN_SAMPLES: u32 = 256;
/// Boxes and triangles that these points together may look at.
const BUDGET: u64 = 10_000_000;
/// Winding numbers from which on a point is in material, and up to which it is in air. In between the surface is too open to
/// tell.
const MATERIAL: f64 = 0.75;
const AIR: f64 = 0.25;
/// How far beside the surface is asked for material and air: a share of the diagonal, and what f64 tells apart.
const BESIDE: [f64; 2] = [1e-9, 1e-13];
/// A ray passes over faces nearer than this share of the diagonal: they touch the face from which it starts.
const TOUCHING: f64 = 1e-6;
/// Two sides make a wall where they face away from each other to within 30 degrees (its cosine). At the edges of a box the
/// faces are near each other, but there is no thin wall.
const OPPOSITE: f64 = 0.866_025_403_784_438_6;
/// The same for a ball that touches both sides, which turns with the point: 37 degrees.
const BALL_OPPOSITE: f64 = 0.8;
/// Faces that a ray may pass through on its way to the air, as in overlapping parts.
const MOST_PASSED: usize = 16;
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

/// What is at one sample.
pub(super) enum Probe {
    /// The surface does not part material from air here.
    NotSolid,
    /// No opposite side within the length that was asked for.
    NoWall,
    /// The thickness in unit coordinates, and the opposite face.
    Wall(f64, u32),
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
    let prober = Prober::new(analysis, None);
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

/// Measures the wall behind single points.
pub(super) struct Prober<'a> {
    analysis: &'a Analysis<'a>,
    material: Material<'a>,
    /// Longer than any wall.
    reach: f64,
    beside: f64,
    touching: f64,
}

/// What tells on which side of a face the material is.
enum Material<'a> {
    /// Every face of these parts has material behind it and air in front, and other faces are not between the two. With the faces by
    /// the way they are turned.
    Bounded(Vec<bool>, OppositeFaces<'a>),
    /// Winding numbers at points beside the face.
    Measured(Inside<'a>),
}

impl<'a> Prober<'a> {
    /// `bounding` as [`bounding_parts`] finds it.
    fn new(analysis: &'a Analysis<'a>, bounding: Option<Vec<bool>>) -> Self {
        let diagonal = unit_diagonal(analysis);
        let beside = (BESIDE[0] * diagonal).max(BESIDE[1]);
        let material = match bounding {
            Some(parts) => {
                let normal = |face: u32| {
                    let bounds = is_bounding(analysis, &parts, face);
                    if bounds { unit_normal(analysis, face) } else { DVec3::ZERO }
                };
                let opposite = analysis.tree().opposite_faces(OPPOSITE, normal);
                Material::Bounded(parts, opposite)
            }
            None => Material::Measured(Inside::new(analysis)),
        };
        Self { analysis, material, reach: 2.0 * diagonal, beside, touching: TOUCHING * diagonal }
    }

    /// For each face whether a wall of at most `longest` may be behind it.
    pub fn may_have_wall(&self, longest: f64) -> Vec<bool> {
        let faces = self.analysis.surface.faces.len();
        match &self.material {
            Material::Bounded(_, opposite) => opposite.may_be_within(longest.min(self.reach), faces),
            // Parts may be inside out.
            Material::Measured(_) => vec![true; faces],
        }
    }

    /// The wall behind a sample by the ray inward, where it is at most `longest`. Whether the surface parts material from air is
    /// asked only where a ray meets something within that length, or where it is as long as any wall.
    pub fn probe(&self, sample: &Sample, longest: f64, steps: &mut u64) -> Probe {
        let has_none = match &self.material {
            Material::Bounded(parts, opposite) => {
                is_bounding(self.analysis, parts, sample.face) && !self.meets_opposite(opposite, sample, longest, steps)
            }
            Material::Measured(_) => longest < self.reach && !self.meets_anything(sample, longest, steps),
        };
        if has_none {
            return Probe::NoWall;
        }
        let Some(inward) = self.inward(sample, steps) else { return Probe::NotSolid };
        let Some((length, face)) = self.way_out(sample, inward, longest, steps) else { return Probe::NoWall };
        if self.is_opposite(face, inward, OPPOSITE) { Probe::Wall(length, face) } else { Probe::NoWall }
    }

    /// The wall behind a sample by the ray inward or by the ball inside the material that touches the sample, shrunk until
    /// nothing is in it (Ma et al. 2012): the thinner of both.
    fn probe_by_ball(&self, sample: &Sample, steps: &mut u64) -> Probe {
        let Some(inward) = self.inward(sample, steps) else { return Probe::NotSolid };
        let Some((length, face)) = self.way_out(sample, inward, self.reach, steps) else { return Probe::NoWall };
        if let Some(wall) = self.ball(sample.point, inward, length / 2.0, steps) {
            return wall;
        }
        if self.is_opposite(face, inward, BALL_OPPOSITE) { Probe::Wall(length, face) } else { Probe::NoWall }
    }

    fn is_opposite(&self, face: u32, inward: DVec3, cosine: f64) -> bool {
        let along = unit_normal(self.analysis, face).dot(inward);
        // A part turned inside out has its faces' normals inward.
        (if self.is_measured() { along.abs() } else { along }) >= cosine
    }

    fn is_measured(&self) -> bool {
        matches!(self.material, Material::Measured(_))
    }

    /// Whether a ray from a sample against its normal meets an opposite face within a length.
    fn meets_opposite(&self, opposite: &OppositeFaces<'_>, sample: &Sample, longest: f64, steps: &mut u64) -> bool {
        let (ray, least) = (-sample.normal * longest, self.touching / longest);
        opposite.any_along([sample.point, sample.point + ray], sample.normal, steps, |face| {
            let share = hit(sample.point, ray, self.analysis.unit_corners(face));
            face != sample.face && share.is_some_and(|share| share > least)
        })
    }

    /// Whether a face is within a length of a sample along its normal, to either side.
    fn meets_anything(&self, sample: &Sample, longest: f64, steps: &mut u64) -> bool {
        [-sample.normal, sample.normal].into_iter().any(|way| self.first(sample, way * longest, None, steps).is_some())
    }

    /// The first face that a ray from a sample meets, as a share of the ray.
    fn first(&self, sample: &Sample, ray: DVec3, after: Option<(f64, u32)>, steps: &mut u64) -> Option<(f64, u32)> {
        let least = self.touching / ray.length();
        self.analysis.tree().first_along([sample.point, sample.point + ray], after, steps, |face| {
            let other = face != sample.face && self.may_end_material(face);
            let share = other.then(|| hit(sample.point, ray, self.analysis.unit_corners(face))).flatten();
            share.filter(|&share| share > least)
        })
    }

    /// The direction from a sample into the material, if there is material on one side and air on the other.
    fn inward(&self, sample: &Sample, steps: &mut u64) -> Option<DVec3> {
        let inside = match &self.material {
            Material::Bounded(parts, _) => {
                return is_bounding(self.analysis, parts, sample.face).then_some(-sample.normal);
            }
            Material::Measured(inside) => inside,
        };
        let [front, back] = inside.windings(sample.point, sample.normal * self.beside, steps);
        if front < AIR && back > MATERIAL {
            Some(-sample.normal)
        } else {
            (back < AIR && front > MATERIAL).then_some(sample.normal)
        }
    }

    /// Whether air may begin behind a face that is met from the material.
    fn may_end_material(&self, face: u32) -> bool {
        match &self.material {
            Material::Bounded(parts, _) => is_bounding(self.analysis, parts, face),
            Material::Measured(_) => true,
        }
    }

    /// Whether a point just behind a face that was met from the material is in air.
    fn is_air(&self, beyond: DVec3, steps: &mut u64) -> bool {
        match &self.material {
            Material::Bounded(..) => true,
            Material::Measured(inside) => inside.winding(beyond, steps) < AIR,
        }
    }

    /// How far it is inward to where the air begins, if at most `longest`, and the face there.
    fn way_out(&self, sample: &Sample, inward: DVec3, longest: f64, steps: &mut u64) -> Option<(f64, u32)> {
        let ray = inward * longest;
        let mut passed = None;
        for _ in 0..MOST_PASSED {
            let first = self.first(sample, ray, passed, steps);
            let (share, face) = first.filter(|_| *steps > 0)?;
            let length = share * longest;
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
        let wall = outward.dot(inward) >= BALL_OPPOSITE && self.is_air(beyond, steps);
        wall.then_some(Probe::Wall(2.0 * ball.radius, contact.face))
    }
}

fn is_bounding(analysis: &Analysis<'_>, parts: &[bool], face: u32) -> bool {
    parts.get(analysis.parts.of_face[face as usize] as usize).copied().unwrap_or(false)
}

/// The unit normal of a face in unit coordinates; zero where it has no area.
fn unit_normal(analysis: &Analysis<'_>, face: u32) -> DVec3 {
    let [a, b, c] = analysis.unit_corners(face);
    (b - a).cross(c - a).normalize_or_zero()
}
