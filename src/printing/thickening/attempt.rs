//! The unions that a round tries, the one that adds the fewest faces first.

use crate::context::{Cancelled, Context};
use crate::mesh::Surface;

use super::layer::{Layered, layered};
use super::moved::moved;
use super::outcome::Thickening;
use super::pockets::Added;
use super::refine::Refined;
use super::regions::Regions;
use super::results::encloses;
use super::unite::{Broken, SelfUnion, Topology, united};

/// The most unions of a round. More than one is needed only where a promise is broken.
const MAX_UNIONS: usize = 7;
/// How far a point of the surface may be outside a union with it, as a share of the least wall: unions move vertices a little.
const MAX_LOST: f64 = 0.01;

/// The places whose layers can be united, and those whose layers cannot.
pub type Tried = (Vec<u32>, Vec<u32>);

/// The unions that a round tries.
pub struct Attempt<'a> {
    /// The surface that the round starts from, and how it grows.
    pub surface: &'a Surface,
    pub refined: &'a Refined,
    /// The place of each of its faces.
    pub place: &'a [Option<u32>],
    /// The number of faces of the input: faces of the layer get the source of their face plus this.
    pub added: u32,
    pub settings: Thickening,
    pub union: &'a dyn SelfUnion,
    /// The topology of the input.
    pub topology: Topology,
    pub context: &'a Context<'a>,
    /// Whether a region folded so far, and the number of unions so far.
    pub has_folded: bool,
    pub unions: usize,
}

/// How the material is added.
#[derive(Clone, Copy)]
pub enum Shape<'a> {
    /// The vertices of flat regions move. Tells whether regions may fold.
    Moved(&'a Regions, bool),
    /// Prisms stand on the faces.
    Prisms,
}

impl Shape<'_> {
    /// A surface with its layer, whose faces get the source of their face plus `added`. None if no region can move.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub fn layered(
        self,
        (surface, refined): (&Surface, &Refined),
        added: u32,
        settings: &Thickening,
        context: &Context<'_>,
    ) -> Result<Option<Layered>, Cancelled> {
        let (source, precision) = (&surface.source, settings.precision);
        match self {
            Self::Moved(regions, may_fold) => moved((refined, regions, may_fold), source, added, precision, context),
            Self::Prisms => layered(refined, source, added, precision, context).map(Some),
        }
    }
}

impl Attempt<'_> {
    /// The union with the layer of some places, in ascending order; none if they have no layer.
    pub fn union_in(&mut self, shape: Shape<'_>, places: &[u32]) -> Result<Option<Result<Surface, Broken>>, Cancelled> {
        if matches!(shape, Shape::Moved(_, false)) && !self.has_folded {
            // No region folded, so the result would be the same.
            return Ok(Some(Err(Broken::Union)));
        }
        let takes_part =
            |parent: u32| self.place[parent as usize].is_none_or(|place| places.binary_search(&place).is_ok());
        let &mut Self { surface, added, ref settings, context, .. } = self;
        self.unions += 1;
        let layered = shape.layered((surface, &self.refined.only(takes_part)), added, settings, context)?;
        let Some(layered) = layered else { return Ok(Some(Err(Broken::Union))) };
        self.has_folded |= layered.is_folded;
        if layered.piece.iter().all(Option::is_none) {
            return Ok(None);
        }
        let united = united(&layered.surface, (Added::Layer, added), settings, self.union, context)?;
        let Some(united) = united else { return Ok(Some(Err(Broken::Union))) };
        // Only faces that face back can take material away.
        if layered.is_folded && !encloses(&united.surface, surface, MAX_LOST * settings.min_wall) {
            return Ok(Some(Err(Broken::Union)));
        }
        Ok(Some(united.topology.broken_since(self.topology).map_or(Ok(united.surface), Err)))
    }

    /// The places whose prisms can be united together, and those whose prisms cannot. By halving.
    pub fn largest_good(&mut self, all: &[u32]) -> Result<Tried, Cancelled> {
        let (mut good, mut broken): (Vec<u32>, Vec<u32>) = (Vec::new(), Vec::new());
        let mut open: Vec<Vec<u32>> = vec![all.to_vec()];
        let mut is_first = true;
        while let Some(some) = open.pop() {
            let mut with: Vec<u32> = good.iter().chain(&some).copied().collect();
            with.sort_unstable();
            let outcome = if is_first {
                Err(Broken::Union)
            } else if self.unions >= MAX_UNIONS {
                broken.extend(&some);
                continue;
            } else {
                self.union_in(Shape::Prisms, &with)?.map_or(Ok(()), |result| result.map(|_| ()))
            };
            is_first = false;
            match outcome {
                Ok(()) => good = with,
                Err(_) if some.len() == 1 => broken.push(some[0]),
                Err(_) => {
                    let (left, right) = some.split_at(some.len() / 2);
                    open.extend([right.to_vec(), left.to_vec()]);
                }
            }
        }
        Ok((good, broken))
    }
}
