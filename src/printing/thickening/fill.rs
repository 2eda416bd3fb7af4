//! Rounds that unite a solid with balls along the middle of its thin places, until nothing is thin.

use crate::context::{Cancelled, Context};
use crate::math::{Box3, Tree};
use crate::mesh::{Edges, Parts, Surface};
use crate::remesh::{BallUnion, RemeshError};
use glam::DVec3;
use rayon::prelude::*;

use super::bodies::{Filler, Fillers, Search};
use super::outcome::{Thickening, ThinReason};
use super::results::{Grown, Thin};
use super::spheres::Spheres;
use super::unite::{Broken, Expected, SelfUnion, Topology, united};

/// The most rounds.
const MAX_ROUNDS: usize = 8;
/// Sizes of cells, finest first. Measuring the result takes longest, so a body of many faces gets larger cells.
const CELLS: [Cells; 2] =
    [Cells { share: 0.2, margin: 0.08, max_faces: 50_000 }, Cells { share: 0.32, margin: 0.12, max_faces: 150_000 }];
/// How much more a ball grows in each round after the first.
const MORE: f64 = 0.01;
/// The most memory of a body's samples.
const MAX_MEMORY: u64 = 1 << 29;
/// The most unions of a round.
const MAX_UNIONS: usize = 10;

/// A size of cells.
struct Cells {
    /// The edge length as a share of the least wall.
    share: f64,
    /// The share by which balls are larger than the least wall, to cover the error of their surface.
    margin: f64,
    /// The most faces of a body.
    max_faces: u64,
}

/// The settings of the rounds.
pub struct Filling<'a> {
    pub settings: Thickening,
    pub union: &'a dyn SelfUnion,
    pub context: &'a Context<'a>,
    /// The number of the input's faces: sources from here on mean added faces.
    pub faces: u32,
    /// The topology of the input.
    pub topology: Topology,
}

/// A closed surface around balls, and its components.
struct Body {
    surface: Surface,
    /// For each face, the number of its component.
    component: Vec<u32>,
    count: u32,
}

/// What a round starts from.
struct Start<'a> {
    /// The surface with which balls are united.
    base: &'a Grown,
    /// The best result so far, whose thin places get balls.
    current: &'a Grown,
    number: usize,
}

impl Filling<'_> {
    /// Runs the rounds. Each unites the balls of all rounds with the first surface, so that no round cuts what another
    /// added. Ends early, with the best result, when the time runs out.
    ///
    /// # Errors
    /// [`Cancelled`] when the work was cancelled.
    pub fn run(&self, base: &Grown) -> Result<Grown, Cancelled> {
        let (mut best, mut current) = (base.clone(), base.clone());
        let mut balls = Vec::new();
        for number in 0..MAX_ROUNDS {
            if current.thin.is_empty() {
                break;
            }
            let start = Start { base, current: &current, number };
            let Some(next) = self.context.unless_late(self.round(&start, &mut balls))? else {
                best.reason = Some(ThinReason::Time);
                break;
            };
            best.reason = next.reason.or(best.reason);
            if next.surface == current.surface {
                best.limited.extend(next.limited);
                break;
            }
            current = next;
            if current.thin.lack < best.thin.lack {
                best = current.clone();
            }
        }
        Ok(best)
    }

    /// One round. The surface stays the same if nothing can grow.
    fn round(&self, start: &Start<'_>, balls: &mut Vec<Filler>) -> Result<Grown, Cancelled> {
        let &Start { base, current, number } = start;
        let mut next = Grown { reason: Some(ThinReason::Union), ..current.clone() };
        for Cells { share, margin, max_faces } in CELLS {
            let cell = share * self.settings.min_wall;
            let search = Search { spacing: cell, margin: margin + MORE * number as f64, is_first: number == 0 };
            let Some(fillers) =
                Fillers::new(&current.surface, self.settings, search).of(&current.thin, self.context)?
            else {
                continue;
            };
            next.limited.extend(fillers.iter().filter(|filler| filler.is_limited).map(|filler| filler.centre));
            if fillers.iter().all(|filler| filler.radius <= 0.0) {
                return Ok(Grown { reason: None, ..next });
            }
            let all: Vec<Filler> = balls.iter().chain(&fillers).copied().collect();
            let body = match self.body(&all, cell, max_faces) {
                Ok(body) => body,
                Err(RemeshError::Cancelled(cancelled)) => return Err(cancelled),
                Err(_) => continue,
            };
            *balls = all;
            let (result, broken) = self.largest_union(&base.surface, &body)?;
            next.reason = broken.map(|broken| match broken {
                Broken::Union => ThinReason::Union,
                Broken::Topology => ThinReason::Topology,
            });
            if let Some(surface) = result {
                next.surface = self.with_sources(surface, &base.surface);
                next.thin = Thin::of(&next.surface, self.settings.min_wall, self.context)?;
            }
            return Ok(next);
        }
        Ok(next)
    }

    /// The surface of a union of balls.
    fn body(&self, fillers: &[Filler], cell: f64, max_faces: u64) -> Result<Body, RemeshError> {
        let balls: Vec<_> = fillers.iter().map(|filler| (filler.centre, filler.radius)).filter(|b| b.1 > 0.0).collect();
        let precision = self.settings.precision;
        let union = BallUnion { balls: &balls, cell, max_faces, max_memory: MAX_MEMORY, precision };
        let mut surface = union.surface(self.context)?;
        Spheres::new(&balls, cell, precision).fit(&mut surface);
        Ok(Body::new(surface))
    }

    /// The union with as many components of a body as possible, and why others are left out. By halving.
    fn largest_union(&self, surface: &Surface, body: &Body) -> Result<(Option<Surface>, Option<Broken>), Cancelled> {
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
            match self.union_of(surface, body, &with, self.topology)? {
                Ok(result) => (good, best) = (with, Some(result)),
                Err(reason) => {
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
        let expected = Expected { topology, settings: self.settings, first_added: self.faces, has_crumbs: false };
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
