//! Growth: how far each point of a thin wall's surface must move outward until the wall has the least thickness.

use crate::context::{Cancelled, Context};
use crate::mesh::Surface;
use crate::printing::thickness::OpposedPair;
use glam::DVec3;

use super::outcome::{Growth, Thickening};
use super::sides::kept_side;
use super::walls::{Opposed, WallSide, Walls};

/// Factor on the least wall that is aimed at. It covers the rounding of positions.
pub const AIM: f64 = 1.001;
/// The most thin walls that are examined for a face, and for a point.
const MAX_WITNESSES: usize = 64;
const MAX_AT_POINT: usize = 8;
/// The most that a top is raised at once, as a share of the least wall.
const MAX_ADDITIONAL: f64 = 0.1;

/// A point of a face at which the wall is too thin.
#[derive(Debug, Clone, Copy)]
pub struct Witness {
    /// The point.
    pub point: DVec3,
    /// The growth that it needs, in the model's unit.
    pub growth: f64,
    /// The thin wall.
    pub wall: Opposed,
}

/// The growth of each point of a surface.
pub struct Growths<'a> {
    /// The search for opposed faces.
    pub walls: Walls<'a>,
    settings: Thickening,
    /// The least that a thin wall grows, in the model's unit.
    least: f64,
    /// For each face, the thin walls behind it, thinnest first.
    witnesses: Vec<Vec<Witness>>,
    /// Whether a face may not grow.
    kept: Vec<bool>,
    /// Whether a wall grows on both sides although one side should stay.
    pub has_equal_sides: bool,
}

impl<'a> Growths<'a> {
    /// Finds the walls of a surface, of which `measured` are the thinnest. `may_grow` tells which faces may grow.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub fn new(
        (surface, measured): (&'a Surface, &[OpposedPair]),
        settings: Thickening,
        least: f64,
        may_grow: impl Fn(u32) -> bool,
        context: &Context<'_>,
    ) -> Result<Self, Cancelled> {
        let walls = Walls::new(surface);
        let thin = thin_walls(&walls, measured, settings.min_wall, context)?;
        let kept = vec![false; surface.faces.len()];
        let mut growths = Self { walls, settings, least, witnesses: Vec::new(), kept, has_equal_sides: false };
        if settings.growth != Growth::Both {
            let side = kept_side(surface, &growths.walls, &thin, (settings.growth, settings.min_wall), context)?;
            (growths.kept, growths.has_equal_sides) = (side.faces, side.has_equal_sides);
        }
        for face in (0u32..).zip(&mut growths.kept) {
            *face.1 |= !may_grow(face.0);
        }
        // Whether a face is thin decides how two faces share a gap, so the list must exist before growth is computed.
        let without_growth = |thin: Vec<Opposed>| {
            thin.into_iter().map(|wall| Witness { point: wall.points[0], growth: 0.0, wall }).collect()
        };
        growths.witnesses = thin.into_iter().map(without_growth).collect();
        growths.evaluate(context)?;
        Ok(growths)
    }

    /// Keeps the faces that `may_grow` excludes, too.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub fn restrict(&mut self, may_grow: impl Fn(u32) -> bool, context: &Context<'_>) -> Result<(), Cancelled> {
        for (face, kept) in (0u32..).zip(&mut self.kept) {
            *kept |= !may_grow(face);
        }
        self.evaluate(context)
    }

    /// Evaluates the growth at all witnesses.
    fn evaluate(&mut self, context: &Context<'_>) -> Result<(), Cancelled> {
        let all: Vec<(u32, &[Witness])> = (0u32..).zip(self.witnesses.iter().map(|all| &all[..])).collect();
        let growth: Vec<Vec<f64>> = context.map_in_parallel(&all, |&(face, all)| {
            let of_witness = |witness: &Witness| self.of_wall(&witness.wall, &mut self.front(witness.point, face));
            all.iter().map(of_witness).collect()
        })?;
        for (witnesses, growth) in self.witnesses.iter_mut().zip(growth) {
            witnesses.iter_mut().zip(growth).for_each(|(witness, growth)| witness.growth = growth);
        }
        Ok(())
    }

    /// The least wall that is aimed at.
    pub fn min_wall(&self) -> f64 {
        self.settings.min_wall * AIM
    }

    /// Whether a face has a thin wall behind it.
    pub fn is_thin(&self, face: u32) -> bool {
        !self.witnesses[face as usize].is_empty()
    }

    /// The thin walls behind a face, thinnest first.
    pub fn witnesses(&self, face: u32) -> &[Witness] {
        &self.witnesses[face as usize]
    }

    /// The growth that a point of a face needs.
    pub fn at(&self, point: DVec3, face: u32) -> f64 {
        let opposed = self.walls.of_point((point, face), self.min_wall(), WallSide::Material, MAX_AT_POINT);
        let mut front = self.front(point, face);
        opposed.iter().map(|wall| self.of_wall(wall, &mut front)).fold(0.0, f64::max)
    }

    /// The growth at a point of a face at an end of a wall, within the limits on both sides.
    fn of_wall(&self, wall: &Opposed, front: &mut Front<'_, '_>) -> f64 {
        let (face, to) = (front.face, wall.points[1]);
        let lack = self.lack(&self.walls, face, wall);
        if lack <= 0.0 {
            return 0.0;
        }
        let (ends, wanted) = (Ends::new(&self.walls, face, wall), wall.distance + lack.max(self.least));
        let base = ends.growth_of_both(wanted);
        let own = front.limit(base);
        if own < base {
            return own;
        }
        let other = self.limit(to, wall.face, base);
        if other >= base { base } else { front.limit(ends.growth_of_first(wanted, other)) }
    }

    /// The gaps in front of a point of a face, of which none is known yet.
    fn front(&self, point: DVec3, face: u32) -> Front<'_, 'a> {
        Front { growths: self, point, face, reach: 0.0, gaps: Vec::new() }
    }

    /// How much longer a wall's segment must become.
    fn lack(&self, walls: &Walls<'_>, face: u32, wall: &Opposed) -> f64 {
        (self.min_wall() * walls.factor(face, wall.face) - wall.distance).max(0.0)
    }

    /// The growth that a top needs in addition, by a wall of the layered surface. `grows_opposite` tells whether the
    /// opposed face is a top too, and `piece` is the top's own place on the surface, with the growth that it has.
    pub fn additional(
        &self,
        walls: &Walls<'_>,
        (face, wall): (u32, &Opposed),
        grows_opposite: bool,
        (centre, parent, growth): (DVec3, u32, f64),
    ) -> f64 {
        let (ends, wanted) = (Ends::new(walls, face, wall), wall.distance + self.lack(walls, face, wall));
        let more = if grows_opposite { ends.growth_of_both(wanted) } else { ends.growth_of_first(wanted, 0.0) };
        let most = self.limit(centre, parent, growth + more);
        more.min(most - growth).clamp(0.0, MAX_ADDITIONAL * self.settings.min_wall)
    }

    /// The growth of a face at a point: `wanted`, or less where the gap in front would become too narrow.
    pub fn limit(&self, point: DVec3, face: u32, wanted: f64) -> f64 {
        self.front(point, face).limit(wanted)
    }

    /// The growth of a whole face: `wanted`, or less where a gap in front would become too narrow.
    pub fn limit_of_face(&self, face: u32, wanted: f64) -> f64 {
        if self.kept[face as usize] {
            return 0.0;
        }
        let gaps = self.walls.of_face(face, self.reach(wanted), WallSide::Air, MAX_AT_POINT);
        let least = gaps.iter().map(|gap| self.room(gap)).fold(wanted, f64::min);
        let corners = self.walls.corners(face);
        let centre = corners.into_iter().sum::<DVec3>() / 3.0;
        corners.into_iter().chain([centre]).fold(least, |least, point| self.limit(point, face, least))
    }

    /// How wide a gap matters for a growth.
    fn reach(&self, wanted: f64) -> f64 {
        2.0 * wanted + self.settings.least_gap()
    }

    /// How far one side of a gap may grow.
    fn room(&self, gap: &Opposed) -> f64 {
        let room = (gap.distance - self.settings.least_gap()).max(0.0);
        let is_shared = self.is_thin(gap.face) && !self.kept[gap.face as usize];
        if is_shared { room / 2.0 } else { room }
    }
}

/// The gaps in front of a point of a face, which limit its growth.
struct Front<'g, 'a> {
    growths: &'g Growths<'a>,
    point: DVec3,
    face: u32,
    /// Narrower gaps are known.
    reach: f64,
    gaps: Vec<Opposed>,
}

impl Front<'_, '_> {
    /// The growth at the point: `wanted`, or less where a gap would become too narrow.
    fn limit(&mut self, wanted: f64) -> f64 {
        let growths = self.growths;
        if growths.kept[self.face as usize] {
            return 0.0;
        }
        let reach = growths.reach(wanted);
        if reach > self.reach {
            self.gaps = growths.walls.of_point((self.point, self.face), reach, WallSide::Air, MAX_AT_POINT);
            self.reach = reach;
        }
        let narrow = self.gaps.iter().filter(|gap| gap.thickness < reach);
        narrow.map(|gap| growths.room(gap)).fold(wanted, f64::min)
    }
}

/// The ends of a wall's segment, which move along the normals of their faces.
struct Ends {
    /// From the second end to the first one.
    across: DVec3,
    /// The directions in which the two ends move away from each other.
    apart: [DVec3; 2],
}

impl Ends {
    fn new(walls: &Walls<'_>, face: u32, wall: &Opposed) -> Self {
        let normals = [walls.normal(face), -walls.normal(wall.face)];
        if wall.distance > walls.contact {
            let [from, to] = wall.points;
            return Self { across: from - to, apart: normals };
        }
        let direction = (normals[0] + normals[1]).normalize_or_zero();
        let way = direction * walls.factor(face, wall.face);
        Self { across: direction * wall.distance, apart: [way; 2] }
    }

    /// The growth of both ends at which the segment has this length.
    fn growth_of_both(&self, length: f64) -> f64 {
        growth(self.across, self.apart[0] + self.apart[1], length)
    }

    /// The growth of the first end at which the segment has this length if the second one grows by `other`.
    fn growth_of_first(&self, length: f64, other: f64) -> f64 {
        growth(self.across + self.apart[1] * other, self.apart[0], length)
    }
}

/// The factor of `step` at which `start` plus the step has this length; 0 if `start` is longer. A slanted segment turns
/// towards the step, so it gets longer faster than at the start.
fn growth(start: DVec3, step: DVec3, length: f64) -> f64 {
    let (square, half) = (step.length_squared(), start.dot(step));
    let missing = (length * length - start.length_squared()).max(0.0);
    missing / (half + (half * half + square * missing).sqrt()).max(f64::MIN_POSITIVE)
}

/// For each face, the walls thinner than `min_wall` behind it, thinnest first; `measured` has the thinnest of each face.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn thin_walls(
    walls: &Walls<'_>,
    measured: &[OpposedPair],
    min_wall: f64,
    context: &Context<'_>,
) -> Result<Vec<Vec<Opposed>>, Cancelled> {
    let faces: Vec<u32> = (0u32..).take(walls.face_count()).collect();
    let of_face = |&face: &u32| walls.of_face(face, min_wall, WallSide::Material, MAX_WITNESSES);
    let mut thin = context.map_in_parallel(&faces, of_face)?;
    // The nearest points of two faces can lie on their borders, where a third face is in the way. The measure that decides
    // looks between all points.
    for &OpposedPair { faces: [face, other], points, distance, thickness, .. } in measured {
        let found = &mut thin[face as usize];
        if found.is_empty() {
            found.push(Opposed { face: other, points, distance, thickness });
        }
    }
    Ok(thin)
}
