//! Balls along the middle of thin places. Their union with the solid is nowhere thinner than the least wall.
//!
//! At points of the thin faces a ball grows inward until it touches the surface again. If both contacts face away from
//! each other, and the ball is thinner than the least wall, its centre is on the middle of a thin place. A ball of the
//! least wall's diameter around the same centre replaces it.

use crate::context::{Cancelled, Context};
use crate::math::{Ball, Nearest, Tree, centre_and_radius, halves, hit, nearest_on_segment};
use crate::mesh::Surface;
use crate::printing::thickness::OpposedPair;
use glam::DVec3;
use rayon::prelude::*;
use rustc_hash::FxHashMap;
use smallvec::SmallVec;

use super::clearance::{Clearances, Contact, OPPOSED, STEPS};
use super::limits::{Filler, Limits};
use super::results::Thin;
use super::sampling::{NearThin, Scope, TriangleBudget};
use super::walls::{noise_of, trusted_normal};

/// The share of the least wall that the perpendicular through a wall measures of the ball's diameter, at least.
const PERPENDICULAR: f64 = (1.0 - OPPOSED) / 2.0;
/// The largest dot product of the normals of two faces between which a perpendicular is as good as a ball.
const PARALLEL: f64 = -0.99;
/// The largest cosine between the way through a neck and the normals of the faces at its edges: 25.8 degrees.
const MAX_ACROSS: f64 = 0.9;
/// Like [`OPPOSED`] in later rounds, for the edges beside earlier balls: 60 degrees.
const WIDE: f64 = -0.5;
/// Faces between two checks for cancellation. A large face has very many samples.
const BATCH: usize = 1 << 6;
/// Faces larger than this many least walls are split without a test of their thickness: the ball that would prove it meets
/// too many other faces.
const MAX_TESTED: f64 = 2.0;
/// The most triangles that the faces of a batch are split into. A wall that is far thinner than its faces needs more.
const MAX_TRIANGLES: u64 = 4_000_000;
/// The deepest subdivision of a face.
const MAX_DEPTH: u32 = 32;
/// Sine of half the angle of a wedge from which its end counts as a sharp edge.
const LEAST_TAPER: f64 = 0.08;
/// Share of the way to the edge of a wedge that must be free.
const TIP_REACH: f64 = 0.8;
/// How far from the thinnest places of faces a later search looks, in least walls. Most long faces that earlier balls cut are
/// thin in a few places only.
const NEAR: f64 = 6.0;
/// How far from the thinnest places of faces walls may be thicker than the least wall by a tolerance, in least walls.
const BESIDE: f64 = 0.5;
/// The most balls.
pub const MAX_BALLS: usize = 4_000_000;

/// The search for the balls of a surface.
pub struct Fillers<'a> {
    surface: &'a Surface,
    tree: Tree,
    limits: &'a Limits<'a>,
    search: Search,
    noise: f64,
}

/// How balls are searched.
#[derive(Debug, Clone, Copy)]
pub struct Search {
    /// The distance between samples.
    pub spacing: f64,
    /// The share by which a ball is larger than needed, to cover the error of its surface.
    pub margin: f64,
    /// How far a ball exceeds a sharp edge, as a share of the least wall, so that its surface surely covers the edge.
    pub tip_cover: f64,
    /// How much thicker than the least wall a wall near a thin place may be, as a share of it, to get balls as well. The border of
    /// the balls then lies where the wall is surely thick.
    pub tolerance: f64,
    /// Whether this is the first search. A later one looks only near the thinnest places of faces, but also puts balls around
    /// the middle of each thin pair, in lips, and at wider edges.
    pub is_first: bool,
}

/// The number of a cell in each direction.
pub type Cell = [i64; 3];

/// The cells with thin balls, and whether one of them has a filler of its full size. More balls there add nothing.
type Filled = FxHashMap<Cell, bool>;

/// The fillers found so far, one for each cell.
#[derive(Default)]
struct Kept {
    fillers: Vec<Filler>,
    of_cell: FxHashMap<Cell, usize>,
    is_filled: Filled,
}

impl Kept {
    /// Adds a cell with a thin ball; whether it is new.
    fn is_first(&mut self, cell: Cell) -> bool {
        let len = self.is_filled.len();
        self.is_filled.entry(cell).or_default();
        self.is_filled.len() > len
    }

    /// Keeps the larger filler of a cell.
    fn take(&mut self, cell: Cell, found: Filler) {
        let at = *self.of_cell.entry(cell).or_insert(self.fillers.len());
        if at == self.fillers.len() {
            self.fillers.push(found);
        } else if found.radius > self.fillers[at].radius {
            self.fillers[at] = found;
        }
    }
}

/// A ball inside the solid that touches it at two opposed points and is thinner than the least wall.
struct ThinBall {
    middle: DVec3,
    radius: f64,
    contacts: [Contact; 2],
}

impl<'a> Fillers<'a> {
    /// Prepares the search in a surface that grew from the one with the limits.
    pub fn new(surface: &'a Surface, limits: &'a Limits<'a>, search: Search) -> Self {
        let tree = Tree::new(&surface.positions, &surface.faces);
        Self { surface, tree, limits, search, noise: noise_of(&surface.positions) }
    }

    /// The balls of all thin faces; none if there are too many.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub fn of(&self, pairs: &Thin, context: &Context<'_>) -> Result<Option<Vec<Filler>>, Cancelled> {
        let mut faces: Vec<u32> = pairs.walls().iter().chain(pairs.tips()).map(|pair| pair.faces[0]).collect();
        faces.sort_unstable();
        faces.dedup();
        let near = (!self.search.is_first).then(|| NearThin::new(pairs, NEAR * self.limits.settings.min_wall));
        let mut kept = Kept::default();
        if !self.of_faces(&faces, (near.as_ref(), 0.0), &mut kept, context)? {
            return Ok(None);
        }
        if !self.search.is_first {
            let thin = pairs.walls().par_iter().chain(pairs.tips());
            let found: Vec<Vec<Filler>> = thin.map(|pair| self.of_pair(pair)).collect();
            context.check()?;
            found.into_iter().flatten().for_each(|filler| kept.take(self.cell(filler.centre), filler));
        }
        if self.search.tolerance > 0.0 {
            let beside = NearThin::new(pairs, BESIDE * self.limits.settings.min_wall);
            let faces = beside.faces(self.surface);
            if !self.of_faces(&faces, (Some(&beside), self.search.tolerance), &mut kept, context)? {
                return Ok(None);
            }
        }
        Ok(Some(kept.fillers))
    }

    /// Adds the balls of some faces near some places, where walls may exceed the least wall by a share of it. False if there are
    /// too many.
    fn of_faces(
        &self,
        faces: &[u32],
        (near, tolerance): (Option<&NearThin>, f64),
        kept: &mut Kept,
        context: &Context<'_>,
    ) -> Result<bool, Cancelled> {
        for batch in faces.chunks(BATCH) {
            let budget = TriangleBudget::new(MAX_TRIANGLES, context);
            let scope = Scope { budget: &budget, near, tolerance };
            let of_face = |&face| self.of_face(face, &kept.is_filled, scope);
            let found: Vec<Vec<ThinBall>> = batch.par_iter().map(of_face).collect();
            context.check()?;
            if budget.is_exceeded() {
                return Ok(false);
            }
            let (first, others): (Vec<_>, Vec<_>) =
                found.into_iter().flatten().partition(|ball| kept.is_first(self.cell(ball.middle)));
            for balls in [first, others] {
                let open = balls.par_iter().filter(|ball| !kept.is_filled[&self.cell(ball.middle)]);
                let found: Vec<_> = open.map(|ball| (ball.middle, self.of_ball(ball))).collect();
                for (middle, filler) in found {
                    kept.is_filled.insert(self.cell(middle), !filler.is_limited);
                    kept.take(self.cell(filler.centre), filler);
                }
            }
            if kept.fillers.len() > MAX_BALLS {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// The ball around the middle of a thin pair, and those along the edge that it begins at. A neck between two concave edges is thin
    /// all along them, but each face tells one place only.
    fn of_pair(&self, pair: &OpposedPair) -> Vec<Filler> {
        let [p, q] = pair.points;
        let [normal, opposite] = pair.faces.map(|face| self.normal(face));
        let contacts = [Contact { point: p, normal }, Contact { point: q, normal: opposite }];
        let ball = ThinBall { middle: p.midpoint(q), radius: p.distance(q) / 2.0, contacts };
        let mut found = vec![self.of_ball(&ball)];
        let way = (q - p).normalize_or_zero();
        // Where the faces at the edges are across the way, samples of them find the wall.
        if -normal.dot(way) < MAX_ACROSS && opposite.dot(way) < MAX_ACROSS {
            let [at_p, at_q] = [0, 1].map(|k| self.edges_at(pair.faces[k], pair.points[k]));
            let along = |[start, end]: [DVec3; 2]| (end - start).normalize_or_zero();
            let is_parallel =
                |edge: &[DVec3; 2]| at_q.iter().any(|other| along(*edge).dot(along(*other)).abs() > -PARALLEL);
            for edge in at_p.into_iter().filter(is_parallel) {
                let across = |point: DVec3| self.across(point, way);
                found.extend(self.points_along(edge, p).filter_map(across).map(|ball| self.of_ball(&ball)));
            }
        }
        found
    }

    /// The edges of a face at a point.
    fn edges_at(&self, face: u32, point: DVec3) -> SmallVec<[[DVec3; 2]; 2]> {
        let corners = self.surface.corners(face as usize);
        let edges = [0, 1, 2].map(|k| [corners[k], corners[(k + 1) % 3]]);
        edges.into_iter().filter(|edge| nearest_on_segment(point, *edge).distance(point) <= self.noise).collect()
    }

    /// Points of an edge near one of them.
    fn points_along(&self, [start, end]: [DVec3; 2], near: DVec3) -> impl Iterator<Item = DVec3> {
        let (step, reach) = (self.search.spacing, NEAR * self.limits.settings.min_wall);
        let way = (end - start).normalize_or_zero();
        let ends = [(near - start).length().min(reach), (end - near).length().min(reach)];
        #[expect(clippy::cast_possible_truncation, reason = "at most reach / step, which is small")]
        let [back, ahead] = ends.map(|length| (length / step) as i32);
        (-back..=ahead).filter(|&number| number != 0).map(move |number| near + way * (step * f64::from(number)))
    }

    /// The ball around the way through a wall from a point of an edge, if the wall is thin.
    fn across(&self, point: DVec3, way: DVec3) -> Option<ThinBall> {
        let start = point + way * self.noise;
        let opposite = self.opposite(start, (None, -way), self.limits.settings.min_wall)?;
        let contacts = [Contact { point, normal: -way }, Contact { point: opposite.point, normal: way }];
        let (middle, distance) = (point.midpoint(opposite.point), point.distance(opposite.point));
        self.is_thin(distance, self.search.tolerance).then_some(ThinBall { middle, radius: distance / 2.0, contacts })
    }

    /// The cell of a point.
    fn cell(&self, point: DVec3) -> Cell {
        cell_of(point, self.search.spacing)
    }

    fn normal(&self, face: u32) -> DVec3 {
        trusted_normal(self.surface.corners(face as usize), self.noise)
    }

    /// The thin balls at samples of a face, but hardly any in cells that are filled. Incomplete where the budget is
    /// exceeded, or the work should stop.
    fn of_face(&self, face: u32, is_filled: &Filled, scope: Scope<'_>) -> Vec<ThinBall> {
        let normal = self.normal(face);
        let mut found = Vec::new();
        if normal != DVec3::ZERO {
            let corners = self.surface.corners(face as usize);
            self.sample(corners, (Some(face), normal), (0, scope), &mut |contact, opposite| {
                if !opposite.is_some_and(|opposite| self.is_filled_between(contact, opposite, is_filled)) {
                    found.extend(self.thin_ball(contact, opposite, scope.tolerance));
                }
            });
        }
        found
    }

    /// Whether the cell in the middle of a wall between parallel faces is filled, from the other side as a rule.
    fn is_filled_between(&self, Contact { point, normal }: Contact, opposite: Nearest, is_filled: &Filled) -> bool {
        let is_parallel = || self.normal(opposite.face).dot(normal) < PARALLEL;
        is_filled.get(&self.cell(point.midpoint(opposite.point))).is_some_and(|&is_filled| is_filled) && is_parallel()
    }

    /// Visits samples of a triangle of a face, with the points opposite. A large triangle has those of its halves.
    fn sample(
        &self,
        corners: [DVec3; 3],
        of: (Option<u32>, DVec3),
        (depth, scope): (u32, Scope<'_>),
        visit: &mut impl FnMut(Contact, Option<Nearest>),
    ) {
        if scope.budget.should_stop() {
            return;
        }
        let (_, normal) = of;
        let (centre, size) = centre_and_radius(corners);
        if scope.near.is_some_and(|near| !near.reaches(centre, size)) {
            return;
        }
        if size <= 0.6 * self.search.spacing || depth >= MAX_DEPTH {
            visit(Contact { point: centre, normal }, self.opposite(centre, of, 2.0 * self.thickest()));
            return;
        }
        let may_be_thin = || {
            let radius = self.thickest() + size;
            self.opposite(centre, of, 2.0 * radius).is_some()
                || self.ball([centre, -normal], radius).is_some_and(|ball| ball.touches.is_some())
        };
        if size > MAX_TESTED * self.limits.settings.min_wall || may_be_thin() {
            // Across the longest side, so that a long narrow face has few samples.
            for half in halves(corners) {
                self.sample(half, of, (depth + 1, scope), visit);
            }
        }
    }

    /// The largest radius of a ball in a thin wall.
    fn thickest(&self) -> f64 {
        0.5 * self.limits.settings.min_wall * (1.0 + self.search.tolerance) / PERPENDICULAR
    }

    /// Where the perpendicular of at most `longest` from a point of a face leaves the material.
    fn opposite(&self, point: DVec3, (own, normal): (Option<u32>, DVec3), longest: f64) -> Option<Nearest> {
        let step = -normal * longest;
        let corners = |face: u32| self.surface.corners(face as usize);
        let first = self.tree.first_hit([point, step], own, &mut STEPS.clone(), corners);
        let at = |(fraction, face): (f64, u32)| Nearest {
            face,
            point: point + step * fraction,
            distance: longest * fraction,
        };
        first.map(at).filter(|opposite| opposite.distance > 0.0)
    }

    /// The largest empty ball of at most `radius` that touches a point, with its centre in a direction from it.
    fn ball(&self, from: [DVec3; 2], radius: f64) -> Option<Ball> {
        self.tree.shrunk_ball(from, radius, &mut STEPS.clone(), |face| self.surface.corners(face as usize))
    }

    /// The ball at a point that is thinner than the least wall; with the point opposite, if the perpendicular meets one.
    fn thin_ball(&self, contact: Contact, opposite: Option<Nearest>, tolerance: f64) -> Option<ThinBall> {
        let chord = || if self.search.is_first { None } else { self.around_chord(contact, opposite?, tolerance) };
        self.inscribed(contact, opposite, tolerance).or_else(chord)
    }

    /// The inscribed ball at a point, if it is thinner than the least wall. With the point opposite, which is found faster,
    /// the ball starts small and meets few faces.
    fn inscribed(&self, contact: Contact, opposite: Option<Nearest>, tolerance: f64) -> Option<ThinBall> {
        let Contact { point, normal } = contact;
        let radius = opposite.map_or(f64::INFINITY, |opposite| opposite.distance / 2.0).min(self.thickest());
        let ball = self.ball([point, -normal], radius)?;
        let touched = ball.touches.or(opposite)?;
        let middle = point - normal * ball.radius;
        let outward = (touched.point - middle).normalize_or_zero();
        let cosine = outward.dot(normal);
        let is_wall = cosine <= OPPOSED && self.is_thin(ball.radius * (1.0 - cosine), tolerance);
        // Beside a ball the edge of a solid can become a wall, which the next round would have to thicken.
        let is_edge = !self.search.is_first && cosine <= WIDE && 2.0 * ball.radius < self.limits.settings.min_wall;
        let contacts = [contact, Contact { point: touched.point, normal: outward }];
        ((is_wall || is_edge) && ball.radius > 0.0).then_some(ThinBall { middle, radius: ball.radius, contacts })
    }

    /// The ball around the perpendicular at a point, if it is a thin wall. In a lip that is less high than thick, each
    /// inscribed ball touches the lip's end instead of the other side.
    fn around_chord(&self, contact: Contact, opposite: Nearest, tolerance: f64) -> Option<ThinBall> {
        let normal = self.normal(opposite.face);
        let contacts = [contact, Contact { point: opposite.point, normal }];
        let ball =
            ThinBall { middle: contact.point.midpoint(opposite.point), radius: opposite.distance / 2.0, contacts };
        (normal.dot(contact.normal) <= OPPOSED && self.is_thin(opposite.distance, tolerance)).then_some(ball)
    }

    /// Whether a thickness is less than the least wall, or hardly more.
    fn is_thin(&self, thickness: f64, tolerance: f64) -> bool {
        thickness < self.limits.settings.min_wall * (1.0 - 1e-6 + tolerance)
    }

    /// The ball that replaces a thin one.
    fn of_ball(&self, &ThinBall { middle, radius, contacts }: &ThinBall) -> Filler {
        let wanted = radius.max(0.5 * self.limits.settings.min_wall) * (1.0 + self.search.margin) - radius;
        let current = (self.surface, &self.tree);
        let filler = Clearances { current, limits: self.limits }.ball((middle, radius), wanted, contacts);
        self.retracted(filler, radius, contacts)
    }

    /// The ball of a wedge that ends in a sharp edge, moved back so that it covers the thin ball of radius `thin` and
    /// hardly exceeds the edge.
    fn retracted(&self, filler: Filler, thin: f64, contacts: [Contact; 2]) -> Filler {
        let sum = contacts[0].normal + contacts[1].normal;
        let taper = sum.length() / 2.0;
        if filler.is_limited || taper < LEAST_TAPER {
            return filler;
        }
        let way = sum / (2.0 * taper);
        let ahead = way * (thin / taper * TIP_REACH);
        let mut is_tip = true;
        self.tree.along(filler.centre, filler.centre + ahead, |face| {
            is_tip = hit(filler.centre, ahead, self.surface.corners(face as usize)).is_none();
            is_tip
        });
        let back = filler.radius - thin - self.search.tip_cover * self.limits.settings.min_wall;
        if is_tip && back > 0.0 {
            Filler { centre: filler.centre - way * back, slack: (filler.slack - back).max(0.0), ..filler }
        } else {
            filler
        }
    }
}

/// The cell of a point in a grid of cells of the given size.
#[expect(clippy::cast_possible_truncation, reason = "coordinates are far fewer than 2^63 cells from the origin")]
pub fn cell_of(point: DVec3, size: f64) -> Cell {
    (point / size).floor().to_array().map(|x| x as i64)
}

#[cfg(test)]
mod tests;
