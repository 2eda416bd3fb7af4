//! Bad places removed and closed again.

mod bad;
mod deviation;
mod patch;
mod regions;

use bad::Bad;
use patch::Patching;
use regions::{Limits, Regions};

use super::{Applied, Counter, Counts, Operation, Scope};
use crate::mesh::Surface;
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// Rings of faces around what is bad that go with it, round by round.
const RINGS: std::ops::RangeInclusive<u32> = 0..=3;
/// Rounds with the same number of rings while they make it better: what a first patch hits goes in the second.
const ROUNDS_A_RING: u32 = 2;

/// How bad places are removed and closed again.
#[derive(Debug, Clone, Copy)]
pub struct CleanAndPatch {
    /// Most edges around a hole that is closed.
    pub max_hole_edges: u32,
    /// Largest extent of a hole that is closed, as a share of the bounding box's diagonal.
    pub max_hole_size: f64,
    /// Most of a part's faces that may go in all, in percent.
    pub max_face_loss_pct: f64,
    /// Most of a part's faces, and of its area, that may go at one place, in percent; 20 by default.
    pub max_region_pct: f64,
    /// The farthest that a patch may be from the surface that it replaces, in the model's unit. A twentieth of the part's
    /// diagonal is the most in any case.
    pub max_deviation: f64,
}

impl Default for CleanAndPatch {
    fn default() -> Self {
        Self {
            max_hole_edges: 1_000_000,
            max_hole_size: 1.0,
            max_face_loss_pct: 40.0,
            max_region_pct: 20.0,
            max_deviation: f64::INFINITY,
        }
    }
}

/// What all rounds did.
#[derive(Debug, Default)]
struct Tally {
    regions: u64,
    removed: u64,
    moved: f64,
}

impl CleanAndPatch {
    /// Removes what is bad with growing rings around it and closes the holes, while that makes it better.
    ///
    /// Bad are faces at open or non-manifold edges, and faces that intersect others of their part. What belongs together,
    /// by a vertex or by an intersection, is one region. Its patch stays where the region has fewer open and
    /// non-manifold edges and intersecting pairs than before, counted exactly, no edge is open that was not, and the
    /// patch is near what it replaces; otherwise the region is put back as it was and tried again with one more ring.
    ///
    /// ```text
    ///    _____________        _____________        _____________
    ///   |   _/\/X_    |      |   ______    |      |   __ ___    |
    ///   |  |_X\/\_|   |  ->  |  |      |   |  ->  |  |  /   |   |
    ///   |_____________|      |__|______|___|      |__|_/____|___|
    /// ```
    ///
    /// Precondition: consistent winding, and sheets cut apart by index. Result: faces outside of the regions are as they
    /// were, no vertex moves, no part goes or falls in two. Leaves: places that a patch makes no better, that are
    /// larger than the limits, that hold a part together, and intersections between parts. It does nothing where the
    /// intersections are too many to be counted.
    ///
    /// After *Clean and Patch* of Mesh Heal.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let mut bad = Bad::of(surface, context)?;
        let first = bad.total();
        if first == 0 {
            return Ok(Applied::default());
        }
        if !bad.complete {
            let why = "so many faces intersect that they were not all counted; nothing was removed";
            return Ok(Applied { left: Some(why.to_owned()), ..Applied::default() });
        }
        let mut patching = Patching::new(surface);
        let mut tally = Tally::default();
        let (mut too_large, mut put_back) = (0, 0);
        'rings: for rings in RINGS {
            for _ in 0..ROUNDS_A_RING {
                context.check()?;
                let limits = Limits { in_all_pct: self.max_face_loss_pct, at_one_place_pct: self.max_region_pct };
                let regions = Regions::new(&patching, &bad, rings, limits);
                (too_large, put_back) = (regions.too_large, 0);
                if regions.count == 0 {
                    break;
                }
                let reach = (self.max_deviation - tally.moved).max(0.0);
                let round =
                    patching.round(&bad, &regions, reach, (self.max_hole_edges, self.max_hole_size), context)?;
                put_back = round.put_back;
                let Some(made) = round.made else { break };
                if Counts::of(&made.patching.surface).rose_from(&Counts::of(&patching.surface)) {
                    break;
                }
                tally.regions += made.regions;
                tally.removed += made.removed;
                tally.moved += made.deviation;
                (patching, bad) = (made.patching, made.bad);
                if bad.total() == 0 {
                    break 'rings;
                }
            }
        }
        let left = match (too_large, put_back) {
            (0, 0) => None,
            (large, 0) => Some(format!("{large} bad places are too large to be removed")),
            (0, back) => Some(format!("{back} bad places were put back, since a patch made them no better")),
            (large, back) => Some(format!(
                "{large} bad places are too large to be removed; {back} were put back, since a patch made them no better"
            )),
        };
        if tally.regions == 0 {
            return Ok(Applied { left, ..Applied::default() });
        }
        let added = patching.origin.iter().filter(|&&o| o == patch::NEW).count() as u64;
        let changes = Change::list([
            (ChangeKind::PlacesPatched, tally.regions),
            (ChangeKind::FacesRemoved, tally.removed),
            (ChangeKind::FacesAdded, added),
            (ChangeKind::DefectsGone, first - bad.total()),
        ]);
        *surface = patching.surface;
        surface.drop_unreferenced();
        Ok(Applied { changes, moved: tally.moved, left, ..Applied::default() })
    }
}

impl Operation for CleanAndPatch {
    const FIXES: &'static [Counter] = &[Counter::BoundaryEdges, Counter::NonmanifoldEdges];
    const MAY_RAISE: &'static [Counter] = &[];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        let options = scope.options;
        Self {
            max_hole_edges: options.max_hole_edges,
            max_hole_size: options.max_hole_size,
            max_face_loss_pct: options.max_face_loss_pct,
            max_deviation: scope.max_deviation,
            ..Self::default()
        }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}
