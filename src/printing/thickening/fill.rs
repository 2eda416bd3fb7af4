//! Rounds that unite a solid with balls along the middle of its thin places, until nothing is thin.

use crate::context::{Cancelled, Context};
use crate::math::{Box3, Tree};
use crate::mesh::{Edges, Parts, Surface};
use crate::remesh::{BallUnion, RemeshError};
use crate::simplify::Simplify;
use glam::DVec3;
use rayon::prelude::*;

use super::bodies::{Filler, Fillers};
use super::outcome::{Thickening, ThinReason};
use super::results::{Grown, Thin};
use super::unite::{Broken, Expected, SelfUnion, Topology, united};

/// The most rounds.
const MAX_ROUNDS: usize = 3;
/// Edge lengths of cells as shares of the least wall, finest first, with the shares by which balls are larger than the
/// least wall to cover the error of their surface.
const CELLS: [(f64, f64); 3] = [(1.0 / 6.0, 0.04), (0.2, 0.05), (0.25, 0.07)];
/// How much more a ball grows in each round after the first.
const MORE: f64 = 0.01;
/// The most faces of a body, and the most memory of its samples.
const MAX_FACES: u64 = 600_000;
const MAX_MEMORY: u64 = 1 << 29;
/// The error of the body's simplification, as a share of the least wall.
const SIMPLIFIED: f64 = 0.004;
/// The most unions of a round.
const MAX_UNIONS: usize = 10;

/// The settings of the rounds.
pub struct Filling<'a> {
    pub settings: Thickening,
    pub union: &'a dyn SelfUnion,
    pub context: &'a Context<'a>,
    /// The number of the input's faces: sources from here on mean added faces.
    pub faces: u32,
}

/// A closed surface around balls, and its components.
struct Body {
    surface: Surface,
    /// For each face, the number of its component.
    component: Vec<u32>,
    count: u32,
}

impl Filling<'_> {
    /// Runs the rounds. Ends early, with what was reached, when the time runs out.
    ///
    /// # Errors
    /// [`Cancelled`] when the work was cancelled.
    pub fn run(&self, mut grown: Grown) -> Result<Grown, Cancelled> {
        for number in 0..MAX_ROUNDS {
            if grown.thin.is_empty() {
                break;
            }
            let Some(next) = self.context.unless_late(self.round(&grown, number))? else {
                grown.reason = Some(ThinReason::Time);
                break;
            };
            let is_better = next.thin.area < grown.thin.area || next.thin.tips.len() < grown.thin.tips.len();
            if !is_better {
                grown.limited.extend(next.limited);
                grown.reason = next.reason;
                break;
            }
            grown = next;
        }
        Ok(grown)
    }

    /// One round. The surface stays the same if nothing can grow.
    fn round(&self, grown: &Grown, number: usize) -> Result<Grown, Cancelled> {
        let mut next = grown.clone();
        next.reason = Some(ThinReason::Union);
        for (share, margin) in CELLS {
            let cell = share * self.settings.min_wall;
            let margin = margin + MORE * number as f64;
            let finder = Fillers::new(&grown.surface, self.settings, cell, margin);
            let Some(fillers) = finder.of(&grown.thin, number > 0, self.context)? else { continue };
            next.limited.extend(fillers.iter().filter(|filler| filler.is_limited).map(|filler| filler.centre));
            if fillers.iter().all(|filler| filler.radius <= 0.0) {
                return Ok(next);
            }
            self.context.log(&format!("    round {number} cell {share:.3}: {} walls {} tips of {}, {} balls, {} limited", grown.thin.walls.len(), grown.thin.tips.len(), grown.surface.faces.len(), fillers.len(), fillers.iter().filter(|f| f.is_limited).count()));
            let body = match self.body(&fillers, cell) {
                Ok(body) => body,
                Err(RemeshError::Cancelled(cancelled)) => return Err(cancelled),
                Err(_) => continue,
            };
            self.context.log(&format!("    body {} faces, {} components", body.surface.faces.len(), body.count));
            let (result, broken) = self.largest_union(&grown.surface, &body)?;
            next.reason = broken.map(|broken| match broken {
                Broken::Union => ThinReason::Union,
                Broken::Topology => ThinReason::Topology,
            });
            if let Some(surface) = result {
                self.context.log(&format!("    union {} faces", surface.faces.len()));
                next.surface = self.with_sources(surface, &grown.surface);
                next.thin = Thin::of(&next.surface, self.settings.min_wall, self.context)?;
                self.context.log(&format!("    then {} walls {} tips thin, least {:.4}", next.thin.walls.len(), next.thin.tips.len(), next.thin.walls.iter().map(|p| p.thickness).fold(f64::INFINITY, f64::min) / self.settings.min_wall));
            }
            return Ok(next);
        }
        Ok(next)
    }

    /// The surface of a union of balls, simplified.
    fn body(&self, fillers: &[Filler], cell: f64) -> Result<Body, RemeshError> {
        let balls: Vec<_> = fillers.iter().map(|filler| (filler.centre, filler.radius)).filter(|b| b.1 > 0.0).collect();
        let Thickening { precision, min_wall, .. } = self.settings;
        let union = BallUnion { balls: &balls, cell, max_faces: MAX_FACES, max_memory: MAX_MEMORY, precision };
        let mut surface = union.surface(self.context)?;
        self.context.log(&format!("    contour {} faces", surface.faces.len()));
        let simplify = Simplify {
            max_faces: None,
            max_error: SIMPLIFIED * min_wall,
            feature_angle_deg: 60.0,
            precision,
            toward: None,
        };
        simplify.apply(&mut surface, self.context)?;
        Ok(Body::new(surface))
    }

    /// The union with as many components of a body as possible, and why others are left out. By halving.
    fn largest_union(
        &self,
        surface: &Surface,
        body: &Body,
    ) -> Result<(Option<Surface>, Option<Broken>), Cancelled> {
        let topology = Topology::of(surface);
        let (mut good, mut best, mut broken) = (Vec::new(), None, None);
        let mut open: Vec<Vec<u32>> = vec![(0..body.count).collect()];
        let mut unions = 0;
        while let Some(some) = open.pop() {
            if unions >= MAX_UNIONS {
                break;
            }
            unions += 1;
            let mut with: Vec<u32> = good.iter().chain(&some).copied().collect();
            with.sort_unstable();
            match self.union_of(surface, body, &with, topology)? {
                Ok(result) => (good, best) = (with, Some(result)),
                Err(reason) => {
                    self.context.log(&format!("    {} components: {reason:?}", some.len()));
                    broken = Some(reason);
                    if some.len() > 1 {
                        let (left, right) = some.split_at(some.len() / 2);
                        open.extend([right.to_vec(), left.to_vec()]);
                    }
                }
            }
        }
        Ok((best, broken))
    }

    fn union_of(
        &self,
        surface: &Surface,
        body: &Body,
        components: &[u32],
        topology: Topology,
    ) -> Result<Result<Surface, Broken>, Cancelled> {
        let first = u32::try_from(surface.positions.len()).unwrap_or(u32::MAX);
        let mut both = surface.clone();
        both.positions.extend(&body.surface.positions);
        for (face, component) in body.surface.faces.iter().zip(&body.component) {
            if components.binary_search(component).is_ok() {
                both.push_generated(face.map(|v| v + first), self.mark());
            }
        }
        both.drop_unreferenced();
        let expected = Expected { topology, min_wall: self.settings.min_wall, first_added: self.faces };
        united(&both, expected, self.union, self.context)
    }

    /// The source of a body's faces.
    fn mark(&self) -> u32 {
        2 * self.faces
    }

    /// Gives the faces of a body the source of the nearest face below.
    fn with_sources(&self, mut united: Surface, below: &Surface) -> Surface {
        let tree = Tree::new(&below.positions, &below.faces);
        let nearest = |face: usize| {
            let centre = united.corners(face).into_iter().sum::<DVec3>() / 3.0;
            let found = tree.nearest(centre, f64::INFINITY, &mut u64::MAX.clone(), |f| below.corners(f as usize));
            found.map_or(self.faces, |found| below.source[found.face as usize] % self.faces + self.faces)
        };
        let source = |face: usize| if united.source[face] == self.mark() { nearest(face) } else { united.source[face] };
        united.source = (0..united.faces.len()).into_par_iter().map(source).collect();
        united
    }
}

impl Body {
    fn new(surface: Surface) -> Self {
        let parts = Parts::new(&surface, &Edges::new(&surface.faces));
        let boxes: Vec<(Box3, f64)> = parts.faces().iter().map(|faces| measured(&surface, faces)).collect();
        // A cavity belongs to the smallest component around it.
        let mut component: Vec<u32> = (0u32..).take(boxes.len()).collect();
        for (part, (bounds, volume)) in boxes.iter().enumerate().filter(|(_, (_, volume))| *volume < 0.0) {
            let around = boxes.iter().enumerate().filter(|(_, other)| other.1 > -volume && other.0.contains(bounds));
            let smallest = around.min_by(|a, b| a.1.1.total_cmp(&b.1.1));
            #[expect(clippy::cast_possible_truncation, reason = "parts are counted in u32")]
            if let Some((outer, _)) = smallest {
                component[part] = outer as u32;
            }
        }
        let count = u32::try_from(boxes.len()).unwrap_or(u32::MAX);
        let component = parts.of_face.iter().map(|&part| component.get(part as usize).copied().unwrap_or(0)).collect();
        Self { surface, component, count }
    }
}

/// The box and the enclosed volume of some faces.
fn measured(surface: &Surface, faces: &[u32]) -> (Box3, f64) {
    let corners = || faces.iter().map(|&face| surface.corners(face as usize));
    let bounds = Box3::of(corners().flatten());
    let origin = bounds.centre();
    let volume = corners().map(|corners| corners.map(|p| p - origin)).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum();
    (bounds, volume)
}
