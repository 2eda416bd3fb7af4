//! The outer skin of a model: its faces that bound the air that a ball of one diameter, the seal, can reach from
//! outside.
//!
//! Made for meshes from generators: two nearly parallel skins with pinholes, inner shells, loose crumbs, any
//! orientation. Orientation plays no part. The skin's facets are pieces of the input's faces; most are whole faces.

mod accounting;
mod cut;
mod double_shell;
mod evidence;
mod labels;
mod lids;
mod sight;
mod states;

use glam::DVec3;

use crate::arrange::ArrangeError;
use crate::arrange::FacetSides;
use crate::context::{Cancelled, Context};
use crate::math::Tree;
use crate::mesh::Surface;
use crate::printing::reach::ReachOptions;
pub use accounting::{Accounting, DropReason, DroppedPiece, kept_exactly_pct};
use double_shell::double_walls;
pub use double_shell::{DoubleShell, recognise_double_shell};
use evidence::evidence;
use lids::Lids;
use states::{Labels, SideCells};

/// Seals that are tried, as shares of the diagonal.
const SEALS: [f64; 3] = [0.024, 0.012, 0.006];
/// Relative change of the volume below which two seals agree.
const AGREEMENT: f64 = 0.01;
/// Octree nodes for a seal that the caller chose, and for one that is tried.
const MAX_NODES: usize = 40_000_000;
const MAX_NODES_TRIED: usize = 3_000_000;
/// A skin with a mean wall below this share of the diagonal may still be hollow.
const HOLLOW_WALL: f64 = 0.05;
/// Widest seal, as a share of the diagonal, and the factor between the seals, with which a hollow skin is tried.
const WIDEST: f64 = 0.1;
const WIDER: f64 = 1.3;
/// A wider seal fills a space if the volume grows by at least this factor.
const FILLS: f64 = 1.25;
/// Octree nodes for half the seal, relative to the nodes for the seal.
const MORE_NODES: usize = 5;

/// Why there is no outer skin.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum OuterSkinError {
    /// The faces could not be arranged.
    #[error(transparent)]
    Arrange(#[from] ArrangeError),
    /// The octree would be too large.
    #[error("`seal_mm` is too small for the model's size")]
    TooFine,
    /// The work was cancelled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// The outer skin of a model.
pub struct OuterSkin {
    /// The facets with outside air on one side, with the air in front, in the order of their faces. `source` holds the
    /// index of the input's face. Open where the input has openings narrower than the seal, or junk that was dropped.
    pub surface: Surface,
    /// The seal, in the model's unit.
    pub seal: f64,
    /// The largest extent of the openings of a few missing faces that count as closed, in the model's unit; 0 without such.
    pub widest_lid: f64,
    /// Which faces of the input are not in the skin, and why.
    pub accounting: Accounting,
    /// A wider seal with which a space that air reaches now would be filled, in the model's unit. None if there is no such
    /// space, or its openings are wider than a tenth of the diagonal.
    pub filling_seal: Option<f64>,
}

/// Finds the outer skin. `seal` is in the model's unit; none chooses one, and counts openings of a few missing faces as
/// closed, whatever their width.
///
/// The surface should be welded; it may be open, intersect itself and have any orientation. Other openings of at least
/// the seal stay open. Crevices stay, unless the space behind them must be cut off anyway.
///
/// # Errors
/// [`OuterSkinError`].
pub fn outer_skin(surface: &Surface, seal: Option<f64>, context: &Context<'_>) -> Result<OuterSkin, OuterSkinError> {
    let sides = FacetSides::new(surface, context)?;
    let lids = match seal {
        Some(_) => Lids::none(),
        None => Lids::new((&surface.positions, &surface.faces), (&sides.positions, &sides.corners)),
    };
    let model = Model::new(surface, &sides, lids);
    let (seal, outer) = model.choose(seal, context)?;
    let filling_seal = model.filling_seal(seal, &outer, context)?;
    let accounting = Accounting::new(surface, &sides, &outer);
    let widest_lid = model.lids.widest;
    Ok(OuterSkin { surface: outer_facets(&sides, &outer), seal, widest_lid, accounting, filling_seal })
}

/// A model prepared for several seals.
struct Model<'a> {
    sides: &'a FacetSides,
    tree: Tree,
    lids: Lids,
    cells: SideCells,
    diagonal: f64,
    centre: DVec3,
}

impl<'a> Model<'a> {
    fn new(surface: &Surface, sides: &'a FacetSides, lids: Lids) -> Self {
        let bounds = surface.bounds();
        let tree = Tree::new(&sides.positions, &sides.corners);
        Self { sides, tree, lids, cells: SideCells::new(sides), diagonal: bounds.diagonal(), centre: bounds.centre() }
    }

    /// The seal, and for each side whether outside air is in front of it. Without a given seal, the smallest of the
    /// tried ones whose volume agrees with the next larger one. Where the largest two disagree, a surface that is open
    /// or has thin double walls takes the largest; another takes a smaller one, which leaves the necks of vessels open.
    fn choose(&self, seal: Option<f64>, context: &Context<'_>) -> Result<(f64, Vec<bool>), OuterSkinError> {
        if let Some(seal) = seal {
            let (outer, _) = self.outer(seal, MAX_NODES, context)?.ok_or(OuterSkinError::TooFine)?;
            return Ok((seal, outer));
        }
        let (positions, corners) = (&self.sides.positions, &self.sides.corners);
        let is_faulty = self.cells.is_open() || double_walls(positions, corners, &self.tree, context)?.is_some();
        let mut best: Option<(f64, f64, Vec<bool>)> = None;
        let mut expected_nodes = 0;
        let mut agree = false;
        for seal in SEALS.map(|share| share * self.diagonal) {
            if expected_nodes > MAX_NODES_TRIED {
                break;
            }
            let Some((outer, nodes)) = self.outer(seal, MAX_NODES, context)? else { break };
            expected_nodes = nodes * MORE_NODES;
            let volume = self.volume(&outer);
            if let Some((_, before, _)) = best {
                let agrees = (volume - before).abs() <= AGREEMENT * volume.abs().max(before.abs());
                if !agrees && (agree || is_faulty) {
                    break;
                }
                agree |= agrees;
            }
            best = Some((seal, volume, outer));
        }
        best.map(|(seal, _, outer)| (seal, outer)).ok_or(OuterSkinError::TooFine)
    }

    /// The least wider seal tried with which a thin-walled skin would be filled.
    fn filling_seal(&self, seal: f64, outer: &[bool], context: &Context<'_>) -> Result<Option<f64>, OuterSkinError> {
        let (volume, widest) = (self.volume(outer), WIDEST * self.diagonal);
        if seal * WIDER > widest || 2.0 * volume > HOLLOW_WALL * self.diagonal * self.area(outer) {
            return Ok(None);
        }
        let fills = |seal: f64| -> Result<bool, OuterSkinError> {
            let found = self.outer(seal, MAX_NODES, context)?;
            Ok(found.is_some_and(|(outer, _)| self.volume(&outer) >= FILLS * volume))
        };
        if !fills(widest)? {
            return Ok(None);
        }
        let mut wider = seal * WIDER;
        while wider < widest && !fills(wider)? {
            wider *= WIDER;
        }
        Ok(Some(wider.min(widest)))
    }

    /// For each side whether outside air is in front of it, with the octree's number of nodes.
    fn outer(
        &self,
        seal: f64,
        max_nodes: usize,
        context: &Context<'_>,
    ) -> Result<Option<(Vec<bool>, usize)>, OuterSkinError> {
        let options = ReachOptions { diameter: seal, cells_per_diameter: 4, refinements: 2, max_nodes };
        let uncovered = (&self.sides.positions[..], &self.sides.corners[..], &self.tree);
        let reach = self.lids.reach(uncovered, options, context)?;
        let Some(reach) = reach else { return Ok(None) };
        let evidence = evidence(self.sides, &self.tree, &reach, context)?;
        let labels = Labels::new((self.sides, &self.cells), &evidence, (&self.tree, seal), context)?;
        Ok(Some((labels.outer, reach.node_count())))
    }

    /// The area of the facets with air on one side.
    fn area(&self, outer: &[bool]) -> f64 {
        boundary(outer).map(|facet| self.sides.area_vector(facet).length() / 2.0).sum()
    }

    /// The volume behind the facets with air on one side.
    fn volume(&self, outer: &[bool]) -> f64 {
        let signed = |facet: u32| {
            let [a, b, c] = self.sides.triangle(facet).map(|p| p - self.centre);
            let volume = a.dot(b.cross(c)) / 6.0;
            if outer[2 * facet as usize] { volume } else { -volume }
        };
        boundary(outer).map(signed).sum()
    }
}

/// The facets with air on exactly one side.
fn boundary(outer: &[bool]) -> impl Iterator<Item = u32> {
    (0u32..).zip(outer.chunks_exact(2)).filter(|(_, sides)| sides[0] != sides[1]).map(|(facet, _)| facet)
}

/// The facets with air on exactly one side, with the air in front, in the order of the faces they come from; `source`
/// holds those faces.
fn outer_facets(sides: &FacetSides, outer: &[bool]) -> Surface {
    let mut kept: Vec<(u32, u32)> = boundary(outer).map(|facet| (sides.face[facet as usize], facet)).collect();
    kept.sort_unstable();
    let corners = |facet: u32| {
        let [a, b, c] = sides.corners[facet as usize];
        if outer[2 * facet as usize] { [a, b, c] } else { [a, c, b] }
    };
    let mut surface = Surface {
        positions: sides.positions.clone(),
        faces: kept.iter().map(|&(_, facet)| corners(facet)).collect(),
        source: kept.iter().map(|&(face, _)| face).collect(),
    };
    surface.drop_unreferenced();
    surface
}
