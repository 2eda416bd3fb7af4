//! The rounds of a thickening: measure, grow, unite, and measure again.

use crate::context::{Cancelled, Context};
use crate::math::Tree;
use crate::mesh::Surface;
use glam::DVec3;
use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::attempt::{Attempt, Shape};
use super::growth::{Growths, thin_walls};
use super::outcome::{Thickening, ThickeningError};
use super::places::Places;
use super::refine::Refined;
use super::regions::{Pieces, Regions};
use super::results::{Grown, MAX_THINNER, Thin, deviation_of_added, face_count, with_own_sources};
use super::unite::{SelfUnion, Topology};
use super::walls::{Opposed, Walls};

/// The most rounds.
const MAX_ROUNDS: usize = 3;
/// The most times that the rounds start again without the places that stay thin.
const MAX_RESTARTS: usize = 2;
/// The largest distance from the input, as a share of the least wall: a wall grows on one side by its thickness at most,
/// and a mitre is longer.
const MAX_DEVIATION: f64 = 1.5;
/// The share of a place's area that may stay thin.
const MAX_LEFT: f64 = 0.5;
/// The most times that tops are raised before a union.
const MAX_RAISES: usize = 8;
/// The least that a wall grows after the first round, as a share of the least wall. Thinner layers leave slivers.
const LEAST_STEP: f64 = 0.02;
/// How much more material whole regions may need in all rounds than growth that follows the thickness.
const MAX_MORE: f64 = 1.35;
/// Walls thinner than the least wall by this share count as thin: f32 resolves less.
const RESOLUTION: f64 = 1.0 / (1 << 20) as f64;

/// The state between rounds.
pub struct Rounds<'a> {
    settings: Thickening,
    input: &'a Surface,
    /// Its thin walls.
    before: &'a Thin,
    /// The tree of the input, for the deviation.
    input_tree: Tree,
    union: &'a dyn SelfUnion,
    context: &'a Context<'a>,
    /// The topology of the input.
    topology: Topology,
    /// The places of the input.
    places: Places,
    /// For each place, whether its layer was taken back.
    taken_back: Vec<bool>,
    fit: Fit,
    /// The material that growth following the thickness adds, by the first round, and what flat regions added so far.
    needed: f64,
    added: f64,
    /// Whether a wall grew on both sides although one side should stay.
    grew_on_equal_sides: bool,
}

/// How the surface grows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fit {
    /// Each flat region grows by one distance: its vertices move, or prisms stand on it where they cannot. A
    /// region stays if that needs much more material.
    Regions,
    /// Each point grows as far as it needs, with prisms on pieces of the faces.
    Points,
}

impl<'a> Rounds<'a> {
    /// Runs all rounds from a measured surface. Returns the result with its thin walls. Faces of the result have the index of
    /// the input's face as their source; those of the layer have it plus the number of faces.
    ///
    /// # Errors
    /// [`ThickeningError::Cancelled`] when the work should stop.
    pub fn run(
        settings: Thickening,
        fit: Fit,
        (input, before): (&'a Surface, &'a Thin),
        union: &'a dyn SelfUnion,
        context: &'a Context<'a>,
    ) -> Result<Grown, ThickeningError> {
        let thin_before = thin_of((input, before), settings.min_wall, context)?;
        let places = Places::new(input, &thin_before);
        let taken_back = vec![false; places.count as usize];
        let topology = Topology::of(input, &settings);
        let input_tree = Tree::new(&input.positions, &input.faces);
        let (needed, added) = (0.0, 0.0);
        let mut rounds = Self {
            settings,
            input,
            before,
            input_tree,
            union,
            context,
            topology,
            places,
            taken_back,
            fit,
            needed,
            added,
            grew_on_equal_sides: false,
        };
        let mut best = rounds.grown(&thin_before)?;
        // Where places got worse or stayed thin, their layers are left out and the others start again; at last all are.
        for number in 0..=MAX_RESTARTS {
            let mut failed = rounds.failed(&best, &thin_before);
            let is_hopeless = || rounds.fit == Fit::Regions && failed.len() == rounds.places.count as usize;
            if failed.is_empty() || is_hopeless() {
                break;
            }
            if number == MAX_RESTARTS {
                failed = (0..rounds.places.count).filter(|&p| !rounds.taken_back[p as usize]).collect();
            }
            failed.iter().for_each(|&place| rounds.taken_back[place as usize] = true);
            best = rounds.grown(&thin_before)?;
        }
        let (surface, thin) = (best.surface, best.measured);
        Ok(Grown { surface, thin, grew_on_equal_sides: rounds.grew_on_equal_sides, ..Grown::default() })
    }

    /// The rounds from the input on; the result with the least thin area.
    fn grown(&mut self, thin_before: &[Vec<Opposed>]) -> Result<Measured, ThickeningError> {
        let settings = self.settings;
        // Faces carry the index of the input's face; added faces carry it plus the number of faces.
        let mut surface = with_own_sources(self.input);
        let (mut measured, mut thin) = (self.before.clone(), thin_before.to_vec());
        let area = thin_area(&surface, &thin);
        let mut best = Measured { area, surface: surface.clone(), measured: measured.clone(), thin: thin.clone() };
        for number in 0..MAX_ROUNDS {
            if thin.iter().all(Vec::is_empty) {
                break;
            }
            let Some(next) = self.round((&surface, &measured), number)? else { break };
            surface = next;
            measured = Thin::of(&surface, settings.min_wall, self.context)?;
            thin = thin_of((&surface, &measured), settings.min_wall, self.context)?;
            let area = thin_area(&surface, &thin);
            // The first round is judged place by place.
            let is_better = number == 0 || area < best.area && !self.is_thinner_somewhere(&surface, &thin, &best);
            let is_hopeless = self.fit == Fit::Regions && number > 0 && area > MAX_LEFT * best.area;
            let deviation = || deviation_of_added((self.input, &self.input_tree), &surface);
            if !is_better || is_hopeless || deviation() > MAX_DEVIATION * settings.min_wall {
                break;
            }
            // Where the first round adds more thin faces than it mends, later ones split these further.
            let is_worse = area > best.area;
            best = Measured { area, surface: surface.clone(), measured: measured.clone(), thin: thin.clone() };
            if is_worse {
                break;
            }
        }
        Ok(best)
    }

    /// Whether a place has a thinner wall than in an earlier result.
    fn is_thinner_somewhere(&self, surface: &Surface, thin: &[Vec<Opposed>], earlier: &Measured) -> bool {
        let [now, before] = [self.measures(surface, thin), self.measures(&earlier.surface, &earlier.thin)];
        now.iter().zip(before).any(|(now, before)| now.least < MAX_THINNER * before.least.min(self.settings.min_wall))
    }

    /// The thin area and the least thickness of each place. A thin face of no place counts for the nearest one.
    fn measures(&self, surface: &Surface, thin: &[Vec<Opposed>]) -> Vec<PlaceMeasure> {
        let none = PlaceMeasure { area: 0.0, least: f64::INFINITY };
        let mut measures = vec![none; self.places.count as usize];
        for (face, walls) in thin.iter().enumerate() {
            let Some(wall) = walls.first() else { continue };
            let place = self.place_of(surface, face).or_else(|| self.places.nearest(self.input, wall.points[0]));
            if let Some(place) = place {
                measures[place as usize].add(surface.area_vector(face).length(), wall.thickness);
            }
        }
        measures
    }

    /// The places that are not yet taken back, and of which much stays thin or a wall got thinner.
    fn failed(&self, grown: &Measured, before: &[Vec<Opposed>]) -> Vec<u32> {
        let before = self.measures(&with_own_sources(self.input), before);
        let after = self.measures(&grown.surface, &grown.thin);
        let is_failed = |&place: &u32| {
            let [before, after] = [&before, &after].map(|measures| measures[place as usize]);
            // Balls can mend what whole regions leave at a few faces.
            let is_thinner = || after.least < MAX_THINNER * before.least.min(self.settings.min_wall);
            let is_worse = after.area > MAX_LEFT * before.area || self.fit == Fit::Points && is_thinner();
            let is_near = after.least >= MAX_THINNER * self.settings.min_wall;
            !self.taken_back[place as usize] && is_worse && !is_near
        };
        (0..self.places.count).filter(is_failed).collect()
    }

    fn faces(&self) -> u32 {
        face_count(self.input)
    }

    /// The place of a face, by its carrier.
    fn place_of(&self, surface: &Surface, face: usize) -> Option<u32> {
        self.places.of_face[(surface.source[face] % self.faces().max(1)) as usize]
    }

    /// One round: the united surface; none where nothing grows.
    fn round(
        &mut self,
        (surface, measured): (&Surface, &Thin),
        number: usize,
    ) -> Result<Option<Surface>, ThickeningError> {
        let place: Vec<Option<u32>> = (0..surface.faces.len()).map(|face| self.place_of(surface, face)).collect();
        let least = if number == 0 { 0.0 } else { LEAST_STEP * self.settings.min_wall };
        let (growths, mut pieces) = self.pieces((surface, measured), least, &place, number)?;
        let mut thin: Option<Vec<u32>> = None;
        for _ in 0..MAX_RAISES {
            let still = self.raise(surface, &mut pieces, &growths, thin.as_deref())?;
            if still.is_empty() {
                break;
            }
            thin = Some(still);
        }
        if self.fit == Fit::Points {
            pieces.refined.spread(&growths);
        }
        let all: Vec<u32> = (0..self.places.count).filter(|&place| !self.taken_back[place as usize]).collect();
        let &mut Self { settings, union, topology, context, .. } = self;
        let mut attempt = Attempt {
            surface,
            refined: &pieces.refined,
            place: &place,
            added: self.faces(),
            settings,
            union,
            topology,
            context,
            has_folded: false,
            unions: 0,
        };
        let moved = pieces.regions.iter().flat_map(|regions| [true, false].map(|folds| Shape::Moved(regions, folds)));
        for shape in moved.chain([Shape::Prisms]) {
            if let Some(Ok(whole)) = attempt.union_in(shape, &all)? {
                return Ok(Some(whole));
            }
        }
        let (kept, broken) = attempt.largest_good(&all)?;
        let result = attempt.union_in(Shape::Prisms, &kept)?;
        for place in broken {
            self.taken_back[place as usize] = true;
        }
        Ok(result.and_then(Result::ok))
    }

    /// The surface with its growth, in pieces on which the growth is nearly linear, or in flat regions.
    fn pieces<'s>(
        &mut self,
        (surface, measured): (&'s Surface, &Thin),
        least: f64,
        place: &[Option<u32>],
        number: usize,
    ) -> Result<(Growths<'s>, Pieces), Cancelled> {
        let may_grow = |face: u32| place[face as usize].is_none_or(|place| !self.taken_back[place as usize]);
        let (settings, precision) = (self.settings, self.settings.precision);
        let mut growths = Growths::new((surface, measured.walls()), settings, least, may_grow, self.context)?;
        self.grew_on_equal_sides |= growths.has_equal_sides;
        let mut refined = Refined::new(surface, &growths, precision, self.context)?;
        if self.fit == Fit::Points {
            refined.spread(&growths);
            return Ok((growths, Pieces { refined, regions: None }));
        }
        let mut regions = Regions::new(surface, &growths, &refined, settings.min_wall);
        if number == 0 {
            (self.needed, self.added) = (regions.volume(), 0.0);
        }
        let is_little = number > 0 && self.added + regions.whole_volume() <= MAX_MORE * self.needed;
        if !is_little && !regions.are_thin_as_a_whole() {
            // The sides of thin walls that are part of thick regions stay; the others grow by all that is needed.
            growths.restrict(|face| regions.is_thin_as_a_whole(face), self.context)?;
            regions.assess(&Refined::new(surface, &growths, precision, self.context)?);
            regions.keep_thin_as_a_whole();
        }
        regions.limit(&growths);
        self.added += regions.whole_volume();
        let refined = Refined::unsplit(surface, regions.growth(surface), precision);
        Ok((growths, Pieces { refined, regions: Some(regions) }))
    }

    /// Raises the tops that still have a thin wall, among some pieces or all. Returns their pieces. Raising only
    /// increases distances, so no other piece becomes thin.
    fn raise(
        &self,
        surface: &Surface,
        pieces: &mut Pieces,
        growths: &Growths<'_>,
        among: Option<&[u32]>,
    ) -> Result<Vec<u32>, Cancelled> {
        let refined = &pieces.refined;
        let grown = |shape: Shape<'_>| shape.layered((surface, refined), self.faces(), &self.settings, self.context);
        let moved = pieces.regions.as_ref().map(|regions| grown(Shape::Moved(regions, true))).transpose()?;
        let Some(mut layered) = moved.flatten().map_or_else(|| grown(Shape::Prisms), |moved| Ok(Some(moved)))? else {
            return Ok(Vec::new());
        };
        if layered.is_folded {
            // They bound no material, so that no wall ends at them.
            layered.drop_faces_that_face_back(|face| growths.walls.normal(face));
        }
        let walls = Walls::new(&layered.surface);
        let limit = self.settings.min_wall * (1.0 - RESOLUTION);
        let takes_part = |piece: &u32| among.is_none_or(|among| among.binary_search(piece).is_ok());
        let of_face = |(face, &piece): (u32, &Option<u32>)| piece.filter(takes_part).map(|piece| (face, piece));
        let tops: Vec<(u32, u32)> = (0u32..).zip(&layered.piece).filter_map(of_face).collect();
        self.context.check()?;
        let more: Vec<f64> = tops
            .par_iter()
            .map(|&(face, piece)| {
                let known = growths.witnesses(layered.parent[face as usize]);
                let is_known = |other: u32| {
                    let parent = layered.parent[other as usize];
                    known.iter().any(|witness| witness.wall.face == parent)
                };
                walls.nearest_wall(face, limit, is_known).map_or(0.0, |wall| {
                    let grows_opposite = layered.piece[wall.face as usize].is_some();
                    let centre = refined.corners(piece).into_iter().sum::<DVec3>() / 3.0;
                    let growth = (0..3).map(|k| refined.corner_growth(piece, k)).fold(0.0, f64::max);
                    let place = (centre, refined.parent[piece as usize], growth);
                    growths.additional(&walls, (face, &wall), grows_opposite, place)
                })
            })
            .collect();
        let mut raised: Vec<u32> = Vec::new();
        let mut most: FxHashMap<u32, f64> = FxHashMap::default();
        for (&(_, piece), &more) in tops.iter().zip(&more).filter(|(_, more)| **more > 0.0) {
            raised.push(piece);
            let most = most.entry(pieces.group_of(piece)).or_insert(0.0);
            *most = most.max(more);
        }
        pieces.raise(most, growths);
        raised.sort_unstable();
        Ok(raised)
    }
}

/// The thin area and the least thickness of a place.
#[derive(Clone, Copy)]
struct PlaceMeasure {
    area: f64,
    least: f64,
}

impl PlaceMeasure {
    fn add(&mut self, area: f64, thickness: f64) {
        self.area += area;
        self.least = self.least.min(thickness);
    }
}

/// The result of some rounds.
struct Measured {
    surface: Surface,
    /// The thinnest wall of each thin face.
    measured: Thin,
    /// For each face, its thin walls.
    thin: Vec<Vec<Opposed>>,
    /// Twice the area of the thin faces.
    area: f64,
}

/// The walls of a measured surface that are thinner than `min_wall`.
fn thin_of(
    (surface, measured): (&Surface, &Thin),
    min_wall: f64,
    context: &Context<'_>,
) -> Result<Vec<Vec<Opposed>>, Cancelled> {
    thin_walls(&Walls::new(surface), measured.walls(), min_wall * (1.0 - RESOLUTION), context)
}

/// Twice the area of the faces with a thin wall.
fn thin_area(surface: &Surface, thin: &[Vec<Opposed>]) -> f64 {
    let is_thin = |face: &usize| !thin[*face].is_empty();
    (0..thin.len()).filter(is_thin).map(|face| surface.area_vector(face).length()).sum()
}
